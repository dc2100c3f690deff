"""Rendered frames against closed forms, labels and Mitsuba's own integrator."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from estimator import Spot, StackError, SubpixelSettings, TrackState, measure, read_stack
from scenes import Renderer, Scene, SceneError, load_mitsuba, render_stack


def scene(**parts) -> Scene:
    """A uniform wall under the ideal cone's direct light alone, unless told otherwise."""
    plain: dict[str, Any] = {
        "schema": 1,
        "phantom": {"wall": "uniform", "indirect": "off"},
        "source": {"kind": "cone"},
        "withdrawal": {"start_mm": 3.0, "travel_mm": 1.0, "frames": 2},
        "instrument": {"visible": False},
        "microscope": {"illumination_mw_mm2": 0.0},
    }
    for name, values in parts.items():
        plain[name] = {**plain.get(name, {}), **values}
    return Scene.model_validate(plain)


@pytest.mark.parametrize("height", [11.5, 200.0, float("inf")])
@pytest.mark.parametrize("kind", ["eyeball", "plane"])
def test_mitsubas_camera_is_the_microscope_of_the_labels(kind, height):
    mi = load_mitsuba()
    from scenes import build, geometry

    settings = scene(
        phantom={"kind": kind},
        spot={"eccentricity_mm": 4.0, "azimuth_deg": 50.0},
        microscope={"pinhole_height_mm": height},
    )
    loaded = mi.load_dict(build.mitsuba_dict(settings, table=None, uniform=np.zeros(3)))
    pixels = np.array([[0.0, 0.0], [639.0, 0.0], [320.0, 240.0], [100.0, 479.0]])
    u, v = ((pixels + 0.5) / [640, 480]).T
    ray, _ = loaded.sensors()[0].sample_ray(
        0.0, 0.5, mi.Point2f(mi.Float(u), mi.Float(v)), mi.Point2f(0.5)
    )
    points = jnp.asarray(np.array(loaded.ray_intersect(ray).p).T)
    seen = np.asarray(geometry.microscope(settings).project(points))
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


@pytest.mark.parametrize("kind", ["eyeball", "plane"])
def test_every_label_is_found_again_in_the_pixels(kind):
    settings = scene(
        phantom={"kind": kind},
        spot={"eccentricity_mm": 5.0, "azimuth_deg": 20.0, "incidence_azimuth_deg": 60.0},
        microscope={"samples": 64},
    )
    renderer = Renderer(settings)
    for frame in range(2):
        image = renderer.render(frame).radiance
        spot, _ = measure(image / image.max() * 0.8, TrackState(), SubpixelSettings())
        assert isinstance(spot, Spot)
        truth = renderer.truth.cone
        found = (spot.x_px, spot.y_px, spot.semi_major_px, spot.semi_minor_px)
        expected = (
            *truth.centre[frame],
            truth.semi_major[frame],
            truth.semi_minor[frame],
        )
        np.testing.assert_allclose(found, expected, atol=0.05)
        turn = (spot.angle_rad - float(truth.angle[frame])) % np.pi
        # 0.05 px at the end of the semi-major axis, seen against the difference of the axes.
        leeway = 0.05 / float(truth.semi_major[frame] - truth.semi_minor[frame])
        assert min(turn, np.pi - turn) < leeway


def test_the_integrator_agrees_with_mitsubas_path_tracer():
    mi = load_mitsuba()
    settings = scene(
        instrument={"visible": True},
        withdrawal={"start_mm": 0.5, "frames": 1},
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


def test_frames_are_bit_identical_when_rendered_again():
    settings = scene(instrument={"visible": True}, phantom={"wall": "printed paper"})
    first, second = (Renderer(settings).render(1).radiance for _ in range(2))
    assert np.array_equal(first, second)


def test_the_instrument_hides_the_spot_that_the_labels_say_it_hides():
    settings = scene(instrument={"visible": True}, withdrawal={"start_mm": "contact"})
    renderer = Renderer(settings)
    fractions = [renderer.render(frame).visible_fraction for frame in range(2)]
    assert fractions[0] < 0.75 < fractions[1]
    mask = renderer.mask(0, renderer.render(0))
    ellipse = renderer.truth.half_max
    whole = np.pi * float(ellipse.semi_major[0] * ellipse.semi_minor[0])
    assert mask.sum() < 0.7 * whole


def test_a_spot_outside_the_window_is_refused_with_the_way_out():
    with pytest.raises(SceneError, match=r"leaves the 100 x 100 px window.*Lower"):
        Renderer(scene(microscope={"width_px": 100, "height_px": 100}))


def test_a_stack_is_whole_or_not_there(tmp_path):
    settings = scene(microscope={"illumination_mw_mm2": 0.05})

    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_stack(settings, tmp_path / "stack", progress=stop)
    assert list(tmp_path.iterdir()) == []
    stack = render_stack(settings, tmp_path / "stack")
    stack.verify()
    assert [row.exposure for row in stack.labels] == ["paper", "metered"] * 2
    again = read_stack(tmp_path / "stack")
    assert again.labels == stack.labels
    metered = stack.exposed("metered")[0]
    image, mask = stack.image(metered), stack.mask(metered) > 0
    # 80 % of 255 at the peak; noise of 3 DN on top of it at the 99.9th percentile.
    assert 195 < np.percentile(image[mask], 95) < 215
    with pytest.raises(StackError, match="exists"):
        render_stack(settings, tmp_path / "stack")
    (tmp_path / "stack" / metered.file_name).write_bytes(b"broken")
    with pytest.raises(StackError, match=r"000001\.png differs"):
        again.verify()
    lines = tmp_path / "stack" / "metadata.jsonl"
    lines.write_text(lines.read_text().replace('"d_mm"', '"d_cm"', 1))
    with pytest.raises(StackError, match="line 1: missing or unknown columns: d_cm, d_mm"):
        read_stack(tmp_path / "stack")
