"""The space of geometries: scrambled Sobol points, every model's error there, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

import optics
from benchmarks.evaluation import ModelError
from benchmarks.studies.eccentricity import chain
from benchmarks.studies.eccentricity.chain import Eye

AXES = {
    "c_mm": (0.0, 8.0),
    "d_mm": (0.5, 6.0),
    "r_mm": (10.5, 12.5),
    "incidence_deg": (0.0, 45.0),
    "azimuth_deg": (0.0, 360.0),
    "half_angle_deg": (2.0, 8.0),
}
"""What is varied continuously, and its range; columns of model_error.csv."""

PINHOLES = ("centre", "sphere", "200", "inf")
"""z_F: the eyeball's centre (0), on the sphere (r), 200 mm, telecentric."""

BLOCK = 1 << 14
"""Geometries at a time; a Sobol sequence is balanced over powers of two."""

_BATCH = 512

_FIRST_NUMBER = ModelError._fields.index("c_mm")


class Block(NamedTuple):
    """Geometries and the errors there; arrays of n.

    Attributes:
        axes: by the names of `AXES`.
        pinhole: number of the pinhole in `PINHOLES`.
        z_f_mm: its height.
        apex_offset_mm: b; the spot at contact keeps the scene's size whatever the cone's angle.
        estimates: by model, mm.
    """

    axes: dict[str, np.ndarray]
    pinhole: np.ndarray
    z_f_mm: np.ndarray
    apex_offset_mm: np.ndarray
    estimates: dict[str, np.ndarray]

    def error(self, model: str) -> np.ndarray:
        """Estimate - truth, mm."""
        return self.estimates[model] - self.axes["d_mm"]


