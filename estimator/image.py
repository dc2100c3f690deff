"""Images and outlines as people see them."""

from collections.abc import Sequence

import cv2
import numpy as np

from eyespot.formats.camera_sheet import LensDistortion, Response

_OUTLINE_POINTS = 180  # 2 px apart at a radius of 60 px


def rgb_8bit(image: np.ndarray, response: Response) -> np.ndarray:
    """A frame as 8-bit RGB; the camera's full scale becomes 255.

    Args:
        image: (H, W) or RGB (H, W, 3), of any of the types of a frame.
    """
    if image.dtype != np.uint8 or response.full_scale is not None:
        scale = 255 / response.full_scale_of(image)
        image = np.clip(np.rint(image * scale), 0, 255).astype(np.uint8)
    return cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) if image.ndim == 2 else image.copy()


def outline_px(
    ellipse: Sequence[float], camera: LensDistortion | None
) -> tuple[np.ndarray, np.ndarray]:
    """An ellipse as it appears in the frame.

    Args:
        ellipse: the parameters of a spot, in the order of `PARAMETERS`.
        camera: whose distortion was removed from the ellipse; it is applied again. None for none.

    Returns:
        Points of the closed contour, (180, 2), and the centre, (2,), px.
    """
    x, y, major, minor, angle = ellipse
    t = np.linspace(0, 2 * np.pi, _OUTLINE_POINTS, endpoint=False)
    along, across = major * np.cos(t), minor * np.sin(t)
    c, s = np.cos(angle), np.sin(angle)
    points = np.stack([x + along * c - across * s, y + along * s + across * c], 1)
    centre = np.array([[x, y]])
    if camera is not None:
        points, centre = camera.all_distorted(points), camera.all_distorted(centre)
    return points, centre[0]
