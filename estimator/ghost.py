"""A ghost: a second, fainter image of the spot that moves with it, as a cover glass makes one.

One frame cannot show it: what a ghost adds may as well be the wall's texture. But a texture keeps
its place on the wall while the spot grows or moves on, and a ghost keeps its place beside the spot.
So each cell of the wall has a reflectance of its own, alike in all frames, which is eliminated.
What is left of the light of a model without a ghost is compared with the light that a ghost would
add, at shifts all round.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float
from scipy import ndimage

from eyespot.formats.spot import Spot

_RADII_PX = (8.0, 12.0, 18.0, 27.0, 40.0, 60.0)
"""Lengths of the shifts that are tried: half of the step to the next one is a fifth of it, and so
much beside its place a ghost still has most of its effect."""
_ANGLES = 12
_FEWEST_FRAMES, FRAMES_TO_DENY = 2, 4
"""Frames that may show a ghost, and that deny one which others showed."""
GHOST_SIGMAS = 5.0
"""Standard deviations of its share from which a ghost is found. In rendered stacks without one, the
strongest of all shifts had 1.4 to 2.3."""
_RIDGE = 1e-9  # added to each direction's information, which is 1: columns may be equal


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

    @property
    def is_found(self) -> bool:
        """Whether what a model of the beam leaves shows it, and it is large enough to matter."""
        return self.sigmas > GHOST_SIGMAS and _LEAST_SHARE < self.share < 1.0

    @property
    def said(self) -> str:
        """Where it is, in words."""
        right, down = self.shift_px
        return (
            f"the spot has a ghost, a second image some {right:+.0f} px to the right and "
            f"{down:+.0f} px down of it, at least {100 * self.share:.0f} % as bright. Look for "
            "reflexes of a cover glass, a lens or the eye"
        )


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


_COUNT = 26
_LATTICE_MARGIN_PX = 70.0  # beside the largest spot: the longest shift, and a cell
_KEPT = 4
_GROWN, _MOVED = 0.04, 0.25
"""Change of a spot's size, and of its place over its size, from which it lights its wall otherwise:
a pixel and a half of an outline of 40 px."""
_SHARP = 0.1
"""Largest width of an edge over the semi-minor axis of a spot whose light is even within it. The
light of others has a shape of its own, which only a model of the beam tells from a ghost."""
_LEAST_COVERAGE = 0.85
_SURE_SIGMAS, _LEAST_SHARE = 13.0, 0.03
"""A ghost of a sharp spot is found where two sets of frames in succession have these on average.
The light within a spot and beside it is only even to some percent: in rendered stacks without a
ghost, sets had shares of up to 0.04 with 9 standard deviations, where the shaft is near a small
spot. A share of 0.03 moves the edge by 0.02 px."""
_EVEN_SIGMA = 0.01  # standard deviation of the logarithm of such light that nothing undercuts
_FLOOR = 0.05
"""Light that counts as ambient beside that outside of the spot, over that within: where it is dark,
the logarithm of noise would outweigh everything."""
_HIDDEN_SIGMAS = 5.0  # standard deviations below the others: a tool, or its shadow


class GhostWatch:
    """Looks for ghosts of sharp spots in frames that follow each other, as a cone makes them."""

    def __init__(self) -> None:
        self._kept: list[tuple[np.ndarray, Spot]] = []
        self.found: Ghost | None = None
        self.strongest: Ghost | None = None
        self._doubt = 0.0  # of the set of frames before: 1 where it shows a ghost
        self._denials = 0  # sets since the last one that showed the ghost that was found

    def look(self, image: np.ndarray, spot: Spot) -> None:
        """Take a frame, and note in `found` what ghost the last ones show, of all in `strongest`.

        A ghost that was found stays, as what makes it does, until some frames in succession that
        would show it do not, or the spot is no longer sharp.

        Args:
            image: H x W, or H x W x 3.
        """
        sharp = spot.edge_width_px <= _SHARP * spot.semi_minor_px
        if not sharp or spot.coverage < _LEAST_COVERAGE:  # its tool or a shadow is beside it
            self._kept, self._doubt = [], 0.0
            if not sharp:
                self.found = None
            return
        if self._kept and _alike(self._kept[-1][1], spot):
            return
        grey = image if image.ndim == 2 else image[..., 1]
        self._kept = [*self._kept, (grey.astype(np.float32), spot)][-_KEPT:]
        if len(self._kept) < _FEWEST_FRAMES:
            return
        ghost = _beside_discs(self._kept) or _NONE
        doubt = min(ghost.sigmas / _SURE_SIGMAS, ghost.share / _LEAST_SHARE)
        self._denials = 0 if doubt > 1.0 else self._denials + 1
        if doubt + self._doubt > 2.0:
            self.found = ghost
            if ghost.share > (self.strongest or _NONE).share:
                self.strongest = ghost
        elif self._denials >= FRAMES_TO_DENY:
            self.found = None
        self._doubt = doubt


_NONE = Ghost(0.0, 1.0, (0.0, 0.0), np.zeros((0, 0)))


def _alike(one: Spot, other: Spot) -> bool:
    away = np.hypot(one.x_px - other.x_px, one.y_px - other.y_px) / one.semi_minor_px
    grown = abs(np.log(one.semi_minor_px / other.semi_minor_px))
    return bool(away < _MOVED and grown < _GROWN)


def _beside_discs(frames: Sequence[tuple[np.ndarray, Spot]]) -> Ghost | None:
    """The strongest ghost of even discs with the outlines of spots."""
    spots = [spot for _, spot in frames]
    reach = max(spot.semi_major_px for spot in spots) + _LATTICE_MARGIN_PX
    side = int(np.ceil(2.0 * reach / _COUNT))
    middle = np.mean([(spot.x_px, spot.y_px) for spot in spots], axis=0)
    corner = np.round(middle - 0.5 * _COUNT * side)
    along = (np.arange(_COUNT) + 0.5) * side - 0.5
    x, y = np.meshgrid(corner[0] + along, corner[1] + along)
    parts = [_disc(grey, spot, corner, side, x, y) for grey, spot in frames]
    residual, weight, light, total, slopes = zip(*parts, strict=True)
    return strongest_ghost(
        np.stack(residual),
        np.stack(weight),
        np.stack(light),
        np.stack(total),
        slopes,
        side_px=side,
    )


def _disc(
    grey: np.ndarray, spot: Spot, corner: np.ndarray, side: int, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Residual, weight, light, total light and slopes of a frame on the cells, see above."""
    size = _COUNT * side
    shift = np.array([[1.0, 0.0, -corner[0]], [0.0, 1.0, -corner[1]]])
    cut = cv2.warpAffine(grey, shift, (size, size), borderValue=float("nan"))
    seen = cut.reshape(_COUNT, side, _COUNT, side).mean(axis=(1, 3))
    cosine, sine = np.cos(spot.angle_rad), np.sin(spot.angle_rad)
    right, down = x - spot.x_px, y - spot.y_px
    major = (right * cosine + down * sine) / spot.semi_major_px
    minor = (down * cosine - right * sine) / spot.semi_minor_px
    outwards = (np.hypot(major, minor) - 1.0) * spot.semi_minor_px
    edge = 2.0 * spot.edge_width_px + 0.75 * side
    within, beside = outwards < -edge, outwards > edge
    usable = np.isfinite(seen) & (within | beside) & (seen < grey.max())
    if not (usable & within).any() or not (usable & beside).any():
        nothing = np.zeros(seen.size)
        return nothing, nothing, np.zeros_like(seen), np.ones_like(seen), np.zeros((0, seen.size))
    ambient = float(np.median(seen[usable & beside]))
    peak = max(float(np.median(seen[usable & within])) - ambient, 1e-6)
    light = peak * np.clip(0.5 - outwards / max(2.0 * spot.edge_width_px, side), 0.0, 1.0)
    floor = _FLOOR * peak
    total = light + floor
    residual = np.log(np.maximum(seen - ambient + floor, 0.2 * floor) / total)
    spread = 1.4826 * np.median(np.abs(residual - np.median(residual[usable]))[usable])
    usable &= residual > np.median(residual[usable]) - _HIDDEN_SIGMAS * max(
        spread, 2.0 * _EVEN_SIGMA
    )
    slopes = [within, within * major, within * minor, within * major**2, within * major * minor]
    slopes += [within * minor**2, beside, beside * major, beside * minor]
    return (
        np.where(usable, residual, 0.0).ravel(),
        usable.ravel() / _EVEN_SIGMA**2,
        light,
        total,
        np.stack([1.0 * slope.ravel() for slope in slopes]),
    )
