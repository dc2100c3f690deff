"""A whole fit, from recordings to a report, a table and a calibration file.

It may be recorded for the viewer rerun: frames, spots, distances by fit and robot, residuals.
"""

import hashlib
import html
import importlib.metadata
import json
import math
import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from rich.markup import escape
from rich.table import Table

from eyespot import optics
from eyespot.calibration.command import report as fit_report
from eyespot.calibration.command.apart import together
from eyespot.calibration.command.choices import Choices, one_each
from eyespot.calibration.command.crossed import (
    Crossed,
    Read,
    as_stated,
    crossed,
    read_by_cone,
    read_by_lens,
)
from eyespot.calibration.command.fit_verdict import (
    MOST_CHI_SQUARED,
    Doubt,
    Fault,
    Fitted,
    doubts,
    refusal,
    verdict,
)
from eyespot.calibration.command.pixel_models import DROP, fit_image_of_cone, fit_image_of_lens
from eyespot.calibration.command.spot_models import (
    EYE,
    fit_cone_to_spots,
    fit_eye,
    fit_planes,
    fit_sphere,
)
from eyespot.calibration.pixels.data import CONE, FREE, NUISANCES, known_names
from eyespot.calibration.recorded_trial import RecordedTrial, recorded_trial
from eyespot.calibration.spots.cone_problem import PARAMETERS
from eyespot.estimator import Ranger
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.progress_bar import progress, say
from eyespot.estimator.viewer import recording_of
from eyespot.formats.calibration import BEAM, Calibration, write_calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import Spot
from eyespot.formats.whole_files import written_whole


def record_fit(target: str, fit: "Fit") -> None:
    """Record the frames of a fit, one recording after the other on the timeline `frame`."""
    fitted, recordings, calibration = fit.fitted, fit.recordings, fit.calibration
    name = ", ".join(recording.name for recording in recordings)
    touches = {row[0].removeprefix("touch of "): row[1] for row in fitted.others}
    # The residuals of spots are in the order of the recordings; a fit may have left some out.
    all_used = list(map(id, fitted.recordings)) == list(map(id, recordings))
    residuals = zip(*fitted.residuals.values(), strict=True) if all_used else iter(())
    first = 0
    with recording_of(target, name=name, microscope=recordings[0].microscope) as recorded:
        for recording in recordings:
            trial = recording.trial
            ranger = Ranger(calibration, recording.microscope)
            touch = touches.get(recording.name, trial.touch.mean)
            numbers = [record.frame for record in recording.records]
            seen = zip(recording.records, trial.readings, strict=True)
            spots = dict(zip(numbers, seen, strict=True))
            frames: Iterable[tuple[int, float, np.ndarray | None]]
            if recording.recording.spots is not None:
                frames = ((record.frame, record.time_s, None) for record in recording.records)
            else:
                source = recording.recording.source
                frames = ((frame.index, frame.time_s, frame.image) for frame in source)
            for number, time_s, image in frames:
                recorded.add_frame(first + number, time_s, image)
                if number not in spots:
                    continue
                record, reading = spots[number]
                assert isinstance(record.result, Spot)
                found = ranger.distance(record.result, axis=trial.axis, frame=image)
                recorded.add_measured(record.result, found, "")
                recorded.add_value("distance/robot", touch + float(reading))
                for kind, value in zip(fitted.residuals, next(residuals, ()), strict=False):
                    recorded.add_value(f"residuals/{kind.replace(' ', '_')}", float(value))
            first += recording.frames


_PACKAGES = ("eyespot", "jax", "optimistix")

SOFT_EDGE = 0.1
"""Edge width over semi-minor axis above which the spots' edges are soft, a camera's blur apart.

A cone's edge is as wide as the camera's blur. With a lens it is as wide as the core's image: for
caps of sag 0 to 0.12 mm and numerical apertures of 0.05 to 0.3, the upper quartile over distances
of 0.5 to 6 mm is 0.25 to 0.8."""
SHARP_EDGE = 0.05
"""As `SOFT_EDGE`; below it the edge is surely a cone's. Between the two it may also be that of a
small core behind a nearly flat end, such as 0.2 mm with a sag of 0.015 mm in air: 0.10."""


class FitModel(NamedTuple):
    """A model and its selectable parameters."""

    fit: Callable[[Sequence[RecordedTrial], Choices], Fitted]
    parameters: tuple[str, ...] = ()
    """Names that --free accepts."""
    free: tuple[str, ...] = ()
    """Default of --free."""
    of_pixels: bool = False
    """Whether it is fitted to all pixels, of one recording at a time, instead of to spots."""


