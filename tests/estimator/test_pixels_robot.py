"""The robot's own motion in the mode pixels."""

import dataclasses
import math

import numpy as np
import pytest

from estimator.pixels.frame_model import RobotPose, _turn, motion_between
from formats.poses import PoseTrack, read_poses
from optics.wall_light.pose_light import BeamFrame
from tests.pixel_stacks import assert_posed, readings_of


def _unit(*vector):
    return np.array(vector) / np.linalg.norm(vector)


def _pose(tip, axis):
    first = np.cross(axis, [0.3, 0.8, 0.1])
    first /= np.linalg.norm(first)
    right, down = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    return BeamFrame(
        np.array(tip), axis, np.asarray(2.0), right, down, first, np.cross(axis, first)
    )


def _moved(pose, change):
    tip, axis = pose.moved(change)
    return pose._replace(tip=tip, axis=axis, distance=pose.distance + change[2])


def test_the_least_rotation_turns_one_axis_into_the_other():
    first, later = _unit(0.1, -0.3, -1.0), _unit(0.3, 0.1, -1.0)
    turn, angle = _turn(first, later)
    np.testing.assert_allclose(turn @ first, later, atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert angle == pytest.approx(math.acos(first @ later))
    # Its own axis stays.
    np.testing.assert_allclose(turn @ np.cross(first, later), np.cross(first, later), atol=1e-12)


def test_a_robot_that_moves_as_the_beam_says_nothing_new_and_slopes_are_differences():
    pose_0, pose = (
        _pose([0, 0, -9], _unit(0.1, 0.0, -1)),
        _pose([0.3, 0, -8.5], _unit(0.2, 0.1, -1)),
    )
    # The robot is elsewhere, but has moved alike.
    home = np.array([5.0, 3.0, -2.0])
    robot_0, robot = (RobotPose(one.tip + home, one.axis, 0.005) for one in (pose_0, pose))
    motion = motion_between((pose_0, robot_0), (pose, robot))
    assert motion is not None
    np.testing.assert_allclose(motion.rest, 0.0, atol=1e-12)
    assert motion_between((pose_0, None), (pose, robot)) is None
    step = 1e-6
    for k, change in enumerate(step * np.eye(5)):
        later = motion_between((pose_0, robot_0), (_moved(pose, change), robot))
        first = motion_between((_moved(pose_0, change), robot_0), (pose, robot))
        assert later is not None
        assert first is not None
        # Of second order in the step.
        np.testing.assert_allclose(-later.rest / step, motion.slopes[:, k], atol=1e-4)
        np.testing.assert_allclose(-first.rest / step, motion.first_slopes[:, k], atol=1e-4)


def test_a_robot_that_is_wrong_by_half_of_its_motion_does_not_pull_the_pose(paper_stack, tmp_path):
    told = list(read_poses(paper_stack.folder / "kinematics.csv"))
    home = np.array(told[0].position_mm)

    def stretched(pose):
        x, y, z = (home + 1.5 * (np.array(pose.position_mm) - home)).tolist()
        return dataclasses.replace(pose, position_mm=(x, y, z))

    readings = list(
        readings_of(paper_stack, tmp_path, PoseTrack([stretched(pose) for pose in told]))
    )
    assert len(readings) == 6
    # The tip goes 0.9 mm; the robot says 1.35.
    assert_posed(readings, within_mm=0.015)
