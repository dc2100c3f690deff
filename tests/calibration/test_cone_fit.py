"""The exact-geometry fit: exact on exact contours, honest on noise, open about what it lacks."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from skimage.measure import EllipseModel

from eyespot import calibration, optics
from eyespot.calibration.spots.cone_fit import HALVES, shake_px
from eyespot.estimator.distance.withdrawal import BORESIGHT_SIGMA
from tests.support.drawn.exact_spots import cone_trial, exact_spots, with_errors

pytestmark = pytest.mark.usefixtures("fast_compilation")
# A fit of other numbers of trials is a program of its own, which JAX traces for 5 to 20 s.

TRUE = {
    "half_angle": float(np.arctan(1 / 20)),
    "b": -5.117,
    "scale": 0.0067,
    "eye_radius": 11.5,
    "inverse_working_distance": 1 / 211.5,
    "tilt_x": 0.03,
    "tilt_y": -0.02,
}
CONE = ("half_angle", "b")
EYE = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
SIGMAS = np.diag([0.01, 0.01, 0.012, 0.012, 0.005]) ** 2
TOUCH = calibration.Prior(0.12, 0.05)
D = np.linspace(0.5, 6.0, 8)


def wall_of(kind, tilted):
    if kind == "eyeball":
        return optics.Sphere(11.5)
    # Tangents of the normal's lean, from the angles by trigonometry.
    tangent = tilted * np.hypot(TRUE["tilt_x"], TRUE["tilt_y"])
    towards = np.arctan2(TRUE["tilt_y"], TRUE["tilt_x"])
    return optics.pole_plane(eye_radius=11.5, tilt=np.arctan(tangent), tilt_azimuth=towards)


def trial(
    kind: str,
    c: float,
    *,
    azimuth=0.5,
    incidence=0.5,
    noise=None,
    lean=(0.0, 0.0),
    touch=TOUCH,
    touched=0.12,
    tilted=False,
):
    """A withdrawal; `touched` is the distance at reading 0, `touch` what is believed of it."""
    places = [(c, azimuth, incidence, 0.0, d) for d in D]
    ellipses, beams = exact_spots(wall_of(kind, tilted), EYE, places)
    axis = beams.axis[0]
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(axis))
    told = axis + lean[0] * first + lean[1] * second
    if noise is not None:
        errors = noise.standard_normal((len(D), 5)) * np.sqrt(np.diag(SIGMAS))
        ellipses = with_errors(ellipses, errors)
    return cone_trial(
        ellipses,
        SIGMAS,
        readings=D - touched,
        axis=told / np.linalg.norm(told),
        touch=touch,
        kind=kind,
    )


START = {"half_angle": 1.3 * TRUE["half_angle"], "b": 0.7 * TRUE["b"]}


def test_the_halves_of_a_recording_agree_unless_the_robot_is_bent():
    rng = np.random.default_rng(8)
    chances = {}
    for bend in (0.0, 0.03):
        one = trial("eyeball", 1.0, azimuth=1.0, noise=rng)
        # From the middle on, the robot reports 3 % less than it goes.
        late = np.maximum(one.readings - 3.0, 0.0)
        one.readings[:] -= bend * late
        fit = calibration.fit_cone([one], EYE, start=TRUE | {"tilt_x": 0.0, "tilt_y": 0.0})
        chances[bend] = fit.halves
    # Of four numbers the least is below 0.01 once in 25 seeds.
    assert min(chances[0.0].values()) > 0.01
    # 0.09 mm at the end, fifty times what a radius known to 0.012 px leaves unknown.
    assert chances[0.03]["near and far"] < 1e-6
    assert chances[0.03]["even and odd"] > 1e-3


def test_a_view_that_shakes_is_learnt_and_does_not_move_the_cone():
    rng = np.random.default_rng(10)
    true = {name: TRUE[name] for name in ("half_angle", "eye_radius")}
    start = TRUE | {"tilt_x": 0.0, "tilt_y": 0.0}
    loose = {"eye_radius": calibration.Prior(11.5, 1.0)}
    for shake in (0.0, 0.3):
        one = trial("eyeball", 3.0, noise=rng)
        shaken = one.ellipses._replace(
            centre=one.ellipses.centre + shake * rng.standard_normal((len(D), 2))
        )
        fit = calibration.fit_cone(
            [replace(one, ellipses=shaken)],
            EYE,
            start=start,
            free=("half_angle", "b", "eye_radius"),
            priors=loose,
        )
        # A standard deviation of 12 squares about a curve is known to a quarter.
        assert fit.shake_px[0] == pytest.approx(shake, rel=0.75)
        assert fit.growth == 1.0
        sigmas = np.sqrt(np.diag(fit.covariance))
        for at, (name, value) in enumerate(true.items()):
            assert abs(fit.values[name] - value) < 4 * sigmas[2 * at], name


def test_only_what_moves_from_frame_to_frame_is_a_shake():
    rng = np.random.default_rng(11)
    one = trial("eyeball", 1.0)
    places = rng.standard_normal((2000, len(D), 2))
    alarms = np.mean([shake_px(one, own) > 0 for own in places])
    assert alarms < 4 / 1000  # 1 in 1,000, and three deviations of 2,000 draws
    drift = np.linspace(0.0, 30.0, len(D))[:, None]
    outlier = np.where(np.arange(len(D)) == 6, 20.0, 0.0)[:, None]
    assert shake_px(one, places[0] + drift) == shake_px(one, places[0] + outlier) == 0.0


@pytest.mark.slow
def test_the_halves_chances_are_those_of_noise():
    rng = np.random.default_rng(9)
    start = TRUE | {"tilt_x": 0.0, "tilt_y": 0.0}
    found = [
        calibration.fit_cone([trial("eyeball", 1.0, noise=rng)], EYE, start=start).halves
        for _ in range(50)
    ]
    for halves in HALVES:
        # Of right programs two in 1,000 fail.
        assert stats.kstest([one[halves] for one in found], "uniform").pvalue > 1e-3


def test_exact_contours_give_every_parameter_back():
    trials = [
        trial("plane", 1.5, tilted=True),
        trial("eyeball", 3.0),
        trial("plane", 3.0, azimuth=2.0, tilted=True),
        trial("eyeball", 5.0, azimuth=4.0),
        trial("plane", 4.5, azimuth=4.0, tilted=True),
    ]
    rough = optics.microscope(scale=0.007, pinhole_height=220.0, eye_radius=12.0)
    fit = calibration.fit_cone(trials, rough, start=START, free=tuple(TRUE))
    assert fit.converged
    assert fit.undetermined == ()
    # The priors' means are the truth's, so that exact data can be met exactly.
    for name, true in TRUE.items():
        assert fit.values[name] == pytest.approx(true, rel=1e-6), name
    np.testing.assert_allclose(fit.touch, 0.12, atol=1e-6)
    np.testing.assert_allclose(fit.lean, 0.0, atol=1e-6)
    np.testing.assert_allclose(fit.eccentricity, [1.5, 3.0, 3.0, 5.0, 4.5], rtol=1e-6)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    runs = 50
    hits = {
        name: 0 for name in (*CONE, *(f"{name} {n}" for name in ("touch", "c") for n in range(4)))
    }
    squares = []
    for seed in range(runs):
        noise = np.random.default_rng(seed)
        leans = np.radians(1.0) * noise.standard_normal((4, 2))
        touched = TOUCH.mean + TOUCH.sigma * noise.standard_normal(4)
        places = (("plane", 1.5, 0.5), ("plane", 3.0, 2.0), ("eyeball", 3.0, 0.5))
        trials = [
            trial(kind, c, azimuth=azimuth, noise=noise, lean=tuple(lean), touched=touch)
            for (kind, c, azimuth), lean, touch in zip(
                (*places, ("eyeball", 5.0, 4.0)), leans, touched, strict=True
            )
        ]
        fit = calibration.fit_cone(trials, EYE, start=START)
        assert fit.converged
        errors = [
            *(fit.values[name] - TRUE[name] for name in CONE),
            *(fit.touch - touched),
            *(fit.eccentricity - [1.5, 3.0, 3.0, 5.0]),
        ]
        sigmas = [*np.sqrt(np.diag(fit.covariance)), *fit.touch_error, *fit.eccentricity_error]
        for name, error, sigma in zip(hits, errors, sigmas, strict=True):
            hits[name] += abs(error) < 1.959964 * sigma
        # No boresight is drawn, so its prior is met exactly as far as the data determine it.
        known = np.trace(fit.boresight_covariance, axis1=1, axis2=2) / BORESIGHT_SIGMA**2
        squares.append(fit.chi_squared + np.sum(2.0 - known))
    # Counts that 95 % intervals give but for 1 % of the time, over the parameters of all three fits
    # together: k, b of planes; c of spheres; these.
    level = 0.01 / (3 + len(hits))
    low, high = stats.binom.ppf([level / 2, 1 - level / 2], runs, 0.95)
    assert all(low <= count <= high for count in hits.values()), hits
    # And chi squared has the mean of its distribution, within four standard errors.
    degrees = fit.degrees_of_freedom
    assert np.mean(squares) == pytest.approx(degrees, abs=4 * np.sqrt(2 * degrees / runs))


def test_scale_and_cone_are_only_seen_together_on_planes_from_a_telecentric_microscope():
    telecentric = optics.microscope(scale=0.0067, pinhole_height=float("inf"), eye_radius=11.5)
    trials = [trial("plane", 1.5, incidence=0.0)]
    fit = calibration.fit_cone(trials, telecentric, start=START, free=("half_angle", "b", "scale"))
    # Only tan(half_angle)/scale enters the size of a square spot in px.
    assert len(fit.undetermined) == 1
    assert fit.undetermined[0].startswith("only the ratio of half_angle and scale")
    assert "add a trial in the eyeball" in fit.undetermined[0]
    assert np.isinf(fit.covariance[0, 0])
    # Where the spot is in mm hangs on the scale.
    assert np.isinf(fit.eccentricity_error).all()
    # b is seen all the same, as well as the touch is known.
    assert np.sqrt(fit.covariance[1, 1]) == pytest.approx(TOUCH.sigma, rel=0.01)


def traced_ellipses(*, beam, motion, readings, noise):
    """Ellipses of a cone's spots on the plane z = -11.5, in NumPy: generators, then a pinhole."""
    scale, height, plane = 0.0067, 200.0, -11.5
    aside = np.cross(beam, [1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    turn = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)[:, None]
    around = np.cos(turn) * aside + np.sin(turn) * np.cross(beam, aside)
    rays = np.cos(TRUE["half_angle"]) * beam + np.sin(TRUE["half_angle"]) * around
    touching = np.array([1.2, 0.8, plane]) - 0.12 * beam
    rows = []
    for reading in readings:
        apex = touching - reading * motion + TRUE["b"] * beam
        wall = apex + rays * ((plane - apex[2]) / rays[:, 2])[:, None]
        focal_px = (height - plane) / scale
        image = focal_px * wall[:, :2] * [1, -1] / (height - wall[:, 2:])
        ellipse = EllipseModel.from_estimate(image)
        axes, angle = ellipse.axis_lengths, ellipse.theta
        if axes[0] < axes[1]:
            axes, angle = axes[::-1], angle + np.pi / 2
        rows.append([*ellipse.center, *axes, (angle + np.pi / 2) % np.pi - np.pi / 2])
    rows = np.array(rows) + noise.standard_normal((len(readings), 5)) * np.sqrt(np.diag(SIGMAS))
    return optics.Ellipse(*map(jnp.asarray, (rows[:, :2], *rows[:, 2:].T)))


@pytest.mark.parametrize("off_deg", [0.3, 2.0])
def test_a_beam_off_the_motion_does_not_change_the_cone(off_deg):
    noise = np.random.default_rng(8)
    motion = np.array([0.25, 0.42, -0.87])
    motion /= np.linalg.norm(motion)
    aside = np.cross(motion, [0.6, 0.8, 0.1])
    aside /= np.linalg.norm(aside)
    angle = np.radians(off_deg)
    beam = np.cos(angle) * motion + np.sin(angle) * aside
    readings = np.linspace(0.3, 5.8, 16)  # as many frames as other trials are padded to
    trial = cone_trial(
        traced_ellipses(beam=beam, motion=motion, readings=readings, noise=noise),
        SIGMAS,
        readings=readings,
        axis=motion,
        motion=motion,
        touch=calibration.Prior(0.12, 0.02),
        kind="plane",
    )
    fit = calibration.fit_cone([trial], EYE, start=START)
    assert fit.converged
    for name, error in zip(CONE, np.sqrt(np.diag(fit.covariance)), strict=True):
        assert abs(fit.values[name] - TRUE[name]) < 3 * error, name
    # Chi squared of n normal numbers, within four standard deviations.
    degrees = fit.degrees_of_freedom
    assert abs(fit.chi_squared - degrees) < 4 * np.sqrt(2 * degrees)
    # The spot moves by 5.5 mm x the angle, so even a single trial shows the angle.
    sigma = np.sqrt(np.trace(fit.boresight_covariance[0]))
    assert sigma < np.radians(0.01)
    assert abs(np.hypot(*fit.boresight[0]) - angle) < 3 * sigma


def test_an_unknown_parameter_is_refused_by_name():
    with pytest.raises(ValueError, match="sag"):
        calibration.fit_cone([trial("plane", 1.5)], EYE, start=START, free=("sag",))