MODELS = {
    "plane": FitModel(fit_planes),
    "sphere": FitModel(fit_sphere),
    "cone": FitModel(fit_cone_to_spots, PARAMETERS, CONE),
    "eye": FitModel(lambda trials, given: fit_eye(trials, given, given.known), EYE, EYE),
    "image": FitModel(fit_image_of_cone, known_names("cone"), FREE["cone"], of_pixels=True),
    "lens": FitModel(fit_image_of_lens, known_names("lens"), FREE["lens"], of_pixels=True),
}
"""Models by their names on the command line."""


def chosen_model(recordings: Sequence[RecordedTrial]) -> tuple[str, str]:
    """A lens if the spots' edges are soft, a cone if they are sharp; and the reason.

    Uses measured spots only. Uses the upper quartile of the edge widths, because a lens also makes
    a sharp edge at the distance where it images its core.

    Raises:
        InputError: the spots need a lens, but there are no images.
    """
    width = _edge_width(recordings)
    if math.isnan(width):
        return ("cone", "the spots' edges were not measured")
    seen = (
        f"the spots' edges are {{}}: {width:.2f} of the radius wide beside the camera's blur (a "
        f"cone's: at most {SOFT_EDGE})"
    )
    if width <= SOFT_EDGE:
        return ("cone", seen.format("sharp"))
    if any(one.recording.spots is not None for one in recordings):
        raise InputError(
            f"{seen.format('soft')}, so the light comes from a lens.\n"
            "A lens is fitted to pixels: give recordings with their images. To fit a cone instead, "
            "add --model cone."
        )
    return ("lens", seen.format("soft"))


def _edge_width(recordings: Sequence[RecordedTrial]) -> float:
    """Upper quartile of the edges' widths over the spots' radii; NaN if not all were measured.

    Without the camera's blur, which is as wide in all frames of a recording: at most as the
    narrowest edge. Where the spots do not grow, a lens's edge may be so, too.
    """
    shares = []
    for recording in recordings:
        spots = [one.result for one in recording.records if isinstance(one.result, Spot)]
        width, radius = np.array([(spot.edge_width_px, spot.semi_minor_px) for spot in spots]).T
        grows = np.quantile(radius, 0.75) > _GROWN_RATIO * radius.min()
        blur = min((1.0 + _WIDTH_ERROR) * float(width.min()), _MOST_BLUR_PX) if grows else 0.0
        shares.append(np.sqrt(np.maximum(width**2 - blur**2, 0.0)) / radius)
    return float(np.quantile(np.concatenate(shares), 0.75))


_MOST_BLUR_PX = 5.0
"""Standard deviation of the blur of a camera that is far out of focus. Far from the wall, a lens's
edge may be as wide in all frames, too: that of the default scene by 12 px of 640."""
_GROWN_RATIO, _WIDTH_ERROR = 1.35, 0.2
"""Upper quartile of the radii over the smallest from which spots grow, and relative error of an
edge's width, on walls of 10 % texture. With them an edge that grows with the spot as a lens's does,
0.25 of the radius, is soft, whatever part of it is taken for a blur:
0.25 sqrt(1 - (1.2/1.35)^2) = 0.11."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A fitted model with its covariance, and what speaks against it.

    Attributes:
        model: that was fitted, by its name on the command line.
        doubts: reasons why it may be wrong; empty for a good fit.
        crossed: the recordings fitted apart; None for one, or where they were not.
    """

    model: str
    fitted: Fitted
    recordings: Sequence[RecordedTrial]
    doubts: Sequence[Doubt]
    crossed: Crossed | None = None

    def __repr__(self) -> str:
        return f"{self.verdict}\n{self.parameters}"

    def _repr_html_(self) -> str:
        """Verdict and parameters, for notebooks."""
        return f"<p>{html.escape(self.verdict)}</p>{self.parameters.to_html()}"

    @property
    def good(self) -> bool:
        """Whether the values are right within their standard errors, and so may be saved."""
        return all(doubt.fault.harmless for doubt in self.doubts)

    @property
    def verdict(self) -> str:
        """What the fit is worth, in a sentence; if it is not good, what to try."""
        if not self.good:
            return refusal(self.doubts, model=self.model)
        said = verdict(self.doubts)
        return f"{said}; {self.crossed.verdict}" if self.crossed else said

    @property
    def parameters(self) -> pd.DataFrame:
        """Value, standard deviation and unit of each parameter."""
        columns = ["parameter", "value", "sigma", "unit"]
        return pd.DataFrame(self.fitted.rows, columns=columns).set_index("parameter")

    @property
    def covariance(self) -> pd.DataFrame:
        """Of the calibration's parameters, in products of their units."""
        names = list(self.fitted.values)
        return pd.DataFrame(self.fitted.covariance, names, names)

    @property
    def calibration(self) -> Calibration:
        """The calibration, with which spots become distances."""
        return calibration_of(self.fitted, self.recordings)

    @property
    def summary(self) -> dict[str, Any]:
        """Verdict and parameters for JSON; null for what is not determined."""
        parameters = json.loads(self.parameters.to_json(orient="index", double_precision=15))
        about = {"model": self.model, "good": self.good, "verdict": self.verdict}
        return {**about, "parameters": parameters}

    @property
    def residuals(self) -> pd.DataFrame:
        """Of each spot, or of each frame the mean over its pixels, over standard deviations."""
        used, tables = self.fitted.recordings, []
        for part in self.fitted.parts or [self.fitted]:
            if pixels := part.pixels:
                of_frames = {"frame": pixels.frames, "mean of the pixels": pixels.of_frames}
                tables.append(pd.DataFrame({"recording": part.recordings[0].name} | of_frames))
        if tables:
            return pd.concat(tables, ignore_index=True)
        named = {
            "recording": np.repeat([r.name for r in used], [r.trial.readings.size for r in used])
        }
        return pd.DataFrame(named | dict(self.fitted.residuals))

    def plot(self) -> Figure:
        """The residuals over their standard deviations."""
        return fit_report.residuals_figure(self.fitted)

    def save(self, path: Path | str, *, overwrite: bool = False) -> None:
        """Write the calibration file for `track`.

        Raises:
            InputError: the fit is not good, or the file exists.
        """
        if not self.good:
            raise InputError(self.verdict)
        with written_whole(Path(path), replace=overwrite) as partial:
            write_calibration(partial, self.calibration)

    def page(self) -> str:
        """The report as an HTML page."""
        return fit_report.render(**vars(self), **_origin(self.recordings))


