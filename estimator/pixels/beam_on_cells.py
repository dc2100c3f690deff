"""The light of a calibrated beam on a window's cells, blurred, with derivatives. Loads JAX.

A blur has a variance and an excess kurtosis. A camera out of focus blurs by a disc, whose kurtosis
is -1; many small causes blur by a Gaussian, 0; a wall that scatters light sideways blurs by an
exponential, 2. Between these it is a mixture of the two, whose kurtosis is that of the mixture.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.fft import dct
from scipy.special import j1

from eyespot.estimator.camera_noise import USUAL_CUT, camera_noise
from eyespot.estimator.pixels.frame_cells import COUNT, STILL, CellWindow, WallMotion
from eyespot.formats.microscope import MicroscopeFile
from eyespot.optics.instrument import BareFibre
from eyespot.optics.wall_light.cells import Lattice, pixels_see, square_lattice
from eyespot.optics.wall_light.pose_light import (
    BeamFrame,
    Steps,
    beam_at_wall,
    irradiance_alone,
    irradiance_and_slopes,
)

LEAST_KURTOSIS, MOST_KURTOSIS = -1.0, 2.0
"""Of a disc and of an exponential exp(-r/L)."""

_TINY = 1e-9
_VARIANCE_STEP = 1e-4  # of the blur, px²: for its numerical derivative


def blurred(
    values: Float[np.ndarray, "*k n"], variance: float, kurtosis: float = 0.0
) -> Float[np.ndarray, "*k n"]:
    """Cells after a blur that spreads from cell to cell.

    Args:
        values: of the cells of a square lattice.
        variance: of the blur along each side, in squares of a cell's side.
    """
    waves, squares = _waves(math.isqrt(values.shape[-1]))
    transfer, _ = _transfer(squares, variance, kurtosis)
    return _filtered(values, waves, transfer)


def blurred_each(
    values: Float[np.ndarray, "k n"], blurs: Sequence[tuple[float, float]]
) -> Float[np.ndarray, "k n"]:
    """As `blurred`, of lights that have a blur each: its variance and its kurtosis."""
    return np.stack([blurred(one, *blur) for one, blur in zip(values, blurs, strict=True)])


def blurred_with_growth(
    values: Float[np.ndarray, "n"], variance: float, kurtosis: float
) -> Float[np.ndarray, "3 n"]:
    """As `blurred`, followed by the growth with the variance and with the kurtosis."""
    waves, squares = _waves(math.isqrt(values.shape[-1]))
    transfer, by_kurtosis = _transfer(squares, variance, kurtosis)
    more, _ = _transfer(squares, variance + _VARIANCE_STEP, kurtosis)
    parts = transfer, (more - transfer) / _VARIANCE_STEP, by_kurtosis
    return np.stack([_filtered(values, waves, part) for part in parts])


@functools.cache
def _waves(count: int) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Waves of a square lattice beyond which the light is mirrored.

    Along a side, as columns; and the squares of their numbers, those along both sides added, in 1
    over squares of a cell's side.
    """
    numbers = np.pi * np.arange(count) / count
    waves = dct(np.eye(count), axis=0, norm="ortho").T
    return waves, np.add.outer(numbers**2, numbers**2)


def _transfer(
    squares: np.ndarray, variance: float, kurtosis: float
) -> tuple[np.ndarray, np.ndarray]:
    """The blur's transfer function of the lattice's waves, and its growth with the kurtosis."""
    gaussian = np.exp(-0.5 * variance * squares)
    if kurtosis < 0:
        length = 2.0 * np.sqrt(variance * squares)  # a disc's variance is a quarter of its radius's
        other = np.where(length > _TINY, 2.0 * j1(length) / np.maximum(length, _TINY), 1.0)
        growth = (other - gaussian) / LEAST_KURTOSIS
    else:
        other = (1.0 + variance * squares / 3.0) ** -1.5
        growth = (other - gaussian) / MOST_KURTOSIS
    return gaussian + kurtosis * growth, growth


def _filtered(values: np.ndarray, waves: np.ndarray, transfer: np.ndarray) -> np.ndarray:
    grids = values.reshape(-1, *transfer.shape)
    return (waves @ (transfer * (waves.T @ grids @ waves)) @ waves.T).reshape(values.shape)


