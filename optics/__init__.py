"""Physics of the spot as pure, differentiable functions: mm, rad, px; JAX in float64.

array_namespace    NumPy or JAX, chosen by a function's arguments; does not import JAX
beam               The fibre's beam: a cone, given by tip and axis or by spot and distance
camera             Pinhole microscope at any height: above the retina, at infinity, or behind it
contour            The exact spot: intersection of cone and wall, projected and fitted
contour_pose       Tip and axis of the beam from the image of the spot's edge
distance           Distance from the exact contour: by its semi-minor axis, or by its area for
                   a known axis
ellipse            The ellipse of a contour, with one definition for labels, models and fits
ellipse_pose       Tip and axis of the beam from a measured ellipse
emission           Rays from the core's face through the cap, and the power they carry
half_maximum       The contour where direct irradiance on the wall is half of its peak
indirect           Light that a Lambertian eyeball scatters back onto its own wall
input_error        The error that says a value from outside is wrong, and values in its text
input_files        Reads text and TOML that anyone may have written
input_model        Formats of files as pydantic models, and what is wrong with a content
irradiance         Vector irradiance of a glue lens at a wall point, by quadrature
irradiance_breaks  Rings of a cap at which its lit part changes its form
irradiance_edges   Boundaries between lit and dark along a scan
irradiance_lookup  Vector irradiance of a lens in a medium, as a table
irradiance_turns   Turns of the edge of a cap's lit part
lens               GlueLens, a drop of glue on a fibre's end: shape, light and presets
lens_trace         Rays traced backwards from a wall point through the cap to the core's face
mismatch           Difference of a contour's ellipse from a measured one, without a fit
models             Models from spot size to distance: planar, small_plane, corrected, stereographic
pose               The five parameters of tip and axis, and their solver
profile            Spot radius behind a lens: half maximum, isophote, equivalent cone
refraction         Refraction and Fresnel transmission at a smooth boundary between two media
spread_contour     The spot's contours on a wall that spreads light, for labels
square_spot        The spot of a beam perpendicular to the wall, and its image, in closed form
surface            The walls: a plane with any normal, the eyeball's sphere, and an ellipsoid
truth              The true parameters of a beam's spot, for labels
vector             Operations on three-vectors by components
viewing/           The eye's own optics and the lenses through which a surgeon looks
wall_light/        Light of the wall behind pixels: the image model of fits and of the pixels mode
wall_spread        The point-spread on a wall that scatters light sideways before it leaves
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
