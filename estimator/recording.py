"""A recording: frames with their times, the robot's poses, and the rig that made them.

    Recording.open("session.bag", rig="rig.toml")
    Recording.open("images", rig="rig.toml", poses="robot.csv")
    Recording(frames=array, times=seconds, poses=table, rig=rig)

`open` is the only place that reads files; what measures and fits takes a recording. A stack is a
recording whose labels are known.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eyespot.estimator.sources.files import listed_images
from eyespot.estimator.sources.opening import array_source, open_source
from eyespot.estimator.sources.source import Frame, Source
from eyespot.formats.inputs import InputError, in_file
from eyespot.formats.microscope import MicroscopeFile
from eyespot.formats.poses import PoseTrack, poses_of_table, read_poses
from eyespot.formats.rig import Rig, read_rig
from eyespot.formats.spots import SpotRecord, read_spots
from eyespot.formats.stack import FrameLabels, Stack

if TYPE_CHECKING:
    import pandas as pd

_FRAMES_FOR_NOISE = 40  # 20 pairs of 640 x 480 px have a variance to 0.1 %
Rigs = Rig | str | Path | None
"""A rig, or its file."""
Changes = Sequence[str] | Mapping[str, Any]
"""Values of a rig to change: "table.key=value", or {"table.key": value}."""
SPOTS_FILES = (".csv", ".parquet")
"""Endings of files of spots, which have no images."""


class Recording:
    """Frames in order, with times, exposure times, poses and rig.

    Args:
        frames: an array of frames x h x w, or frames x h x w x 3 (RGB); a list of such images or of
            image files; or a source.
        times: of the middles of the exposures, s; None: the source's own, if it has any.
        exposure_s: exposure times of an array, s.
        poses: the robot's, on the frames' clock: a track, a table or a file as `read_poses` reads
            it, or None.
        rig: the rig or its file, whose keys come before those of a stack's own; None for that, or
            for a rig of which nothing is known.
        changes: values of the rig to change.
        name: for messages.

    Raises:
        InputError: they do not fit together, or a file is wrong.
        OSError: a file cannot be read.
    """

    def __init__(
        self,
        frames: Source | np.ndarray | Sequence[Any],
        *,
        times: Sequence[float] | np.ndarray | None = None,
        exposure_s: Sequence[float] | np.ndarray | float | None = None,
        poses: "PoseTrack | pd.DataFrame | str | Path | None" = None,
        rig: Rigs = None,
        changes: Changes = (),
        name: str = "frames",
    ) -> None:
        if isinstance(frames, Source):
            self.source = frames
        elif len(frames) and all(isinstance(one, str | Path) for one in frames):
            self.source = listed_images([Path(one) for one in frames])
        else:
            self.source = array_source(frames, times_s=times, exposure_s=exposure_s, name=name)
        own = self.source.rig
        given = read_rig(rig) if isinstance(rig, str | Path) else rig
        if given is not None and own is not None and given is not own:
            given = given.over(own)
        self.rig = (given or own or Rig()).changed(changes)
        self._poses = poses

    @classmethod
    def open(
        cls,
        source: "Recording | Source | Stack | str | Path | int | np.ndarray | Sequence[Any]",
        *,
        rig: Rigs = None,
        changes: Changes = (),
        poses: "PoseTrack | pd.DataFrame | str | Path | None" = None,
        exposure: str | None = None,
        fps: float | None = None,
    ) -> "Recording":
        """The recording in a file, a folder, a stack, or arrays.

        Args:
            source: a stack, folder of images, TIFF, video, ROS bag, spots file, a camera's number,
                genicam:NAME; a list of images or of their files, or an array; or a recording.
            exposure: of a stack that has several, see `open_source`.
            fps: images a second of a folder without times, see `times_of`.

        Raises:
            InputError: as the class, or there is no such source.
            OSError: a file cannot be read.
        """
        if isinstance(source, Recording):
            kept = source._poses if poses is None else poses
            return cls(source.source, poses=kept, rig=rig or source.rig, changes=changes)
        if isinstance(source, Source):
            return cls(source, poses=poses, rig=rig, changes=changes)
        if isinstance(source, Stack):
            source = source.folder
        if not isinstance(source, str | Path | int):
            return cls(source, poses=poses, rig=rig, changes=changes)
        given = read_rig(rig) if isinstance(rig, str | Path) else rig
        if Path(str(source)).suffix.lower() in SPOTS_FILES:
            opened = Source(name=str(source), read=lambda: iter(()))
        else:
            topic = (given or Rig()).changed(changes).robot.image_topic
            opened = open_source(str(source), exposure=exposure, image_topic=topic, fps=fps)
        return cls(opened, poses=poses, rig=given, changes=changes)

    def __repr__(self) -> str:
        count = "" if self.source.length is None else f": {self.source.length} frames"
        return f"<Recording {self.source.name}{count}>"

    @property
    def name(self) -> str:
        """What the recording is called, without its folders."""
        return Path(self.source.name).name

    @property
    def labels(self) -> tuple[FrameLabels, ...]:
        """True values of a stack's frames; empty where nobody knows them."""
        return self.source.labels

    @property
    def view(self) -> MicroscopeFile | None:
        """The microscope and the wall; None if the rig says nothing of them."""
        return self.rig.view

    @property
    def spots(self) -> list[SpotRecord] | None:
        """The spots of a spots file, which has no images; None of other sources."""
        if Path(self.source.name).suffix.lower() not in SPOTS_FILES:
            return None
        return read_spots(Path(self.source.name))

    def poses(self) -> PoseTrack | None:
        """The robot's poses that were given with the recording; None without any.

        Raises:
            InputError: they are wrong.
            OSError: they cannot be read.
        """
        if self._poses is None or isinstance(self._poses, PoseTrack):
            return self._poses
        robot = self.rig.robot
        if isinstance(self._poses, str | Path):
            self._poses = read_poses(self._poses, robot=robot)
        else:
            self._poses = poses_of_table(self._poses, robot=robot)
        return self._poses

    @property
    def has_poses(self) -> bool:
        """Whether there are poses of the robot, readable or not."""
        return self._poses is not None or self.source.poses_file is not None

    def robot(self) -> PoseTrack:
        """The robot's poses, of a stack or a bag its own if no others were given.

        Raises:
            InputError: there are none, or they are wrong.
        """
        found = self.poses()
        if found is None and self.source.poses_file is not None:
            found = read_poses(self.source.poses_file, robot=self.rig.robot)
        if found is None:
            raise InputError(
                f"{self.source.name} contains no poses of the robot. Give --poses FILE: a table or "
                "a bag; [robot] of the rig file says what its columns mean."
            )
        return found

    def measured(self) -> "Recording":
        """The recording whose camera's noise was measured in its frames.

        At most `_FRAMES_FOR_NOISE` frames are read, evenly drawn in pairs of neighbours.

        Raises:
            InputError: the frames do not show it.
        """
        from eyespot.estimator.recording_noise import noise_of_frames

        view = self.rig.view
        assert view is not None
        camera = self.rig.camera
        with in_file(self.source.name):
            noise = noise_of_frames(
                self._pairs(),
                response=replace(view.response, full_scale=None),
                bit_depth=camera.bit_depth,
                black_level_dn=camera.black_level_dn,
            )
        return Recording(self.source, poses=self._poses, rig=self.rig.with_noise(noise.sheet))

    def _pairs(self) -> list[np.ndarray]:
        """Frames in pairs of neighbours."""
        count = self.source.length or _FRAMES_FOR_NOISE
        firsts = set(np.linspace(0, max(count - 2, 0), _FRAMES_FOR_NOISE // 2).round().astype(int))
        wanted = firsts | {first + 1 for first in firsts}
        return [frame.image for frame in self.source if frame.index in wanted and not frame.fault]

    def without_repeats(self) -> "Recording":
        """The recording without frames that equal the one before, as capture cards repeat them.

        They hold no new light, so a fit that counted them would state too small errors.
        """
        source = self.source
        if source.live or self.spots is not None:
            return self

        def read() -> Iterator[Frame]:
            before, number = None, 0
            for frame in source:
                if before is None or not np.array_equal(before, frame.image):
                    yield replace(frame, index=number)
                    number += 1
                before = frame.image

        return Recording(replace(source, read=read), poses=self._poses, rig=self.rig)

    def unrelated(self, unrelated: bool | None) -> "Recording":
        """The recording whose images are measured one by one, or not; None: as its source says."""
        if unrelated is None:
            return self
        source = replace(self.source, unrelated=unrelated)
        return Recording(source, poses=self._poses, rig=self.rig)