NODES = np.linspace(-0.5, 0.5, 17)
"""Times of a sweep's points, from the exposure's middle, over the exposure. A hand trembles ten
times a second, and a dark retina may need a tenth of one."""
_SWEPT = 0.15
"""Way of the light between two of the positions that stand for a moving tip, over a cell's side. An
edge that moves on by this much leaves a cell that it cuts wrong by a few hundredths of the step at
most, and only if the cell is cut during a part of the exposure."""
_SWEPT_SLOPES = 0.5
"""The same for derivatives. Those of the middle alone would take the light's edge for a sharp one,
and the pose for too well known."""
_POSITIONS_SHARP, _POSITIONS = (3, 6, 12), (3, 6)
"""Numbers of these positions, for light with and without a sharp edge; each is compiled once."""
_LENGTHS = (0.0, 0.3, 0.47, 0.7, 1.2, 2.0)
"""Ways over a cell's side for which numbers of positions differ, for the value or its slopes."""
_USUAL_REACH_PX = 60.0
_STILL_SHARP_PX, _STILL_PX = 0.1, 0.5  # way of the light that is not averaged
_STEADY_PX = 0.01  # unless its mean place is so far from that in the middle
_SOFT = 0.13
"""Share of an error of cut pixels where an edge is two pixels wide, as that of a lens's light is at
least: edges at random places and angles, sampled by a Bayer filter."""
_LEAST_BLUR_PX2 = 0.25
"""Below it the light of a sharp edge changes as a parabola, and that of a lens in proportion."""
_VARIANCE_FACTOR = 1.2  # factor on the variance, for the second point of the finite difference
_NO_BLUR_PX2 = 0.05  # below it a lens's light may as well spread from cell to cell, in less time
_PARTS = 2
"""Parts of a cell's side, between which the light of a sharp edge spreads."""
_NARROW = 0.25
"""Variance of a blur, in squares of a part's side, from which light spreads from part to part: then
an edge reaches over two of them, and where in one it lies does not matter."""
_TOOL = BareFibre(fibre_radius=0.25, fibre_length=6.0)
"""Of most instruments the fibre is as thin or thinner."""
_SPARSE, _BESIDE_TOOL_PX = 4, 6.0
"""Pixels between those of which it is asked whether the instrument hides them, and a margin about
it: as many, and the error of a tip where a fit starts."""
_MAX_LATTICES = 24
"""Lattices that are kept; each has 400 KB, one of parts four times as much. A frame needs its own,
those of the six that are kept, and each of these as if the view had drifted."""
_WIDENING = 0.1  # a beam's radius over its length; a lens's light widens by 0.05 to 0.3


class Sweep(NamedTuple):
    """A tool's motion during an exposure, as the robot says it.

    Attributes:
        tip: place of the tip at `NODES`, relative to the exposure's middle, mm, eye frame.
        axis: its direction there, less that at the middle.
    """

    tip: Float[np.ndarray, "17 3"]
    axis: Float[np.ndarray, "17 3"]


class SeenLight(NamedTuple):
    """Irradiance of the cells per unit power, 1/mm², as a camera sees it.

    Attributes:
        value: with the motion during the exposure and the blur.
        slopes: its derivatives by the pose's changes and by the beam's own.
        bend: its derivative by the blur's variance, 1/px².
        tails: its derivative by the blur's excess kurtosis.
    """

    value: Float[np.ndarray, "n"]
    slopes: Float[np.ndarray, "5+q n"]
    bend: Float[np.ndarray, "n"]
    tails: Float[np.ndarray, "n"]
    by_motion: Float[np.ndarray, "n"]
    by_blur: Float[np.ndarray, "n"]


