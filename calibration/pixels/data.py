"""Frames as light with a known noise, with the conditions of the recording.

Reads images, times, exposures, the robot's poses and the microscope's file. From the scene it reads
only the camera's data sheet, the wall's kind, the medium and the instrument's sizes. It does not
read the labels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

import optics
from calibration.recordings import withdrawal
from estimator import Stack
from estimator.files import MicroscopeFile, read_microscope
from estimator.image import CameraNoise
from estimator.sources import open_source
from optics import InputError, shortened

# 20 gauge, the thickest shaft in use. With a thinner shaft a few visible pixels are left out.
_SHAFT_RADIUS_MM = 0.455


class Instrument(NamedTuple):
    """Bare fibre at the end of a shaft: the fibre's radius and length, mm."""

    fibre_radius: float
    fibre_length: float

    def hides(
        self,
        origin: Float[np.ndarray, "*n 3"],
        sight: Float[np.ndarray, "*n 3"],
        *,
        tip: Float[np.ndarray, "3"],
        axis: Float[np.ndarray, "3"],
        margin: float,
    ) -> Bool[np.ndarray, "*n"]:
        """Whether lines of sight meet the instrument, enlarged by a margin.

        Args:
            origin: a point on each line, mm.
            sight: unit directions of the lines.
            tip: S, mm.
            axis: unit vector from the tip towards the wall.
            margin: mm.
        """
        rods = (
            (self.fibre_radius, -self.fibre_length, 0.0),
            (_SHAFT_RADIUS_MM, -math.inf, -self.fibre_length),
        )
        offset = origin - tip
        height, rise = offset @ axis, sight @ axis
        foot, aside = offset - height[..., None] * axis, sight - rise[..., None] * axis
        # A line meets a rod if its sections inside the cylinder and between the ends overlap.
        a, b = np.sum(aside**2, axis=-1), np.sum(foot * aside, axis=-1)
        hidden = np.zeros(a.shape, bool)
        for radius, back, front in rods:
            with np.errstate(divide="ignore", invalid="ignore"):
                inside = b**2 - a * (np.sum(foot**2, axis=-1) - (radius + margin) ** 2)
                root = np.sqrt(inside)
                planes = [(end - height) / rise for end in (back - margin, front + margin)]
                first = np.maximum((-b - root) / a, np.minimum(*planes))
                last = np.minimum((-b + root) / a, np.maximum(*planes))
            hidden |= (inside > 0) & (first < last)
        return hidden


@dataclass(frozen=True, kw_only=True, eq=False)
class Footage:
    """A withdrawal's frames as light.

    Attributes:
        light: mean of the channels, full wells, frames x h x w.
        clear: whether a pixel is neither black nor saturated in any channel.
        exposure_s: exposure times that the camera reports.
        readings: distance of the tip from its place in the first frame, mm.
        motion: unit vector against the tip's motion, towards the wall, reported by the robot.
        axis: unit vector along the tool from the tip towards the wall, reported by the robot.
        noise: the camera's noise.
        microscope: the stack's microscope file.
        instrument: the tool, which can hide the wall and touches it in the first frame.
        in_view: whether the instrument is visible.
        kind: kind of the wall, "eyeball" or "plane".
        medium_index: n0.
    """

    light: Float[np.ndarray, "frames h w"]
    clear: Bool[np.ndarray, "frames h w"]
    exposure_s: Float[np.ndarray, "frames"]
    readings: Float[np.ndarray, "frames"]
    motion: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    noise: CameraNoise
    microscope: MicroscopeFile
    instrument: Instrument
    in_view: bool
    kind: str
    medium_index: float


def read_footage(stack: Stack, *, exposure: str | None = None) -> Footage:
    """Read a stack's frames as light.

    Args:
        stack: a withdrawal that begins at contact.
        exposure: see `open_source`.

    Raises:
        InputError: a camera that the noise model does not support, or robot
            poses that are no withdrawal or do not cover all frames.
    """
    microscope = read_microscope(stack.folder / "microscope.json")
    noise = CameraNoise.of(_camera_of(stack), microscope.response)
    frames = list(open_source(stack.folder, exposure=exposure))
    times = np.array([frame.time_s for frame in frames])
    readings, motion, axis, _ = withdrawal(
        times, stack.folder / "kinematics.csv", source=stack.folder
    )

    def number(key: str) -> float:
        return stack.described(f"scene.{key}", float)

    medium = stack.described("scene.source.medium", str)
    if medium not in optics.MEDIA:
        raise InputError(f"{stack.folder}: unknown medium {shortened(medium)}. Render it again.")
    return Footage(
        light=np.stack([noise.light(frame.image) for frame in frames]).astype(np.float32),
        clear=np.stack([_clear(frame.image, noise.full_scale) for frame in frames]),
        exposure_s=np.array([frame.exposure_s for frame in frames]),
        readings=readings,
        motion=motion,
        axis=axis,
        noise=noise,
        microscope=microscope,
        instrument=Instrument(
            number("instrument.fibre_diameter_mm") / 2, number("instrument.fibre_length_mm")
        ),
        in_view=stack.described("scene.instrument.visible", bool),
        kind=stack.described("scene.phantom.kind", str),
        medium_index=optics.MEDIA[medium],
    )


def _camera_of(stack: Stack) -> dict[str, Any]:
    """The table [camera] of a stack's scene, with every key that `CameraNoise.of` reads."""
    numbers = ("prnu", "dsnu_e", "full_well_e", "read_noise_e", "dark_signal_e", "black_level_dn")
    kinds: dict[str, type] = {"bayer": str, "jpeg_quality": int, "bit_depth": int}
    kinds |= dict.fromkeys(numbers, float)
    return {key: stack.described(f"scene.camera.{key}", kind) for key, kind in kinds.items()}


def _clear(image: np.ndarray, full_scale: int) -> Bool[np.ndarray, "h w"]:
    return np.asarray(((image > 0) & (image < full_scale)).all(axis=-1))
