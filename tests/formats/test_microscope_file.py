"""Microscope files: ours, and what OpenCV and ROS write."""

import json
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from eyespot import optics
from eyespot.formats.inputs import InputError
from eyespot.formats.microscope import read_microscope
from tests.support.drawn.made_up import an_opencv_file, microscope_content

FOCAL, CX, CY = 3432.8, 330.5, 224.25
MATRIX = np.array([[FOCAL, 0, CX], [0, FOCAL, CY], [0, 0, 1.0]])
DISTORTION = np.array([-0.21, 0.13, 1e-3, -2e-3, 0.05])
EYE: dict[str, Any] = {"pinhole_height_mm": 200.0, "eye_radius_mm": 11.5}


def ours(**changed):
    seen: dict[str, Any] = {"principal_point_px": [900.0, -300.0], "pinhole_height_mm": 11.5}
    content = microscope_content(**seen, response="srgb", paper_exposure_s=0.004)
    return {"schema": 1, **content, **changed}


@pytest.fixture
def written(tmp_path):
    def write(text, suffix=".json"):
        path = tmp_path / f"microscope{suffix}"
        path.write_text(text if isinstance(text, str) else json.dumps(text))
        return path

    return write


def test_our_file_is_read(written):
    microscope = read_microscope(written(ours()))
    assert (microscope.width_px, microscope.height_px) == (640, 480)
    assert microscope.scale_mm_px == 0.0067
    assert microscope.principal_point_px == (900.0, -300.0)
    assert microscope.pinhole_height_mm == microscope.eye_radius_mm == 11.5
    assert microscope.response.curve == "srgb"
    assert microscope.paper_exposure_s == 0.004
    assert microscope.camera() is None  # nothing to take out


def test_a_telecentric_microscope_has_no_matrix(written):
    microscope = read_microscope(written(ours(camera_matrix=None, pinhole_height_mm=None)))
    assert math.isinf(microscope.pinhole_height_mm)
    assert microscope.camera() is None
    assert float(microscope.pinhole().inverse_working_distance) == 0.0


def test_a_pinhole_behind_the_retina_is_read_with_its_negative_focal_length(written):
    # 1/kappa = -16.9 mm: a phakic eye behind a flat contact lens.
    f = -16.9 / 0.0067
    matrix = [[f, 0, 900.0], [0, f, -300.0], [0, 0, 1]]
    distorted = ours(camera_matrix=matrix, pinhole_height_mm=-28.4, distortion=DISTORTION.tolist())
    microscope = read_microscope(written(distorted))
    assert microscope.inverse_working_distance == pytest.approx(-1 / 16.9, rel=1e-12)
    pixels = np.array([[640.0, 0.0], [310.0, 400.0]])
    camera = microscope.camera()
    assert camera is not None
    ideal = camera.undistorted(pixels)
    eye = optics.microscope(
        scale=0.0067,
        pinhole_height=-28.4,
        eye_radius=11.5,
        principal_point=(900.0, -300.0),
        distortion=tuple(DISTORTION),
    )
    point, _ = eye.ray(pixels)
    # OpenCV inverts the distortion by five fixed-point steps.
    seen = microscope.ideal_microscope().project(point)
    np.testing.assert_allclose(ideal, seen, atol=1e-3)


def test_opencvs_camera_may_see_through_an_eye_whose_pinhole_lies_behind_the_retina(written):
    microscope = read_microscope(written(ROS, ".yaml"), **EYE | {"pinhole_height_mm": -28.4})
    assert microscope.scale_mm_px == pytest.approx(16.9 / FOCAL, rel=1e-12)
    assert microscope.inverse_working_distance == pytest.approx(-1 / 16.9, rel=1e-12)


def test_a_plane_wall_stands_in_the_file_or_is_added(written):
    normal = (0.0, 0.6, 0.8)
    in_file = read_microscope(written(ours(plane_normal=list(normal))))
    given = read_microscope(written(ROS, ".yaml"), **EYE).changed(plane_normal=normal)
    old = read_microscope(written(ours())).changed(plane_normal=normal)
    assert in_file.plane_normal == given.plane_normal == old.plane_normal == normal
    met = in_file.wall().intersect(jnp.array([0.0, 0.0, 5.0]), jnp.array([0.0, 0.0, -1.0]))
    np.testing.assert_allclose(met.point, jnp.array([0.0, 0.0, -11.5]), atol=1e-12)
    assert isinstance(read_microscope(written(ours())).wall(), optics.Sphere)


