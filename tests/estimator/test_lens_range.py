"""Distances of spots behind a lens: from the radius that its light has, and the spot's shape."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from eyespot import optics
from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.estimator.detector.shape import Shape, spot_shape
from eyespot.estimator.distance import lens_range
from eyespot.estimator.distance.lens_range import LensCurve, distance_from_lens
from eyespot.estimator.distance.ranger import Ranger
from eyespot.formats.calibration import LENS_PARAMETERS
from eyespot.formats.camera_sheet import Response
from eyespot.formats.spot import Reason
from tests.estimator.test_ranger import NORMALS, R_EYE, WALLS, B, K, calibration, microscope, spot
from tests.support.light.profiles import light_of, light_on


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


NO_CONE = {"half_angle": 0.0, "apex_offset": 0.0}


@pytest.mark.parametrize("curvature", [1 / R_EYE, 0.0])
def test_light_of_a_lens_is_found_on_the_curved_and_on_the_plane_wall(curvature):
    # Any smooth light will do: a bell that fills the envelope.
    bell = jnp.exp(-((3 * jnp.linspace(0.0, 1.0, 65)) ** 2))
    table = light_of(bell, contact=0.3, aside=0.2)
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
