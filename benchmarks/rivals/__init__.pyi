from .pupil import PACKAGE as PACKAGE
from .pupil import PupilDetector as PupilDetector
from .pupil import why_unavailable as why_unavailable
from .scikit_image import contour_ellipse as contour_ellipse
