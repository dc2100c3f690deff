"""The image model on chunks of pixels, compiled once for all frames and stages of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

import optics
from calibration.spots import beam_directions, phantom_wall
from optics.wall_light import PARAMETERS as LENS
from optics.wall_light import BeamLight, Cone, Lens, LensTable, WallPixels, radiance, wall_pixels

CHUNK = 1024
"""Pixels per chunk, few enough that the derivatives stay in the cache."""

_ROUNDING = 1e-6  # of a pixel; smaller fractions are rounding errors and no cut by an edge


class Problem(eqx.Module):
    """The constants of a fit, and the conversion from its parameters to values.

    Attributes:
        first, size: the free values are first + size x.
        fixed: values of the parameters that are not free.
        microscope: the camera; `scale` and `eye_radius` of the values replace its own.
        motion: the tip's direction of motion towards the wall, reported by the robot.
        axis: the tool's axis towards the wall, reported by the robot.
        blur: sigma with which the frames were blurred, px, or None.
        names: names of the free parameters.
        kind: kind of the wall.
    """

    first: Float[Array, "p"]
    size: Float[Array, "p"]
    fixed: dict[str, Array]
    microscope: optics.Microscope
    motion: Float[Array, "3"]
    axis: Float[Array, "3"]
    blur: Float[Array, ""] | None
    names: tuple[str, ...] = eqx.field(static=True)
    kind: str = eqx.field(static=True)


class Chunk(NamedTuple):
    """Pixels, or squares of pixels, of one frame, padded to one size; padding has `weight` 0.

    Attributes:
        pixels: (u, v) of the centres, px.
        sides: sides of the squares, px; 1 for single pixels.
        light: measured mean light, full wells.
        weight: 1 over the light's sigma.
        reading: the robot's reading, mm.
        exposure_s: reported exposure time.
        frame: the frame's number.
    """

    pixels: Float[np.ndarray, "n 2"]
    sides: Float[np.ndarray, "n"]
    light: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]
    reading: Float[np.ndarray, ""]
    exposure_s: Float[np.ndarray, ""]
    frame: Int[np.ndarray, ""]


class View(NamedTuple):
    """The model's values for a chunk's pixels.

    Attributes:
        light: full wells.
        direct: the part of `light` that comes directly from the source.
        step: height of the sharp edge that cuts the pixel, full wells; 0 without an edge.
        along: distance of the wall from the tip's plane, mm.
        point: point on the wall, mm.
        sight: unit vectors from the microscope.
        tip, axis: the frame's tip and beam.
    """

    light: Float[Array, "n"]
    direct: Float[Array, "n"]
    step: Float[Array, "n"]
    along: Float[Array, "n"]
    point: Float[Array, "n 3"]
    sight: Float[Array, "n 3"]
    tip: Float[Array, "3"]
    axis: Float[Array, "3"]


class Sums(NamedTuple):
    """A chunk's part of the normal equations; the last parameter is the frame's exposure."""

    cost: Float[Array, ""]
    gradient: Float[Array, "p+1"]
    information: Float[Array, "p+1 p+1"]
    residuals: Float[Array, "n"]


def values_at(problem: Problem, x: Array) -> dict[str, Array]:
    """Values of all parameters at x."""
    free = problem.first + problem.size * x
    return problem.fixed | dict(zip(problem.names, free, strict=True))


@eqx.filter_jit
def look(problem: Problem, table: LensTable | None, x: Array, chunk: Chunk) -> View:
    """Evaluate the model on a chunk."""
    values = values_at(problem, x)
    camera, surface = _eye(problem, values)
    wall = _wall(chunk, camera, surface)
    tip, axis = _pose(problem, values, camera, surface, chunk.reading)
    source = _source(problem, values, table)
    gain = values["sensitivity"] * chunk.exposure_s
    direct = gain * values["reflectance"] / jnp.pi * values["power"]
    direct = direct * source.irradiance(wall, tip=tip, axis=axis)
    lit = source.lit(wall, tip=tip, axis=axis)
    cut = (lit > _ROUNDING) & (lit < 1.0 - _ROUNDING)
    return View(
        light=gain * _radiance(problem, values, wall, source, tip, axis),
        direct=direct,
        step=jnp.where(cut, direct / jnp.where(cut, lit, 1.0), 0.0),
        along=(wall.point - tip) @ axis,
        point=wall.point,
        sight=camera.ray(jnp.asarray(chunk.pixels))[1],
        tip=tip,
        axis=axis,
    )


@eqx.filter_jit
def linearised(
    problem: Problem, table: LensTable | None, x: Array, over: Array, chunk: Chunk
) -> tuple[Float[Array, "n"], Float[Array, "p+1 n"]]:
    """A chunk's residuals, and their derivatives; the last parameter is the frame's exposure.

    Args:
        problem: the fit.
        table: light of the lens, computed near `x`; None for a cone.
        x: the parameters.
        over: relative excess of the frame's exposure over the reported one.
        chunk: the pixels.

    Returns:
        Model minus light over sigma, and its derivatives.
    """

    def residuals(z: Array) -> Array:
        values = values_at(problem, z[:-1])
        camera, surface = _eye(problem, values)
        wall = _wall(chunk, camera, surface)
        tip, axis = _pose(problem, values, camera, surface, chunk.reading)
        source = _source(problem, values, table)
        gain = values["sensitivity"] * chunk.exposure_s * (1.0 + z[-1])
        model = gain * _radiance(problem, values, wall, source, tip, axis)
        return jnp.asarray(chunk.weight) * (model - chunk.light)

    z = jnp.append(x, over)
    return jax.vmap(lambda direction: jax.jvp(residuals, (z,), (direction,)), out_axes=(None, 0))(
        jnp.eye(z.size)
    )


def sums(problem: Problem, table: LensTable | None, x: Array, over: Array, chunk: Chunk) -> Sums:
    """A chunk's contribution to the normal equations; arguments as for `linearised`.

    It is not compiled as a whole, because `linearised` is compiled by itself in any case.
    """
    return _products(*linearised(problem, table, x, over, chunk))


@jax.jit
def _products(value: Array, slopes: Array) -> Sums:
    return Sums(jnp.sum(value**2), slopes @ value, slopes @ slopes.T, value)


def _radiance(
    problem: Problem,
    values: Mapping[str, Array],
    wall: WallPixels,
    source: BeamLight,
    tip: Array,
    axis: Array,
) -> Array:
    return radiance(
        wall, values, source=source, tip=tip, axis=axis, eyeball=problem.kind == "eyeball"
    )


def poses(
    problem: Problem, values: Mapping[str, ArrayLike], readings: Float[np.ndarray, "frames"]
) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, "3"]]:
    """Tips and beam of frames with the given readings."""
    known = {name: jnp.asarray(value, float) for name, value in values.items()}
    tips, beam = _poses(problem, known, jnp.asarray(readings))
    return np.asarray(tips), np.asarray(beam)


@eqx.filter_jit
def _poses(problem: Problem, values: dict[str, Array], readings: Array) -> tuple[Array, Array]:
    camera, surface = _eye(problem, values)
    return jax.vmap(
        lambda reading: _pose(problem, values, camera, surface, reading), out_axes=(0, None)
    )(readings)


def _wall(chunk: Chunk, camera: optics.Microscope, surface: optics.Surface) -> WallPixels:
    return wall_pixels(
        jnp.asarray(chunk.pixels),
        microscope=camera,
        surface=surface,
        sides=jnp.asarray(chunk.sides),
    )


def _eye(problem: Problem, values: Mapping[str, Array]) -> tuple[optics.Microscope, optics.Surface]:
    camera = eqx.tree_at(
        lambda m: (m.scale, m.pole_height),
        problem.microscope,
        (values["scale"], -values["eye_radius"]),
    )
    return camera, phantom_wall(problem.kind, eye_radius=values["eye_radius"])


def _pose(
    problem: Problem,
    values: Mapping[str, Array],
    camera: optics.Microscope,
    surface: optics.Surface,
    reading: ArrayLike,
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Tip and beam of a frame. The tip follows the robot's motion, and the beam its tool."""
    spot = surface.intersect(*camera.ray(jnp.stack([values["u"], values["v"]]))).point
    motion, beam = beam_directions(
        motion=problem.motion,
        axis=problem.axis,
        lean=jnp.stack([values["lean"], values["lean_sideways"]]),
        boresight=jnp.stack([values["boresight"], values["boresight_sideways"]]),
    )
    return spot - values["touch"] * beam - reading * motion, beam


def _source(problem: Problem, values: Mapping[str, Array], table: LensTable | None) -> BeamLight:
    if table is None:
        own, added = values.get("blur"), problem.blur
        blurs = [blur for blur in (own, added) if blur is not None]
        blur = jnp.sqrt(sum(jnp.square(b) for b in blurs)) if blurs else None
        # Frames that were blurred much more than the wall spreads the light show nothing of it.
        spread = values.get("spread") if added is None else None
        return Cone(values["half_angle"], values["b"], blur, spread)
    names = [name for name in problem.names if name in LENS]
    now = jnp.array([values[name] for name in names])
    moved = eqx.tree_at(lambda t: t.moved, table, now - table.at)
    return Lens(moved, values.get("spread"))
