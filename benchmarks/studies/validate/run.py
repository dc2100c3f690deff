"""The main job: the paper's static experiment on rendered images, and its model against the truth.

DIR/run.json         what was asked for; a folder with another run.json is refused
    stacks/…         labelled image stacks, one a trial
    spots/…          what each way of measuring found in them
    *.csv, figures/  the numbers and pictures of the report
    summary.json     what was found
    report.html      the same, for people
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

import scenes
from benchmarks.evaluation import (
    PINHOLE_HEIGHTS_MM,
    WAYS,
    Geometry,
    ModelError,
    Tracked,
    Trial,
    grid_trials,
    model_error,
    paper_trials,
    track_stack,
)
from benchmarks.reporting import run_folder
from calibration import PlaneFit, SphereFit, fit_eccentricity, fit_plane
from estimator import Stack
from scenes.world import World

_RUN_SCHEMA = 1
_ALL_PLANES = "all planes"
_ANALYTIC_HEIGHTS_MM = (*PINHOLE_HEIGHTS_MM, 100.0)
_RANGE_LIMITS_MM = (3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0)
_READING_SLACK_MM = 1e-6  # readings are sums of steps
_FEWEST_SPOTS = 6  # fewer say nothing of a line and its scatter
SUBPIXEL = WAYS[-1].name


@dataclass(frozen=True, kw_only=True)
class Findings:
    """Everything that the report is made of.

    Attributes:
        settings: what was asked for (run.json).
        trials: all trials in order.
        tracked: by (trial name, way of measuring).
        plane_fits: by (source, way), then by "plane 1" … and "all planes".
        range_fits: by (source, way): (limit, fit of all planes up to that reading in mm); a lens is
            no cone, so what the fit says depends on how far the trial went.
        sphere_fits: by (source, way), then by "sphere 1" …
        analytic: model errors on exact contours.
        rendered: model errors on measured spots of the ideal cone.
        seconds: wall time of this run by step.
    """

    settings: dict[str, object]
    trials: list[Trial]
    tracked: dict[tuple[str, str], Tracked]
    plane_fits: dict[tuple[str, str], dict[str, PlaneFit]] = field(default_factory=dict)
    range_fits: dict[tuple[str, str], list[tuple[float, PlaneFit]]] = field(default_factory=dict)
    sphere_fits: dict[tuple[str, str], dict[str, SphereFit]] = field(default_factory=dict)
    analytic: list[ModelError] = field(default_factory=list)
    rendered: list[ModelError] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)


def run(*, out: Path, quick: bool, seed: int, source: str) -> Findings:
    """Render, measure, fit, compare and report.

    Args:
        out: folder of the run; a run with the same settings goes on where it was.
        quick: fewer frames.
        seed: of camera noise and wall texture.
        source: "lens", "cone" or "both".

    Raises:
        ValueError: `out` holds something else.
    """
    from benchmarks.studies.validate import report  # figures and templates, needed at the end only

    out = Path(out)
    settings: dict[str, object] = {
        "schema": _RUN_SCHEMA,
        "quick": quick,
        "seed": seed,
        "source": source,
    }
    scenes.load_mitsuba()  # a machine that cannot render leaves no folder behind
    run_folder.claim(out, settings, command="eyespot validate")
    sources = ("lens", "cone") if source == "both" else (source,)
    trials = [
        trial for kind in sources for trial in paper_trials(source=kind, quick=quick, seed=seed)
    ] + grid_trials(quick=quick, seed=seed)

    findings = Findings(settings=settings, trials=trials, tracked={})
    # One worker computes and measures beside the rendering, which leaves a core half idle.
    with ThreadPoolExecutor(max_workers=1) as beside:
        try:
            with _timed(findings, "render and measure"):
                findings.tracked.update(_render_and_measure(trials, out, beside))
            with _timed(findings, "fit and compare"):
                analytic = beside.submit(_analytic, quick=quick)
                _fit(findings)
                findings.rendered.extend(_rendered(findings))
                findings.analytic.extend(analytic.result())
        except BaseException:
            beside.shutdown(cancel_futures=True)
            raise
    with _timed(findings, "report"):
        report.write(findings, out)
    return findings


def _render_and_measure(
    trials: list[Trial], out: Path, beside: ThreadPoolExecutor
) -> dict[tuple[str, str], Tracked]:
    (out / "spots").mkdir(exist_ok=True)
    (out / "stacks").mkdir(exist_ok=True)
    measured: dict[str, Future[dict[str, Tracked]]] = {}
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("frames"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    # Lens trials come last: their table takes seconds, beside the trials that need none.
    ordered = sorted(trials, key=lambda trial: trial.source == "lens")
    table = beside.submit(lambda: World(ordered[-1].scene).light)
    with Progress(*columns) as progress:
        total = sum(scenes.frame_count(trial.scene) for trial in trials)
        task = progress.add_task("rendering", total=total)
        for trial in ordered:
            progress.update(task, description=trial.name)
            if trial.source == "lens":
                table.result()
            stack = run_folder.finished_stack(
                trial.scene, out / "stacks" / trial.name, progress=lambda: progress.advance(task)
            )
            measured[trial.name] = beside.submit(_measure, trial, stack, out)
        progress.update(task, description="measuring")
        return {
            (name, way): tracked
            for name, future in measured.items()
            for way, tracked in future.result().items()
        }


def _measure(trial: Trial, stack: Stack, out: Path) -> dict[str, Tracked]:
    ways = [way for way in WAYS if way.exposure in trial.scene.exposures.kinds]
    if trial.kind == "grid":
        ways = [way for way in ways if way.name == SUBPIXEL]
    return {
        way.name: track_stack(stack, way, spots_file=out / "spots" / f"{trial.name}-{way.slug}.csv")
        for way in ways
    }


def _fit(findings: Findings) -> None:
    """Tables I and II for every source and way of measuring that found spots."""
    paper = [trial for trial in findings.trials if trial.kind != "grid"]
    for source in dict.fromkeys(trial.source for trial in paper):
        for way in WAYS:
            key = source, way.name
            tracked = {
                trial.group: findings.tracked[trial.name, way.name]
                for trial in paper
                if trial.source == source
            }
            enough = {g: t for g, t in tracked.items() if np.sum(t.used) >= _FEWEST_SPOTS}
            planes = {g: t for g, t in enough.items() if g.startswith("plane")}
            spheres = {g: t for g, t in enough.items() if g.startswith("sphere")}
            if not planes:
                continue
            fits = {
                group: fit_plane(semi_minor_px=t.semi_minor_px, distance=t.travel_mm)
                for group, t in planes.items()
            }
            axis = np.concatenate([t.semi_minor_px for t in planes.values()])
            reading = np.concatenate([t.travel_mm for t in planes.values()])
            pooled = fit_plane(semi_minor_px=axis, distance=reading)
            findings.plane_fits[key] = {**fits, _ALL_PLANES: pooled}
            findings.range_fits[key] = [
                (limit, fit_plane(semi_minor_px=axis[near], distance=reading[near]))
                for limit in _RANGE_LIMITS_MM
                if np.count_nonzero(near := reading <= limit + _READING_SLACK_MM) >= _FEWEST_SPOTS
            ]
            scene = paper[0].scene
            findings.sphere_fits[key] = {
                group: fit_eccentricity(
                    semi_minor_px=t.semi_minor_px,
                    distance=t.travel_mm,
                    delta_k=pooled.delta_k,
                    b=pooled.b,
                    scale=scene.microscope.scale_mm_px,
                    eye_radius=scene.phantom.radius_mm,
                )
                for group, t in spheres.items()
            }


def _analytic(*, quick: bool) -> list[ModelError]:
    """Errors on exact contours: square to the wall, and at the trials' incidence."""
    trial = grid_trials(quick=quick, seed=0)[0]
    eccentricities = np.linspace(0.0, 7.0, 8 if quick else 29)
    distances = np.arange(0.5, 6.01, 0.5)
    return [
        error
        for height in _ANALYTIC_HEIGHTS_MM
        for incidence_deg in (0.0, trial.scene.spot.incidence_deg)
        for error in model_error.analytic_errors(
            _geometry(trial, pinhole_height=height, incidence_deg=incidence_deg),
            eccentricities=eccentricities,
            distances=distances,
        )
    ]


