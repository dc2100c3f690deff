"""`eyespot fit`: recordings in, a calibration out where the fit is good, and a reason where not."""

import base64
import math
import re
from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import eyespot
from eyespot import optics, scenes
from eyespot.calibration import Prior, fit_cone
from eyespot.calibration.recorded_trial import recorded_trial
from eyespot.estimator.recording import Recording
from eyespot.formats.calibration import read_calibration
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import Spot
from tests.support.command_line import call, printed
from tests.support.drawn.made_up import a_microscope_file, a_spot
from tests.support.drawn.scene_tables import scene_of
from tests.support.files.bad_input import OLD
from tests.support.files.fit_files import a_recording, assert_within

# As test_cone_fit, with which it shares programs; the first fit of a kind takes 8 s to trace.
pytestmark = pytest.mark.usefixtures("fast_compilation")

SVG = "{http://www.w3.org/2000/svg}"
K, B, SCALE = 20.0, -5.117, 0.0067
A_CONE = str(OLD / "calibration.json")
RIM = 0.25 * np.tan(np.radians(30.0))


def spot(semi_minor: float) -> Spot:
    covariance = np.diag([0.01, 0.01, 0.01, 0.01, 0.001]) ** 2
    return a_spot(320.0, 240.0, 1.15 * semi_minor, semi_minor, 0.3, covariance=covariance)


@pytest.fixture
def rig(tmp_path):
    """Writes what a rig records of a withdrawal from a plane; gives the command's arguments."""
    a_microscope_file(tmp_path, scale_mm_px=SCALE, principal_point_px=[320.0, 240.0])

    def record(name="trial", *, bend=0.0, aside=0.0, outliers=(), seed=0, ending=".csv"):
        rng = np.random.default_rng(seed)
        gone = np.linspace(0.0, 6.0, 16)
        axis = np.array([0.5, 0.0, -np.sqrt(0.75)])
        # The robot's clock is not the camera's: its reports fall between the frames.
        n = np.arange(-0.3, 15.7, 0.2)
        tips = np.outer(-0.4 * n, axis) + np.outer(aside * n / 15, [0.0, 1.0, 0.0])
        poses = np.column_stack([n / 10, tips, np.tile(axis, (n.size, 1))])
        d = gone + RIM + bend * (gone - 3.0) ** 2
        sizes = (d - B) / (K * SCALE) + rng.normal(0, 0.05, gone.size)
        sizes[list(outliers)] += 3.0
        file = tmp_path / f"{name}{ending}"
        return str(file), a_recording(file, map(spot, sizes), np.arange(16) / 10, poses)

    return record


def fit(tmp_path, *arguments, book=True, out="c.json"):
    keys = ("wall.kind=plane", "wall.medium=air", "robot.eye_from_robot=[0.0, 0.0, 0.0, 1.0]")
    rig = ["--rig", str(tmp_path / "microscope.json")]
    rest = [*rig, *(word for key in keys for word in ("--set", key))] if book else []
    return call(["fit", *rest, *arguments, "--out", str(tmp_path / out)])


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_spots_files_of_a_rig_give_the_line_back(rig, tmp_path, ending):
    trials = [rig(f"trial-{seed}", seed=seed, ending=ending) for seed in range(2)]
    poses = [argument for _, path in trials for argument in ("--poses", path)]
    result = fit(tmp_path, *(path for path, _ in trials), *poses, "--model", "plane")
    assert result.exit_code == 0, result.output
    assert "A good fit" in result.output
    found = read_calibration(tmp_path / "c.json")
    assert_within(found, {"k": K, "b": B}, 4)
    # Two touches of 0.02 mm.
    assert found.sigma("b") == pytest.approx(0.02 / np.sqrt(2), rel=0.1)
    assert re.search(r"eyespot \S+, jax \S+, optimistix \S+", found.software)
    assert found.fitted_on.description == f"32 spots of trial-0{ending}, trial-1{ending}"
    page = (tmp_path / "c.html").read_text()
    assert "<b>A good fit.</b>" in page
    # Self-contained: nothing is loaded from elsewhere.
    assert not re.findall(r'(?:src|href)="(?!data:)', page)


