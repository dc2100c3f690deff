"""From spots to model parameters, each with an error that means what it says.

_least_squares  Levenberg-Marquardt with covariance
_cone_fit       the exact geometry: half-angle, b, scale, eye, with each trial's nuisances
recordings      stacks as trials: spots by the estimator, readings by the robot
fit_command     `eyespot fit`
_paper_fits     the paper's Table I (delta k, b on planes) and Table II (c in spheres)
"""

from calibration._cone_fit import ConeFit as ConeFit
from calibration._cone_fit import Prior as Prior
from calibration._cone_fit import Trial as Trial
from calibration._cone_fit import fit_cone as fit_cone
from calibration._paper_fits import PlaneFit as PlaneFit
from calibration._paper_fits import SphereFit as SphereFit
from calibration._paper_fits import fit_eccentricity as fit_eccentricity
from calibration._paper_fits import fit_plane as fit_plane
