"""Labels of a frame, its exposure, and the calibration of a scene's own beam."""

import hashlib
import json
import math
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np

from eyespot import optics
from eyespot.formats.calibration import LENS_PARAMETERS, Calibration
from eyespot.formats.camera import GREY_WEIGHTS
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.description.settings import SceneError
from eyespot.scenes.world.motion import longest_exposure
from eyespot.scenes.world.world import World


def spot_labels(world: World, frame: int) -> dict[str, Any]:
    """The fields of `formats.stack.FrameLabels` that follow from geometry, for one frame."""
    scene, spots = world.scene, world.truth

    def at(column: object) -> Any:
        # Indexing a NumPy array takes a tenth of the time of indexing a JAX array.
        return np.asarray(column)[frame].tolist()

    c, azimuth = at(spots.eccentricity), at(spots.azimuth)
    phi = 0.0  # between the local normal and the microscope's axis; of a plane by convention
    if isinstance(world.wall, optics.Sphere):
        phi = math.asin(c / float(world.wall.radius))
    elif isinstance(world.wall, optics.Ellipsoid):
        normal = world.wall.frame_at(eccentricity=c, azimuth=azimuth).outward
        x, y, z = np.asarray(normal).tolist()
        phi = math.atan2(math.hypot(x, y), -z)
    labels: dict[str, Any] = {
        "frame": frame,
        "time_s": round(at(world.times), 9),  # as people write times
        "d_mm": at(spots.distance),
        "nearest_mm": at(spots.nearest),
        "c_mm": c,
        "azimuth_rad": azimuth,
        "phi_rad": phi,
        "incidence_rad": at(spots.incidence),
        "incidence_azimuth_rad": at(spots.incidence_azimuth),
        "tip_mm": tuple(at(spots.beam.tip)),
        "axis": tuple(at(spots.beam.axis)),
        "spot_mm": tuple(at(spots.origin)),
        "speed_mm_s": at(world.speed),
        "medium": scene.source.medium,
        "seed": scene.seed,
    }
    if (shifts := world.colour_shifts) is not None:
        for colour, shift in zip(("red", "blue"), shifts[:, frame], strict=True):
            x, y = shift.tolist()
            labels |= {f"{colour}_shift_x_px": x, f"{colour}_shift_y_px": y}
    if scene.phantom.clear_layer_mm:
        pose = np.asarray(at(spots.beam.tip)), np.asarray(at(spots.beam.axis))
        labels["surface_mm"] = float(world.surface.intersect(*pose).distance)
    unrest = scene.unrest
    moment = world.unrest.at(frame, at(world.times))
    if unrest.shifts:
        labels["view_x_px"], labels["view_y_px"] = moment.view_px.tolist()
    if unrest.turns:
        degrees = np.degrees(moment.turn).tolist()
        labels |= {f"eye_turn_{k}_deg": d for k, d in zip("xyz", degrees, strict=True)}
    if unrest.power_swing:
        labels["relative_power"] = moment.power
    if world.reflections is not None:
        x, y = (world.brightest_reflex_px + moment.view_px).tolist()
        labels |= {"reflex_x_px": x, "reflex_y_px": y}
    ellipses = {"cone": spots.cone, "half_max": spots.half_max}
    if (spread := world.spread_spots) is not None:
        ellipses |= {"spread_cone": spread.cone, "spread_half_max": spread.half_max}
    for kind, ellipse in ellipses.items():
        x, y = at(ellipse.centre)
        labels |= {
            f"{kind}_x_px": x,
            f"{kind}_y_px": y,
            f"{kind}_semi_major_px": at(ellipse.semi_major),
            f"{kind}_semi_minor_px": at(ellipse.semi_minor),
            f"{kind}_angle_rad": at(ellipse.angle),
        }
    return labels


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


def study_calibration(
    model: str,
    values: Mapping[str, float],
    *,
    medium: str,
    covariance: np.ndarray | None = None,
    fitted_on: str = "this study",
) -> Calibration:
    """A calibration for `estimator.Ranger`.

    Args:
        values: parameters of the model in the units of `QUANTITIES`.
        medium: a name in `optics.MEDIA`.
        covariance: covariance of the values; None if they are known exactly.
        fitted_on: origin of the values.
    """
    known = {name: float(value) for name, value in values.items()}
    return Calibration.of(
        model=model,
        values=known,
        covariance=np.zeros((len(known), len(known))) if covariance is None else covariance,
        medium=medium,
        medium_index=optics.MEDIA[medium],
        fitted_on=fitted_on,
        data_sha256=hashlib.sha256(json.dumps(known).encode()).hexdigest(),
        software=f"eyespot {version('eyespot')}",
    )


def true_calibration(scene: Scene) -> Calibration:
    """The true lens of a scene, or its ideal cone (model `exact`)."""
    if scene.source.kind == "cone":
        half_angle, apex_offset = World(scene).cone
        model, values = "exact", {"half_angle": half_angle, "b": apex_offset}
    else:
        lens = optics.load_lens(scene.source.lens)
        given = {name: getattr(lens, name) for name in LENS_PARAMETERS}
        model, values = "lens", {name: x for name, x in given.items() if x is not None}
    return study_calibration(
        model, values, medium=scene.source.medium, fitted_on="the scene as it is"
    )
