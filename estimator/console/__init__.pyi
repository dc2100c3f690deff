from .advice import exposure_advice as exposure_advice
from .guide import Guide as Guide
from .guide import Stage as Stage
from .session import Session as Session
from .session import View as View
