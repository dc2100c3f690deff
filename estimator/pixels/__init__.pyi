from .beam import NODES as NODES
from .ranger import PixelRanger as PixelRanger
