"""`eyespot study table-one`: which lenses give the paper's Table I, and what sets trials apart.

DIR/table_one_scan.csv      each lens at the threshold and range that come nearest to the table
    table_one_rendered.csv  the best of them, and some that fail, on rendered stacks
    table_one_marks.csv     what would tell lenses apart that give the same line
    table_one_causes.csv    what touch, light, tilt, height and range do to a line
    lenses/, stacks/, spots/  what was rendered, and measured in it
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from benchmarks.reporting import Request, Study
from benchmarks.studies.table_one import causes, rendered, scan
from benchmarks.studies.table_one.causes import Cause, Mark
from benchmarks.studies.table_one.rendered import Confirmed
from benchmarks.studies.table_one.scan import AT_SCALE, Choice, Family, Isophotes
from scenes import Scene, SceneError

WIDE_APERTURE = 0.15
"""From here on the first scan, by ray binning, found no flat end that fits."""
_CURVED_MM = 0.02


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What the report is made of.

    Attributes:
        scene: the study's.
        isophotes: of all lenses of the scan.
        choices: of each lens, by both ways of asking.
        confirmed: lenses on rendered stacks: those that give the table, those that give its line,
            the others; of a kind the best of the scan first.
        marks: of the same lenses.
        causes: what makes trials of the best lens differ.
    """

    scene: Scene
    isophotes: dict[Family, Isophotes]
    choices: list[Choice]
    confirmed: list[Confirmed]
    marks: list[Mark]
    causes: list[Cause]

    def asked(self, way: str) -> list[Choice]:
        """Choices by one way of asking."""
        return [choice for choice in self.choices if choice.asked == way]


def run(request: Request) -> Findings:
    """Scan, render, compare and report.

    Args:
        request: what was asked for.

    Raises:
        SceneError: the scene is no withdrawal of a lens from a plane.
        ValueError: the folder holds something else.
        RendererUnavailable: Mitsuba cannot run here.
    """
    from benchmarks.studies.table_one import (
        report as table_one_report,  # figures, needed at the end only
    )

    study = Study("table-one", request, defaults=("phantom.kind=plane",), check=check)
    scene = study.scene
    with study.timed("scan of lenses"):
        isophotes = _isophotes(scene, lenses(quick=request.quick))
        choices = [
            choice
            for one in isophotes.values()
            for choice in scan.best_choices(one, scale=scene.microscope.scale_mm_px)
        ]
    chosen = to_render([c for c in choices if c.asked == AT_SCALE], quick=request.quick)
    with study.timed("render and measure"):
        confirmed = sorted(
            rendered.confirm(study, chosen, frames=7 if request.quick else 31),
            key=lambda one: (one.reproduces, one.straight),
            reverse=True,
        )
    best = confirmed[0].choice
    findings = Findings(
        scene=scene,
        isophotes=isophotes,
        choices=choices,
        confirmed=confirmed,
        marks=[causes.mark(isophotes[one.choice.family], one.choice) for one in confirmed],
        causes=causes.causes(isophotes[best.family], best, scene),
    )
    study.publish(table_one_report.report(findings))
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene that Table I cannot be asked of.

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
        return scan.families((0.05, 0.10, 0.15, 0.20), (0.0, 0.12))
    return scan.families(
        (0.05, 0.08, 0.10, 0.12, 0.15, 0.20), (0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.12)
    )


def to_render(choices: Sequence[Choice], *, quick: bool) -> list[Choice]:
    """The best, and of those that fail the nearest of several kinds.

    Args:
        choices: one of each lens.
        quick: the best, and the nearest with a round cap, alone.

    Returns:
        The two best, the preset `paper-candidate`, whose claim is to be tried, and those that fail.
    """
    ranked = sorted(choices, key=lambda choice: choice.miss)
    kinds: list[Callable[[Choice], bool]] = [
        lambda choice: choice.sag_mm >= _CURVED_MM,
        lambda choice: choice.numerical_aperture >= WIDE_APERTURE and choice.sag_mm == 0,
    ]
    failing = [
        next((choice for choice in ranked if of_kind(choice) and choice.miss > 1), None)
        for of_kind in (kinds[:1] if quick else kinds)
    ]
    candidate = [choice for choice in ranked if choice.family == scan.candidate()]
    chosen = ranked[:1] if quick else [*ranked[:2], *candidate]
    chosen += [choice for choice in failing if choice is not None]
    return list(dict.fromkeys(chosen))


def _isophotes(scene: Scene, families: Sequence[Family]) -> dict[Family, Isophotes]:
    with ThreadPoolExecutor(max_workers=2) as pool:
        return dict(
            zip(families, pool.map(lambda f: Isophotes.of(f, scene), families), strict=True)
        )
