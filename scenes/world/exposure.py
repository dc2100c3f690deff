"""How bright a world is for its camera, and how long the `paper` frames are exposed."""

import math

import numpy as np

from eyespot import optics
from eyespot.formats.camera_sheet import GREY_WEIGHTS
from eyespot.scenes.description.scene_keys import SceneError
from eyespot.scenes.world.motion import longest_exposure
from eyespot.scenes.world.world import World

_PAPER_THRESHOLD_DN = 200.0
"""The paper's segmentation threshold for 8-bit images (Zhou et al. 2020, section III-B)."""


def uniform_irradiance(world: World) -> np.ndarray:
    """Indirect irradiance per colour channel, mW/mm2, by the closed form.

    It is zero on a plane, and if it is off or traced by the integrator.
    """
    scene = world.scene
    if scene.phantom.kind == "plane" or scene.phantom.indirect != "closed form":
        return np.zeros(3)
    share = 1.0 if world.light is None else world.light.transmitted
    return np.asarray(
        optics.indirect_irradiance(
            flux=share * scene.source.power_mw,
            reflectance=world.wall_colour,
            eye_radius=scene.phantom.mean_radius_mm,
            pupil_radius=scene.phantom.pupil_radius_mm,
        )
    )


def peak_irradiance(world: World, *, distance: float) -> float:
    """Largest irradiance on a plane square to the beam, mW/mm2.

    Args:
        distance: distance from the tip, mm.
    """
    power, table = world.scene.source.power_mw, world.table
    if table is None:
        cone = world.cone
        solid_angle = 2 * math.pi * (1 - math.cos(cone.half_angle))
        return power / solid_angle / (distance - cone.apex_offset) ** 2
    radii = np.linspace(0.0, float(table.envelope(distance)), 512)
    _, axial = table(radius=radii, distance=np.full_like(radii, distance))
    return power * float(np.max(np.asarray(axial)))


def paper_exposure(world: World) -> float:
    """The fixed exposure time of the `paper` frames, s.

    With it, a wall of the mean colour has grey level 200, the threshold of the paper's tracker,
    where its irradiance is `paper_level` times the peak of the beam at `paper_distance_mm`. Each
    channel is clipped at full scale, as in the camera.

    Raises:
        SceneError: the scene has `paper` frames, and the exposure is longer than the time between
            frames.
    """
    scene, exposures = world.scene, world.scene.exposures
    peak = peak_irradiance(world, distance=exposures.paper_distance_mm)
    radiance = world.wall_colour / math.pi * exposures.paper_level * peak
    black = scene.camera.black_level_dn / scene.camera.full_scale_dn
    low, high = 0.0, 4.0 / (radiance.min() * exposures.sensitivity_mm2_sr_mj)
    for _ in range(60):
        middle = 0.5 * (low + high)
        light = radiance * exposures.sensitivity_mm2_sr_mj * middle
        # Noise-free values of a linear camera on the 8-bit scale.
        digital = 255.0 * np.minimum(black + (1.0 - black) * light, 1.0)
        grey = GREY_WEIGHTS @ digital
        low, high = (middle, high) if grey < _PAPER_THRESHOLD_DN else (low, middle)
    longest = longest_exposure(scene)
    if "paper" in exposures.kinds and high > longest:
        raise SceneError(
            f"the paper exposure takes {high:.3f} s, but clocks.camera_hz allows {longest:.3f} s "
            "per frame. Raise exposures.sensitivity_mm2_sr_mj or source.power_mw, or remove "
            "'paper' from exposures.kinds."
        )
    return high
