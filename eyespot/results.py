"""What the functions return; apart from them, because importing it loads JAX."""

from benchmarks.sets.score.judging import Score as Score
from calibration.command.fitting import Fit as Fit