def calibration_of(fitted: Fitted, recordings: Sequence[RecordedTrial]) -> Calibration:
    """The calibration of a fit, whether it is good or not."""
    names = ", ".join(recording.name for recording in recordings)
    medium = recordings[0].medium
    return Calibration.of(
        model=fitted.calibration_model,
        values=fitted.values,
        covariance=fitted.covariance,
        medium=medium,
        medium_index=optics.MEDIA[medium],
        fitted_on=f"{fitted.used} {fitted.unit} of {names}",
        sigma_inflation=fitted.inflation,
        microscope=fitted.microscope,
        stated=fitted.stated,
        **_origin(recordings),
    )


def _origin(recordings: Sequence[RecordedTrial]) -> dict[str, Any]:
    checksums = json.dumps([recording.sha256 for recording in recordings])
    packages = [f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES]
    return {
        "data_sha256": hashlib.sha256(checksums.encode()).hexdigest(),
        "software": ", ".join(packages),
    }


def opened_recordings(
    sources: Sequence[Any],
    choices: Choices,
    *,
    rig: Any = None,
    poses: Any = None,
) -> list[Recording]:
    """Open the recordings of a fit, each with its rig and its poses.

    Args:
        sources: as `Recording.open` takes them.
        rig: a rig or its file, one for all or one each; None: those of the choices.
        poses: the robot's, likewise.

    Raises:
        InputError: wrong files, or another number of them than of sources.
    """
    rigs = rig if isinstance(rig, list | tuple) else choices.rig if rig is None else [rig]
    tracks = (
        poses if isinstance(poses, list | tuple) else choices.poses if poses is None else [poses]
    )
    each = zip(
        sources,
        one_each("--rig", rigs, len(sources)),
        one_each("--poses", tracks, len(sources)),
        strict=True,
    )
    return [
        Recording.open(
            source,
            rig=own,
            changes=choices.changes,
            poses=track,
            exposure=choices.exposure,
            fps=choices.fps,
        ).without_repeats()
        for source, own, track in each
    ]


