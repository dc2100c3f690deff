"""The scene file: its keys, their validation, and how it is read and written.

camera_settings   The table [camera]
command           The commands `eyespot scene init` and `scene schema`, and options for scenes
motion_settings   The tables [motion] and [clocks]
scene             A whole scene with its table [unrest], and the rules that its tables must meet
scene_file        Scene files (TOML): reading, changing, writing, template and JSON schema
settings          All other tables
viewing_settings  The table [viewing]
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
