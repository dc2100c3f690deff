"""Physics of the spot as pure, differentiable functions: mm, rad, px; JAX in float64.

beam              The fibre's beam: a cone, given by tip and axis or by spot and distance
camera            Pinhole microscope at any height: above the retina, at infinity, or behind it
contour           The exact spot: cone and wall intersected, projected, and its ellipse fitted
distance          Distance from the exact contour: by its semi-minor axis, or by its area for a
                  known axis
ellipse           The ellipse of a contour, with one definition for labels, models and fits
input_error       The error that says a value from outside is wrong, and values in its text
input_files       Reads text and TOML that anyone may have written
input_model       Formats of files as pydantic models, and what is wrong with a content
irradiance        Vector irradiance of a glue lens at a wall point, by quadrature
irradiance_edges  The edge of a cap's lit part, when seen from a wall point
lens              GlueLens, a drop of glue on a fibre's end: shape, light and presets
lens_table        Light behind a lens: rays and power, irradiance as a table, the spot's radius
models            Models from spot size to distance in closed form, and back; does not import JAX
pose              Tip and axis of the beam, from a measured ellipse or the image of the spot's edge
refraction        Refraction and Fresnel transmission at a smooth boundary between two media
surface           The walls: a plane with any normal, the eyeball's sphere, and an ellipsoid
truth             The true parameters of a beam's spot, for labels; also of spread light
viewing/          The eye's own optics and the lenses through which a surgeon looks
wall_light/       Light of the wall behind pixels: the image model of fits and of the pixels mode
"""

import os
import sys

import lazy_loader

# Half a micrometre at 200 mm needs more than float32's seven digits. JAX reads the variable at its
# first import; if JAX is already imported, its setting must be changed.
os.environ["JAX_ENABLE_X64"] = "1"
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