def fit_recordings(sources: Sequence[Recording], choices: Choices) -> Fit:
    """Fit a model to recordings of withdrawals.

    Raises:
        InputError: wrong input; a fit that is not good is no error.
    """
    of_lens = choices.lens or (choices.known and choices.known.model == "lens")
    model: str = "lens" if choices.model == "auto" and of_lens else choices.model
    without_images = sum(source.spots is not None for source in sources)
    if model != "auto":
        _check(model, choices, sources=len(sources), without_images=without_images)
    recordings = _trials(sources, choices)
    if model == "auto":
        model, reason = chosen_model(recordings)
        say(f"Model {model}: {reason}.")
        _check(model, choices, sources=len(sources), without_images=without_images)
    fit = _fit(model, recordings, choices)
    first, *more = recordings
    has_pixels = first.recording.spots is None
    one_cone = (choices.model, model, choices.free) == ("auto", "cone", None) and not more
    if fit.good or not one_cone or not has_pixels or any(first.tilt):
        return fit
    of_pixels = "lens" if _edge_width(recordings) > SHARP_EDGE else "image"
    if of_pixels == "image" and any(doubt.fault is Fault.DISAGREEMENT for doubt in fit.doubts):
        return fit  # the rig is not as its file says, whatever is fitted
    say(f"The spots are {fit.verdict.splitlines()[0]} Trying model {of_pixels}, of all pixels.")
    try:
        other = _fit(of_pixels, recordings, choices)
    except InputError as error:  # the verdict on the spots stands
        say(str(error))
        return fit
    return other if other.good else fit


def _fit(model: str, recordings: list[RecordedTrial], choices: Choices) -> Fit:
    for recording in recordings:
        seen = recording.microscope
        beyond = seen.viewing_path is not None or seen.retina_semi_axes_mm is not None
        if beyond and MODELS[model].parameters and model != "eye":
            raise InputError(
                f"{recording.name} shows a wall through a viewing lens, or one that is no sphere; "
                f"--model {model} sees planes and spheres through a pinhole. Fit a recording of a "
                "phantom; `track` then looks through what the microscope file describes."
            )

    def fit(some: Sequence[RecordedTrial]) -> Fitted:
        return MODELS[model].fit(some, choices)

    apart: Sequence[Fitted] = ()
    if MODELS[model].of_pixels and len(recordings) > 1:
        apart = [fit([one]) for one in recordings]
    fitted = together(apart) if apart else fit(recordings)
    if model == "cone":
        fitted = without_foreign(fitted, fit)
        recordings = list(fitted.recordings)
    if choices.known and model != "eye":
        for name, value, sigma, unit in fitted.rows:
            # The beam's angles from the tool are new after each mounting, so they are no prior.
            known = name in choices.known.values and name not in BEAM
            if known and (before := choices.known.sigma(name)) > 0:
                was = choices.known.values[name]
                change = (
                    f"{name} moved by {(value - was) / before:+.1f} σ, from {was:.6g} ± "
                    f"{before:.2g} to {value:.6g} ± {sigma:.2g} {unit}."
                )
                fitted.notes.append(change)
                say(change)
    found, others = doubts(fitted), None
    if model == "cone" and len(recordings) > 1 and choices.known is None:
        apart = [fit([as_stated(one)]) for one in recordings]
    if apart:
        others = crossed(apart, _read_by_lens if model == "lens" else read_by_cone)
        if others is not None and not others.agree:
            found.insert(0, Doubt(Fault.DISAGREEMENT, others.verdict))
    return Fit(model=model, fitted=fitted, recordings=recordings, doubts=found, crossed=others)


def _read_by_lens(own: Fitted, other: Fitted) -> Read:
    return read_by_lens(own, calibration_of(other, other.recordings))


_MOST_FOREIGN, _FOREIGN = 3, 10.0
"""Spots that may be left out, and how far the size of each must be from a parabola through those of
the others, in their root mean square deviations."""
_FEWEST_ALIKE = 6


def without_foreign(fitted: Fitted, fit: Callable[[Sequence[RecordedTrial]], Fitted]) -> Fitted:
    """The fit without single spots that do not belong to the others, which its notes name.

    Such as a frame of another recording. Only where the fit is bad with them and good without.
    """
    found = fitted
    named: list[str] = []
    while not _explained(found) and len(named) < _MOST_FOREIGN:
        some = [*found.recordings]
        far, spot, number = max((*_farthest(one), number) for number, one in enumerate(some))
        if far < _FOREIGN:
            return fitted
        one = some[number]
        named.append(f"frame {one.records[spot].frame} of {one.name}")
        some[number] = one.only(np.delete(np.arange(one.trial.readings.size), spot))
        found = fit(some)
    if not named or not _explained(found):
        return fitted
    said = f"Left out, because they do not belong to the other spots: {', '.join(named)}."
    found.notes.append(said)
    say(said)
    return found


def _explained(fitted: Fitted) -> bool:
    return fitted.converged and (fitted.chi_squared_per_degree or 0.0) <= MOST_CHI_SQUARED


