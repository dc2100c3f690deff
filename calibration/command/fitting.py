"""A whole fit, from recordings to a report, a table and a calibration file."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import optics
from calibration.command import report as fit_report
from calibration.command.arguments import log_books, read_priors, read_rotation
from calibration.command.fitted import Choices, Fitted
from calibration.command.goodness import Doubt, doubts, refusal, verdict
from calibration.command.models import AUTO, MODELS, Model, chosen_model
from calibration.command.recording import record_fit
from calibration.pixels import NUISANCES
from calibration.recordings import LogBook, Recording, is_stack, read_recording
from calibration.solvers import correlations
from calibration.spots import Prior
from estimator.files import (
    QUANTITIES,
    Calibration,
    in_terminal,
    read_calibration,
    require_space,
    write_calibration,
    written_whole,
)
from estimator.run import progress
from estimator.viewer import check_recording_path
from optics import InputError

_PACKAGES = ("eyespot", "jax", "optimistix")
_MOST_BYTES = 2**23  # of a report with its figures

_STRONG = 0.9
"""Correlations above this are named under the table; the report lists all."""


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
    cone: Path | None = None,
    microscope: Path | None = None,
    poses: Sequence[Path] = (),
    phantoms: Sequence[str] = (),
    medium: str | None = None,
    fibre_diameter_mm: float = 0.5,
    eye_from_robot: str | None = None,
    rerun: str | None = None,
) -> None:
    """Fit a model to withdrawals and write a report, and a calibration file if the fit is good.

    Args:
        sources: stacks, spots files or bags, taken with one microscope in one medium.
        model: a name of `MODELS`, or `AUTO`.
        out: calibration file to write; must not exist. The report is written beside it, as .html.
        exposure: which exposure to use if a stack has two; by default "metered", whose peaks are
            never saturated.
        free: parameters to fit; None for the model's default.
        priors: "name=mean,sigma" for free parameters, or for `touch`, each trial's first distance.
        robust: find outliers and fit without them (models plane and sphere).
        lens: preset or file from which the model lens starts, see `optics.load_lens`.
        cone: calibration file of the cone, for the model eye.
        microscope: microscope file for sources other than stacks, see `read_microscope`.
        poses: pose files for sources other than stacks, in order; a bag may contain its own.
        phantoms: "plane" or "eyeball", one for each source other than a stack, or one for all.
        medium: name in `optics.MEDIA`, for sources other than stacks.
        fibre_diameter_mm: diameter of the tip's face, for sources other than stacks.
        eye_from_robot: "QX,QY,QZ,QW", rotation from the poses' frame to the eye frame.
        rerun: a recording of the fit, a file NAME.rrd or "live"; None for none.

    Raises:
        InputError: wrong input, an existing file or report, or a fit that is not good. In the last
            case only the report is written. A fit whose only fault is too large standard
            deviations raises nothing.
        OSError: a file cannot be written.
    """
    sources = [Path(source) for source in sources]
    report = _report_beside(out)
    if rerun is not None:
        check_recording_path(rerun)
    # Entered before the fit, so that a name that is taken or a full disk does not cost its result.
    with written_whole(out) as calibration:
        with written_whole(report) as page:
            require_space(out, _MOST_BYTES)
            given = read_priors(priors)
            choices = Choices(
                free=None if free is None else tuple(free),
                priors=given,
                loss="huber" if robust else "squares",
                exposure=exposure,
                lens=lens or "",
                cone=None if cone is None else read_calibration(cone),
            )
            if model == AUTO and lens:
                model = "lens"
            others = [source for source in sources if not is_stack(source)]
            if model != AUTO:
                _check(model, choices, sources=len(sources), others=len(others))
            rotation = read_rotation(eye_from_robot)
            books = log_books(
                others, microscope, poses, phantoms, medium, fibre_diameter_mm, rotation
            )
            recordings = [
                _read(source, books.get(source), exposure=exposure, touch=given.get("touch"))
                for source in sources
            ]
            _check_alike(recordings)
            if model == AUTO:
                model, reason = chosen_model(recordings)
                print(f"Model {model}: {reason}.", file=sys.stderr, flush=True)
                _check(model, choices, sources=len(sources), others=len(others))
            result = _Result(MODELS[model].fit(recordings, choices), recordings, model)
            Console().print(result.table())
            page.write_text(result.page(), encoding="utf-8", errors="backslashreplace")
        if not all(doubt.harmless for doubt in result.doubts):
            raise InputError(refusal(result.doubts, model=model, report=report))
        write_calibration(calibration, result.calibration())
    if rerun is not None:
        record_fit(rerun, result.fitted, recordings, result.calibration(), exposure=exposure)
    print(f"{verdict(result.doubts)}. Wrote {out} and {report}.")


@dataclass(frozen=True)
class _Result:
    """A fit, and what it was made from."""

    fitted: Fitted
    recordings: Sequence[Recording]
    model: str

    @cached_property
    def doubts(self) -> Sequence[Doubt]:
        """Why the fit is not good."""
        return doubts(
            converged=self.fitted.converged,
            failed=self.fitted.failed,
            bounds=self.fitted.bounds,
            undetermined=self.fitted.undetermined,
            chi_squared_per_degree=self.fitted.chi_squared_per_degree,
            degrees_of_freedom=self.fitted.degrees_of_freedom,
            misfit=None if self.fitted.pixels is None else self.fitted.pixels.misfit,
            residuals=self.fitted.residuals,
        )

    def table(self) -> Table:
        """What the terminal shows."""
        frames = sum(recording.frames for recording in self.recordings)
        goodness = self.fitted.chi_squared_per_degree
        title = f"{self.fitted.used} of {frames} frames, recordings: {len(self.recordings)}"
        title += "" if goodness is None else f"; χ²/n {goodness:.3g}"
        return _result_table(self.fitted, title=title)

    def page(self) -> str:
        """The report."""
        return fit_report.render(
            self.fitted,
            model=self.model,
            recordings=self.recordings,
            doubts=self.doubts,
            software=_software(),
            fingerprint=self._fingerprint,
        )

    def calibration(self) -> Calibration:
        """Content of the calibration file."""
        fitted, medium = self.fitted, self.recordings[0].medium
        names = ", ".join(recording.name for recording in self.recordings)
        return Calibration(
            model=fitted.calibration_model,
            values=fitted.values,
            covariance=fitted.covariance,
            medium=medium,
            medium_index=optics.MEDIA[medium],
            fitted_on=f"{fitted.used} {fitted.unit} of {names}",
            data_sha256=self._fingerprint,
            software=_software(),
            sigma_inflation=fitted.inflation,
        )

    @property
    def _fingerprint(self) -> str:
        checksums = json.dumps([recording.sha256 for recording in self.recordings])
        return hashlib.sha256(checksums.encode()).hexdigest()


def _software() -> str:
    return ", ".join(f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES)


def _report_beside(out: Path) -> Path:
    """The report's file."""
    report = out.with_suffix(".html")
    if report == out:
        raise InputError(f"{out}: the report uses the ending .html. End the calibration in .json.")
    return report


