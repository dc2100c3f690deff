"""Camera calibrations of OpenCV, ROS and Kalibr: each form gives the camera that it describes."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.formats.camera_sheet import LensDistortion
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spot import Spot
from tests.support.drawn.drawn_spots import spot_in

FOCAL, CENTRE, SIZE = 800.0, np.array([162.25, 118.5]), (320, 240)
MATRIX = np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1]])
FISHEYE = [-0.5, 0.1, 0.02, 0.178]
BROWN = [-0.21, 0.13, 1e-3, -2e-3, 0.05]
RATIONAL = [*BROWN, 0.11, -0.05, 0.02]
EYE: dict[str, Any] = {"pinhole_height_mm": 200.0, "eye_radius_mm": 11.5}

POINTS = np.random.default_rng(0).uniform((5, 5), (315, 235), (200, 2))
"""Where an ideal pinhole sees some points, px."""


def equidistant(points: np.ndarray) -> np.ndarray:
    """Where the fisheye sees them: theta_d = theta (1 + k1 theta^2 + ... + k4 theta^8)."""
    offset = (points - CENTRE) / FOCAL
    tangent = np.hypot(*offset.T)
    theta = np.arctan(tangent)
    bent = theta + sum(k * theta ** (3 + 2 * n) for n, k in enumerate(FISHEYE))
    return CENTRE + FOCAL * offset * (bent / tangent)[:, None]


def polynomial(points: np.ndarray, k: list[float]) -> np.ndarray:
    """Where a lens of Brown's model sees them: plumb_bob, and with k4 to k6 the rational model."""
    x, y = ((points - CENTRE) / FOCAL).T
    r2 = x**2 + y**2
    k1, k2, p1, p2, k3, k4, k5, k6 = [*k, 0, 0, 0, 0][:8]
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    bent = [
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
    ]
    return CENTRE + FOCAL * np.stack(bent, axis=1)


def ros_yaml(model: str | None, d: list[float]) -> str:
    """As camera_calibration writes it."""
    said = f"distortion_model: {model}\n" if model is not None else ""
    return (
        f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: scope\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {MATRIX.ravel().tolist()}\n{said}"
        f"distortion_coefficients:\n  rows: 1\n  cols: {len(d)}\n  data: {d}\n"
    )


def info(model: str, d: list[float], **changed: Any) -> dict[str, Any]:
    """A CameraInfo."""
    return {
        "header": {"stamp": {"sec": 5, "nanosec": 1}, "frame_id": "scope"},
        "height": SIZE[1],
        "width": SIZE[0],
        "distortion_model": model,
        "d": d,
        "k": MATRIX.ravel().tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": np.c_[MATRIX, [0, 0, 0]].ravel().tolist(),
        "binning_x": 0,
        "binning_y": 0,
        "roi": dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
        | {"do_rectify": False},
    } | changed


def echo(model: str, d: list[float]) -> str:
    """What `ros2 topic echo` prints of two messages."""
    later = {"header": {"stamp": {"sec": 6, "nanosec": 0}, "frame_id": "scope"}}
    both = (info(model, d), info(model, d, **later))
    return "".join(yaml.safe_dump(one, sort_keys=False) + "---\n" for one in both)


def rostopic(model: str, d: list[float]) -> str:
    """What `rostopic echo` of ROS 1 prints, with capital letters."""
    said = {k.upper() if len(k) == 1 else k: v for k, v in info(model, d).items()}
    return yaml.safe_dump(said, default_flow_style=None) + "---\n"


def opencv(suffix: str, d: list[float], **others: Any) -> str:
    storage = cv2.FileStorage(f".{suffix}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", SIZE[0])
    storage.write("image_height", SIZE[1])
    for name, value in others.items():
        storage.write(name, value)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", np.array(d)[:, None])
    return storage.releaseAndGetString()


def kalibr(model: str, d: list[float], camera: str = "pinhole") -> str:
    return (
        f"cam0:\n  cam_overlaps: []\n  camera_model: {camera}\n  distortion_coeffs: {d}\n"
        f"  distortion_model: {model}\n  intrinsics: {[FOCAL, FOCAL, *CENTRE.tolist()]}\n"
        f"  resolution: {list(SIZE)}\n  rostopic: /scope/image_raw\n"
    )


