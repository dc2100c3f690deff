"""The space of geometries: scrambled Sobol points, every model's error there, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.stats import qmc

import optics
from benchmarks.evaluation import MODEL_ERROR
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

_FIRST_NUMBER = MODEL_ERROR.index("c_mm")


class Block(NamedTuple):
    """Geometries and the errors there; arrays of n.

    Attributes:
        axes: by the names of `AXES`.
        pinhole: number of the pinhole in `PINHOLES`.
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


def csv_line(row: tuple[Any, ...]) -> str:
    """A row of model_error.csv, in the digits of `csv_text`."""
    head, shared, (estimate, error) = row[:_FIRST_NUMBER], row[_FIRST_NUMBER:-2], row[-2:]
    place = ",".join(f"{value:.6g}" for value in shared)
    return f"{','.join(map(str, head))},{place},{estimate:.6f},{error:.6f}\n"


def csv_text(block: Block, *, medium: str) -> str:
    """The block's lines of model_error.csv.

    Numbers are formatted once per geometry, not once per model, which saves most of the time.
    """
    axes = {**block.axes, "z_f_mm": block.z_f_mm, "apex_offset_mm": block.apex_offset_mm}
    between = MODEL_ERROR[_FIRST_NUMBER:-2]
    columns = [axes[name].tolist() for name in between]
    row = ",".join(["%.6g"] * len(between))
    shared = [row % values for values in zip(*columns, strict=True)]
    lines = []
    for model, estimate in block.estimates.items():
        head = f"{model},analytic,False,{medium},"
        both = zip(shared, estimate.tolist(), block.error(model).tolist(), strict=True)
        lines += [f"{head}{place},{value:.6f},{error:.6f}\n" for place, value, error in both]
    return "".join(lines)


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

    def within(self, limit: float) -> dict[str, float]:
        """Part of the geometries in which each model's error is within a limit (mm)."""
        return {
            model: float(np.mean(np.abs(np.concatenate(errors)) <= limit))
            for model, errors in self._errors.items()
        }

    def errors(self, model: str, pinhole: str) -> np.ndarray:
        """A model's errors with one pinhole, mm."""
        return np.concatenate(self._errors[model])[self._seen_by(pinhole)]

    def spreads(self, *, bins: int = 16) -> pd.DataFrame:
        """Content of space.csv: the size of the errors in each bin of an axis, over all others."""
        rows = [
            (
                *(model, pinhole, axis, low + (high - low) * n / bins),
                *(low + (high - low) * (n + 1) / bins, size.size),
                *(float(np.median(size)), float(np.percentile(size, 95))),
            )
            for model in optics.MODELS
            for pinhole in PINHOLES
            for axis, (low, high) in AXES.items()
            for n, size in enumerate(self._binned(model, pinhole, axis, bins))
        ]
        columns = "model pinhole axis from_value to_value geometries median_mm percentile_95_mm"
        return pd.DataFrame(rows, columns=columns.split())

    def sensitivities(self) -> pd.DataFrame:
        """Content of sensitivity.csv: the part of the variance that an axis alone explains.

        The first-order Sobol index (Sobol 1993), in [0, 1]; the axes' sum is short of 1 by the part
        of axes together. `exact` has no error.
        """
        rows = [
            (model, pinhole, axis, self._explained(model, pinhole, axis))
            for model in optics.MODELS
            if model != "exact"
            for pinhole in PINHOLES
            for axis in AXES
        ]
        return pd.DataFrame(rows, columns=["model", "pinhole", "axis", "first_order"])

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
        # With every link real there is a closed form, which saves half of the time.
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
