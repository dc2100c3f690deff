from .crops import Guess as Guess
from .crops import Window as Window
from .crops import blob_in as blob_in
from .estimator import WEIGHTS as WEIGHTS
from .estimator import LearnedEstimator as LearnedEstimator
from .making import make_weights as make_weights
