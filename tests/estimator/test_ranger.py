"""Distances of spots: against the models of `optics`, exact geometry, and many noisy repeats."""

import math
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import fftconvolve

from eyespot import optics
from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.estimator.detector.shape import Shape, spot_shape
from eyespot.estimator.distance import lens_range
from eyespot.estimator.distance.lens_range import LensCurve, distance_from_lens
from eyespot.estimator.distance.ranger import Ranger
from eyespot.formats.calibration import LENS_PARAMETERS
from eyespot.formats.camera import Response
from eyespot.formats.inputs import InputError
from eyespot.formats.spots import Reason, Spot
from tests.support.command_line import run_python
from tests.support.drawn.exact_spots import exact_spots
from tests.support.drawn.made_up import CONE, a_calibration, a_microscope, a_spot
from tests.support.light.photon_stacks import Recording, direct_light, half_maximum
from tests.support.light.photons import Drop, counted_light

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


def beam_at(distance, *, wall="eyeball", c=3.0, incidence=0.5):
    return optics.beam_at_spot(
        WALLS[wall],
        eccentricity=c,
        azimuth=0.7,
        distance=distance,
        incidence=incidence,
        incidence_azimuth=0.4,
        half_angle=math.atan(1 / K),
        apex_offset=B,
    )


def light_on(table, beam, points, inward):
    """Irradiance of points of a wall by a beam of light that a table has."""
    offset = points - beam.tip
    along = offset @ beam.axis
    across = offset - along[..., None] * beam.axis
    radius = jnp.linalg.norm(across, axis=-1)
    lateral, axial = table(radius=radius, distance=along)
    vector = (lateral / jnp.maximum(radius, 1e-9))[..., None] * across
    vector = vector + axial[..., None] * beam.axis
    return jnp.maximum(-jnp.sum(vector * inward, axis=-1), 0.0)


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


@pytest.mark.parametrize("height", HEIGHTS)
@pytest.mark.parametrize("model", ["small_plane", "corrected"])
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


def test_exact_sees_through_the_fitted_working_distance():
    seen, _, axis, _ = exact_spot(200.0, d=3.0, c=4.0, incidence=0.5)
    own = calibration(model="exact", k=K, b=B, inverse_working_distance=1 / 211.5)
    result = Ranger(own, microscope()).distance(seen, axis=axis)
    # As of a microscope's file that says the same.
    there = Ranger(calibration(model="exact"), microscope(200.0)).distance(seen, axis=axis)
    assert result.distance_mm == pytest.approx(there.distance_mm, abs=1e-9)
    assert result.distance_mm == pytest.approx(3.0, abs=1e-3)


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


@pytest.mark.parametrize(
    ("incidence", "axis_sigma"),
    [
        (0.0, None),
        (0.2, 0.0175),
        pytest.param(0.2, None, marks=pytest.mark.slow),
        pytest.param(0.5, 0.0175, marks=pytest.mark.slow),
    ],
)
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


def bell(height, width, *, centre=(200.0, 180.0)):
    y, x = np.mgrid[:height, :width]
    return np.exp(-0.5 * ((x - centre[0]) / 30) ** 2 - 0.5 * ((y - centre[1]) / 24) ** 2)


HALF_WIDTH = math.sqrt(2 * math.log(2))  # of a bell, in standard deviations
BELL = {0.25: math.sqrt(2), 0.75: math.sqrt(math.log(4 / 3) / math.log(2))}  # over HALF_WIDTH
BELL_SPOT = spot(200.0, 180.0, 30 * HALF_WIDTH, 24 * HALF_WIDTH)


def frame_of(light, *, response=None, noise_dn=1.0):
    """An 8-bit frame of light in [0, 1]."""
    curved = light if response is None else light ** (1 / response.gamma)
    noise = noise_dn * np.random.default_rng(5).standard_normal(light.shape)
    return np.clip(np.rint(255 * curved + noise), 0, 255).astype(np.uint8)


