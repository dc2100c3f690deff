"""A loop with an ideal sensor is the linear system that its parts make."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov

from eyespot import scenes
from eyespot.benchmarks.studies import loop
from eyespot.benchmarks.studies.loop import LAG_S, TICK_S, Course, LoopRun, perfect, simulated

DEPTH_MM, SET_MM = 20.0, 2.0
STILL = LoopRun(tremor_mm=0.0, foreknown=0.0, rate_hz=20.0, latency_s=0.05)


def flat(seconds: float) -> Course:
    """A wall that stays where it is."""
    time = np.arange(0.0, seconds, TICK_S)
    axis = np.broadcast_to([0.0, 0.0, -1.0], (time.size, 3))
    return Course(time, axis, np.full(time.size, DEPTH_MM), np.array([0.0, 0.0, 9.0]))


def closed_loop(gain: float) -> tuple[np.ndarray, np.ndarray]:
    """From tick to tick, for an arm v' = (u - v)/lag with u = gain (target - place), held."""
    rates = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 0.0]]) / [[1.0], [LAG_S], [1.0]]
    step = expm(TICK_S * rates)
    by_target = gain * step[:2, 2]
    return step[:2, :2] - np.outer(by_target, [1.0, 0.0]), by_target


def test_a_perfect_sensor_makes_a_sampled_first_order_lag():
    course = flat(1.0)
    read = perfect(course, STILL, 0)
    rows = simulated(STILL, course, read, begin_mm=2.1, set_mm=SET_MM, seed=0)
    matrix, _ = closed_loop(STILL.gain)
    # The first frame is taken at 0.05 s; its reading comes after the latency. Until then it rests.
    first = round((1 / STILL.rate_hz + STILL.latency_s) / TICK_S)
    expected = [
        -(np.linalg.matrix_power(matrix, max(k - first, 0)) @ [-0.1, 0.0])[0]
        for k in range(course.time_s.size)
    ]
    # Rounding of places near 20 mm; the poses between ticks are straight lines through them.
    np.testing.assert_allclose(rows.d_mm - SET_MM, expected, atol=1e-10)


def test_noise_alone_gives_the_variance_of_the_lyapunov_equation():
    run = LoopRun(tremor_mm=0.0, foreknown=0.0, rate_hz=20.0, latency_s=0.05, noise_mm=0.01)
    course = flat(300.0)
    rows = simulated(run, course, perfect(course, run, 1), begin_mm=SET_MM, set_mm=SET_MM, seed=1)
    matrix, by_target = closed_loop(run.gain)
    held = round(1 / run.rate_hz / TICK_S)
    powers = [np.linalg.matrix_power(matrix, n) for n in range(held + 1)]
    driven = sum(power @ by_target for power in powers[:-1])
    noise = run.noise_mm**2 * np.outer(driven, driven)
    variance = solve_discrete_lyapunov(powers[-1], noise)[0, 0]
    arrivals = rows.d_mm[40::held] - SET_MM
    # 6,000 frames, nearly independent: the variance is known to sqrt(2/6000) = 1.8 %; four of them.
    assert np.mean(np.square(arrivals)) == pytest.approx(variance, rel=0.075)


@pytest.mark.parametrize(("dark_s", "withdraws"), [(0.1, False), (0.6, True)])
def test_an_arm_holds_for_a_while_without_readings_and_then_withdraws(dark_s, withdraws):
    run = LoopRun(tremor_mm=0.0, foreknown=0.0, dark_s=(0.5, 0.5 + dark_s))
    course = flat(0.5 + dark_s)
    rows = simulated(run, course, perfect(course, run, 0), begin_mm=2.0, set_mm=SET_MM, seed=0)
    assert rows.lost.any() == withdraws
    assert (rows.d_mm.iloc[-1] > SET_MM + 0.1) == withdraws


def test_the_guard_keeps_an_arm_from_the_wall():
    run = LoopRun(tremor_mm=0.0, foreknown=0.0)
    course = flat(2.0)
    # The wall comes by 3 mm/s. That is the arm's way in the delay, and in 1/gain, of 0.5 mm.
    coming = course._replace(depth_mm=DEPTH_MM - 3.0 * np.clip(course.time_s - 1.0, 0.0, 0.5))
    rows = simulated(run, coming, perfect(coming, run, 0), begin_mm=1.2, set_mm=1.2, seed=0)
    assert rows.near.any()
    assert rows.d_mm.min() > 0.0


def test_poses_that_are_old_lag_by_the_way_of_the_arm():
    course, ends = flat(4.0), []
    # The wall goes away by 0.5 mm/s, so in the end the arm follows as fast.
    leaving = course._replace(depth_mm=DEPTH_MM + 0.5 * course.time_s)
    for late_s in (0.0, 0.04):
        run = LoopRun(tremor_mm=0.0, foreknown=0.0, late_s=late_s)
        rows = simulated(run, leaving, perfect(leaving, run, 0), begin_mm=2.0, seed=0)
        ends.append(rows.d_mm[rows.time_s > 3.5].mean())
    # A reading is placed 0.5 mm/s x 0.04 s too near, so the distance settles as much farther. The
    # steps of frames and ticks shift both alike.
    assert ends[1] - ends[0] == pytest.approx(0.02, abs=1e-4)


def test_the_course_keeps_its_speed_along_the_wall():
    scene = scenes.load_scene(None, ("source.kind=cone",))
    course = Course.of(scene, LoopRun(speed_mm_s=1.0), 0.5)
    spots = course.trocar + course.depth_mm[:, None] * course.axis
    assert np.linalg.norm(spots, axis=1) == pytest.approx(11.5, abs=1e-9)
    ways = np.linalg.norm(np.diff(spots, axis=0), axis=1) / TICK_S
    # Chords of 5 um on a sphere of 11.5 mm are arcs within 1e-8.
    assert ways == pytest.approx(1.0, rel=1e-6)


@pytest.mark.slow
def test_a_quick_run_keeps_the_distance_without_contact(tmp_path):
    errors = loop.loop(out=tmp_path / "run", quick=True).set_index("run")
    assert errors.nearest_mm.min() > 0
    # The phantom of the paper's successor was kept to 0.1 mm.
    assert errors.rms_mm[["perfect sensor", "sub-pixel", "pixels"]].max() < 0.1
