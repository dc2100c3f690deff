"""`eyespot study sensors`: one distance by the spot, by the instrument's shadow, and by stereo.

All three know the instrument's axis (from the robot), the wall's shape and their cameras, and give
the same quantity: d, the distance from the tip to the wall along the axis. Marks in their images
have stated noise, or are exact while one assumption is wrong. Nothing is rendered.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import StrEnum
from itertools import product
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot import optics
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.model_error import DISTANCE
from eyespot.benchmarks.paper import ACCEPTABLE_ERROR_MM
from eyespot.benchmarks.reporting import grouped, listed, number, where
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.optics.instrument import BareFibre
from eyespot.optics.viewing import (
    SideCamera,
    ThinLens,
    ViewingPath,
    bare_path,
    load_eye,
    load_viewing_lens,
    side_camera,
    viewing_path,
)

# What the sensors look at: the instrument, the light guide, the wall, and the microscopes.

PATHS: dict[str, str | None] = {
    "pinhole": None,
    "flat contact lens": "flat",
    "wide-field 90 D": "wide-field-90",
}
"""Viewing lens of each path; behind a lens lies Navarro's phakic eye."""

EYE, WAVELENGTH_NM = "navarro", 550.0
RADIUS_MM = 12.0  # Navarro's retina.
WALL, POLE = optics.Sphere(RADIUS_MM), np.array([0.0, 0.0, -RADIUS_MM])
PINHOLE_HEIGHT_MM = 200.0
SCALE_MM_PX = 0.0134  # The shadow of a tip at 6 mm lies 6 mm beside the spot.
WINDOW_PX = np.array([960, 720])
CONVERGENCE_DEG = 5.5
"""Angle between the two lines of sight of a stereo microscope at the pole, without a viewing lens:
the middle of 5 to 6 degrees."""

CONE = {"half_angle": float(np.arctan(1 / 20.0)), "apex_offset": -5.117}
TOOL_RADIUS_MM = 0.255
TROCAR_POLAR_DEG = 48.0
TOOL_AZIMUTH_DEG, LAMP_AZIMUTH_DEG, SPOT_AZIMUTH_DEG = 30.0, 150.0, 270.0
"""The trocars lie at two and ten o'clock; the spot moves away from both."""
LAMP_ABOVE_MM = 15.0  # Distance of the light guide's end from the pole, along its trocar.

Numbers = Any
"""NumPy's outside of compiled functions, JAX's inside; several places have a leading axis."""


class InstrumentPlace(NamedTuple):
    """An instrument at the wall, and the light guide that makes its shadow; mm, eye frame."""

    tip: Numbers
    axis: Numbers  # unit vector from the trocar to O
    spot: Numbers
    lamp: Numbers


class Views(NamedTuple):
    """The microscope that sees spot and shadow, and the pair; the pole is at pixel (0, 0)."""

    centre: SideCamera
    left: SideCamera
    right: SideCamera


def _trocar(azimuth_deg: float) -> np.ndarray:
    turn, polar = math.radians(azimuth_deg), math.radians(TROCAR_POLAR_DEG)
    aside = math.sin(polar) * np.array([math.cos(turn), math.sin(turn)])
    return RADIUS_MM * np.array([*aside, math.cos(polar)])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


LAMP_AXIS = _unit(POLE - _trocar(LAMP_AZIMUTH_DEG))


def places(eccentricities: Numbers, distances: Numbers) -> InstrumentPlace:
    """Places at pairs of c and d (mm), with a leading axis."""
    azimuth = math.radians(SPOT_AZIMUTH_DEG)
    spot = np.array([WALL.frame_at(eccentricity=c, azimuth=azimuth).origin for c in eccentricities])
    axis = _unit(spot - _trocar(TOOL_AZIMUTH_DEG))
    lamp = np.broadcast_to(POLE - LAMP_ABOVE_MM * LAMP_AXIS, spot.shape)
    return InstrumentPlace(spot - np.asarray(distances)[:, None] * axis, axis, spot, lamp)


