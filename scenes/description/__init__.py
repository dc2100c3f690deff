"""The scene file: what a person may write, validated.

camera_settings  The table [camera] of the scene file
command          The commands `eyespot scene init` and `scene schema`, and the options that scenes
                 are read with
motion_settings  The tables [motion] and [clocks] of the scene file
scene_file       The scene file (TOML): read with errors for people, written, explained, and its
                 JSON schema
settings         A scene: every key with its unit and default, validated before anything is
                 rendered
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
