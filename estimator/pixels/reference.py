"""What an image of the wall without the spot says of the wall's reflectance.

Where the ambient light varies smoothly, the logarithm of the light is the logarithm of the
reflectance, but for a smooth surface of the second degree.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from estimator.image import CameraNoise
from estimator.pixels.cells import COUNT, CellLight, Window
from estimator.pixels.mix import Mix

_CLEAR = 5.0  # standard deviations of the noise, above which a cell's logarithm is good
_FEWEST = 50  # such cells

_ALONG = (np.arange(COUNT) + 0.5) / (0.5 * COUNT) - 1.0
_X, _Y = np.tile(_ALONG, COUNT), np.repeat(_ALONG, COUNT)
_SMOOTH = np.stack([np.ones(COUNT**2), _X, _Y, _X**2, _X * _Y, _Y**2])
"""The ambient light's logarithm: any mixture of these."""


class Reference:
    """An image of the wall in the ambient light alone.

    Args:
        image: H x W x 3.
        noise: of the camera.
    """

    def __init__(self, image: np.ndarray, noise: CameraNoise) -> None:
        self._noise = noise
        self._channels = noise.channels(image)
        self._usable = np.all(image < noise.full_scale, axis=-1)

    def known(
        self, window: Window, mix: Mix
    ) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n"]]:
        """Information on the cells' log reflectance, and its product with the best guess of it.

        Args:
            window: the cells.
            mix: of the channels in which the spot is looked at. Ambient light has another colour,
                so that each channel counts as it does in the spot.
        """
        mean = self._channels[self._usable].mean(axis=0)
        parts = mix.weights * mix.shares / np.maximum(mean, 1e-6)

        def variance(light: np.ndarray) -> np.ndarray:
            return sum(
                part**2 * self._noise.channel_variance(level * light)
                for part, level in zip(parts, mean, strict=True)
            )

        cells = CellLight(self._channels @ parts, self._usable, variance)
        light, usable = (part.ravel() for part in cells.means(window))
        sigma = np.sqrt(variance(np.maximum(light, 0.0))) / window.side
        clear = usable & (light > _CLEAR * sigma)
        if np.count_nonzero(clear) < _FEWEST:
            return np.zeros((COUNT**2, COUNT**2)), np.zeros(COUNT**2)
        light = np.where(clear, light, 1.0)
        weight = np.where(clear, np.square(light / sigma), 0.0)
        weighted = _SMOOTH * weight
        smooth = weighted.T @ np.linalg.pinv(weighted @ _SMOOTH.T, hermitian=True) @ weighted
        information = np.diag(weight) - smooth
        return information, information @ np.log(light)
