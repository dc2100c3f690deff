"""`eyespot study sensors`: one distance by the spot, by the instrument's shadow, and by stereo."""

from __future__ import annotations

import math
from collections.abc import Iterator
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
from eyespot.optics import viewing
from eyespot.optics.instrument import BareFibre
from eyespot.optics.lines import directions_across

# What the sensors look at: the instrument, the light guide, the wall, and the microscopes.

PATHS = {"pinhole": None, "flat contact lens": "flat", "wide-field 90 D": "wide-field-90"}
"""Viewing lens of each path; behind a lens lies Navarro's phakic eye."""

RADIUS_MM = 12.0  # Navarro's retina.
WALL, POLE = optics.Sphere(RADIUS_MM), np.array([0.0, 0.0, -RADIUS_MM])
PINHOLE_HEIGHT_MM = 200.0
SCALE_MM_PX = 0.0134  # The shadow of a tip at 6 mm lies 6 mm beside the spot.
WINDOW_PX = np.array([960, 720])
CONVERGENCE_DEG = 5.5  # Between a stereo microscope's lines of sight, without a lens: 5 to 6.
CONE = {"half_angle": float(np.arctan(1 / 20.0)), "apex_offset": -5.117}
TOOL_RADIUS_MM = 0.255
TROCAR_POLAR_DEG = 48.0
TOOL_AZIMUTH_DEG, LAMP_AZIMUTH_DEG, SPOT_AZIMUTH_DEG = 30.0, 150.0, 270.0
"""The trocars lie at two and ten o'clock; the spot moves away from both."""
LAMP_ABOVE_MM = 15.0  # Distance of the light guide's end from the pole, along its trocar.

Numbers = Any  # NumPy's, in compiled functions JAX's; several places have a leading axis.


class InstrumentPlace(NamedTuple):
    """An instrument at the wall, and the light guide that makes its shadow; mm, eye frame."""

    tip: Numbers
    axis: Numbers  # unit vector from the trocar to O
    spot: Numbers
    lamp: Numbers


class Views(NamedTuple):
    """The microscope that sees spot and shadow, and the pair; the pole is at pixel (0, 0)."""

    centre: viewing.SideCamera
    left: viewing.SideCamera
    right: viewing.SideCamera


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
        bare = viewing.bare_path(eye_radius=RADIUS_MM, pinhole_height=PINHOLE_HEIGHT_MM)
        return _views(bare, half)
    eye, lens = viewing.load_eye("navarro", wavelength_nm=550.0), viewing.load_viewing_lens(name)
    cornea = float(eye.axial_length) - RADIUS_MM
    seen = viewing.viewing_path(eye, lens, pinhole_distance=PINHOLE_HEIGHT_MM - cornea)
    # A stereo inverter turns both images, and exchanges them; else near would look far.
    return _views(seen, -half if isinstance(lens, viewing.ThinLens) else half)


@eqx.filter_jit
def _views(path: viewing.ViewingPath, half: float) -> Views:
    up = jnp.array([0.0, 0.0, 1.0])
    cameras = (
        viewing.side_camera(path, aside=jnp.array([x, 0.0]), scale=SCALE_MM_PX, upright=True)
        for x in (0.0, -half, half)
    )
    return Views(*(c.centred_on(c.pole_height * up, width=1, height=1) for c in cameras))


# The sensors: what they see, and the distances that follow.

CONTOUR_PX, MARK_PX, WALL_PX = 0.05, 1.0, 0.1
"""Stated noise of each of 128 points of the spot's edge (as in the study of poses), of a tip and a
shadow's tip in x and y, and of the wall's texture matched in a pair; the last are assumptions."""
_POINTS = 128


SENSORS = {"spot": (page.BLUE, "o"), "shadow": (page.ORANGE, "^"), "stereo": (page.VERMILION, "s")}
"""What the distance is read from, and the looks of its lines."""


class Marks(NamedTuple):
    """What is measured in the central image and in the pair, px."""

    contour: Numbers  # the spot's edge, n x 2
    tip: Numbers
    shadow: Numbers  # of the tip
    tip_pair: Numbers  # 2 x 2
    wall_pair: Numbers  # a point of the wall near O


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
) -> dict[str, Numbers]:
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
        "spot": by_spot,
        "shadow": wall.intersect(under_lamp, one.axis).distance,
        "stereo": raised.intersect(tip, one.axis).distance,
    }