def test_a_name_with_markup_is_shown_as_it_is(rig, tmp_path):
    names = "_a$b$[b]c_", "_a$b$[b]d_"
    trials = [rig(name, seed=seed) for seed, name in enumerate(names)]
    poses = [argument for _, path in trials for argument in ("--poses", path)]
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # text as text, not as outlines
        result = fit(tmp_path, *(path for path, _ in trials), *poses, "--model", "plane")
    assert result.exit_code == 0, result.output
    page = (tmp_path / "c.html").read_text()
    drawn = [
        ElementTree.fromstring(base64.b64decode(data))
        for data in re.findall(r"data:image/svg\+xml;base64,([\w+/=]+)", page)
    ]
    texts = ["".join(text.itertext()).strip() for svg in drawn for text in svg.iter(f"{SVG}text")]
    # The legends of both figures; mathematics would have no dollar signs.
    assert [texts.count(f"{name}.csv") for name in names] == [2, 2]


def test_a_bent_line_is_not_called_a_good_fit(rig, tmp_path):
    spots, poses = rig(bend=0.02)
    result = fit(tmp_path, spots, "--poses", poses, "--model", "plane")
    assert isinstance(result.exception, ValueError)
    wrong, remedy, details = str(result.exception).splitlines()
    assert re.search("not a good fit: the residuals of .* have structure", wrong)
    assert "Try --model cone" in remedy
    assert f"{tmp_path / 'c.html'} shows the residuals" in details
    assert not (tmp_path / "c.json").exists()
    assert "Not a good fit" in (tmp_path / "c.html").read_text()


def test_outliers_are_named_and_left_out(rig, tmp_path):
    spots, poses = rig(outliers=(2, 10))
    result = fit(tmp_path, spots, "--poses", poses, "--model", "plane", "--robust")
    assert result.exit_code == 0, result.output
    assert "14 of 16 frames" in result.output
    assert "2 outliers, at readings of 0.80, 4.00 mm" in (tmp_path / "c.html").read_text()
    found = read_calibration(tmp_path / "c.json")
    assert found.values["k"] == pytest.approx(K, rel=0.005)


def test_the_fingerprint_is_that_of_the_data(rig, tmp_path):
    prints: list[str] = []
    for seed in (0, 0, 1):
        spots, poses = rig(seed=seed)
        out = f"{len(prints)}.json"
        fit(tmp_path, spots, "--poses", poses, "--model", "plane", out=out)
        prints.append(read_calibration(tmp_path / out).fitted_on.sha256)
    assert prints[0] == prints[1] != prints[2]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--model", "plane", "--free", "b"], "has no selectable parameter b"),
        (["--model", "plane", "--prior", "scale=0.0067,0.0001"], "--prior scale does nothing"),
        (["--model", "sphere"], "one recording of an eyeball.*got 0"),
        (["--free", "half_angle"], "must contain half_angle and b; b is missing"),
        (["--free", "half_angle,b,sag"], "--free accepts half_angle, .*got 'sag'"),
        (["--prior", "touch=0.1"], "NAME=MEAN,SIGMA.*got 'touch=0.1'"),
        (["--prior", "touch=0.1,-0.2"], "positive sigma"),
        (["--model", "image"], "fits pixels; got 1 sources, of which 1 have no images"),
        (["--lens", "dome"], "--model lens fits pixels; got"),
        (["--lens", "dome", "--model", "cone"], "--lens works with --model lens only"),
        (["--model", "image", "--free", "half_angle,b,sag"], "--free accepts .*blur.*got 'sag'"),
        (["--model", "eye", "--free", "scale,b"], "half_angle and b; half_angle is missing"),
        (["--model", "eye", "--robust"], "works with the models"),
        (["--robust"], "works with the models plane and sphere only"),
        (["--poses", "a.csv", "--poses", "b.csv"], "--poses must be given once, or once per"),
        (["--model", "plane", "--calibration", A_CONE], "does not work with --lens, nor with the"),
    ],
)
def test_what_makes_no_sense_is_refused(rig, tmp_path, arguments, told):
    spots, poses = rig()
    result = fit(tmp_path, spots, "--poses", poses, *arguments)
    assert isinstance(result.exception, ValueError), result.output
    assert re.search(told, str(result.exception))
    assert not (tmp_path / "c.json").exists()


