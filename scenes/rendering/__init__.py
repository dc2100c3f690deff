"""From a scene to linear frames, with Mitsuba.

build           The scene as a Mitsuba dictionary, and how its moving parts are set for a moment
differentiable  Photons through the glue lens onto the film, as a function of the lens and its
                pose
glass           Images by photons through the lens as real glass, which know nothing of its
                irradiance table
images          Images of a scene without the camera's noise, for any pose of the tip
photons         The glue lens as real glass: where Mitsuba's photons leave its cap, and in which
                direction
pixels          Some pixels of an image, sampled on a regular grid
placement       Where things stand in a Mitsuba scene
plugins         Mitsuba plugins: the lens and the cone as emitters, and an integrator without
                noise
reach           Which pixels a moving instrument can change: those that see it, or what its beam
                reaches
render          From a scene to linear frames: sharp ones of a moment, and what an exposure
                gathers
rivals          The usual ways to render a spot behind a lens, on our own scene: what ours is
                compared with
sensor          Mitsuba plugin: the microscope, for light traced from it and towards it
smooth_lens     Photons through the glue lens whose place, direction and power are smooth in its
                parameters
wall            The phantom's wall for Mitsuba: its shape and the picture on it
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
