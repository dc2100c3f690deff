"""Everything derived from a scene: wall, microscope, beam, motion, light, labels.

calibrations  Calibrations without a file: the true one of a scene, and those of studies
geometry      The parts at rest as `optics` objects: wall, position of [spot], microscope
labels        The labels of a frame that follow from geometry
light_cache   Irradiance of a glue lens; takes half a minute to compute, so it is cached on disk
limits        Checks: the tip stays out of the wall, the spot stays in the window
motion        Position of the tip over time, and the clocks of camera and robot
photometry    Brightness: indirect light, and the exposure time of the `paper` frames
unknown_wall  What one frame says of the distance, if nobody knows the wall
unrest        Where the view, the eyeball and the source's power are at a time
reflections   The microscope's lamp as the surfaces of a viewing path reflect it
view          The camera: a pinhole, or the microscope behind a lens and the eye's optics
world         World: derives each of these once and passes it on
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
