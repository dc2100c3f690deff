"""Rendered frames against closed forms, labels and Mitsuba's own integrator."""

import math

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from eyespot.formats.inputs import InputError
from eyespot.formats.stack import read_stack
from eyespot.scenes import Renderer, Scene, load_mitsuba, render_image, render_stack, write_preview
from eyespot.scenes.sensor import after_jpeg
from eyespot.scenes.world.world import World
from tests.support.drawn.drawn_spots import spot_in
from tests.support.drawn.scene_tables import BARE, scene_of


def scene(**parts) -> Scene:
    """A uniform wall under the ideal cone's direct light alone, unless told otherwise."""
    return scene_of(BARE, {"motion": {"start_mm": 3.0, "travel_mm": 1.0, "frames": 2}}, parts)


# Brown's five, all at work: at c = 5 mm and z_F = 11.5 mm, 0.3 of the focal length from the axis,
# they move the image by 20 px and change its shape.
LENS = (-0.2, 0.3, 0.02, -0.03, 0.5)


@pytest.mark.parametrize(
    ("height", "distortion"),
    [
        (11.5, [0.0] * 5),
        (11.5, LENS),
        (200.0, [0.0] * 5),
        (float("inf"), [0.0] * 5),
        (-28.4, [0.0] * 5),  # behind the retina
    ],
)
@pytest.mark.parametrize("kind", ["eyeball", "plane"])
def test_mitsubas_camera_is_the_microscope_of_the_labels(kind, height, distortion):
    mi = load_mitsuba()
    from eyespot.scenes.rendering import build

    settings = scene(
        phantom={"kind": kind},
        spot={"eccentricity_mm": 4.0, "azimuth_deg": 50.0},
        microscope={"pinhole_height_mm": height, "distortion": distortion},
    )
    loaded = mi.load_dict(build.mitsuba_dict(World(settings), uniform=np.zeros(3)))
    pixels = np.array([[0.0, 0.0], [639.0, 0.0], [320.0, 240.0], [100.0, 479.0]])
    u, v = ((pixels + 0.5) / [640, 480]).T
    ray, _ = loaded.sensors()[0].sample_ray(
        0.0, 0.5, mi.Point2f(mi.Float(u), mi.Float(v)), mi.Point2f(0.5)
    )
    points = jnp.asarray(np.array(loaded.ray_intersect(ray).p).T)
    seen = np.asarray(World(settings).microscope.project(points))
    # float32 at 12 mm is 1e-6 mm = 1.5e-4 px; a few operations.
    np.testing.assert_allclose(seen, pixels, atol=2e-3)


def test_a_lit_pixel_has_the_closed_form_radiance():
    settings = scene(spot={"incidence_deg": 30.0}, phantom={"kind": "plane"})
    frame = Renderer(settings).render(0)
    # I/(distance to the apex)^2 * cos(incidence) * rho/pi, with I = P/(2 pi (1 - cos alpha)).
    cosine = 20 / np.sqrt(401)
    intensity = 1.0 / (2 * np.pi * (1 - cosine))
    expected = intensity / (3.0 + 5.117) ** 2 * np.cos(np.radians(30.0)) * 0.5 / np.pi
    # The middle pixel spans 0.0067 mm of 8 mm: 1e-3 of slope, averaged out; float32.
    np.testing.assert_allclose(frame.radiance[240, 320], expected, rtol=1e-3)


@pytest.mark.parametrize(
    ("kind", "distortion"), [("eyeball", [0.0] * 5), ("plane", [0.0] * 5), ("eyeball", LENS)]
)
def test_every_label_is_found_again_in_the_pixels(kind, distortion):
    settings = scene(
        phantom={"kind": kind},
        spot={"eccentricity_mm": 5.0, "azimuth_deg": 20.0, "incidence_azimuth_deg": 60.0},
        microscope={"samples": 64, "distortion": distortion},
    )
    renderer = Renderer(settings)
    for frame in range(2):
        image = renderer.render(frame).radiance
        spot = spot_in(image / image.max() * 0.8)
        truth = renderer.world.truth.cone
        axes = truth.semi_major[frame], truth.semi_minor[frame]
        np.testing.assert_allclose(spot.ellipse[:4], (*truth.centre[frame], *axes), atol=0.05)
        turn = math.remainder(spot.angle_rad - float(truth.angle[frame]), math.pi)
        # 0.05 px at the end of the semi-major axis, seen against the difference of the axes.
        leeway = 0.05 / float(truth.semi_major[frame] - truth.semi_minor[frame])
        assert abs(turn) < leeway


