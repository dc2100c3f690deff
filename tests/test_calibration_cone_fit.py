"""The exact-geometry fit: exact on exact contours, honest on noise, open about what it lacks."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import calibration
import optics

TRUE = {"half_angle": float(np.arctan(1 / 20)), "b": -5.117}
EYE = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
SIGMAS = np.diag([0.01, 0.01, 0.012, 0.012, 0.001]) ** 2
TOUCH = calibration.Prior(0.12, 0.05)
D = np.linspace(0.5, 6.0, 8)


@functools.lru_cache
def seen(kind: str, c: float, azimuth: float, incidence: float):
    wall = optics.Sphere(11.5) if kind == "eyeball" else optics.pole_plane(eye_radius=11.5)

    def at(d):
        beam = optics.beam_at_spot(
            wall,
            eccentricity=c,
            azimuth=azimuth,
            incidence=incidence,
            distance=d,
            half_angle=TRUE["half_angle"],
            apex_offset=TRUE["b"],
        )
        return optics.spot_ellipse(beam, wall, EYE), beam.axis

    return jax.jit(jax.vmap(at))(jnp.asarray(D))


def trial(
    kind: str, c: float, *, azimuth=0.5, incidence=0.5, noise=None, lean=(0.0, 0.0), touch=TOUCH
):
    ellipses, axes = seen(kind, c, azimuth, incidence)
    axis = np.asarray(axes[0])
    first, second = (np.asarray(v) for v in optics.perpendicular_frame(axis))
    told = axis + lean[0] * first + lean[1] * second
    if noise is not None:
        e = noise.standard_normal((len(D), 5)) * np.sqrt(np.diag(SIGMAS))
        ellipses = optics.Ellipse(
            ellipses.centre + e[:, :2],
            ellipses.semi_major + e[:, 2],
            ellipses.semi_minor + e[:, 3],
            ellipses.angle + e[:, 4],
        )
    return calibration.Trial(
        ellipses=ellipses,
        covariances=np.tile(SIGMAS, (len(D), 1, 1)),
        # Counted from a touch that the rim of a tilted tip makes early.
        readings=D - 0.12,
        axis=told / np.linalg.norm(told),
        principal_point=np.zeros(2),
        touch=touch,
        kind=kind,
    )


START = {"half_angle": 1.3 * TRUE["half_angle"], "b": 0.7 * TRUE["b"]}


@pytest.fixture(scope="module")
def clean():
    wide = calibration.Prior(0.12, 5.0)
    trials = [
        trial("plane", 1.5, lean=(0.01, -0.01), touch=wide),
        trial("eyeball", 3.0, touch=wide),
        trial("plane", 3.0, azimuth=2.0, touch=wide),
        trial("eyeball", 5.0, azimuth=4.0, lean=(-0.01, 0.0), touch=wide),
    ]
    # The priors' means are the truth's, so that exact data can be met exactly.
    return calibration.fit_cone(trials, EYE, start=START, lean_sigma=5.0)


def test_exact_contours_give_the_cone_back(clean):
    # From starts 30 % off; the priors, 5 mm and 5 rad wide, pull by 1e-10 of the data.
    assert clean.converged
    assert clean.values["half_angle"] == pytest.approx(TRUE["half_angle"], rel=1e-6)
    assert clean.values["b"] == pytest.approx(TRUE["b"], rel=1e-6)
    np.testing.assert_allclose(clean.touch, 0.12, atol=1e-5)
    assert clean.undetermined == ()


def test_intervals_hold_the_truth_as_often_as_they_say():
    hits = {name: 0 for name in TRUE}
    runs = 40
    for seed in range(runs):
        noise = np.random.default_rng(seed)
        leans = np.radians(1.0) * noise.standard_normal((4, 2))
        trials = [
            trial("plane", 1.5, noise=noise, lean=tuple(leans[0])),
            trial("plane", 3.0, azimuth=2.0, noise=noise, lean=tuple(leans[1])),
            trial("eyeball", 3.0, noise=noise, lean=tuple(leans[2])),
            trial("eyeball", 5.0, azimuth=4.0, noise=noise, lean=tuple(leans[3])),
        ]
        fit = calibration.fit_cone(trials, EYE, start=START)
        for n, name in enumerate(fit.free):
            off = abs(fit.values[name] - TRUE[name])
            hits[name] += off < 1.96 * np.sqrt(fit.covariance[n, n])
    # Binomial(40, 0.95): 33 or fewer have a probability of 0.3 %, halved over two parameters. All
    # touches are at the prior's mean, so that b may be held more often than it says.
    assert min(hits.values()) >= 34


def test_scale_and_cone_are_only_seen_together_on_planes_from_a_telecentric_microscope():
    telecentric = optics.microscope(scale=0.0067, pinhole_height=float("inf"), eye_radius=11.5)
    trials = [trial("plane", 1.5, incidence=0.0)]
    fit = calibration.fit_cone(trials, telecentric, start=START, free=("half_angle", "b", "scale"))
    # Only tan(half_angle)/scale enters the size of a square spot in px.
    assert len(fit.undetermined) == 1
    assert fit.undetermined[0].startswith("half_angle and scale only together")
    assert np.isinf(fit.covariance[0, 0])
    # b is seen all the same, as well as the touch is known.
    assert np.sqrt(fit.covariance[1, 1]) == pytest.approx(TOUCH.sigma, rel=0.01)


def test_an_unknown_parameter_is_refused_by_name():
    with pytest.raises(ValueError, match="sag"):
        calibration.fit_cone([trial("plane", 1.5)], EYE, start=START, free=("sag",))
