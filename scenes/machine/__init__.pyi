from . import doctor as doctor
from .variant import RendererUnavailable as RendererUnavailable
from .variant import load_mitsuba as load_mitsuba
