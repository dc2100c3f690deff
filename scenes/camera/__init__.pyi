from .exposure import FixedPatterns as FixedPatterns
from .exposure import expose as expose
from .exposure import fixed_patterns as fixed_patterns
from .exposure import metered_exposure as metered_exposure
from .output import after_jpeg as after_jpeg
