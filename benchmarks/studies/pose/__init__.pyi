from .errors import angle_deg as angle_deg
from .errors import drawn_prior as drawn_prior
from .findings import PRIOR_DEG as PRIOR_DEG
from .findings import REPORTED as REPORTED