def test_a_recording_that_is_no_stack_needs_its_rig(rig, tmp_path):
    spots, _ = rig()
    result = fit(tmp_path, spots, book=False)
    assert re.search("wall.medium is not stated.*--rig", str(result.exception))


def recorded(tmp_path, spots, poses, **changes):
    """The recording of a rig that is known, but for some keys."""
    rig = {"wall.kind": "plane", "wall.medium": "air", "robot.eye_from_robot": [0.0, 0.0, 0.0, 1.0]}
    keys = (key if "." in key else f"robot.{key}" for key in changes)
    changed = rig | dict(zip(keys, changes.values(), strict=True))
    return Recording.open(spots, rig=tmp_path / "microscope.json", changes=changed, poses=poses)


def test_spots_beside_the_wall_are_refused_with_the_keys_that_place_them(rig, tmp_path):
    spots, poses = rig()
    a_microscope_file(tmp_path, scale_mm_px=10 * SCALE, principal_point_px=[100.0, 240.0])
    # 220 px of 0.067 mm are 14.7 mm.
    said = r"16 of 16 spots lie beside the wall: up to 14\.7 mm.*radius\. Correct.*scale_mm_px"
    with pytest.raises(InputError, match=said):
        recorded_trial(recorded(tmp_path, spots, poses, **{"wall.kind": "eyeball"}))


def test_a_straight_motion_need_not_be_along_the_tools_axis(rig, tmp_path):
    spots, poses = rig(aside=0.2)
    trial = recorded_trial(recorded(tmp_path, spots, poses)).trial
    np.testing.assert_allclose(trial.axis, [0.5, 0.0, -np.sqrt(0.75)], atol=1e-9)
    # 0.2 mm sideways over 6 mm, reversed: 1.9 degrees.
    expected = np.array([3.0, -0.2, -6.0 * np.sqrt(0.75)])
    assert trial.motion is not None
    np.testing.assert_allclose(trial.motion, expected / np.linalg.norm(expected), atol=1e-9)


def test_readings_are_those_of_the_moment_between_two_reports(rig, tmp_path):
    spots, poses = rig()
    readings = recorded_trial(recorded(tmp_path, spots, poses)).trial.readings
    # The latest report lags by up to 0.2 of a frame, 0.08 mm.
    np.testing.assert_allclose(readings, np.linspace(0.0, 6.0, 16), atol=1e-9)


def test_frames_beyond_the_robots_reports_are_refused(rig, tmp_path):
    spots, poses = rig()
    lines = Path(poses).read_text().splitlines()
    Path(poses).write_text("\n".join(lines[:40]) + "\n")
    with pytest.raises(ValueError, match="until after the last"):
        recorded_trial(recorded(tmp_path, spots, poses))


def test_where_the_touch_is_unknown_somebody_must_say_it(rig, tmp_path):
    spots, poses = rig()
    arguments = "--poses", poses, "--model", "cone", "--set", "robot.touch=free"
    result = fit(tmp_path, spots, *arguments)
    assert "State instrument.core_radius_mm" in str(result.exception), result.output
    given = Prior(0.5, 0.1)
    stated = recorded(tmp_path, spots, poses, touch=[0.5, 0.1])
    assert recorded_trial(stated).trial.touch == given
    assert recorded_trial(recorded(tmp_path, spots, poses), touch=given).trial.touch == given


