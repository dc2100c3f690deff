from .command import score as score
from .judging import Score as Score
from .sample import sample_folder as sample_folder
from .scoring import run as run
