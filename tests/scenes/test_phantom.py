"""What stands in the eye besides the beam: a picture of the user's own, a second tool."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage

from eyespot.scenes import Renderer, Scene, SceneError
from eyespot.scenes.walls.picture import PHOTOGRAPH
from eyespot.scenes.world.world import World
from tests.support.drawn.scene_tables import BARE, scene_of


def scene(**parts) -> Scene:
    """An eye in even light, seen from the sphere's height, with a beam of no power."""
    even = {"light": "ambient", "scale_mm_px": 0.02, "samples": 16, "illumination_mw_mm2": 0.05}
    motion = {"start_mm": 3.0, "travel_mm": 1.0, "frames": 1}
    dark = {"power_mw": 1e-9}
    return scene_of(BARE, {"microscope": even, "motion": motion, "source": dark}, parts)


def dots(path, places_mm, *, mm_px, size, radius_mm=0.15):
    """White dots with soft edges on black; right is +X, up is +Y, the middle is (0, 0)."""
    height, width = size
    y, x = np.mgrid[0:height, 0:width]
    x_mm, y_mm = (x - (width - 1) / 2) * mm_px, ((height - 1) / 2 - y) * mm_px
    away = np.min([np.hypot(x_mm - a, y_mm - b) for a, b in places_mm], axis=0)
    image = np.clip((radius_mm - away) / mm_px + 0.5, 0, 1)
    cv2.imwrite(str(path), (255 * image).astype(np.uint8))


PLACES_MM = [(0.0, 0.0), (3.0, 0.0), (0.0, 2.5), (-2.0, -2.0), (4.0, -2.5)]


@pytest.mark.parametrize(
    ("kind", "mm_px", "size"),
    [
        ("eyeball", 0.01, (1200, 1600)),
        ("eyeball", 0.004, (2401, 2501)),
        ("plane", 0.03, (300, 401)),
    ],
)
def test_dots_of_an_image_lie_where_their_arcs_from_the_pole_end(tmp_path, kind, mm_px, size):
    file = tmp_path / "dots.png"
    dots(file, PLACES_MM, mm_px=mm_px, size=size)
    phantom = {
        "kind": kind,
        "wall": "image",
        "wall_image": str(file),
        "wall_image_mm": mm_px * size[1],
    }
    settings = scene(phantom=phantom)
    image = Renderer(settings).render(0).radiance[..., 1]
    parts, count = scipy.ndimage.label(image > image.max() / 2)
    assert count == len(PLACES_MM)
    found = np.array(scipy.ndimage.center_of_mass(image > image.max() / 2, parts, range(1, 6)))
    x, y = np.transpose(PLACES_MM)
    # Azimuthal-equidistant: the arc from the pole keeps its length and its direction.
    arc, angle = np.hypot(x, y), np.arctan2(y, x)
    polar = arc / 11.5 if kind == "eyeball" else 0 * arc
    across = 11.5 * np.sin(polar) if kind == "eyeball" else arc
    points = np.stack(
        [across * np.cos(angle), across * np.sin(angle), -11.5 * np.cos(polar)], axis=-1
    )
    expected = np.asarray(World(settings).microscope.project(jnp.asarray(points)))
    away = np.linalg.norm(found[:, None, ::-1] - expected, axis=-1).min(axis=0)
    # Pixels above the half of a dot of 15 px across, counted whole, have their mean within 0.1 px;
    # dots of the coarsest file are sampled at 10 px across. A map of 0.012 mm adds nothing.
    assert away.max() < 0.15


def test_the_dot_at_the_pole_is_round(tmp_path):
    dots(tmp_path / "dot.png", [(0.0, 0.0)], mm_px=0.01, size=(800, 800), radius_mm=2.0)
    phantom = {"wall": "image", "wall_image": str(tmp_path / "dot.png"), "wall_image_mm": 8.0}
    image = Renderer(scene(phantom=phantom)).render(0).radiance[..., 1]
    inside = np.argwhere(image > image.max() / 2)
    across = np.ptp(inside, axis=0) + 1
    spread = inside.std(axis=0)
    # An arc of 2 mm seen from the sphere (stereographic): 2 (23 / 0.02) tan(2 / 11.5 / 2) = 200.5.
    np.testing.assert_allclose(across, 200.5, atol=1.5)
    np.testing.assert_allclose(spread, 200.5 / 4, rtol=2e-3)


def test_an_images_grey_is_the_reflectance_that_srgb_makes_of_it(tmp_path):
    # IEC 61966-2-1: 188 of 255 is linear 0.5029, times the white's 0.4.
    for dtype, value in ((np.uint8, 188), (np.uint16, 188 * 257)):
        cv2.imwrite(str(tmp_path / "grey.png"), np.full((20, 30, 3), value, dtype))
        renderer = Renderer(
            scene(
                phantom={
                    "wall": "image",
                    "wall_image": str(tmp_path / "grey.png"),
                    "reflectance": 0.4,
                }
            )
        )
        np.testing.assert_allclose(renderer.world.wall_colour, 0.4 * 0.5029, rtol=1e-4)
        image = renderer.render(0).radiance
        np.testing.assert_allclose(image, 0.4 * 0.5029 * 0.05 / np.pi, rtol=1e-4)


