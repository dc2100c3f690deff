from .cluster import cores as cores
from .cluster import local_workers as local_workers
from .generate import WHOLE as WHOLE
from .generate import Shard as Shard
from .generate import make_set as make_set
from .generate import rendered_set as rendered_set
from .manifest import verify_set as verify_set
from .worker import versions as versions
