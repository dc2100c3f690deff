from .errors import PRIOR_DEG as PRIOR_DEG
from .errors import REPORTED as REPORTED
from .errors import angle_deg as angle_deg
from .errors import drawn_prior as drawn_prior
