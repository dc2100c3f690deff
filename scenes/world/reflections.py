"""The microscope's lamp as the surfaces of a viewing path reflect it into the image."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from optics.viewing import PathCamera, Reflex, ViewingPath
from scenes.description import Scene

_PLACES = 400


class Reflections(NamedTuple):
    """Reflexes of a round lamp of even radiance in the pinhole's plane.

    Attributes:
        scene: the scene.
        camera: the microscope behind the path.
        radiance: of the lamp, in the unit of the images, mW/(mm2 sr).
        reflexes: at every surface of the path.
    """

    scene: Scene
    camera: PathCamera
    radiance: float
    reflexes: tuple[Reflex, ...]

    @classmethod
    def of(
        cls, scene: Scene, camera: PathCamera, path: ViewingPath, reflexes: tuple[Reflex, ...]
    ) -> Reflections:
        """The reflexes of the lamp that gives the coaxial light on the retina.

        A lamp of radiance L, radius rho and distance D gives the irradiance L pi (rho/D)^2 in front
        of the path, and 1/a^2 of it behind, where a is the path's magnification. Images hold the
        radiance inside the eye, which is that in air times the squared index.
        """
        distance = 1.0 / float(path.pinhole_closeness)
        in_front = scene.microscope.illumination_mw_mm2 * float(camera.magnification) ** 2
        in_front /= float(camera.transmittance(camera.principal_point))
        lamp = in_front / (math.pi * (scene.viewing.lamp_radius_mm / distance) ** 2)
        return cls(scene, camera, lamp * float(path.medium_index) ** 2, reflexes)

    def image(self, view_px: np.ndarray) -> np.ndarray:
        """Radiance of all reflexes, H x W, in an image that is shifted by (x, y) px."""
        microscope = self.scene.microscope
        height, width = microscope.height_px, microscope.width_px
        v, u = np.mgrid[:height, :width]
        aim = self.camera.aim(np.stack([u, v], axis=-1) - view_px)
        light = np.zeros((height, width))
        for reflex in self.reflexes:
            place, part = (np.asarray(a) for a in (reflex.place(aim), reflex.part(aim)))
            inside = self.scene.viewing.lamp_radius_mm - np.linalg.norm(
                place - np.array(self.scene.viewing.lamp_mm), axis=-1
            )
            # The edge is as wide as a pixel.
            down, right = np.gradient(inside)
            light += part * np.clip(inside / np.maximum(np.hypot(down, right), 1e-9) + 0.5, 0, 1)
        middle = np.array([width, height]) / 2
        corner = np.sum(((np.stack([u, v], axis=-1) + 0.5 - middle) / np.hypot(*middle)) ** 2, -1)
        return self.radiance * (1 - microscope.vignetting * corner) * light

    def brightest_px(self) -> np.ndarray:
        """Where the brightest reflex shows the lamp's centre, (x, y) px; NaN outside the window."""
        lamp = np.array(self.scene.viewing.lamp_mm)
        away = float(np.linalg.norm(lamp))
        outward = lamp / away if away else np.array([1.0, 0.0])
        best, found = 0.0, np.full(2, np.nan)
        for reflex in self.reflexes:
            aim = _aim_at(reflex, away)
            if aim is None:
                continue
            part = float(reflex.part(aim * outward))
            offset = aim * outward * float(self.camera.px_per_aim) * [1.0, -1.0]
            at = np.asarray(self.camera.principal_point) + offset
            if part > best and np.all((at >= -0.5) & (at <= self._last_pixel + 0.5)):
                best, found = part, at
        return found

    @property
    def _last_pixel(self) -> np.ndarray:
        microscope = self.scene.microscope
        return np.array([microscope.width_px - 1, microscope.height_px - 1])


def _aim_at(reflex: Reflex, away: float) -> float | None:
    """Signed distance t at which a line of sight returns to a distance from the axis, mm."""

    def missed(t: float) -> float:
        return float(reflex.place(np.array([t, 0.0]))[0]) - away

    places = np.linspace(-1.0, 1.0, _PLACES) * float(reflex.widest)
    returned = np.asarray(reflex.place(np.stack([places, 0.0 * places], axis=-1)))[:, 0] - away
    crossed = np.flatnonzero(returned[:-1] * returned[1:] <= 0.0)
    if not crossed.size:
        return None
    nearest = crossed[np.argmin(np.abs(places[crossed]))]
    return float(brentq(missed, places[nearest], places[nearest + 1]))
