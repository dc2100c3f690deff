"""Recordings of one beam agree within their errors; of two beams they do not."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from eyespot import optics
from eyespot.calibration.command.choices import Choices
from eyespot.calibration.command.comparisons import cone_against_rig, priors_against_images
from eyespot.calibration.command.crossed import as_stated, crossed, read_by_cone
from eyespot.calibration.command.fit_verdict import Fitted
from eyespot.calibration.command.fitting import without_foreign
from eyespot.calibration.command.spot_models import fit_cone_to_spots
from eyespot.calibration.recorded_trial import RecordedTrial
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.calibration.tolerances import PriorOutcome
from eyespot.estimator.distance.consistency import disagreements
from eyespot.estimator.recording import Recording
from eyespot.formats.rig import Rig
from eyespot.formats.spots import SpotRecord
from tests.support.drawn.exact_spots import cone_trial, exact_spots, with_errors
from tests.support.drawn.made_up import a_spot

SCALE, RADIUS = 0.0067, 11.5
ANGLE, B = math.atan(1 / 20), -5.0
SIGMAS = np.array([2e-5, 0.02])  # of half-angle and b
RIG = Rig.model_validate(
    {
        "schema": 1,
        "microscope": {
            "width_px": 640,
            "height_px": 480,
            "scale_mm_px": SCALE,
            "pinhole_height_mm": 200.0,
            "principal_point_px": [0.0, 0.0],
        },
        "wall": {"kind": "eyeball", "radius_mm": RADIUS, "medium": "air"},
        "robot": {"eye_from_robot": [0.0, 0.0, 0.0, 1.0], "scale_sigma": 0.01},
    }
)


def recorded(name, trial, across):
    """A recording whose spots are known."""
    view = RIG.view
    assert view is not None
    return RecordedTrial(
        name=name,
        recording=Recording(np.zeros((1, 480, 640), np.uint8), rig=RIG, name=name),
        trial=trial,
        tilt=(0.0, 0.0),
        across=across,
        frames=len(trial.readings),
        microscope=view,
        medium="air",
        fibre_radius_mm=0.25,
        sha256="0" * 64,
    )


def square(name, touched=0.1):
    """A withdrawal square to the wall at its pole: circles with d = kR + b + sagitta."""
    distances = np.linspace(touched, 4.0, 8)
    radius = np.linspace(0.2, 0.5, 4001)
    way = 20.0 * radius + B + RADIUS - np.sqrt(RADIUS**2 - radius**2)
    size = np.interp(distances, way, radius)
    # The circle lies nearer to the pinhole by its sagitta.
    depth = 1.0 - (RADIUS - np.sqrt(RADIUS**2 - size**2)) / (200.0 + RADIUS)
    size_px, none = jnp.asarray(size / (SCALE * depth)), jnp.zeros(len(size))
    trial = cone_trial(
        optics.Ellipse(jnp.zeros((len(size), 2)), size_px, size_px, none),
        np.eye(5),
        readings=distances - touched,
        axis=np.array([0.0, 0.0, -1.0]),
        touch=Prior(touched, 0.02),
    )
    return recorded(name, trial, np.eye(3)[:2])


def drawn_fit(rng, angles):
    """A fit whose results scatter as it states, about the half-angle of each recording."""

    def fit(recordings):
        (one,) = recordings
        values = np.array([angles[one.name], B]) + SIGMAS * rng.normal(size=2)
        return Fitted(
            calibration_model="exact",
            values=dict(zip(("half_angle", "b"), values.tolist(), strict=True)),
            covariance=np.diag(SIGMAS**2),
            converged=True,
            residuals={},
            recordings=recordings,
            used=8,
            degrees_of_freedom=30,
            others=[(f"touch of {one.name}", 0.1, 0.0, "mm")],
        )

    return fit


def test_recordings_of_one_beam_agree_as_chance_has_it():
    rng, pair = np.random.default_rng(1), [square("A"), square("B")]
    fit = drawn_fit(rng, {"A": ANGLE, "B": ANGLE})
    found = [crossed([fit([one]) for one in pair], read_by_cone) for _ in range(300)]
    chances = [one.chance for one in found if one]
    # The level is that of one test: of right programs one in 1,000 fails.
    assert stats.kstest(chances, "uniform").pvalue > 1e-3
    assert all(one.agree for one in found if one)
    # Read by the other's calibration, 0.020 mm of b is the error, and nothing of the robot's.
    rms = [one.distances["rms_sigmas"].mean() for one in found if one]
    assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(1.0, abs=0.1)


def test_the_one_recording_of_another_beam_is_named():
    rng, three = np.random.default_rng(2), [square(name) for name in "ABC"]
    other = ANGLE + 12 * SIGMAS[0]
    fit = drawn_fit(rng, {"A": ANGLE, "B": other, "C": ANGLE})
    found = crossed([fit([one]) for one in three], read_by_cone)
    assert found is not None
    assert not found.agree
    assert found.foreign == "B"
    assert "Without B the others agree" in found.verdict


def line_fit(recordings):
    """A line through the sizes of one recording's spots, known to 0.02 px."""
    (one,) = recordings
    sizes = np.asarray(one.trial.ellipses.semi_minor)
    line = np.polynomial.Polynomial.fit(one.trial.readings, sizes, 2)
    left = (sizes - line(one.trial.readings)) / 0.02
    return Fitted(
        calibration_model="exact",
        values={},
        covariance=np.zeros((0, 0)),
        converged=True,
        residuals={"size": left},
        chi_squared=float(left @ left),
        degrees_of_freedom=len(left) - 3,
        recordings=recordings,
        used=len(left),
    )


