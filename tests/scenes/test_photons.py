"""Photons through real glass: against closed forms, and the referee of the lens's table.

How `lens` and `photons` are compared: a pixel of `photons` is rendered with K = 16 seeds of
200 photons or more each, so that its mean over the seeds, less the pixel of `lens` (which has no
noise) and over its standard error, follows Student's t with 15 degrees of freedom if both say the
same. Two verdicts, each at the level ALPHA: no pixel lies beyond the t that ALPHA / pixels / 2
leaves above it (Bonferroni: finds a wrong place), and the pixels' t follow their distribution
(Kolmogorov and Smirnov: finds a small error everywhere). Nothing is scaled to fit.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.stats

from eyespot import optics
from eyespot.scenes import Renderer, Scene, load_mitsuba
from tests.support.drawn.made_up import a_lens
from tests.support.drawn.scene_tables import BARE, scene_of

SEEDS = 16
ALPHA = 1e-3
PHOTONS = 2_000_000


class Photons(NamedTuple):
    """Rays of the core's light behind the cap, n x 3, and which of them came out."""

    place: np.ndarray
    heading: np.ndarray
    out: np.ndarray


def photons_behind(lens: optics.GlueLens, medium_index: float) -> Photons:
    mi = load_mitsuba()
    from eyespot.scenes.rendering.photons import Glass

    numbers = mi.PCG32(PHOTONS)
    u = [numbers.next_float32() for _ in range(5)]
    glass = Glass(lens, medium_index=medium_index)
    ray, out = glass.sample_ray(u[0], mi.Point2f(u[1], u[2]), mi.Point2f(u[3], u[4]))
    return Photons(np.array(ray.o).T, np.array(ray.d).T, np.array(out))


def lateral(vectors: np.ndarray) -> np.ndarray:
    return np.hypot(vectors[:, 0], vectors[:, 1])


def scene(kind: str, **parts) -> Scene:
    """A uniform wall in the lens's direct light alone."""
    source = {"kind": kind, "lens": "dome", "photons_per_pixel": 512}
    window = {"width_px": 96, "height_px": 96, "samples": 64}
    plain = {"phantom": {"kind": "plane"}, "source": source, "microscope": window}
    return scene_of(BARE, plain, parts)


def withdrawal(distance: float) -> dict[str, Any]:
    return {"start_mm": distance, "travel_mm": 0.001, "frames": 1}


@pytest.mark.parametrize("medium_index", [1.0, 1.336])
def test_a_flat_end_lets_the_fresnel_integral_through(medium_index):
    lens = optics.load_lens("paper-candidate")
    photons = photons_behind(lens, medium_index)
    expected = float(optics.transmitted_power(lens, medium_index=medium_index))
    # What the flat cap reflects meets the core: each photon is one binomial try. 4 sigma.
    leeway = 4 * np.sqrt(expected * (1 - expected) / PHOTONS)
    assert abs(np.mean(photons.out) - expected) < leeway


@pytest.mark.parametrize("medium_index", [1.0, 1.336])
def test_light_that_the_dome_reflects_hardly_comes_out_at_a_later_try(medium_index):
    lens = optics.load_lens("dome")
    photons = photons_behind(lens, medium_index)
    first_try = float(optics.transmitted_power(lens, medium_index=medium_index))
    forward = photons.out & (photons.heading[:, 2] > 0)
    # The 0.5 % of the power, in all directions and in those that reach the retina.
    assert first_try < np.mean(photons.out) < 1.005 * first_try
    assert abs(np.mean(forward) / first_try - 1) < 0.005


def test_light_behind_a_flat_end_fills_the_numerical_aperture_evenly():
    lens = a_lens(core_radius=0.2, glue_length=0.0, sag=0.0, numerical_aperture=0.1)
    photons = photons_behind(lens, 1.336)
    sine, place = (lateral(v)[photons.out] for v in (photons.heading, photons.place))
    # Snell: n0 sin = NA at the edge, float32. Uniform over two discs: mean squares of a half; a
    # disc's squared radius scatters by 1/sqrt(12) of its largest; 4 sigma.
    assert np.max(sine) == pytest.approx(0.1 / 1.336, rel=1e-3)
    assert np.max(place) == pytest.approx(0.2, rel=1e-3)
    leeway = 4 / np.sqrt(12 * photons.out.sum())
    assert abs(np.mean((sine * 1.336 / 0.1) ** 2) - 0.5) < leeway
    assert abs(np.mean((place / 0.2) ** 2) - 0.5) < leeway


