"""What do data say of a state, which step fits them best, and how uncertain is it then?

The one damped step of every Levenberg-Marquardt loop in NumPy, and the covariance at its end.
"""

import numpy as np

_RIDGE = 1e-12
"""Share of a state's own information that is added to it, so that one without any stays."""


class Information:
    """An information matrix J^T J, (s, s), in units in which each state has the information 1.

    Attributes:
        least: information of the direction that is known worst, in these units; at rounding's size
            (1e-12) the data do not determine it.
    """

    def __init__(self, matrix: np.ndarray) -> None:
        own = np.diag(matrix)
        size = 1.0 / np.sqrt(np.maximum(own, max(_RIDGE * own.max(), np.finfo(float).tiny)))
        values, vectors = np.linalg.eigh(size[:, None] * matrix * size)
        self.least = float(values[0])
        self._values = np.maximum(values, 0.0) + _RIDGE
        self._axes = size[:, None] * vectors

    def solved(self, values: np.ndarray, damping: float = 0.0) -> np.ndarray:
        """The inverse times values, (s,), with a share of each state's own information added to it.

        Times the gradient J^T r it is the step of Levenberg and Marquardt.
        """
        return self._axes @ ((values @ self._axes) / (self._values + damping))

    def solved_within(
        self, values: np.ndarray, damping: float, limits: dict[int, tuple[float, float]]
    ) -> np.ndarray:
        """The same with some numbers kept within limits, one after the other."""
        step = self.solved(values, damping)
        for at, (least, most) in limits.items():
            excess = step[at] - np.clip(step[at], least, most)
            if excess:
                column = self.solved(np.eye(1, step.size, at)[0], damping)
                step -= column * (excess / column[at])
        return step

    def inverse(self) -> np.ndarray:
        """The covariance, if the residuals are over their standard deviations."""
        return (self._axes / self._values) @ self._axes.T
