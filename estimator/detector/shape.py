"""Shape of a spot's profile: plateau, bell, or something in between."""

from typing import NamedTuple

import numpy as np

from eyespot.estimator.detector.clipping import clip_level
from eyespot.estimator.detector.ellipse_rays import AffineEllipse, Patch
from eyespot.estimator.detector.levels import outermost_radius
from eyespot.estimator.detector.tuning import RAYS, SpotProfile
from eyespot.estimator.frame_window import Window, checked_frame
from eyespot.formats.camera_sheet import GREY, LensDistortion, Response
from eyespot.formats.spot import Spot

LEVELS = SpotProfile.LEVELS
"""Levels of the isophotes, as fractions of the peak above the background."""

_PROFILE_RADII = np.linspace(0.0, 3.0, 121)
_BACKGROUND = _PROFILE_RADII >= SpotProfile.BACKGROUND
_CORE = np.linspace(0.0, SpotProfile.CORE, 10)


class Shape(NamedTuple):
    """Shape and brightness of a spot's profile.

    Attributes:
        ratios: radii at a quarter and at three quarters of the peak over the half-maximum radius.
        peak: above the background, as a fraction of full scale.
    """

    ratios: tuple[float, float]
    peak: float


def spot_shape(
    frame: np.ndarray, spot: Spot, *, response: Response, camera: LensDistortion | None
) -> Shape | None:
    """Shape and peak of a spot, from the median profile over its rays.

    Args:
        frame: in which the spot was measured; as `estimator.measure` takes it.

    Returns:
        None if the peak is saturated, the wall round the spot is out of view, or there is no spot.
    """
    frame = checked_frame(frame)
    x, y = spot.x_px, spot.y_px
    if camera is not None:
        x, y = camera.distorted(x, y)
    ellipse = AffineEllipse.from_axes(x, y, spot.semi_major_px, spot.semi_minor_px, spot.angle_rad)
    half_width, half_height = ellipse.scaled(_PROFILE_RADII[-1]).half_extent()
    window = Window.around(x, y, half_width + 1, half_height + 1, frame)
    values, full_scale = window.of(frame), response.full_scale_of(frame)

    def profiles_of(signal: np.ndarray, radii: np.ndarray) -> np.ndarray:
        patch = Patch(signal.astype(np.float32), window.x0, window.y0)
        rays = patch.unwrapped(ellipse, radii)
        return rays[~np.isnan(rays).any(axis=1)]

    # A saturated channel has lost its peak; the brightest of the others has the least noise.
    channels = np.atleast_3d(values)
    cores = [profiles_of(channels[:, :, c], _CORE) for c in range(channels.shape[2])]
    if len(cores[0]) < RAYS // 4:
        return None
    tops = np.percentile(cores, 95, axis=(1, 2))
    clips = [
        clip_level(plane, plane > top / 2)
        for plane, top in zip(np.moveaxis(channels, 2, 0), tops, strict=True)
    ]
    whole = tops < np.minimum(clips, full_scale)
    if not whole.any():
        return None
    channel = GREY if whole.all() else int(np.argmax(np.where(whole, tops, -1.0)))
    light = response.channel(values, channel, full_scale)
    profiles = profiles_of(light, _PROFILE_RADII)
    if len(profiles) < RAYS // 4:
        return None
    profile = np.median(profiles, axis=0)
    profile = profile - np.median(profile[_BACKGROUND])
    peak = float(profile[_PROFILE_RADII < 1].max())
    if not peak > 0:
        return None
    quarter, half, three_quarters = (
        outermost_radius(profile, level * peak, _PROFILE_RADII) for level in LEVELS
    )
    return Shape((quarter / half, three_quarters / half), peak / full_scale)
