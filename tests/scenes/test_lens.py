"""The glue lens as an emitter: its table in Mitsuba, its light on the wall, its labels."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from skimage.measure import find_contours

from eyespot import optics
from eyespot.scenes import Renderer
from tests.support.drawn.scene_tables import BARE, scene_of
from tests.support.light.lens_quadrature import irradiance


@pytest.fixture(scope="module")
def renderer():
    lens = {
        "phantom": {"kind": "plane"},
        "source": {"kind": "lens", "lens": "dome", "power_mw": 2.0},
        "spot": {"eccentricity_mm": 2.0, "incidence_deg": 20.0},
        "motion": {"start_mm": 1.0, "travel_mm": 1.5, "frames": 2},
    }
    return Renderer(scene_of(BARE, lens))


def test_mitsuba_looks_the_table_up_as_optics_does(renderer):
    import mitsuba as mi

    rng = np.random.default_rng(0)
    distance, share, turn = np.exp(rng.uniform(-4.0, 3.0, 500)), *rng.uniform(0, 1, (2, 500))
    radius = share * np.asarray(renderer.world.table.envelope(distance))
    turn = 2 * np.pi * turn
    emitter = renderer.mitsuba_scene.emitters()[0]
    tip, axis = (
        np.asarray(a[0]) for a in (renderer.world.truth.beam.tip, renderer.world.truth.beam.axis)
    )
    renderer.render(0)
    first, second = (np.asarray(a) for a in optics.perpendicular_frame(axis))
    around = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    points = tip + distance[:, None] * axis + radius[:, None] * around
    vector = np.array(emitter.vector_irradiance(mi.Point3f(points.T.astype(np.float32)))).T
    lateral, axial = renderer.world.table(radius=radius, distance=distance)
    expected = 2.0 * (np.asarray(lateral)[:, None] * around + np.asarray(axial)[:, None] * axis)
    peak = np.linalg.norm(expected, axis=1).max()
    inside = share < 0.99  # a step at the envelope may fall on either side in float32
    # float32 places points to 1e-6 mm; the table's steepest cells change by 1e-3 of the peak
    # in 1e-5 mm of 0.01 mm.
    np.testing.assert_allclose(vector[inside], expected[inside], atol=1e-3 * peak)


def test_radiance_at_the_spot_is_that_of_the_vector_irradiance(renderer):
    frame = renderer.render(1)
    axial = irradiance(optics.load_lens("dome"), 1.0, 1e-6, 2.5)
    expected = 2.0 * axial * np.cos(np.radians(20.0)) * 0.5 / np.pi
    # Bilinear cells and the pixel's 0.0067 mm of a bell 0.5 mm wide: 1e-3.
    np.testing.assert_allclose(frame.radiance[240, 320], expected, rtol=2e-3)


def test_four_samples_make_no_image_sharper_than_hundreds_do(renderer):
    from eyespot.scenes.rendering.loaded_scene import pixel_means  # needs Mitsuba's variant

    def image(samples: int) -> np.ndarray:
        rows, columns = np.mgrid[120:360, 180:460]  # around the spot
        pixels = (640 * rows + columns).astype(np.uint32).ravel()
        radiance, _ = pixel_means(renderer.mitsuba_scene, samples=samples, smooth=True)(pixels)
        return radiance[:, 0].reshape(rows.shape)

    few, many = image(4), image(256)
    off, curved = few - many, ndimage.laplace(many)
    # Two even samples each way would lack (1 - 1/4) / 12 of the variance 1/12 px² of a pixel's
    # places, and so the fraction 1/96 px² of the light's curvature.
    assert abs(np.vdot(off, curved) / np.vdot(curved, curved)) < 0.1 / 96


def test_half_maximum_label_is_the_half_maximum_contour_of_the_pixels(renderer):
    for frame in range(2):
        image = renderer.render(frame).radiance[..., 0]
        contour = max(find_contours(image, image.max() / 2), key=len)[:-1, ::-1]
        found = optics.ellipse_of_contour(jnp.asarray(contour))
        truth = renderer.world.truth.half_max
        np.testing.assert_allclose(found.centre, truth.centre[frame], atol=0.05)
        np.testing.assert_allclose(found.semi_major, truth.semi_major[frame], atol=0.05)
        np.testing.assert_allclose(found.semi_minor, truth.semi_minor[frame], atol=0.05)
