"""What is drawn over the image, as SVG."""

from __future__ import annotations

from estimator.console.session import View
from estimator.image import Camera, Spot, outline_px

_EXPECTED_PX = 14  # radius of the circle where the spot was expected


def svg_of(view: View, camera: Camera | None) -> str:
    """The contour, its centre, and where the spot was expected.

    Args:
        view: what was measured.
        camera: with the lens's distortion; None without.
    """
    parts = []
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