def blocks(*, count: int, seed: int, scale: float, contact_radius: float) -> Iterator[Block]:
    """Geometries that fill the space evenly, with the estimates of all models.

    Args:
        count: of geometries, rounded up to whole blocks.
        seed: of the scrambling.
        scale: delta, mm/px.
        contact_radius: -b/k, mm.
    """
    engine = qmc.Sobol(d=len(AXES) + 1, scramble=True, rng=np.random.default_rng(seed))
    low, high = np.array(list(AXES.values())).T
    size = min(BLOCK, 1 << (count - 1).bit_length())
    for _ in range(-(-count // size)):
        unit = engine.random(size)
        axes = dict(zip(AXES, (low + (high - low) * unit[:, :-1]).T, strict=True))
        pinhole = np.minimum(unit[:, -1] * len(PINHOLES), len(PINHOLES) - 1).astype(int)
        r = axes["r_mm"]
        z_f = np.choose(pinhole, [0.0 * r, r, 0.0 * r + 200.0, 0.0 * r + np.inf])
        half_angle = np.radians(axes["half_angle_deg"])
        b = -contact_radius / np.tan(half_angle)
        columns = {
            "scale": np.full(size, scale),
            "inverse_working_distance": 1.0 / (z_f + r),
            "radius": r,
            "half_angle": half_angle,
            "apex_offset": b,
            "incidence": np.radians(axes["incidence_deg"]),
            "incidence_azimuth": np.radians(axes["azimuth_deg"]),
            "eccentricity": axes["c_mm"],
        }
        eye = Eye(**{name: jnp.asarray(values) for name, values in columns.items()})
        estimates = _estimates(eye, jnp.asarray(axes["d_mm"]))
        yield Block(axes, pinhole, z_f, b, {m: np.asarray(estimates[m]) for m in optics.MODELS})


def csv_line(row: ModelError) -> str:
    """A row of model_error.csv, in the digits of `csv_text`."""
    head, shared, (estimate, error) = row[:_FIRST_NUMBER], row[_FIRST_NUMBER:-2], row[-2:]
    place = ",".join(f"{value:.6g}" for value in shared)
    return f"{','.join(map(str, head))},{place},{estimate:.6f},{error:.6f}\n"


def csv_text(block: Block, *, medium: str) -> str:
    """The block's lines of model_error.csv.

    Numbers are written once a geometry, not once a model, which is most of what a million take.
    """
    axes = {**block.axes, "z_f_mm": block.z_f_mm, "apex_offset_mm": block.apex_offset_mm}
    between = ModelError._fields[_FIRST_NUMBER:-2]
    columns = [axes[name].tolist() for name in between]
    row = ",".join(["%.6g"] * len(between))
    shared = [row % values for values in zip(*columns, strict=True)]
    lines = []
    for model, estimate in block.estimates.items():
        head = f"{model},analytic,False,{medium},"
        both = zip(shared, estimate.tolist(), block.error(model).tolist(), strict=True)
        lines += [f"{head}{place},{value:.6f},{error:.6f}\n" for place, value, error in both]
    return "".join(lines)


class Spread(NamedTuple):
    """Row of space.csv: the size of a model's error in one bin of one axis, over all others."""

    model: str
    pinhole: str
    axis: str
    from_value: float
    to_value: float
    geometries: int
    median_mm: float
    percentile_95_mm: float


class Sensitivity(NamedTuple):
    """Row of sensitivity.csv: part of a model's error variance that one axis alone explains.

    The first-order Sobol index (Sobol 1993), in [0, 1]; what is missing to 1 over the axes is due
    to axes together.
    """

    model: str
    pinhole: str
    axis: str
    first_order: float


class Space:
    """Errors of all models over the space, gathered block by block."""

    def __init__(self) -> None:
        self._axes: dict[str, list[np.ndarray]] = {axis: [] for axis in AXES}
        self._errors: dict[str, list[np.ndarray]] = {model: [] for model in optics.MODELS}
        self._pinhole: list[np.ndarray] = []

    def add(self, block: Block) -> None:
        """Keep a block's axes and errors, in single precision."""
        for axis, values in block.axes.items():
            self._axes[axis].append(values.astype(np.float32))
        for model in optics.MODELS:
            self._errors[model].append(block.error(model).astype(np.float32))
        self._pinhole.append(block.pinhole.astype(np.int8))

    @property
    def count(self) -> int:
        """Number of geometries."""
        return sum(map(len, self._pinhole))

    def errors(self, model: str, pinhole: str) -> np.ndarray:
        """A model's errors with one pinhole, mm."""
        return np.concatenate(self._errors[model])[self._seen_by(pinhole)]

    def spreads(self, *, bins: int = 16) -> list[Spread]:
        """Size of the errors along every axis."""
        return [
            Spread(
                model=model,
                pinhole=pinhole,
                axis=axis,
                from_value=low + (high - low) * n / bins,
                to_value=low + (high - low) * (n + 1) / bins,
                geometries=size.size,
                median_mm=float(np.median(size)),
                percentile_95_mm=float(np.percentile(size, 95)),
            )
            for model in optics.MODELS
            for pinhole in PINHOLES
            for axis, (low, high) in AXES.items()
            for n, size in enumerate(self._binned(model, pinhole, axis, bins))
        ]

    def sensitivities(self) -> list[Sensitivity]:
        """What every axis alone explains of the errors' variance; not of `exact`'s rounding."""
        return [
            Sensitivity(model, pinhole, axis, self._explained(model, pinhole, axis))
            for model in optics.MODELS
            if model != "exact"
            for pinhole in PINHOLES
            for axis in AXES
        ]

    def _seen_by(self, pinhole: str) -> np.ndarray:
        return np.concatenate(self._pinhole) == PINHOLES.index(pinhole)

    def _binned(self, model: str, pinhole: str, axis: str, bins: int) -> list[np.ndarray]:
        """Absolute errors in equal bins of an axis."""
        low, high = AXES[axis]
        place = np.concatenate(self._axes[axis])[self._seen_by(pinhole)]
        number = np.clip((place - low) / (high - low) * bins, 0, bins - 1).astype(int)
        size = np.abs(self.errors(model, pinhole))
        return [size[number == n] for n in range(bins)]

    def _explained(self, model: str, pinhole: str, axis: str, *, bins: int = 32) -> float:
        """Variance of the mean error in bins of equal counts, over the whole variance."""
        place = np.concatenate(self._axes[axis])[self._seen_by(pinhole)]
        error = self.errors(model, pinhole).astype(float)
        means = [part.mean() for part in np.array_split(error[np.argsort(place)], bins)]
        return float(np.var(means) / np.var(error))


@jax.jit
def _estimates(eye: Eye, d: jax.Array) -> dict[str, jax.Array]:
    def of(spot: tuple[Eye, jax.Array]) -> dict[str, jax.Array]:
        eye, d = spot
        seen = chain.semi_minor(eye, d)
        # With every link real it has a closed form, which spares half of the time.
        stereographic = optics.stereographic_distance(
            semi_minor_px=seen,
            scale=eye.scale,
            k=optics.slope(eye.half_angle),
            b=eye.apex_offset,
            eccentricity=eye.eccentricity,
            eye_radius=eye.radius,
        )
        exact = chain.inverse(eye, seen)
        closed = chain.closed_forms(eye, seen)
        return {**closed, "stereographic": stereographic, "exact": exact}

    return jax.lax.map(of, (eye, d), batch_size=_BATCH)
