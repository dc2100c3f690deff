"""`eyespot track`: what it writes, what it says, and how it ends."""

import functools
import json
import math
from contextlib import suppress
from importlib.metadata import version
from unittest import mock

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eyespot.estimator import LiteralSettings, SubpixelSettings, track
from eyespot.estimator.distance.ranger import Ranger
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.offline import summary_of, table_of, track_source
from eyespot.estimator.run.options import Options
from eyespot.estimator.run.overlay import annotated, overlay_writer
from eyespot.estimator.sources.ros import write_bag
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.calibration import read_calibration, write_calibration
from eyespot.formats.camera_sheet import LensDistortion, Response
from eyespot.formats.microscope import read_microscope
from eyespot.formats.poses import Pose, PoseTrack
from eyespot.formats.spot import NoSpot, Reason, Spot
from eyespot.formats.spots import SpotRecord, read_spots
from eyespot.scenes.drawn import Drawing, Truth, frame_of
from tests.support import command_line
from tests.support.drawn.drawn_recording import (
    GONE,
    SHAPE,
    assert_same,
    new_reader,
    recorded,
    truth,
    write_folder,
    write_stack,
    write_video,
)
from tests.support.drawn.drawn_spots import disc
from tests.support.drawn.made_up import a_calibration, a_microscope_file, an_opencv_file

run = functools.partial(command_line.run, "track")
SCALE_MM_PX = 0.0067
NOTHING = NoSpot(Reason.NONE_FOUND)


@pytest.fixture(scope="module")
def images():
    return recorded(8)


@pytest.fixture
def frames(tmp_path, images):
    return write_folder(tmp_path / "frames", images, "{}.png")


@pytest.fixture
def microscope(tmp_path):
    """A telecentric one with a curved response."""
    size = SHAPE[1], SHAPE[0]
    return a_microscope_file(tmp_path, size, response="srgb", paper_exposure_s=0.01)


@pytest.fixture
def distorted(tmp_path):
    """A calibration of OpenCV's with 8 px of distortion in the corners."""
    size = {"image_width": SHAPE[1], "image_height": SHAPE[0]}
    lens = {"camera_matrix": CAMERA.matrix, "distortion_coefficients": CAMERA.distortion}
    return an_opencv_file(tmp_path / "camera.yml", **size, **lens)


CAMERA = LensDistortion(
    matrix=np.array([[400.0, 0, 100], [0, 400, 80], [0, 0, 1]]),
    distortion=np.array([-0.6, 0, 0, 0, 0]),
)
EYE = ("--set", "microscope.pinhole_height_mm=200", "--set", "wall.radius_mm=11.5")


@pytest.fixture
def calibration(tmp_path):
    path = tmp_path / "calibration.json"
    write_calibration(path, a_calibration({"k": 20.0, "b": -4.5}))
    return path


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_the_file_holds_what_the_tracker_measures(tmp_path, frames, images, suffix):
    out = tmp_path / f"spots{suffix}"
    assert run(frames, "--out", out).exit_code == 0
    records = read_spots(out)
    assert_same(records, list(track(images, SubpixelSettings())))
    assert [record.file_name for record in records] == [f"{k}.png" for k in range(8)]
    assert {record.mode for record in records} == {"subpixel"}
    versions = f"eyespot {version('eyespot')}, OpenCV {cv2.__version__}"
    assert {record.measured_with for record in records} == {versions}
    assert all(math.isnan(record.distance_mm) for record in records)


def test_parquet_has_typed_columns_and_nulls(tmp_path, frames):
    pyarrow = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "spots.parquet"
    run(frames, "--out", out)
    table = pyarrow.read_table(out)
    types = {name: str(table.schema.field(name).type) for name in table.column_names}
    assert types["frame"] == types["schema_version"] == "int64"
    assert types["reason"] == "string"
    assert types["semi_minor_px"] == types["distance_mm"] == "double"
    assert table["distance_mm"].null_count == 8
    assert [k for k, x in enumerate(table["x_px"].to_pylist()) if x is None] == [GONE]


