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
from operator import add, itemgetter
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
from eyespot.benchmarks.statistics import largest
from eyespot.benchmarks.study import Study
from eyespot.benchmarks.study_command import command
from eyespot.optics.viewing import (
    ThinLens,
    bare_path,
    load_eye,
    load_viewing_lens,
    path_camera,
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

    eccentricity: Numbers
    distance: Numbers
    tip: Numbers
    axis: Numbers  # unit vector from the trocar to O
    spot: Numbers
    lamp: Numbers
    lamp_axis: Numbers


class Views(NamedTuple):
    """The microscope that sees spot and shadow, and the pair; the pole is at pixel (0, 0)."""

    centre: optics.Camera
    left: optics.Camera
    right: optics.Camera


def places(eccentricities: Numbers, distances: Numbers) -> InstrumentPlace:
    """Places at pairs of c and d (mm), with a leading axis."""
    azimuth, trocars = math.radians(SPOT_AZIMUTH_DEG), {}
    for name, azimuth_deg in (("tool", TOOL_AZIMUTH_DEG), ("lamp", LAMP_AZIMUTH_DEG)):
        turn, polar = math.radians(azimuth_deg), math.radians(TROCAR_POLAR_DEG)
        aside = math.sin(polar) * np.array([math.cos(turn), math.sin(turn)])
        trocars[name] = RADIUS_MM * np.array([*aside, math.cos(polar)])
    c, d = np.asarray(eccentricities, float), np.asarray(distances, float)
    spot = np.array([WALL.frame_at(eccentricity=one, azimuth=azimuth).origin for one in c])
    axis = _unit(spot - trocars["tool"])
    lamp_axis = np.broadcast_to(_unit(POLE - trocars["lamp"]), spot.shape)
    tip, lamp = spot - d[:, None] * axis, POLE - LAMP_ABOVE_MM * lamp_axis
    return InstrumentPlace(c, d, tip, axis, spot, lamp, lamp_axis)


def views(path: str) -> Views:
    """The microscopes that look through a path."""
    if (name := PATHS[path]) is None:
        bare = bare_path(eye_radius=RADIUS_MM, pinhole_height=PINHOLE_HEIGHT_MM)
        return _views(bare, bare=True, inverted=False)
    eye, lens = load_eye(EYE, wavelength_nm=WAVELENGTH_NM), load_viewing_lens(name)
    cornea = float(eye.axial_length) - RADIUS_MM
    seen = viewing_path(eye, lens, pinhole_distance=PINHOLE_HEIGHT_MM - cornea)
    return _views(seen, bare=False, inverted=isinstance(lens, ThinLens))


@eqx.filter_jit
def _views(seen: Any, *, bare: bool, inverted: bool) -> Views:
    if bare:
        centre: optics.Camera = optics.microscope(
            scale=SCALE_MM_PX, pinhole_height=PINHOLE_HEIGHT_MM, eye_radius=RADIUS_MM
        )
    else:
        centre = path_camera(seen, scale=SCALE_MM_PX, upright=True)
    half = math.tan(math.radians(CONVERGENCE_DEG / 2)) * (PINHOLE_HEIGHT_MM + RADIUS_MM)
    left, right = (
        side_camera(seen, aside=jnp.array([x, 0.0]), scale=SCALE_MM_PX, upright=True)
        # A stereo inverter turns both images, and exchanges them; else near would look far.
        for x in ((half, -half) if inverted else (-half, half))
    )
    up = jnp.array([0.0, 0.0, 1.0])
    every = centre, left, right
    return Views(*(c.centred_on(c.pole_height * up, width=1, height=1) for c in every))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


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


class Known(NamedTuple):
    """What the sensors take as known; a wrong assumption is a wrong value here.

    The cameras; the radius of the wall's sphere, whose pole is at the cameras' pole height, mm; the
    light guide's end, mm; and the instrument's unit vector.
    """

    views: Views
    radius: Numbers
    lamp: Numbers
    axis: Numbers


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


def shadow_of(one: InstrumentPlace) -> Numbers:
    """Where the tip's shadow falls on the wall, from a lamp without extent, mm."""
    towards = one.tip - one.lamp
    return WALL.intersect(one.tip, towards / jnp.linalg.norm(towards)).point


def contour_of(one: InstrumentPlace, points: int) -> Numbers:
    """The edge of the spot on the wall, mm."""
    beam = optics.Beam(tip=jnp.asarray(one.tip), axis=jnp.asarray(one.axis), **CONE)
    return optics.cone_contour(beam, WALL, points=points).point


def marks_of(one: InstrumentPlace, views: Views, *, points: int = _POINTS) -> Marks:
    """The true marks."""
    tip_and_shadow = jnp.stack([one.tip, shadow_of(one)])
    # Each camera projects all of its points at once: the compilation of a path takes seconds.
    central = views.centre.project(jnp.concatenate([contour_of(one, points), tip_and_shadow]))
    both = jnp.stack([one.tip, one.spot])
    pair = jnp.stack([camera.project(both) for camera in (views.left, views.right)])
    return Marks(central[:-2], central[-2], central[-1], pair[:, 0], pair[:, 1])


@eqx.filter_jit
def by_spot(ellipse: optics.Ellipse, known: Known) -> Numbers:
    """d by the exact spot with the ellipse's area, mm (`optics.distance_by_area`)."""
    return optics.distance_by_area(
        ellipse, optics.Sphere(known.radius), known.views.centre, axis=known.axis, **CONE
    )


@eqx.filter_jit
def by_shadow(tip: Numbers, shadow: Numbers, known: Known) -> Numbers:
    """d by the tip and its shadow in one image (px), mm.

    The shadow's line of sight meets the wall at a point; the line from there to the lamp and the
    tip's line of sight meet at the tip.
    """
    wall = optics.Sphere(known.radius)
    points, directions = known.views.centre.ray(jnp.stack([tip, shadow]))
    foot = wall.intersect(points[1], directions[1]).point
    by_both = optics.nearest_point((points[0], directions[0]), (foot, known.lamp - foot))
    return wall.intersect(by_both, known.axis).distance


@eqx.filter_jit
def by_stereo(tip_pair: Numbers, wall_pair: Numbers, known: Known) -> Numbers:
    """d by the tip and a point of the wall in a stereo pair (px), mm.

    The wall's point says how high the wall lies; the wall's curvature is known.
    """
    pairs = jnp.stack([tip_pair, wall_pair], axis=1)
    tip, wall = optics.nearest_point(
        known.views.left.ray(pairs[0]), known.views.right.ray(pairs[1])
    )
    return optics.Sphere(jnp.linalg.norm(wall)).intersect(tip, known.axis).distance


@eqx.filter_jit
def readings(marks: Marks, known: Known) -> dict[Sensor, Any]:
    """Distances from marks at all places, each with a lamp and an axis, mm."""

    def one(own: Marks, lamp: Any, axis: Any) -> dict[Sensor, Any]:
        here = known._replace(lamp=lamp, axis=axis)
        return {
            Sensor.SPOT: by_spot(optics.ellipse_of_contour(own.contour), here),
            Sensor.SHADOW: by_shadow(own.tip, own.shadow, here),
            Sensor.STEREO: by_stereo(own.tip_pair, own.wall_pair, here),
        }

    return jax.vmap(one)(marks, known.lamp, known.axis)


# Which sensors see their marks: the window, the iris, and the instrument in front.

READ, OUT_OF_VIEW = "read", "out of view"
HIDDEN = "hidden"  # The instrument hides its tip's shadow.
_EDGE_POINTS = 32  # All of them must be in view.
_SHAFT_POINTS = 200


def outcomes_at(every: InstrumentPlace, seen: Views) -> dict[Sensor, np.ndarray]:
    """Whether each sensor can see its marks, for places with a leading axis."""
    in_view, hidden = _in_view_and_hidden(every, seen)
    found = {sensor: np.where(in_view[sensor], READ, OUT_OF_VIEW) for sensor in Sensor}
    found[Sensor.SHADOW][in_view[Sensor.SHADOW] & hidden] = HIDDEN
    return found


@eqx.filter_jit
def _in_view_and_hidden(every: InstrumentPlace, seen: Views) -> tuple[dict[Sensor, Any], Any]:
    def in_view(camera: Any, points: Any) -> Any:
        """Whether points are in the window, centred on the first one, and not behind the iris."""
        pixels = camera.project(points)
        inside = jnp.all(jnp.abs(pixels - pixels[0]) < WINDOW_PX / 2, axis=-1)
        # The transmittance behind the iris is 0.
        bare = isinstance(camera, optics.Microscope)
        return inside if bare else inside & (camera.transmittance(pixels) > 0)

    def at(one: InstrumentPlace) -> tuple[dict[Sensor, Any], Any]:
        shadow = shadow_of(one)
        marks = jnp.stack([one.spot, one.tip, shadow])
        central = in_view(seen.centre, jnp.concatenate([marks, contour_of(one, _EDGE_POINTS)]))
        pair = jnp.stack([in_view(camera, marks[:2]) for camera in seen[1:]])
        _, down = seen.centre.ray(seen.centre.project(shadow))
        shaft = one.tip - jnp.linspace(0.0, RADIUS_MM, _SHAFT_POINTS)[:, None] * one.axis - shadow
        aside = jnp.linalg.norm(shaft - (shaft @ down)[:, None] * down, axis=-1)
        seen_by = {
            Sensor.SPOT: jnp.all(central[3:]),
            Sensor.SHADOW: central[1] & central[2],
            Sensor.STEREO: jnp.all(pair),
        }
        return seen_by, jnp.any(aside < TOOL_RADIUS_MM)

    return jax.vmap(at)(every)


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
    every = places(*np.transpose([*pairs]))
    true = eqx.filter_jit(jax.vmap(lambda one: marks_of(one, seen)))(every)
    rng, sigma = np.random.default_rng(seed), Marks(CONTOUR_PX, MARK_PX, MARK_PX, MARK_PX, WALL_PX)
    noise = jax.tree.map(lambda leaf, s: s * rng.standard_normal((draws, *leaf.shape)), true, sigma)
    right = Known(seen, np.asarray(RADIUS_MM), every.lamp, every.axis)
    noisy = [
        readings(jax.tree.map(add, true, jax.tree.map(itemgetter(k), noise)), right)
        for k in range(draws)
    ]
    aside = math.tan(math.radians(_AXIS_OFF_DEG))
    turned = [_unit(every.axis + v) for v in _aside(every.axis, aside)]
    assumed = {
        WRONG_PATH: [] if path == "pinhole" else [right._replace(views=pinholes)],
        WRONG_LAMP: [
            right._replace(lamp=every.lamp + aside)
            for aside in _aside(every.lamp_axis, _LAMP_OFF_MM)
        ],
        "the axis is 1° off": [right._replace(axis=axis) for axis in turned],
        "the eye's radius is 0.5 mm larger": [_in_larger_sphere(right, _RADIUS_OFF_MM)],
    }
    at = {"c_mm": every.eccentricity, "d_mm": every.distance}
    outcomes = outcomes_at(every, seen)
    sigmas, biases = [], []
    for sensor, outcome in outcomes.items():
        spread = np.std([one[sensor] for one in noisy], axis=0)
        found = {"outcome": outcome, "sigma_mm": np.where(outcome == READ, spread, np.nan)}
        sigmas.append(pd.DataFrame({"sensor": sensor, "path": path, **at, **found}))
    for wrong, ones in assumed.items():
        read = [readings(true, one) for one in ones]
        affected = [Sensor.SHADOW] if wrong == WRONG_LAMP else list(Sensor)
        for sensor in affected if ones else ():
            error = np.array([one[sensor] for one in read]) - every.distance
            # Displacements in opposite directions have opposite effects; their size counts.
            size = error[0] if len(error) == 1 else np.sqrt(np.mean(error**2, axis=0))
            rows = {"sensor": sensor, "path": path, "wrong": wrong, **at, "error_mm": size}
            biases.append(pd.DataFrame(rows)[outcomes[sensor] == READ])
    return pd.concat(sigmas, ignore_index=True), pd.concat(biases, ignore_index=True)


def _in_larger_sphere(known: Known, by: float) -> Known:
    """What is known, in the frame of a larger sphere through the same pole; mm.

    Its centre lies higher above the pole, so cameras and lamp, which stay, lie lower in its frame.
    """
    lowered = [
        eqx.tree_at(lambda c: c.pole_height, camera, camera.pole_height - by)
        for camera in known.views
    ]
    lamp = known.lamp - by * np.array([0.0, 0.0, 1.0])
    return Known(Views(*lowered), known.radius + by, lamp, known.axis)


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
    named, paths = ", ".join(Sensor), noise.path.unique().tolist()
    for path in paths:
        sigmas = [where(noise, path=path, outcome=READ, sensor=s).sigma_mm for s in Sensor]
        medians, seen = tuple(float(s.median()) for s in sigmas), [len(s) for s in sigmas]
        yield page.Claim(
            name=f"noise, {path}",
            sentence=f"Through {path}, marks of the stated noise give {listed(medians, '.4f')} mm "
            f"({named}; medians over the places in view). In view are {listed(seen, 'd')} of "
            f"{len(where(noise, sensor=Sensor.SPOT, path=path))} places.",
            value=medians,
        )
    for path in paths[1:]:
        taken = where(wrong, path=path, wrong=WRONG_PATH)
        worst = tuple(largest(where(taken, sensor=sensor).error_mm) for sensor in Sensor)
        yield page.Claim(
            name=f"unknown path, {path}",
            sentence=f"If {path} is taken for a pinhole, the largest errors are "
            f"{listed(worst, '.2f')} mm ({named}).",
            value=worst,
        )
    lamp = largest(where(wrong, wrong=WRONG_LAMP).error_mm)
    yield page.Claim(
        name="light guide",
        sentence="A light guide 1 mm beside the place where it is thought to be changes the "
        f"shadow's distance by up to {lamp:.2f} mm.",
        value=lamp,
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