class BeamLight:
    """Irradiance of the wall by one beam under one microscope.

    Args:
        source: the beam's light, see `optics.wall_light.cells.CellBeam`.
        spread: turns independent numbers of variance 1 into errors of the beam's own parameters.
        sharp: whether the light ends at an edge.
        apex_mm: how far behind the tip the light begins to widen.
        within_mm: least and largest distance at which the light is known.
    """

    def __init__(
        self,
        source: Any,
        microscope: MicroscopeFile,
        spread: Float[np.ndarray, "p q"],
        *,
        sharp: bool,
        apex_mm: float = 0.0,
        within_mm: tuple[float, float] = (0.0, math.inf),
    ) -> None:
        self.source, self.spread, self.sharp = source, spread, sharp
        self.apex_mm, self.within_mm = apex_mm, within_mm
        noise = camera_noise(microscope)
        cut = noise.cut if noise else USUAL_CUT
        self.cut = cut if sharp else _SOFT * cut
        self.lattice = functools.lru_cache(maxsize=_MAX_LATTICES)(self._lattice)
        self.camera = microscope.ideal_microscope()
        self.wall = microscope.wall()
        self.scale_mm_px = microscope.scale_mm_px
        self._middle_px = 0.5 * np.array([microscope.width_px, microscope.height_px])

    @functools.cached_property
    def _sparse(self) -> tuple[np.ndarray, np.ndarray]:
        """Wall points and lines of sight of blocks of pixels, h x w x 3."""
        middle = 0.5 * (_SPARSE - 1)
        u, v = np.meshgrid(*(np.arange(middle, n + _SPARSE, _SPARSE) for n in 2 * self._middle_px))
        pixels = np.stack([u, v], axis=-1)
        point, _ = self.wall_points(pixels.reshape(-1, 2))
        return point.reshape(*u.shape, 3), np.asarray(self.camera.ray(pixels)[1])

    def hidden(self, pose: BeamFrame) -> Bool[np.ndarray, "h w"]:
        """Pixels of the image in which the instrument hides the wall, or nearly does."""
        point, sight = self._sparse
        margin = _BESIDE_TOOL_PX * self.scale_mm_px
        hides = _TOOL.hides(point, sight, tip=pose.tip, axis=pose.axis, margin=margin)
        width, height = (2.0 * self._middle_px).astype(int)
        return np.repeat(np.repeat(hides, _SPARSE, 0), _SPARSE, 1)[:height, :width]

    def wall_points(self, pixels: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
        """Wall points that pixels see, and the inward normals there, (n, 3)."""
        point, normal = pixels_see(self.camera, self.wall, np.asarray(pixels, float))
        return np.asarray(point), np.asarray(normal)

    def _lattice(self, window: CellWindow, motion: WallMotion, parts: int = 1) -> Lattice:
        """The wall that a window's cells show after a motion of the wall's picture.

        Each side of a cell may be divided into some parts.
        """
        corner, right = window.in_image(motion)
        count = parts * COUNT
        return square_lattice(
            self.camera, self.wall, corner=corner, right=right / parts, count=count
        )

    def irradiance(
        self,
        window: CellWindow,
        motion: WallMotion,
        pose: BeamFrame,
        own: Float[np.ndarray, "q"],
        *,
        sweep: Sweep | None = None,
        blur_px2: float = 0.0,
        kurtosis: float = 0.0,
    ) -> SeenLight:
        """Irradiance of the cells per unit power, 1/mm², as the camera sees it.

        Args:
            own: changes of the beam's own parameters, in the terms of `spread`.
            sweep: motion during the exposure; None for a tip at rest.
            blur_px2: variance of the image's blur along each side.
        """
        lattice = self.lattice(window, motion)
        swept_px = 0.0 if sweep is None else self.swept_px(pose, sweep)
        moved, few = None, None
        still_px = _STILL_SHARP_PX if self.sharp else _STILL_PX
        if sweep is not None and (swept_px > still_px or self._aside_px(pose, sweep) > _STEADY_PX):
            counts = _POSITIONS_SHARP if self.sharp else _POSITIONS
            moved = _steps(sweep, counts, swept_px / (_SWEPT * window.side))
            if swept_px > _SWEPT_SLOPES * window.side:
                few = _steps(sweep, _POSITIONS, swept_px / (_SWEPT_SLOPES * window.side))
        both = irradiance_and_slopes(
            lattice, self.source, pose, own=own, spread=self.spread, steps=few
        )
        value, slopes = map(np.asarray, both)
        at_rest = value if few is None else self.irradiance_alone(lattice, pose, own)
        if moved is not None:
            value = self.irradiance_alone(lattice, pose, own, moved)
        cells2 = window.side**2  # px²
        narrow = blur_px2 < _NARROW * cells2 / _PARTS**2
        if narrow and (self.sharp or blur_px2 >= _NO_BLUR_PX2):
            # Where in a cell the light is steep, only the beam knows.
            at_least = max(blur_px2, _LEAST_BLUR_PX2)
            around = moved if few is None else few
            middle = value if few is None else self.irradiance_alone(lattice, pose, own, few)

            def change(variance_px2: float) -> np.ndarray:
                places = self._aside(around, variance_px2)
                return self.irradiance_alone(lattice, pose, own, places) - middle

            all_, share = change(at_least), blur_px2 / at_least
            # A sharp edge loses less by a blur, the wider it is already.
            last = (
                (change(_VARIANCE_FACTOR * at_least) - all_) / (_VARIANCE_FACTOR - 1.0)
                if self.sharp
                else all_
            )
            straight, curved = 2.0 * all_ - last, last - all_
            seen = value + share * (straight + share * curved)
            bend = (straight + 2.0 * share * curved) / at_least
            tails = np.zeros_like(value)
        else:
            fine, parts = value, 1
            if self.sharp:
                parts, finer = _PARTS, self.lattice(window, motion, _PARTS)
                fine = self.irradiance_alone(finer, pose, own, moved)
            part2 = cells2 / parts**2
            wide = blurred_with_growth(fine, blur_px2 / part2, kurtosis)
            whole_cells = wide.reshape(3, COUNT, parts, COUNT, parts).mean(axis=(2, 4))
            seen, bend, tails = whole_cells.reshape(3, -1)
            bend = bend / part2
        slopes = blurred(slopes, blur_px2 / cells2, kurtosis)
        return SeenLight(seen, slopes, bend, tails, value - at_rest, seen - value)

    def _aside(self, moved: Steps | None, variance_px2: float) -> Steps:
        """Four places around each place of the light, which stand for a blur."""
        if moved is None:
            moved = Steps(np.zeros((1, 3)), np.zeros((1, 3)), np.ones(1))
        tips, axes, shares = map(np.asarray, moved)
        aside = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
        aside *= math.sqrt(2.0 * variance_px2) * self.scale_mm_px
        return Steps(
            tips=(tips[:, None] + aside).reshape(-1, 3),
            axes=np.repeat(axes, len(aside), axis=0),
            shares=np.repeat(shares, len(aside)) / len(aside),
        )

    def compile(self) -> None:
        """Compile what frames may need, or load it, so that none of a sequence waits for it.

        Takes 1 to 3 s where JAX has kept what it compiled.
        """
        window = CellWindow.around(self._middle_px, _USUAL_REACH_PX)
        (point,), (normal,) = self.wall_points(self._middle_px[None])
        pose = beam_at_wall(self.wall, point + normal, -normal)
        assert pose is not None, "the middle of an image shows the wall"
        for cells in _LENGTHS:
            length = cells * window.side * self.scale_mm_px
            sweep = Sweep(np.outer(length * NODES, pose.right), np.zeros((NODES.size, 3)))
            for blur_px2 in (_LEAST_BLUR_PX2, float(window.side**2)):
                self.irradiance(
                    window,
                    STILL,
                    pose,
                    np.zeros(self.spread.shape[1]),
                    sweep=sweep,
                    blur_px2=blur_px2,
                )

    def swept_px(self, pose: BeamFrame, sweep: Sweep) -> float:
        """Way of the light during an exposure, px."""
        return self._length_px(pose, np.diff(sweep.tip + pose.distance * sweep.axis, axis=0))

    def _aside_px(self, pose: BeamFrame, sweep: Sweep) -> float:
        """How far the light's mean place is from that in the middle of an exposure, px."""
        return self._length_px(pose, np.mean(sweep.tip + pose.distance * sweep.axis, axis=0)[None])

    def _length_px(self, pose: BeamFrame, steps: Float[np.ndarray, "n 3"]) -> float:
        """Way of the light along steps of the spot, px."""
        along = steps @ pose.axis
        across = np.linalg.norm(steps - along[:, None] * pose.axis, axis=1)
        return float(np.sum(across + _WIDENING * np.abs(along))) / self.scale_mm_px

    def lights(
        self,
        window: CellWindow,
        seen: Sequence[tuple[WallMotion, BeamFrame]],
        own: Float[np.ndarray, "q"],
    ) -> Float[np.ndarray, "k n"]:
        """Irradiance of the cells without motion and blur, after motions of the wall, by pose."""
        lights = [
            self.irradiance_alone(self.lattice(window, motion), pose, own) for motion, pose in seen
        ]
        return np.array(lights).reshape(-1, COUNT**2)

    def irradiance_alone(
        self,
        lattice: Lattice,
        pose: BeamFrame,
        own: Float[np.ndarray, "q"],
        steps: Steps | None = None,
    ) -> Float[np.ndarray, "n"]:
        """Irradiance of the cells without derivatives; `steps` are the places of a moving tip."""
        light = irradiance_alone(
            lattice, self.source, pose, own=own, spread=self.spread, steps=steps
        )
        return np.asarray(light)


def _steps(sweep: Sweep, counts: tuple[int, ...], needed: float) -> Steps:
    """Places for a moving beam: the least of the counts that is as large as needed, or the last."""
    nodes, shares = _gauss(next((count for count in counts if count >= needed), counts[-1]))
    tips, axes = (
        np.stack([np.interp(0.5 * nodes, NODES, line) for line in part.T], axis=-1)
        for part in sweep
    )
    return Steps(tips, axes, 0.5 * shares)


_gauss = functools.cache(np.polynomial.legendre.leggauss)