@pytest.mark.parametrize(("response", "curve"), [("linear", "linear"), (2.2, "gamma")])
def test_response_curves_keep_their_meaning(written, response, curve):
    read = read_microscope(written(ours(response=response))).response
    assert read.curve == curve
    assert read.gamma == 2.2


@pytest.mark.parametrize("suffix", [".yml", ".yaml", ".json", ".xml"])
@pytest.mark.parametrize(
    "names",
    [
        ("camera_matrix", "distortion_coefficients", "image_width", "image_height"),
        ("Camera_Matrix", "Distortion_Coefficients", "image_Width", "image_Height"),
        ("cameraMatrix", "distCoeffs", "width", "height"),
        ("K", "D", "image_width", "image_height"),
    ],
)
def test_what_opencv_writes_is_read(tmp_path, suffix, names):
    content = dict(zip(names, (MATRIX, DISTORTION, 640, 480), strict=True))
    microscope = read_microscope(an_opencv_file(tmp_path / f"camera{suffix}", **content), **EYE)
    assert (microscope.width_px, microscope.height_px) == (640, 480)
    np.testing.assert_array_equal(microscope.camera_matrix, MATRIX)
    np.testing.assert_array_equal(microscope.distortion, DISTORTION)
    # delta = (z_F + r)/f at the pole.
    assert microscope.scale_mm_px == pytest.approx(211.5 / FOCAL, rel=1e-12)


ROS = """image_width: 640
image_height: 480
camera_name: microscope
camera_matrix:
  rows: 3
  cols: 3
  data: [3432.8, 0, 330.5, 0, 3432.8, 224.25, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.21, 0.13, 0.001, -0.002, 0.05]
"""


@pytest.mark.parametrize("missing", ["pinhole_height_mm", "eye_radius_mm"])
def test_what_opencv_does_not_hold_must_be_given(written, missing):
    given = {name: value for name, value in EYE.items() if name != missing}
    with pytest.raises(InputError, match=f"does not hold {missing}"):
        read_microscope(written(ROS, ".yaml"), **given)


def test_what_stands_in_the_file_must_not_be_given_too(written):
    with pytest.raises(InputError, match="eye_radius_mm is in the file already"):
        read_microscope(written(ours()), eye_radius_mm=12.0)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"camera_matrix": None}, "camera_matrix must be a matrix"),
        ({"pinhole_height_mm": None}, "camera_matrix must be null"),
        ({"scale_mm_px": 0.0068}, "Change both alike"),
        ({"principal_point_px": [0, 0]}, "Change both alike"),
        ({"pinhole_height_mm": -11.5}, "must lie above or below the retinal pole"),
        ({"plane_normal": [0, 0, 2]}, "plane_normal must be a unit vector.*square"),
        ({"plane_normal": [0, 0, -1]}, "plane_normal must be a unit vector.*square"),
    ],
)
def test_nonsense_in_our_file_is_refused_with_file_and_key(written, changed, told):
    path = written(ours(**changed))
    with pytest.raises(InputError, match=told) as error:
        read_microscope(path)
    assert str(error.value).startswith(str(path))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("image_width: 640\n", "", "image_width .or width. is missing"),
        ("width: 640", "width: [640, 480]", "image_width must be one whole number"),
        ("3432.8, 224.25", "3500.0, 224.25", "square pixels.*CALIB_FIX_ASPECT_RATIO"),
        ("[3432.8, 0,", "[3432.8, 20.0,", "square pixels without skew"),
        ("  cols: 3\n", "  cols: 2\n", "9 numbers, but rows and cols say"),
        ("0.05]", "0.05, 1]", "6 numbers, but rows and cols say"),
        ("-0.21", "red", "must hold numbers"),
        ("-0.21, 0.13", ".nan, 0.13", "finite coefficients"),
        ("[3432.8, 0, 330.5, 0, 3432.8, 224.25, 0, 0, 1]", "[]", "0 numbers, but rows and cols"),
    ],
)
def test_nonsense_in_a_ros_file_is_refused(written, old, new, told):
    assert old in ROS
    with pytest.raises(InputError, match=told):
        read_microscope(written(ROS.replace(old, new, 1), ".yaml"), **EYE)


