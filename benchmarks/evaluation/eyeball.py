"""The eyeball and the microscope that several studies need."""

from __future__ import annotations

from scenes import Scene, SceneError

MICROSCOPE_MM = 200.0
"""z_F of a real microscope."""

_SMALLEST_RADIUS_MM = 10.0


def require_roomy_eyeball(scene: Scene, reach: str) -> None:
    """Refuse a scene whose wall ends before a study's spots do.

    Args:
        scene: the study's.
        reach: what reaches how far, for the message.

    Raises:
        SceneError: the wall is no eyeball, or too small.
    """
    if scene.phantom.kind != "eyeball" or scene.phantom.radius_mm < _SMALLEST_RADIUS_MM:
        raise SceneError(
            f"the study's {reach} in an eyeball of {_SMALLEST_RADIUS_MM:g} mm radius or more; got "
            f"phantom.kind '{scene.phantom.kind}' with radius_mm = {scene.phantom.radius_mm:g}. "
            "Set phantom.kind=eyeball and raise phantom.radius_mm."
        )
