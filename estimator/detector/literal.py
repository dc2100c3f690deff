"""Literal mode: the paper's Algorithms 1 and 2 (Zhou et al. 2020), step by step.

Grey image, patch check, crop, median and Gaussian filter, threshold 200, connected components, the
largest of more than T_s pixels, an ellipse on its boundary, a minor axis below m_e; the patch
follows the last ellipse. It is kept as the reference that the paper's numbers are compared with.

Slips of the printed algorithms, and how they are mended:

- Algorithm 2 sets m_cy = p and at once overwrites it with r_I - p - 1: the first is kept.
- Algorithm 1 calls PatchCheck(M), Algorithm 2 defines PatchCheck(M, I_GREY): the latter.
- Algorithm 2 names its image input RGB: it is the grey image.
- Algorithm 1 checks the patch twice in the first frame (`imcount == 0`), with one result: once.
- M is updated after `Return`, so the patch would never move: before.
- Algorithm 1 filters the grey patch and thresholds it then; the text thresholds first and filters
  the binary image: both orders, `order`; filtering first is the default.
- "The maximum number of the connected components" is the pixel count of the largest component.
- T_s, m_e, p and the filters' kernels have no values: see `LiteralSettings`.
- a_min is used as the semi-minor axis in the paper's model and as the minor axis against m_e: here
  m_e bounds the full minor axis.
- `vote` and `maxIndex` are set and never used: left out.

Two things are added: without a click the patch is centred on the largest component of the whole
frame, and a frame without an ellipse says why.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np

from eyespot.estimator.detector.clipping import clip_level
from eyespot.formats.camera_sheet import Response
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import NoSpot, Reason, Spot


@dataclass(frozen=True, kw_only=True)
class LiteralSettings:
    """Settings of the literal mode; the paper gives only the threshold.

    Attributes:
        patch_half_width_px: p; the patch is 2p x 2p.
        threshold: on the 8-bit grey scale; brighter pixels are spot.
        min_component_px: T_s, pixels that the largest component must exceed.
        max_minor_axis_px: m_e, below which the ellipse's full minor axis must stay.
        median_px: side of the median filter, odd, 3 or more.
        gaussian_px: side of the Gaussian filter, odd, 3 or more.
        order: "filter_first" as in Algorithm 1, "threshold_first" as in the text.
        response: only its full scale counts, for frames that are not 8-bit.
    """

    patch_half_width_px: int = 200
    threshold: int = 200
    min_component_px: int = 200
    max_minor_axis_px: float = 300.0
    median_px: int = 5
    gaussian_px: int = 5
    order: Literal["filter_first", "threshold_first"] = "filter_first"
    response: Response = field(default_factory=Response)

    def __post_init__(self) -> None:
        """Reject what the filters cannot do."""
        if self.order not in ("filter_first", "threshold_first"):
            raise InputError(
                "LiteralSettings(order=...) must be 'filter_first' or 'threshold_first';"
                f" got {self.order!r}."
            )
        for name in ("median_px", "gaussian_px"):
            side = getattr(self, name)
            if side < 3 or side % 2 == 0:
                raise InputError(
                    f"LiteralSettings({name}=...) must be odd and at least 3; got {side} px."
                )
        if self.patch_half_width_px < 1:
            raise InputError(
                "LiteralSettings(patch_half_width_px=...) must be at least 1 px;"
                f" got {self.patch_half_width_px} px."
            )
        if not 0 <= self.threshold < 255:
            raise InputError(
                f"LiteralSettings(threshold=...) must lie in [0, 255); got {self.threshold}."
            )


def grey_8bit(frame: np.ndarray, settings: LiteralSettings) -> np.ndarray:
    """RGB2GREY of Algorithm 1, on the 8-bit scale."""
    if frame.dtype != np.uint8:
        scale = 255 / settings.response.full_scale_of(frame)
        frame = np.clip(np.rint(frame * scale), 0, 255).astype(np.uint8)
    if frame.ndim == 3:
        return cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY)
    return np.ascontiguousarray(frame)


def patch_check(x: float, y: float, half_width: int, shape: tuple[int, ...]) -> tuple[int, int]:
    """Algorithm 2: the patch's centre, moved so that the patch lies in an image of that shape."""
    rows, columns = (max(length - half_width - 1, half_width) for length in shape[:2])
    return round(min(max(x, half_width), columns)), round(min(max(y, half_width), rows))


def measure_literal(
    frame: np.ndarray, at: tuple[float, float] | None, settings: LiteralSettings
) -> Spot | NoSpot:
    """One turn of Algorithm 1's loop.

    Args:
        at: M, the last position or the click (px); None to search the whole frame.
    """
    grey = grey_8bit(frame, settings)
    p = settings.patch_half_width_px
    if at is None:
        whole = _largest_component(grey, settings)
        if isinstance(whole, NoSpot):
            return whole
        moments = cv2.moments(whole, binaryImage=True)
        at = moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]
    x, y = patch_check(*at, p, grey.shape)
    x0, y0 = x - p, y - p
    component = _largest_component(np.ascontiguousarray(grey[y0 : y + p, x0 : x + p]), settings)
    if isinstance(component, NoSpot):
        return component
    contours, _ = cv2.findContours(component, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    boundary = max(contours, key=len)
    if len(boundary) < 5:
        return NoSpot(Reason.TOO_SMALL)
    (u, v), axes, degrees = cv2.fitEllipse(boundary)
    minor, major = min(axes), max(axes)
    if not all(map(math.isfinite, (u, v, minor, major))) or minor <= 0:
        return NoSpot(Reason.NONE_FOUND)
    if minor >= settings.max_minor_axis_px:
        return NoSpot(Reason.TOO_LARGE)
    patch = grey[y0 : y0 + 2 * p, x0 : x0 + 2 * p]
    clip = min(clip_level(patch, component > 0), 255)
    angle = math.radians(degrees) + (0 if axes[0] == major else math.pi / 2)
    return Spot(
        x_px=x0 + u,
        y_px=y0 + v,
        semi_major_px=major / 2,
        semi_minor_px=minor / 2,
        angle_rad=math.pi / 2 - (math.pi / 2 - angle) % math.pi,  # in (-pi/2, pi/2]
        covariance=np.full((5, 5), math.nan),
        edge_width_px=math.nan,
        coverage=math.nan,
        inlier_fraction=math.nan,
        saturated=float(np.mean(patch[component > 0] >= clip)),
    )


def _largest_component(grey: np.ndarray, settings: LiteralSettings) -> np.ndarray | NoSpot:
    """Mask (0 or 1) of the largest bright component, after both filters."""

    def filtered(image: np.ndarray) -> np.ndarray:
        side = settings.gaussian_px
        return cv2.GaussianBlur(cv2.medianBlur(image, settings.median_px), (side, side), 0)

    filters_first = settings.order == "filter_first"
    light = filtered(grey) if filters_first else grey
    _, binary = cv2.threshold(light, settings.threshold, 255, cv2.THRESH_BINARY)
    if not filters_first:
        _, binary = cv2.threshold(filtered(binary), 127, 255, cv2.THRESH_BINARY)
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(binary)
    if count < 2:
        return NoSpot(Reason.NONE_FOUND)
    areas = statistics[1:, cv2.CC_STAT_AREA]
    largest = int(np.argmax(areas))
    if areas[largest] <= settings.min_component_px:
        return NoSpot(Reason.TOO_SMALL)
    return (labels == largest + 1).view(np.uint8)
