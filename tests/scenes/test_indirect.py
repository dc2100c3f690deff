"""Light from wall to wall, traced: against the integrating sphere and Mitsuba's path tracer."""

from typing import Any

import numpy as np
import pytest
import scipy.stats

from eyespot import optics
from eyespot.scenes import Renderer, Scene, load_mitsuba
from tests.support.drawn.scene_tables import BARE, scene_of


def scene(**parts) -> Scene:
    """A uniform sphere in the light of one source, its own reflections traced."""
    window = {"width_px": 96, "height_px": 96, "scale_mm_px": 0.05, "samples": 16}
    motion = {"start_mm": 0.5, "travel_mm": 5.5, "frames": 2}
    traced = {"indirect": "traced"}
    return scene_of(BARE, {"phantom": traced, "microscope": window, "motion": motion}, parts)


def indirect_radiance(renderer: Renderer, frame: int) -> np.ndarray:
    """What the integrator adds to the direct light, H x W x 3."""
    mi = load_mitsuba()
    from eyespot.scenes.rendering import build

    renderer.render(frame)
    content = build.mitsuba_dict(renderer.world, uniform=np.zeros(3))
    integrator = mi.load_dict({**content["integrator"], "direct": False})
    return np.array(mi.render(renderer.mitsuba_scene, integrator=integrator, seed=1))[..., :3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "reflectance"), [("cone", 0.2), ("cone", 0.8), ("lens", 0.5), ("photons", 0.5)]
)
def test_traced_light_in_a_uniform_sphere_is_that_of_the_integrating_sphere(kind, reflectance):
    settings = scene(
        phantom={"reflectance": reflectance}, source={"kind": kind, "medium": "vitreous"}
    )
    renderer = Renderer(settings)
    flux = 1.0
    if kind != "cone":
        lens = optics.load_lens(settings.source.lens)
        flux = float(optics.transmitted_power(lens, medium_index=1.336))
    expected = reflectance / np.pi * reflectance * flux / (4 * np.pi * 11.5**2 * (1 - reflectance))
    for frame in range(2):
        found = indirect_radiance(renderer, frame)
        # The 0.5 %; 0.1 % of it is in the reflections that are left out. The same on both
        # halves of the window: in the spot and beside it.
        for part in (found[32:64, 32:64], found[:, :32]):
            assert np.mean(part) == pytest.approx(expected, rel=5e-3)


@pytest.mark.slow
def test_light_that_leaves_through_the_pupil_is_missing_by_the_closed_form():
    phantom = {"reflectance": 0.6, "pupil_radius_mm": 3.0}
    renderer = Renderer(scene(phantom=phantom))
    closed_form = Renderer(scene(phantom={**phantom, "indirect": "closed form"})).render(0)
    expected = closed_form.radiance[:, :32].mean()
    found = indirect_radiance(renderer, 0)[:, :32]
    assert found.mean() == pytest.approx(expected, rel=5e-3)
    # An independent estimate: 2.5 % less than in the closed eye.
    closed_eye = 0.6 / np.pi * 0.6 / (4 * np.pi * 11.5**2 * 0.4)
    assert expected / closed_eye == pytest.approx(0.975, abs=5e-4)


@pytest.mark.slow
def test_traced_light_is_what_the_path_tracer_finds_slowly():
    # An instrument and a picture on the wall, where no closed form holds. The path tracer meets
    # the spot by chance; a wide one, so that its noise is near normal.
    mi = load_mitsuba()
    settings = scene(
        phantom={"wall": "retina"},
        source={"cone_k": 2.0, "cone_apex_offset_mm": -0.3},
        motion={"start_mm": 2.0, "travel_mm": 0.001, "frames": 1},
        instrument={"visible": True},
    )
    renderer = Renderer(settings)
    ours = indirect_radiance(renderer, 0)
    blocks = []
    for depth in (2, 12):  # the reflectance of the retina is below 0.5: 0.1 % lies beyond
        path = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 100})
        blocks.append(
            [
                mean_of_blocks(
                    mi.render(renderer.mitsuba_scene, integrator=path, spp=256, seed=seed)
                )
                for seed in range(16)
            ]
        )
    theirs = np.array(blocks[1]) - np.array(blocks[0])
    error = theirs.std(axis=0, ddof=1) / 4
    t = (theirs.mean(axis=0) - mean_of_blocks(ours)) / error
    # Student's t with 15 degrees of freedom, one block of 48 too far off in 1000 such tests.
    assert np.abs(t).max() < scipy.stats.t(15).isf(1e-3 / t.size / 2)
    assert np.max(error / theirs.mean(axis=0)) < 0.02


def mean_of_blocks(image: Any) -> np.ndarray:
    """Means of 4 x 4 parts of an image, channels apart."""
    return np.array(image)[..., :3].reshape(4, 24, 4, 24, 3).mean(axis=(1, 3)).ravel()
