"""What is drawn over the image, as SVG."""

from __future__ import annotations

import numpy as np

from estimator.console.session import View
from estimator.files import MicroscopeFile
from estimator.image import Spot, outline_px

_EXPECTED_PX = 14  # radius of the circle where the spot was expected


def svg_of(view: View, microscope: MicroscopeFile | None) -> str:
    """The contour, its centre, the tip if it is known, and where the spot was expected.

    Args:
        view: what was measured.
        microscope: of the frames; None if unknown.
    """
    camera = microscope.camera() if microscope else None
    parts = []
    distance = view.reading.range
    if microscope and not microscope.viewing_path and distance and distance.poses:
        x, y = tip_px(distance.poses[0].tip_mm, microscope) + 0.5
        parts.append(
            f'<path d="M{x - 7:.1f} {y - 7:.1f}l14 14m0 -14l-14 14" stroke="#ff5ecb"'
            ' stroke-width="2" vector-effect="non-scaling-stroke"/>'
        )
    if view.expected_px is not None:
        x, y = (value + 0.5 for value in view.expected_px)
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{_EXPECTED_PX}" fill="none" stroke="#4aa3ff"'
            ' stroke-width="1.5" stroke-dasharray="4 3" vector-effect="non-scaling-stroke"/>'
        )
    spot = view.reading.result
    if isinstance(spot, Spot):
        points, centre = outline_px(spot.ellipse, camera)
        corners = " ".join(f"{x + 0.5:.1f},{y + 0.5:.1f}" for x, y in points)
        x, y = centre + 0.5
        colour = "#ffb000" if view.reading.doubt else "#2bff5e"
        parts.append(
            f'<polygon points="{corners}" fill="none" stroke="{colour}" stroke-width="2"'
            ' vector-effect="non-scaling-stroke"/>'
            f'<path d="M{x - 6:.1f} {y:.1f}h12M{x:.1f} {y - 6:.1f}v12" stroke="{colour}"'
            ' stroke-width="1.5" vector-effect="non-scaling-stroke"/>'
        )
    return "".join(parts)


def tip_px(tip_mm: np.ndarray, microscope: MicroscopeFile) -> np.ndarray:
    r"""Where a point appears in the frame.

    $u = u_0 + X / s$ and $v = v_0 - Y / s$ with the scale $s = \delta (1 - \kappa (Z + r))$ at the
    point's height.

    Args:
        tip_mm: (X, Y, Z) in the eye frame, (3,).
        microscope: a pinhole or telecentric, without a viewing path.

    Returns:
        (u, v), px, (2,).
    """
    x, y, z = tip_mm
    height = z + microscope.eye_radius_mm
    scale = microscope.scale_mm_px * (1 - microscope.inverse_working_distance * height)
    point = np.array(microscope.principal_point_px) + np.array([x, -y]) / scale
    camera = microscope.camera()
    return point if camera is None else camera.all_distorted(point[None])[0]
