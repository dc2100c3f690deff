"""Recordings for the viewer rerun, read back with rerun's own reader."""

import io
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from eyespot.estimator.rig.rig_reader import Parameters, opened_rig
from eyespot.estimator.viewer import check_recording_path, record_stack
from eyespot.formats.spot import Spot
from eyespot.formats.spots import read_spots
from eyespot.formats.stack import read_stack
from eyespot.scenes import render_stack
from tests.support.command_line import printed
from tests.support.drawn.drawn_sets import labels_of, write_stack
from tests.support.drawn.drawn_spots import disc
from tests.support.drawn.scene_tables import scene_of


def columns_of(recording: Path) -> dict[str, dict[int, Any]]:
    """The values of each column, by the frame that they belong to."""
    chunk = pytest.importorskip("rerun.chunk", reason="pip install 'eyespot[rerun]'")
    found: dict[str, dict[int, Any]] = {}
    for part in chunk.RrdReader(recording).stream():
        batch = part.to_record_batch()
        if "frame" in batch.schema.names:
            frames = batch.column("frame").to_pylist()
            for name in batch.schema.names:
                column = found.setdefault(f"{part.entity_path}:{name}", {})
                column.update(zip(frames, batch.column(name).to_pylist(), strict=True))
    return found


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    labels = [labels_of(index) for index in range(4)]
    return write_stack(tmp_path_factory.mktemp("drawn") / "stack", labels)


def test_a_tracked_stack_is_recorded_with_what_was_measured_and_what_is_true(stack, tmp_path):
    recording, spots = tmp_path / "a.rrd", tmp_path / "spots.csv"
    pytest.importorskip("rerun", reason="pip install 'eyespot[rerun]'")
    printed("track", stack, "--out", spots, "--rerun", recording)
    columns, records = columns_of(recording), read_spots(spots)
    for record, labels in zip(records, read_stack(stack).labels, strict=True):
        (centre,) = columns["/microscope/spot/centre:Points2D:positions"][record.frame]
        assert isinstance(record.result, Spot)
        # Single precision, and rerun's corner of the first pixel is at (-0.5, -0.5).
        np.testing.assert_allclose(np.subtract(centre, 0.5), record.result.ellipse[:2], rtol=1e-6)
        (contour,) = columns["/microscope/spot:LineStrips2D:strips"][record.frame]
        # One of 180 corners lacks 2e-4 of its ellipse's area.
        _, _, semi_major, semi_minor, _ = record.result.ellipse
        area = cv2.contourArea(np.asarray(contour, np.float32))
        assert area == pytest.approx(np.pi * semi_major * semi_minor, rel=1e-3)
        assert columns["/distance/truth:Scalars:scalars"][record.frame] == [labels.d_mm]
        (blob,) = columns["/microscope:EncodedImage:blob"][record.frame]
        image = np.asarray(Image.open(io.BytesIO(bytes(blob))))
        assert image.shape == (120, 160, 3)


def test_a_fit_is_recorded_with_the_robots_distances_and_its_residuals(tmp_path):
    pytest.importorskip("rerun", reason="pip install 'eyespot[rerun]'")
    scene = {
        "source": {"kind": "cone"},
        "microscope": {"width_px": 320, "height_px": 240, "scale_mm_px": 0.0134},
        "motion": {"frames": 9},
        "phantom": {"wall": "uniform"},
        "exposures": {"kinds": ["metered"]},
    }
    stack, recording = tmp_path / "stack", tmp_path / "fit.rrd"
    render_stack(scene_of(scene), stack)
    printed("fit", stack, "--model", "cone", "--out", tmp_path / "c.json", "--rerun", recording)
    columns = columns_of(recording)
    measured = columns["/distance/measured:Scalars:scalars"]
    robot = columns["/distance/robot:Scalars:scalars"]
    labels = read_stack(stack).labels
    # At contact the instrument hides the spot.
    assert sorted(measured) == sorted(robot) == [*range(1, 9)]
    for row in labels[1:]:
        # The touch is known to 0.02 mm, and fit and robot share it.
        assert robot[row.frame][0] == pytest.approx(row.d_mm, abs=0.04)
        assert measured[row.frame][0] == pytest.approx(robot[row.frame][0], abs=0.01)
    residuals = [name for name in columns if name.startswith("/residuals/")]
    assert residuals
    assert all(len(columns[name]) == 8 for name in residuals)
    assert len(columns["/microscope:EncodedImage:blob"]) == 9


def test_the_rig_records_what_it_measures(tmp_path):
    pytest.importorskip("rerun", reason="pip install 'eyespot[rerun]'")
    image = disc((240, 320), 150, 110, 40)
    message = SimpleNamespace(
        height=240, width=320, encoding="mono8", is_bigendian=0, step=320, data=image.ravel()
    )
    with opened_rig(Parameters(rerun=str(tmp_path / "rig.rrd"))) as rig:
        outputs = [rig.output(message, 1.0 + n / 10, n) for n in (7, 8)]
    columns = columns_of(tmp_path / "rig.rrd")
    centres = columns["/microscope/spot/centre:Points2D:positions"]
    for number, output in zip((7, 8), outputs, strict=True):
        np.testing.assert_allclose(
            np.subtract(centres[number][0], 0.5), output.centre[:2], rtol=1e-6
        )


def test_the_beam_of_a_recorded_stack_ends_at_its_distance(stack, tmp_path):
    pytest.importorskip("rerun", reason="pip install 'eyespot[rerun]'")
    record_stack(stack, str(tmp_path / "a.rrd"))
    columns = columns_of(tmp_path / "a.rrd")
    for labels in read_stack(stack).labels:
        (tip,) = columns["/eye/truth/tip:Points3D:positions"][labels.frame]
        (beam,) = columns["/eye/truth/beam:Arrows3D:vectors"][labels.frame]
        np.testing.assert_allclose(tip, labels.tip_mm, rtol=1e-6)
        np.testing.assert_allclose(beam, labels.d_mm * np.array(labels.axis), atol=1e-6)


def test_the_rings_of_the_retina_lie_on_the_eyeball():
    from eyespot.estimator.viewer import _heights_mm

    class Eye:
        plane_normal, eye_radius_mm = None, 11.5

    points = np.array([[0.0, 0.0], [3.0, 4.0]])
    heights: Any = _heights_mm(Eye(), points)  # type: ignore[arg-type]
    np.testing.assert_allclose(np.sum(points**2, 1) + heights**2, 11.5**2)
    assert (heights < 0).all()


def test_a_live_view_without_a_display_is_refused(tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ValueError, match="live needs a display"):
        check_recording_path("live")


@pytest.mark.parametrize(
    ("target", "said"), [("a.mp4", r"NAME\.rrd, or live"), ("a.rrd", r"eyespot\[rerun\]")]
)
def test_a_recording_that_cannot_be_made_is_refused_before_the_run(
    stack, tmp_path, monkeypatch, target, said
):
    monkeypatch.setitem(sys.modules, "rerun", None)  # stands in for a machine without it
    with pytest.raises(ValueError, match=said):
        record_stack(stack, str(tmp_path / target))
    assert not list(tmp_path.iterdir())
