"""A ghost: a second, fainter image of the spot that moves with it, as a cover glass makes one.

One frame cannot show it: what a ghost adds may as well be the wall's texture. But a texture keeps
its place on the wall while the spot grows or moves on, and a ghost keeps its place beside the spot.
So each cell of the wall has a reflectance of its own, alike in all frames, which is eliminated.
What is left of the light of a model without a ghost is compared with the light that a ghost would
add, at shifts all round.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

_RADII_PX = (8.0, 12.0, 18.0, 27.0, 40.0, 60.0)
"""Lengths of the shifts that are tried: half of the step to the next one is a fifth of it, and so
much beside its place a ghost still has most of its effect."""
_ANGLES = 12
_FEWEST_FRAMES, FRAMES_TO_DENY = 2, 4
"""Frames that may show a ghost, and that deny one which others showed."""
GHOST_SIGMAS = 5.0
"""Standard deviations of its share from which a ghost is found. In rendered stacks without one, the
strongest of all shifts had 1.4 to 2.3."""
_RIDGE = 1e-9  # of a direction's own information


class Ghost(NamedTuple):
    """The ghost that explains best what a model without one leaves.

    Attributes:
        share: its light over the spot's.
        sigma: standard deviation of the share, by the residuals.
        shift_px: of the ghost from the spot, to the right and downwards.
        added: what it adds to the logarithm of the light per unit share, frames x cells.
    """

    share: float
    sigma: float
    shift_px: tuple[float, float]
    added: Float[np.ndarray, "f n"]

    @property
    def sigmas(self) -> float:
        """The share over its standard deviation."""
        return self.share / self.sigma


def strongest_ghost(
    residual: Float[np.ndarray, "f n"],
    weight: Float[np.ndarray, "f n"],
    light: Float[np.ndarray, "f rows columns"],
    total: Float[np.ndarray, "f rows columns"],
    slopes: Sequence[Float[np.ndarray, "p n"]],
    *,
    side_px: float,
) -> Ghost | None:
    """The ghost that explains best what is left of a model; None where frames show too little.

    Args:
        residual: logarithm of the measured light less that of the model, by frame and cell of the
            wall.
        weight: 1 over its variance; 0 for cells that are not used.
        light: of the beam by the model, in any unit.
        total: the same with the ambient light.
        slopes: of each frame, derivatives of the model by what was fitted to the frame.
    """
    frames, cells = residual.shape
    weight = weight * ((weight > 0).sum(axis=0) > 1)  # a cell of one frame shows its own wall only
    if frames < _FEWEST_FRAMES or not weight.any():
        return None
    shifts = [
        (radius * np.cos(turn), radius * np.sin(turn))
        for radius in _RADII_PX
        for turn in np.arange(_ANGLES) * 2.0 * np.pi / _ANGLES
    ]
    added = np.stack(
        [
            ndimage.shift(light, (0.0, down / side_px, right / side_px), order=1, mode="nearest")
            / total
            for right, down in shifts
        ]
    ).reshape(len(shifts), frames, cells)
    states = np.zeros((sum(map(len, slopes)), frames, cells))
    at = 0
    for k, own in enumerate(slopes):
        states[at : at + len(own), k] = own
        at += len(own)
    root, every = np.sqrt(weight), weight.sum(axis=0)

    def within(values: np.ndarray) -> np.ndarray:
        """Values less what the wall's reflectance explains, over their standard deviations."""
        mean = (weight * values).sum(axis=-2) / np.maximum(every, 1e-300)
        return np.asarray((root * (values - mean[..., None, :])).reshape(len(values), -1))

    left, basis, ghosts = within(residual[None])[0], within(states), within(added)
    basis /= np.maximum(np.linalg.norm(basis, axis=1, keepdims=True), 1e-300)
    gram = basis @ basis.T + _RIDGE * np.eye(len(basis))
    left = left - np.linalg.solve(gram, basis @ left) @ basis
    ghosts -= np.linalg.solve(gram, basis @ ghosts.T).T @ basis
    freedom = np.count_nonzero(weight) - np.count_nonzero(every) - len(basis)
    if freedom < 1:
        return None
    information = np.square(ghosts).sum(axis=1)
    share = ghosts @ left / np.maximum(information, 1e-300)
    # The residuals that the ghost leaves say how far noise and model are to be trusted.
    squares = left @ left - share**2 * information
    sigma = np.sqrt(np.maximum(squares / freedom, 1.0) / np.maximum(information, 1e-300))
    best = int(np.argmax(share / sigma))
    return Ghost(float(share[best]), float(sigma[best]), shifts[best], added[best])
