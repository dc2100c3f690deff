"""The poses that the robot has sent last."""

from __future__ import annotations

from typing import Any

from estimator.files import Pose, PoseTrack

POSES_KEPT = 400  # two seconds at the robot's 200 Hz; images reach the node sooner


class RecentPoses:
    """Takes poses in one thread, and gives them in any other."""

    def __init__(self) -> None:
        self._poses: tuple[Pose, ...] = ()

    def take(self, message: Any, received_s: float) -> None:
        """Remember a pose.

        Args:
            message: `geometry_msgs/Transform`, mm.
            received_s: when it arrived, s: the message has no time stamp.

        Raises:
            InputError: its rotation is no unit quaternion, or a number is not finite.
        """
        position, turn = message.translation, message.rotation
        pose = Pose(
            time_s=received_s,
            position_mm=(position.x, position.y, position.z),
            rotation=(turn.x, turn.y, turn.z, turn.w),
        )
        # Poses arrive in another thread. A tuple is replaced as a whole, never half changed.
        kept = self._poses[1 - POSES_KEPT :]
        # A recording that begins anew sets the clock back; the older poses lie in its future.
        self._poses = (pose,) if kept and received_s < kept[-1].time_s else (*kept, pose)

    def track(self) -> PoseTrack:
        """The poses that are known now."""
        return PoseTrack(self._poses)
