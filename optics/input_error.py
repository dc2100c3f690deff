"""The error that says a value from outside is wrong; every other exception is a defect of ours."""


class InputError(ValueError):
    """A value that the caller can correct; the text names it, its unit, the rule and the remedy.

    The command line prints the text of an InputError and ends with 2. A ValueError of Python, NumPy
    or SciPy comes from a defect of ours and keeps its traceback: a frame's "math domain error" is
    no fault of the one who took the frame.
    """
