"""Distances on frames rendered through Navarro's eye and a flat contact lens.

The calibration knows what the table knows: withdrawals at three places, and a cone from a phantom.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from eyespot import scenes
from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.estimator.distance.ranger import Ranger
from eyespot.formats.calibration import read_calibration, write_calibration
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spot import Spot
from eyespot.formats.stack import Stack
from eyespot.scenes.world.true_calibration import true_calibration
from tests.support.command_line import printed

pytestmark = pytest.mark.slow

_THROUGH_THE_EYE = [
    "viewing.eye=navarro",
    "viewing.lens=flat",
    "viewing.pupil_mm=14",  # 7 mm would hide the spots at c = 5 mm
    "source.kind=cone",
    "source.medium=vitreous",
    "microscope.pinhole_height_mm=200",
    "phantom.wall=uniform",
    "instrument.visible=false",
    'exposures.kinds=["metered"]',
    "spot.incidence_deg=0",
]


def scene_at(c: float, *changes: str) -> scenes.Scene:
    return scenes.load_scene(None, [*_THROUGH_THE_EYE, f"spot.eccentricity_mm={c}", *changes])


def rendered(folder: Path, c: float, *changes: str) -> Stack:
    return scenes.render_stack(scene_at(c, *changes), folder / f"c{c:g}{len(changes)}")


def test_models_hold_their_limits_behind_a_flat_contact_lens(tmp_path):
    trocar = "motion.frames=13", "spot.incidence_deg=25", "spot.incidence_azimuth_deg=90"
    withdrawals = [rendered(tmp_path, c, *trocar) for c in (1.0, 3.0, 5.0)]
    truth = true_calibration(scene_at(1.0))
    write_calibration(tmp_path / "cone.json", truth)
    known = "--model", "eye", "--calibration", tmp_path / "cone.json"
    folders = [stack.folder for stack in withdrawals]
    printed("fit", *folders, *known, "--out", tmp_path / "eye.json")
    eye = read_calibration(tmp_path / "eye.json")
    worst = dict.fromkeys(("exact", "corrected", "area", "small_plane"), 0.0)
    for c in (1.0, 2.0, 4.0, 5.0):
        stack = rendered(
            tmp_path, c, "motion.frames=5", "motion.start_mm=1", "motion.travel_mm=4", "seed=1"
        )
        microscope = read_microscope(stack.folder / "microscope.json")
        rangers = {
            "exact": Ranger(truth, microscope, model="exact"),
            "corrected": Ranger(eye, microscope, model="corrected"),
            "area": Ranger(eye, microscope, model="area"),
            "small_plane": Ranger(truth, microscope, model="small_plane"),
        }
        for label in stack.labels:
            spot, *_ = measure(stack.image(label), TrackState(), SubpixelSettings())
            assert isinstance(spot, Spot)
            for model, ranger in rangers.items():
                read = ranger.distance(spot, axis=np.array(label.axis), axis_sigma_rad=1e-3)
                worst[model] = max(worst[model], abs(read.distance_mm - label.d_mm))
    print(worst)  # the figures of docs/viewing.md
    assert worst["exact"] < 0.02
    assert worst["corrected"] < 0.08
    assert worst["area"] < 0.08
    assert worst["small_plane"] > 2.0