def test_the_integrator_agrees_with_mitsubas_path_tracer():
    mi = load_mitsuba()
    settings = scene(
        instrument={"visible": True},
        motion={"start_mm": 0.5, "frames": 1},
        phantom={"wall": "printed paper"},
    )
    renderer = Renderer(settings)
    ours = renderer.render(0).radiance
    path = mi.load_dict({"type": "path", "max_depth": 2})
    theirs = np.asarray(mi.render(renderer.mitsuba_scene, integrator=path, seed=1))[..., :3]
    # One point light: the same radiance at the same grid of samples, but for float32.
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-6 * ours.max())


def test_all_of_the_cones_power_lands_on_the_wall():
    settings = scene(
        phantom={"kind": "plane"}, spot={"incidence_deg": 0.0}, microscope={"samples": 16}
    )
    image = Renderer(settings).render(0).radiance[..., 0]
    flux = image.sum() * np.pi / 0.5 * 0.0067**2
    # 2,300 edge pixels each off by 1/16 at random: 3 pixels of 11,700.
    np.testing.assert_allclose(flux, 1.0, rtol=1e-3)


def test_the_instrument_hides_the_spot_that_the_labels_say_it_hides():
    settings = scene(instrument={"visible": True}, motion={"start_mm": "contact"})
    renderer = Renderer(settings)
    fractions = [renderer.render(frame).visible_fraction for frame in range(2)]
    assert fractions[0] < 0.75 < fractions[1]
    mask = renderer.mask(0, renderer.render(0))
    ellipse = renderer.world.truth.half_max
    whole = np.pi * float(ellipse.semi_major[0] * ellipse.semi_minor[0])
    assert mask.sum() < 0.7 * whole


def test_a_stack_holds_every_exposure_of_every_frame_and_its_checksums(tmp_path):
    settings = scene(microscope={"illumination_mw_mm2": 0.05})
    stack = render_stack(settings, tmp_path / "stack")
    stack.verify()
    assert [row.exposure for row in stack.labels] == ["paper", "metered"] * 2
    again = read_stack(tmp_path / "stack")
    assert again.labels == stack.labels
    metered = stack.exposed("metered")[0]
    image, mask = stack.image(metered), stack.mask(metered) > 0
    # 80 % of 255 at the peak; noise of 3 DN on top of it at the 99.9th percentile.
    assert 195 < np.percentile(image[mask], 95) < 215
    with pytest.raises(InputError, match="already exists"):
        render_stack(settings, tmp_path / "stack")


def test_an_image_without_a_stack_is_that_of_the_stack(tmp_path):
    settings = scene(
        microscope={"illumination_mw_mm2": 0.05},
        motion={"frames": 2, "speed_mm_s": 2.0},  # blurred
        camera={"jpeg_quality": 85},
    )
    stack = render_stack(settings, tmp_path / "stack")
    image = render_image(settings, frame=1, exposure="metered")
    assert np.array_equal(image, stack.image(stack.exposed("metered")[1]))
    with pytest.raises(InputError, match=r"frame = 2 is not in the scene: it has 0 to 1"):
        render_image(settings, frame=2)
    with pytest.raises(InputError, match=r"exposure = 'long' is none of the scene's: paper, met"):
        render_image(settings, exposure="long")


def test_a_stack_of_a_usb_camera_is_that_of_its_sensor_after_jpeg(tmp_path):
    def with_camera(**keys):
        return scene(
            camera={"bayer": "GRBG", "prnu": 0.01, "response": "srgb", **keys},
            motion={"frames": 1},
            exposures={"kinds": ["metered"], "keep_linear": True},
            microscope={"illumination_mw_mm2": 0.05},
        )

    sensor = render_stack(with_camera(), tmp_path / "sensor")
    usb = render_stack(with_camera(jpeg_quality=85), tmp_path / "usb")
    raw, sent = sensor.image(sensor.labels[0]), usb.image(usb.labels[0])
    assert np.array_equal(after_jpeg(raw, quality=85), sent)
    # Clipping happens in the sensor; JPEG smears clipped pixels below full scale.
    assert sensor.labels[0].saturated_fraction == usb.labels[0].saturated_fraction


