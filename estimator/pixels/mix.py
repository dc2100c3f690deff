"""The mixture of a camera's channels in which the wall is most even.

Vessels are dark in green and hardly visible in red. A mixture of channels has less texture than
each of them, and the texture is what limits the pose of a first frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from estimator.image import GREY_WEIGHTS, CameraNoise
from estimator.pixels.cells import CellLight, Window
from estimator.pixels.solution import Solution

_LEAST = 1e-4  # full wells, of a channel
_BRIGHT = 0.25  # of the brightest cell; darker ones show the ambient light
_FEWEST = 20  # cells from which a mixture is chosen
_MOST = 2.0  # of a channel's weight; larger ones would only add noise
_RIDGE = 1e-4  # of the mean variance


@dataclass(frozen=True, eq=False)
class Mix:
    """A mixture of channels.

    Attributes:
        weights: of the channels' light; that of a grey spot of light 1 is 1.
        shares: light of each channel over that of the mixture.
    """

    weights: Float[np.ndarray, "3"]
    shares: Float[np.ndarray, "3"]

    @classmethod
    def of_shares(cls, parts: Float[np.ndarray, "3"], light: Float[np.ndarray, "3"]) -> Mix:
        """Of parts that add up to 1, for channels with some mean light, full wells."""
        level = float(np.mean(light))
        return cls(weights=np.asarray(parts) * level / light, shares=light / level)

    def light(self, channels: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
        """The mixture's light."""
        return channels @ self.weights.astype(channels.dtype)

    def variance(
        self, noise: CameraNoise, light: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        """Variance of a pixel's light in the mixture."""
        return sum(
            weight**2 * noise.channel_variance(share * light)
            for weight, share in zip(self.weights, self.shares, strict=True)
        )


def plain_mix(light: Float[np.ndarray, "3"], saturated: Bool[np.ndarray, "3"]) -> Mix:
    """The luminance, which JPEG keeps best, for light of some colour.

    Args:
        light: of the channels.
        saturated: channels that do not count, unless all are.
    """
    light = np.maximum(light, _LEAST)
    parts = np.array(GREY_WEIGHTS) * light
    if not saturated.all():
        parts[saturated] = 0.0
    return Mix.of_shares(parts / parts.sum(), light)


def evener_mix(
    channels: Float[np.ndarray, "h w 3"],
    usable: Bool[np.ndarray, "h w"],
    window: Window,
    solution: Solution,
    mix: Mix,
) -> Mix:
    """The mixture of channels with the least texture in a fitted frame.

    Args:
        channels: light of the frame's channels.
        usable: whether a pixel is neither saturated nor hidden.
        window: of the solution.
        solution: a fit of the frame alone.
        mix: of that fit, which stays if a channel is dark.
    """
    line, frame = solution.linear[-1], solution.frames[-1]
    light = frame.cells.means(window)[0].ravel()
    parts, seen = zip(
        *(
            CellLight(np.ascontiguousarray(channels[..., c]), usable, np.zeros_like).means(window)
            for c in range(channels.shape[-1])
        ),
        strict=True,
    )
    bright = (line.weight > 0) & seen[0].ravel() & (light > _BRIGHT * light.max())
    own = np.stack([part.ravel()[bright] for part in parts])
    if np.count_nonzero(bright) < _FEWEST or not own.min() > 0:
        return mix
    residuals = np.log(own) - np.log(light[bright]) + line.residual[bright]
    # What another pose would explain does not count: the fit has taken it from this mixture.
    fitted = np.concatenate([line.slopes, line.shared])[:, bright].T
    residuals -= (fitted @ np.linalg.lstsq(fitted, residuals.T, rcond=1e-9)[0]).T
    return Mix.of_shares(_most_even(residuals), own.mean(axis=1))


def _most_even(residuals: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3"]:
    """Parts of the channels, which add up to 1, whose log light has the least variance."""
    spread = np.cov(residuals)
    spread += _RIDGE * np.trace(spread) * np.eye(len(spread))
    parts = np.linalg.solve(spread, np.ones(len(spread)))
    parts /= parts.sum()
    if np.abs(parts).max() > _MOST:  # nearly equal channels: towards the plain mean
        mean = 1.0 / len(parts)
        parts = mean + (_MOST - mean) / (np.abs(parts).max() - mean) * (parts - mean)
    return parts