def test_one_foreign_frame_is_named_and_left_out():
    one = square("A")
    spot = a_spot(0, 0, 30, 30, 0)
    records = [
        SpotRecord(frame=k, file_name="", time_s=0.0, mode="subpixel", result=spot)
        for k in range(8)
    ]
    # Of another time: 5 px more than its place in the withdrawal, 250 standard deviations.
    sizes = np.asarray(one.trial.ellipses.semi_minor) + 5.0 * (np.arange(8) == 3)
    ellipses = one.trial.ellipses._replace(semi_minor=jnp.asarray(sizes))
    one = one._replace(records=records, trial=replace(one.trial, ellipses=ellipses))
    found = without_foreign(line_fit([one]), line_fit)
    assert found.used == 7
    assert "frame 3 of A" in found.notes[0]
    # A wrong model is no foreign frame: all spots deviate, and none is left out.
    bent = 40.0 + 2.0 * np.sin(9.0 * one.trial.readings)
    ellipses = one.trial.ellipses._replace(semi_minor=jnp.asarray(bent))
    one = one._replace(trial=replace(one.trial, ellipses=ellipses))
    assert without_foreign(line_fit([one]), line_fit).used == 8


def drawn(rng, name, half_angle, b, robot_scale, frames=16):
    """A withdrawal at a place, tilt, contact and travel that are drawn, with noise on its spots."""
    c, incidence = rng.uniform(0.5, 3.0), np.radians(rng.uniform(10, 35))
    azimuth, leaning = rng.uniform(0, 2 * np.pi, 2)
    touched = 0.25 * math.sin(incidence)
    distances = np.linspace(touched, touched + rng.uniform(3, 5), frames)
    eye = optics.microscope(scale=SCALE, pinhole_height=200.0, eye_radius=RADIUS)
    places = [(c, azimuth, incidence, leaning, d) for d in distances]
    ellipses, beams = exact_spots(optics.Sphere(RADIUS), eye, places, half_angle=half_angle, b=b)
    _, major, minor, _ = ellipses
    of_angle = 0.012 / np.maximum(major - minor, 1e-3 * minor)
    sigmas = np.stack([*np.tile([[0.01], [0.01], [0.012], [0.012]], frames), of_angle], axis=1)
    axis = beams.axis[0]
    trial = cone_trial(
        with_errors(ellipses, sigmas * rng.normal(size=sigmas.shape)),
        np.stack([np.diag(row**2) for row in sigmas]),
        readings=(distances - touched) / robot_scale,
        axis=axis,
        touch=Prior(touched + 0.02 * rng.normal(), 0.02),
    )
    return recorded(name, trial, np.stack(optics.perpendicular_frame(axis)))


