"""The rig file: every key explained, wrong ones named, files of 0.1 and 0.2 taken in its place."""

import json
import math
import tomllib

import numpy as np
import pytest

import eyespot
from eyespot.estimator import Recording
from eyespot.estimator.run.option_names import MOVED
from eyespot.estimator.run.options import Options
from eyespot.estimator.run.rig_check import checked
from eyespot.formats.camera_sheet import CameraSheet
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import Pose, PoseTrack
from eyespot.formats.rig import Rig, read_rig, rig_in, rig_of_scene, rig_template
from eyespot.formats.settings_files import table_lines
from tests.support.command_line import call, printed
from tests.support.drawn.drawn_recording import write_folder
from tests.support.drawn.drawn_spots import disc
from tests.support.drawn.made_up import a_microscope_file, an_opencv_file

NUMBERS = {
    "microscope.width_px": 320,
    "microscope.height_px": 240,
    "microscope.scale_mm_px": 0.0134,
    "microscope.pinhole_height_mm": 200.0,
    "wall.radius_mm": 11.5,
    "wall.medium": "air",
    "robot.eye_from_robot": [0.0, 0.0, 0.0, 1.0],
}


def test_the_template_has_every_key_with_its_meaning_and_changes_nothing(tmp_path):
    path = tmp_path / "rig.toml"
    printed("rig", "init", path)
    assert read_rig(path).model_dump() == Rig().model_dump()
    text = path.read_text()
    for name, field in Rig.model_fields.items():
        for key, own in (
            getattr(field.default, "__class__", Rig).__dict__.get("__pydantic_fields__", {}).items()
        ):
            assert f"\n{key} = " in text or f"\n# {key} = " in text, f"{name}.{key}"
            assert own.description, f"{name}.{key}"
    assert call(["rig", "init", str(path)]).exit_code != 0  # never written over


def test_what_is_commented_out_in_the_template_is_a_possible_value():
    """A person takes the # away."""
    for name, field in Rig.model_fields.items():
        for line in (
            table_lines(name, type(field.default)) if hasattr(field.default, "model_dump") else ()
        ):
            if line.startswith("# ") and " = " in line:
                value = tomllib.loads(line.removeprefix("# "))
                rig_in({name: value}, where="the template")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("robot.unti=mm", "unknown key 'robot.unti'; did you mean 'unit'"),
        ("robot.eye_from_robot=[0, 0, 0, 2]", "unit quaternion"),
        ("robot.incidence_deg=[40, 10]", "incidence_deg must be two angles"),
        ("robot.touch=[0.1, 0]", "touch needs a positive sigma"),
        ("robot.touch='seen'", "robot.touch: Input should be 'contact' or 'free'; got 'seen'"),
        ("wall.normal=[0, 0, 0]", "zero vector"),
        ("workspace.tilt_deg=[30, 10]", "workspace.tilt_deg: must be the least and the largest"),
        ("instrument.core_radius_mm=0.3", "core_radius_mm = 0.3 is wider than the fibre"),
        ("robot.touch=[-0.1, 0.02]", "touch must not be negative; got -0.1 mm"),
        ("workspace.distance_mm=[0, 6]", "distance_mm must be above 0"),
        ("schema=2", "schema is 2; this eyespot"),
    ],
)
def test_a_wrong_key_or_value_is_named(change, told):
    with pytest.raises(InputError, match=told):
        Rig().changed([change])


@pytest.mark.parametrize(
    ("key", "value"), [("workspace.eccentricity_mm", [0, 12]), ("workspace.distance_mm", [1, 25])]
)
def test_a_workspace_fits_into_its_eye(key, value):
    Rig().changed({key: value, "wall.radius_mm": 15.0})
    with pytest.raises(InputError, match=f"{key} must lie below .* wall.radius_mm = 11.5"):
        Rig().changed({key: value, "wall.radius_mm": 11.5})


