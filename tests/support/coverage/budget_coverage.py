"""Do 95 % intervals contain 95 % of the distances? On rendered frames, with every error drawn.

Each reading has a frame of its own: Mitsuba renders the spot and the instrument over a printed
fundus, the scene's camera photographs it, and the sub-pixel mode measures it. Calibration, eye
radius, pinhole, touch, axis and clock that the reading is computed with are wrong by errors drawn
anew for each reading from the distributions that the budget is told. The frames know none of them.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from eyespot.estimator import SubpixelSettings, TrackState, measure
from eyespot.estimator.distance.budget import Budgets, ToolMotion
from eyespot.estimator.distance.ranger import Ranger
from eyespot.formats.spot import Spot
from eyespot.formats.stated import Stated
from eyespot.scenes import Scene, World, load_scene
from eyespot.scenes.rendering.render import images_of
from eyespot.scenes.sensor import CameraSensor
from tests.support.drawn.made_up import a_calibration, a_microscope

K, B, RADIUS, SCALE = 20.0, -5.117, 11.5, 0.0067
WINDOW_PX = 288
INCIDENCE_DEG = (15.0, 32.0)
DISTANCES_MM = (0.5, 5.0)

STATED = Stated(
    eye_radius_sigma_mm=0.2,
    inverse_working_distance_sigma=0.001,
    size_per_mm=0.00065,
    touch_sigma_mm=0.02,
    axis_sigma_deg=1.0,
    incidence_deg=INCIDENCE_DEG,
    clock_sigma_s=0.01,
)
COVARIANCE = np.array([[4e-4, -1e-4, 0.0], [-1e-4, 1e-4, 0.0], [0.0, 0.0, (1e-3 * SCALE) ** 2]])
"""Of k, b and scale: 0.1 %, 0.01 mm, 0.1 %."""

MODELS = ("small_plane", "corrected", "area", "exact")
PLACES = (
    # Eccentricity, mm; pinhole height, mm; wall.
    (0.0, 200.0, "printed paper"),
    (1.0, 11.5, "retina"),
    (1.5, 200.0, "retina"),
    (2.0, 200.0, "uniform"),
    (2.5, 11.5, "printed paper"),
    (3.0, 200.0, "printed paper"),
    (3.5, 11.5, "retina"),
    (4.0, 200.0, "retina"),
)


class Seen(NamedTuple):
    """A spot that was rendered and measured, the pinhole's height, the beam and the true |SO|."""

    height_mm: float
    principal_px: tuple[float, float]
    axis: np.ndarray
    distance_mm: float
    spot: Spot


def scene_at(place: tuple[float, float, str], seed: int) -> Scene:
    c, height, wall = place
    return load_scene(
        None,
        [
            "source.kind=cone",
            f"spot.eccentricity_mm={c}",
            f"spot.azimuth_deg={40 * seed}",
            f"microscope.pinhole_height_mm={height}",
            f"microscope.width_px={WINDOW_PX}",
            f"microscope.height_px={WINDOW_PX}",
            f"phantom.wall={wall}",
            f"phantom.texture_seed={seed}",
            f"seed={seed}",
            "motion.frames=1",
            "motion.start_mm=3",
        ],
    )


def seen_spots(count: int, *, seed: int) -> Iterator[Seen]:
    """Spots at all places, rendered and measured; those without a spot are left out."""
    for number, place in enumerate(PLACES):
        world = World(scene_at(place, seed * len(PLACES) + number))
        own = count // len(PLACES) + (number < count % len(PLACES))
        yield from _seen_at(world, own, np.random.default_rng([seed, number]))