FILES = {
    "ros": ros_yaml("equidistant", FISHEYE),
    "echo": echo("equidistant", FISHEYE),
    "rostopic": rostopic("equidistant", FISHEYE),
    "zeros after it": echo("equidistant", [*FISHEYE, 0.0, 0.0, 0.0, 0.0]),
    "kalibr": kalibr("equidistant", FISHEYE),
    **{f"opencv {s}": opencv(s, FISHEYE, fisheye_model=1) for s in ("yml", "json", "xml")},
    **{f"named {s}": opencv(s, FISHEYE, distortion_model="fisheye") for s in ("yml", "xml")},
}


def camera_in(tmp_path: Path, text: str) -> LensDistortion:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    microscope = read_microscope(path, **EYE)
    assert (microscope.width_px, microscope.height_px) == SIZE
    camera = microscope.camera()
    assert camera is not None
    return camera


@pytest.mark.parametrize("name", FILES)
def test_a_fisheye_is_a_fisheye_in_every_form(tmp_path, name):
    camera, seen = camera_in(tmp_path, FILES[name]), equidistant(POINTS)
    assert np.abs(seen - POINTS).max() > 1  # px; taken for plumb_bob, it would be silently wrong
    # Newton's iteration ends at 1e-8 of an angle, 1e-5 px; files have at least 15 digits.
    np.testing.assert_allclose(camera.undistorted(seen), POINTS, atol=1e-4)
    np.testing.assert_allclose(camera.all_distorted(POINTS), seen, atol=1e-8)
    assert camera.can_undistort(seen)


@pytest.mark.parametrize(
    ("text", "k"),
    [
        (ros_yaml("plumb_bob", BROWN), BROWN),
        (ros_yaml(None, BROWN), BROWN),
        (echo("plumb_bob", [*BROWN[:4], 0.0]), BROWN[:4]),
        (ros_yaml("plumb_bob", BROWN[:4]), BROWN[:4]),
        (echo("rational_polynomial", RATIONAL), RATIONAL),
        (rostopic("rational_polynomial", RATIONAL), RATIONAL),
        (opencv("yml", RATIONAL), RATIONAL),
        (opencv("xml", BROWN), BROWN),
        (kalibr("radtan", BROWN[:4]), BROWN[:4]),
    ],
)
def test_the_polynomial_models_are_what_their_names_say(tmp_path, text, k):
    camera, seen = camera_in(tmp_path, text), polynomial(POINTS, k)
    np.testing.assert_allclose(camera.all_distorted(POINTS), seen, atol=1e-8)
    # OpenCV takes five steps, each of which leaves 0.03, the distortion here, of the error.
    np.testing.assert_allclose(camera.undistorted(seen), POINTS, atol=1e-3)


def test_without_distortion_there_is_nothing_to_take_out(tmp_path):
    for text in (
        *(kalibr("none", []), ros_yaml("plumb_bob", [0.0] * 5), echo("", [])),
        *(echo("plumb_bob", []), opencv("yml", [0.0] * 4)),
    ):
        path = tmp_path / "camera.yaml"
        path.write_text(text)
        assert read_microscope(path, **EYE).camera() is None


def test_coefficients_of_zero_do_not_make_a_fisheye_a_pinhole(tmp_path):
    camera = camera_in(tmp_path, ros_yaml("equidistant", [0.0] * 4))
    # r = f theta: at 0.2 rad, 0.00271 f inside of f tan(theta).
    (seen,) = camera.all_distorted(CENTRE[None] + [FOCAL * np.tan(0.2), 0])
    np.testing.assert_allclose(seen - CENTRE, [FOCAL * 0.2, 0], atol=1e-9)