def shape_in(frame, seen=BELL_SPOT, response=None):
    return spot_shape(frame, seen, response=response or Response(), camera=None)


@pytest.mark.parametrize("response", [None, Response(curve="gamma", gamma=2.2)])
def test_the_shape_of_a_bell_is_read_from_its_frame(response):
    frame = frame_of(0.1 + 0.6 * bell(360, 400), response=response)
    seen = shape_in(frame, response=response)
    # Where the background is taken, 2.75 half widths out, the bell still has 0.5 %; a quarter of
    # the peak lies where a percent of the peak is 0.5 % of the radius.
    assert seen.ratios == pytest.approx((BELL[0.25], BELL[0.75]), abs=0.015)
    assert seen.peak == pytest.approx(0.6, abs=0.01)


def test_the_shape_of_a_plateau_is_read_from_its_frame():
    y, x = np.mgrid[:360, :400]
    inside = np.hypot(x - 200.0, y - 180.0) < 40
    seen = shape_in(frame_of(0.1 + 0.6 * inside), spot(200, 180, 40, 40))
    # A pixel's width at the edge, 1/40 of the radius.
    assert seen.ratios == pytest.approx((1.0, 1.0), abs=0.025)


def test_a_saturated_channel_gives_way_to_another():
    channels = [frame_of(np.minimum(gain * bell(360, 400), 1.0)) for gain in (2.0, 0.6, 0.3)]
    seen = shape_in(np.stack(channels, axis=-1))
    assert seen.ratios == pytest.approx((BELL[0.25], BELL[0.75]), abs=0.015)
    assert seen.peak == pytest.approx(0.6, abs=0.01)
    assert shape_in(channels[0]) is None


def test_no_shape_is_read_where_the_wall_round_the_spot_is_out_of_view():
    frame = frame_of(0.6 * bell(90, 90, centre=(45, 45)))
    assert shape_in(frame, spot(45, 45, 30 * HALF_WIDTH, 24 * HALF_WIDTH)) is None


@pytest.mark.parametrize("at", [(-200.0, 45.0), (45.0, 45.0), (89.0, 0.0)])
@pytest.mark.parametrize("size", [0.5, 20.0, 500.0])
def test_a_frame_without_the_spot_has_no_shape(at, size):
    rng = np.random.default_rng(2)
    dark = np.zeros((90, 90), np.uint8)
    white = np.full((90, 90, 3), 255, np.uint8)
    for frame in (dark, white, rng.random((90, 90)), rng.integers(0, 9, (1, 1)).astype(np.uint8)):
        shape = shape_in(frame, spot(*at, size, size))
        assert shape is None or np.isfinite([*shape.ratios, shape.peak]).all()
        assert shape is None or frame.dtype == float


def valley_curve():
    """A made-up lens: R = 0.2 + 0.1 |d - 2| mm; a plateau before 2 mm and a bell behind."""
    distances = np.linspace(0.1, 8.0, 80)
    half = 0.2 + 0.1 * np.abs(distances - 2)
    near = distances < 2
    shape = [np.where(near, 1.05, BELL[0.25]), np.ones(80), np.where(near, 0.95, BELL[0.75])]
    radii = (half * shape).T
    return LensCurve(
        distances=distances,
        incidences=np.radians([0.0, 45.0]),
        radii=np.stack([radii, radii], axis=1),
        peak=np.stack([distances**-2.0] * 2, axis=1),
        relative_error=np.zeros(80),
        tip_radius=0.25,
    )


def found(*, radius_mm=0.25, incidence=0.0, ratios=None, peak=None):
    return distance_from_lens(
        valley_curve(),
        radius_mm=radius_mm,
        relative_sigma=0.004,
        incidence=incidence,
        shape=None if ratios is None else Shape(ratios, 0.6),
        peak_irradiance=None if peak is None else (peak, 0.0),
    )


