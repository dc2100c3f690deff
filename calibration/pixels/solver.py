"""The fit to all pixels: its start, the model on all chunks, and steps from blurred to sharp.

Levenberg-Marquardt minimises the sum over pixels of ((light - model)/sigma)^2. The Jacobian over 40
frames would take 24 GB, but only J^T J and J^T r are needed. These are sums over pixels, computed
in chunks by forward mode, on all cores. Optimistix needs the residuals themselves, so it cannot be
used here.

The cone's edge is sharp. If the start deviates by 30 %, no pixel's derivative shows the edge. So
the first fits blur frames and model alike, by a quarter of the spot's radius and then by less.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import optics
from calibration.pixels.chunks import Chunk, Problem, Sums, linearised, look, poses, sums, values_at
from calibration.pixels.data import Footage
from calibration.pixels.image_fit import Criterion, Failure, ImageFit
from calibration.pixels.lens_light import NEAREST_MM, LensLight
from calibration.pixels.misfit import Pixels, found_misfit
from calibration.pixels.parameters import DEFAULTS, NUISANCES, possible
from calibration.pixels.selection import bright_spot, chosen_chunks
from calibration.pixels.squares import chunked, residual_frames
from calibration.solvers import Minimum, NormalEquations, covariance_and_lost, minimise
from calibration.spots import Prior, phantom_wall
from optics import InputError
from optics.wall_light import LensTable

_TOUCH_SIGMA_MM = 0.02


def fit_problem(
    footage: Footage,
    start: Mapping[str, float],
    free: tuple[str, ...],
    priors: Mapping[str, Prior],
    *,
    place: Float[np.ndarray, "2"],
    lean_sigma: float,
    boresight_sigma: float,
) -> tuple[Problem, dict[str, Prior]]:
    """The problem and its priors, given ones included.

    Args:
        footage: the frames.
        start: start values of free parameters, and values of others.
        free: names of the free parameters; the nuisances are free too.
        priors: priors that replace or add to those of the nuisances.
        place: centre of the spot, px.
        lean_sigma: standard deviation of the robot's directions, rad.
        boresight_sigma: standard deviation of the beam's angle from the tool's axis, rad.
    """
    file = footage.microscope
    microscope = optics.microscope(
        scale=file.scale_mm_px,
        pinhole_height=file.pinhole_height_mm,
        eye_radius=file.eye_radius_mm,
        principal_point=file.principal_point_px,
        distortion=tuple(file.distortion),
    )
    surface = phantom_wall(footage.kind, eye_radius=file.eye_radius_mm)
    normal = surface.intersect(*microscope.ray(place)).normal
    # The rim of a tilted tip touches the wall before the centre does.
    touch = optics.contact_distance(
        surface,
        incidence=jnp.arccos(-normal @ footage.axis),
        rim_radius=footage.instrument.fibre_radius,
    )
    lean, boresight = Prior(0.0, lean_sigma), Prior(0.0, boresight_sigma)
    every = {
        "touch": Prior(float(touch), _TOUCH_SIGMA_MM),
        "lean": lean,
        "lean_sideways": lean,
        "boresight": boresight,
        "boresight_sideways": boresight,
        **priors,
    }
    known = dict.fromkeys(NUISANCES, 0.0) | DEFAULTS
    known |= {"scale": file.scale_mm_px, "eye_radius": file.eye_radius_mm}
    known |= {"u": float(place[0]), "v": float(place[1])}
    known |= {name: prior.mean for name, prior in every.items()} | dict(start)
    names = (*free, *(name for name in NUISANCES if name not in free))
    problem = Problem(
        first=jnp.array([known[name] for name in names]),
        size=jnp.array([_size(name, known[name], every) for name in names]),
        fixed={name: jnp.asarray(v, float) for name, v in known.items() if name not in names},
        microscope=microscope,
        motion=jnp.asarray(footage.motion),
        axis=jnp.asarray(footage.axis),
        blur=None,
        names=names,
        kind=footage.kind,
    )
    return problem, every


def _size(name: str, value: float, priors: Mapping[str, Prior]) -> float:
    """Scale of a parameter; with it, the damping affects all parameters equally."""
    if name in priors:
        return priors[name].sigma
    own = {"u": 1.0, "v": 1.0, "illumination": 0.01}
    return own.get(name) or abs(value) or 1.0


class Place(NamedTuple):
    """Where the model is evaluated.

    Attributes:
        problem: the fit.
        table: light of the lens, computed near `x`; None for a cone.
        x: the parameters, without exposures.
        over: relative excess of each frame's exposure over the reported one.
        exposures: whether exposures are parameters too.
    """

    problem: Problem
    table: LensTable | None
    x: Float[Array, "p"]
    over: Float[np.ndarray, "frames"]
    exposures: bool


def parts_at(place: Place, chunks: Sequence[Chunk]) -> list[Sums]:
    """The sums of every chunk."""

    def part(chunk: Chunk) -> Sums:
        over = place.over[int(chunk.frame)]
        return jax.block_until_ready(sums(place.problem, place.table, place.x, over, chunk))

    with ThreadPoolExecutor() as pool:
        # The first chunk runs alone, so that only one thread compiles.
        return [part(chunks[0]), *pool.map(part, chunks[1:])]


def pixels_at(place: Place, chunks: Sequence[Chunk]) -> Iterator[Pixels]:
    """The pixels of every frame with their residuals and derivatives, in the chunks' order."""
    p, frames = place.x.size, len(place.over)

    def of_frame(own: list[Chunk]) -> Pixels:
        frame, parts = int(own[0].frame), []
        for chunk in own:
            view = look(place.problem, place.table, place.x, chunk)
            off, derivatives = linearised(
                place.problem, place.table, place.x, place.over[frame], chunk
            )
            columns = (*chunk.pixels.T, view.direct, view.light, chunk.weight, off)
            rows = [*columns, *np.asarray(derivatives)[: p + place.exposures]]
            parts.append(np.array(rows)[:, chunk.weight > 0])
        u, v, direct, light, weight, residual, *slope = np.concatenate(parts, axis=1)
        slopes = np.zeros((p + frames * place.exposures, u.size))
        slopes[:p] = slope[:p]
        if place.exposures:
            slopes[p + frame] = slope[p]
        return Pixels(frame, u, v, direct, light, weight, residual, slopes)

    by_frame = [list(own) for _, own in itertools.groupby(chunks, lambda c: int(c.frame))]
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        # No more frames than cores at a time, because the derivatives of all pixels take gigabytes.
        for first in range(0, len(by_frame), cores):
            yield from pool.map(of_frame, by_frame[first : first + cores])


