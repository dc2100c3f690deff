"""What the functions return; apart from them, because importing it loads JAX."""

from eyespot.benchmarks.sets.score.judging import Score as Score
from eyespot.calibration.command.fitting import Fit as Fit