def test_one_radius_at_two_distances_is_told_apart_by_shape_or_by_brightness():
    # R = 0.25 mm belongs to 1.5 and to 2.5 mm; the valley's corner lies between the nodes.
    alone = found()
    assert sorted([alone.distance_mm, *alone.others_mm]) == pytest.approx([1.5, 2.5], abs=2e-3)
    assert alone.sigma_mm > 0.4
    for distance, ratios in ((1.5, (1.05, 0.95)), (2.5, (BELL[0.25], BELL[0.75]))):
        for told in (found(ratios=ratios), found(peak=distance**-2)):
            assert told.distance_mm == pytest.approx(distance, abs=2e-3)
            assert told.others_mm == ()


def test_a_shape_that_fits_nowhere_does_not_decide():
    strange = found(ratios=(3.0, 0.1))
    assert (strange.distance_mm, strange.others_mm) == (found().distance_mm, found().others_mm)


def test_sigma_of_lens_follows_the_slope_of_its_radius():
    # 0.4 % from the image and 0.3 % of the method, of 0.5 mm, over a slope of 0.1.
    assert found(radius_mm=0.5).sigma_mm == pytest.approx(0.005 * 0.5 / 0.1, rel=0.02)


def test_a_tilted_tip_does_not_come_nearer_than_its_rim_allows():
    # R = 0.385 mm belongs to 0.15 and to 3.85 mm; at 45 degrees the rim touches at 0.25 mm.
    assert len(found(radius_mm=0.385).others_mm) == 1
    tilted = found(radius_mm=0.385, incidence=math.pi / 4)
    assert tilted.distance_mm == pytest.approx(3.85, abs=2e-3)
    assert tilted.others_mm == ()


def test_a_radius_that_the_lens_never_has_is_nowhere():
    for radius_mm in (0.1, 2.0, math.nan):
        assert math.isnan(found(radius_mm=radius_mm).distance_mm)


@pytest.mark.parametrize("wall", ["plane", "tilted plane"])
def test_exact_takes_the_planes_shape(wall):
    view = microscope(200.0, plane_normal=NORMALS[wall])
    place = (3.0, 0.7, 0.5, 0.4, 4.0)
    ellipses, beams = exact_spots(WALLS[wall], view.ideal_microscope(), [place])
    seen = spot(*ellipses.centre[0], *(own[0] for own in ellipses[1:]))
    result = Ranger(calibration(), view, model="exact").distance(seen, axis=beams.axis[0])
    # 1e-7 px, as above; on a sphere the same ellipse would be 0.024 mm off.
    assert result.distance_mm == pytest.approx(4.0, abs=2e-8)


NO_CONE = {"half_angle": 0.0, "apex_offset": 0.0}


@pytest.mark.parametrize("curvature", [1 / R_EYE, 0.0])
def test_light_of_a_lens_is_found_on_the_curved_and_on_the_plane_wall(curvature):
    # Any smooth light will do: a bell that fills the envelope.
    x = jnp.linspace(0.0, 1.0, 65)
    bell = jnp.exp(-((3 * x) ** 2))
    table = optics.IrradianceTable(
        values=jnp.tile(jnp.stack([0.2 * x * bell, bell], axis=-1), (9, 1, 1)),
        medium_index=jnp.array(1.0),
        contact_radius=jnp.array(0.3),
        slope=jnp.array(0.2),
    )
    light, points = lens_range._wall_light(table, curvature, 3.0)
    wall = "eyeball" if curvature else "plane"
    for row, incidence in enumerate(lens_range._INCIDENCES):
        beam = optics.beam_at_spot(
            WALLS[wall], eccentricity=0.0, distance=3.0, incidence=incidence, **NO_CONE
        )
        there = jnp.asarray(points[row] - [0.0, 0.0, R_EYE])
        inward = -there / R_EYE if curvature else jnp.array([0.0, 0.0, 1.0])
        expected = light_on(table, beam, there, inward)
        on_wall = jnp.linalg.norm(there, axis=-1) if curvature else -there[..., 2]
        # Rounding at 11.5 mm.
        np.testing.assert_allclose(on_wall, R_EYE, atol=1e-12)
        np.testing.assert_allclose(light[row], expected, atol=1e-12)


