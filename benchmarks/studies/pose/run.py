"""`eyespot study pose`: tip and axis of the tool from one spot and from three.

DIR/pose_error.csv  every pose, analytic and rendered, with its errors and bounds
    poses/          what was rendered: poses of the beams
    stacks/, spots/ the frames, and what was measured in them
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import optics
from benchmarks.reporting import MICROSCOPE_MM, Request, Study, require_roomy_eyeball
from benchmarks.studies.pose import analytic, rendered
from benchmarks.studies.pose.errors import PoseError
from benchmarks.studies.pose.tool import one_spot, three_spots
from scenes import Scene, SceneError
from scenes.world import World

LARGEST_C_MM = 5.0
"""Of the rendered spots."""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What the report is made of.

    Attributes:
        scene: the study's.
        rows: errors of all poses.
    """

    scene: Scene
    rows: list[PoseError]


def run(request: Request) -> Findings:
    """Compute, render, compare and report.

    Args:
        request: what was asked for.

    Raises:
        SceneError: the scene is no eyeball lit by a cone, or too small a one.
        ValueError: the folder holds something else.
        RendererUnavailable: Mitsuba cannot run here.
    """
    from benchmarks.studies.pose import report as pose_report  # figures, needed at the end only

    study = Study("pose", request, defaults=("source.kind=cone",), check=check)
    quick = request.quick
    with study.timed("noise on exact contours"):
        rows = _analytic(study, one=64 if quick else 1024, three=32 if quick else 128)
    with study.timed("render and measure"):
        rows += rendered.measure(
            study,
            eccentricities=np.linspace(0.0, LARGEST_C_MM, 2 if quick else 6).tolist(),
            poses=3 if quick else 6,
        )
    findings = Findings(scene=study.scene, rows=rows)
    study.publish(pose_report.report(findings))
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene whose spots have no pose in the working volume.

    Raises:
        SceneError: saying what to change.
    """
    reach = np.sqrt(2) * analytic.HALF_WIDTH_MM
    require_roomy_eyeball(scene, f"spots reach {reach:.1f} mm from the axis")
    if scene.source.kind != "cone":
        raise SceneError(
            "the study needs a sharp edge, whose geometry tells the pose; got source.kind "
            f"'{scene.source.kind}'. Set source.kind=cone."
        )


def _analytic(study: Study, *, one: int, three: int) -> list[PoseError]:
    """With the scene's pinhole and with a microscope's."""
    scene = study.scene
    surface = World(scene).wall
    assert isinstance(surface, optics.Sphere)  # by `check`
    given = World(scene).cone
    rows = []
    for height in dict.fromkeys((scene.microscope.pinhole_height_mm, MICROSCOPE_MM)):
        view = optics.microscope(
            scale=scene.microscope.scale_mm_px,
            pinhole_height=height,
            eye_radius=scene.phantom.radius_mm,
        )
        for tool, count in ((one_spot(given), one), (three_spots(given), three)):
            every = analytic.places(surface, count=count, seed=study.seed)
            rows += analytic.errors(tool, every, surface, view, seed=study.seed)
    return rows
