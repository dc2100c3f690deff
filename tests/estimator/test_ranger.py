"""Distances of spots: against the models of `optics`, exact geometry, and many noisy repeats."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import fftconvolve

from eyespot import optics
from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.estimator.distance.ranger import Ranger
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import Reason, Spot
from tests.support.command_line import run_python
from tests.support.drawn.exact_spots import exact_spots
from tests.support.drawn.made_up import CONE, a_calibration, a_microscope, a_spot

HOME = Path(__file__).resolve().parents[2]
R_EYE, SCALE, K, B = 11.5, 0.0067, *CONE.values()
BEHIND = -28.4  # kappa = -0.059/mm, a phakic eye behind a flat contact lens
HEIGHTS = (0.0, 11.5, 200.0, math.inf, BEHIND)
CENTRE = (900.0, -300.0)  # outside the frame, as for a spot far from the axis


def microscope(height=R_EYE, **changed):
    return a_microscope(**{"principal_point_px": CENTRE, "pinhole_height_mm": height} | changed)


def calibration(*, model="corrected", covariance=None, stated=None, **values):
    return a_calibration(values or CONE, model=model, covariance=covariance, stated=stated)


def covariance_of(semi_major, semi_minor, sigma_px):
    """Of an ellipse fitted to points with white noise, one of whose harmonics has this sigma.

    The radius changes by the mean m, with half the variance of a harmonic, and by c cos 2t + s sin
    2t about the ellipse's own axes: a = m + c, b = m - c, angle = s/(a - b).
    """
    covariance = np.diag([1.0, 1.0, 1.5, 1.5, max(semi_major - semi_minor, 1e-6) ** -2])
    covariance[2, 3] = covariance[3, 2] = -0.5
    return sigma_px**2 * covariance


def spot(*ellipse, covariance=None):
    clean = covariance_of(float(ellipse[2]), float(ellipse[3]), 1e-3)
    return a_spot(*ellipse, covariance=clean if covariance is None else covariance)


def wall_point(c, azimuth):
    return np.array([c * math.cos(azimuth), c * math.sin(azimuth), -math.sqrt(R_EYE**2 - c**2)])


def image_of(points, height):
    """Image of points in the eye by a pinhole on the axis, px."""
    nearness = 1.0 if math.isinf(height) else (height + R_EYE) / (height - points[..., 2:])
    return CENTRE + points[..., :2] * (1.0, -1.0) * nearness / SCALE


def exact_spot(height, *, d, c, incidence=0.0):
    """Spot of a sharp cone by exact geometry in NumPy, its beam's tip and axis, the wall's normal.

    The ellipse is the least-squares conic about the centroid of 64 points of the edge that are
    uniform in the ellipse's own angle: generators of the cone are moved until they are.
    """
    centre = wall_point(c, 0.7)
    normal = centre / R_EYE
    east, north = np.linalg.svd(normal[None])[2][1:]
    lean = math.cos(0.4) * east + math.sin(0.4) * north
    axis = math.cos(incidence) * normal + math.sin(incidence) * lean
    tip = centre - d * axis
    apex, half_angle = tip + B * axis, math.atan(1 / K)
    across = np.linalg.svd(axis[None])[2][1:]
    uniform = np.arange(64) * (2 * np.pi / 64)

    def edge(angle):
        around = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ across
        ray = math.cos(half_angle) * axis + math.sin(half_angle) * around
        along = ray @ apex
        to_wall = np.sqrt(along**2 + R_EYE**2 - apex @ apex) - along
        return image_of(apex + to_wall[:, None] * ray, height)

    angle = uniform
    for _ in range(40):
        points = edge(angle)
        middle = points.mean(axis=0)
        x, y = (points - middle).T / 60.0
        conic = np.linalg.lstsq(np.stack([x * x, x * y, y * y, x, y], 1), np.ones(64))[0]
        matrix = np.array([[conic[0], conic[1] / 2], [conic[1] / 2, conic[2]]])
        shift = np.linalg.solve(matrix, -conic[3:] / 2)
        values, vectors = np.linalg.eigh(matrix / (1 + shift @ matrix @ shift))
        p, q = (np.sqrt(values) * ((np.stack([x, y], 1) - shift) @ vectors)).T
        own = np.unwrap(np.arctan2(q, p))
        turn = math.copysign(1.0, own[-1] - own[0])
        angle = angle - turn * (own - own[0] - turn * uniform)
    semi_major, semi_minor = 60.0 / np.sqrt(values)
    slope = math.atan2(vectors[1, 0], vectors[0, 0])
    return spot(*(middle + 60.0 * shift), semi_major, semi_minor, slope), tip, axis, normal


TILTED = (math.sin(0.2) * math.cos(2.0), math.sin(0.2) * math.sin(2.0), math.cos(0.2))
WALLS: dict[str, optics.Surface] = {
    "eyeball": optics.Sphere(R_EYE),
    "plane": optics.pole_plane(eye_radius=R_EYE),
    "tilted plane": optics.pole_plane(eye_radius=R_EYE, tilt=0.2, tilt_azimuth=2.0),
}
NORMALS = {"eyeball": None, "plane": (0.0, 0.0, 1.0), "tilted plane": TILTED}


@pytest.mark.parametrize("height", HEIGHTS)
@pytest.mark.parametrize("c", [0.0, 3.0, 7.0])
@pytest.mark.parametrize("semi_minor", [20.0, 90.0])
def test_closed_forms_equal_those_of_optics(height, c, semi_minor):
    given = {"semi_minor_px": semi_minor, "scale": SCALE, "k": K, "b": B}
    eye = {"eccentricity": c, "eye_radius": R_EYE}
    expected = {
        "planar": optics.planar_distance(**given),
        "small_plane": optics.small_plane_distance(**given, **eye),
    }
    for model in ("corrected", *(("stereographic",) if height == R_EYE else ())):
        expected[model] = optics.closed_form_distance(
            model, **given, **eye, inverse_working_distance=1 / (height + R_EYE)
        )
    for model, distance in expected.items():
        ranger = Ranger(calibration(), microscope(height), model=model, eccentricity_mm=c)
        result = ranger.distance(spot(0, 0, semi_minor, semi_minor))
        assert result.distance_mm == pytest.approx(float(distance), abs=1e-9)


def test_half_angle_and_slope_are_one_parameter():
    seen = spot(0, 0, 60, 55)
    by_slope = Ranger(calibration(), microscope()).distance(seen)
    by_angle = Ranger(calibration(half_angle=math.atan(1 / K), b=B), microscope()).distance(seen)
    assert by_angle.distance_mm == pytest.approx(by_slope.distance_mm, abs=1e-12)


def test_a_fitted_scale_and_radius_go_before_the_microscopes():
    own = calibration(k=K, b=B, scale=0.008, eye_radius=12.0)
    expected = optics.closed_form_distance(
        "corrected",
        semi_minor_px=55.0,
        scale=0.008,
        k=K,
        b=B,
        eccentricity=2.0,
        eye_radius=12.0,
        inverse_working_distance=1 / 212.0,
    )
    result = Ranger(own, microscope(200.0), eccentricity_mm=2.0).distance(spot(0, 0, 60, 55))
    assert result.distance_mm == pytest.approx(float(expected), abs=1e-9)


@pytest.mark.parametrize(
    ("model", "height"),
    [
        *(("small_plane", height) for height in HEIGHTS),
        *(("corrected", height) for height in HEIGHTS),
        ("exact", 200.0),
    ],
)
def test_a_fitted_working_distance_goes_before_the_microscopes(model, height):
    kappa = 1 / (height + R_EYE)
    own = calibration(k=K, b=B, inverse_working_distance=kappa)
    # The spot's place, whose c is read through the pinhole, tells one from another.
    seen = spot(*image_of(wall_point(4.0, 0.7), height), 60, 55)
    fitted, there = (
        Ranger(values, microscope(at), model=model).distance(seen)
        for values, at in ((own, 50.0), (calibration(), height))
    )
    # z_F = 1/kappa - r, rounded.
    assert fitted.distance_mm == pytest.approx(there.distance_mm, abs=1e-10)
    assert fitted.sigma_mm == pytest.approx(there.sigma_mm, rel=1e-6)


@pytest.mark.parametrize("height", [50.0, math.inf])
def test_sigma_of_a_working_distance_shows_in_the_distance(height):
    kappa, sigma = 1 / (height + R_EYE), 1e-4
    covariance = np.zeros((3, 3))
    covariance[2, 2] = sigma**2
    own = calibration(k=K, b=B, inverse_working_distance=kappa, covariance=covariance)
    seen = spot(*image_of(wall_point(4.0, 0.7), height), 60, 55, covariance=np.zeros((5, 5)))
    result = Ranger(own, microscope()).distance(seen)
    # As far as the distance moves under another microscope, whose kappa is one sigma more: the
    # curvature over a sigma of 0.2 to 1 % of kappa is left.
    other = Ranger(calibration(), microscope(1 / (kappa + sigma) - R_EYE)).distance(seen)
    assert result.sigma_mm == pytest.approx(abs(other.distance_mm - result.distance_mm), rel=0.01)
    assert result.sigma_mm > 1e-3


@pytest.mark.parametrize("c", [1.0, 3.0, 5.0])
def test_corrected_recovers_a_distance_through_a_pinhole_behind_the_retina(c):
    seen, *_ = exact_spot(BEHIND, d=2.0, c=c)
    found = Ranger(calibration(), microscope(BEHIND)).distance(seen)
    # The factor is of first order in the spot's size, R = 0.36 mm. At c = 5 mm the paper's cos(phi)
    # errs by -2 mm.
    assert found.distance_mm == pytest.approx(2.0, abs=0.01)


@pytest.mark.parametrize("height", HEIGHTS)
@pytest.mark.parametrize("c", [0.0, 1.0, 5.0])
def test_eccentricity_is_read_off_the_image(height, c):
    seen = spot(*image_of(wall_point(c, 2.0), height), 60, 60)
    read, given = (
        Ranger(calibration(), microscope(height), model="small_plane", **told).distance(seen)
        for told in ({}, {"eccentricity_mm": c})
    )
    # Rounding of x of 1000 px (1e-13) in c, times dd/dc of 1 and less; at c = 0 d is even in c.
    assert read.distance_mm == pytest.approx(given.distance_mm, abs=1e-10)


@pytest.mark.parametrize("height", HEIGHTS)
@pytest.mark.parametrize(("c", "distances"), [(0.0, (0.5, 3.0, 6.0)), (3.0, (6.0, 0.5, 3.0))])
def test_exact_returns_distance_and_tip_of_exact_geometry(height, c, distances):
    ranger = Ranger(calibration(), microscope(height), model="exact")
    for incidence, d in zip((0.0, 0.2, 0.5), distances, strict=True):
        seen, tip, axis, _ = exact_spot(height, d=d, c=c, incidence=incidence)
        known = ranger.distance(seen, axis=axis, axis_sigma_rad=1e-4)
        # The solver's 32 points leave 1e-7 px: k delta = 0.134 mm/px of it in d, and in the tip
        # 0.1 mm/px and less, where tilt is seen best at 0.2 and 0.5 rad and given at 0.
        assert known.distance_mm == pytest.approx(d, abs=2e-8)
        np.testing.assert_allclose(known.poses[0].tip_mm, tip, atol=2e-8)
        # Without the axis either of two poses may come first; one of them is the true one.
        unknown = [pose.distance_mm for pose in ranger.distance(seen).poses]
        assert min(unknown, key=lambda found: abs(found - d)) == pytest.approx(d, abs=2e-8)


def test_exact_reports_the_mirror_pose_and_a_prior_tells_the_two_apart():
    ranger = Ranger(calibration(), microscope(), model="exact")
    seen, _, axis, normal = exact_spot(R_EYE, d=3.0, c=2.0, incidence=0.3)
    mirrored = 2 * normal @ axis * normal - axis
    for towards in (axis, mirrored):
        poses = ranger.distance(seen, axis=towards).poses
        # The mirror solution is a reflection at the normal only to first order in the spot's size.
        assert poses[0].axis @ towards > math.cos(0.02)
        assert poses[1].axis @ towards < math.cos(0.3)
        assert poses[0].distance_mm == pytest.approx(3.0, abs=0.01)


def test_a_mirror_pose_at_another_distance_is_told_unless_the_axis_decides():
    ranger = Ranger(calibration(), microscope(0.0), model="exact")
    seen, _, axis, _ = exact_spot(0.0, d=6.0, c=3.0, incidence=0.5)
    free = ranger.distance(seen)
    assert free.flag is Reason.AMBIGUOUS
    both = sorted([free.distance_mm, *free.others_mm], key=lambda d: abs(d - 6.0))
    assert both[0] == pytest.approx(6.0, abs=2e-8)
    # The test could fail: the other one is another distance.
    assert abs(both[1] - 6.0) > 1e-4
    led = ranger.distance(seen, axis=axis)
    assert led.flag is None
    assert led.distance_mm == pytest.approx(6.0, abs=2e-8)


def test_exact_forgives_an_axis_that_is_a_degree_off():
    ranger = Ranger(calibration(), microscope(), model="exact")
    seen, _, axis, _ = exact_spot(R_EYE, d=3.0, c=2.0, incidence=0.5)
    across = np.cross(axis, [1.0, 0.0, 0.0])
    off = axis + 0.0175 * across / np.linalg.norm(across)
    result = ranger.distance(seen, axis=off / np.linalg.norm(off))
    # The ellipse (0.001 px) shows the axis to 2e-5 rad; the prior of 0.0175 pulls it by the square
    # of the ratio, 2e-8 rad. Held, it would cost 0.04 mm.
    assert result.distance_mm == pytest.approx(3.0, abs=1e-6)


def drawn(rng, seen, covariance):
    """The spot measured again."""
    return spot(*rng.multivariate_normal(seen.ellipse, covariance), covariance=covariance)


CALIBRATION_COVARIANCE = np.array([[0.04, -0.012], [-0.012, 0.0049]])  # k and b: correlation -0.86


@pytest.mark.parametrize("model", ["planar", "small_plane", "corrected", "stereographic"])
def test_sigma_of_closed_forms_is_the_scatter_of_many_repeats(model):
    rng = np.random.default_rng(7)
    covariance = np.diag([9.0, 9.0, 1.0, 0.5, 0.01]) ** 2
    covariance[0, 3] = covariance[3, 0] = 0.5 * 9.0 * 0.5
    seen = replace(exact_spot(R_EYE, d=3.0, c=5.0)[0], covariance=covariance)
    predicted = Ranger(
        calibration(covariance=CALIBRATION_COVARIANCE), microscope(), model=model
    ).distance(seen)
    found = []
    for k, b in rng.multivariate_normal([K, B], CALIBRATION_COVARIANCE, size=1000):
        ranger = Ranger(calibration(k=k, b=b), microscope(), model=model)
        found.append(ranger.distance(drawn(rng, seen, covariance)).distance_mm)
    # The scatter of 1000 repeats is known to 1/sqrt(2000) = 2.2 %: four of these.
    assert np.std(found) == pytest.approx(predicted.sigma_mm, rel=0.09)


@pytest.mark.parametrize(("incidence", "axis_sigma"), [(0.0, None), (0.2, 0.0175)])
def test_sigma_of_exact_is_the_scatter_of_many_repeats(incidence, axis_sigma):
    rng = np.random.default_rng(3)
    seen, _, axis, _ = exact_spot(200.0, d=3.0, c=3.0, incidence=incidence)
    # 0.2 px of the semi-minor axis are 27 um of d; k and b have 40 um.
    covariance = covariance_of(seen.semi_major_px, seen.semi_minor_px, 0.2)
    first = np.cross(axis, [1.0, 0.0, 0.0])
    sides = np.stack([first, np.cross(axis, first)]) / np.linalg.norm(first)
    own = calibration(covariance=CALIBRATION_COVARIANCE)
    ranger = Ranger(own, microscope(200.0), model="exact")
    found, predicted = [], list[float]()
    for k, b in rng.multivariate_normal([K, B], CALIBRATION_COVARIANCE, size=150):
        one, given = drawn(rng, seen, covariance), {}
        if axis_sigma is not None:
            told = axis + axis_sigma * rng.standard_normal(2) @ sides
            given = {"axis": told / np.linalg.norm(told), "axis_sigma_rad": axis_sigma}
        if len(predicted) < 25:  # it hardly scatters
            predicted.append(ranger.distance(one, **given).sigma_mm)
        again = Ranger(calibration(k=k, b=b), microscope(200.0), model="exact")
        found.append(again.distance(one, **given).distance_mm)
    # 1/sqrt(300) = 6 % from the repeats, three of these, and a few percent of sigma's own.
    assert np.std(found) == pytest.approx(np.median(predicted), rel=0.21)


def test_a_mode_without_errors_gives_a_distance_without_one():
    literal = spot(*CENTRE, 60, 55, covariance=np.full((5, 5), np.nan))
    for model in ("planar", "corrected", "exact"):
        result = Ranger(calibration(), microscope(), model=model).distance(literal)
        assert result.flag is None
        assert math.isnan(result.sigma_mm)


def kernel(shape, size, samples):
    """A blur as an image of `samples` a pixel, its `size` in px."""
    reach = math.ceil(6 * size * samples)
    away = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) / (size * samples)
    light = {"gaussian": np.exp(-0.5 * away**2), "defocus": away <= 1.0, "tails": np.exp(-away)}
    return light[shape] / np.sum(light[shape])


@pytest.mark.parametrize("shape, size", [("gaussian", 2.0), ("defocus", 3.0), ("tails", 1.5)])
def test_a_blurred_edge_does_not_shorten_the_distance_of_a_cone(shape, size):
    samples, pixels = 5, 160
    v, u = (np.mgrid[: samples * pixels, : samples * pixels] + 0.5) / samples - 0.5
    sharp = ((u - 80.3) / 40) ** 2 + ((v - 79.6) / 30) ** 2 < 1
    light = fftconvolve(sharp.astype(float), kernel(shape, size, samples), mode="same")
    light = light.reshape(pixels, samples, pixels, samples).mean(axis=(1, 3))
    noise = np.random.default_rng(3).normal(0, 1, light.shape)
    image = np.rint(10 + 180 * light + noise).astype(np.uint8)
    spot, _ = measure(image, TrackState(), SubpixelSettings())
    assert isinstance(spot, Spot)
    # Half of the light lies inside of the edge, which the ellipse's own errors do not contain.
    assert spot.semi_minor_px < 30 - 3 * spot.sigma_semi_minor_px
    cone = calibration(model="planar", half_angle=math.atan(1 / K), b=B)
    found = Ranger(cone, microscope()).distance(spot)
    assert found.distance_mm == pytest.approx(SCALE * K * 30 + B, abs=3 * found.sigma_mm)
    # The shift, three or four times the noise's error, is known to 15 %.
    assert found.sigma_mm < 1.5 * SCALE * K * spot.sigma_semi_minor_px


@pytest.mark.parametrize("model", ["small_plane", "corrected", "exact"])
def test_a_spot_that_the_eye_cannot_hold_is_out_of_range(model):
    ranger = Ranger(calibration(), microscope(200.0), model=model)
    off_the_sphere = spot(CENTRE[0] + 1.1 * R_EYE / SCALE, CENTRE[1], 60, 55)
    too_large = spot(*CENTRE, 1.2 * R_EYE / SCALE, 1.1 * R_EYE / SCALE)
    for seen in (off_the_sphere, too_large):
        result = ranger.distance(seen)
        assert result.flag is Reason.OUT_OF_RANGE
        assert math.isnan(result.distance_mm)


def test_a_spot_smaller_than_at_contact_is_out_of_range():
    result = Ranger(calibration(), microscope()).distance(spot(*CENTRE, 20, 19))
    assert result.distance_mm < 0
    assert result.flag is Reason.OUT_OF_RANGE


def test_what_does_not_fit_is_refused_with_a_remedy():
    with pytest.raises(ValueError, match="one of planar, small_plane"):
        Ranger(calibration(), microscope(), model="perfect")
    with pytest.raises(ValueError, match=r"needs the pinhole on the sphere.*corrected"):
        Ranger(calibration(), microscope(200.0), model="stereographic")
    with pytest.raises(ValueError, match=r"eccentricity_mm=.*\[0, 11.5\).*12"):
        Ranger(calibration(), microscope(), eccentricity_mm=12.0)
    with pytest.raises(ValueError, match="one is a cone, the other a lens"):
        Ranger(calibration(), microscope(), model="lens")
    with pytest.raises(InputError, match="another microscope, or of another zoom"):
        Ranger(calibration(k=K, b=B, scale=2 * SCALE), microscope())
    with pytest.raises(ValueError, match="unit vector"):
        Ranger(calibration(), microscope()).distance(spot(*CENTRE, 60, 55), axis=[0, 0, -2])


def test_closed_forms_load_no_jax():
    code = """