NA_SIGMA = 5e-4


@pytest.fixture(scope="module")
def flat_end():
    """The flat end of NA 0.10 in air: its light, and a ranger calibrated to it."""
    lens = optics.load_lens("paper-candidate")
    values = {name: float(getattr(lens, name)) for name in LENS_PARAMETERS[:6]}
    covariance = np.zeros((6, 6))
    covariance[5, 5] = NA_SIGMA**2
    ranger = Ranger(calibration(model="lens", covariance=covariance, **values), microscope(200.0))
    return optics.irradiance_table(lens, medium_index=1.0), ranger


def lens_spot(table, beam, wall="eyeball"):
    """Spot of the half-maximum contour, by labels' own ray by ray search."""
    eye = microscope(200.0).ideal_microscope()
    contour = eye.project(optics.half_maximum_contour(table, beam, WALLS[wall]))
    ellipse = optics.ellipse_of_contour(contour)
    return spot(*ellipse.centre, *ellipse[1:])


@pytest.mark.slow  # 25 s for the lens's light
@pytest.mark.parametrize(
    ("wall", "c", "incidence"),
    [
        *(("eyeball", c, incidence) for c in (0.0, 3.0) for incidence in (0.0, 0.25, 0.5)),
        *(("plane", 3.0, 0.5), ("tilted plane", 3.0, 0.5)),
    ],
)
def test_lens_returns_the_distance_of_its_half_maximum_contour(flat_end, wall, c, incidence):
    table, on_sphere = flat_end
    ranger = Ranger(on_sphere.calibration, microscope(200.0, plane_normal=NORMALS[wall]))
    for d in (3.0, 4.0, 6.0):
        beam = beam_at(d, c=c, incidence=incidence, wall=wall)
        result = ranger.distance(lens_spot(table, beam, wall))
        # Radii agree within 0.1 %, and the distance has 1.2 (at 6 mm 0.9) times its share. Taken
        # for the eyeball, a plane would cost 0.05 mm.
        assert result.distance_mm == pytest.approx(d, rel=1.3e-3)
        assert result.flag is None


@pytest.fixture(scope="module")
def counted():
    """The flat end's light, counted by photons without any code of `optics`."""
    drop = Drop.of(optics.load_lens("paper-candidate"))
    return counted_light(
        drop, 1.0, nearest=2.0, farthest=8.0, contact=0.35, slope=0.15, count=1 << 23
    )


@pytest.mark.slow
@pytest.mark.parametrize("incidence", [0.0, 0.5])
@pytest.mark.parametrize("c", [0.0, 3.0])
def test_lens_returns_the_distance_of_a_spot_that_photons_made(flat_end, counted, c, incidence):
    _, ranger = flat_end
    drop, side = Drop.of(optics.load_lens("paper-candidate")), 360
    recording = Recording(drop=drop, wall="eyeball", width=side, height=side, scale=SCALE)
    for d in (3.0, 4.0, 6.0):
        beam = beam_at(d, c=c, incidence=incidence)
        tip, axis = np.asarray(beam.tip), np.asarray(beam.axis)
        x, y, z = tip + d * axis
        place = np.array([x, -y]) * (200.0 + R_EYE) / (200.0 - z) / SCALE
        centre = (side - 1) / 2 - place
        image = direct_light(recording, counted, tip, axis, centre, samples=1)
        contour = half_maximum(image) - centre + CENTRE
        ellipse = optics.ellipse_of_contour(jnp.asarray(contour))
        result = ranger.distance(spot(*ellipse.centre, *ellipse[1:]))
        # The peak that photons count errs by 1e-3, so that half of it moves the radius by 1e-3; the
        # distance has 1.2 times that, and 1.3e-3 by the ranger's own table.
        assert result.distance_mm == pytest.approx(d, rel=3e-3)


