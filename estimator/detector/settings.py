"""Settings of the sub-pixel mode: the half-maximum contour of the linearised signal.

The edge of a spot is where its light falls to the middle between the spot's peak and the background
around it. The peak is that of a bell, the plateau of a disc, or the highest point of a dome or of a
sloping plateau. The edge does not move with exposure nor, if it is symmetric about its middle, with
blur. The wall's reflectance is removed as far as the frame shows it.

Colour frames are measured on their grey mean (the weights of cv2's RGB2GRAY), which has the least
noise. If one channel is clearly brighter in the spot, texture is weaker there, and that channel is
used (on a retina red, which hardly shows vessels). If a channel is saturated, the least saturated
one is used. Texture that differs between colours is removed from broad edges first
(`spot_contour.py`).
"""

from dataclasses import dataclass, field

from eyespot.formats.camera_sheet import LensDistortion, Response
from eyespot.formats.inputs import InputError


@dataclass(frozen=True, kw_only=True, eq=False)
class SubpixelSettings:
    """Settings of the sub-pixel mode.

    Attributes:
        camera: whose lens distortion is removed from the edge, so that spots are in the image of an
            ideal pinhole. None measures in the image as it is.
        search_half_width_px: half side of the square searched round the last position.
        min_semi_minor_px: smaller spots are `too_small`.
        max_semi_major_px: larger spots are `too_large`.
        max_axis_ratio: largest ratio of semi-major to semi-minor axis of a spot (2: a beam at 60
            degrees).
        min_contrast: (peak - background) / background that a wall's texture does not reach; spots
            of less must exceed the scatter round them by `tuning.Verdict.FAINTEST`.
        min_coverage: fraction of the contour below which a spot is `occluded` or `clipped`.
        max_jump_px: furthest move between frames; a spot further away must be seen twice.
        max_growth: largest ratio of the semi-minor axes of two frames, either way.
        uneven_top: whether the light's top may be uneven, as behind a lens. Where the wall's
            texture hides that, one frame does not tell the light's from the wall's unevenness, and
            the size's error contains both. A reader with a lens's calibration sets it.
    """

    response: Response = field(default_factory=Response)
    camera: LensDistortion | None = None
    search_half_width_px: int = 200
    min_semi_minor_px: float = 2.5
    max_semi_major_px: float = 400.0
    max_axis_ratio: float = 2.0
    min_contrast: float = 1.0
    min_coverage: float = 0.5
    max_jump_px: float = 80.0
    max_growth: float = 1.5
    uneven_top: bool = False

    def __post_init__(self) -> None:
        """Reject settings under which nothing can be found."""
        positive = ("search_half_width_px", "min_semi_minor_px", "min_contrast", "max_jump_px")
        rules = {name: ("be positive", getattr(self, name) > 0) for name in positive}
        for name in ("max_axis_ratio", "max_growth"):
            rules[name] = "exceed 1", getattr(self, name) > 1
        rules["min_coverage"] = "lie in (0, 1]", 0 < self.min_coverage <= 1
        smallest = self.min_semi_minor_px
        rules["max_semi_major_px"] = (
            f"exceed min_semi_minor_px = {smallest} px",
            self.max_semi_major_px > smallest,
        )
        for name, (rule, is_kept) in rules.items():
            if not is_kept:
                raise InputError(
                    f"SubpixelSettings({name}=...) must {rule}; got {getattr(self, name)}."
                )
