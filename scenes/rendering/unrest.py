"""Moves the view and the eyeball of a loaded scene, and changes the source's power.

Import after `load_mitsuba`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from scenes.world import Moment, World


def unsettler(world: World, mitsuba_scene: Any, *, uniform: np.ndarray) -> Callable[[Moment], None]:
    """Function that brings a loaded scene into the state of a moment.

    Args:
        world: the scene and everything derived from it.
        mitsuba_scene: the loaded scene.
        uniform: indirect irradiance per colour channel at the source's mean power, mW/mm2.
    """
    unrest, microscope = world.scene.unrest, world.scene.microscope
    parameters = mi.traverse(mitsuba_scene)
    ambient = 0.0 if microscope.light == "coaxial" else microscope.illumination_mw_mm2
    centre = np.asarray(world.microscope.principal_point) + 0.5
    sensors = [
        name for name in ("sensor", "photon_camera") if f"{name}.principal_point" in parameters
    ]
    mean_power = float(np.array(parameters["source.power"]).item())
    # A mesh has no transform, and does not turn.
    at_rest = np.array(parameters["wall.to_world"].matrix, float) if unrest.turns else np.eye(4)

    def unsettle(moment: Moment) -> None:
        values: dict[str, Any] = {}
        if unrest.shifts:
            for name in sensors:
                values[f"{name}.principal_point"] = _opaque(mi.Vector2f(centre + moment.view_px))
        if unrest.turns:
            turned = np.eye(4)
            turned[:3, :3] = Rotation.from_rotvec(moment.turn).as_matrix()
            values["wall.to_world"] = mi.Transform4f(turned @ at_rest.reshape(4, 4))
        if unrest.power_swing:
            values["source.power"] = _opaque(mi.Float(moment.power * mean_power))
            light = moment.power * uniform + ambient
            values["integrator.uniform"] = _opaque(mi.Color3f(light))
        with _no_warnings():
            parameters.update(values)

    return unsettle


@contextlib.contextmanager
def _no_warnings() -> Iterator[None]:
    """Mitsuba warns of a shear above 1e-6, which float32 leaves in a rotation times 11.5 mm."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(level)


def _opaque(value: Any) -> Any:
    """The value as data, so that Mitsuba does not compile a kernel for each."""
    dr.make_opaque(value)
    return value
