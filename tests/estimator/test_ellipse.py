import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eyespot.estimator.detector.ellipse_rays import (
    AffineEllipse,
    covariance_of_axes,
    offset_design,
    refitted,
    robust_step,
)

_ANGLES = np.linspace(0, 2 * np.pi, 192, endpoint=False)
_DESIGN = offset_design(np.cos(_ANGLES), np.sin(_ANGLES))

axes = st.floats(5, 200)
angles = st.floats(-math.pi / 2 + 1e-3, math.pi / 2 - 1e-3)


@given(minor=axes, ratio=st.floats(1.01, 3), angle=angles)
def test_axes_and_angle_come_back(minor, ratio, angle):
    a, b, back = AffineEllipse.from_axes(3, 4, minor * ratio, minor, angle).axes
    # float64 through squares of lengths: 1e-9 relative, the angle divided by the axes' difference.
    assert a == pytest.approx(minor * ratio, rel=1e-9)
    assert b == pytest.approx(minor, rel=1e-9)
    assert back == pytest.approx(angle, abs=1e-6)


def test_vertical_major_axis_has_angle_plus_half_pi():
    for angle in (math.pi / 2, -math.pi / 2):
        assert AffineEllipse.from_axes(0, 0, 2, 1, angle).axes[2] == pytest.approx(math.pi / 2)


def _radius(ellipse: AffineEllipse, about: AffineEllipse) -> np.ndarray:
    """Radius of one ellipse's points along the rays of another, by bisection."""
    low, high = np.full(_ANGLES.size, 0.5), np.full(_ANGLES.size, 2.0)
    direction = about.shape @ np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])
    for _ in range(60):
        middle = (low + high) / 2
        points = about.centre[:, None] + middle * direction - ellipse.centre[:, None]
        inside = np.hypot(*np.linalg.solve(ellipse.shape, points)) < 1
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return (low + high) / 2


def test_a_step_moves_the_edge_as_the_design_says():
    start = AffineEllipse.from_axes(100, 80, 70, 50, 0.4)
    rng = np.random.default_rng(0)
    for _ in range(5):
        step = rng.normal(0, 1e-4, 5)
        moved = _radius(start.stepped(step), start) - 1
        # Second-order terms are of the order of the step squared, 1e-8 times a few.
        np.testing.assert_allclose(moved, _DESIGN @ step, atol=2e-7)


def test_a_quarter_of_the_ring_takes_over_where_trimming_starts_from_another_ellipse():
    step, other = np.array([0.05, 0.02, 0.0, 0.03, -0.01]), np.array([0.0, 0.0, -0.3, -0.3, 0.0])
    first = np.arange(_ANGLES.size) < 70  # 36 %
    offsets = np.where(first, _DESIGN @ other, _DESIGN @ step)
    found = robust_step(_DESIGN, offsets, first | True, first, tolerance=0.005, limit=0.1)
    assert found is not None
    # The remaining offsets are exact; the least squares are kept solvable by 1e-6.
    np.testing.assert_allclose(found[0], step, atol=1e-6)


def test_refit_of_exact_points_is_exact():
    truth = AffineEllipse.from_axes(51, 47, 40, 30, -0.7)
    start = AffineEllipse.from_axes(50, 48, 39, 31, -0.6)
    points = truth.centre + (truth.shape @ np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])).T
    found = refitted(start, points)
    np.testing.assert_allclose(found.centre, truth.centre, atol=1e-6)
    np.testing.assert_allclose(found.axes, truth.axes, atol=1e-6)


def test_covariance_of_axes_is_the_step_covariance_propagated():
    rng = np.random.default_rng(3)
    root = rng.normal(0, 1e-4, (5, 5))
    # A shape whose columns are not the axes, as refinement leaves it.
    turn = np.array([[math.cos(0.8), -math.sin(0.8)], [math.sin(0.8), math.cos(0.8)]])
    start = AffineEllipse.from_axes(10, 20, 70, 50, 0.3)
    ellipse = AffineEllipse(start.centre, start.shape @ turn)
    steps = rng.standard_normal((4000, 5)) @ root.T
    samples = []
    for step in steps:
        moved = ellipse.stepped(step)
        samples.append([*moved.centre, *moved.axes])
    predicted = covariance_of_axes(ellipse, root @ root.T)
    sampled = np.cov(np.array(samples).T)
    scale = np.sqrt(np.outer(predicted.diagonal(), predicted.diagonal()))
    # 4000 samples: covariances are known to 1 / sqrt(4000) = 1.6 % of the scale, 4 sigma.
    np.testing.assert_allclose(sampled / scale, predicted / scale, atol=0.065)


def test_a_circle_has_a_finite_covariance():
    circle = AffineEllipse.from_axes(0, 0, 50, 50, 0)
    assert np.isfinite(covariance_of_axes(circle, 1e-8 * np.eye(5))).all()


def test_covariance_of_a_contour_is_that_of_its_harmonics():
    # docs/theory/bounds.md derives the factors from the harmonics 0, 1 and 2 of a circle.
    n = 96
    t = np.arange(n) * (2 * math.pi / n)
    design = offset_design(np.cos(t), np.sin(t))
    circle = AffineEllipse.from_axes(0.0, 0.0, 1.0, 1.0, 0.0)
    step = np.linalg.inv(design.T @ design)
    covariance = covariance_of_axes(circle, step)
    x, y, major, minor = np.diag(covariance)[:4]
    # Equal to rounding: the sums of the harmonics' squares are exact on an even grid.
    np.testing.assert_allclose([x, y, major, minor], np.array([2, 2, 3, 3]) / n, rtol=1e-9)
    assert covariance[2, 3] == pytest.approx(-1 / n, rel=1e-9)
    both = np.array([0, 0, 0.5, 0.5, 0])
    assert both @ covariance @ both == pytest.approx(1 / n, rel=1e-9)