def test_a_parquet_file_of_something_else_is_no_file_of_spots(tmp_path):
    table = pytest.importorskip("pyarrow").table({"frame": [1]})
    pytest.importorskip("pyarrow.parquet").write_table(table, tmp_path / "spots.parquet")
    with pytest.raises(ValueError, match="not a spots file: column 'file_name' is missing"):
        read_spots(tmp_path / "spots.parquet")


def test_literal_mode_starts_at_the_point_that_is_given(tmp_path, frames, images):
    out = tmp_path / "spots.csv"
    assert run(frames, "--out", out, "--mode", "literal", "--start", "70,80").exit_code == 0
    assert_same(read_spots(out), list(track(images, LiteralSettings(), start=(70, 80))))


def test_json_is_one_object_and_counts_every_frame(tmp_path, frames):
    outcome = run(frames, "--out", tmp_path / "spots.csv", "--json", "--start", "auto")
    expected = {"frames": 8, "spots": 7, "no_spot": {"none_found": 1}, "ended": "complete"}
    assert expected.items() <= json.loads(outcome.stdout).items()
    assert outcome.stderr == ""


def test_the_table_counts_by_reason(tmp_path, frames):
    words = run(frames, "--out", tmp_path / "spots.csv").stdout
    for row in (("spot", "7"), ("no spot: none found", "1"), ("all", "8")):
        assert any(all(part in line for part in row) for line in words.splitlines()), row
    assert f"Wrote {tmp_path / 'spots.csv'}." in words


def test_a_planar_calibration_makes_its_closed_form_of_every_spot(
    tmp_path, frames, images, microscope, calibration
):
    out = tmp_path / "spots.csv"
    options = ("--calibration", calibration, "--rig", microscope)
    summary = json.loads(run(frames, "--out", out, *options, "--json").stdout)
    assert summary["distances"] == 7
    records = read_spots(out)
    assert_same(records, list(track(images, SubpixelSettings(response=Response(curve="srgb")))))
    slope = SCALE_MM_PX * 20
    for record in records:
        spot = record.result
        if not isinstance(spot, Spot):
            assert math.isnan(record.distance_mm)
            continue
        # The paper's planar model: d = delta k e1' + b; k and b are exact here.
        assert record.distance_mm == pytest.approx(slope * spot.semi_minor_px - 4.5, abs=1e-12)
        # By differences of 1e-6 relative, of a linear function.
        sigma = slope * spot.sigma_semi_minor_px
        assert record.sigma_distance_mm == pytest.approx(sigma, rel=1e-6)
    # Spots of less than 4.5 / 0.134 = 33.6 px would have the tip behind the wall: 30 to 33 px.
    assert summary["doubtful_distances"] == {"out_of_range": 4}


