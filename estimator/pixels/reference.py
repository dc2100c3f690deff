"""What an image of the wall without the spot says of the wall's reflectance.

Where the ambient light varies smoothly, the logarithm of the light is the logarithm of the
reflectance, but for a smooth surface of the second degree.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from estimator.image import CameraNoise
from estimator.pixels.cells import COUNT, SHADES, CellLight, Window
from estimator.pixels.mix import Mix

_CLEAR = 5.0  # standard deviations of the noise, above which a cell's logarithm is good
_FEWEST = 50  # such cells

_SMOOTH = np.stack([np.ones(COUNT**2), *SHADES])
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

    def seen_in(self, mix: Mix) -> ReferenceView:
        """The image in a mixture of channels.

        Ambient light has another colour than the spot, so that each channel counts as it does in
        the spot.
        """
        mean = self._channels[self._usable].mean(axis=0)
        parts = mix.weights * mix.shares / np.maximum(mean, 1e-6)
        ambient = Mix(weights=parts, shares=mean)
        return ReferenceView(
            CellLight(
                ambient.light(self._channels),
                self._usable,
                lambda light: ambient.variance(self._noise, light),
            )
        )


class ReferenceView:
    """A reference in one mixture of channels.

    Args:
        cells: its light.
    """

    def __init__(self, cells: CellLight) -> None:
        self._cells = cells

    def known(self, window: Window) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n"]]:
        """Information on the cells' log reflectance, and its product with the best guess of it."""
        light, usable = (part.ravel() for part in self._cells.means(window))
        sigma = np.sqrt(self._cells.variance(np.maximum(light, 0.0))) / window.side
        clear = usable & (light > _CLEAR * sigma)
        if np.count_nonzero(clear) < _FEWEST:
            return np.zeros((COUNT**2, COUNT**2)), np.zeros(COUNT**2)
        light = np.where(clear, light, 1.0)
        weight = np.where(clear, np.square(light / sigma), 0.0)
        weighted = _SMOOTH * weight
        smooth = weighted.T @ np.linalg.pinv(weighted @ _SMOOTH.T, hermitian=True) @ weighted
        information = np.diag(weight) - smooth
        return information, information @ np.log(light)