# Which sensors see their marks: the window, the iris, and the instrument in front.

READ, OUT_OF_VIEW, HIDDEN = "read", "out of view", "hidden"  # by the instrument: its shadow


def outcomes_at(marks: Marks, every: InstrumentPlace, seen: Views) -> dict[str, np.ndarray]:
    """Whether each sensor can see its marks, for places with a leading axis."""
    in_view, sights = _in_view(marks, every, seen)
    tool = BareFibre(TOOL_RADIUS_MM, math.inf)
    lines = zip(*map(np.asarray, sights), every.tip, every.axis, strict=True)
    hidden = [tool.hides(p, u, tip=tip, axis=axis, margin=0.0) for p, u, tip, axis in lines]
    found = {sensor: np.where(in_view[sensor], READ, OUT_OF_VIEW) for sensor in SENSORS}
    found["shadow"][in_view["shadow"] & np.array(hidden)] = HIDDEN
    return found


@eqx.filter_jit
@eqx.filter_vmap(in_axes=(0, 0, None))
def _in_view(marks: Marks, one: InstrumentPlace, seen: Views) -> tuple[Any, Any]:
    """Whether each sensor's marks are in view, and the shadow's line of sight."""

    def visible(camera: viewing.SideCamera, pixels: Numbers, middle: Numbers) -> Numbers:
        # In the window around the spot, and not behind the iris.
        inside = jnp.abs(pixels - middle) < WINDOW_PX / 2
        return jnp.all(inside) & jnp.all(camera.transmittance(pixels) > 0)

    spot, both = seen.centre.project(one.spot), jnp.stack([marks.tip, marks.shadow])
    halves = zip((seen.left, seen.right), marks.tip_pair, marks.wall_pair, strict=True)
    pair = [visible(camera, jnp.stack([tip, wall]), wall) for camera, tip, wall in halves]
    return {
        "spot": visible(seen.centre, marks.contour, spot),
        "shadow": visible(seen.centre, both, spot),
        "stereo": pair[0] & pair[1],
    }, seen.centre.ray(marks.shadow)


# What each sensor can reach: exact marks with stated noise, and with one wrong assumption.

WRONG_PATH = "the path is taken for a pinhole"
WRONG_LAMP = "the light guide is 1 mm elsewhere"


