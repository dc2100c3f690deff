"""The main job: the paper's static experiment on rendered images, and its model against the truth.

DIR/run.json         the request; a folder with another run.json is refused
    stacks/…         labelled image stacks, one for each trial
    spots/…          the spots measured in them, in each way
    *.csv, figures/  the numbers and figures of the report
    summary.json     what was found
    report.html      the same, for people
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.evaluation import (
    SUBPIXEL,
    WAYS,
    StaticTrial,
    Tracked,
    grid_trials,
    paper_trials,
    track_stack,
)
from benchmarks.reporting import Request, Study
from benchmarks.studies.validate.findings import ValidateFindings
from benchmarks.studies.validate.fits import analytic_errors, fit_tables, rendered_errors
from benchmarks.studies.validate.report import report
from estimator import Stack
from scenes import World


def run(*, out: Path, quick: bool, seed: int, source: str) -> ValidateFindings:
    """Render, measure, fit, compare and report.

    Args:
        out: folder of the run; a run with the same settings is resumed.
        quick: fewer frames.
        seed: of camera noise and wall texture.
        source: "lens", "cone" or "both".

    Raises:
        InputError: `out` has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    request = Request(out=out, quick=quick, seed=seed, options={"source": source})
    study = Study("validate", request, command=("eyespot", "validate"))
    sources = ("lens", "cone") if source == "both" else (source,)
    trials = [t for kind in sources for t in paper_trials(source=kind, quick=quick, seed=seed)]
    trials += grid_trials(quick=quick, seed=seed)
    with ThreadPoolExecutor(max_workers=1) as beside:
        # These take seconds and need no renderer, so they run beside the trials of the ideal cone.
        analytic = beside.submit(lambda: analytic_errors(quick=quick))
        light = beside.submit(lambda: World(trials[0].scene).light)
        with study.timed("render and measure"):
            tracked = _tracked(study, [t for t in trials if t.source == "cone"])
            light.result()
            tracked |= _tracked(study, [t for t in trials if t.source == "lens"])
        with study.timed("fit and compare"):
            plane_fits, sphere_fits = fit_tables(trials, tracked)
            findings = ValidateFindings(
                stacks=study.folder / "stacks",
                trials=trials,
                tracked=tracked,
                plane_fits=plane_fits,
                sphere_fits=sphere_fits,
                analytic=analytic.result(),
                rendered=rendered_errors(trials, tracked),
            )
    study.publish(report, findings)
    return findings


def _tracked(study: Study, trials: list[StaticTrial]) -> dict[tuple[str, str], Tracked]:
    """Spots of every trial in every way whose exposure it has; of the grid in the best way."""
    by_name = {trial.name: trial for trial in trials}
    folder = study.folder / "spots"
    folder.mkdir(exist_ok=True)

    def measure(name: str, stack: Stack) -> dict[tuple[str, str], Tracked]:
        kinds = by_name[name].scene.exposures.kinds
        ways = [way for way in WAYS if way.exposure in kinds]
        return {
            (name, way.name): track_stack(stack, way, spots_file=folder / f"{name}-{way.slug}.csv")
            for way in (ways if by_name[name].kind != "grid" else [SUBPIXEL])
        }

    found = study.measured({trial.name: trial.scene for trial in trials}, measure)
    return {key: tracked for of_trial in found.values() for key, tracked in of_trial.items()}
