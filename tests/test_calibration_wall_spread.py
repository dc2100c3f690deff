"""The pixel fit on a wall that spreads light: its image is a spread disc, its fit finds L."""

import math
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import calibration
import optics
from calibration.spots import Prior
from estimator import Stack
from optics.wall_light import Cone, Lens, wall_pixels
from optics.wall_light.lens import Grid, LensTable
from scenes import Scene, render_stack
from scenes.world import World
from tests.spread_disc import lit_by_disc, radii

pytestmark = pytest.mark.usefixtures("fast_compilation")

HALF_ANGLE, B = math.atan(1 / 20), -5.117
START = {"half_angle": 0.055, "b": -4.5}


def scene(**tables: Any) -> Scene:
    """A withdrawal from an even plane, in frames of 96 x 96."""
    settings: dict[str, Any] = {
        "schema": 1,
        "phantom": {"wall": "uniform", "kind": "plane", "spread": "own"},
        "source": {"kind": "cone"},
        "spot": {"incidence_deg": 0.0},
        "motion": {"start_mm": 1.0, "travel_mm": 4.0, "frames": 4},
        "instrument": {"visible": False},
        "microscope": {"width_px": 96, "height_px": 96, "scale_mm_px": 0.015, "samples": 16},
        "exposures": {"kinds": ["metered"]},
    }
    return Scene.model_validate(
        settings | {name: settings.get(name, {}) | table for name, table in tables.items()}
    )


@pytest.mark.parametrize(("length", "limit"), [(0.02, 0.002), (0.05, 0.0008), (0.1, 0.0002)])
def test_the_image_of_a_cone_is_a_spread_disc(length, limit):
    world = World(scene())
    beam = optics.beam_at_spot(
        world.wall, eccentricity=0.0, distance=3.0, half_angle=HALF_ANGLE, apex_offset=B
    )
    # One row of pixels through the spot's middle.
    u = jnp.arange(0.0, 96.0)
    pixels = jnp.stack([u, jnp.full(96, 47.5)], axis=-1)
    assert isinstance(world.microscope, optics.Microscope)
    wall = wall_pixels(pixels, microscope=world.microscope, surface=world.wall)
    cone = Cone(jnp.asarray(HALF_ANGLE), jnp.asarray(B), None, jnp.asarray(length))
    found = np.asarray(cone.irradiance(wall, tip=beam.tip, axis=beam.axis))
    # A wall point without spread sees I/(distance to the apex)^2 times the cosine, as the disc did.
    cosine = math.cos(HALF_ANGLE)
    offset = np.asarray(wall.point - beam.apex)
    even = -offset[:, 2] / np.linalg.norm(offset, axis=1) ** 3 / (2 * math.pi * (1 - cosine))
    x = np.asarray(wall.point)[:, 0]
    # A pixel's mean; it is nearly as wide as the smaller length.
    parts = 0.015 * (np.arange(10) - 4.5) / 10
    disc = [[lit_by_disc(abs(r) + 1e-9, (3.0 - B) / 20, length) for r in x + s] for s in parts]
    disc_mean = np.mean(disc, axis=0)
    # Sixteen lines a point, and 2 x 2 nodes for the mean over a pixel, 0.75 to 0.15 L
    # wide: 0.2 % to 0.02 % of the plateau, where the kernel's cusp is at the edge.
    np.testing.assert_allclose(found / even.max(), even / even.max() * disc_mean, atol=limit)


def test_the_image_of_a_lens_is_its_light_averaged_over_the_wall():
    x = np.linspace(0.0, 1.0, 65)
    bell = 1 / (1 + np.exp((x - 0.5) / 0.06))
    table = LensTable(
        values=jnp.tile(jnp.asarray(bell), (9, 1)),
        slopes=jnp.zeros((0, 9, 65)),
        transmitted_value=jnp.array(1.0),
        transmitted_slopes=jnp.zeros(0),
        at=jnp.zeros(0),
        moved=jnp.zeros(0),
        grid=Grid(jnp.array(0.5), jnp.array(0.2), jnp.array(0.5), jnp.array(8.0)),
    )
    world, length = World(scene()), 0.05
    beam = optics.beam_at_spot(
        world.wall, eccentricity=0.0, distance=2.0, incidence=0.5, half_angle=0.05, apex_offset=B
    )
    pixels = jnp.array([[47.5, 47.5], [59.0, 54.0], [69.0, 44.0], [79.0, 48.0]])
    assert isinstance(world.microscope, optics.Microscope)
    wall = wall_pixels(pixels, microscope=world.microscope, surface=world.wall)
    pose = {"tip": beam.tip, "axis": beam.axis}
    found = Lens(table, jnp.asarray(length)).irradiance(wall, **pose)
    total = np.zeros(len(pixels))
    ring, turn = np.meshgrid(radii(length, 100), np.arange(16) * (2 * np.pi / 16))
    asides = np.stack([ring * np.cos(turn), ring * np.sin(turn), 0 * ring], axis=-1).reshape(-1, 3)
    sharp = Lens(table)
    points = jnp.asarray(np.asarray(wall.point)[:, None] + asides).reshape(-1, 3)
    many = type(wall)(points, *(jnp.repeat(leaf, len(asides), axis=0) for leaf in wall[1:]))
    total = np.asarray(sharp.irradiance(many, **pose)).reshape(len(pixels), -1).mean(axis=1)
    # 100 rings by the midpoint rule end at 7.4 L; 4 x 8 nodes for a bell some L wide.
    np.testing.assert_allclose(found, total, atol=0.004 * float(total.max()))


@pytest.mark.slow  # a minute to render and fit
def test_the_fit_finds_the_length_and_the_cone(tmp_path: Path):
    settings = scene(phantom={"spread_mm": [0.06] * 3})
    stack: Stack = render_stack(settings, tmp_path / "stack")
    known: dict[str, Any] = {"source": "cone", "priors": {"touch": Prior(1.0, 1e-3)}}
    free = ("half_angle", "b", "spread")
    fit = calibration.fit_image(stack, start=START | {"spread": 0.03}, free=free, **known)
    assert fit.converged

    found, error = fit.parameters["spread"]
    assert abs(found - 0.06) < 3 * error
    assert error < 0.01 * 0.06
    # Errors of spots whose true cone is at 1 and 5 mm, by the fitted one; without the spread they
    # are 0.15 mm. Their standard errors follow from the covariance of half-angle and b.
    names = list(fit.parameters)
    own = [names.index(name) for name in ("half_angle", "b")]
    angle, b = fit.parameters["half_angle"][0], fit.parameters["b"][0]
    for distance in (1.0, 5.0):
        radius = (distance - B) / 20
        slopes = np.array([-radius / math.sin(angle) ** 2, 1.0])
        sigma = math.sqrt(slopes @ fit.covariance[np.ix_(own, own)] @ slopes)
        assert abs(radius / math.tan(angle) + b - distance) < 3 * sigma
        assert sigma < 0.02
