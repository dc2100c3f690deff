"""The study of sensors: closed forms of stereo and of shadows."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eyespot.benchmarks.reporting import where
from eyespot.benchmarks.studies import sensors
from eyespot.benchmarks.studies.sensors import (
    CONVERGENCE_DEG,
    PINHOLE_HEIGHT_MM,
    POLE,
    RADIUS_MM,
    SCALE_MM_PX,
    InstrumentPlace,
    outcomes_at,
    places,
    views,
)

pytestmark = pytest.mark.usefixtures("fast_compilation")

DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def pinholes():
    return views("pinhole")


def test_each_sensor_reads_the_distance_of_exact_marks(pinholes):
    one = jax.tree.map(lambda leaf: leaf[0], places([2.0], [3.0]))
    found = sensors.marks_of(one, pinholes, points=64)
    read = sensors.read(found, one, pinholes)
    # The spot's contour of 64 points is within 1e-7 px of that of 32; rounding for the others.
    assert float(read["spot"]) == pytest.approx(3.0, abs=1e-6)
    assert float(read["shadow"]) == pytest.approx(3.0, abs=1e-9)
    assert float(read["stereo"]) == pytest.approx(3.0, abs=1e-9)


def test_a_stereo_error_is_the_disparitys_times_distance_over_base(pinholes):
    """By similar triangles dz = e H/B, with e the disparity's error on the object."""
    lamp, above = np.array([-5.0, 0.0, 3.0]), 2.0
    one = InstrumentPlace(POLE - above * DOWN, DOWN, POLE, lamp)
    true = sensors.marks_of(one, pinholes, points=32)
    off = 0.2
    pair = true.tip_pair + jnp.array([[off, 0.0], [0.0, 0.0]])
    seen = true._replace(tip_pair=pair)
    read = float(sensors.read(seen, one, pinholes)["stereo"])
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
    one = InstrumentPlace(tip, DOWN, POLE, lamp)
    true = sensors.marks_of(one, pinholes, points=32)
    np.testing.assert_allclose(true.shadow, pinholes.centre.project(POLE), atol=1e-9)
    off = 1.0
    read = [
        sensors.read(true._replace(shadow=true.shadow + jnp.array([s * off, 0.0])), one, pinholes)
        for s in (-1.0, 1.0)
    ]
    slope = (read[1]["shadow"] - read[0]["shadow"]) / (2 * off * SCALE_MM_PX)
    # The tip's line of sight leans by x h/H / 212 mm = 0.6 % of its height.
    assert float(slope) == pytest.approx(-(up - height) / x, rel=0.02)


def test_the_instrument_hides_the_shadow_of_a_tip_near_the_wall(pinholes):
    every = places([0.0, 0.0], [0.3, 3.0])
    marks = eqx.filter_vmap(sensors.marks_of, in_axes=(0, None))(every, pinholes)
    found = outcomes_at(marks, every, pinholes)
    # The instrument is 0.255 mm thick, and the shadow 0.15 mm beside the tip at d = 0.3 mm.
    assert found["shadow"].tolist() == [sensors.HIDDEN, sensors.READ]
    assert found["stereo"].tolist() == [sensors.READ, sensors.READ]


@pytest.mark.slow
def test_a_quick_study_finds_the_spot_best_and_stereo_last(tmp_path):
    tables = sensors.sensors(out=tmp_path / "sensors", quick=True, seed=1)
    read = where(tables["expected"], path="pinhole", outcome=sensors.READ)
    medians = read.groupby("sensor").sigma_mm.median()
    spot, shadow, stereo = (medians[sensor] for sensor in sensors.SENSORS)
    found = json.loads((tmp_path / "sensors/summary.json").read_text())["found"]
    assert all(claim["holds"] for claim in found)
    # Closed forms: 1 px on a mark is 0.013 mm on the wall; a light guide stands 25 degrees, the
    # halves of the pair 5.5 degrees apart. The stated noise of a spot's edge is a twentieth.
    assert spot < 0.01 < shadow < 0.1 < stereo < 0.5
    # The shadow's geometry lies inside the eye, that of the pair outside of it.
    taken = where(tables["wrong"], path="flat contact lens", wrong=sensors.WRONG_PATH)
    wrong = taken.error_mm.abs().groupby(taken.sensor).max()
    assert wrong["shadow"] < wrong["spot"] < wrong["stereo"]
