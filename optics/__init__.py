"""Physics of the spot as pure, differentiable functions: mm, rad, px; JAX in float64.

array_namespace    NumPy or JAX, by the arrays that a function is given; does not import JAX
beam               The fibre's beam: a cone given by tip and axis, by spot and distance, or
                   through a trocar
camera             Pinhole microscope at any height, from the eyeball's centre to infinity
cholesky           Small positive definite systems, solved for whole batches at once
contour            The exact spot: cone and wall intersected generator by generator, projected,
                   fitted
contour_pose       Tip and axis of the beam from the image of the spot's edge
distance           `exact`: the distance whose exact contour has the measured semi-minor axis
ellipse            The ellipse of a contour, by one definition that labels, models and fits share
ellipse_pose       Tip and axis of the beam from a measured ellipse: five numbers for five
                   parameters
emission           Light on its way out: rays from the core's face through the cap, and the power
                   they carry
half_maximum       The spot's edge by light: where the direct irradiance on the wall falls to half
                   of its peak
indirect           Light that a matt eyeball scatters back onto its own wall
irradiance         Vector irradiance of a glue lens on any wall point, by deterministic quadrature
irradiance_edges   Edges of the part of a cap that is lit when seen from a wall point
irradiance_lookup  Vector irradiance of a lens in a medium, tabulated for look-up
lens               GlueLens: a drop of glue on the end of a fibre, its shape, its light and its
                   presets
lens_misaligned    A glue lens whose cap sits off the core's centre or tilted to it: no symmetry
                   about the axis
lens_trace         Rays traced backwards through the cap of a glue lens: from a wall point to the
                   core's face
mismatch           How far a contour's fitted ellipse is from a measured one, without fitting it
models             Models from spot size to distance: planar, small_plane, corrected,
                   stereographic
pose               Tip and axis of the beam, five parameters: what is estimated, and the solver
                   for it
profile            What a spot's radius means behind a lens: half maximum, isophote, and the cone
                   they amount to
refraction         Refraction and Fresnel transmission at a smooth boundary between two media
square_spot        The spot of a beam square to the wall and its image, in closed form: the models'
                   other direction
surface            Walls that the beam meets: a plane of any normal and the eyeball's sphere
truth              What is true of the spot of any beam: the numbers behind every label
vector             Three-vectors on the last axis, written out by components
"""

import os
import sys

import lazy_loader

# Half a micrometre at 200 mm needs more than float32's seven digits. JAX reads the variable when
# it is first imported; a JAX that is there already has to be told.
os.environ["JAX_ENABLE_X64"] = "1"
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