def expected(
    path: str, seen: Views, pinholes: Views, *, draws: int, seed: int
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of expected.csv and of wrong.csv for one path.

    The first are standard deviations over `draws` of the stated noise, with everything known; the
    second are errors of exact marks if one assumption is wrong, RMS over directions. `pinholes` are
    cameras at the same places without a path.
    """
    c, d = np.array([*product((0.0, 1.5, 3.0), (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0))]).T
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

    quarters = np.radians((0.0, 90.0, 180.0, 270.0))
    shifts = [directions_across(LAMP_AXIS, turn) for turn in quarters]
    leans = [math.tan(math.radians(1.0)) * directions_across(every.axis, turn) for turn in quarters]
    assumed = {
        WRONG_PATH: [] if path == "pinhole" else [(every, pinholes, radius)],
        WRONG_LAMP: [(every._replace(lamp=every.lamp + by), seen, radius) for by in shifts],
        "the axis is 1° off": [
            (every._replace(axis=_unit(every.axis + by)), seen, radius) for by in leans
        ],
        "the eye's radius is 0.5 mm larger": [_in_larger_sphere(every, seen, by=0.5)],
    }
    for wrong, ones in assumed.items():
        found_by = [readings(true, *one) for one in ones]
        affected = ["shadow"] if wrong == WRONG_LAMP else SENSORS
        for sensor in affected if ones else ():
            error = np.array([found[sensor] for found in found_by]) - d
            # Displacements in opposite directions have opposite effects; their size counts.
            size = error[0] if len(error) == 1 else np.sqrt(np.mean(error**2, axis=0))
            rows = {"sensor": sensor, "path": path, "wrong": wrong, **at, "error_mm": size}
            biases.append(pd.DataFrame(rows)[outcomes[sensor] == READ])
    return pd.concat(sigmas, ignore_index=True), pd.concat(biases, ignore_index=True)


def _in_larger_sphere(every: InstrumentPlace, seen: Views, *, by: float) -> tuple[Any, ...]:
    """What is known, in the frame of a sphere larger by some mm through the same pole."""
    # Its centre lies higher above the pole, so cameras and lamp, which stay, lie lower in it.
    lower = [camera.pole_height - by for camera in seen]
    moved = eqx.tree_at(lambda views: [camera.pole_height for camera in views], seen, lower)
    lamp = every.lamp - by * np.array([0.0, 0.0, 1.0])
    return every._replace(lamp=lamp), moved, np.asarray(RADIUS_MM + by)


# The page.


def _figure(noise: pd.DataFrame) -> Figure:
    def draw(axes: Axes, _: str, path: str) -> None:
        axes.axhline(ACCEPTABLE_ERROR_MM, color=page.VERMILION, lw=0.8, ls="--", zorder=2.1)
        axes.set(yscale="log", ylim=(1e-4, 5.0))
        for sensor, (colour, mark) in SENSORS.items():
            own = grouped(where(noise, path=path, sensor=sensor), "c_mm")
            for (c, line), dashes in zip(own, ("-", "--", ":"), strict=True):
                style: dict[str, Any] = {"label": f"{sensor}, c = {c:g} mm", "c": colour, "ms": 3}
                axes.plot(line.d_mm, line.sigma_mm, mark + dashes, **style)

    paths, y = noise.path.unique().tolist(), "σ of d (mm)"
    return page.small_multiples(draw, columns=paths, x=DISTANCE, y=y, legend_columns=3, sharey=True)


def _report(noise: pd.DataFrame, wrong: pd.DataFrame) -> page.Report:
    read = noise[noise.outcome == READ].groupby("sensor").sigma_mm.median()
    medians = ", ".join(f"{number(read[sensor], 4)} mm from the {sensor}" for sensor in SENSORS)
    worst = wrong.error_mm.abs().groupby([wrong.wrong, wrong.sensor], sort=False).max().unstack()
    worst = worst.add_suffix("_mm").reset_index()
    return page.Report(
        title="Which is the best sensor of the distance: the spot, the shadow, or a stereo pair?",
        answer=f"Marks of the stated noise give a median standard deviation of {medians}.",
        lead="The same distance d, from the instrument's tip to the wall along its axis, is read "
        "from the spot of its own light, from the shadow of its tip under a light guide, and from "
        f"a stereo pair with {CONVERGENCE_DEG:g}° between the lines of sight, by one microscope "
        f"({SCALE_MM_PX:g} mm/px at the pole). All three know the instrument's axis, the wall's "
        "shape and their cameras.",
        first=[
            page.Picture(
                "noise",
                _figure(noise),
                "The spot is the most precise of the three sensors. Standard deviation of d, for "
                f"noise of {CONTOUR_PX:g} px for each of {_POINTS} points of the spot's edge, "
                f"{MARK_PX:g} px in x and y for a tip and for a shadow's tip, {WALL_PX:g} px for "
                "the wall's texture in a pair; the last three are assumptions. Dashed: what the "
                "paper calls acceptable. A line ends where a mark is hidden.",
                data="expected.csv",
            ),
            page.Table(worst, worst.columns.tolist(), "Largest error of exact marks.", "wrong.csv"),
        ],
        claims=list(_claims(noise)),
        data={"expected.csv": noise, "wrong.csv": wrong},
    )


def _claims(noise: pd.DataFrame) -> Iterator[page.Claim]:
    for path, every in grouped(noise, "path"):
        in_view = every[every.outcome == READ].groupby("sensor").sigma_mm
        medians, seen = (found.reindex([*SENSORS]) for found in (in_view.median(), in_view.size()))
        yield page.Claim(
            name=f"noise, {path}",
            sentence=f"Through {path}, marks of the stated noise give {listed(medians, '.4f')} mm "
            f"({', '.join(SENSORS)}; medians over the {listed(seen, 'd')} places in view).",
            value=medians.spot,
            high=medians[["shadow", "stereo"]].min(),
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
