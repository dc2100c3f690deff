"""A coat on the matt wall: its reflection of the coaxial light, and when there is none."""

import math
from typing import Any

import numpy as np
import pytest

from eyespot import optics
from eyespot.scenes import Renderer, Scene
from tests.support.drawn.scene_tables import BARE, scene_of


def scene(coat: str, **parts: Any) -> Scene:
    """An even plane under a telecentric microscope, with a beam of no power."""
    window = {"scale_mm_px": 0.1, "width_px": 32, "height_px": 32}
    plain = {
        "phantom": {"kind": "plane", "coat": coat, "indirect": "closed form"},
        "source": {"power_mw": 1e-9},
        "motion": {"start_mm": 3.0, "travel_mm": 1.0, "frames": 1},
        "microscope": {"pinhole_height_mm": math.inf, "illumination_mw_mm2": 1.0} | window,
    }
    return scene_of(BARE, plain, parts)


def radiance(settings: Scene) -> float:
    return float(np.mean(Renderer(settings).render(0).radiance))


@pytest.mark.parametrize(
    ("coat", "index", "roughness"), [("wet", optics.MEDIA["water"], 0.05), ("glossy", 1.5, 0.2)]
)
def test_a_coat_on_black_reflects_coaxial_light_as_its_slopes_are_spread(coat, index, roughness):
    seen = radiance(scene(coat, phantom={"reflectance": 0.0}))
    # Facets square to the light send back Fresnel's part of it; Beckmann and Spizzichino (1963):
    # they are 1 / (pi roughness^2) of all per steradian, and a facet's normal turns half as much
    # as its light, so that the radiance of an irradiance of 1 is a quarter of that.
    fresnel = ((index - 1) / (index + 1)) ** 2
    assert seen == pytest.approx(fresnel / (4 * math.pi * roughness**2), rel=1e-3)


def test_a_wet_wall_under_water_is_a_matt_wall():
    matt, wet = (radiance(scene(coat, source={"medium": "water"})) for coat in ("none", "wet"))
    assert matt == pytest.approx(0.5 / math.pi, rel=1e-5)
    assert wet == pytest.approx(matt, rel=1e-4)


def test_what_a_coat_makes_approximate_is_said():
    coated = scene("wet", source={"kind": "lens", "power_mw": 1.0})
    assert "highlights" in coated.approximations[0]
    assert not scene("none").approximations
    assert not scene("glossy").approximations
    eye = scene("glossy", phantom={"kind": "eyeball"})
    assert "indirect light" in eye.approximations[0]