def test_without_a_touch_the_distances_rest_on_the_core(rig, tmp_path):
    """The tip was withdrawn by 1.2 mm before the first frame, and nobody says so."""
    spots, poses = rig()
    records = pd.read_csv(spots)
    records[records.time_s >= 0.3].to_csv(spots, index=False)
    core = -B / K
    free = recorded(tmp_path, spots, poses, touch="free")
    found = eyespot.fit(free, changes={"instrument.core_radius_mm": core}, model="cone").parameters
    # b = -a/tan(half-angle) with 1 % of a: 0.05 mm.
    assert found.sigma["b"] == pytest.approx(-0.01 * B, rel=0.05)
    assert found.value["b"] == pytest.approx(B, abs=0.01)
    # The robot says that 1.2 mm are missing to within the 0.05 mm of b.
    assert found.value[f"touch of {Path(spots).name}"] == pytest.approx(RIM + 1.2, abs=0.01)


def test_a_robot_known_to_a_tolerance_widens_the_half_angle(rig, tmp_path):
    spots, poses = rig()
    exact, tolerant = (
        eyespot.fit(recorded(tmp_path, spots, poses, scale_sigma=sigma), model="cone").parameters
        for sigma in (0.0, 0.01)
    )
    # tan(half-angle) is a size over a distance, which the robot knows to 1 %.
    assert tolerant.sigma["half_angle"] == pytest.approx(0.01 / K, rel=0.05)
    assert exact.sigma["half_angle"] < 0.1 * tolerant.sigma["half_angle"]


def test_what_a_rig_states_is_in_the_calibration_apart_from_the_data(rig, tmp_path):
    spots, poses = rig()
    sigmas = {"microscope.scale_sigma": 0.02, "robot.scale_sigma": 0.01, "microscope.id": "A"}
    source = recorded(tmp_path, spots, poses, touch=[RIM, 0.02])
    own = Recording.open(source, changes=sigmas)
    found = eyespot.fit(own, model="cone").calibration
    angle, _, covariance = found.cone
    # tan(half-angle) is a size in the image's scale over a distance in the robot's.
    assert math.sqrt(covariance[0, 0]) / angle == pytest.approx(math.hypot(0.02, 0.01), rel=0.02)
    rows = {name: found.stated[name][0] for name in ("scale", "robot_scale", "touch")}
    at = list(found.values).index("half_angle")
    assert rows["scale"][at] / angle == pytest.approx(0.02, rel=0.02)
    assert rows["robot_scale"][at] / angle == pytest.approx(-0.01, rel=0.02)
    assert rows["touch"][list(found.values).index("b")] == pytest.approx(0.02, rel=0.02)
    # Through the same microscope a spot's radius on the wall stands for a distance whatever the
    # scale is: size * scale / tan(half-angle) follows the robot alone.
    scale = list(found.values).index("scale")
    relative = found.covariance / np.outer([*found.values.values()], [*found.values.values()])
    distance = relative[scale, scale] - 2 * relative[scale, at] + relative[at, at]
    assert math.sqrt(distance) == pytest.approx(0.01, rel=0.05)
    # Another microscope does not share it.
    assert found.seen_by("A").values == found.values
    assert "scale" not in found.seen_by("B").values
    assert found.seen_by("B").sigma("half_angle") == found.sigma("half_angle")


def test_a_tip_at_contact_rests_on_the_clear_layer(rig, tmp_path):
    spots, poses = rig()
    keys = {"wall.clear_layer_mm": 0.25, "wall.clear_layer_sigma_mm": 0.06}
    recording = recorded_trial(recorded(tmp_path, spots, poses, **keys))
    # At 30 degrees the layer is longer along the beam.
    touch, longer = recording.trial.touch, 2 / np.sqrt(3)
    assert touch.mean == pytest.approx(RIM + 0.25 * longer, rel=1e-9)
    assert touch.sigma == pytest.approx(np.hypot(0.02, 0.06 * longer), rel=1e-9)


