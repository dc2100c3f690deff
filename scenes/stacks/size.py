"""Least size of a stack on disk, to see before rendering that a disk is too full."""

from __future__ import annotations

import math

from scenes.description import Scene
from scenes.world import frame_count

_LINEAR_BYTES = 4  # float32, not compressed


def least_bytes(scene: Scene) -> float:
    r"""Least size of a scene's stack on disk: that of the noise in its images.

    No lossless format makes Gaussian noise of $\sigma$ DN smaller than its entropy of
    $\log_2(\sigma \sqrt{2 \pi e})$ bits a sample (Shannon 1948). Half of it is counted, because
    dark and saturated pixels clip half of their noise or all of it.
    """
    camera, microscope = scene.camera, scene.microscope
    size = {"height": microscope.height_px, "width": microscope.width_px}
    sigma_dn = 0.0 if camera.jpeg_quality else camera.read_noise_e * camera.system_gain
    bits = max(math.log2(sigma_dn * math.sqrt(2 * math.pi * math.e)), 0.0) if sigma_dn else 0.0
    image = math.prod(camera.sensor_shape(**size)) * bits / 8 / 2
    linear = 3 * math.prod(size.values()) * _LINEAR_BYTES if scene.exposures.keep_linear else 0
    return frame_count(scene) * len(scene.exposures.kinds) * (image + linear)
