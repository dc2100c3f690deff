"""The mode pixels when the wall moves in the image, and when the tip moves on a curve."""

import numpy as np

from estimator.distance.range import WallMemory
from estimator.pixels.cells import COUNT, CellLight, CellWindow, WallMotion
from estimator.pixels.frame_fit import registered
from estimator.pixels.frame_model import OWN, Linear
from estimator.sources.opening import open_source
from tests.pixel_stacks import assert_posed, cone_stack, readings_of


def test_a_point_of_the_map_comes_back_from_the_image():
    rng = np.random.default_rng(1)
    motion = WallMotion(12.0, -7.0, 0.08)
    points = rng.uniform(0, 500, (20, 2))
    np.testing.assert_allclose(motion.map_px(motion.image_px(points)), points, atol=1e-9)
    step = WallMotion(-3.0, 1.0, -0.02)
    later = step.after(motion)
    np.testing.assert_allclose(later.image_px(points), step.image_px(motion.image_px(points)))
    np.testing.assert_allclose(later.since(motion), step, atol=1e-12)


def test_cells_follow_a_wall_that_turns():
    v, u = np.mgrid[0:300, 0:400].astype(float)

    def picture(points):
        x, y = points[..., 0], points[..., 1]
        return 0.5 + 0.2 * np.sin(x / 31.0) * np.cos(y / 23.0)

    motion = WallMotion.about(np.array([200.0, 150.0]), np.array([9.0, -4.0]), 0.09)
    image = picture(motion.map_px(np.stack([u, v], axis=-1)))
    usable = np.ones(image.shape, bool)
    window = CellWindow(left=130, top=90, side=5)
    still = CellLight(picture(np.stack([u, v], axis=-1)), usable, np.zeros_like).means(window)[0]
    moved, kept = CellLight(image, usable, np.zeros_like, motion).means(window)
    assert kept.all()
    # Between pixels the picture is bent by 0.2 / 23^2 per px^2; an eighth of that is lost.
    np.testing.assert_allclose(moved, still, atol=1e-4)


def _texture(rng):
    """A smooth random field on a lattice that is wider than the map."""
    place = np.arange(2 * COUNT)
    field = np.zeros((2 * COUNT, 2 * COUNT))
    for _ in range(60):
        kx, ky = rng.normal(0, 0.35, 2)
        field += np.sin(kx * place[None, :] + ky * place[:, None] + rng.uniform(0, 2 * np.pi))
    return 0.1 * field / field.std()


def test_a_shift_of_the_wall_is_found_although_the_light_has_changed():
    rng = np.random.default_rng(4)
    field, at = _texture(rng), COUNT // 2
    right, down = 3, -2
    known = field[at : at + COUNT, at : at + COUNT].ravel()
    now = field[at - down : at - down + COUNT, at - right : at - right + COUNT].ravel()
    slopes = np.zeros((OWN, COUNT**2))
    along = np.linspace(-1, 1, COUNT)
    slopes[0], slopes[1] = np.tile(along, COUNT), np.repeat(along, COUNT)
    slopes[2] = 1.0
    noise = 0.005
    line = Linear(
        residual=now + 0.3 * slopes[0] - 0.2 * slopes[2] + noise * rng.normal(size=COUNT**2),
        slopes=slopes,
        shared=np.zeros((0, COUNT**2)),
        weight=np.full(COUNT**2, noise**-2),
    )
    window = CellWindow(left=100, top=80, side=6)
    found = registered(line, known, np.full(COUNT**2, noise**2), window)
    assert found is not None
    moved = found.image_px(window.middle_px) - window.middle_px
    # 0.05 cells: noise of 5 % of the contrast on 500 cells would leave 0.005, splines some more.
    np.testing.assert_allclose(moved / window.side, [right, down], atol=0.05)
    assert abs(found.turn) < 0.005


def test_a_vessel_that_comes_into_the_light_is_not_another_wall(tmp_path):
    # The growing light reaches a dark line of the paper, which no frame before has shown well.
    stack = cone_stack(
        tmp_path / "stack",
        seed=968783527,
        phantom={"wall": "printed paper", "texture_seed": 968783527},
        spot={
            "eccentricity_mm": 1.28,
            "azimuth_deg": 75.061,
            "incidence_deg": 22.609,
            "incidence_azimuth_deg": 246.684,
        },
        microscope={"width_px": 640, "height_px": 480},
        motion={"start_mm": 2.5406, "travel_mm": 0.7619, "frames": 5, "speed_mm_s": 1.0},
    )
    walls = [wall for wall, _, _ in readings_of(stack, tmp_path)]
    assert walls == [WallMemory.NEW, *4 * [WallMemory.KNOWN]]


def test_a_wall_that_turns_with_the_eye_is_registered(tmp_path):
    stack = cone_stack(tmp_path / "stack", unrest={"rotation_deg_s": (3.0, 2.0, 0.0)})
    readings = list(readings_of(stack, tmp_path))
    assert readings[0][0] is WallMemory.NEW
    assert {wall for wall, _, _ in readings[1:]} == {WallMemory.MOVED}
    # Once its motion is known. Printed paper leaves a few micrometres; a map that stayed behind by
    # 0.1 mm would be no better than none.
    assert_posed(readings[2:], within_mm=0.015)
    assert_posed(readings)


def test_a_drift_of_the_microscope_is_within_the_stated_errors(tmp_path):
    stack = cone_stack(tmp_path / "stack", unrest={"drift_mm_s": (0.4, 0.3)})
    readings = list(readings_of(stack, tmp_path))
    assert {wall for wall, _, _ in readings[1:]} == {WallMemory.MOVED}
    # The tip is up to 0.45 mm off; the microscope file cannot know that, the standard errors do.
    assert_posed(readings)


def test_a_light_that_moves_on_a_curve_is_averaged_along_it(tmp_path):
    # A retina is dark: the camera meters exposures of some 60 ms, in which a hand's tremor turns.
    stack = cone_stack(
        tmp_path / "stack",
        phantom={"wall": "uniform", "reflectance": 0.1},
        motion={
            "kind": "hand",
            "distance_mm": 2.0,
            "duration_s": 0.4,
            "top_speed_mm_s": 2.0,
            "seed": 3,
        },
    )
    times = [frame.exposure_s for frame in open_source(stack.folder)]
    assert min(times) > 0.03
    assert_posed(readings_of(stack, tmp_path), within_mm=0.005)


def test_a_shake_as_stated_is_no_motion_of_the_wall(tmp_path):
    # Two frames differ by 0.7 px along each side, and by 1 px or more in one of three. That a pair
    # is 3 px apart, from where the wall counts as moved, happens once in 8,000.
    stack = cone_stack(tmp_path / "stack", unrest={"shake_px": 0.5})
    walls = [wall for wall, _, _ in readings_of(stack, tmp_path)]
    assert walls == [WallMemory.NEW, *5 * [WallMemory.KNOWN]]
