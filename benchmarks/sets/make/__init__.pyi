from .cluster import local_workers as local_workers
from .generate import make_set as make_set