def _farthest(one: RecordedTrial) -> tuple[float, int]:
    """How far the spot is whose size deviates most from those of the others, and its number."""
    readings, sizes = one.trial.readings, np.asarray(one.trial.ellipses.semi_minor)
    if sizes.size <= _FEWEST_ALIKE:
        return 0.0, 0
    far = []
    for spot in range(sizes.size):
        x, y = np.delete(readings, spot), np.delete(sizes, spot)
        curve = np.polynomial.Polynomial.fit(x, y, 2)
        spread = math.sqrt(np.mean((y - curve(x)) ** 2))
        far.append(abs(sizes[spot] - curve(readings[spot])) / max(spread, 1e-9))
    return float(max(far)), int(np.argmax(far))


def _check(model: str, choices: Choices, *, sources: int, without_images: int) -> None:
    """Reject choices that do not fit the model, before any spot is measured."""
    chosen = MODELS[model]
    for name in choices.names:
        if not chosen.parameters:
            raise InputError(
                f"--model {model} has no selectable parameter {name}; --model cone has "
                f"{', '.join(PARAMETERS)}."
            )
        if name not in chosen.parameters:
            raise InputError(
                f"--free accepts {', '.join(chosen.parameters)}; got {name!r}. Each trial's touch, "
                "spot position and axis direction are always free."
            )
    always = NUISANCES if chosen.of_pixels else ("touch",)
    of_drop = DROP if model == "lens" and not (choices.lens or choices.known) else ()
    for name in choices.priors:
        if name not in (*always, *(choices.names or (*chosen.free, *of_drop))):
            raise InputError(f"--prior {name} does nothing while {name} is not in --free. Add it.")
    for name in {"half_angle", "b"} & {*chosen.free} - {*(choices.names or chosen.free)}:
        raise InputError(f"--free must contain half_angle and b; {name} is missing. Add it.")
    if choices.robust and chosen.parameters:
        raise InputError("--robust works with the models plane and sphere only. Leave it out.")
    if choices.lens and model != "lens":
        raise InputError("--lens works with --model lens only. Leave it out.")
    if choices.known and (choices.lens or not chosen.parameters):
        raise InputError(
            "--calibration does not work with --lens, nor with the models plane and sphere. "
            "Leave it out."
        )
    if chosen.of_pixels and without_images:
        raise InputError(
            f"--model {model} fits pixels; got {sources} sources, of which {without_images} have "
            "no images. Leave those out, or fit the spots of all sources with --model cone."
        )
    if chosen.of_pixels and choices.known and sources > 1:
        raise InputError(
            "--calibration counts once, and pixels are fitted in one recording at a time; got "
            f"{sources} recordings. Fit one with it, and the next with the result."
        )


def _trials(sources: Sequence[Recording], choices: Choices) -> list[RecordedTrial]:
    """Measure the spots, and refuse recordings that cannot be fitted together."""
    touch, recordings = choices.priors.get("touch"), []
    for source in sources:
        with progress(f"Measuring {source.name}", total=None) as advance:
            recordings.append(recorded_trial(source, touch=touch, progress=advance))
    media = {recording.medium for recording in recordings}
    if len(media) > 1:
        raise InputError(
            f"these recordings were taken in {' and '.join(sorted(media))}. A calibration is valid "
            "in one medium. Fit the recordings of each medium by themselves."
        )
    first = recordings[0]
    eye = operator.attrgetter("scale_mm_px", "pinhole_height_mm", "eye_radius_mm")
    for recording in recordings:
        if eye(recording.microscope) != eye(first.microscope):
            raise InputError(
                f"{recording.name} and {first.name} were taken with different microscopes or "
                "eyes. Fit each by itself."
            )
    planes = [recording for recording in recordings if recording.trial.kind == "plane"]
    for plane in planes:
        if plane.tilt != planes[0].tilt:
            raise InputError(
                f"the planes of {planes[0].name} and {plane.name} are tilted differently. Fit each "
                "by itself."
            )
    return recordings


def table_of(fitted: Fitted, recordings: Sequence[RecordedTrial]) -> Table:
    """What the terminal shows: value, standard deviation and unit of each parameter."""
    frames = sum(recording.frames for recording in recordings)
    goodness = fitted.chi_squared_per_degree
    title = f"{fitted.used} of {frames} frames, recordings: {len(recordings)}"
    title += "" if goodness is None else f"; χ²/n {goodness:.3g}"
    strong = fitted.strong_correlations
    caption = f"Strong correlations: {strong}." if strong else None
    table = Table(title=escape(title), caption=caption)
    for heading in ("parameter", "value", "± σ", "unit"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for name, value, error, unit in fitted.rows:
        digits = 6 if name in fitted.values else 4
        sigma = "given" if error == 0 else fit_report.rounded(error, 2)
        table.add_row(escape(name), f"{value:.{digits}g}", sigma, unit)
    return table
