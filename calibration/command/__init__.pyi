from .choices import Choices as Choices
from .fitting import Fit as Fit
from .fitting import fit_recordings as fit_recordings
from .page import templates as templates
