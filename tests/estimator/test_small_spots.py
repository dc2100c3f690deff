"""Spots of 3 to 15 px, fitted to their pixels, against images by closed forms."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import j1
from scipy.stats import ncx2

from eyespot.estimator import SubpixelSettings, TrackState, measure, track
from eyespot.formats.spot import NoSpot, Reason, Spot
from tests.support.drawn.drawn_spots import SUB_PIXELS, over_pixels, spot_in, sub_pixel_grid
from tests.support.drawn.own_frames import clouds

SHAPE = (120, 160)
_NOISE = 2.0


def bell(x, y, semi_major, semi_minor, angle, power=2.0):
    u, v = sub_pixel_grid(SHAPE)
    along = (u - x) * math.cos(angle) + (v - y) * math.sin(angle)
    across = (v - y) * math.cos(angle) - (u - x) * math.sin(angle)
    return over_pixels(
        np.exp(-math.log(2) * np.hypot(along / semi_major, across / semi_minor) ** power)
    )


def blurred_disc(x, y, radius, blur):
    """Peak 1: the light of a disc after a Gaussian blur is a noncentral chi-squared probability."""
    u, v = sub_pixel_grid(SHAPE)
    distances = np.linspace(0, 200, 4000)
    profile = ncx2.cdf((radius / blur) ** 2, 2, (distances / blur) ** 2)
    return over_pixels(np.interp(np.hypot(u - x, v - y), distances, profile / profile[0]))


def half_radius(radius, blur):
    """Where a blurred disc falls to half of its peak."""

    def fall(r):
        return ncx2.cdf((radius / blur) ** 2, 2, (r / blur) ** 2) - 0.5 * -math.expm1(
            -0.5 * (radius / blur) ** 2
        )

    return brentq(fall, 0.1, radius + 5 * blur)


def camera_frame(rng, light, peak, wall=1.0, noise=_NOISE):
    image = (15 + peak * light) * wall + rng.normal(0, noise, SHAPE)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def place(rng) -> tuple[float, float]:
    return SHAPE[1] / 2 + rng.uniform(-5, 5), SHAPE[0] / 2 + rng.uniform(-5, 5)


def bound(parameters, peak):
    """Cramér-Rao bound of a bell's semi-axes: noise, rounding; peak and sloping wall unknown."""
    steps = np.diag([0.02, 0.02, 0.02, 0.02, 0.002, 0.01])
    at = np.append(parameters, 2.0)
    columns = [
        peak * (bell(*(at + step)) - bell(*(at - step))).ravel() / (2 * step.sum())
        for step in steps
    ]
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    plane = np.ones(SHAPE), (u - at[0]) / 50, (v - at[1]) / 50
    rows = np.stack([*columns, *(one.ravel() for one in (bell(*at), *plane))])
    variances = np.diag(np.linalg.inv(rows @ rows.T)) * (_NOISE**2 + 1 / 12)
    return np.sqrt(variances[2:4])


def test_bells_reach_the_bound():
    ratios = []
    for seed in range(24):
        rng = np.random.default_rng([1, seed])
        minor = rng.uniform(3, 12)
        truth = np.array(
            [*place(rng), minor * rng.uniform(1.1, 1.5), minor, rng.uniform(-1.5, 1.5)]
        )
        peak = rng.uniform(40, 225)
        spot = spot_in(camera_frame(rng, bell(*truth), peak))
        errors = np.array([spot.semi_major_px, spot.semi_minor_px]) - truth[2:4]
        ratios.append(errors / bound(truth, peak))
    rms = np.sqrt(np.mean(np.square(ratios)))
    # The goal is 1.3; 48 squares leave the root of their mean open by 10 %.
    assert rms < 1.3
    # At 1/sqrt(24) of the bound the mean is zero.
    assert np.abs(np.mean(ratios, axis=0)).max() < 3 / math.sqrt(24)


@pytest.mark.parametrize("contrast", [0.0, 0.03])
def test_stated_errors_of_small_discs_are_those_of_the_errors(contrast):
    errors, sigmas = [], []
    for seed in range(40):
        rng = np.random.default_rng([2, seed])
        radius, blur = rng.uniform(3, 14), rng.uniform(0.7, 2)
        light = blurred_disc(*place(rng), radius, blur)
        wall = np.exp(contrast * clouds(rng, SHAPE))
        spot = spot_in(camera_frame(rng, light, rng.uniform(40, 225), wall))
        true = half_radius(radius, blur)
        errors.append(math.sqrt(spot.semi_major_px * spot.semi_minor_px) - true)
        # The axes' mean: half of the variance of their sum.
        (a, c), (_, b) = spot.covariance[2:4, 2:4].tolist()
        sigmas.append(math.sqrt((a + b + 2 * c) / 4))
    if not contrast:
        assert abs(np.mean(errors)) < 0.03  # px, the goal
    z = np.array(errors) / sigmas
    # 40 squares leave the root of their mean open by 11 %, and texture that is not the model's by
    # 20 %.
    assert 0.75 < math.sqrt(np.mean(z * z)) < 1.35


