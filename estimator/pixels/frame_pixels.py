"""The pixels of a frame: their light in a mixture of channels, and which of them show the wall.

Vessels are dark in green and hardly visible in red. A mixture of channels has less texture than
each of them, and the texture is what limits the pose of a first frame.

A reference image shows the wall without the spot. Where its ambient light varies smoothly, the
logarithm of the light is the logarithm of the reflectance, but for a smooth surface of the second
degree.

A cell in which the light of the spot ends at a tool, or at its shadow, says nothing of the spot's
edge, and before a pose is known it cannot be distinguished from one at that edge. Pixels can: they
are dark well within the spot.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from eyespot.estimator.camera_noise import CameraNoise
from eyespot.estimator.detector.clipping import clip_level
from eyespot.estimator.pixels.frame_cells import (
    COUNT,
    SHADES,
    STILL,
    CellLight,
    CellWindow,
    WallMotion,
)
from eyespot.estimator.pixels.pose_solver import PoseSolution
from eyespot.formats.camera_sheet import GREY_WEIGHTS
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import Outline

_MIN_LIGHT = 1e-4  # full wells, of a channel
_LIT_SHARE = 0.25  # over the brightest cell; darker ones show the ambient light
_MIN_LIT_CELLS = 20  # cells from which a mixture is chosen
_MAX_CHANNEL_WEIGHT = 2.0  # larger ones would only add noise
_RIDGE = 1e-4  # over the mean variance


@dataclass(frozen=True, eq=False)
class Mix:
    """A mixture of channels.

    Attributes:
        weights: of the channels' light; that of a grey spot of light 1 is 1.
        shares: light of each channel over that of the mixture.
    """

    weights: Float[np.ndarray, "c"]
    shares: Float[np.ndarray, "c"]

    @classmethod
    def of_shares(cls, parts: Float[np.ndarray, "c"], light: Float[np.ndarray, "c"]) -> "Mix":
        """Of parts that add up to 1, for channels with some mean light, full wells."""
        level = float(np.mean(light))
        return cls(weights=np.asarray(parts) * level / light, shares=light / level)

    def light(self, channels: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "h w"]:
        """The mixture's light."""
        return channels @ self.weights.astype(channels.dtype)


def evener_mix(
    channels: Float[np.ndarray, "h w c"],
    usable: Bool[np.ndarray, "h w"],
    window: CellWindow,
    solution: PoseSolution,
    mix: Mix,
) -> Mix:
    """The mixture of channels with the least texture in a fitted frame.

    Args:
        usable: whether a pixel is neither saturated nor hidden.
        mix: of that fit, which stays if a channel is dark.
    """
    line, frame = solution.linear[-1], solution.newest
    light = frame.cells.means(window).light
    parts = [
        CellLight(np.ascontiguousarray(channels[..., c]), usable, np.zeros_like).means(window)
        for c in range(channels.shape[-1])
    ]
    bright = (line.weight > 0) & parts[0].usable & (light > _LIT_SHARE * light.max())
    own = np.stack([part.light[bright] for part in parts])
    if np.count_nonzero(bright) < _MIN_LIT_CELLS or not own.min() > 0:
        return mix
    residuals = np.log(own) - np.log(light[bright]) + line.residual[bright]
    # What another pose would explain does not count: the fit has taken it from this mixture.
    fitted = np.concatenate([line.slopes, line.shared])[:, bright].T
    residuals -= (fitted @ np.linalg.lstsq(fitted, residuals.T, rcond=1e-9)[0]).T
    return Mix.of_shares(_most_even(residuals), own.mean(axis=1))


def _most_even(residuals: Float[np.ndarray, "c n"]) -> Float[np.ndarray, "c"]:
    """Parts of the channels, which add up to 1, whose log light has the least variance."""
    spread = np.atleast_2d(np.cov(residuals))
    spread += _RIDGE * np.trace(spread) * np.eye(len(spread))
    parts = np.linalg.solve(spread, np.ones(len(spread)))
    parts /= parts.sum()
    if np.abs(parts).max() > _MAX_CHANNEL_WEIGHT:  # nearly equal channels: towards the plain mean
        mean = 1.0 / len(parts)
        parts = mean + (_MAX_CHANNEL_WEIGHT - mean) / (np.abs(parts).max() - mean) * (parts - mean)
    return parts