def test_a_cone_has_one_angle():
    with pytest.raises(InputError, match="both state the cone"):
        Rig().changed({"beam.half_angle_deg": 5.0, "beam.numerical_aperture": 0.1})


@pytest.mark.parametrize("missing", ["width_px", "height_px", "pinhole_height_mm"])
def test_a_microscope_of_numbers_must_be_whole(missing):
    changes = {key: value for key, value in NUMBERS.items() if not key.endswith(missing)}
    with pytest.raises(InputError, match=rf"microscope\.{missing} is missing"):
        _ = Rig().changed(changes).view


def test_numbers_a_camera_file_and_a_microscope_file_are_one_microscope(tmp_path):
    numbers = Rig().changed(NUMBERS).view
    file = a_microscope_file(tmp_path, (320, 240), scale_mm_px=0.0134, pinhole_height_mm=200.0)
    focal = 211.5 / 0.0134
    matrix = np.array([[focal, 0, 159.5], [0, focal, 119.5], [0, 0, 1.0]])
    camera = an_opencv_file(
        tmp_path / "camera.yaml",
        image_width=320,
        image_height=240,
        camera_matrix=matrix,
        distortion_coefficients=np.zeros((1, 5)),
    )
    rig = tmp_path / "rig.toml"
    rig.write_text(
        f'[microscope]\ncalibration = "{camera.name}"\npinhole_height_mm = 200.0\n'
        "[wall]\nradius_mm = 11.5\n"
    )
    for view in (numbers, read_rig(file).view, read_rig(rig).view):
        assert view is not None
        assert view.scale_mm_px == pytest.approx(0.0134, rel=1e-9)
        assert view.principal_point_px == pytest.approx((159.5, 119.5))
        np.testing.assert_allclose(np.asarray(view.camera_matrix, float), matrix, rtol=1e-9)
    with pytest.raises(
        InputError, match=r"rig\.toml: microscope\.scale_mm_px is that of camera\.yaml"
    ):
        _ = read_rig(rig, ["microscope.scale_mm_px=0.0134"]).view


def test_a_rig_that_is_written_is_read_from_elsewhere(tmp_path):
    a_microscope_file(tmp_path)
    other = tmp_path / "other"
    other.mkdir()
    sheet = CameraSheet(full_well_e=9e3, read_noise_e=5.0, black_level_dn=2.0, bit_depth=8)
    rig = read_rig(tmp_path / "microscope.json", ["wall.medium=water"]).with_noise(sheet)
    (other / "rig.toml").write_text(rig.toml(other))
    again = read_rig(other / "rig.toml")
    assert again.wall.medium == "water"
    assert again.view is not None
    assert again.view.noise == sheet