def test_errors_of_discs_that_only_pixels_blur_are_those_of_noise():
    """How much of a pixel lies within an edge depends on the direction in which the edge runs."""
    u, v = sub_pixel_grid(SHAPE)
    z = []
    for seed in range(24):
        rng = np.random.default_rng([11, seed])
        (x, y), radius = place(rng), rng.uniform(6, 14)
        # The part of a sub-pixel that lies within; what its edge's direction changes is 1e-4 px.
        within = np.clip(SUB_PIXELS * (radius - np.hypot(u - x, v - y)) + 0.5, 0, 1)
        spot = spot_in(camera_frame(rng, over_pixels(within), 200.0, noise=1.0))
        covariance = spot.covariance
        z.append((spot.x_px - x) / math.sqrt(covariance[0, 0]))
        z.append((spot.y_px - y) / math.sqrt(covariance[1, 1]))
        variance = covariance[2, 2] + covariance[3, 3] + 2 * covariance[2, 3]
        z.append((spot.semi_major_px + spot.semi_minor_px - 2 * radius) / math.sqrt(variance))
    # 72 squares leave the root of their mean open by 8 %.
    assert math.sqrt(np.mean(np.square(z))) < 1.25


def test_a_focus_with_rings_and_a_halo_is_measured_at_half_of_its_own_peak():
    u, v = sub_pixel_grid(SHAPE)
    for seed, radius in enumerate((3.0, 4.0, 6.0, 9.0)):
        rng = np.random.default_rng([7, seed])

        def focus(t):
            """Airy's pattern, half at t = 1, on a halo that no bell or disc has."""
            x = 1.6163 * np.maximum(t, 1e-9)
            return (2 * j1(x) / x) ** 2 + 0.15 * np.exp(-((t / 2.2) ** 2))

        true = radius * brentq(lambda t: focus(t) - focus(0.0) / 2, 0.5, 2.0)
        x, y = place(rng)
        light = over_pixels(focus(np.hypot(u - x, v - y) / radius)) / focus(0.0)
        spot = spot_in(camera_frame(rng, light, 180.0))
        error = math.sqrt(spot.semi_major_px * spot.semi_minor_px) - true
        # The goal for real beams is 3 % of the area's radius.
        assert abs(error) < max(3 * spot.sigma_semi_minor_px, 0.03 * true)
        assert spot.sigma_semi_minor_px < 0.06 * true


def test_a_spot_that_grows_through_15_px_is_measured_all_the_way():
    rng = np.random.default_rng(3)
    radii = np.linspace(12, 19, 15)
    frames = [
        camera_frame(rng, bell(80.3, 60.6, 1.1 * radius, radius, 0.4), 180.0) for radius in radii
    ]
    results = list(track(frames, SubpixelSettings()))
    spots = [spot for spot in results if isinstance(spot, Spot)]
    assert len(spots) == len(results)
    z = [(s.semi_minor_px - r) / s.sigma_semi_minor_px for s, r in zip(spots, radii, strict=True)]
    assert np.abs(z).max() < 4


@pytest.mark.parametrize("aside_px", [26, 32, 38])
@pytest.mark.parametrize("share", [-0.08, 0.1, 0.4])
def test_what_is_beside_a_small_spot_does_not_move_it(aside_px, share):
    """Another disc, lit or dark, that is within three radii but does not touch the spot."""
    light = blurred_disc(70.3, 60.4, 11.5, 0.6)
    beside = blurred_disc(70.3 + aside_px * 0.8, 60.4 - aside_px * 0.6, 11.5, 0.6)
    rng = np.random.default_rng([9, aside_px])
    spot = spot_in(camera_frame(rng, light + share * beside, 150.0))
    z = (math.sqrt(spot.semi_major_px * spot.semi_minor_px) - half_radius(11.5, 0.6)) / (
        spot.sigma_semi_minor_px
    )
    assert abs(z) < 4
    assert spot.sigma_semi_minor_px < 0.04  # 0.02 alone


def test_dots_of_a_lattice_are_no_spot():
    u, v = sub_pixel_grid(SHAPE)
    lattice = np.hypot((u + 18) % 40 - 20, (v + 13) % 40 - 20)
    light = over_pixels(np.exp(-math.log(2) * (lattice / 4) ** 2))
    frame = camera_frame(np.random.default_rng(4), light, 180.0)
    assert measure(frame, TrackState(), SubpixelSettings())[0] == NoSpot(Reason.AMBIGUOUS)


def test_of_two_spots_about_15_px_large_the_fainter_one_is_not_taken():
    """The search for larger spots sees the second one alone."""
    light = blurred_disc(48.2, 60.1, 12.4, 0.8) + 0.15 * blurred_disc(112.6, 58.3, 13.6, 0.8)
    frame = camera_frame(np.random.default_rng(8), light, 150.0)
    assert measure(frame, TrackState(), SubpixelSettings())[0] == NoSpot(Reason.AMBIGUOUS)
    clicked = spot_in(frame, at=(50.0, 59.0))
    assert math.hypot(clicked.x_px - 48.2, clicked.y_px - 60.1) < 0.1


def test_of_two_small_spots_the_clicked_one_is_measured():
    light = bell(40.2, 60.1, 5, 4, 0.3) + bell(120.6, 50.3, 5, 4, 1.1)
    frame = camera_frame(np.random.default_rng(6), light, 180.0)
    assert measure(frame, TrackState(), SubpixelSettings())[0] == NoSpot(Reason.AMBIGUOUS)
    clicked = spot_in(frame, at=(122.0, 49.0))
    assert math.hypot(clicked.x_px - 120.6, clicked.y_px - 50.3) < 0.1


def test_a_small_disc_at_full_scale_is_refused():
    light = blurred_disc(80.2, 60.4, 6.0, 1.0)
    found, _ = measure(
        camera_frame(np.random.default_rng(5), light, 400.0), TrackState(), SubpixelSettings()
    )
    # Its half level lies within the edge's blur, which nothing in the frame shows.
    assert found == NoSpot(Reason.SATURATED)
