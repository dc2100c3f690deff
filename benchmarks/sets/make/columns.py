"""What the columns of a label table mean."""

from __future__ import annotations

import re

_MEANINGS = {
    "file_name": "Path of the image within the split.",
    "mask_file_name": "Path of the mask: 255 where the wall within the spot is seen.",
    "frame": "Number of the moment within its stack.",
    "time_s": "Middle of the exposure, s.",
    "exposure": "How the exposure time was chosen: paper (fixed) or metered.",
    "exposure_s": "Exposure time, s.",
    "d_mm": "Distance from the tip to the wall along the beam, mm.",
    "nearest_mm": "Distance from the tip to the nearest point of the wall, mm.",
    "c_mm": "Distance of the spot from the axis of the microscope, mm.",
    "azimuth_rad": "Azimuth of the spot around the axis of the microscope, rad.",
    "phi_rad": "Angle of the spot on the eyeball from the axis, rad.",
    "incidence_rad": "Angle between the beam and the outward normal of the wall, rad.",
    "incidence_azimuth_rad": "Azimuth of the beam around that normal, rad.",
    "tip_mm": "Position of the tip in the eye frame, mm.",
    "axis": "Unit vector along the beam, from the tip towards the wall.",
    "spot_mm": "Where the beam's axis meets the wall, mm.",
    "visible_fraction": "Part of the half-maximum contour that the camera sees.",
    "saturated_fraction": "Part of the mask's pixels with a channel at full scale.",
    "speed_mm_s": "Speed of the tip, mm/s.",
    "medium": "Medium between tip and wall.",
    "seed": "Random seed of the stack.",
    "relative_power": "Power of the light source, relative to its mean.",
    "stack": "Name of the stack.",
    "condition": "Difficult condition of the stack; empty if it has none.",
    "cone_k": "1/tan of the beam's half-angle; for a lens, of its effective cone.",
}
_FAMILIES = {
    "spread_cone": "edge of the geometric cone after the wall has spread the light",
    "spread_half_max": "half of the peak after the wall has spread the light",
    "cone": "edge of the geometric cone",
    "half_max": "half of the noise-free, unoccluded peak",
}
_PARTS = {
    "x_px": "x of its centre, px",
    "y_px": "y of its centre, px",
    "semi_major_px": "its semi-major axis, px",
    "semi_minor_px": "its semi-minor axis, px",
    "angle_rad": "angle of its semi-major axis from right towards down, rad",
}
_OTHERS = (
    (
        r"bound_(x|y|semi_major|semi_minor)_px",
        "Least standard deviation of the half-maximum "
        "ellipse that an unbiased estimator can reach in this image (Cramér-Rao), px.",
    ),
    (r"bound_d_mm", "The same of the distance from the ellipse, with the beam known, mm."),
    (r"(red|blue)_shift_[xy]_px", "Where this colour shows the spot, against green, px."),
    (r"reflex_[xy]_px", "Brightest reflex of the microscope's lamp, px."),
    (r"view_[xy]_px", "Shift of the image by drift and shake, px."),
    (r"eye_turn_[xyz]_deg", "Rotation vector of the eyeball, degrees."),
)


def meaning(name: str) -> str:
    """A sentence about a column; of a scene key, that it is one."""
    if name in _MEANINGS:
        return _MEANINGS[name]
    for family, contour in _FAMILIES.items():
        if name.startswith(f"{family}_") and (part := _PARTS.get(name.removeprefix(f"{family}_"))):
            return f"Ellipse at the {contour}: {part}."
    for pattern, sentence in _OTHERS:
        if re.fullmatch(pattern, name):
            return sentence
    return f"Key {name} of the stack's scene."
