"""`eyespot study table-one`: which lenses give the paper's Table I, and what sets trials apart.

DIR/table_one_scan.csv      each lens at the threshold and range that come nearest to the table
    table_one_rendered.csv  the best of them, and some that fail, on rendered stacks
    table_one_marks.csv     what distinguishes lenses that give the same line
    table_one_causes.csv    what touch, light, tilt, height and range do to a line
    lenses/, stacks/        rendered lenses and frames
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from benchmarks.reporting import Request, Study
from benchmarks.studies.table_one import causes, rendered, scan
from benchmarks.studies.table_one.findings import Demand, LensChoice, TableOneFindings
from benchmarks.studies.table_one.isophotes import Family, Isophotes, families, paper_candidate
from benchmarks.studies.table_one.report import report
from scenes import Scene, SceneError

WIDE_APERTURE = 0.15
"""From here on the first scan, by ray binning, found no flat end that fits."""
_CURVED_MM = 0.02


def run(request: Request) -> TableOneFindings:
    """Scan, render, compare and report.

    Args:
        request: the arguments.

    Raises:
        SceneError: the scene is not a withdrawal of a lens from a plane.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("table-one", request, defaults=("phantom.kind=plane",), check=check)
    scene = study.scene
    with study.timed("scan of lenses"):
        isophotes = _isophotes(scene, lenses(quick=request.quick))
        choices = [
            choice
            for one in isophotes.values()
            for choice in scan.best_choices(one, scale=scene.microscope.scale_mm_px)
        ]
    chosen = to_render([c for c in choices if c.asked == Demand.AT_SCALE], quick=request.quick)
    with study.timed("render and measure"):
        confirmed = sorted(
            rendered.confirm(study, chosen, frames=7 if request.quick else 31),
            key=lambda one: (one.reproduces, one.straight),
            reverse=True,
        )
    best = confirmed[0].choice
    findings = TableOneFindings(
        scene=scene,
        isophotes=isophotes,
        choices=choices,
        confirmed=confirmed,
        marks=[causes.mark(isophotes[one.choice.family], one.choice) for one in confirmed],
        causes=causes.causes(isophotes[best.family], best, scene),
    )
    study.publish(report, findings)
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene that cannot be compared with Table I.

    Raises:
        SceneError: saying what to change.
    """
    if scene.phantom.kind != "plane" or scene.phantom.tilt_deg:
        raise SceneError(
            "Table I is of a plane square to the microscope; got phantom.kind "
            f"'{scene.phantom.kind}' with tilt_deg = {scene.phantom.tilt_deg:g}. Set "
            "phantom.kind=plane and phantom.tilt_deg=0."
        )
    if scene.source.kind != "lens" or scene.motion.kind != "withdrawal":
        raise SceneError(
            "the study compares lenses on withdrawals from contact; got source.kind "
            f"'{scene.source.kind}' and motion.kind '{scene.motion.kind}'. Set source.kind=lens "
            "and motion.kind=withdrawal."
        )
    if scene.motion.start_mm != "contact":
        raise SceneError(
            "the paper counts its readings from contact; got motion.start_mm = "
            f"{scene.motion.start_mm:g}. Set motion.start_mm=contact."
        )


def lenses(*, quick: bool) -> list[Family]:
    """The lenses of the scan."""
    if quick:
        return families((0.05, 0.10, 0.15, 0.20), (0.0, 0.12))
    return families(
        (0.05, 0.08, 0.10, 0.12, 0.15, 0.20), (0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.12)
    )


def to_render(choices: Sequence[LensChoice], *, quick: bool) -> list[LensChoice]:
    """The best, and of those that fail the nearest of several kinds.

    Args:
        choices: one of each lens.
        quick: the best, and the nearest with a round cap, alone.

    Returns:
        The two best, the preset `paper-candidate`, and those that fail.
    """
    ranked = sorted(choices, key=lambda choice: choice.miss)
    kinds: list[Callable[[LensChoice], bool]] = [
        lambda choice: choice.sag_mm >= _CURVED_MM,
        lambda choice: choice.numerical_aperture >= WIDE_APERTURE and choice.sag_mm == 0,
    ]
    failing = [
        next((choice for choice in ranked if of_kind(choice) and choice.miss > 1), None)
        for of_kind in (kinds[:1] if quick else kinds)
    ]
    candidate = [choice for choice in ranked if choice.family == paper_candidate()]
    chosen = ranked[:1] if quick else [*ranked[:2], *candidate]
    chosen += [choice for choice in failing if choice is not None]
    return list(dict.fromkeys(chosen))


def _isophotes(scene: Scene, families: Sequence[Family]) -> dict[Family, Isophotes]:
    with ThreadPoolExecutor(max_workers=2) as pool:
        return dict(
            zip(families, pool.map(lambda f: Isophotes.of(f, scene), families), strict=True)
        )
