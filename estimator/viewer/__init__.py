"""Recordings for the viewer rerun: `--rerun FILE|live`.

eyeball    The eye in three dimensions: eyeball, retina, and the beam from the tip to the wall
recording  A recording of frames and of what was measured or is known in them
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