def compile_model(place: Place, chunk: Chunk) -> None:
    """Compile what a fit evaluates for places and chunks of these shapes."""
    look(place.problem, place.table, place.x, chunk)
    parts_at(place, [chunk])


_BLURS = (1 / 4, 1 / 12, 1 / 36)
"""Blurs of the first fits, relative to the spot's radius; the last fits have no blur."""
_ROUNDS = 2
"""Rounds of the fit to all pixels. Each selects pixels and computes noise from the last result."""
_SOME = 24
"""Frames of a lens's first rounds, evenly over the withdrawal; the last round has all of them."""
_NEAREST_MM = {"cone": 0.03, "lens": NEAREST_MM}
"""Least distance from the tip's plane. Nearer, the rim touches or the lens's table is invalid."""
_MOST_OF_TABLE = 10.0
"""Largest difference of two tables' results, in standard errors. The covariance contains it, but a
larger one is not only noise."""
_PROGRESS = 0.25
"""Part of a step's expected gain in chi squared, its squared length in standard errors, that shows
that the step is due to the data and not to a table's errors."""
_MOST_TABLES = 12
_EXACT = 1e-6
"""Sigma of the constraint that fitted exposures equal the reported ones on average."""
_SETTLED = {"cone": 1e-3, "lens": 0.04}
"""A fit ends if a step would lower chi squared by less. The root is the step in standard errors:
0.03, or 0.2 for a lens, whose table is computed with errors."""
_NEAR = 1.0
"""Step, in standard errors, after which a lens's table is as good as one computed at its end: what
the table leaves out is of second order in a step far smaller than the lens."""
_COARSELY = {"cone": 0.1, "lens": 1.0}
"""The same for the first fits."""
_SAME = 0.15
"""Relative difference from an earlier fit's lens below which the first fits have found it again.
They end within 10 % of their last fits; the second minima that were seen are 30 % apart or more."""
_HOPELESS = 0.04
"""Part of the light, RMS, that a lens may miss after the first round: no later step mends a wall
that is not even. Chi squared would depend on how bright the frames are."""


