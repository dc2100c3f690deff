"""The pixel fit on a wall that spreads light: its image is a spread disc, its fit finds L."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from eyespot import calibration
from eyespot.calibration.pixels.data import POSE
from eyespot.calibration.pixels.light import Cells, Light
from eyespot.calibration.spots.cone_trials import Prior
from eyespot.formats.stack import Stack
from eyespot.optics.wall_light.lens_flux import Grid, LensTable
from eyespot.scenes import Scene, render_stack
from tests.support.drawn.made_up import a_footage, a_lens_table, a_microscope
from tests.support.drawn.scene_tables import scene_of
from tests.support.light.spread_disc import lit_by_disc, radii

pytestmark = pytest.mark.usefixtures("fast_compilation")

HALF_ANGLE, B = math.atan(1 / 20), -5.117
START = {"half_angle": 0.055, "b": -4.5}


def scene(**tables: Any) -> Scene:
    """A withdrawal from an even plane, in frames of 96 x 96."""
    settings = {
        "phantom": {"wall": "uniform", "kind": "plane", "spread": "own"},
        "source": {"kind": "cone"},
        "spot": {"incidence_deg": 0.0},
        "motion": {"start_mm": 1.0, "travel_mm": 4.0, "frames": 4},
        "instrument": {"visible": False},
        "microscope": {"width_px": 96, "height_px": 96, "scale_mm_px": 0.015, "samples": 16},
        "exposures": {"kinds": ["metered"]},
    }
    return scene_of(settings, tables)


def of_one_frame(length: float, *, radius_px: float, table: LensTable | None) -> np.ndarray:
    """Irradiance of a plane 3 mm before the tip, square to the beam, rows x columns of cells."""
    microscope = a_microscope(
        width_px=48, height_px=48, scale_mm_px=0.015, principal_point_px=(47.5, 47.5)
    )
    down = np.array([0.0, 0.0, -1.0])
    footage = a_footage(
        microscope=microscope, readings=np.zeros(1), exposure_s=np.ones(1), motion=down, axis=down
    )
    lens: Any = None
    if table is not None:
        lens = SimpleNamespace(
            at=lambda values: table,
            reach_mm=lambda distance: 2.0,
            slopes=lambda values: np.zeros((0, 0)),
            tables=1,
            where=(),
        )
    cells = Cells.over((96, 96), max(1, round(radius_px / 16)), beyond=True)
    values = dict.fromkeys(POSE, 0.0) | {"half_angle": HALF_ANGLE, "b": B, "spread": length}
    values |= {"touch": 3.0, "u": 47.5, "v": 47.5, "scale": 0.015, "eye_radius": 11.5}
    values |= {"sensitivity": 1.0, "power": 1.0, "reflectance": 0.5, "illumination": 0.0}
    values["inverse_working_distance"] = microscope.inverse_working_distance
    light = Light(footage, cells, (), lens)
    found = light.frames(values, np.zeros((1, 7)), [0], slopes=False)
    assert found is not None
    frame = found[0]
    seen = np.zeros(cells.along**2)
    seen[frame.cells] = frame.direct * math.pi / 0.5
    return seen.reshape(cells.along, cells.along)[16:-16, 16:-16]


@pytest.mark.parametrize("length", [0.02, 0.05, 0.1])
def test_the_image_of_a_cone_is_a_spread_disc(length):
    radius = (3.0 - B) / 20
    found = of_one_frame(length, radius_px=radius / 0.015, table=None)
    side = 2  # px, of cells of a sixteenth of the spot's radius
    # One row of cells, in which the middle of the spot lies half a cell higher.
    at = side * (np.arange(found.shape[0]) + 0.5) - 0.5 - 47.5
    row = int(np.argmin(np.abs(at)))
    parts = side * (np.arange(8) - 3.5) / 8
    x, y = 0.015 * (at[:, None] + parts), 0.015 * (at[row] + parts)
    apart = np.hypot(x[:, :, None], y)
    disc = np.vectorize(lambda r: lit_by_disc(r + 1e-9, radius, length))(apart)
    # A wall point without spread sees I/(distance to the apex)^2 times the cosine, as the disc did.
    far = np.hypot(apart, 3.0 - B)
    even = (3.0 - B) / far**3 / (2 * math.pi * (1 - math.cos(HALF_ANGLE)))
    expected = (even * disc).mean(axis=(1, 2))
    # Light spreads between means of cells, 1.5 to 0.3 L wide, which show edges less than sharply.
    np.testing.assert_allclose(found[row] / even.max(), expected / even.max(), atol=0.012)
    assert np.sqrt(np.mean((found[row] - expected) ** 2)) < 0.004 * even.max()


@pytest.mark.slow
def test_the_image_of_a_lens_is_its_light_averaged_over_the_wall():
    x = np.linspace(0.0, 1.0, 65)
    bell = 1 / (1 + np.exp((x - 0.5) / 0.06))
    table = a_lens_table(np.tile(bell, (9, 1)), Grid(*map(jnp.asarray, (0.5, 0.2, 0.5, 8.0))))
    length = 0.05
    found, sharp = (of_one_frame(own, radius_px=36.0, table=table) for own in (length, 1e-9))
    # The kernel's rings, on the image without spread between its cells.
    ring, turn = np.meshgrid(radii(length, 100), np.arange(16) * (2 * np.pi / 16))
    rows, columns = np.mgrid[: found.shape[0], : found.shape[1]]
    total = np.zeros(found.shape)
    for right, down in zip(
        (ring * np.cos(turn)).ravel(), (ring * np.sin(turn)).ravel(), strict=True
    ):
        at = np.stack([rows + down / 0.03, columns + right / 0.03])
        total += ndimage.map_coordinates(sharp, at, order=3, mode="nearest") / ring.size
    inside = np.hypot(rows - 23.5, columns - 23.5) < 18
    # 100 rings by the midpoint rule end at 7.4 L.
    np.testing.assert_allclose(found[inside], total[inside], atol=0.004 * float(total.max()))


@pytest.mark.slow  # a minute to render and fit
def test_the_fit_finds_the_length_and_the_cone(tmp_path: Path):
    settings = scene(phantom={"spread_mm": [0.06] * 3})
    stack: Stack = render_stack(settings, tmp_path / "stack")
    known: dict[str, Any] = {"source": "cone", "priors": {"touch": Prior(1.0, 1e-3)}}
    free = ("half_angle", "b", "spread")
    fit = calibration.fit_image(
        calibration.footage_of(stack), start=START | {"spread": 0.03}, free=free, **known
    )
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
