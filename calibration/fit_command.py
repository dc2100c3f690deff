"""The command `eyespot fit`: stacks in, a table and a calibration file out."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import optics
from calibration._cone_fit import ConeFit, fit_cone
from calibration._paper_fits import PlaneFit, fit_plane
from calibration.recordings import Recording, read_recording
from estimator.calibration_file import Calibration, write_calibration
from estimator.model_parameters import QUANTITIES

_CHI_SQUARED = (0.8, 1.25)
"""Per degree of freedom: outside, the noise model or the geometry is not that of the data."""


def run(
    sources: Sequence[Path], *, model: str, out: Path, exposure: str | None, free: Sequence[str]
) -> None:
    """Fit a model to stacks and write a calibration file.

    Args:
        sources: stacks of one microscope and one medium.
        model: "plane", delta k and b of the planes (Zhou et al. 2020, eq. 7); or "cone", the exact
            geometry on planes and eyeballs together.
        out: the calibration file; must not exist.
        exposure: of stacks with several.
        free: what the cone fit leaves free, of half_angle, b, scale, eye_radius.

    Raises:
        ValueError: bad input, or data that do not determine what is asked for.
    """
    if out.exists():
        raise ValueError(f"{out} exists already. Choose another name; nothing is written over.")
    console = Console(stderr=True)
    with console.status("Measuring spots"):
        recordings = [read_recording(Path(source), exposure=exposure) for source in sources]
    _check_alike(recordings)
    with console.status("Fitting"):
        if model == "plane":
            values, covariance, doubts = _plane(recordings)
        else:
            values, covariance, doubts = _cone(recordings, tuple(free))
    spots = sum(r.trial.readings.size for r in recordings)
    medium = recordings[0].medium
    write_calibration(
        out,
        Calibration(
            model="planar" if model == "plane" else "exact",
            values=values,
            covariance=covariance,
            medium=medium,
            medium_index=optics.MEDIA[medium],
            fitted_on=f"{spots} spots of {', '.join(r.name for r in recordings)}",
            data_sha256=hashlib.sha256(
                json.dumps([r.sha256 for r in recordings]).encode()
            ).hexdigest(),
            software=f"eyespot {importlib.metadata.version('eyespot')}",
        ),
    )
    Console().print(_table(values, covariance, recordings))
    for doubt in doubts:
        print(f"Not a good fit: {doubt}")
    print(f"Wrote {out}.")


def _plane(recordings: Sequence[Recording]) -> tuple[dict[str, float], np.ndarray, list[str]]:
    planes = [r for r in recordings if r.trial.kind == "plane"]
    if not planes:
        raise ValueError("the model plane needs a stack of a plane; all of these are eyeballs.")
    fit = _line(planes)
    scale = planes[0].microscope.scale_mm_px
    own = np.array([fit.delta_k_error / scale, fit.b_error])
    covariance = np.outer(own, own) * np.array([[1.0, fit.correlation], [fit.correlation, 1.0]])
    doubts = [] if fit.converged else ["the solver did not converge."]
    return {"k": fit.delta_k / scale, "b": fit.b}, covariance, doubts


def _cone(
    recordings: Sequence[Recording], free: tuple[str, ...]
) -> tuple[dict[str, float], np.ndarray, list[str]]:
    fit = fit_cone(
        [r.trial for r in recordings],
        recordings[0].microscope.ideal_microscope(),
        start=_start(recordings),
        free=free,
    )
    if fit.undetermined:
        raise ValueError(f"these stacks do not determine {'; '.join(fit.undetermined)}.")
    order = ("half_angle", "b", *(name for name in free if name not in ("half_angle", "b")))
    values = {name: fit.values[name] for name in order}
    covariance = np.zeros((len(order), len(order)))
    for i, row in enumerate(fit.free):
        for j, column in enumerate(fit.free):
            covariance[order.index(row), order.index(column)] = fit.covariance[i, j]
    return values, covariance, _doubts(fit)


def _start(recordings: Sequence[Recording]) -> dict[str, float]:
    """The planar model through all spots, near enough for the exact one to find its way."""
    fit = _line(recordings)
    return {"half_angle": math.atan(recordings[0].microscope.scale_mm_px / fit.delta_k), "b": fit.b}


def _line(recordings: Sequence[Recording]) -> PlaneFit:
    """The paper's line through the spots of all stacks."""
    return fit_plane(
        semi_minor_px=np.concatenate([np.asarray(r.trial.ellipses.semi_minor) for r in recordings]),
        distance=np.concatenate([r.trial.readings for r in recordings]),
    )


def _doubts(fit: ConeFit) -> list[str]:
    low, high = _CHI_SQUARED
    per_degree = fit.chi_squared / fit.degrees_of_freedom
    doubts = [] if fit.converged else ["the solver did not converge."]
    if not low <= per_degree <= high:
        doubts.append(
            f"chi squared per degree of freedom is {per_degree:.2f}, not within {low} and {high}: "
            "the standard errors stand for the noise that the estimator reports, not for this."
        )
    return doubts


def _check_alike(recordings: Sequence[Recording]) -> None:
    media = {r.medium for r in recordings}
    if len(media) > 1:
        raise ValueError(
            f"these stacks were taken in {' and '.join(sorted(media))}. A calibration holds in one "
            "medium; fit each by itself."
        )
    first = recordings[0].microscope
    for recording in recordings[1:]:
        other = recording.microscope
        if (other.scale_mm_px, other.pinhole_height_mm, other.eye_radius_mm) != (
            first.scale_mm_px,
            first.pinhole_height_mm,
            first.eye_radius_mm,
        ):
            raise ValueError(
                f"{recording.name} was taken with another microscope or eye than "
                f"{recordings[0].name}. Fit each by itself."
            )


def _table(
    values: dict[str, float], covariance: np.ndarray, recordings: Sequence[Recording]
) -> Table:
    spots = sum(r.trial.readings.size for r in recordings)
    frames = sum(r.frames for r in recordings)
    table = Table(title=f"{spots} of {frames} frames in {len(recordings)} stacks")
    for heading in ("parameter", "value", "± σ", "unit", *(f"ρ {name}" for name in values)):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    sigma = np.sqrt(np.diag(covariance))
    for i, (name, value) in enumerate(values.items()):
        correlations = [
            f"{covariance[i, j] / (sigma[i] * sigma[j]):+.2f}" if sigma[i] * sigma[j] else ""
            for j in range(len(values))
        ]
        error = f"{sigma[i]:.2g}" if sigma[i] else "given"
        table.add_row(name, f"{value:.6g}", error, QUANTITIES[name].unit, *correlations)
    return table