def test_a_gaussian_launch_keeps_its_waist():
    flat = {"glue_length": 0.0, "sag": 0.0, "glue_index": 1.336001, "numerical_aperture": 0.4}
    lens = a_lens(launch_radius=0.08, launch_aperture=0.1, **flat)
    photons = photons_behind(lens, 1.336)
    sine, place = lateral(photons.heading), lateral(photons.place)
    # exp(-2 p^2/w^2): the squares are exponential with mean w^2/2, cut at 2.6 waists (1e-6).
    leeway = 5 / np.sqrt(PHOTONS)
    assert np.mean(np.square(place)) == pytest.approx(0.08**2 / 2, rel=leeway + 1e-4)
    assert np.mean(np.square(sine * 1.336)) == pytest.approx(0.1**2 / 2, rel=leeway + 1e-4)


def seen_at(distance: float, scale_mm_px: float, medium: str = "air", **microscope) -> dict:
    """Tables of a frame at a distance, mm."""
    return {
        "source": {"medium": medium},
        "motion": withdrawal(distance),
        "microscope": {"scale_mm_px": scale_mm_px, **microscope},
    }


EYEBALL = {"phantom": {"kind": "eyeball"}}
ASIDE = {"spot": {"eccentricity_mm": 2.0}}
DISTORTION = [-0.4, 0.1, 0.05, 0.04, -0.2]
THIN_LENS = {"numerical_aperture": 0.1, "focus_mm": 2.0, "samples": 4096}
CASES: dict[str, dict[str, Any]] = {
    "dome, air, 0.5 mm": seen_at(0.5, 0.02),
    "dome, vitreous, 6 mm": seen_at(6.0, 0.04, "vitreous"),
    "flat end, air, 6 mm, eyeball, instrument, microscope above the eye": {
        **seen_at(6.0, 0.03, pinhole_height_mm=200.0),
        **EYEBALL,
        **ASIDE,
        "source": {"lens": "paper-candidate"},
        "instrument": {"visible": True},
    },
    "dome, air, 6 mm, a lens that distorts and darkens": {
        **seen_at(6.0, 0.06, vignetting=0.4, distortion=DISTORTION),
        "spot": {"eccentricity_mm": 4.0},
    },
    "dome, vitreous, 0.5 mm, eyeball, a thin lens in focus 2 mm above the wall": {
        **seen_at(0.5, 0.02, "vitreous", **THIN_LENS),
        **EYEBALL,
        **ASIDE,
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_lens_and_photons_agree_pixel_by_pixel(case):
    load_mitsuba()
    from eyespot.scenes.rendering.photons import photon_image

    expected = Renderer(scene("lens", **CASES[case])).render(0)
    photons = Renderer(scene("photons", **CASES[case]))
    photons.render(0)
    per_pixel = photons.scene.source.photons_per_pixel
    images = np.stack(
        [
            photon_image(photons.mitsuba_scene, photons_per_pixel=per_pixel, seed=seed)[..., 0]
            for seed in range(SEEDS)
        ]
    )
    radiance = expected.radiance[..., 0].astype(float)
    # Photons in a pixel and seed, were all of them in the window: 200 make a sum near normal.
    # Pixels that an edge of the instrument cuts are left out: `lens` has 64 points in them.
    lit = radiance / radiance.sum() * radiance.size * per_pixel > 200
    lit &= expected.wall > 0.999
    assert lit.sum() > 500
    error = images.std(axis=0, ddof=1)[lit] / np.sqrt(SEEDS)
    t = (images.mean(axis=0) - radiance)[lit] / error
    student = scipy.stats.t(SEEDS - 1)
    worst = np.abs(t).max()
    assert worst < student.isf(ALPHA / t.size / 2), f"largest |t| {worst:.2f} of {t.size} pixels"
    fit = scipy.stats.kstest(t, student.cdf)
    assert fit.pvalue > ALPHA, f"p = {fit.pvalue:.2g}, mean t {t.mean():+.3f}"
