from . import run as run
from .space import BLOCK as BLOCK