def test_a_stack_brings_its_microscope_and_its_exposures(tmp_path, images, microscope):
    content, out = json.loads(microscope.read_text()), tmp_path / "spots.csv"
    folder = write_stack(tmp_path / "stack", images, ("metered", "paper"), **content)
    settings = SubpixelSettings(response=Response(curve="srgb"))
    usual = run(folder, "--out", tmp_path / "usual.csv", "--json")
    said = "Reading the exposure metered (the stack also has paper); --exposure chooses."
    assert usual.exit_code == 0
    assert usual.stderr.count(said) == 1
    assert_same(read_spots(tmp_path / "usual.csv"), list(track(images, settings)))
    chosen = run(folder, "--out", out, "--exposure", "paper")
    assert chosen.exit_code == 0
    assert "--exposure" not in chosen.stderr
    records = read_spots(out)
    assert_same(records, list(track([image // 2 for image in images], settings)))
    assert [record.time_s for record in records] == [k / 25 for k in range(8)]


def test_a_beam_that_was_calibrated_in_another_medium_is_refused(tmp_path, images, microscope):
    content, beam = json.loads(microscope.read_text()), tmp_path / "water.json"
    folder = write_stack(tmp_path / "stack", images, ("metered",), **content)
    line = {"k": 20.0, "b": -4.5}
    write_calibration(beam, a_calibration(line, medium="water", medium_index=1.333))
    outcome = run(folder, "--out", tmp_path / "spots.csv", "--calibration", beam)
    outcome.assert_bad_input("taken in air", "valid in water")


# k 20 % too large makes 3.6 mm of 3 mm; along the wall the robot says nothing of the distance.
@pytest.mark.parametrize(
    ("k", "towards", "told"),
    [(20.0, (0, 0, 1), None), (24.0, (0, 0, 1), (3.0, 3.6)), (24.0, (1, 0, 0), None)],
)
def test_a_robot_that_contradicts_the_distances_is_told(tmp_path, k, towards, told):
    microscope = a_microscope_file(tmp_path, (320, 240), scale_mm_px=0.0134)
    write_calibration(tmp_path / "beam.json", a_calibration({"k": k, "b": -5.117}))
    distances = np.linspace(1.0, 4.0, 10)
    frames = [
        Frame(index=n, time_s=n / 10, image=disc((240, 320), 160, 120, (d + 5.117) / 0.268))
        for n, d in enumerate(distances)
    ]
    poses = PoseTrack(
        Pose.along((0.0, 0.0, -1.0), time_s=n / 10, position_mm=tuple(d * np.array(towards)))
        for n, d in enumerate(distances)
    )
    reader = Options(rig=microscope, calibration=tmp_path / "beam.json").reader()
    source = Source(name="withdrawal", read=lambda: iter(frames))
    frame_of_eye = {"robot.eye_from_robot": [0.0, 0.0, 0.0, 1.0]}
    recording = Recording(source, poses=poses, rig=microscope, changes=frame_of_eye)
    tracking = track_source(recording, reader)
    said = [str(line) for line in table_of(summary_of(tracking, source, "", 0.0)).renderables]
    assert len(tracking.disagreements) == bool(told)
    if told:
        # The disc is drawn to 0.02 px, which are 5 um in the distance; the budget adds what the
        # planar model misses on a sphere, 5 um more in 3 mm.
        robot, read = told
        expected = f"by {robot:.2f} mm by the robot, by {read:.1f}"
        assert expected in tracking.disagreements[0]
        assert any(expected in line for line in said)


def test_a_distorted_lens_is_taken_out_of_the_spots(tmp_path, frames, images, distorted):
    out = tmp_path / "spots.csv"
    assert run(frames, "--out", out, "--rig", distorted, *EYE).exit_code == 0
    assert_same(read_spots(out), list(track(images, SubpixelSettings(camera=CAMERA))))


def test_poses_leave_their_age_beside_the_frames(tmp_path, images):
    video, poses, out = tmp_path / "video.avi", tmp_path / "poses.csv", tmp_path / "spots.csv"
    write_video(video, images, hz=10.0)
    poses.write_text("time_s,x_mm,y_mm,z_mm,axis_x,axis_y,axis_z\n0.15,0,0,0,0,0,-1\n")
    summary = json.loads(run(video, "--out", out, "--poses", poses, "--json").stdout)
    ages = [record.pose_age_s for record in read_spots(out)]
    expected = [math.nan, math.nan, 0.05, 0.15, 0.25, 0.35, 0.45, 0.55]
    assert ages == pytest.approx(expected, nan_ok=True)
    assert summary["median_pose_age_s"] == pytest.approx(0.3)


@pytest.mark.slow
def test_the_robots_axis_is_turned_into_the_eye_for_the_exact_model(tmp_path, images, microscope):
    bag, out = tmp_path / "rig.bag", tmp_path / "spots.csv"
    turn = Rotation.from_euler("xyz", [0.4, -0.2, 0.3])  # from the robot to the eye
    axis = Rotation.from_euler("x", 0.3).apply([0.0, 0.0, -1.0])  # in the eye
    # The fibre is not parallel to its tool, and the calibration contains the angles.
    off = np.array([0.03, -0.02, 1.0]) / math.hypot(0.03, 0.02, 1.0)
    tool, _ = Rotation.align_vectors(turn.inv().apply(axis)[None], off[None])
    askew = tmp_path / "askew.json"
    beam = {"k": 20.0, "b": -4.5, "beam_x": 0.03, "beam_y": -0.02}
    write_calibration(askew, a_calibration(beam))
    stamped = [Frame(index=k, time_s=1.0 + k / 10, image=images[k]) for k in range(2)]
    rotation = tuple(tool.as_quat().tolist())
    pose = Pose(rotation=rotation, time_s=0.9, position_mm=(0.0, 0.0, 0.0))
    write_bag(bag, frames=stamped, poses=[pose])
    quaternion = ",".join(map(repr, turn.as_quat().tolist()))
    options = ("--calibration", askew, "--rig", microscope, "--model", "exact")
    known = ("--poses", bag, "--set", f"robot.eye_from_robot=[{quaternion}]")
    assert run(bag, "--out", out, *options, *known).exit_code == 0
    ranger = Ranger(read_calibration(askew), read_microscope(microscope), model="exact")
    for record in read_spots(out):
        assert isinstance(record.result, Spot)
        with_axis = ranger.distance(record.result, axis=axis)
        without = ranger.distance(record.result)
        assert record.distance_mm == pytest.approx(with_axis.distance_mm, abs=1e-6)
        # The test could fail: the axis says more than the contour alone.
        assert with_axis.sigma_mm < without.sigma_mm


def off_the_line_px(picture, image, ellipse):
    """Distance from an ellipse, to first order, of pixels that a line went through below the text.

    Without the cross in the middle.
    """
    change = np.abs(picture.astype(int) - image).max(axis=2)
    rows, columns = np.nonzero(change > 80)  # of the 135 and more that the line's colour differs
    x0, y0, major, minor, angle = ellipse
    u, v = columns[rows > 30] - x0, rows[rows > 30] - y0
    c, s = math.cos(angle), math.sin(angle)
    off = (np.hypot((u * c + v * s) / major, (v * c - u * s) / minor) - 1) * minor
    return off[off > -15]


def test_the_overlay_folder_shows_each_ellipse_where_the_spot_is(tmp_path, frames, images):
    folder = tmp_path / "overlay"
    assert run(frames, "--out", tmp_path / "spots.csv", "--overlay", folder).exit_code == 0
    pictures = sorted(folder.iterdir())
    assert [path.name for path in pictures] == [f"{k:06d}.png" for k in range(8)]
    for k, path in enumerate(pictures):
        stored = cv2.imread(str(path))
        assert stored is not None
        one = truth(k)
        ellipse = one.x, one.y, one.semi_major, one.semi_minor, one.angle
        off = off_the_line_px(stored[:, :, ::-1], images[k], ellipse)
        if k == GONE:
            assert len(off) == 0
            continue
        assert len(off) > 50
        assert np.abs(off).max() < 1.5  # a line of 1 px, smoothed over its neighbours


def test_the_overlay_of_a_distorting_lens_is_drawn_as_the_lens_sees_it(images):
    seen, ideal = (
        next(track(images, SubpixelSettings(camera=camera))) for camera in (None, CAMERA)
    )
    assert isinstance(seen, Spot)
    assert isinstance(ideal, Spot)
    frame = Frame(index=0, time_s=0.0, image=images[0])
    record = SpotRecord(frame=0, file_name="", time_s=0.0, mode="subpixel", result=ideal)
    picture = annotated(frame, record, response=Response(), camera=CAMERA)
    assert np.abs(off_the_line_px(picture, images[0], seen.ellipse)).max() < 1.5
    # The test could fail: without the camera the drawing would lie elsewhere.
    plain = annotated(frame, record, response=Response())
    assert np.abs(off_the_line_px(plain, images[0], seen.ellipse)).max() > 1.5


@pytest.mark.parametrize("dtype", ["uint16", "float32"])
def test_an_overlay_is_as_bright_as_its_frame(dtype):
    full_scale = {"uint16": 4095, "float32": 1}[dtype]
    image = (np.full((40, 50), 0.5) * full_scale).astype(dtype)
    frame = Frame(index=0, image=image)
    record = SpotRecord(frame=0, file_name="", time_s=math.nan, mode="", result=NOTHING)
    picture = annotated(frame, record, response=Response(full_scale=full_scale))
    assert picture[-1, -1].tolist() == pytest.approx([127.5] * 3, abs=0.6)


@pytest.mark.parametrize("name", ["overlay.mp4", "overlay.avi"])
def test_the_overlay_video_has_every_frame(tmp_path, frames, name):
    video = tmp_path / name
    assert run(frames, "--out", tmp_path / "spots.csv", "--overlay", video).exit_code == 0
    capture = cv2.VideoCapture(str(video))
    shapes = [picture.shape[:2] for seen, picture in (capture.read() for _ in range(9)) if seen]
    assert shapes == 8 * [SHAPE]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--start", "12"], ["X,Y in px", "'12'"]),
        (["--start", "500,80"], ["(500, 80) px", "200x160 px"]),
        (["--out", "spots.txt"], [".csv or .parquet"]),
        (["--out", "none/spots.csv"], ["none is not a folder"]),
        (["--overlay", "overlay.mov"], [".mp4, .avi", "folder", "'.mov'"]),
        (["--exposure", "paper"], ["is not a stack"]),
        (["--model", "planar"], ["--model needs --calibration"]),
        (["--calibration", "CALIBRATION"], ["--calibration needs the microscope", "--rig FILE"]),
        (["--rig", "DISTORTED"], ["pinhole_height_mm"]),
        (["--rig", "missing.json"], ["missing.json", "Check the path."]),
        (["--mode", "literal", "--rig", "DISTORTED", *EYE], ["literal", "distortion"]),
        (["--poses", "missing.csv"], ["missing.csv", "Check the path"]),
        (["--poses", "POSES"], ["has no time", "Leave the poses out"]),
        (["--rig", "OTHER SIZE"], ["200x160 px", "640x160 px"]),
    ],
)
def test_bad_input_is_one_message_and_leaves_nothing_behind(
    monkeypatch, tmp_path, frames, distorted, calibration, microscope, options, words
):
    microscope.write_text(microscope.read_text().replace("200", "640", 1))
    poses = tmp_path / "poses.csv"
    poses.write_text("time_s,x_mm,y_mm,z_mm,axis_x,axis_y,axis_z\n0,0,0,0,0,0,-1\n")
    files = {"DISTORTED": distorted, "CALIBRATION": calibration, "POSES": poses}
    files["OTHER SIZE"] = microscope
    before = sorted(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    arguments = [files.get(option, option) for option in options]
    outcome = run(frames, "--out", "spots.csv", *arguments)
    outcome.assert_bad_input(*words)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("option", ["--out", "--overlay"])
def test_nothing_is_written_over(tmp_path, frames, option):
    there = tmp_path / ("there.csv" if option == "--out" else "there")
    there.write_text("precious")
    options = {"--out": tmp_path / "spots.csv"} | {option: there}
    outcome = run(frames, *(part for pair in options.items() for part in pair))
    outcome.assert_bad_input(f"{there} already exists")
    assert there.read_text() == "precious"


def test_a_source_that_breaks_leaves_its_frames_and_one_message(tmp_path, frames, images):
    broken, out = frames / "5.png", tmp_path / "spots.csv"
    broken.write_bytes(broken.read_bytes()[:1000])
    outcome = run(frames, "--out", out, "--overlay", tmp_path / "overlay", "--json")
    outcome.assert_bad_input("5.png (frame 5) is truncated", f"{out} holds the 5 frames before")
    assert json.loads(outcome.stdout)["ended"] == "broken"
    assert_same(read_spots(out), list(track(images[:5], SubpixelSettings())))
    assert len(list((tmp_path / "overlay").iterdir())) == 5


def test_frames_of_two_sizes_do_not_fit_into_one_video(tmp_path, frames, images):
    cv2.imwrite(str(frames / "3.png"), np.zeros((90, 90), np.uint8))
    video = tmp_path / "video.mp4"
    outcome = run(frames, "--unrelated", "--out", tmp_path / "spots.csv", "--overlay", video)
    outcome.assert_bad_input("one size", "Choose a folder")
    assert len(read_spots(tmp_path / "spots.csv")) == 3


def test_a_real_process_prints_one_line_for_a_broken_video(tmp_path):
    """OpenCV and FFmpeg say nothing of their own beside it."""
    path = tmp_path / "video.mp4"
    path.write_bytes(b"\0\0\0\x18ftypmp42" + bytes(500))
    done = command_line.run_process("track", path, "--out", tmp_path / "spots.csv")
    done.assert_bad_input(str(path))


def test_ctrl_c_between_writing_and_counting_a_video_frame_is_no_fault(
    tmp_path, images, monkeypatch
):
    writer = cv2.VideoWriter()
    interrupted = mock.Mock(wraps=writer)

    def write(picture: np.ndarray) -> None:
        writer.write(picture)
        if interrupted.write.call_count == 2:
            raise KeyboardInterrupt

    interrupted.write.side_effect = write
    opened = mock.Mock(return_value=interrupted, fourcc=cv2.VideoWriter.fourcc)
    monkeypatch.setattr(cv2, "VideoWriter", opened)
    video = tmp_path / "overlay.mp4"
    record = SpotRecord(frame=0, file_name="", time_s=0.0, mode="subpixel", result=NOTHING)
    frame = Frame(index=0, time_s=0.0, image=images[0])
    with overlay_writer(video, rate_hz=10.0, response=Response()) as draw:
        draw(frame, record)
        with suppress(KeyboardInterrupt):
            draw(frame, record)
    assert video.stat().st_size > 0


def far_apart() -> list[np.ndarray]:
    """Two images with spots further from each other than a spot jumps between frames: 80 px."""
    rng = np.random.default_rng(3)
    places = [Truth(x=x, y=80, semi_major=33, semi_minor=30) for x in (50, 150)]
    return [frame_of(Drawing(truth=place), rng, SHAPE) for place in places]


@pytest.mark.parametrize(
    ("names", "options", "unrelated"),
    [
        (["eye.png", "phantom.png"], [], True),
        (["a1.png", "b2.png"], [], True),
        (["frame_08.png", "frame_10.png"], [], False),
        (["frame_08.png", "frame_10.png"], ["--unrelated"], True),
        (["eye.png", "phantom.png"], ["--sequence"], False),
    ],
)
def test_images_that_are_not_counted_are_measured_one_by_one(tmp_path, names, options, unrelated):
    folder, out = write_folder(tmp_path / "images", far_apart(), "{}.png"), tmp_path / "spots.csv"
    for k, name in enumerate(names):
        (folder / f"{k}.png").rename(folder / name)
    summary = json.loads(run(folder, "--out", out, "--json", *options).stdout)
    assert summary["unrelated"] == unrelated
    settings = SubpixelSettings()
    by_itself = [next(track([image], settings)) for image in far_apart()]
    # In a sequence, such a jump is believed only when it is seen twice.
    expected = by_itself if unrelated else [by_itself[0], NoSpot(Reason.AMBIGUOUS)]
    assert_same(read_spots(out), expected)


def test_three_numbers_with_a_gap_are_no_recording(tmp_path):
    folder = write_folder(tmp_path / "images", far_apart()[:1] * 7, "IMG_{}.png")
    for number in (0, 3, 4, 5):
        (folder / f"IMG_{number}.png").unlink()
    summary = json.loads(run(folder, "--out", tmp_path / "spots.csv", "--json").stdout)
    assert summary["unrelated"]


def test_an_image_of_another_size_begins_a_new_sequence():
    small, other = far_apart()
    large = np.pad(other, ((40, 0), (90, 0), (0, 0)), mode="edge")
    reader = new_reader()
    reader.read(Frame(index=0, image=small))
    alone = next(track([large], SubpixelSettings()))
    np.testing.assert_equal(vars(reader.read(Frame(index=1, image=large)).result), vars(alone))


def test_the_table_says_how_the_images_were_taken(tmp_path):
    folder = write_folder(tmp_path / "images", far_apart(), "{}.png")
    assert "--unrelated" in run(folder, "--out", tmp_path / "a.csv").stdout
    assert "--sequence" in run(folder, "--out", tmp_path / "b.csv", "--unrelated").stdout