class Solver:
    """A running fit. Parameters x are in units of their size, followed by the frames' exposures."""

    def __init__(
        self,
        footage: Footage,
        source: Literal["cone", "lens"],
        start: Mapping[str, float],
        free: tuple[str, ...],
        priors: Mapping[str, Prior],
        exposures: bool,
        lean_sigma: float,
        boresight_sigma: float,
        progress: Callable[[float], None],
    ) -> None:
        self.footage, self.source, self.exposures = footage, source, exposures
        self.progress = progress
        self.of_table: np.ndarray | None = None
        place, self.radius_px = bright_spot(footage)
        self.problem, self.priors = fit_problem(
            footage,
            start,
            free,
            priors,
            place=place,
            lean_sigma=lean_sigma,
            boresight_sigma=boresight_sigma,
        )
        self.names = self.problem.names
        self.frames = len(footage.readings)
        self.lens = LensLight(footage, self.names) if source == "lens" else None

    def run(self, known: ImageFit | None = None) -> ImageFit | None:
        """Fit blurred frames first, then all pixels.

        Args:
            known: an earlier fit from another start. If the first fits come near its lens, they are
                on their way to the same minimum; if they miss much of the light, they lead nowhere.
                The result is then None.
        """
        x = np.zeros(len(self.names) + self.frames * self.exposures)
        if self.source == "cone":
            coarse = [part * self.radius_px for part in _BLURS]
            strides = [max(1, round(blur / 2)) for blur in coarse]
        else:
            coarse = [0.0]
            # Squares of a quarter of the spot's radius, as the first blur of a cone.
            strides = [2 ** int(np.clip(math.log2(_BLURS[0] * self.radius_px), 0, 4))]
        self._start(x)
        self._choose(x, blur=coarse[0], stride=strides[0], frames=self._some)
        x = self._bright_enough(x)
        for blur, stride in zip(coarse, strides, strict=True):
            self._choose(x, blur=blur, stride=stride, frames=self._some)
            found = minimise(self._tabulated_sums, x, tolerance=_COARSELY[self.source])
            x = found.x
        if known is not None and (self._is_near(x, known) or self._missed(found) > _HOPELESS):
            return None
        self._tabulate(x)
        for _ in range(_ROUNDS - 1):
            self._choose(x, frames=self._some)
            found = minimise(self._tabulated_sums, x, tolerance=_COARSELY[self.source])
            x = found.x
            misfit = self._missed(found)
            if self.source == "lens" and misfit > _HOPELESS:
                why = (
                    f"after the first round the lens misses {100 * misfit:.2g} % of the light; "
                    f"{100 * _HOPELESS:g} % are allowed"
                )
                return self._result(found, Failure(Criterion.FIRST_ROUND, why))
            if self._from_table(found) >= _NEAR:
                self._tabulate(x)
        self._choose(x)
        return self._result(*self._settled(x))

    @property
    def _pixels(self) -> int:
        return sum(int(np.count_nonzero(chunk.weight > 0)) for chunk in self.chunks)

    def _settled(self, x: np.ndarray) -> tuple[Minimum, Failure | None]:
        """Iterate until a lens's table is exact at the minimum; say why if it never is.

        Within a minimisation the table is linear in the lens's parameters. Each new table corrects
        the terms of second order, and brings new errors of its quadrature, which finds or misses
        arcs. If a step is not half as long as the one before, and chi squared has not fallen as a
        step of this length lowers it, these errors are what remains. Their effect on the parameters
        is then known from the steps, and becomes part of the covariance.
        """
        steps: list[np.ndarray] = []
        costs: list[float] = []
        while True:
            found = minimise(self._sums, x, tolerance=_SETTLED[self.source])
            if not found.converged:
                why = (
                    f"after {found.steps} steps another one would lower chi squared by "
                    f"{found.gain:.2g}; {_SETTLED[self.source]:g} is allowed"
                )
                return found, Failure(Criterion.STEPS, why)
            steps.append(found.x - x)
            costs.append(found.at.cost)
            x = found.x
            if self._from_table(found) < _NEAR:
                return found, None
            lengths = [self._in_sigmas(step, found) for step in steps[-2:]]
            slow = len(steps) > 2 and lengths[1] > lengths[0] / 2
            if slow and costs[-2] - costs[-1] > _PROGRESS * lengths[1] ** 2:
                slow = len(steps) >= _MOST_TABLES
            if slow:
                last = np.stack(steps[-2:])
                self.of_table = last.T @ last / 2
                if max(lengths) < _MOST_OF_TABLE:
                    return found, None
                why = (
                    f"the last two tables of the lens's light differ by {max(lengths):.1f} "
                    f"standard errors of the result; {_MOST_OF_TABLE:g} are allowed"
                )
                return found, Failure(Criterion.TABLES, why)
            self._tabulate(x)

    def _missed(self, found: Minimum) -> float:
        """Part of the light, RMS, that a fit to the chosen pixels misses."""
        signal = sum(float(np.sum((c.light * c.weight) ** 2)) for c in self.chunks)
        return math.sqrt(max(found.at.cost - self._pixels, 0.0) / signal)

    def _is_near(self, x: np.ndarray, known: ImageFit) -> bool:
        """Whether the lens is that of another fit, but for the error of the first fits."""
        values = self._values(x)
        free = self.lens.free if self.lens else ()
        return all(abs(values[n] - known.values[n]) < _SAME * abs(known.values[n]) for n in free)

    def _from_table(self, found: Minimum) -> float:
        """Distance of the lens from that of the last table, in standard errors; 0 for a cone."""
        if self.lens is None or not self.lens.free:
            return 0.0
        own = [self.names.index(name) for name in self.lens.free]
        step = self.lens.moved(self._values(found.x)) / np.asarray(self.problem.size)[own]
        covariance = np.linalg.pinv(found.at.information, rcond=1e-12)[np.ix_(own, own)]
        return float(np.sqrt(step @ np.linalg.pinv(covariance) @ step))

    def _in_sigmas(self, step: np.ndarray, found: Minimum) -> float:
        return float(np.sqrt(step @ found.at.information @ step))

    @property
    def _some(self) -> list[int]:
        """Frames of the first rounds."""
        # The fit of a cone is fast. An exposure needs its frame.
        count = self.frames if self.lens is None or self.exposures else min(self.frames, _SOME)
        even = np.linspace(0, self.frames - 1, count).round().astype(int)
        return [int(frame) for frame in even]

    def _start(self, x: np.ndarray) -> None:
        """Compute the first table of a lens, and compile the image model meanwhile."""
        if self.lens is None:
            return
        place, one = self._place(x, self.lens.blank(self._values(x))), np.ones(1)
        (chunk,) = chunked(self.footage, 0, np.zeros((1, 2)), one, one, one)
        with ThreadPoolExecutor(1) as other:
            compiled = other.submit(compile_model, place, chunk)
            self._tabulate(x, coarse=True)
            compiled.result()

    def _choose(
        self,
        x: np.ndarray,
        *,
        blur: float | None = None,
        stride: int = 1,
        frames: Sequence[int] | None = None,
    ) -> None:
        """Select pixels of frames for the current parameters; without a blur, all pixels."""
        self.problem = eqx.tree_at(
            lambda problem: problem.blur,
            self.problem,
            jnp.asarray(blur) if blur else None,
            is_leaf=lambda leaf: leaf is None,
        )
        self.chunks = chosen_chunks(
            self.footage,
            self.problem,
            self.table,
            jnp.asarray(x[: len(self.names)]),
            frames=range(self.frames) if frames is None else frames,
            coarse=blur is not None,
            stride=stride,
            nearest=_NEAREST_MM[self.source],
        )
        if self._pixels <= x.size:
            raise InputError(
                f"{self._pixels} pixels or squares of pixels are usable; a fit of {x.size} "
                f"parameters needs more. The others are black, saturated, hidden, or nearer than "
                f"{_NEAREST_MM[self.source]} mm to the tip. Change the exposure or withdraw "
                "farther."
            )

    def _bright_enough(self, x: np.ndarray) -> np.ndarray:
        """Set sensitivity and illumination by linear least squares, with all else fixed."""
        own = [self.names.index(name) for name in ("sensitivity", "illumination")]
        first, size = np.array(self.problem.first), np.array(self.problem.size)
        columns = []
        for illumination in (0.0, 1.0):
            at = x[: len(self.names)].copy()
            at[own] = (np.array([1.0, illumination]) - first[own]) / size[own]
            views = [look(self.problem, self.table, jnp.asarray(at), c) for c in self.chunks]
            columns.append(np.concatenate([np.asarray(view.light) for view in views]))
        source, both = columns
        weight = np.concatenate([chunk.weight for chunk in self.chunks])
        light = np.concatenate([chunk.light for chunk in self.chunks])
        basis = np.stack([source, both - source], axis=1) * weight[:, None]
        sensitivity, product = np.linalg.lstsq(basis, light * weight, rcond=None)[0]
        if not sensitivity > 0:
            raise InputError("the spot is not near its place in the start values. Check these.")
        first[own] = sensitivity, max(product / sensitivity, 0.0)
        size[own[0]] = sensitivity
        self.problem = eqx.tree_at(
            lambda problem: (problem.first, problem.size),
            self.problem,
            (jnp.asarray(first), jnp.asarray(size)),
        )
        return x

    def _values(self, x: np.ndarray) -> dict[str, float]:
        values = values_at(self.problem, jnp.asarray(x[: len(self.names)]))
        return {name: float(value) for name, value in values.items()}

    @property
    def table(self) -> LensTable | None:
        """The lens's light at the current table's parameters; None for a cone."""
        return None if self.lens is None else self.lens.table

    def _tabulate(self, x: np.ndarray, *, coarse: bool = False) -> None:
        """Compute the lens's light anew at x."""
        if self.lens is not None:
            self.lens.tabulate(self._values(x), coarse=coarse)

    def _tabulated_sums(self, x: np.ndarray) -> NormalEquations:
        """`_sums` with a new table at x if the lens is too far from the last one's."""
        values = self._values(x)
        if self.lens is not None and possible(values):
            self.lens.follow(values)
        return self._sums(x)

    def _sums(self, x: np.ndarray) -> NormalEquations:
        """Normal equations, summed over all chunks and priors."""
        p = len(self.names)
        gradient, information = np.zeros(x.size), np.zeros((x.size, x.size))
        values = self._values(x)
        if not possible(values):
            return NormalEquations(np.inf, gradient, information)
        cost = 0.0
        own = np.arange(p)
        parts = parts_at(self._place(x, self.table), self.chunks)
        for chunk, part in zip(self.chunks, parts, strict=True):
            at = np.append(own, p + int(chunk.frame)) if self.exposures else own
            cost += float(part.cost)
            gradient[at] += np.asarray(part.gradient)[: at.size]
            information[np.ix_(at, at)] += np.asarray(part.information)[: at.size, : at.size]
        size = np.asarray(self.problem.size)
        for name, prior in self.priors.items():
            if name in self.names:
                i = self.names.index(name)
                off, slope = (values[name] - prior.mean) / prior.sigma, size[i] / prior.sigma
                cost += off**2
                gradient[i] += slope * off
                information[i, i] += slope**2
        if self.exposures:
            # Exposures are right on average; without this, only exposure x sensitivity is known.
            share = np.zeros(x.size)
            share[p:] = 1.0 / (_EXACT * self.frames)
            cost += float(share @ x) ** 2
            gradient += share * (share @ x)
            information += np.outer(share, share)
        self.progress(cost)
        return NormalEquations(cost, gradient, information)

    def _place(self, x: np.ndarray, table: LensTable | None) -> Place:
        """Where the model is evaluated, with a lens's table."""
        p = len(self.names)
        over = x[p:] if self.exposures else np.zeros(self.frames)
        return Place(self.problem, table, jnp.asarray(x[:p]), over, self.exposures)

    def _result(self, found: Minimum, failed: Failure | None = None) -> ImageFit:
        exposures = [f"exposure of frame {frame}" for frame in range(self.frames)]
        names = (*self.names, *exposures[: self.frames * self.exposures])
        over = dict(zip(names[len(self.names) :], 1.0 + found.x[len(self.names) :], strict=True))
        every = self._values(found.x) | over
        covariance, lost = covariance_and_lost(
            found.at.information, names, [every[name] for name in names]
        )
        held = sum(name in self.names for name in self.priors) + self.exposures
        degrees = self._pixels + held - len(names)
        offs: list[np.ndarray] = []

        def noted() -> Iterator[Pixels]:
            for own in pixels_at(self._place(found.x, self.table), self.chunks):
                offs.append(own.residual)
                yield own

        misfit, covariance = found_misfit(
            noted(),
            covariance,
            chi_squared=found.at.cost,
            degrees_of_freedom=degrees,
        )
        inflation = 1.0
        if self.of_table is not None:
            inflation = _inflation(self.of_table, covariance)
            covariance = covariance + self.of_table
        size = np.append(np.asarray(self.problem.size), np.ones(len(over)))
        covariance = covariance * np.outer(size, size)
        errors = np.sqrt(np.diag(covariance)).tolist()
        shape = self.footage.light.shape
        residuals, sides = residual_frames(shape, self.chunks, np.concatenate(offs))
        tips, axis = poses(self.problem, every, self.footage.readings)
        return ImageFit(
            parameters={n: (every[n], error) for n, error in zip(names, errors, strict=True)},
            values=every,
            covariance=covariance,
            chi_squared=found.at.cost,
            degrees_of_freedom=degrees,
            misfit=misfit,
            tips=tips,
            axis=axis,
            undetermined=lost,
            failed=failed,
            residuals=residuals,
            numerical_inflation=inflation,
            sides=sides,
        )


def _inflation(added: np.ndarray, covariance: np.ndarray) -> float:
    """Largest factor by which an added covariance enlarges a standard error."""
    known = np.isfinite(np.diag(covariance))
    return float(np.sqrt(1 + np.max(np.diag(added)[known] / np.diag(covariance)[known])))