def test_the_preview_is_the_middle_frame_in_half_of_its_size(tmp_path):
    settings = scene(
        motion={"start_mm": 1.0, "travel_mm": 4.0, "frames": 3},
        microscope={"illumination_mw_mm2": 0.05, "width_px": 656, "height_px": 488},
        camera={"full_well_e": 1e12},  # noise of 1e-6
    )
    write_preview(settings, tmp_path / "preview.png")
    small = np.asarray(cv2.imread(str(tmp_path / "preview.png")))[..., 1].astype(float)
    assert small.shape == (488 // 2, 656 // 2)
    linear = Renderer(settings).render(1).radiance[..., 1].astype(float)
    blocks = linear.reshape(244, 2, 328, 2).mean(axis=(1, 3))
    flat = np.abs(np.gradient(blocks)).max(axis=0) < 0.01 * blocks.max()
    # Away from edges one sample is a pixel's mean to less than half a number, and rounding takes
    # another half. The metered exposure clips nothing.
    assert flat.sum() > 0.9 * flat.size
    per_light = np.median(((small - 4) / blocks)[flat & (small > 100)])
    assert np.abs(small - 4 - per_light * blocks)[flat].max() <= 1.0
    assert 150 < small.max() < 255


def test_ambient_light_is_even_and_vignetting_takes_the_corners_by_the_square_of_the_distance():
    settings = scene(
        phantom={"kind": "plane", "reflectance": 0.6},
        source={"power_mw": 1e-9},
        microscope={"light": "ambient", "illumination_mw_mm2": 0.05, "vignetting": 0.4},
    )
    image = Renderer(settings).render(0).radiance[..., 1]
    y, x = np.mgrid[0:480, 0:640]
    # Two rows and columns of samples a pixel, a quarter to either side of its centre.
    squared = ((x - 319.5) ** 2 + (y - 239.5) ** 2 + 2 * 0.25**2) / (320**2 + 240**2)
    # Matt and evenly lit: rho E / pi. The beam adds 1e-8 of it; the rest is float32's rounding.
    np.testing.assert_allclose(image, 0.6 * 0.05 / np.pi * (1 - 0.4 * squared), rtol=1e-5)


def test_ambient_light_shows_the_instrument_and_coaxial_light_falls_off_with_the_slope():
    lit = {
        light: Renderer(
            scene(
                source={"power_mw": 1e-9},
                motion={"start_mm": 1.0, "travel_mm": 1.0, "frames": 1},
                spot={"eccentricity_mm": 5.0},
                instrument={"visible": True},
                microscope={"light": light, "illumination_mw_mm2": 0.05},
            )
        ).render(0)
        for light in ("coaxial", "ambient")
    }
    wall = lit["ambient"].wall == 1
    ambient, coaxial = (lit[light].radiance[..., 0] for light in ("ambient", "coaxial"))
    assert np.ptp(ambient[wall]) < 1e-5 * ambient[wall].mean()
    assert ambient[lit["ambient"].wall == 0].min() > 0
    # From a pinhole on the sphere a point at the angle t to the axis is 2 r cos t away and seen at
    # the angle t to its normal (Thales), so E = E0 cos t (2 r)^2 / (2 r cos t)^2 = E0 / cos t. The
    # window's middle is the spot, whose angle at the sphere's centre is twice that at the pinhole.
    f = 23.0 / 0.0067
    y, x = np.mgrid[0:480, 0:640]
    middle = np.tan(np.arcsin(5.0 / 11.5) / 2)
    secant = np.sqrt(1 + (middle + (x - 319.5) / f) ** 2 + ((y - 239.5) / f) ** 2)
    np.testing.assert_allclose(coaxial[wall], (0.5 / np.pi * 0.05 * secant)[wall], rtol=1e-5)


@pytest.mark.parametrize(
    ("microscope", "message"),
    [
        ({"distortion": (-9.0, 0.0, 0.0, 0.0, 0.0)}, "folds the image"),
        ({"distortion": LENS, "pinhole_height_mm": float("inf")}, "telecentric"),
    ],
)
def test_an_impossible_microscope_is_refused(microscope, message):
    with pytest.raises(ValueError, match=message):
        World(scene(microscope=microscope, spot={"eccentricity_mm": 5.0})).truth  # noqa: B018


def test_lines_of_the_scenes_own_microscope_give_its_image():
    window = {"width_px": 64, "height_px": 48, "scale_mm_px": 0.05, "samples": 1}
    cone = {"source": {"kind": "cone"}, "motion": {"frames": 3}, "microscope": window}
    renderer = Renderer(scene_of(cone))
    from eyespot.scenes.rendering.loaded_scene import radiance_along  # needs Mitsuba's variant

    image = renderer.render(1).radiance
    rows, columns = np.divmod(np.arange(48 * 64), 64)
    point, direction = map(
        np.asarray, renderer.world.microscope.ray(np.stack([columns, rows], axis=-1).astype(float))
    )
    start = point - 10.0 * direction  # 10 mm above the pole, below the default pinhole
    found = radiance_along(renderer.mitsuba_scene, start=start, direction=direction)
    # Float32 lines that start elsewhere meet the wall 1 um away; at the spot's edge and on the
    # instrument's outline that decides a few pixels.
    same = np.isclose(found.reshape(image.shape), image, rtol=1e-3, atol=1e-7).all(axis=-1)
    assert same.mean() > 0.99
