from .command import score as score
