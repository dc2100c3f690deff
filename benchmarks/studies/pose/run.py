"""`eyespot study pose`: tip and axis of the tool from one spot and from three.

DIR/pose_error.csv  every pose, analytic and rendered, with its errors and bounds
    poses/          the rendered poses of the beams
    stacks/, spots/ the frames, and the spots measured in them
"""

from __future__ import annotations

import numpy as np

import optics
from benchmarks.evaluation import MICROSCOPE_MM, require_roomy_eyeball
from benchmarks.reporting import Request, Study
from benchmarks.studies.pose import analytic, rendered
from benchmarks.studies.pose.errors import one_spot, three_spots
from benchmarks.studies.pose.findings import HALF_WIDTH_MM, LARGEST_C_MM, PoseError, PoseFindings
from benchmarks.studies.pose.report import report
from scenes import Scene, SceneError
from scenes.world import World


def run(request: Request) -> PoseFindings:
    """Compute, render, compare and report.

    Args:
        request: the arguments.

    Raises:
        SceneError: the scene is no eyeball lit by a cone, or too small a one.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
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
    findings = PoseFindings(scene=study.scene, rows=rows)
    study.publish(report, findings)
    return findings


def check(scene: Scene) -> None:
    """Refuse a scene whose spots have no pose in the working volume.

    Raises:
        SceneError: saying what to change.
    """
    reach = np.sqrt(2) * HALF_WIDTH_MM
    require_roomy_eyeball(scene, f"spots reach {reach:.1f} mm from the axis")
    if scene.source.kind != "cone":
        raise SceneError(
            "the study computes poses from a spot's sharp edge; got source.kind "
            f"'{scene.source.kind}'. Set source.kind=cone."
        )


def _analytic(study: Study, *, one: int, three: int) -> list[PoseError]:
    """Errors on exact contours, with the scene's pinhole and with a microscope's."""
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
        for tool, count in ((one_spot(*given), one), (three_spots(*given), three)):
            every = analytic.places(surface, count=count, seed=study.seed)
            rows += analytic.errors(tool, every, surface, view, seed=study.seed)
    return rows
