from .advice import exposure_advice as exposure_advice
from .session import Session as Session
from .session import View as View