def _check(model: str, choices: Choices, *, sources: int, others: int) -> None:
    """Reject choices that do not fit the model, before any spot is measured."""
    chosen = MODELS[model]
    _check_names(chosen, choices)
    if choices.lens and model != "lens":
        raise InputError("--lens works with --model lens only. Leave it out.")
    if choices.cone is not None and model != "eye":
        raise InputError("--cone works with --model eye only. Leave it out.")
    if chosen.of_pixels and (others or sources != 1):
        raise InputError(
            f"--model {model} fits the pixels of one stack; got {sources} sources, of which "
            f"{others} are no stacks. Fit each stack by itself, or fit the spots of all sources "
            "together with --model cone."
        )


def _read(
    source: Path, book: LogBook | None, *, exposure: str | None, touch: Prior | None
) -> Recording:
    with progress(f"Measuring {source.name}", total=None) as advance:
        return read_recording(
            source, exposure=exposure, log_book=book, touch=touch, progress=advance
        )


def _check_names(model: Model, choices: Choices) -> None:
    for name in choices.free or ():
        if name not in model.parameters:
            raise InputError(
                f"--free accepts {', '.join(model.parameters)}; got {name!r}. Each trial's touch, "
                "spot position and axis direction are always free."
            )
    always = NUISANCES if model.of_pixels else ("touch",)
    for name in choices.priors:
        if name not in always and name not in (choices.free or model.free):
            raise InputError(f"--prior {name} does nothing while {name} is not in --free. Add it.")


def _check_alike(recordings: Sequence[Recording]) -> None:
    media = {r.medium for r in recordings}
    if len(media) > 1:
        raise InputError(
            f"these recordings were taken in {' and '.join(sorted(media))}. A calibration is valid "
            "in one medium. Fit the recordings of each medium by themselves."
        )
    first = recordings[0].microscope
    for recording in recordings[1:]:
        other = recording.microscope
        if (other.scale_mm_px, other.pinhole_height_mm, other.eye_radius_mm) != (
            first.scale_mm_px,
            first.pinhole_height_mm,
            first.eye_radius_mm,
        ):
            raise InputError(
                f"{recording.name} and {recordings[0].name} were taken with different microscopes "
                "or eyes. Fit each by itself."
            )
    planes = [r for r in recordings if r.trial.kind == "plane"]
    for plane in planes[1:]:
        if plane.tilt != planes[0].tilt:
            raise InputError(
                f"the planes of {planes[0].name} and {plane.name} are tilted differently. Fit each "
                "by itself."
            )


def _result_table(fitted: Fitted, *, title: str) -> Table:
    """A row for each parameter: value, standard deviation, unit."""
    sigma = np.sqrt(np.diag(fitted.covariance))
    table = Table(title=in_terminal(title), caption=_strong_correlations(fitted))
    for heading in ("parameter", "value", "± σ", "unit"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for i, (name, value) in enumerate(fitted.values.items()):
        table.add_row(in_terminal(name), f"{value:.6g}", _error(sigma[i]), QUANTITIES[name].unit)
    for name, value, error, unit in fitted.others:
        table.add_row(in_terminal(name), f"{value:.4g}", _error(error), unit)
    return table


def _strong_correlations(fitted: Fitted) -> str | None:
    names, rho = list(fitted.values), correlations(fitted.covariance)
    pairs = [
        f"{names[i]} and {names[j]} {rho[i, j]:+.2f}"
        for i, j in zip(*np.triu_indices(len(names), 1), strict=True)
        if abs(rho[i, j]) > _STRONG  # false for NaN, where a parameter was not fitted
    ]
    return f"Strong correlations: {', '.join(pairs)}." if pairs else None


def _error(sigma: float) -> str:
    if math.isinf(sigma):
        return "not determined"
    if sigma == 0:
        return "given"
    return "" if math.isnan(sigma) else f"{sigma:.2g}"