def _seen_at(world: World, count: int, noise: np.random.Generator) -> Iterator[Seen]:
    images, camera = images_of(world, variant="llvm_ad_rgb"), CameraSensor(world.scene)
    point, normal = (np.asarray(part) for part in world.spot_frame[:2])
    sides = np.linalg.svd(normal[None])[2][1:]
    principal = np.asarray(world.microscope.principal_point)
    settings = SubpixelSettings()
    for number in range(count):
        distance = noise.uniform(*DISTANCES_MM)
        tilt = math.radians(noise.uniform(*INCIDENCE_DEG))
        turn = noise.uniform(0, 2 * math.pi)
        axis = math.cos(tilt) * normal + math.sin(tilt) * (
            np.array([math.cos(turn), math.sin(turn)]) @ sides
        )
        light, wall = images.at(tip=point - distance * axis, axis=axis, seed=number)
        level = light.mean(axis=-1)
        duration = camera.metered_s(light, (level > level.max() / 2) & (wall > 0.5))
        frame = camera.raw(light, exposure_s=duration, noise_seed=[world.scene.seed, number])
        found, _ = measure(frame, TrackState(at_px=(WINDOW_PX / 2, WINDOW_PX / 2)), settings)
        if isinstance(found, Spot):
            height = world.scene.microscope.pinhole_height_mm
            u, v = principal.tolist()
            yield Seen(height, (u, v), axis, distance, found)


def interval_holds(
    seen: Seen, model: str, *, known_axis: bool, noise: np.random.Generator
) -> bool | None:
    """Whether a lab that knows everything up to its stated uncertainties states a true interval.

    The truth is the distance at the time that the clock said; None without a distance.
    """
    k, b, scale = noise.multivariate_normal([K, B, SCALE], COVARIANCE).tolist()
    b += STATED.touch_sigma_mm * noise.standard_normal()
    radius = RADIUS + STATED.eye_radius_sigma_mm * noise.standard_normal()
    kappa = 1 / (seen.height_mm + RADIUS)
    kappa += STATED.inverse_working_distance_sigma * noise.standard_normal()
    u, v = seen.principal_px
    c = SCALE * math.hypot(seen.spot.x_px - u, seen.spot.y_px - v)
    # A view that is larger than the pinhole's is one whose pixels are believed too small.
    scale *= 1 + STATED.size_per_mm * c * noise.standard_normal()
    velocity = -noise.uniform(0, 5) * seen.axis
    motion = ToolMotion(
        velocity_mm_s=(velocity[0], velocity[1], velocity[2]),
        turn_rad_s=noise.uniform(0, 0.2),
        pose_age_s=noise.uniform(0, 0.05),
    )
    late = STATED.clock_sigma_s * noise.standard_normal()
    sides = np.linalg.svd(seen.axis[None])[2][1:]
    turned = motion.turn_rad_s * (motion.pose_age_s + late)
    towards = noise.uniform(0, 2 * math.pi)
    aside = math.radians(STATED.axis_sigma_deg) * noise.standard_normal(2)
    aside += turned * np.array([math.cos(towards), math.sin(towards)])
    axis = seen.axis + aside @ sides
    axis /= np.linalg.norm(axis)
    microscope = a_microscope(
        width_px=WINDOW_PX,
        height_px=WINDOW_PX,
        scale_mm_px=scale,
        principal_point_px=seen.principal_px,
        pinhole_height_mm=1 / kappa - radius,
        eye_radius_mm=radius,
    )
    values = {"k": k, "b": b, "scale": scale}
    calibration = a_calibration(values, covariance=COVARIANCE, model="exact")
    ranger = Ranger(calibration, microscope, model=model)
    told = axis if known_axis else None
    found = ranger.distance(
        seen.spot, axis=told, axis_sigma_rad=math.radians(STATED.axis_sigma_deg)
    )
    budget = Budgets(ranger, STATED).of(seen.spot, found, axis=told, motion=motion)
    truth = seen.distance_mm + math.hypot(*motion.velocity_mm_s) * late
    if budget is None:
        return None
    low, high = budget.interval_mm
    return low <= truth <= high


def held_intervals(spots: list[Seen], *, seed: int) -> list[bool]:
    """One reading of each spot, by the models in turn, two of them also without an axis."""
    noise = np.random.default_rng([seed, 1])
    ways = [(model, True) for model in MODELS] + [(model, False) for model in MODELS[:2]]
    found = (
        interval_holds(spot, model, known_axis=axis, noise=noise)
        for spot, (model, axis) in zip(spots, ways * len(spots), strict=False)
    )
    return [held for held in found if held is not None]
