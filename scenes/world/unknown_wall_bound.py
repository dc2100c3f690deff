"""A scene's lights before a wall that nobody knows: what one frame says of the distance.

`scenes.stacks.bound` is the bound of an image whose wall is known.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from eyespot import optics
from eyespot.optics.wall_light.cells import CellBeam
from eyespot.optics.wall_light.cone import UniformCone
from eyespot.optics.wall_light.lens_flux import lens_samples
from eyespot.optics.wall_light.unknown_wall import SpotCells, distance_sigmas, spot_cells
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.world.world import World

_NEAREST_MM, _FARTHEST_MM = 0.25, 9.0  # distances that a table of light covers
_FINENESS = {True: (3, 0.05), False: (5, 0.01)}
"""How often a table's cells are halved, and their finest width in mm; for coarse and exact ones.
With 0.02 mm a gradient by the core's radius is a fifth off, because the edge of the light moves."""


class SpotLight(NamedTuple):
    """A source's light at several distances, and how it changes with the source's parameters.

    Attributes:
        spots: light on the wall's cells.
        ambient: light that is everywhere, per unit power, 1/mm², and its derivatives.
        radii: half-maximum radii on planes square to the beam, mm, which set the cells.
    """

    spots: SpotCells
    ambient: np.ndarray
    radii: np.ndarray


class UnknownWallScene:
    """A scene's eye, camera and microscope, for any source and any distance along the beam.

    The instrument is not in the image, and the wall's mean colour is the scene's.

    Args:
        scene: its own source and motion are not used.

    Attributes:
        sensor: `electrons` and `dark_e2` of `optics.wall_light.unknown_wall.distance_sigmas`.
        full_dose: radiant exposure that fills the brightest colour's wells, mJ/mm².
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self._world = scene, World(scene)
        camera = scene.camera
        full_wells = self._world.wall_colour / math.pi * scene.exposures.sensitivity_mm2_sr_mj
        self.sensor: dict[str, Any] = {
            "electrons": full_wells * camera.full_well_e,
            "dark_e2": camera.dark_signal_e + camera.dark_variance_e2,
        }
        self.full_dose = 1 / float(full_wells.max())

    def of_lens(
        self,
        values: Mapping[str, float],
        distances: Sequence[float],
        *,
        free: Sequence[str] = (),
        coarse: bool = False,
        radii: np.ndarray | None = None,
    ) -> SpotLight:
        """Light of a glue lens.

        Args:
            values: `optics.wall_light.lens_flux.PARAMETERS`.
            distances: d, mm, within 0.25 to 8.
            free: parameters by which the light is differentiated.
            coarse: for a search; errors of a hundredth of the peak.
            radii: of another light, to look at its cells; None for the lens's own.
        """
        halvings, finest = _FINENESS[coarse]
        table = lens_samples(
            values,
            free,
            medium_index=self._world.medium_index,
            nearest=_NEAREST_MM,
            farthest=_FARTHEST_MM,
            reach=1.0,
            halvings=halvings,
            finest=finest,
            coarse=coarse,
        ).table()
        if radii is None:
            radii = np.array([table.half_maximum_radius(d) for d in distances])
        return self._light(table.parts(), distances, radii, np.asarray(table.power))

    def of_cone(self, distances: Sequence[float]) -> SpotLight:
        """Light of the ideal cone of [source]."""
        k, b = self.scene.source.cone_k, self.scene.source.cone_apex_offset_mm
        cone = UniformCone.of(math.atan(1 / k), b)
        return self._light([cone], distances, (np.array(distances) - b) / k, np.ones(1))

    def sigmas(self, light: SpotLight, dose: float, *, outline: bool = False) -> np.ndarray:
        """Bounds of the standard deviation of d, mm (`distance_sigmas`)."""
        rest = {"ambient": light.ambient, "dose": dose, "outline": outline, **self.sensor}
        return np.asarray(distance_sigmas(light.spots, np.zeros(light.ambient.size - 1), **rest))

    def brightest(self, light: SpotLight) -> np.ndarray:
        """Irradiance of the brightest cell at each distance, mW/mm²."""
        peak = np.max(light.spots.light[:, 0, 0, 0], axis=-1) + light.ambient[0]
        return np.asarray(self.scene.source.power_mw * peak)

    def _light(
        self,
        parts: Sequence[CellBeam],
        distances: Sequence[float],
        radii: np.ndarray,
        transmitted: np.ndarray,
    ) -> SpotLight:
        world, phantom, microscope = self._world, self.scene.phantom, self.scene.microscope
        spot, axis = world.aim
        tilted = math.cos(math.radians(self.scene.spot.incidence_deg))
        spots = [
            spot_cells(
                parts,
                camera=world.microscope,
                wall=world.wall,
                tip=spot - d * axis,
                axis=axis,
                half_maximum_mm=radius / tilted,
                size_px=(microscope.width_px, microscope.height_px),
            )
            for d, radius in zip(distances, radii.tolist(), strict=True)
        ]
        indirect = optics.indirect_irradiance(
            flux=transmitted * (phantom.kind == "eyeball" and phantom.indirect != "off"),
            reflectance=world.wall_colour.mean(),
            eye_radius=phantom.mean_radius_mm,
            pupil_radius=phantom.pupil_radius_mm,
        )
        lamp = microscope.illumination_mw_mm2 / self.scene.source.power_mw
        ambient = np.asarray(indirect) + lamp * (np.arange(len(parts)) == 0)
        return SpotLight(
            SpotCells(*(np.stack(part) for part in zip(*spots, strict=True))), ambient, radii
        )