def views(path: str) -> Views:
    """The microscopes that look through a path."""
    half = math.tan(math.radians(CONVERGENCE_DEG / 2)) * (PINHOLE_HEIGHT_MM + RADIUS_MM)
    if (name := PATHS[path]) is None:
        bare = bare_path(eye_radius=RADIUS_MM, pinhole_height=PINHOLE_HEIGHT_MM)
        return _views(bare, half)
    eye, lens = load_eye(EYE, wavelength_nm=WAVELENGTH_NM), load_viewing_lens(name)
    cornea = float(eye.axial_length) - RADIUS_MM
    seen = viewing_path(eye, lens, pinhole_distance=PINHOLE_HEIGHT_MM - cornea)
    # A stereo inverter turns both images, and exchanges them; else near would look far.
    return _views(seen, -half if isinstance(lens, ThinLens) else half)


@eqx.filter_jit
def _views(path: ViewingPath, half: float) -> Views:
    up = jnp.array([0.0, 0.0, 1.0])
    cameras = (
        side_camera(path, aside=jnp.array([x, 0.0]), scale=SCALE_MM_PX, upright=True)
        for x in (0.0, -half, half)
    )
    return Views(*(c.centred_on(c.pole_height * up, width=1, height=1) for c in cameras))


# The sensors: what they see, and the distances that follow.

CONTOUR_PX, MARK_PX, WALL_PX = 0.05, 1.0, 0.1
"""Stated noise: of each of 128 points of the spot's edge (as in the study of poses), of a tip or
a shadow's tip in x and y (an assumption), and of the wall's texture matched in a pair (an
assumption)."""
_POINTS = 128


class Sensor(StrEnum):
    """What the distance is read from."""

    SPOT = "spot"
    SHADOW = "shadow"
    STEREO = "stereo"


class Marks(NamedTuple):
    """What is measured in the images, px.

    In the central image the spot's edge, n x 2, the tip and its shadow; in the pair the tip, and a
    point of the wall near O, 2 x 2.
    """

    contour: Numbers
    tip: Numbers
    shadow: Numbers
    tip_pair: Numbers
    wall_pair: Numbers


def marks_of(one: InstrumentPlace, seen: Views, points: int = _POINTS) -> Marks:
    """The true marks; the lamp has no extent."""
    beam = optics.Beam(tip=jnp.asarray(one.tip), axis=jnp.asarray(one.axis), **CONE)
    contour = optics.cone_contour(beam, WALL, points=points).point
    towards = one.tip - one.lamp
    shadow = WALL.intersect(one.tip, towards / jnp.linalg.norm(towards)).point
    # Each camera projects all of its points at once: the compilation of a path takes seconds.
    central = seen.centre.project(jnp.concatenate([contour, jnp.stack([one.tip, shadow])]))
    both = jnp.stack([one.tip, one.spot])
    pair = jnp.stack([camera.project(both) for camera in (seen.left, seen.right)])
    return Marks(central[:-2], central[-2], central[-1], pair[:, 0], pair[:, 1])


@eqx.filter_jit
def read(
    marks: Marks, one: InstrumentPlace, seen: Views, radius: Numbers = RADIUS_MM
) -> dict[Sensor, Numbers]:
    """Distances from the marks of one place, mm.

    Args:
        one: its axis and lamp are known; a wrong assumption is a wrong value here.
        seen: the cameras, as they are known.
        radius: of the wall's sphere, whose pole is at the cameras' pole height, mm.
    """
    wall = optics.Sphere(radius)
    ellipse = optics.ellipse_of_contour(marks.contour)
    by_spot = optics.distance_by_area(ellipse, wall, seen.centre, axis=one.axis, **CONE)

    # The shadow's line of sight meets the wall at a point; the line from there to the lamp and the
    # tip's line of sight meet at the tip.
    points, directions = seen.centre.ray(jnp.stack([marks.tip, marks.shadow]))
    foot = wall.intersect(points[1], directions[1]).point
    under_lamp = optics.nearest_point((points[0], directions[0]), (foot, one.lamp - foot))

    # The wall's point in the pair says how high the wall lies; its curvature is known.
    pairs = jnp.stack([marks.tip_pair, marks.wall_pair], axis=1)
    tip, at_wall = optics.nearest_point(seen.left.ray(pairs[0]), seen.right.ray(pairs[1]))
    raised = optics.Sphere(jnp.linalg.norm(at_wall))
    return {
        Sensor.SPOT: by_spot,
        Sensor.SHADOW: wall.intersect(under_lamp, one.axis).distance,
        Sensor.STEREO: raised.intersect(tip, one.axis).distance,
    }


