"""Viewing paths against Mitsuba, which traces the same eye as real dielectric surfaces."""

import numpy as np
import pytest
from scipy import ndimage

from eyespot.optics import viewing
from tests.support.drawn.scene_tables import BARE, scene_of

pytestmark = pytest.mark.usefixtures("fast_compilation")

WIDTH, HEIGHT, SCALE = 96, 72, 0.08
RADIUS, REFLECTANCE = 12.0, 1e-3  # so dark that the wall does not light itself
SEEDS, SPP = 16, 16


@pytest.fixture(scope="module")
def glass():
    from eyespot.scenes import load_mitsuba

    load_mitsuba("llvm_ad_rgb")
    from tests.support.light import mitsuba_glass

    return mitsuba_glass


def flat_lens(form):
    return viewing.viewing_path(
        viewing.load_eye("navarro", wavelength_nm=543.0),
        viewing.load_viewing_lens("flat"),
        form=form,
        pupil_radius=50.0,
        pinhole_distance=203.0,
    )


def cone_scene(form):
    """An even, dark retina that a cone lights, seen through the same lens and eye."""
    window = {"width_px": WIDTH, "height_px": HEIGHT, "scale_mm_px": SCALE, "samples": 400}
    # 203 mm above the cornea's vertex, as in `flat_lens`.
    height = {"pinhole_height_mm": 203.0 + 23.9203 - RADIUS}
    dark = {
        "phantom": {"reflectance": REFLECTANCE},
        "source": {"medium": "vitreous", "cone_k": 3.0},
        "spot": {"eccentricity_mm": 1.0, "azimuth_deg": 30.0, "incidence_deg": 20.0},
        "motion": {"start_mm": 2.0, "travel_mm": 1.0, "frames": 1},
        "microscope": window | height,
        "viewing": {"eye": "navarro", "lens": "flat", "form": form, "pupil_mm": 100.0},
    }
    return scene_of(BARE, dark, {"viewing": {"wavelengths_nm": [543.0] * 3}})


def seen_through(glass, path, camera, spp):
    """A dark retina behind the path's surfaces, its camera and the integrator."""
    retina = viewing.Conic(depth=0.0, curvature=-1.0 / RADIUS)
    matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": REFLECTANCE}}
    return {
        "integrator": {"type": "path", "max_depth": 12, "rr_depth": 100},
        "wall": glass.conic_mesh(retina, edge=9.0, vertex=glass.retinal_pole(path), bsdf=matt),
        "sensor": glass.outside_camera(path, camera, width=WIDTH, height=HEIGHT, spp=spp),
        **glass.surfaces(path),
    }


@pytest.mark.slow
@pytest.mark.parametrize("form", ["phakic", "aphakic"])
def test_a_rendered_frame_is_mitsubas_through_real_surfaces(glass, form):
    import mitsuba as mi

    from eyespot.scenes.rendering.build import mitsuba_dict
    from eyespot.scenes.rendering.render import Renderer

    renderer = Renderer(cone_scene(form))
    world, path = renderer.world, flat_lens(form)
    ours = renderer.render(0).radiance[..., 1]
    (tip,), (axis,) = world.motion.at(world.times[:1])
    content = mitsuba_dict(world, uniform=np.zeros(3))
    scene = mi.load_dict(content | seen_through(glass, path, world.microscope, 4 * SPP))
    parameters = mi.traverse(scene)
    parameters["source.tip"], parameters["source.axis"] = mi.Point3f(tip), mi.Vector3f(axis)
    parameters.update()
    images = np.array([np.array(mi.render(scene, seed=mi.UInt32(k)))[..., 1] for k in range(SEEDS)])
    # Ours is that in the eye's medium: a pencil widens as it enters air, so radiance falls with the
    # index squared (Nicodemus 1963).
    truth = ours / float(path.medium_index) ** 2
    inside = ndimage.binary_erosion(truth > 0.0, iterations=2)
    off = np.log(images.mean(axis=0) / np.where(inside, truth, 1.0))[inside]
    # Chance decides at each surface whether a ray is reflected, so the relative error is the same
    # in all pixels. A pixel's own estimate of it is skewed.
    scatter = images[:, inside].std(axis=0, ddof=1) / truth[inside]
    z = off / np.sqrt(np.mean(scatter**2) / SEEDS)
    # Over 2,500 pixels z has a mean of 0 +- 0.02 and a mean square of 1 +- 0.03.
    assert np.mean(z) == pytest.approx(0.0, abs=0.08)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.12)
    # On the edge our 20 x 20 samples err by 0.29/20 of a pixel, which averages out over 150 pixels.
    v, u = np.indices(truth.shape)
    for place in (u, v):
        theirs, centre = (np.sum(place * x) / np.sum(x) for x in (images.mean(axis=0), truth))
        assert theirs == pytest.approx(centre, abs=0.01)
