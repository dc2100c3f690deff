"""A robot's clock beside the camera's: what a withdrawal says of it, and what it does not."""

import numpy as np
import pytest

from eyespot import calibration, optics
from eyespot.estimator.distance.withdrawal import withdrawal_of
from eyespot.formats.poses import Pose, PoseTrack, RobotKeys
from tests.support.drawn.exact_spots import cone_trial, exact_spots

pytestmark = pytest.mark.usefixtures("fast_compilation")

EYE = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
TOUCH_MM = 0.15
SPEED_MM_S = 1.0
TIMES_S = np.linspace(0.0, 5.0, 25)
LONG_S = np.arange(-1.0, 6.0, 0.005)
SIGMAS = np.diag([0.01, 0.01, 0.01, 0.01, 0.005]) ** 2
PRIOR = calibration.Prior(0.0, 0.05)


def sets_off(times_s):
    """It rests at the wall until the first frame, as most recordings begin."""
    return SPEED_MM_S * np.maximum(times_s, 0.0)


def pauses(times_s):
    return SPEED_MM_S * (np.minimum(times_s, 2.0) + np.maximum(times_s - 3.0, 0.0))


def at_one_speed(times_s):
    return SPEED_MM_S * np.asarray(times_s)


def clock_of(gone_mm, *, poses_s=LONG_S, late_s=0.0):
    """Clock offset, and its standard error, of spots without noise that are known to 0.01 px.

    Args:
        gone_mm: how far the tip has gone at each time.
        poses_s: when the robot reports its place, on the camera's clock.
        late_s: by how much its clock is behind the camera's.
    """
    places = [(1.0, 0.5, 0.5, 1.0, TOUCH_MM + gone) for gone in gone_mm(TIMES_S)]
    ellipses, beams = exact_spots(optics.Sphere(11.5), EYE, places)
    axis = np.asarray(beams.axis)[0]
    turn = Pose.along(tuple(axis), time_s=0.0, position_mm=(0.0, 0.0, 0.0)).rotation
    poses = PoseTrack.of_arrays(
        poses_s - late_s, -axis * gone_mm(poses_s)[:, None], np.tile(turn, (len(poses_s), 1))
    )
    way = withdrawal_of(poses, TIMES_S, robot=RobotKeys(clock_sigma_s=PRIOR.sigma))
    trial = cone_trial(
        ellipses,
        SIGMAS,
        readings=way.readings,
        delayed=way.delayed,
        delay_s=way.delay_s,
        axis=way.axis,
        motion=way.motion,
        touch=calibration.Prior(TOUCH_MM, 0.02),
    )
    free = "half_angle", "b", "clock_offset"
    start = {"half_angle": 0.05, "b": -5.1}
    fit = calibration.fit_cone([trial], EYE, start=start, free=free, priors={"clock_offset": PRIOR})
    assert fit.converged
    return fit.values["clock_offset"], float(np.sqrt(fit.covariance[2, 2]))


@pytest.mark.parametrize("late_s", [-0.08, -0.03, 0.0, 0.03, 0.08])
@pytest.mark.parametrize("gone_mm", [sets_off, pauses])
def test_a_clock_is_found_within_its_error_where_the_robot_sets_off_or_pauses(gone_mm, late_s):
    found, sigma = clock_of(gone_mm, late_s=late_s)
    # Only the prior pulls, by at most 1.6 of its standard deviations.
    assert abs(found - late_s) < max(1.7 * sigma, 1e-3)
    if gone_mm is pauses:
        # Of 24 places known to 20 x 0.01 px / sqrt(2), 1 um, a fifth pauses, at 1 mm/s: 0.5 ms.
        assert sigma < 1e-3


@pytest.mark.parametrize("poses_s", [TIMES_S, LONG_S])
def test_at_one_speed_nothing_says_how_late_a_clock_is(poses_s):
    # Also if its file begins with the first frame and ends with the last.
    assert clock_of(at_one_speed, poses_s=poses_s) == pytest.approx(tuple(PRIOR), abs=1e-5)


@pytest.mark.parametrize("late_s", [-0.041, 0.041])
def test_a_clock_is_not_known_better_than_few_poses_tell_it(late_s):
    """A robot reports 20 places a second, and whether the first frame shows it at rest is open."""
    found, sigma = clock_of(
        lambda times: 1.4 * sets_off(times), poses_s=np.arange(-1.0, 6.0, 0.05), late_s=late_s
    )
    assert abs(found - late_s) < 2.0 * sigma