@pytest.mark.slow
def test_pairs_of_withdrawals_agree_and_of_two_beams_2_percent_apart_do_not():
    rng, chances, told = np.random.default_rng(7), [], 0
    for other in (0.0, 0.02):
        for _ in range(20):
            half_angle, robot = math.atan(1 / rng.uniform(15, 25)), 1.0 + 0.01 * rng.normal()
            b = -0.25 / math.tan(half_angle)
            pair = [
                drawn(rng, name, half_angle * (1.0 + more), b, robot)
                for name, more in (("A", 0.0), ("B", other))
            ]
            apart = [fit_cone_to_spots([as_stated(one)], Choices()) for one in pair]
            found = crossed(apart, read_by_cone)
            assert found is not None
            if other:
                told += not found.agree
            else:
                chances.append(found.chance)
    # One of 1,000 right programs fails.
    assert stats.kstest(chances, "uniform").pvalue > 1e-3
    assert told >= 18


def test_the_light_at_the_tip_of_each_recording_is_that_of_the_fitted_cone():
    rig = RIG.changed({"instrument.core_radius_mm": -B * math.tan(ANGLE)})
    trial = SimpleNamespace(touch=Prior(0.0, 0.02))
    one = SimpleNamespace(
        name="A", trial=trial, fibre_radius_mm=0.25, ghost=None, recording=SimpleNamespace(rig=rig)
    )
    fit = SimpleNamespace(
        free=("half_angle", "b"),
        values={"half_angle": ANGLE, "b": B},
        covariance=np.diag(SIGMAS**2),
        touch=np.zeros(2),
        touch_error=np.full(2, 0.01),
        lean=np.array([[0.0, 0.01], [0.0, 0.1]]),
        lean_error=np.full((2, 2), np.inf),
        boresight=np.full((2, 2), 0.03),
        boresight_covariance=np.tile(1e-8 * np.eye(2), (2, 1, 1)),
    )
    found: Any = cone_against_rig(cast(Any, fit), cast(Any, [one, one]))
    found = list(found)
    assert [c.sigmas for c in found if c.key == "contact"] == pytest.approx([0.0, 0.0], abs=1e-9)
    # The robot's directions are known to a degree, and here the images add nothing.
    turned = [c for c in found if c.key == "frame"]
    assert [c.sigmas for c in turned] == pytest.approx(np.degrees([0.0, 0.01, 0.0, 0.1]))
    assert "eye_from_robot" in disagreements(turned)[0]


@pytest.mark.parametrize(
    ("name", "value", "sigma", "told"),
    [
        ("robot_scale", 0.957, 0.0072, True),  # 4.3 of its sigmas, 6.2 of what the images add
        ("robot_scale", 0.985, 0.0072, False),
        ("robot_scale", 0.957, 0.02, True),  # the error is enlarged by a misfit
        ("robot_scale", 0.995, 0.0099, False),  # the images add nothing
        ("b", -2.0, 0.1, False),  # a person's own prior, of the cone
    ],
)
def test_a_fit_that_leaves_what_the_rig_states_disagrees_with_it(name, value, sigma, told):
    outcome = PriorOutcome(name, Prior(1.0, 0.01), value, sigma)
    found = disagreements(priors_against_images([outcome]))
    assert bool(found) == told
    assert all("robot_scale is 1 ± 0.01 as stated, but 0.957" in said for said in found)
