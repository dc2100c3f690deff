from .offline import Ended as Ended
from .offline import Tracking as Tracking
from .offline import track_source as track_source
from .options import Options as Options
from .progress_bar import Advance as Advance
from .progress_bar import progress as progress
from .reader import Reader as Reader
from .reader import Reading as Reading
