"""The microscope and the eye as a calibration describes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from estimator.files import MicroscopeFile
from optics import InputError

_OTHER = 1.5  # ratio of scales that no fit corrects: zooms differ by more, and rulers by less


def calibrated_view(microscope: MicroscopeFile, values: Mapping[str, float]) -> MicroscopeFile:
    """The microscope file with a calibration's own numbers in it.

    A calibrated pinhole replaces a viewing path, and the wall is then the sphere that it was fitted
    with.

    Args:
        microscope: as the file describes it.
        values: of the calibration: `scale`, `eye_radius` and `inverse_working_distance`, if it has
            them, replace the microscope's.

    Raises:
        InputError: the calibrated scale is another microscope's, or another zoom's.
    """
    scale = float(values.get("scale", microscope.scale_mm_px))
    if not 1 / _OTHER < scale / microscope.scale_mm_px < _OTHER:
        raise InputError(
            f"the calibration has a scale of {scale:g} mm/px, the microscope file one of "
            f"{microscope.scale_mm_px:g} mm/px: it is of another microscope, or of another zoom. "
            "Give the file that was used for the calibration, or calibrate again."
        )
    radius = values.get("eye_radius", microscope.eye_radius_mm)
    own = 1.0 / (microscope.pinhole_height_mm + radius)
    kappa = values.get("inverse_working_distance", own)
    fitted = "inverse_working_distance" in values
    return replace(
        microscope,
        scale_mm_px=scale,
        eye_radius_mm=float(radius),
        pinhole_height_mm=float(1.0 / kappa - radius) if kappa else math.inf,
        viewing_path=None if fitted else microscope.viewing_path,
        retina=None if fitted or "eye_radius" in values else microscope.retina,
    )