# Which sensors see their marks: the window, the iris, and the instrument in front.

READ, OUT_OF_VIEW = "read", "out of view"
HIDDEN = "hidden"  # The instrument hides its tip's shadow.


def outcomes_at(marks: Marks, every: InstrumentPlace, seen: Views) -> dict[Sensor, np.ndarray]:
    """Whether each sensor can see its marks, for places with a leading axis."""
    in_view, sights = _in_view(marks, every, seen)
    tool = BareFibre(TOOL_RADIUS_MM, math.inf)
    lines = zip(*map(np.asarray, sights), every.tip, every.axis, strict=True)
    hidden = [tool.hides(p, u, tip=tip, axis=axis, margin=0.0) for p, u, tip, axis in lines]
    found = {sensor: np.where(in_view[sensor], READ, OUT_OF_VIEW) for sensor in Sensor}
    found[Sensor.SHADOW][in_view[Sensor.SHADOW] & np.array(hidden)] = HIDDEN
    return found


@eqx.filter_jit
@eqx.filter_vmap(in_axes=(0, 0, None))
def _in_view(
    marks: Marks, one: InstrumentPlace, seen: Views
) -> tuple[dict[Sensor, Numbers], tuple[Numbers, Numbers]]:
    """Whether each sensor's marks are in view, and the shadow's line of sight."""

    def visible(camera: SideCamera, pixels: Numbers, middle: Numbers) -> Numbers:
        """Whether pixels are in the window around the spot, and not behind the iris."""
        inside = jnp.abs(pixels - middle) < WINDOW_PX / 2
        return jnp.all(inside) & jnp.all(camera.transmittance(pixels) > 0)

    spot, both = seen.centre.project(one.spot), jnp.stack([marks.tip, marks.shadow])
    halves = zip((seen.left, seen.right), marks.tip_pair, marks.wall_pair, strict=True)
    pair = [visible(camera, jnp.stack([tip, wall]), wall) for camera, tip, wall in halves]
    return {
        Sensor.SPOT: visible(seen.centre, marks.contour, spot),
        Sensor.SHADOW: visible(seen.centre, both, spot),
        Sensor.STEREO: pair[0] & pair[1],
    }, seen.centre.ray(marks.shadow)


# What each sensor can reach: exact marks with stated noise, and with one wrong assumption.

WRONG_PATH = "the path is taken for a pinhole"
WRONG_LAMP = "the light guide is 1 mm elsewhere"
_LAMP_OFF_MM, _AXIS_OFF_DEG, _RADIUS_OFF_MM = 1.0, 1.0, 0.5