@pytest.mark.parametrize("binning", [1, 2, 3])
@pytest.mark.parametrize("roi", [None, (60, 24, 180, 120)])
def test_binning_and_region_move_the_image_as_they_move_its_pixels(tmp_path, binning, roi):
    """The sensor is averaged by numpy; what lies at its centre of mass is where K says it is."""
    ray, focal = np.array([0.011, -0.017]), FOCAL
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    at = CENTRE + focal * ray
    sensor = np.exp(-0.5 * ((u - at[0]) ** 2 + (v - at[1]) ** 2) / 6**2)
    x, y, width, height = roi or (0, 0, *SIZE)
    rows, columns = height // binning, width // binning
    part = sensor[y : y + rows * binning, x : x + columns * binning]
    frame = part.reshape(rows, binning, columns, binning).mean((1, 3))
    down, right = np.mgrid[: frame.shape[0], : frame.shape[1]]
    place = [float((axis * frame).sum() / frame.sum()) for axis in (right, down)]

    region = {"x_offset": x, "y_offset": y, "width": width, "height": height} if roi else {}
    path = tmp_path / "camera.yaml"
    changed = {"binning_x": binning, "binning_y": binning, "roi": region}
    path.write_text(yaml.safe_dump(info("plumb_bob", BROWN, **changed)))
    microscope = read_microscope(path, **EYE)
    assert (microscope.height_px, microscope.width_px) == frame.shape
    assert microscope.camera_matrix is not None
    seen = (np.array(microscope.camera_matrix) @ [*ray, 1])[:2]
    # The bell ends 7 sigma from the border at the least: 1e-9 of it is missing.
    np.testing.assert_allclose(seen, place, atol=1e-6)
    # A pixel shows n times as much.
    assert microscope.scale_mm_px == pytest.approx(binning * 211.5 / FOCAL, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ros_yaml("thin_prism", BROWN), "must be plumb_bob, rational.*got 'thin_prism'"),
        (ros_yaml("''", BROWN), "must be plumb_bob, rational.*got ''"),
        (kalibr("fov", [0.9]), "must be plumb_bob, .*radtan.*got 'fov'"),
        (kalibr("radtan", BROWN[:4], "omni"), "cam0.camera_model must be pinhole; got 'omni'"),
        (kalibr("none", []) + kalibr("none", []).replace("cam0", "cam1"), "holds cam0, cam1"),
        (kalibr("none", []).replace("240]", "240, 1]"), "resolution must hold 2 numbers"),
        (ros_yaml("plumb_bob", RATIONAL), "plumb_bob has 4 or 5 coefficients; got 8"),
        (ros_yaml("equidistant", BROWN), "equidistant has 4 coefficients; got 5"),
        (ros_yaml("rational_polynomial", BROWN), "has 8 or 12 or 14 coefficients; got 5"),
        (opencv("yml", FISHEYE), "plumb_bob or of a fisheye.*Add a line `distortion_model"),
        (echo("plumb_bob", BROWN) + ros_yaml("plumb_bob", BROWN), "3 parts between --- that diff"),
        (yaml.safe_dump(info("plumb_bob", BROWN, k=[0.0] * 9)), "focal lengths other than 0"),
        (yaml.safe_dump(info("plumb_bob", BROWN, binning_x=2)), "square pixels"),
        (yaml.safe_dump(info("plumb_bob", BROWN, roi={"x_offset": 320})), "roi takes 0 px of it"),
        (yaml.safe_dump(info("plumb_bob", BROWN, roi={"width": 400})), "roi takes 400 px of it"),
        (yaml.safe_dump(info("plumb_bob", BROWN, roi=7)), "roi.x_offset must be one whole"),
        (yaml.safe_dump(info("plumb_bob", BROWN, binning_y=-1)), "binning_y must be one whole"),
        ("a: &a [1]\nb: *a\n", "reference"),
        ("a: " + "[" * 30 + "]" * 30, "levels"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>', "entities"),
        ("hello", "neither a microscope.json"),
    ],
)
def test_what_does_not_describe_one_camera_is_refused_with_its_key(tmp_path, text, words):
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_microscope(path, **EYE)
    assert "\n" not in str(caught.value)


def test_a_spot_under_a_fisheye_is_measured_as_a_pinhole_would_see_it(tmp_path):
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    seen = np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    ideal = seen.copy()
    for _ in range(30):  # each step leaves 4 % of the error, as the lens bends by that much
        ideal += seen - equidistant(ideal)
    x, y, radius = 215.0, 82.0, 40.0
    inside = np.clip(radius + 0.5 - np.hypot(*(ideal - [x, y]).T), 0, 1).reshape(v.shape)
    image = np.rint(20 + 160 * inside).astype(np.uint8)
    camera = camera_in(tmp_path, FILES["ros"])
    spot, state = measure(image, TrackState(), SubpixelSettings(camera=camera))
    assert isinstance(spot, Spot)
    # A drawn edge is rounded to 8 bits: 0.05 px, as for a disc without distortion. Without the
    # camera, the radius is 1 px off, and the centre 1.5 px.
    assert spot.ellipse[:4] == pytest.approx((x, y, radius, radius), abs=0.05)
    blind = spot_in(image)
    assert np.abs(np.subtract(blind.ellipse[:4], (x, y, radius, radius))).max() > 0.5
    # The next frame is searched where this camera sees the ideal middle, 0.3 px beside it.
    assert state.at_px == pytest.approx(equidistant(np.array([[x, y]]))[0], abs=0.05)
