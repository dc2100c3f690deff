"""Rendering with Mitsuba: from a scene to linear frames.

build           The Mitsuba dictionary of a scene, and how the tip is moved in it
differentiable  Images by photons, with derivatives by the lens and its pose
fine_light      Light of the beam and reflectance of the wall, finer than pixels
glass           Images by photons through the lens as glass, without its irradiance table
images          Noise-free images for any pose of the tip
lines           Radiance along given lines of sight, for any other camera
path_sensor     Mitsuba plugin: the microscope behind a viewing path
photons         The glue lens as glass, through which Mitsuba traces photons
pixels          Renders a subset of the pixels, or places within them, on a regular grid
placement       Rigid transforms and the wall of a Mitsuba scene
plugins         Mitsuba plugins: lens and cone as emitters, and a noise-free integrator
reach           Which pixels change when the tip moves
render          Linear frames: sharp ones, and the mean over an exposure (motion blur)
sensor          Mitsuba plugin: the microscope
smooth_lens     Photons behind the lens, as a smooth function of its parameters
unrest          Moves the view and the eyeball, and changes the source's power
wall            The wall for Mitsuba: its shape, an ellipsoid as a mesh, and the picture on it
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
