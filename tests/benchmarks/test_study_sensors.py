"""The study of sensors: closed forms of stereo and of shadows, marks in drawn pictures."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from eyespot import optics
from eyespot.benchmarks.reporting import where
from eyespot.benchmarks.studies import sensor_views, sensors
from eyespot.benchmarks.studies.sensor_views import (
    CONVERGENCE_DEG,
    PINHOLE_HEIGHT_MM,
    RADIUS_MM,
    SCALE_MM_PX,
    InstrumentPlace,
    ReadingOutcome,
    Sensor,
    Wrong,
    outcomes_at,
    place,
    views,
)

pytestmark = pytest.mark.usefixtures("fast_compilation")

DOWN, POLE = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, -RADIUS_MM])


@pytest.fixture(scope="module")
def pinholes():
    return views("pinhole")


def known(seen, one):
    return sensor_views.Known(seen, jnp.asarray(RADIUS_MM), one.lamp, one.axis)


def test_each_sensor_reads_the_distance_of_exact_marks(pinholes):
    one = place(eccentricity=2.0, distance=3.0)
    found = sensor_views.marks_of(one, pinholes, points=64)
    given = known(pinholes, one)
    ellipse = optics.ellipse_of_contour(found.contour)
    # The spot's contour of 64 points is within 1e-7 px of that of 32; rounding for the others.
    assert float(sensor_views.by_spot(ellipse, given)) == pytest.approx(3.0, abs=1e-6)
    assert float(sensor_views.by_shadow(found.tip, found.shadow, given)) == pytest.approx(
        3.0, abs=1e-9
    )
    pairs = found.tip_pair, found.wall_pair
    assert float(sensor_views.by_stereo(*pairs, given)) == pytest.approx(3.0, abs=1e-9)


def test_a_stereo_error_is_the_disparitys_times_distance_over_base(pinholes):
    """By similar triangles dz = e H/B, with e the disparity's error on the object."""
    lamp, above = np.array([-5.0, 0.0, 3.0]), np.asarray(2.0)
    one = InstrumentPlace(np.zeros(()), above, POLE - above * DOWN, DOWN, POLE, lamp, DOWN)
    true = sensor_views.marks_of(one, pinholes, points=32)
    off = 0.2
    pair = true.tip_pair + jnp.array([[off, 0.0], [0.0, 0.0]])
    read = float(sensor_views.by_stereo(pair, true.wall_pair, known(pinholes, one)))
    height = PINHOLE_HEIGHT_MM + RADIUS_MM
    base = 2 * height * np.tan(np.radians(CONVERGENCE_DEG / 2))
    # Pixels are SCALE_MM_PX wide at the pole, and 1 % less 2 mm nearer to the pinhole. The tip has
    # a smaller disparity if the left image moves to the right.
    at_tip = SCALE_MM_PX * (height - 2.0) / height
    expected = off * at_tip * (height - 2.0) / base
    assert abs(read - 2.0) == pytest.approx(expected, rel=0.01)


def test_a_shadows_error_is_that_of_a_lamp_over_a_plane(pinholes):
    """The line from the foot f to a lamp (x, H) is above the tip's place at h = (t - f) H/(x - f).

    So dh/df = -(H - h)/x at f = 0.
    """
    x, up = 6.0, 14.0
    lamp = POLE + np.array([x, 0.0, up])
    height = 3.0
    tip = POLE + height / up * (lamp - POLE)
    one = InstrumentPlace(np.zeros(()), np.asarray(height), tip, DOWN, POLE, lamp, DOWN)
    true = sensor_views.marks_of(one, pinholes, points=32)
    np.testing.assert_allclose(true.shadow, pinholes.centre.project(POLE), atol=1e-9)
    given = known(pinholes, one)
    off = 1.0
    read = [
        float(sensor_views.by_shadow(true.tip, true.shadow + jnp.array([s * off, 0.0]), given))
        for s in (-1.0, 1.0)
    ]
    slope = (read[1] - read[0]) / (2 * off * SCALE_MM_PX)
    # The tip's line of sight leans by x h/H / 212 mm = 0.6 % of its height.
    assert slope == pytest.approx(-(up - height) / x, rel=0.02)


def test_the_instrument_hides_the_shadow_of_a_tip_near_the_wall(pinholes):
    near, far = (place(eccentricity=0.0, distance=d) for d in (0.3, 3.0))
    found = outcomes_at(InstrumentPlace(*map(np.stack, zip(near, far, strict=True))), pinholes)
    # The instrument is 0.255 mm thick, and the shadow 0.15 mm beside the tip at d = 0.3 mm.
    assert found[Sensor.SHADOW] == [ReadingOutcome.HIDDEN, ReadingOutcome.READ]
    assert found[Sensor.STEREO] == [ReadingOutcome.READ, ReadingOutcome.READ]


def bar(shift, *, inside, shape=(200, 240)):
    """A bar with a straight end, blurred by one pixel, and its outline without the shift."""
    rows, columns = np.mgrid[: 4 * shape[0], : 4 * shape[1]] / 4.0 - 0.375
    lit = (columns - shift[0] > 100.0) & (np.abs(rows - shift[1] - 90.0) < 19.0)
    fine = np.where(lit, inside, 120.0)
    image = fine.reshape(shape[0], 4, shape[1], 4).mean(axis=(1, 3))
    sides = np.arange(100.0, 170.0)
    end = np.arange(72.0, 109.0)
    points = np.concatenate(
        [
            np.stack([sides, np.full_like(sides, 71.0)], axis=1),
            np.stack([sides, np.full_like(sides, 109.0)], axis=1),
            np.stack([np.full_like(end, 100.0), end], axis=1),
        ]
    )
    normals = np.repeat([[0.0, -1.0], [0.0, 1.0], [-1.0, 0.0]], [70, 70, 37], axis=0)
    return gaussian_filter(image, 1.0), (points, normals)


@pytest.mark.parametrize("inside, dark", [(40.0, True), (200.0, False)])
def test_an_outline_is_found_where_it_is_drawn(inside, dark):
    shift = np.array([3.5, -2.75])  # on the grid of the fine picture
    image, outline = bar(shift, inside=inside)
    # The ends of the sides reach beyond the bar if the outline lies too far back, so they pull it
    # forwards: a few points of 70, a tenth of a pixel.
    np.testing.assert_allclose(sensor_views.found_shift(image, outline, dark=dark), shift, atol=0.2)


@pytest.mark.slow
def test_a_quick_study_finds_the_spot_best_and_stereo_last(tmp_path):
    tables = sensors.sensors(out=tmp_path / "sensors", quick=True, seed=1)
    claims = {
        c["name"]: c for c in json.loads((tmp_path / "sensors/summary.json").read_text())["found"]
    }
    spot, shadow, stereo = claims["noise, pinhole"]["value"]
    # Closed forms: 1 px on a mark is 0.013 mm on the wall; a light guide stands 25 degrees, the
    # halves of the pair 5.5 degrees apart. The stated noise of a spot's edge is a twentieth.
    assert spot < 0.01 < shadow < 0.1 < stereo < 0.5
    # The shadow's geometry lies inside the eye, that of the pair outside of it.
    path = "flat contact lens"
    taken = where(tables["wrong"], path=path, wrong=Wrong.PATH)
    wrong = taken.error_mm.abs().groupby(taken.sensor).max()
    assert wrong[Sensor.SHADOW] < wrong[Sensor.SPOT] < wrong[Sensor.STEREO]
    read = where(tables["readings"], sensor=Sensor.SPOT)
    assert (read.outcome == ReadingOutcome.READ).all()
    assert read.error_mm.abs().max() < 0.02