_CLEAR_SIGMAS = 5.0  # standard deviations of the noise, above which a cell's logarithm is good
_MIN_CLEAR_CELLS = 50  # such cells

_SMOOTH = np.stack([np.ones(COUNT**2), *SHADES])
"""The ambient light's logarithm: any mixture of these."""


class Reference:
    """An image of the wall, H x W or H x W x 3, in the ambient light alone."""

    def __init__(self, image: np.ndarray, noise: CameraNoise) -> None:
        self._noise = noise
        self._channels = noise.channels(image)
        self._usable = np.all(np.atleast_3d(image) < noise.full_scale, axis=-1)

    def known_in(self, mix: Mix) -> Callable[[CellWindow], tuple[np.ndarray, np.ndarray]]:
        """What the image says of a window's cells, in a mixture of channels, see `PoseSolver`."""
        # Ambient light has another colour than the spot, so that each channel counts as it does in
        # the spot.
        mean = self._channels[self._usable].mean(axis=0)
        parts = mix.weights * mix.shares / np.maximum(mean, 1e-6)
        ambient = Mix(weights=parts, shares=mean)
        cells = CellLight(
            ambient.light(self._channels),
            self._usable,
            functools.partial(self._noise.mixture_variance, ambient.weights, ambient.shares),
        )

        def known(window: CellWindow) -> tuple[np.ndarray, np.ndarray]:
            light, usable, sigma = cells.means(window)
            clear = usable & (light > _CLEAR_SIGMAS * sigma)
            if np.count_nonzero(clear) < _MIN_CLEAR_CELLS:
                return np.zeros((COUNT**2, COUNT**2)), np.zeros(COUNT**2)
            light = np.where(clear, light, 1.0)
            weight = np.where(clear, np.square(light / sigma), 0.0)
            weighted = _SMOOTH * weight
            smooth = weighted.T @ np.linalg.pinv(weighted @ _SMOOTH.T, hermitian=True) @ weighted
            information = np.diag(weight) - smooth
            return information, information @ np.log(light)

        return known


_DARK = 0.4
"""Of the spot's light, below which a pixel is hidden. Vessels of a retina are half as bright as the
rest at least, and a shadow has the ambient light alone."""
_BRIGHT_QUANTILE = 0.95  # quantile of the light within the spot, a tenth of which is seen at least
_THIN_LINE_KERNEL = np.ones((5, 5), np.uint8)  # px, of dark lines that hide nothing
_BORDER_PX = 7  # width of the border beside what hides the spot
_BESIDE = 0.2
"""Width of that border out of the spot, over its radius. What hides the spot goes on there, and
differs less from the wall."""


def hidden_pixels(
    channels: Float[np.ndarray, "h w c"], spot: Outline
) -> Bool[np.ndarray, "h w"] | None:
    """Pixels within a spot that do not show its light, with the border beside them.

    Returns:
        The pixels, or None if the spot is seen as a whole.
    """
    reach = math.ceil(spot.semi_major_px)
    left, top = max(round(spot.x_px) - reach, 0), max(round(spot.y_px) - reach, 0)
    part = channels[top : round(spot.y_px) + reach + 1, left : round(spot.x_px) + reach + 1]
    if not part.size:
        return None
    light = part.mean(axis=-1)
    inside = np.zeros(light.shape, np.uint8)
    inner = 2.0 * max(spot.semi_minor_px - spot.edge_width_px, 0.0)
    outer = inner * spot.semi_major_px / spot.semi_minor_px
    middle = spot.x_px - left, spot.y_px - top
    cv2.ellipse(inside, (middle, (outer, inner), math.degrees(spot.angle_rad)), 1, cv2.FILLED)
    if not inside.any():
        return None
    dark = inside & (light < _DARK * np.quantile(light[inside > 0], _BRIGHT_QUANTILE))
    dark = cv2.morphologyEx(dark.astype(np.uint8), cv2.MORPH_OPEN, _THIN_LINE_KERNEL)
    if not dark.any():
        return None
    hidden = np.zeros(channels.shape[:2], np.uint8)
    hidden[top : top + len(light), left : left + light.shape[1]] = dark
    beside = cv2.dilate(hidden, _square(_BESIDE * spot.semi_minor_px))
    beside[top : top + len(light), left : left + light.shape[1]][inside > 0] = 0
    return np.logical_or(cv2.dilate(hidden, _square(_BORDER_PX)), beside)


