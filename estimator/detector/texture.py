"""The wall's texture, estimated from its colours.

Blood and pigment absorb some colours more than others, while light from one source falls off alike
in all. A product of powers of the channels, with exponents that sum to one, leaves such light
unchanged. Of these products, the one that varies least over short distances shows least of the
wall: the beamformer of Capon (1969) on the logarithms. Texture that is equally dark in every colour
remains.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from estimator.detector.ellipse import Ellipse
from estimator.detector.tuning import Texture
from estimator.detector.unwrap import Patch


def without_texture(patch: Patch, colours: np.ndarray, ellipse: Ellipse) -> Patch:
    """The patch divided by the texture that its colours show.

    Args:
        patch: light of the channel or the grey mean to be measured in, at full resolution.
        colours: (h, w, 3) float32 light of the same pixels, nowhere saturated.
        ellipse: of the spot, roughly.
    """
    light = patch.signal
    height, width = light.shape
    cell = max(ellipse.axes()[1] / Texture.CELLS, 1.0)
    cells = max(round(width / cell), 1), max(round(height / cell), 1)
    channels = cv2.resize(np.dstack([colours, light]), cells, interpolation=cv2.INTER_AREA)
    channels = np.maximum(channels.reshape(-1, 4), 0)
    bright = channels[:, 3:]
    # The same fraction of each channel, so that light that falls off alike in all still does.
    lift = Texture.LIFT * (channels * bright).sum(axis=0) / max(bright.sum(), 1e-30) + 1e-30
    logarithms = cv2.log(channels + lift)
    # Twice, because the logarithm of a bell is curved, and the bell's colour differs from that of
    # the other light.
    short = _without_long_waves(_without_long_waves(logarithms.reshape(*cells[::-1], 4)))
    short = bright * short.reshape(-1, 4)[:, :3]
    varying = short.T @ short
    varying.flat[::4] += 1e-6 * varying.trace() + 1e-30
    exponents = np.linalg.solve(varying, np.ones(3))
    texture = logarithms[:, 3] - logarithms[:, :3] @ (exponents / exponents.sum())
    both = np.stack([logarithms[:, 3], logarithms[:, 3] - texture], axis=1)
    uneven = bright * _round_rings(both, _rings(patch, ellipse, cells))
    before, after = np.square(uneven).sum(axis=0)
    if after > Texture.BY_CHANCE * before:  # wide patches of another pigment
        return patch
    texture = cv2.exp((texture - np.median(texture)).astype(np.float32)).reshape(cells[::-1])
    texture = cv2.resize(texture, (width, height), interpolation=cv2.INTER_LINEAR)
    return replace(patch, signal=(light + lift[3]) / texture - lift[3])


def _without_long_waves(image: np.ndarray) -> np.ndarray:
    return image - cv2.GaussianBlur(image, (0, 0), Texture.SHORT_WAVES)


def _rings(patch: Patch, ellipse: Ellipse, cells: tuple[int, int]) -> np.ndarray:
    """Number of the ring about the ellipse's centre in which each cell lies, (h w,)."""
    height, width = patch.signal.shape
    x = (np.arange(cells[0]) + 0.5) * (width / cells[0]) - 0.5 + patch.x0 - ellipse.centre[0]
    y = (np.arange(cells[1]) + 0.5) * (height / cells[1]) - 0.5 + patch.y0 - ellipse.centre[1]
    (a, b), (c, d) = np.linalg.inv(ellipse.shape).tolist()
    radius = np.hypot(a * x + b * y[:, None], c * x + d * y[:, None])
    return np.rint(radius * Texture.CELLS).astype(int).ravel()


def _round_rings(values: np.ndarray, rings: np.ndarray) -> np.ndarray:
    """Values (n, k) less the means of their rings: variation with the radius is the light's."""
    number = np.maximum(np.bincount(rings), 1)
    sums = [np.bincount(rings, column) for column in values.T]
    return values - (np.stack(sums, axis=1) / number[:, None])[rings]
