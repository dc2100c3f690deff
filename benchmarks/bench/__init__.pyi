from .output import show as show
from .output import table as table
