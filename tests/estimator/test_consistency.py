"""What two sources state is compared: found where they differ, silent where they do not."""

import math
import re

import numpy as np
import pytest

from eyespot.estimator.distance.consistency import (
    CONTRADICTION_SIGMAS,
    TipWay,
    against_prior,
    contact,
    disagreements,
    slope_of,
)
from eyespot.formats.poses import RobotKeys
from tests.support.drawn.made_up import a_calibration

ROBOT_SIGMA, ANGLE_SIGMA = 0.01, 0.005


def a_cone(sigma=ANGLE_SIGMA):
    """A cone whose k = 1/tan(half-angle) is known to a share of it."""
    covariance = np.diag([(sigma * math.atan(1 / 20)) ** 2, 0.02**2])
    values = {"half_angle": math.atan(1 / 20), "b": -5.0}
    return a_calibration(values, covariance=covariance, model="exact")


def withdrawal(rng, *, travel_mm=4.0, frames=20, longer=0.0, frozen=False, noise_mm=0.003):
    """A withdrawal along z by robot and distances, drawn with the errors that are stated."""
    true = np.linspace(0.0, travel_mm, frames)
    robot = true * (1.0 + longer + ROBOT_SIGMA * rng.normal())
    read = 0.5 + true * (1.0 + ANGLE_SIGMA * rng.normal()) + noise_mm * rng.normal(size=frames)
    way = TipWay()
    for moved, distance in zip(robot, read, strict=True):
        way.add(
            position_mm=(0.1, -0.2, 0.0 if frozen else float(moved)),
            axis=(0.0, 0.0, -1.0),
            spot=None,
            distance_mm=float(distance),
            sigma_mm=noise_mm,
            parts_mm={},
        )
    # The beam is known to point along its tool: no incidence, no error of the slope by it.
    return way.compared(
        RobotKeys(scale_sigma=ROBOT_SIGMA, incidence_deg=(0.0, 0.0)), None, a_cone()
    )


def test_a_robot_within_its_tolerance_is_no_contradiction():
    rng = np.random.default_rng(1)
    sigmas = [withdrawal(rng, frames=int(rng.integers(5, 40)))[0].sigmas for _ in range(500)]
    assert not [s for s in sigmas if abs(s) > CONTRADICTION_SIGMAS]
    # Of 500 normal numbers the standard deviation is known to 3.2 %: within four of these.
    assert np.std(sigmas) == pytest.approx(1.0, abs=4 * 0.032)


def test_a_robot_beyond_its_tolerance_is_told_with_the_two_lengths():
    # 7 % are six standard deviations of 1 % and 0.5 % together, so that all are found but for
    # those whose own errors make it less than 3.8: 1 %.
    rng = np.random.default_rng(2)
    found = [disagreements(withdrawal(rng, longer=0.07)) for _ in range(100)]
    assert sum(map(bool, found)) >= 95
    assert "by the robot" in found[0][0]


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        ({"frozen": True}, "All poses of the robot are equal"),
        # Metres that are called millimetres: 4 mm become 0.004 mm.
        ({"longer": -0.999}, "The robot moves by .*robot.unit"),
    ],
)
def test_poses_that_hardly_change_contradict_distances_that_do(poses, words):
    (said,) = disagreements(withdrawal(np.random.default_rng(3), **poses))
    assert re.search(words, said)
    # At rest, where poses jitter and one distance is wrong.
    still = withdrawal(np.random.default_rng(3), travel_mm=0.05, **poses)
    assert disagreements(still) == []


def test_a_slope_through_correlated_scatter_has_the_error_that_it_states():
    # Texture pulls neighbouring frames alike: an autoregressive scatter with a correlation of 0.6.
    rng, travel = np.random.default_rng(4), np.linspace(0.0, 4.0, 60)
    off = []
    for _ in range(400):
        noise = rng.normal(size=60)
        for k in range(1, 60):
            noise[k] = 0.6 * noise[k - 1] + 0.8 * noise[k]
        slope, sigma, _ = slope_of(travel, travel + 0.03 * noise, np.full(60, 0.03))
        off.append((slope - 1.0) / sigma)
    # The correlation is taken from 60 residuals of a line, which are less alike than the errors:
    # stated errors are up to a fifth too small. As if the frames were independent, half.
    assert np.std(off) < 1.35


@pytest.mark.parametrize(
    ("radius_mm", "core_mm", "told"),
    [
        (0.252, None, False),  # 1 % more than the fibre of 0.250 mm
        (0.318, None, True),  # a tenth of a recording of a cone with k = 20 begins 1.3 mm late
        (0.100, None, False),  # a thin core in a thick fibre
        (0.100, 0.250, True),  # no thin core
        (0.252, 0.250, False),
    ],
)
def test_light_at_the_tip_is_no_wider_than_the_fibre_and_as_wide_as_the_core(
    radius_mm, core_mm, told
):
    found = contact(radius_mm, 0.001, core_mm=core_mm, core_sigma=0.01, fibre_mm=0.25, where="rec")
    assert bool(disagreements([found])) == told


@pytest.mark.parametrize("stated_to", [0.0, 0.02])
def test_a_prior_is_contradicted_by_chance_as_often_as_by_a_normal_number(stated_to):
    # The data are off by noise, and by the error of something that the fit takes as stated.
    rng, cause = np.random.default_rng(5), "The first frame"
    sigmas = []
    for _ in range(500):
        truth, measured_to = 0.02 * rng.normal(), 0.01
        measured = truth + measured_to * rng.normal() + stated_to * rng.normal()
        weights = np.array([0.02, measured_to]) ** -2.0
        share = weights[1] / weights.sum()
        sigma = math.hypot(weights.sum() ** -0.5, share * stated_to)
        numbers = share * measured, sigma, 0.0, 0.02
        given = {"cause": cause, "considered": share * stated_to}
        sigmas.append(against_prior("touch", "x", *numbers, **given).sigmas)
    # As above: 3.2 % of 500 numbers.
    assert np.std(sigmas) == pytest.approx(1.0, abs=4 * 0.032)


def test_a_prior_to_which_the_data_add_nothing_is_compared_as_it_is():
    cause = "The first frame"
    for sigma in (0.0199, 0.05):  # the data add nothing; a misfit has enlarged the error
        for value in (0.001, 0.1):
            found = against_prior("touch", "x", value, sigma, 0.0, 0.02, cause=cause)
            assert found.sigmas == pytest.approx(value / 0.02)