import sys
from eyespot.estimator import Ranger
from tests.support.drawn.made_up import a_calibration, a_microscope, a_spot
for model in ("planar", "small_plane", "corrected", "stereographic"):
    ranger = Ranger(a_calibration(), a_microscope(), model=model)
    assert ranger.distance(a_spot(300, 200, 60, 55)).distance_mm > 0
print(*sys.modules)
"""
    child = run_python(code, cwd=HOME)
    assert child.exit_code == 0, child.stderr
    assert not {"jax", "equinox"} & set(child.stdout.split())


@pytest.mark.parametrize("wall", ["plane", "tilted plane"])
def test_exact_takes_the_planes_shape(wall):
    view = microscope(200.0, plane_normal=NORMALS[wall])
    place = (3.0, 0.7, 0.5, 0.4, 4.0)
    ellipses, beams = exact_spots(WALLS[wall], view.ideal_microscope(), [place])
    seen = spot(*ellipses.centre[0], *(own[0] for own in ellipses[1:]))
    result = Ranger(calibration(), view, model="exact").distance(seen, axis=beams.axis[0])
    # 1e-7 px, as above; on a sphere the same ellipse would be 0.024 mm off.
    assert result.distance_mm == pytest.approx(4.0, abs=2e-8)


@pytest.mark.parametrize("model", ["planar", "small_plane", "corrected", "exact"])
@pytest.mark.parametrize("k", [1e3, 9e5])
def test_a_tip_that_would_lie_outside_the_eye_has_no_distance(model, k):
    # A spot of 60 px is 0.4 mm in radius, and d = 0.4 k: 400 mm, and 360 m. An eye of 11.5 mm
    # is 23 mm long.
    ranger = Ranger(calibration(model=model, k=k, b=0.0), microscope())
    found = ranger.distance(spot(*CENTRE, 60.0, 59.0, 0.0))
    assert math.isnan(found.distance_mm)
    assert found.flag is Reason.OUT_OF_RANGE
