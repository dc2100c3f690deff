from .command import score as score
from .sample import sample_folder as sample_folder