def _rendered(findings: Findings) -> list[ModelError]:
    """Errors on measured spots of the grid, each pinhole height in one batch."""
    errors: list[ModelError] = []
    for height in PINHOLE_HEIGHTS_MM:
        trials = [
            trial
            for trial in findings.trials
            if trial.kind == "grid" and trial.scene.microscope.pinhole_height_mm == height
        ]
        tracked = [findings.tracked[trial.name, SUBPIXEL] for trial in trials]
        errors += model_error.measured_errors(
            _geometry(
                trials[0],
                pinhole_height=height,
                incidence_deg=trials[0].scene.spot.incidence_deg,
            ),
            labels=[row for t in tracked for row in t.used_labels],
            semi_minor_px=np.concatenate([t.semi_minor_px for t in tracked]),
        )
    return errors


def _geometry(trial: Trial, *, pinhole_height: float, incidence_deg: float) -> Geometry:
    scene = trial.scene
    return Geometry(
        scale=scene.microscope.scale_mm_px,
        pinhole_height=pinhole_height,
        eye_radius=scene.phantom.radius_mm,
        half_angle=math.atan(1.0 / scene.source.cone_k),
        apex_offset=scene.source.cone_apex_offset_mm,
        incidence=math.radians(incidence_deg),
        incidence_azimuth=math.radians(scene.spot.incidence_azimuth_deg),
    )


@contextmanager
def _timed(findings: Findings, step: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    findings.seconds[step] = time.perf_counter() - start