def test_the_photograph_is_4_9_mm_wide_and_upright():
    settings = scene(phantom={"kind": "plane", "wall": "photograph", "reflectance": 0.5})
    image = Renderer(settings).render(0).radiance[..., 1]
    columns, rows = round(4.9 / 0.02), round(4.9 / 0.02 * 910 / 510)
    file = np.asarray(cv2.imread(str(PHOTOGRAPH)))[..., 1].astype(np.float32) / 255
    small = cv2.resize(file**2.2, (columns, rows), interpolation=cv2.INTER_AREA)  # about sRGB
    top, left = (480 - rows) // 2, (640 - columns) // 2
    seen = image[top : top + rows, left : left + columns]
    # A plane is seen without distortion. Turned or mirrored, the picture correlates by 0.5 at most.
    assert np.corrcoef(seen.ravel(), small.ravel())[0, 1] > 0.97


def test_the_second_tool_is_seen_on_the_line_from_its_tip_to_its_trocar():
    tip = np.array([-2.0, 1.0, -8.0])
    tool = {
        "visible": True,
        "tip_mm": tuple(tip.tolist()),
        "trocar_azimuth_deg": 200.0,
        "gauge": 25,
    }
    settings = scene(second_tool=tool, microscope={"pinhole_height_mm": 200.0})
    seen = Renderer(settings).render(0).wall < 0.5
    microscope = World(settings).microscope
    polar, azimuth = np.radians(48.0), np.radians(200.0)
    trocar = 11.5 * np.array(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )
    along = (trocar - tip) / np.linalg.norm(trocar - tip)
    # 25 G: 0.51 mm across. Points of the axis are in it, those 10 % past the radius are beside it,
    # square to the axis and to the line of sight.
    square = np.cross(along, [0.0, 0.0, 1.0])
    square /= np.linalg.norm(square)
    for reach in (0.1, 1.0, 2.0):
        for aside in (0.0, 0.95, -0.95, 1.1, -1.1):
            point = tip + reach * along + aside * 0.255 * square
            u, v = np.rint(np.asarray(microscope.project(point))).astype(int)
            assert seen[v, u] == (abs(aside) < 1), (reach, aside)
    u, v = np.rint(np.asarray(microscope.project(tip - 1.0 * along))).astype(int)
    assert not seen[v, u]


def test_the_second_tool_hides_and_shades_the_spot():
    parts = {
        "source": {"power_mw": 1.0},
        "spot": {"incidence_deg": 0.0},
        "microscope": {"scale_mm_px": 0.0067, "illumination_mw_mm2": 0.0},
    }
    alone = Renderer(scene(**parts)).render(0)
    tip = {"visible": True, "tip_mm": (0.0, 0.0, -10.5)}
    crossed = Renderer(scene(**parts, second_tool=tip)).render(0)
    assert alone.visible_fraction == 1.0
    assert 0.5 < crossed.visible_fraction < 1.0
    # Some of the wall that is seen lies in the tool's shadow, and the tool gives no light.
    shaded = (crossed.wall == 1) & (alone.radiance[..., 0] > 0) & (crossed.radiance[..., 0] == 0)
    assert shaded.sum() > 100
    assert (crossed.radiance <= alone.radiance.max() * 1.001).all()


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"phantom": {"wall": "image"}}, "needs phantom.wall_image"),
        ({"phantom": {"pupil_radius_mm": 12.0}}, "pupil_radius_mm must be smaller"),
        ({"phantom": {"pupil_radius_mm": 3.0, "kind": "plane"}}, "eyeball phantom only"),
        ({"second_tool": {"visible": True, "tip_mm": (0.0, 0.0, -12.0)}}, "inside the eye"),
    ],
)
def test_an_impossible_phantom_or_tool_is_refused(parts, message):
    with pytest.raises(ValueError, match=message):
        scene(**parts)


def test_a_missing_image_is_named(tmp_path):
    missing = {"wall": "image", "wall_image": str(tmp_path / "none.png")}
    with pytest.raises(SceneError, match=r"none\.png' cannot be read"):
        Renderer(scene(phantom=missing))


def test_a_shifted_window_sees_its_part_of_the_larger_one_and_cuts_the_spot():
    # A whole number of pixels: both windows sample the wall at the same places, but for float32.
    light = {"power_mw": 1.0}
    spot = {"incidence_deg": 0.0}
    whole = Renderer(scene(source=light, spot=spot, microscope={"width_px": 400, "height_px": 300}))
    part = Renderer(
        scene(
            source=light,
            spot=spot,
            microscope={"width_px": 200, "height_px": 100, "window_offset_px": [90.0, -20.0]},
        )
    )
    seen, all_of_it = part.render(0), whole.render(0)
    # The window's middle moves by 90 px right of the spot's and 20 px above it.
    expected = all_of_it.radiance[80:180, 190:390]
    changed = np.abs(seen.radiance - expected).max(axis=-1) > 1e-4 * expected.max()
    assert changed.mean() < 2e-3
    place = np.asarray(part.world.truth.contour_px) - np.asarray(whole.world.truth.contour_px)
    np.testing.assert_allclose(place, np.broadcast_to([-190.0, -80.0], place.shape), atol=1e-9)
    # The spot's middle is 10 px inside of the left border: a little over half of it is seen.
    radius = np.ptp(np.asarray(part.world.truth.contour_px)[0, :, 0]) / 2
    seen_part = 1 - np.arccos(9.5 / radius) / np.pi
    assert all_of_it.visible_fraction == 1.0
    assert seen.visible_fraction == pytest.approx(seen_part, abs=2 / 128)
