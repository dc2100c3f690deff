"""From spots to model parameters, each with an error that means what it says.

_least_squares  Levenberg-Marquardt with covariance
_paper_fits     the paper's Table I (delta k, b on planes) and Table II (c in spheres)
"""

from calibration._paper_fits import PlaneFit as PlaneFit
from calibration._paper_fits import SphereFit as SphereFit
from calibration._paper_fits import fit_eccentricity as fit_eccentricity
from calibration._paper_fits import fit_plane as fit_plane
