"""A fit from start to end: recordings in; a report, a table and a calibration file out."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table

import optics
from calibration.command import report as fit_report
from calibration.command.fitted import Choices, Fitted
from calibration.command.goodness import doubts
from calibration.command.models import MODELS, Model
from calibration.pixels import NUISANCES
from calibration.recordings import LogBook, Recording, read_recording
from calibration.solvers import correlations
from calibration.spots import Prior
from estimator.files import (
    QUANTITIES,
    Calibration,
    Quaternion,
    unit_quaternion,
    write_calibration,
    written_whole,
)

_PACKAGES = ("eyespot", "jax", "optimistix")
_T = TypeVar("_T")


def run(
    sources: Sequence[Path],
    *,
    model: str,
    out: Path,
    exposure: str | None = None,
    free: Sequence[str] | None = None,
    priors: Sequence[str] = (),
    robust: bool = False,
    lens: str | None = None,
    microscope: Path | None = None,
    poses: Sequence[Path] = (),
    phantoms: Sequence[str] = (),
    medium: str | None = None,
    fibre_diameter_mm: float = 0.5,
    eye_from_robot: str | None = None,
) -> None:
    """Fit a model to withdrawals, write a report, and if the fit is good a calibration file.

    Args:
        sources: stacks, spots files, bags: of one microscope and one medium.
        model: of `MODELS`: "plane", delta k and b of the planes (Zhou et al. 2020, eq. 7);
            "sphere", c of an eyeball beside them; "cone", the exact geometry on both together;
            "image" and "lens", a cone or a glue lens behind all pixels of one stack.
        out: the calibration file; must not exist. The report stands beside it, as .html.
        exposure: of stacks with several.
        free: what the fit finds, of the model's parameters.
        priors: "name=mean,sigma" of free parameters, or of `touch`, each trial's first distance.
        robust: Huber's loss for each trial of the paper's fits; outliers are named and left out.
        lens: that the model lens starts from, see `optics.load_lens`.
        microscope: of what is no stack, see `read_microscope`.
        poses: of each source that is no stack, in order; a bag may hold its own.
        phantoms: "plane" or "eyeball", one for each source that is no stack or one for all.
        medium: of what is no stack, of `optics.MEDIA`.
        fibre_diameter_mm: of what is no stack.
        eye_from_robot: "QX,QY,QZ,QW" turns the poses of what is no stack into the eye's frame.

    Raises:
        ValueError: bad input, or a fit that is not good: nothing but the report is written then,
            unless the only doubt is that the errors are too large.
    """
    if out.exists():
        raise ValueError(f"{out} exists already. Choose another name; nothing is written over.")
    if not out.parent.is_dir():
        raise ValueError(f"{out.parent} is no folder. Make it, or write {out.name} elsewhere.")
    report = out.with_suffix(".html")
    if report == out:
        raise ValueError(f"{out}: .html is the report's. Name the calibration .json.")
    given = _priors(priors)
    choices = Choices(
        free=None if free is None else tuple(free),
        priors=given,
        loss="huber" if robust else "squares",
        exposure=exposure,
        lens=lens or "",
    )
    chosen = MODELS[model]
    _check_names(chosen, choices)
    if (lens is not None) != (model == "lens"):
        raise ValueError(
            "--lens and --model lens go together: the fit starts from a lens that is 30 % off or "
            f"less. Give a preset ({', '.join(optics.lens_names())}) or a lens file; other models "
            "know no lens."
        )
    others = [Path(s) for s in sources if not (Path(s) / "stack.toml").is_file()]
    if chosen.of_pixels and (others or len(sources) != 1):
        raise ValueError(
            f"--model {model} fits the pixels of one stack; got {len(sources)} sources, "
            f"{len(others)} of them no stack. Fit each stack by itself; --model cone takes the "
            "spots of all together."
        )
    books = _log_books(
        others, microscope, poses, phantoms, medium, fibre_diameter_mm, _turn(eye_from_robot)
    )
    console = Console(stderr=True)
    with console.status("Measuring spots"):
        recordings = [
            read_recording(
                Path(source),
                exposure=exposure if Path(source) not in others else None,
                log_book=books.get(Path(source)),
                touch=given.get("touch"),
            )
            for source in sources
        ]
    _check_alike(recordings)
    frames = sum(recording.frames for recording in recordings)
    with console.status("Fitting"):
        fitted = chosen.fit(recordings, choices)
    wrong = doubts(
        converged=fitted.converged,
        bounds=fitted.bounds,
        undetermined=fitted.undetermined,
        chi_squared_per_degree=fitted.chi_squared_per_degree,
        residuals=fitted.residuals,
    )
    fingerprint = hashlib.sha256(json.dumps([r.sha256 for r in recordings]).encode()).hexdigest()
    software = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES)
    with written_whole(report) as partial:
        partial.write_text(
            fit_report.render(
                fitted,
                model=model,
                recordings=recordings,
                doubts=wrong,
                software=software,
                fingerprint=fingerprint,
            ),
            encoding="utf-8",
        )
    goodness = fitted.chi_squared_per_degree
    title = f"{fitted.used} of {frames} frames in {len(recordings)} recordings"
    title += "" if goodness is None else f"; χ²/n {goodness:.2f}"
    Console().print(_table(fitted, title=title))
    reasons = "; ".join(doubt.reason for doubt in wrong)
    if not all(doubt.harmless for doubt in wrong):
        raise ValueError(
            f"not a good fit: {reasons}. No calibration was written; {report} shows the residuals."
        )
    used = recordings[0].medium
    write_calibration(
        out,
        Calibration(
            model=fitted.calibration_model,
            values=fitted.values,
            covariance=fitted.covariance,
            medium=used,
            medium_index=optics.MEDIA[used],
            fitted_on=f"{fitted.used} {fitted.unit} of {', '.join(r.name for r in recordings)}",
            data_sha256=fingerprint,
            software=software,
        ),
    )
    verdict = f"Not called a good fit: {reasons}" if wrong else "A good fit"
    print(f"{verdict}. Wrote {out} and {report}.")


def _priors(given: Iterable[str]) -> dict[str, Prior]:
    found = {}
    for text in given:
        name, _, numbers = text.partition("=")
        try:
            mean, sigma = map(float, numbers.split(","))
        except ValueError:
            mean = sigma = math.nan
        if not (math.isfinite(mean) and 0 < sigma < math.inf):
            raise ValueError(
                f"--prior must be NAME=MEAN,SIGMA with a positive sigma, such as "
                f"eye_radius=11.5,0.2; got {text!r}."
            )
        found[name] = Prior(mean, sigma)
    return found


def _check_names(model: Model, choices: Choices) -> None:
    for name in choices.free or ():
        if name not in model.parameters:
            raise ValueError(
                f"--free knows {', '.join(model.parameters)}; got {name!r}. Touches, places and "
                "leans of the axis are always free."
            )
    always = NUISANCES if model.of_pixels else ("touch",)
    for name in choices.priors:
        if name not in always and name not in (choices.free or model.free):
            raise ValueError(f"--prior {name} does nothing while {name} is not in --free. Add it.")


def _turn(text: str | None) -> Quaternion:
    if text is None:
        return (0.0, 0.0, 0.0, 1.0)
    try:
        x, y, z, w = map(float, text.split(","))
        return unit_quaternion((x, y, z, w))
    except ValueError:
        raise ValueError(
            f"--eye-from-robot must be a unit quaternion QX,QY,QZ,QW; got {text!r}."
        ) from None


def _log_books(
    sources: Sequence[Path],
    microscope: Path | None,
    poses: Sequence[Path],
    phantoms: Sequence[str],
    medium: str | None,
    fibre_diameter_mm: float,
    eye_from_robot: Quaternion,
) -> dict[Path, LogBook]:
    """What is said of the sources that are no stacks."""
    if not sources:
        for option, said in (
            ("--microscope", microscope),
            ("--poses", poses),
            ("--phantom", phantoms),
            ("--medium", medium),
        ):
            if said:
                raise ValueError(f"{option} does nothing: a stack has its own. Leave it out.")
        return {}
    if microscope is None or medium is None or not phantoms:
        raise ValueError(
            f"{sources[0]} is no stack, which would tell what a fit needs. Give --microscope, "
            "--phantom and --medium, and --poses unless it is a bag."
        )
    if medium not in optics.MEDIA:
        raise ValueError(f"--medium must be one of {', '.join(optics.MEDIA)}; got {medium!r}.")
    kinds = _one_each("--phantom", phantoms, sources)
    # A bag of images holds the poses of the same minutes.
    tracks = _one_each("--poses", poses, sources) if poses else list(sources)
    return {
        source: LogBook(
            kind=kind,
            medium=medium,
            fibre_diameter_mm=fibre_diameter_mm,
            microscope=microscope,
            poses=track,
            eye_from_robot=eye_from_robot,
        )
        for source, kind, track in zip(sources, kinds, tracks, strict=True)
    }


def _one_each(option: str, given: Sequence[_T], sources: Sequence[Path]) -> Sequence[_T]:
    if len(given) == 1:
        return [*given] * len(sources)
    if len(given) != len(sources):
        raise ValueError(
            f"{option} must be given once, or once for each of the {len(sources)} sources that are "
            f"no stacks; got {len(given)}."
        )
    return given


def _check_alike(recordings: Sequence[Recording]) -> None:
    media = {r.medium for r in recordings}
    if len(media) > 1:
        raise ValueError(
            f"these recordings were taken in {' and '.join(sorted(media))}. A calibration holds in "
            "one medium; fit each by itself."
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
    planes = [r for r in recordings if r.trial.kind == "plane"]
    for plane in planes[1:]:
        if plane.tilt != planes[0].tilt:
            raise ValueError(
                f"the planes of {planes[0].name} and {plane.name} are tilted differently. Fit each "
                "by itself."
            )


def _table(fitted: Fitted, *, title: str) -> Table:
    table = Table(title=title)
    sigma, together = np.sqrt(np.diag(fitted.covariance)), correlations(fitted.covariance)
    # What was given, and not fitted, is correlated with nothing.
    found = np.flatnonzero(sigma > 0)
    names = list(fitted.values)
    for heading in ("parameter", "value", "± σ", "unit", *(f"ρ {names[i]}" for i in found)):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for i, (name, value) in enumerate(fitted.values.items()):
        cells = ["" if math.isnan(rho) else f"{rho:+.2f}" for rho in together[i, found]]
        table.add_row(name, f"{value:.6g}", _error(sigma[i]), QUANTITIES[name].unit, *cells)
    for name, value, error, unit in fitted.others:
        table.add_row(name, f"{value:.4g}", _error(error), unit)
    return table


def _error(sigma: float) -> str:
    if math.isinf(sigma):
        return "not determined"
    if sigma == 0:
        return "given"
    return "" if math.isnan(sigma) else f"{sigma:.2g}"