def test_the_range_of_video_is_taken_out_before_the_curve():
    response = Rig().changed({"camera.limited_range": True, "camera.response": 2.2}).response
    grey = np.array([16, 235], np.uint8)
    np.testing.assert_allclose(response.light(grey, 255.0), [0.0, 255.0], atol=1e-3)
    # BT.601: 16 + 219 V; the curve's inverse is V ** 2.2.
    middle = np.array([16 + 219 // 2], np.uint8)
    assert response.light(middle, 255.0)[0] == pytest.approx(255 * (109 / 219) ** 2.2, rel=1e-5)


@pytest.mark.parametrize("name", MOVED)
def test_an_option_that_moved_names_its_key(name):
    with pytest.raises(InputError, match=r"--rig"):
        Options.of({name: 1})
    outcome = call(["track", "x", "--out", "y.csv", f"--{name.replace('_', '-')}", "1"])
    assert outcome.exit_code == 1  # the exception is the command line's own


def withdrawal(**lies):
    """A cone's withdrawal from contact (k 20, fibre of 0.5 mm) in 12 drawn frames, on a rig."""
    begin, unit, sign = lies.pop("begin_mm", 0.0), lies.pop("unit", 1.0), lies.pop("sign", 1.0)
    gone = np.linspace(0.0, 3.0, 12)
    sizes = (gone + begin + 5.0) / 20 / 0.0134
    noise = np.random.default_rng(0)
    frames = [
        np.rint(disc((240, 320), 160, 120, size) + noise.normal(0, 2, (240, 320))).astype(np.uint8)
        for size in sizes
    ]
    axis = (0.0, 0.0, -1.0)
    poses = PoseTrack(
        Pose.along(axis, time_s=n / 10, position_mm=(0.0, 0.0, sign * unit * d))
        for n, d in enumerate(gone)
    )
    rig = Rig().changed(NUMBERS | lies)
    return Recording(np.stack(frames), times=np.arange(12) / 10, poses=poses, rig=rig)


def verdicts(recording):
    lines = checked(recording).lines
    return dict(zip(lines.key, lines.verdict, strict=True))


def test_a_rig_that_is_as_its_file_says_is_not_contradicted():
    assert "wrong" not in verdicts(withdrawal()).values()


@pytest.mark.parametrize(
    ("lie", "key"),
    [
        ({"begin_mm": 1.5}, "robot.touch"),
        ({"unit": 1e-3}, "robot"),
        ({"unit": 1e3}, "robot"),
        ({"unit": 0.0}, "robot"),
        ({"sign": -1.0}, "robot"),
        ({"robot.eye_from_robot": [1.0, 0.0, 0.0, 0.0]}, "robot.eye_from_robot"),
        ({"microscope.width_px": 640}, "microscope.width_px"),
        ({"camera.black_level_dn": 90.0}, "camera.black_level_dn"),
        ({"microscope.pinhole_height_mm": 0.2}, "microscope.pinhole_height_mm"),
        ({"wall.radius_mm": 0.005}, "wall.radius_mm"),
        ({"microscope.principal_point_px": [2000.0, 120.0]}, "wall.radius_mm"),
    ],
)
def test_a_rig_that_lies_is_contradicted(lie, key):
    if "microscope.width_px" in lie:
        with pytest.raises(InputError, match="320x240 px, but"):
            checked(withdrawal(**lie))
        return
    assert verdicts(withdrawal(**lie))[key] == "wrong"


def test_frames_of_one_time_are_contradicted():
    recording = withdrawal()
    frames = np.stack([frame.image for frame in recording.source])
    times = np.repeat(np.arange(6) / 5, 2)
    at_once = Recording(frames, times=times, poses=recording.robot(), rig=recording.rig)
    found = checked(at_once).lines.set_index("key").found["times"]
    assert "6 frames have the time of another" in [*found]


def test_frames_while_the_robots_file_says_nothing_are_contradicted():
    recording = withdrawal()
    known = recording.robot()
    dense = np.linspace(0.0, 1.1, 221)
    some = dense[(dense < 0.35) | (dense > 0.75)]
    poses = PoseTrack(pose for time_s in some if (pose := known.interpolated(float(time_s))))
    gap = Recording(recording.source, poses=poses, rig=recording.rig)
    lines = checked(gap).lines
    (found,) = lines[lines.verdict == "wrong"].itertuples()
    assert found.found == "none from 0.345 to 0.755 s"
    assert found[-1].startswith("4 frames lie between")


def test_a_noisy_robot_at_one_speed_does_not_tell_the_clock():
    recording = withdrawal()
    known, noise = recording.robot(), np.random.default_rng(2)
    poses = PoseTrack(
        Pose.along(
            (0.0, 0.0, -1.0),
            time_s=float(time_s),
            position_mm=tuple(np.add(pose.position_mm, noise.normal(0.0, 0.005, 3))),
        )
        for time_s in np.linspace(0.0, 1.1, 221)
        if (pose := known.interpolated(float(time_s)))
    )
    noisy = Recording(recording.source, poses=poses, rig=recording.rig)
    assert verdicts(noisy)["robot.clock_offset_s"] == "unknown"


def test_a_recording_that_began_late_is_no_matter_of_the_model():
    fit = eyespot.fit(withdrawal(begin_mm=1.5))
    assert (fit.model, fit.good) == ("cone", False)
    # (5 + 1.5) / 20 mm
    assert "the light leaves the tip with a radius of 0.32" in fit.verdict


def test_a_turn_is_proposed_for_a_robot_whose_z_points_down():
    recording = withdrawal(**{"robot.eye_from_robot": [0.0, 0.0, 0.0, 1.0]})
    content = {key: value for key, value in NUMBERS.items() if "eye_from" not in key}
    down = PoseTrack(
        Pose(time_s=pose.time_s, position_mm=(0.0, 0.0, -pose.position_mm[2]))
        for pose in recording.robot()
    )
    recording = Recording(recording.source, poses=down, rig=Rig().changed(content))
    lines = checked(recording).lines.set_index("key")
    # The tool's +z is the robot's +z: a half turn about x or y points it at the wall.
    assert "proposed [1.0, 0.0, 0.0, 0.0]" in lines.found["robot.eye_from_robot"]


def test_the_command_writes_one_picture_and_says_what_is_wrong(tmp_path):
    recording = withdrawal()
    folder = write_folder(tmp_path / "images", [frame.image for frame in recording.source])
    (tmp_path / "rig.toml").write_text(recording.rig.toml(tmp_path))
    out = tmp_path / "check.png"
    said = printed("rig", "check", tmp_path / "rig.toml", folder, "--fps", "10", "--out", out)
    assert "12 of 12 frames" in said
    assert out.read_bytes().startswith(b"\x89PNG")


def test_poses_that_cannot_be_read_contradict_and_brackets_stay(tmp_path):
    recording = withdrawal()
    folder = write_folder(tmp_path / "images[a]", [frame.image for frame in recording.source])
    (tmp_path / "rig.toml").write_text(recording.rig.toml(tmp_path))
    (tmp_path / "robot.csv").write_text("a,b\n1,2\n")
    words = ("--fps", "10", "--poses", tmp_path / "robot.csv", "--out", tmp_path / "check.png")
    done = call(["rig", "check", *map(str, (tmp_path / "rig.toml", folder, *words))])
    assert done.exit_code == 1
    said = done.stdout
    assert "1 line is wrong" in said
    assert "no times among the columns 'a', 'b'" in said
    assert "images[a]: 12 of 12 frames" in said


def test_the_template_of_a_rendered_scene_has_its_numbers():
    scene = {"phantom": {"kind": "plane"}, "motion": {"kind": "withdrawal", "start_mm": 0.5}}
    rig = rig_in(rig_of_scene(scene), where="a scene")
    assert (rig.wall.kind, rig.robot.touch) == ("plane", "free")
    assert json.loads(json.dumps(rig_of_scene({})))["robot"]["touch"] == "free"
    for lens, rim_sigma_mm in [("dome", 0.0), ("my/drop.toml", 0.05)]:
        rig = rig_in(rig_of_scene({"source": {"lens": lens}}), where="a scene")
        assert rig.instrument.rim_height_sigma_mm == rim_sigma_mm
    cone = {"kind": "cone", "cone_k": 11.6, "cone_apex_offset_mm": -5.117}
    for schema, rim_mm in [(1, 5.117 / 11.6), (2, 0.25)]:  # which rim touches, see the renderer's
        wide = {"schema": schema, "source": cone, "instrument": {"fibre_diameter_mm": 0.5}}
        rig = rig_in(rig_of_scene(wide), where="a scene")
        assert math.isclose(rig.instrument.fibre_diameter_mm, 2 * rim_mm)
    assert math.isclose(rig.robot.touch_sigma_mm, 0.02)
    assert "touch_sigma_mm = 0.02" in rig_template()
