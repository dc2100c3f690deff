"""Photon images and their derivatives: against differences, `optics` and Mitsuba's own glass.

What float32 and the kinks of the pixel's spline leave of a central difference: photons move by h
times their speed. Rounding of their places, some 4e-6 px, is divided by it; of the spline's second
derivative, which jumps, only the part of photons that cross a jump is wrong, by as much as they
move. With moves of 0.005 to 0.05 px both stay below 0.5 % of the derivative's image; STEP has them.
"""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
import tomli_w

from eyespot import optics
from eyespot.calibration.bridge import FLOAT32_LEVENBERG_MARQUARDT, render_as_jax
from eyespot.calibration.least_squares import least_squares
from eyespot.scenes import Scene, World, load_mitsuba
from eyespot.scenes.world.world import LensLight
from tests.support.drawn.made_up import DOME
from tests.support.drawn.scene_tables import BARE, scene_of

ALPHA = 1e-3
STEP = {
    "core_radius": 1e-4,
    "glue_length": 1e-3,
    "aperture_radius": 1e-4,
    "sag": 4e-5,
    "glue_index": 1.5e-4,
    "numerical_aperture": 2e-4,
    "tip_x": 3e-4,
    "tip_y": 3e-4,
    "tip_z": 1e-3,
    "axis_x": 2e-4,
    "axis_y": 2e-4,
    "axis_z": 2e-3,
    "power": 1e-2,
}

# The core's face lies so deep that both the core and the rim cut the light.
DEEP_DOME = {**DOME, "glue_length": 0.2}
LAUNCHED = {**DEEP_DOME, "glue_length": 0.5, "launch_radius": 0.15, "launch_aperture": 0.12}


def scene(lens: dict[str, float], folder: Path, **parts: Any) -> Scene:
    path = folder / "lens.toml"
    path.write_text(tomli_w.dumps({"schema": 1, "lens": lens}))
    window = {"width_px": 64, "height_px": 48, "scale_mm_px": 0.04}
    source = {"kind": "photons", "lens": str(path), "medium": "vitreous"}
    motion = {"start_mm": 3.0, "travel_mm": 0.001, "frames": 1}
    return scene_of(BARE, {"microscope": window, "source": source, "motion": motion}, parts)


PLANE = {"kind": "plane"}
SQUARE = {"incidence_deg": 0.0}


def photon_image(scene: Scene, **settings: Any):
    load_mitsuba()
    from eyespot.scenes.rendering.differentiable import PhotonImage

    return PhotonImage(scene, **{"photons": 1 << 17, **settings})


CASES: dict[str, tuple[dict[str, float], dict[str, Any], tuple[str, ...]]] = {
    "dome in air, with total reflection, on a plane": (
        DEEP_DOME,
        {"source": {"medium": "air"}, "phantom": PLANE},
        ("sag", "glue_index", "tip_z"),
    ),
    "light that core and rim cut, in vitreous, in the eye": (
        LAUNCHED,
        {"spot": {"eccentricity_mm": 2.0}},
        ("glue_length", "numerical_aperture", "axis_x", "power"),
    ),
}
ALL_FREE: dict[str, tuple[dict[str, float], dict[str, Any], tuple[str, ...]]] = {
    f"{name}, all": (lens, parts, tuple(STEP)) for name, (lens, parts, _) in CASES.items()
} | {
    "a flat end's index, a microscope that distorts": (
        {**DEEP_DOME, "sag": 0.0},
        {"microscope": {"distortion": [-0.4, 0.1, 0.05, 0.04, -0.2], "vignetting": 0.4}},
        ("glue_index", "numerical_aperture", "tip_x", "axis_z"),
    )
}


@pytest.mark.parametrize(
    "case", [*CASES, *(pytest.param(name, marks=pytest.mark.slow) for name in ALL_FREE)]
)
def test_derivatives_are_central_differences(case, tmp_path):
    lens, parts, free = {**CASES, **ALL_FREE}[case]
    # Few photons are where one edge takes over from another, and they tell the two apart most. Of
    # parameters that hardly matter otherwise it takes more photons, and 4 x 4 pixels together.
    photons, side = (1 << 17, 1) if case in CASES else (1 << 19, 4)
    image = photon_image(scene(lens, tmp_path, **parts), free=free, photons=photons)
    value, jacobian = image.value_and_jacobian(image.start)
    # Other kernels, the same photons. Threads add the n photons of the brightest pixel in any
    # order; each addition rounds 2^-24 of the sum so far, whose mean square is a third of the
    # whole's. So two sums differ by 2^-24 sqrt(2 n / 3); five times that.
    most = photons * value[..., 0].max() / value[..., 0].sum()
    unlike = 5 * 2**-24 * np.sqrt(2 * most / 3) * value.max()
    np.testing.assert_allclose(value, image.value(image.start), atol=unlike)
    for name, column, direction in zip(
        free, np.moveaxis(jacobian, -1, 0), np.eye(len(free)), strict=True
    ):
        step = STEP[name] * direction
        difference = image.value(image.start + step) - image.value(image.start - step)
        difference /= 2 * STEP[name]
        rounding = 2**-24 * np.linalg.norm(blocks(value, side)) / STEP[name]
        error = np.linalg.norm(blocks(column - difference, side))
        size = np.linalg.norm(blocks(difference, side))
        assert error < 0.01 * size + rounding, f"{name}: {error:.3g} of {size:.3g}"


