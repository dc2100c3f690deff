"""Physics of the spot as pure, differentiable functions: mm, rad, px; JAX in float64.

_camera      Microscope: pinhole at any height, telecentric limit, distortion
_surface     Sphere, Plane: intersections with a status, frames at a wall point
_vector      three-vectors by components
_beam        Beam: cone by tip and axis, by spot and distance, through a trocar; contact
_ellipse     the ellipse of a contour
_ellipse_mismatch  how far it is from a measured one
_contour     the exact spot: cone and wall intersected, projected, fitted
_models      planar, small_plane, corrected, stereographic; the paper's terms one by one
_distance    exact: the distance whose exact contour was measured
_pose        tip and axis: what is estimated, the mirror solution, the solver
_pose_from_contour, _pose_from_ellipse  what it is estimated from
_half_maximum  the spot's edge by light on any wall
_truth       what is true of the spot of any beam: the numbers behind labels
_indirect    light scattered back by a closed matt eyeball
_refraction  Snell, Fresnel, the media by name
_lens        GlueLens and its presets
_lens_misaligned  a cap off centre, a tilted end face: no symmetry about the axis
_emission    rays from the core through the cap, and the power they carry
_irradiance  vector irradiance of the lens, by quadrature
_irradiance_table  the same for look-up, by renderer, labels and fits
_profile     what a spot's radius means behind a lens
"""

import jax

# Half a micrometre at 200 mm needs more than float32's seven digits.
jax.config.update("jax_enable_x64", True)

from optics._beam import Beam as Beam
from optics._beam import beam_at_spot as beam_at_spot
from optics._beam import beam_through_trocar as beam_through_trocar
from optics._beam import contact_distance as contact_distance
from optics._beam import perpendicular_frame as perpendicular_frame
from optics._beam import slope as slope
from optics._camera import Microscope as Microscope
from optics._camera import microscope as microscope
from optics._camera import microscope_from_camera_matrix as microscope_from_camera_matrix
from optics._contour import cone_contour as cone_contour
from optics._contour import spot_contour as spot_contour
from optics._contour import spot_ellipse as spot_ellipse
from optics._distance import exact_distance as exact_distance
from optics._distance import exact_semi_minor as exact_semi_minor
from optics._ellipse import Ellipse as Ellipse
from optics._ellipse import ellipse_of_contour as ellipse_of_contour
from optics._ellipse import ellipse_points as ellipse_points
from optics._ellipse_mismatch import ellipse_mismatch as ellipse_mismatch
from optics._ellipse_mismatch import mismatch_covariance as mismatch_covariance
from optics._emission import MISSED_APERTURE as MISSED_APERTURE
from optics._emission import TOTAL_INTERNAL_REFLECTION as TOTAL_INTERNAL_REFLECTION
from optics._emission import TRANSMITTED as TRANSMITTED
from optics._emission import EmittedRays as EmittedRays
from optics._emission import emitted_rays as emitted_rays
from optics._emission import transmitted_power as transmitted_power
from optics._half_maximum import half_maximum_contour as half_maximum_contour
from optics._half_maximum import wall_irradiance as wall_irradiance
from optics._indirect import indirect_irradiance as indirect_irradiance
from optics._irradiance import vector_irradiance as vector_irradiance
from optics._irradiance_table import IrradianceTable as IrradianceTable
from optics._irradiance_table import LensField as LensField
from optics._irradiance_table import irradiance_table as irradiance_table
from optics._lens import GlueLens as GlueLens
from optics._lens import glue_lens as glue_lens
from optics._lens import lens_names as lens_names
from optics._lens import load_lens as load_lens
from optics._lens_misaligned import MisalignedLens as MisalignedLens
from optics._lens_misaligned import (
    misaligned_vector_irradiance as misaligned_vector_irradiance,
)
from optics._models import MODELS as MODELS
from optics._models import corrected_distance as corrected_distance
from optics._models import corrected_factor as corrected_factor
from optics._models import paper_angle_s_d_e as paper_angle_s_d_e
from optics._models import paper_foreshortening as paper_foreshortening
from optics._models import paper_pinhole_distance as paper_pinhole_distance
from optics._models import planar_distance as planar_distance
from optics._models import planar_semi_minor as planar_semi_minor
from optics._models import sagitta as sagitta
from optics._models import small_plane_distance as small_plane_distance
from optics._models import small_plane_spot_radius as small_plane_spot_radius
from optics._models import sphere_distance as sphere_distance
from optics._models import square_spot_axes as square_spot_axes
from optics._models import square_spot_radius as square_spot_radius
from optics._models import stereographic_distance as stereographic_distance
from optics._models import stereographic_semi_axis as stereographic_semi_axis
from optics._pose import DirectionPrior as DirectionPrior
from optics._pose import Pose as Pose
from optics._pose import PoseEstimate as PoseEstimate
from optics._pose_from_contour import pose_from_contour as pose_from_contour
from optics._pose_from_contour import tip_from_contour as tip_from_contour
from optics._pose_from_ellipse import pose_from_ellipse as pose_from_ellipse
from optics._profile import EffectiveCone as EffectiveCone
from optics._profile import ambiguous_distances as ambiguous_distances
from optics._profile import effective_cone as effective_cone
from optics._profile import half_maximum_radius as half_maximum_radius
from optics._profile import isophote_radius as isophote_radius
from optics._refraction import MEDIA as MEDIA
from optics._surface import BEHIND as BEHIND
from optics._surface import HIT as HIT
from optics._surface import MISS as MISS
from optics._surface import Intersection as Intersection
from optics._surface import Plane as Plane
from optics._surface import Sphere as Sphere
from optics._surface import Surface as Surface
from optics._surface import WallFrame as WallFrame
from optics._surface import pole_plane as pole_plane
from optics._truth import SpotTruth as SpotTruth
from optics._truth import spot_truth as spot_truth
