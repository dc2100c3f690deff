"""From spots to model parameters, each with an error that means what it says.

_least_squares  Levenberg-Marquardt with covariance
_cone_fit       the exact geometry: half-angle, b, scale, eye, with each trial's nuisances
_cone_trials    the trials it is fitted to, and how far they are from its contours
_image_fit      every pixel of a stack: cone or lens, brightness, pose
_image_solver   how it goes; _image_parameters: names, units, what they may be
_image_model    what a pixel sees; _image_table: the light of a lens near some parameters
_image_data     frames as light with a known noise; _image_pixels: which of them a fit takes
_image_chunks   the model and its slopes, chunk by chunk
_normal_equations  Levenberg-Marquardt without residuals in memory
_identifiability   what data determine, in words
_paper_fits     the paper's Table I (delta k, b on planes) and Table II (c in spheres)
_plane_trials   Table I over several trials, each with its touch error, on a tilted plane
_robust         Huber's loss instead of squares
_withdrawal     readings and axis from the robot's poses
recordings      stacks, spots files and bags as trials: the estimator's spots, the robot's readings
fit_command     `eyespot fit`; _fit_models: what --model can be; _goodness: is the fit good
_fit_pixels     of these, the fits to pixels; _fitted: what any of them comes to
fit_report      the fit as an HTML page
render_bridge   a renderer as a JAX function
"""

from calibration._cone_fit import ConeFit as ConeFit
from calibration._cone_fit import fit_cone as fit_cone
from calibration._cone_trials import Prior as Prior
from calibration._cone_trials import Trial as Trial
from calibration._image_fit import fit_image as fit_image
from calibration._image_fit import lens_start as lens_start
from calibration._image_solver import ImageFit as ImageFit
from calibration._paper_fits import PlaneFit as PlaneFit
from calibration._paper_fits import SphereFit as SphereFit
from calibration._paper_fits import fit_eccentricity as fit_eccentricity
from calibration._paper_fits import fit_plane as fit_plane
from calibration._plane_trials import PlaneTrial as PlaneTrial
from calibration._plane_trials import PlaneTrialsFit as PlaneTrialsFit
from calibration._plane_trials import fit_plane_trials as fit_plane_trials
from calibration.render_bridge import FLOAT32_LEVENBERG_MARQUARDT as FLOAT32_LEVENBERG_MARQUARDT
from calibration.render_bridge import render_as_jax as render_as_jax