def blocks(image, side):
    height, width, channels = image.shape
    return image.reshape(height // side, side, width // side, side, channels).sum(axis=(1, 3))


def test_reverse_mode_is_forward_mode_transposed(tmp_path):
    image = photon_image(scene(DEEP_DOME, tmp_path), free=("sag", "tip_z"))
    weight = np.random.default_rng(0).normal(size=image.shape)
    _, jacobian = image.value_and_jacobian(image.start)
    forward = np.einsum("ijc,ijcp->p", weight, jacobian)
    # Sums of 1e4 terms of both signs in float32, each rounded to 6e-8.
    scale = np.linalg.norm(weight) * np.linalg.norm(jacobian.reshape(-1, 2), axis=0)
    assert np.all(np.abs(image.vjp(image.start, weight) - forward) < 1e-4 * scale)


def test_an_image_is_rendered_without_jax(tmp_path):
    image = photon_image(scene(DEEP_DOME, tmp_path), free=("sag", "tip_z"), photons=4096)
    with jax.no_execution(True):
        value = image.value(image.start)
        image.value_and_jacobian(image.start)
        image.vjp(image.start, value)


def test_the_light_in_the_image_is_what_leaves_the_cap(tmp_path):
    # All of it falls in a window of 19 x 14 mm, seen telecentrically, and square to the wall.
    wide = scene(
        DEEP_DOME,
        tmp_path,
        phantom=PLANE,
        spot=SQUARE,
        microscope={"scale_mm_px": 0.3, "pinhole_height_mm": float("inf")},
    )
    free, seeds = ("glue_length", "sag", "glue_index"), 8
    to_power = np.pi / 0.5 * 0.3**2
    found = []
    for seed in range(seeds):
        image = photon_image(wide, free=free, photons=1 << 16, seed=seed)
        value, jacobian = image.value_and_jacobian(image.start)
        slopes = jacobian[..., 0, :].sum(axis=(0, 1))
        found.append(to_power * np.array([value[..., 0].sum(), *slopes]))

    def power(name, step):
        lens = optics.glue_lens(**{**DEEP_DOME, name: DEEP_DOME[name] + step})
        return float(optics.transmitted_power(lens, medium_index=1.336))

    expected = np.array(
        [power("sag", 0), *((power(n, 1e-4) - power(n, -1e-4)) / 2e-4 for n in free)]
    )
    error = np.std(found, axis=0, ddof=1) / np.sqrt(seeds)
    off = np.mean(found, axis=0) - expected
    chance = error * scipy.stats.t(seeds - 1).isf(ALPHA / off.size / 2)
    # Four times the quadrature's nodes move its slopes by up to 7e-4; float32 loses some 1e-6.
    assert np.all(np.abs(off) < chance + [1e-5, *3 * [1e-3]] * np.abs(expected)), off / expected


@pytest.mark.slow
@pytest.mark.parametrize("medium", ["air", "vitreous"])
def test_images_are_those_of_mitsuba_s_own_glass(medium, tmp_path):
    """Blocks of pixels by Welch's t over seeds; nothing is scaled to fit."""
    load_mitsuba()
    import mitsuba as mi

    from eyespot.scenes.rendering.build import mitsuba_dict
    from eyespot.scenes.rendering.loaded_scene import pose_values
    from eyespot.scenes.rendering.photons import photon_image as by_particles

    parts = {"spot": {"eccentricity_mm": 2.0}, "source": {"medium": medium}}
    inside = scene(DEEP_DOME, tmp_path, **parts)
    seeds, per_pixel = 16, 64
    world = World(inside)
    # Photons do not use the table, which would take half a minute to compute.
    cells, nothing = jnp.zeros((2, 2, 2)), jnp.zeros(())
    index = nothing + optics.MEDIA[medium]
    world.light = LensLight(optics.IrradianceTable(cells, index, nothing, nothing), 1.0)
    loaded = mi.load_dict(mitsuba_dict(world, uniform=np.zeros(3)))
    (placed,) = pose_values(inside, world.motion.at(world.times[:1]))
    mi.traverse(loaded).update(placed)
    traced = [
        by_particles(loaded, photons_per_pixel=per_pixel, seed=seed)[..., 0]
        for seed in range(seeds)
    ]
    glass = np.stack(traced)
    ours = []
    for seed in range(seeds):
        image = photon_image(inside, free=(), photons=per_pixel * 64 * 48, seed=seed)
        ours.append(image.value(image.start)[..., 0])
    # Box pixels become those of the quadratic spline, boxes blurred by a tent: the kernel has the
    # tent's second moment, 1/6 px², which is enough where light is smooth over a pixel.
    for axis in (-2, -1):
        glass = (10 * glass + np.roll(glass, 1, axis) + np.roll(glass, -1, axis)) / 12
    sums = [x.reshape(seeds, 12, 4, 16, 4).sum(axis=(2, 4)) for x in (glass, np.array(ours))]
    lit = sums[0].mean(axis=0) > 0.01 * sums[0].mean(axis=0).max()
    assert lit.sum() > 30
    p = scipy.stats.ttest_ind(*sums, axis=0, equal_var=False).pvalue[lit]
    assert p.min() > ALPHA / p.size
    assert scipy.stats.kstest(p, "uniform").pvalue > ALPHA


@pytest.mark.parametrize(
    ("parts", "free", "said"),
    [
        ({"instrument": {"visible": True}}, "sag", "instrument.visible = true .*up to 20 %"),
        ({"second_tool": {"visible": True}}, "sag", "second_tool.visible = true .*up to 20 %"),
        ({"source": {"kind": "cone"}}, "sag", "'cone' has no lens"),
        ({}, "sagg", r"does not know sagg. Choose from core_radius, .*power"),
    ],
)
def test_what_photons_cannot_show_is_refused(parts, free, said, tmp_path):
    with pytest.raises(ValueError, match=said):
        photon_image(scene(DEEP_DOME, tmp_path, **parts), free=(free,))


def test_parameters_that_make_no_lens_are_refused(tmp_path):
    image = photon_image(scene(DEEP_DOME, tmp_path), free=("sag",))
    with pytest.raises(ValueError, match=r"sag must lie in \[0, 0.2\]; got 0.3"):
        image.value(np.array([0.3]))


def bridged(image):
    return render_as_jax(image.value, image.value_and_jacobian, shape=image.shape)


def test_mitsuba_behind_the_bridge_comes_back_from_every_call(tmp_path):
    image = photon_image(scene(DEEP_DOME, tmp_path), free=("sag", "tip_z"), photons=4096)
    function = bridged(image)
    both = jax.jit(jax.value_and_grad(lambda p: jnp.sum(function(p) ** 2)))
    start = jnp.asarray(image.start)
    calls = 50
    for number in range(calls):
        loss, gradient = both(start + 1e-6 * number)
    last = np.asarray(start + 1e-6 * (calls - 1))
    value = image.value(last)
    # Float32 of some 100 photons a pixel, added in any order.
    np.testing.assert_allclose(loss, np.sum(value**2), rtol=1e-5)
    np.testing.assert_allclose(gradient, image.vjp(last, 2 * value), rtol=1e-3)


@pytest.mark.slow
def test_a_lens_is_found_in_another_seed_s_image(tmp_path):
    free = ("sag", "numerical_aperture", "tip_z")
    still = scene(DEEP_DOME, tmp_path)
    model = photon_image(still, free=free, seed=1000)
    seeds = 8
    data = np.stack(
        [
            photon_image(still, free=free, seed=seed).value(model.start)[..., 0]
            for seed in range(seeds)
        ]
    )
    mean = data.mean(axis=0)
    noise = data - mean
    per_light = np.sum(noise**2) / (seeds - 1) / mean.sum()
    sigma = np.sqrt(per_light * np.maximum(mean, 0.01 * mean.max()))
    function = bridged(model)

    def residual(parameters):
        return ((function(parameters)[..., 0] - data[0]) / sigma).ravel()

    start = jnp.asarray(model.start) + jnp.array([-0.02, 0.04, 0.1])
    solution = least_squares(residual, start, count=mean.size, solver=FLOAT32_LEVENBERG_MARQUARDT)
    assert bool(solution.converged)
    # What the other seeds' noise would do to the parameters; twice, as the model has as much.
    jacobian = np.asarray(jax.jacfwd(residual)(solution.parameters))
    shifts = np.linalg.lstsq(jacobian, (noise / sigma).reshape(seeds, -1).T, rcond=None)[0]
    spread = np.sqrt(2 * np.sum(shifts**2, axis=1) / (seeds - 1))
    # Three sigma of a normal error, whose sigma is known from 7 degrees of freedom.
    leeway = scipy.stats.t(seeds - 1).isf(scipy.stats.norm.sf(3))
    assert np.all(np.abs(np.asarray(solution.parameters) - model.start) < leeway * spread)