def test_poses_of_the_robot_are_turned_into_the_eyes_frame(rig, tmp_path):
    spots, poses = rig()
    half = np.sqrt(0.5)
    turned = recorded(tmp_path, spots, poses, eye_from_robot=[0.0, 0.0, half, half])
    # A quarter turn about z takes X to Y.
    axis = recorded_trial(turned).trial.axis
    np.testing.assert_allclose(axis, [0.0, 0.5, -np.sqrt(0.75)], atol=1e-12)


def test_a_boresight_in_the_eye_is_an_angle_in_the_tools_frame(rig, tmp_path):
    spots, poses = rig()
    tool = Rotation.from_euler("xyz", [2.8, 0.3, -0.7])
    axis = tool.apply([0.0, 0.0, 1.0])
    n = np.arange(-0.3, 15.7, 0.2)
    rows = np.column_stack([n / 10, np.outer(-0.4 * n, axis), np.tile(tool.as_quat(), (n.size, 1))])
    poses, header = tmp_path / "turned.csv", "time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw"
    np.savetxt(poses, rows, delimiter=",", header=header, comments="")
    turn = Rotation.from_euler("zyx", [0.4, 0.2, -0.1])  # from the robot to the eye
    recording = recorded_trial(
        recorded(tmp_path, spots, poses, eye_from_robot=turn.as_quat().tolist())
    )
    boresight = np.array([0.02, -0.03])
    in_eye = boresight @ np.stack(optics.perpendicular_frame(recording.trial.axis))
    expected = tool.inv().apply(turn.inv().apply(in_eye))
    np.testing.assert_allclose(recording.beam_slopes @ boresight, expected[:2], atol=1e-9)
    assert abs(expected[2]) < 1e-9


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stacks")

    def render(name, *, kind, c, azimuth=0.0, frames=13, **changes):
        incidence = changes.get("incidence", 30.0)
        scene = {
            "phantom": {"kind": kind, "wall": "uniform", **changes.get("phantom", {})},
            "source": {"kind": "cone", "cone_k": K, "cone_apex_offset_mm": B},
            "spot": {"eccentricity_mm": c, "azimuth_deg": azimuth, "incidence_deg": incidence},
            "instrument": {"visible": "incidence" not in changes},
            "motion": changes.get("motion", {"frames": frames}),
            "exposures": {"kinds": ["metered"]},
        }
        if not (folder / name).exists():
            scenes.render_stack(scene_of(scene), folder / name)
        return str(folder / name)

    return render


