from . import studies as studies
from .benchmarks.model_error import error_limits as error_limits
from .benchmarks.rig_error import model_error as model_error
from .benchmarks.sets.read import read_set as read_set
from .command_line import main as main
from .estimator.recording import Recording as Recording
from .formats.rig import Rig as Rig
from .formats.rig import read_rig as read_rig
from .formats.stack import read_stack as read_stack
from .functions import Scene as Scene
from .functions import Stack as Stack
from .functions import dataset as dataset
from .functions import fit as fit
from .functions import load_scene as load_scene
from .functions import measure as measure
from .functions import render as render
from .functions import score as score
from .functions import track as track
from .results import Fit as Fit
from .results import Score as Score

__version__: str
