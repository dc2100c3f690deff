"""Frames as light with a known noise, and what a log book says of how they were taken.

Labels stay unread: images, their times and exposures, the robot's poses, the microscope's file, and
of the scene as run the camera's data sheet, the wall's kind, the medium and the instrument's sizes.
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
from estimator.image import Response
from estimator.sources import open_source

_CHANNELS = 3
# Of 20 gauge, the thickest in use: a thinner shaft hides less, which costs a few pixels.
_SHAFT_RADIUS_MM = 0.455
_CLEAR_SIGMAS = 4.0  # that light must keep from black and white, where it would be cut


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraNoise:
    """A camera's temporal noise after EMVA 1288, in full wells.

    Attributes:
        full_well_e: electrons at full scale.
        read_noise_e: standard deviation of a dark pixel, electrons.
        dark_signal_e: mean thermal electrons.
        black: level of a dark pixel, as a part of full scale.
        full_scale: largest number in a file.
        response: curve of the numbers.
    """

    full_well_e: float
    read_noise_e: float
    dark_signal_e: float
    black: float
    full_scale: int
    response: Response

    @classmethod
    def of(cls, camera: dict[str, Any], response: Response) -> CameraNoise:
        """From the table [camera] of the scene as run.

        Raises:
            ValueError: pixels whose noise is not independent.
        """
        told = {
            "bayer": camera["bayer"] != "none",
            "jpeg_quality": camera["jpeg_quality"] > 0,
            "prnu": camera["prnu"] > 0,
            "dsnu_e": camera["dsnu_e"] > 0,
        }
        if any(told.values()):
            names = ", ".join(f"{name} = {camera[name]}" for name, is_set in told.items() if is_set)
            raise ValueError(
                f"the image fit takes every pixel's noise for its own; this camera has {names}. "
                "Record raw frames, divided by a flat field, or fit the spots (--model cone)."
            )
        full_scale = (1 << camera["bit_depth"]) - 1
        return cls(
            full_well_e=camera["full_well_e"],
            read_noise_e=camera["read_noise_e"],
            dark_signal_e=camera["dark_signal_e"],
            black=camera["black_level_dn"] / full_scale,
            full_scale=full_scale,
            response=response,
        )

    def light(self, values: np.ndarray) -> Float[np.ndarray, "h w"]:
        """Mean light of an image's channels; noise may take it below 0."""
        straight = self._straight(values).mean(axis=-1, dtype=float)
        return (straight - self.black) / (1 - self.black) - self.dark_signal_e / self.full_well_e

    def variance(self, light: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Of the mean over channels: shot and read noise, and rounding, where the light is known.

        Rounding acts behind the response curve, so that its steps of light are those of the
        curve's inverse.
        """
        electrons = np.maximum(light, 0) * self.full_well_e + self.dark_signal_e
        counted = (electrons + self.read_noise_e**2) / self.full_well_e**2
        levels = np.arange(self.full_scale + 1).astype(np.min_scalar_type(self.full_scale))
        straight = self._straight(levels)
        step = np.interp(self._level(light), straight, np.gradient(straight)) / (1 - self.black)
        return (counted + step**2 / 12) / _CHANNELS

    def is_clear(self, light: Float[np.ndarray, "*n"]) -> Bool[np.ndarray, "*n"]:
        """Whether noise takes a pixel of this light neither to black nor to white."""
        reach = _CLEAR_SIGMAS * np.sqrt(_CHANNELS * self.variance(light))
        level = self._level(light)
        return (level > reach) & (level < 1 - reach)

    def _level(self, light: np.ndarray) -> np.ndarray:
        return self.black + (1 - self.black) * (light + self.dark_signal_e / self.full_well_e)

    def _straight(self, values: np.ndarray) -> np.ndarray:
        """Numbers before the response curve, as parts of full scale."""
        light = self.response.light(values, float(self.full_scale))
        return light.astype(float) / self.full_scale


class Instrument(NamedTuple):
    """Bare fibre at the end of a shaft: its radius and length, mm."""

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
        """Whether lines of sight meet the instrument, thickened by a margin.

        Args:
            origin: a point of each line, mm.
            sight: unit directions.
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
        # Each line's stretches inside an endless cylinder and between two planes must overlap.
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
        clear: neither black nor white in any channel.
        exposure_s: reported by the camera.
        readings: distance along the beam since the first frame, mm.
        axis: unit vector from the tip towards the wall, as the robot reports it.
        noise: the camera's.
        microscope: the stack's.
        instrument: what may hide the wall, and touches it in the first frame.
        in_view: whether the instrument is.
        edge_variance: of the part of a pixel that a sharp edge cuts off, where a renderer found it
            by samples.
        kind: of the wall, "eyeball" or "plane".
        medium_index: n0.
    """

    light: Float[np.ndarray, "frames h w"]
    clear: Bool[np.ndarray, "frames h w"]
    exposure_s: Float[np.ndarray, "frames"]
    readings: Float[np.ndarray, "frames"]
    axis: Float[np.ndarray, "3"]
    noise: CameraNoise
    microscope: MicroscopeFile
    instrument: Instrument
    in_view: bool
    edge_variance: float
    kind: str
    medium_index: float


def read_footage(stack: Stack, *, exposure: str | None = None) -> Footage:
    """Read a stack's frames as light.

    Args:
        stack: of a withdrawal that begins at contact.
        exposure: "paper" or "metered", where the stack holds both.

    Raises:
        ValueError: the exposure has to be chosen, a camera that the noise model does not know, or
            poses of the robot that are no withdrawal or lack frames.
    """
    scene = stack.description["scene"]
    microscope = read_microscope(stack.folder / "microscope.json")
    noise = CameraNoise.of(scene["camera"], microscope.response)
    frames = list(open_source(stack.folder, exposure=exposure))
    times = np.array([frame.time_s for frame in frames])
    readings, axis = withdrawal(times, stack.folder / "kinematics.csv", source=stack.folder)
    tool = scene["instrument"]
    return Footage(
        light=np.stack([noise.light(frame.image) for frame in frames]).astype(np.float32),
        clear=np.stack([_clear(frame.image, noise.full_scale) for frame in frames]),
        exposure_s=np.array([frame.exposure_s for frame in frames]),
        readings=readings,
        axis=axis,
        noise=noise,
        microscope=microscope,
        instrument=Instrument(tool["fibre_diameter_mm"] / 2, tool["fibre_length_mm"]),
        in_view=tool["visible"],
        # Each of n rows of n samples is off by a part of 1/n, evenly spread.
        edge_variance=1 / (12 * scene["microscope"]["samples"] ** 1.5),
        kind=scene["phantom"]["kind"],
        medium_index=optics.MEDIA[scene["source"]["medium"]],
    )


def _clear(image: np.ndarray, full_scale: int) -> Bool[np.ndarray, "h w"]:
    return np.asarray(((image > 0) & (image < full_scale)).all(axis=-1))