@pytest.mark.slow
def test_lens_ranges_a_spot_of_unknown_error(flat_end):
    table, ranger = flat_end
    seen = replace(lens_spot(table, beam_at(4.0)), covariance=np.full((5, 5), np.nan))
    result = ranger.distance(seen)
    assert result.distance_mm == pytest.approx(4.0, rel=1.3e-3)
    assert math.isnan(result.sigma_mm)


@pytest.mark.slow
def test_sigma_of_a_flat_end_follows_its_aperture(flat_end):
    # What leaves a flat end depends on d tan(theta) alone, sin(theta) = NA: so d ~ 1/NA. The method
    # has 0.3 % of R over dR/dd = 0.107 to itself.
    table, ranger = flat_end
    result = ranger.distance(lens_spot(table, beam_at(4.0, incidence=0.0)))
    method = 0.003 * float(optics.half_maximum_radius(table, distance=4.0)) / 0.107
    assert result.sigma_mm == pytest.approx(math.hypot(4.0 * NA_SIGMA / 0.10, method), rel=0.05)


def lit_frame(table, beam, *, size=420):
    """Frame of a matt wall under the beam, traced pixel by pixel, and where it is looking."""
    sphere = optics.Sphere(R_EYE)
    eye = microscope(200.0).ideal_microscope()
    eye = eye.centred_on(beam.spot(sphere).point, width=size, height=size)
    pixels = jnp.stack(jnp.meshgrid(jnp.arange(size), jnp.arange(size)), axis=-1).astype(float)
    wall = sphere.intersect(*eye.ray(pixels))
    light = np.asarray(light_on(table, beam, wall.point, wall.normal))
    frame = frame_of(0.03 + 0.6 * light / light.max(), noise_dn=2.0)
    return frame, microscope(200.0, principal_point_px=tuple(map(float, eye.principal_point)))


@pytest.mark.slow
@pytest.mark.parametrize("incidence", [0.0, 0.5])
@pytest.mark.parametrize("d", [0.4, 1.0, 1.6, 2.7])
def test_two_distances_of_one_radius_are_told_apart_in_a_frame(flat_end, d, incidence):
    table, ranger = flat_end
    frame, ranger.microscope = lit_frame(table, beam_at(d, incidence=incidence))
    seen, _ = measure(frame, TrackState(), SubpixelSettings())
    by_size = ranger.distance(seen)
    assert by_size.flag is Reason.AMBIGUOUS
    candidates = np.array([by_size.distance_mm, *by_size.others_mm])
    by_shape = ranger.distance(seen, frame=frame)
    assert by_shape.flag is None
    # Three standard deviations; near the tip the radius hardly changes and the shape decides alone.
    assert abs(by_shape.distance_mm - d) < 3 * by_shape.sigma_mm
    assert np.abs(candidates - d).min() < 0.3 < np.abs(candidates - d).max()


@pytest.mark.parametrize("model", ["planar", "small_plane", "corrected", "exact"])
@pytest.mark.parametrize("k", [1e3, 9e5])
def test_a_tip_that_would_lie_outside_the_eye_has_no_distance(model, k):
    # A spot of 60 px is 0.4 mm in radius, and d = 0.4 k: 400 mm, and 360 m. An eye of 11.5 mm
    # is 23 mm long.
    ranger = Ranger(calibration(model=model, k=k, b=0.0), microscope())
    found = ranger.distance(spot(*CENTRE, 60.0, 59.0, 0.0))
    assert math.isnan(found.distance_mm)
    assert found.flag is Reason.OUT_OF_RANGE