@pytest.fixture
def stacks(stack):
    return [
        stack("plane", kind="plane", c=1.5),
        stack("far", kind="plane", c=3.0, azimuth=120.0),
        stack("eyeball", kind="eyeball", c=4.0),
        stack("wide", kind="eyeball", c=5.0, azimuth=240.0),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("old", [False, True])
def test_a_cone_far_wider_than_the_papers_is_read_without_an_offset(tmp_path, old):
    """An old file's default b makes a cone of 0.44 mm, which touches before its fibre does."""
    scene = {
        "schema": 1 if old else 2,
        "source": {"kind": "cone", "cone_k": 11.6},
        "motion": {"frames": 6},
        "spot": {"eccentricity_mm": 1.5},
        "exposures": {"kinds": ["metered"]},
    }
    stack = scenes.render_stack(scene_of(scene), tmp_path / "stack")
    printed("fit", stack.folder, "--out", tmp_path / "cone.json")
    found = read_calibration(tmp_path / "cone.json")
    # The touch is known to 0.02 mm; a touch of the wrong rim moves b by 0.12 mm.
    assert found.values["b"] == pytest.approx(-5.117 if old else -11.6 * 0.25585, abs=0.03)


@pytest.mark.slow
def test_the_cone_that_was_rendered_is_found(stacks, tmp_path):
    out = tmp_path / "cone.json"
    printed("fit", *stacks, "--out", out)
    found = read_calibration(out)
    # Asked of rendered cones with camera noise: half-angle within 0.3 %, b within 0.02 mm.
    assert found.values["half_angle"] == pytest.approx(np.arctan(1 / K), rel=0.003)
    assert found.values["b"] == pytest.approx(B, abs=0.02)
    assert_within(found, {"half_angle": np.arctan(1 / K), "b": B}, 4)


@pytest.mark.slow
def test_the_eccentricity_that_was_rendered_is_found(stacks):
    recordings = [recorded_trial(stack) for stack in stacks]
    fit = fit_cone(
        [recording.trial for recording in recordings],
        recordings[0].microscope.pinhole(),
        start={"half_angle": 1.3 / K, "b": 0.7 * B},
    )
    # Asked of rendered cones with camera noise: within 0.01 mm.
    np.testing.assert_allclose(fit.eccentricity, [1.5, 3.0, 4.0, 5.0], atol=0.01)
    assert np.all(np.abs(fit.eccentricity - [1.5, 3.0, 4.0, 5.0]) < 4 * fit.eccentricity_error)


def test_a_perpendicular_withdrawal_from_contact_is_a_good_fit(stack, tmp_path):
    # Its spots are circles, whose measured axes point anywhere, and its first one is as wide as the
    # tip, whose rim is at the wall.
    out = tmp_path / "square.json"
    square = stack("square", kind="eyeball", c=2.0, incidence=0.0)
    assert "A good fit" in printed("fit", square, "--out", out)
    assert_within(read_calibration(out), {"half_angle": np.arctan(1 / K), "b": B}, 4)


@pytest.mark.slow
def test_the_planar_fit_knows_of_the_rim(stacks, tmp_path):
    out = tmp_path / "plane.json"
    printed("fit", *stacks[:2], "--model", "plane", "--out", out)
    assert_within(read_calibration(out), {"k": K, "b": B}, 4)


def test_a_cone_is_not_fitted_through_a_viewing_lens_as_if_there_were_none(rig, tmp_path):
    source, poses = rig()
    series = {"crossing": [1.0], "steepness_per_mm": [0.0], "transmittance": [1.0]}
    path = {**series, "widest_mm": 5.0, "orientation": 1.0}
    a_microscope_file(tmp_path, scale_mm_px=SCALE, viewing_path=path)
    result = fit(tmp_path, source, "--poses", poses, "--model", "cone")
    assert "through a viewing lens" in str(result.exception), result.output


@pytest.mark.parametrize(
    ("given", "told"), [((), "fits pixels"), (("--lens", "dome"), "core_radius is not in --free")]
)
def test_a_core_that_is_free_without_a_lens_may_have_a_prior(rig, tmp_path, given, told):
    source, poses = rig()
    of_core = "--model", "lens", "--prior", "core_radius=0.2,0.01"
    result = fit(tmp_path, source, "--poses", poses, *of_core, *given)
    assert told in str(result.exception), result.output


@pytest.mark.slow
def test_stacks_that_a_fit_cannot_use_say_why(stack, tmp_path):
    tilted = stack("tilted", kind="plane", c=1.5, frames=4, phantom={"tilt_deg": 5.0})
    scan = {"kind": "scan", "length_mm": 1.0, "speed_mm_s": 5.0}
    scanned = stack("scanned", kind="plane", c=1.5, motion=scan)
    late = stack("late", kind="plane", c=1.5, motion={"start_mm": 0.5, "frames": 4})
    for source, model, told in (
        (tilted, "plane", "tilted plane.*Use --model cone"),
        (scanned, "cone", "is no withdrawal"),
        (late, "cone", "robot.touch is free.*--prior touch"),
    ):
        result = call(["fit", source, "--model", model, "--out", str(tmp_path / "c.json")])
        assert re.search(told, str(result.exception)), result.output
    assert recorded_trial(tilted).tilt == pytest.approx((np.tan(np.radians(5.0)), 0.0))