def expected(
    path: str, seen: Views, pinholes: Views, *, draws: int, seed: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of expected.csv and of wrong.csv for one path.

    The first are standard deviations over `draws` of the stated noise, with everything known; the
    second are errors of exact marks if one assumption is wrong, RMS over directions. `pinholes` are
    cameras at the same places without a path.
    """
    pairs = product((0.0, 1.5, 3.0), (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0))
    c, d = np.transpose([*pairs])
    every, at = places(c, d), {"c_mm": c, "d_mm": d}
    true = eqx.filter_jit(eqx.filter_vmap(marks_of, in_axes=(0, None)))(every, seen)
    outcomes, sigmas, biases = outcomes_at(true, every, seen), [], []
    # An array, so that another radius is not compiled anew.
    radius = np.asarray(RADIUS_MM)
    readings = eqx.filter_jit(eqx.filter_vmap(read, in_axes=(0, 0, None, None)))

    rng, sigma = np.random.default_rng(seed), Marks(CONTOUR_PX, MARK_PX, MARK_PX, MARK_PX, WALL_PX)
    noise = jax.tree.map(lambda leaf, s: s * rng.standard_normal((draws, *leaf.shape)), true, sigma)
    drawn = (jax.tree.map(lambda leaf, off, k=k: leaf + off[k], true, noise) for k in range(draws))
    noisy = [readings(marks, every, seen, radius) for marks in drawn]
    for sensor, outcome in outcomes.items():
        spread = np.std([one[sensor] for one in noisy], axis=0)
        found = {"outcome": outcome, "sigma_mm": np.where(outcome == READ, spread, np.nan)}
        sigmas.append(pd.DataFrame({"sensor": sensor, "path": path, **at, **found}))

    turns = _aside(every.axis, math.tan(math.radians(_AXIS_OFF_DEG)))
    shifts = _aside(LAMP_AXIS, _LAMP_OFF_MM)
    assumed = {
        WRONG_PATH: [] if path == "pinhole" else [(every, pinholes, radius)],
        WRONG_LAMP: [(every._replace(lamp=every.lamp + by), seen, radius) for by in shifts],
        "the axis is 1° off": [
            (every._replace(axis=_unit(every.axis + by)), seen, radius) for by in turns
        ],
        "the eye's radius is 0.5 mm larger": [_in_larger_sphere(every, seen, _RADIUS_OFF_MM)],
    }
    for wrong, ones in assumed.items():
        found_by = [readings(true, *one) for one in ones]
        affected = [Sensor.SHADOW] if wrong == WRONG_LAMP else list(Sensor)
        for sensor in affected if ones else ():
            error = np.array([found[sensor] for found in found_by]) - d
            # Displacements in opposite directions have opposite effects; their size counts.
            size = error[0] if len(error) == 1 else np.sqrt(np.mean(error**2, axis=0))
            rows = {"sensor": sensor, "path": path, "wrong": wrong, **at, "error_mm": size}
            biases.append(pd.DataFrame(rows)[outcomes[sensor] == READ])
    return pd.concat(sigmas, ignore_index=True), pd.concat(biases, ignore_index=True)


def _in_larger_sphere(
    every: InstrumentPlace, seen: Views, by: float
) -> tuple[InstrumentPlace, Views, Numbers]:
    """What is known, in the frame of a sphere larger by some mm through the same pole.

    Its centre lies higher above the pole, so cameras and lamp, which stay, lie lower in its frame.
    """
    lower = [camera.pole_height - by for camera in seen]
    moved = eqx.tree_at(lambda views: [camera.pole_height for camera in views], seen, lower)
    lamp = every.lamp - by * np.array([0.0, 0.0, 1.0])
    return every._replace(lamp=lamp), moved, np.asarray(RADIUS_MM + by)


def _aside(axes: np.ndarray, size: float) -> list[np.ndarray]:
    """Vectors across axes, in four directions."""
    first, second = (size * np.asarray(v) for v in optics.perpendicular_frame(axes))
    return [first, second, -first, -second]


# The page.

_COLOURS = {Sensor.SPOT: page.BLUE, Sensor.SHADOW: page.ORANGE, Sensor.STEREO: page.VERMILION}
_MARKS = {Sensor.SPOT: "o", Sensor.SHADOW: "^", Sensor.STEREO: "s"}


def _figure(noise: pd.DataFrame) -> Figure:
    """Standard deviation against distance, for each path."""

    def draw(axes: Axes, _: str, path: str) -> None:
        axes.axhline(ACCEPTABLE_ERROR_MM, color=page.VERMILION, lw=0.8, ls="--", zorder=2.1)
        axes.set(yscale="log", ylim=(1e-4, 5.0))
        for sensor, colour in _COLOURS.items():
            own = grouped(where(noise, path=path, sensor=sensor), "c_mm")
            for (c, line), style in zip(own, ("-", "--", ":"), strict=False):
                look: dict[str, Any] = {"ms": 3, "color": colour, "marker": _MARKS[sensor]}
                label = f"{sensor}, c = {c:g} mm"
                axes.plot(line.d_mm, line.sigma_mm, style, label=label, **look)

    return page.small_multiples(
        draw,
        columns=noise.path.unique().tolist(),
        x=DISTANCE,
        y="σ of d (mm)",
        height=3.0,
        legend_columns=3,
        sharey=True,
    )


def _report(noise: pd.DataFrame, wrong: pd.DataFrame) -> page.Report:
    read = noise[noise.outcome == READ].groupby("sensor").sigma_mm.median()
    medians = ", ".join(f"{number(read[sensor], 4)} mm from the {sensor}" for sensor in Sensor)
    worst = wrong.error_mm.abs().groupby([wrong.wrong, wrong.sensor], sort=False).max().unstack()
    return page.Report(
        title="Which is the best sensor of the distance: the spot, the shadow, or a stereo pair?",
        answer=f"Marks of the stated noise give a median standard deviation of {medians}.",
        lead="The same distance d, from the instrument's tip to the wall along its axis, is read "
        "from the spot of its own light, from the shadow of its tip under a light guide, and from "
        f"a stereo pair with {CONVERGENCE_DEG:g}° between the lines of sight, by the same "
        f"microscope ({SCALE_MM_PX:g} mm/px at the pole) at the same places. All three know the "
        "instrument's axis, the wall's shape and their cameras.",
        first=[
            page.Picture(
                "noise",
                _figure(noise),
                "The spot is the most precise of the three sensors. Standard deviation of d, for "
                f"noise of {CONTOUR_PX:g} px for each of {_POINTS} points of the spot's edge, "
                f"{MARK_PX:g} px in x and y for a tip and for a shadow's tip, {WALL_PX:g} px for "
                "the wall's texture in a pair; the last three are assumptions. Dashed: what "
                "the paper calls acceptable. A line ends where the window or the iris hides a "
                "mark, or the instrument hides its shadow.",
                data="expected.csv",
            ),
            page.Table(
                worst.reset_index().rename(columns=str),
                {"wrong": page.Column("what is wrong")}
                | {f"{sensor}": page.Column(f"{sensor}, mm", 2) for sensor in Sensor},
                "Largest error of exact marks over all paths and places if something is wrong.",
                data="wrong.csv",
            ),
        ],
        claims=list(_claims(noise, wrong)),
        sections=[],
        data={"expected.csv": noise, "wrong.csv": wrong},
    )


def _claims(noise: pd.DataFrame, wrong: pd.DataFrame) -> Iterator[page.Claim]:
    named = ", ".join(Sensor)
    for path, every in grouped(noise, "path"):
        in_view = every[every.outcome == READ].groupby("sensor").sigma_mm
        medians, seen = (found.reindex([*Sensor]) for found in (in_view.median(), in_view.size()))
        yield page.Claim(
            name=f"noise, {path}",
            sentence=f"Through {path}, marks of the stated noise give {listed(medians, '.4f')} mm "
            f"({named}; medians over the places in view). In view are {listed(seen, 'd')} of "
            f"{len(every) // len(Sensor)} places.",
            value=tuple(medians.tolist()),
        )
    for path, taken in grouped(where(wrong, wrong=WRONG_PATH), "path"):
        worst = taken.error_mm.abs().groupby(taken.sensor).max().reindex([*Sensor])
        yield page.Claim(
            name=f"unknown path, {path}",
            sentence=f"If {path} is taken for a pinhole, the largest errors are "
            f"{listed(worst, '.2f')} mm ({named}).",
            value=tuple(worst.tolist()),
        )


@command(with_scene=False)
def sensors(study: Study) -> dict[str, pd.DataFrame]:
    """Read one distance from the spot, from the instrument's shadow and from a stereo pair."""
    cameras = {path: views(path) for path in [*PATHS][: 2 if study.quick else None]}
    with study.timed("exact marks"):
        how: dict[str, Any] = {"draws": 50 if study.quick else 200, "seed": study.seed}
        found = [expected(path, seen, cameras["pinhole"], **how) for path, seen in cameras.items()]
        noise, wrong = (pd.concat(of, ignore_index=True) for of in zip(*found, strict=True))
    study.publish(_report, noise, wrong)
    return {"expected": noise, "wrong": wrong}