def _square(width_px: float) -> np.ndarray:
    return np.ones((round(width_px), round(width_px)), np.uint8)


_MIDDLE_HALF_SIDE = 0.7  # semi-minor axes: half the side of a square about the spot's middle
_LEAST_HALF_SIDE_PX = 2.0


@dataclass(frozen=True, eq=False)
class FramePixels:
    """A frame's pixels.

    Attributes:
        channels: light, full wells.
        ends: light at which a channel is clipped.
        saturated: whether a channel is at full scale in the spot, which has a sharp edge. The edge
            is seen nevertheless.
    """

    noise: CameraNoise
    channels: Float[np.ndarray, "h w c"]
    ends: Float[np.ndarray, "c"]
    full: Bool[np.ndarray, "h w c"]
    usable: Bool[np.ndarray, "h w"]
    saturated: Bool[np.ndarray, "c"]

    @classmethod
    def of(cls, image: np.ndarray, noise: CameraNoise) -> "FramePixels":
        """All of an image, H x W or H x W x 3.

        Raises:
            InputError: it is brighter than the camera can be.
        """
        if image.max() > noise.full_scale:
            raise InputError(
                f"the microscope file says that the camera's values end at {noise.full_scale}, but "
                f"the image has values up to {image.max():g}. Correct camera.bit_depth."
            )
        image = np.atleast_3d(image)
        usable, saturated = np.ones(image.shape[:2], bool), np.zeros(image.shape[2], bool)
        clips = [
            min(clip_level(values, values > values.max() // 2), noise.full_scale)
            for values in np.moveaxis(image, -1, 0)
        ]
        ends = noise.channels(np.array(clips, image.dtype))
        return cls(noise, noise.channels(image), ends, image >= clips, usable, saturated)

    def with_sharp(self, spot: Outline) -> "FramePixels":
        """The frame without what hides a spot with a sharp edge, which may be saturated."""
        hidden = hidden_pixels(self.channels, spot)
        usable = self.usable if hidden is None else self.usable & ~hidden
        shown = replace(self, usable=usable)
        full = shown._in_middle(self.full, spot)
        return replace(shown, saturated=np.mean(full, axis=0) > 0.5) if full.size else shown

    def plain_mix(self, spot: Outline) -> Mix:
        """The luminance, which JPEG keeps best, for light of the spot's colour."""
        seen = self._in_middle(self.channels, spot)
        count = len(self.saturated)
        light = np.maximum(seen.mean(axis=0) if seen.size else np.ones(count), _MIN_LIGHT)
        parts = light * (GREY_WEIGHTS if count == 3 else 1.0)
        if not self.saturated.all():
            parts[self.saturated] = 0.0
        return Mix.of_shares(parts / parts.sum(), light)

    def cells(self, mix: Mix, motion: WallMotion = STILL) -> CellLight:
        """The light in a mixture of channels, after a motion of the wall."""
        mixed = mix.weights != 0
        saturated = bool(self.saturated[mixed].any())
        full = self.full[..., mixed].any(axis=-1)
        return CellLight(
            mix.light(self.channels),
            self.usable if saturated else self.usable & ~full,
            functools.partial(self.noise.mixture_variance, mix.weights, mix.shares),
            motion,
            float(mix.weights @ self.ends) if saturated else math.inf,
        )

    def _in_middle(self, pixels: np.ndarray, spot: Outline) -> np.ndarray:
        """Usable pixels about the middle of a spot, n x c."""
        r = max(_MIDDLE_HALF_SIDE * spot.semi_minor_px, _LEAST_HALF_SIDE_PX)
        rows, columns = (
            slice(max(round(at - r), 0), max(round(at + r) + 1, 0)) for at in (spot.y_px, spot.x_px)
        )
        return pixels[rows, columns][self.usable[rows, columns]]