def through_a_path(**changed):
    """Of a line of sight that aims at t and crosses the pole's height at (0.9 - 0.005 t²) t mm."""
    series = {
        "crossing": [0.81, -0.09],  # 0.9 at t = 0, 0.72 at t = 6
        "steepness_per_mm": [-0.027, 0.027],
        "transmittance": [0.95, 0.0],
        "widest_mm": 6.0,
        "pupil_mm": None,
        "orientation": -1.0,
    }
    # kappa = b(0)/a(0) = -0.054/0.9 = -0.06/mm.
    return ours(
        **{
            "camera_matrix": None,
            "eye_radius_mm": 10.0,
            "pinhole_height_mm": 1 / -0.06 - 10.0,
            "viewing_path": series,
            "retina_semi_axes_mm": [12.0, 11.0, 10.0],
        }
        | changed
    )


def path_with(**changed):
    return {"viewing_path": through_a_path()["viewing_path"] | changed}


def test_a_viewing_path_projects_as_its_series_say(written):
    microscope = read_microscope(written(through_a_path()))
    camera = microscope.ideal_microscope()
    t, above = 3.0, 2.0  # mm
    a, b = 0.9 - 0.005 * t**2, -0.054 * (1 - t**2 / 36)
    # One pixel shows 0.0067 mm on the axis, where t = 0.9 mm; the image is inverted.
    expected = np.array([900.0, -300.0]) - np.array([t * 0.9 / 0.0067, 0.0])
    seen = camera.project(jnp.array([t * (a - b * above), 0.0, -10.0 + above]))
    np.testing.assert_allclose(seen, expected, atol=1e-6)
    assert float(microscope.pinhole().inverse_working_distance) == pytest.approx(-0.06)
    assert microscope.camera() is None


def test_a_retina_is_an_ellipsoid_through_the_pole(written):
    tilted = through_a_path(retina_tilt_deg=5.0, retina_shift_mm=[0.2, -0.1])
    for content in (through_a_path(), tilted):
        wall = read_microscope(written(content)).wall()
        assert isinstance(wall, optics.Ellipsoid)
        met = wall.intersect(jnp.array([0.0, 0.0, 5.0]), jnp.array([0.0, 0.0, -1.0]))
        np.testing.assert_allclose(met.point, jnp.array([0.0, 0.0, -10.0]), atol=1e-12)
    # Untilted, its semi-axes are where they are said to be.
    side = read_microscope(written(through_a_path())).wall()
    met = side.intersect(jnp.zeros(3), jnp.eye(3)[:2])
    np.testing.assert_allclose(met.distance, jnp.array([12.0, 11.0]), atol=1e-12)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (path_with(crossing=[0.9]), "equally many coefficients.*not 1, 2 and 2"),
        (path_with(crossing=[0.9, 0.9]), "crossing that is not 0 on the axis"),
        (path_with(orientation=0.5), "viewing_path.orientation must be 1 .* or -1"),
        ({"camera_matrix": ours()["camera_matrix"]}, "camera_matrix must be null"),
        ({"distortion": [0.1, 0, 0, 0, 0]}, "distortion must be 0 with a viewing_path"),
        ({"pinhole_height_mm": 200.0}, "viewing_path says -0.06/mm"),
        ({"eye_radius_mm": 10.5, "pinhole_height_mm": 1 / -0.06 - 10.5}, "semi-axis along z"),
        ({"retina_shift_mm": [11.0, 0.0]}, "retina_shift_mm must be less than 11 mm"),
        ({"plane_normal": [0.0, 0.0, 1.0]}, "describe two walls"),
    ],
)
def test_a_path_that_contradicts_itself_is_refused(written, changed, said):
    with pytest.raises(InputError, match=said):
        read_microscope(written(through_a_path(**changed)))
