"""Scenes from layers of tables."""

from typing import Any

from eyespot.scenes import Scene

BARE: dict[str, dict[str, Any]] = {
    "phantom": {"wall": "uniform", "indirect": "off"},
    "source": {"kind": "cone"},
    "instrument": {"visible": False},
    "microscope": {"illumination_mw_mm2": 0.0},
}
"""A uniform wall under the ideal cone's direct light alone."""


def scene_of(*layers: dict[str, Any]) -> Scene:
    """A scene whose tables have the keys of all layers; of one key the last value counts."""
    content: dict[str, Any] = {"schema": 1}
    for name, values in (item for layer in layers for item in layer.items()):
        content[name] = content.get(name, {}) | values if isinstance(values, dict) else values
    return Scene.model_validate(content)
