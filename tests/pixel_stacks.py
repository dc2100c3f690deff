"""Small rendered stacks of a known cone for tests of the mode pixels, and what it reads in them."""

import math
from pathlib import Path

import numpy as np

from estimator.run.options import Options
from estimator.sources.opening import open_source
from formats.calibration import write_calibration
from formats.poses import read_poses
from scenes import Scene, render_stack
from tests.made_up import a_calibration


def cone_stack(folder: Path, **tables):
    """A withdrawal from printed paper, with tables of the scene replaced."""
    scene = {
        "schema": 1,
        "seed": 11,
        "phantom": {"wall": "printed paper", "texture_seed": 4},
        "instrument": {"visible": False},
        "source": {"kind": "cone"},
        "spot": {"eccentricity_mm": 1.5, "incidence_deg": 20.0},
        "microscope": {"width_px": 360, "height_px": 300},
        "motion": {"start_mm": 2.0, "travel_mm": 0.9, "frames": 6, "speed_mm_s": 1.0},
        "exposures": {"kinds": ["metered"]},
    }
    return render_stack(Scene.model_validate(scene | tables), folder)


def calibration_in(folder: Path, *, sigma_b_mm: float = 1e-5) -> Path:
    """The calibration file of the cone that is rendered, whose b has some stated error."""
    path = folder / "cone.json"
    path.unlink(missing_ok=True)
    write_calibration(path, a_calibration(covariance=np.diag([1e-8, sigma_b_mm**2])))
    return path


def reader_in(stack, folder: Path, *, sigma_b_mm: float = 1e-5, **options):
    """A reader of a stack in the mode pixels, with the true cone."""
    return Options.of(
        {
            "mode": "pixels",
            "calibration": calibration_in(folder, sigma_b_mm=sigma_b_mm),
            "microscope": stack.folder / "microscope.json",
            "eye_from_robot": (0.0, 0.0, 0.0, 1.0),
            **options,
        }
    ).reader()


def readings_of(stack, folder: Path, poses=None, **options):
    """What the wall was known as, the distance's error and chi squared of the pose, by frame."""
    reader = reader_in(stack, folder, **options)
    poses = poses or read_poses(stack.folder / "kinematics.csv")
    for frame, labels in zip(open_source(stack.folder), stack.labels, strict=True):
        found = reader.read(frame, poses=poses).range
        assert found is not None
        (pose,) = found.poses
        chi_squared = pose.chi_squared(labels.tip_mm, labels.axis)
        yield found.wall, found.distance_mm - labels.d_mm, chi_squared


def assert_posed(readings, within_mm: float = math.inf) -> None:
    """The poses are within their stated errors, and the distances within a limit of the truth."""
    _, off_mm, chi_squared = zip(*readings, strict=True)
    assert max(map(abs, off_mm)) < within_mm
    assert max(chi_squared) < 30  # of five numbers it exceeds that once in 70,000
