"""The study of eccentricity: its chain is the eye's, its shares are Shapley's, its limits known."""

import itertools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from eyespot import optics, scenes
from eyespot.benchmarks.model_error import MODEL_ERROR, Geometry, readings
from eyespot.benchmarks.statistics import coalitions, shapley_values
from eyespot.benchmarks.studies import eccentricity, error_causes
from eyespot.benchmarks.studies.eccentricity import LIMITS_MM
from eyespot.benchmarks.studies.error_causes import CAUSES, WRONG_C_MM, WRONG_R_MM

pytestmark = pytest.mark.usefixtures("fast_compilation")

SCALE, K, B, R = 0.0067, 20.0, -5.117, 11.5
EDGE_PX, PIXELS_PX, SPREAD_PX = 0.03, -0.02, -0.5
MICROSCOPE, TELECENTRIC, SQUARE, ON_AXIS, CENTRED = range(5)
"""Geometries whose errors are split: see `worths`."""
C_MM = np.linspace(0.0, 8.0, 9)


def geometry(*, z_f: float, incidence_deg: float = 0.0) -> Geometry:
    return Geometry(
        scale=SCALE,
        pinhole_height=z_f,
        eye_radius=R,
        half_angle=math.atan(1 / K),
        apex_offset=B,
        incidence=math.radians(incidence_deg),
        incidence_azimuth=math.radians(60.0),
    )


@pytest.fixture(scope="module")
def worths():
    """Worth of every set of causes in five geometries at d = 4 mm."""
    shift = np.array([[EDGE_PX], [PIXELS_PX], [SPREAD_PX]])
    found = [
        error_causes.worths(
            geometry(z_f=z_f, incidence_deg=tilt), c=np.array([c]), d=np.array([4.0]), shift=shift
        )
        for z_f, tilt, c in (
            (200.0, 30.0, 4.0),
            (math.inf, 30.0, 4.0),
            (200.0, 0.0, 4.0),
            (200.0, 30.0, 0.0),
            (0.0, 0.0, 3.0),
        )
    ]
    return np.concatenate(found)


def share(worths: np.ndarray, where: int, model: str, cause: str) -> float:
    shares = shapley_values(worths[where, optics.MODELS.index(model)])
    return float(shares[CAUSES.index(cause)])


def test_the_chain_with_every_link_real_is_the_exact_geometry_and_so_is_its_inverse():
    rng = np.random.default_rng(3)
    n = 64
    columns = {
        "scale": np.full(n, SCALE),
        "pinhole_height": rng.choice([math.inf, 200.0, 11.5, 0.0], n),
        "eye_radius": rng.uniform(10.5, 12.5, n),
        "half_angle": np.radians(rng.uniform(2.0, 8.0, n)),
        "incidence": np.radians(rng.uniform(0.0, 45.0, n)),
        "incidence_azimuth": rng.uniform(0.0, 6.28, n),
    }
    columns["apex_offset"] = -0.256 / np.tan(columns["half_angle"])
    arrays: dict[str, Any] = {name: jnp.asarray(values) for name, values in columns.items()}
    eye = Geometry(**arrays)
    c, d = (jnp.asarray(rng.uniform(*ends, n)) for ends in ((0.0, 8.0), (0.5, 6.0)))

    @jax.jit
    @jax.vmap
    def both(eye: Geometry, c: jax.Array, d: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        wall, camera = eye.world
        seen = optics.exact_semi_minor(wall, camera, distance=d, eccentricity=c, **eye.beam)
        return seen, error_causes.semi_minor(eye, c, d), error_causes.inverse(eye, c, seen)

    expected, found, back = map(np.asarray, both(eye, c, d))
    # Both converge spectrally in the number of points, 64 and 128: 3e-12 is what was left.
    assert found == pytest.approx(expected, rel=1e-10)
    # 1e-10 of 60 px, 0.13 mm of distance to a px, and as much again for the secant.
    assert back == pytest.approx(np.asarray(d), abs=2e-9)


def test_with_every_link_ideal_all_models_are_right(worths):
    # Rounding of numbers near 10 mm.
    assert np.abs(worths[:, :, 0]).max() < 1e-11


def test_a_square_spot_has_an_ellipse_for_its_image_so_that_fitting_one_costs_nothing(worths):
    for where in (SQUARE, CENTRED):
        for model in optics.MODELS:
            # The width between tangents is found to 1e-6 of 10 mm; the image is a conic.
            assert abs(share(worths, where, model, "ellipse fit of a non-ellipse")) < 1e-5


def test_what_is_not_there_has_no_part_in_the_error(worths):
    for model in optics.MODELS:
        # Sums of 1,024 numbers of some mm.
        assert share(worths, SQUARE, model, "beam not square") == pytest.approx(0.0, abs=1e-12)
        if model != "stereographic":  # which takes every microscope for one on the sphere
            telecentric = share(worths, TELECENTRIC, model, "magnification with depth")
            assert telecentric == pytest.approx(0.0, abs=1e-12)
    # `planar` is told neither r nor c; on the axis the wall faces the microscope.
    for cause in ("wrong r", "wrong c"):
        assert share(worths, MICROSCOPE, "planar", cause) == pytest.approx(0.0, abs=1e-12)
    assert share(worths, ON_AXIS, "planar", "foreshortening") == pytest.approx(0.0, abs=1e-12)


def test_the_parts_sum_to_the_error_that_the_models_make_of_the_measured_spot(worths):
    for where, pinhole in ((MICROSCOPE, 200.0), (SQUARE, 200.0)):
        told = geometry(z_f=pinhole, incidence_deg=30.0 if where == MICROSCOPE else 0.0)
        wall, view = told.world
        size = optics.exact_semi_minor(wall, view, eccentricity=4.0, distance=4.0, **told.beam)
        seen = np.array([size + EDGE_PX + PIXELS_PX + SPREAD_PX])
        # The working distance z_F + r is the microscope's and stays.
        wrong = told._replace(eye_radius=R + WRONG_R_MM, pinhole_height=pinhole - WRONG_R_MM)
        c = 4.0 + WRONG_C_MM
        found = readings(wrong, optics.CLOSED_FORMS, c=np.array([c]), semi_minor_px=seen)
        at: dict[str, Any] = {"semi_minor_px": seen[0], "eccentricity": c}
        wall, view = wrong.world
        exact = optics.exact_distance(wall, view, **at, **wrong.beam)
        found["exact"] = np.asarray(exact)[None]
        for m, model in enumerate(optics.MODELS):
            parts = shapley_values(worths[where, m])
            # Solvers settle to 1e-9 mm.
            assert parts.sum() == pytest.approx(float(found[model][0] - 4.0), abs=1e-8)


def test_an_exact_model_told_the_truth_owes_nothing_to_geometry(worths):
    members = coalitions(len(CAUSES))
    geometric = members[:, len(error_causes.LINKS) :].sum(axis=1) == 0
    errors = worths[:, optics.MODELS.index("exact")][:, geometric]
    assert np.abs(errors).max() < 1e-8


def test_at_the_eyeballs_centre_magnification_makes_the_papers_factor_right(worths):
    small = worths[CENTRED, optics.MODELS.index("small_plane")]
    members = coalitions(len(CAUSES))

    def error(*real: str) -> float:
        wanted = [cause in real for cause in CAUSES]
        return float(small[np.flatnonzero((members == wanted).all(axis=1))[0]])

    both = error("foreshortening", "magnification with depth")
    # First order in 1 - cos(phi) = 0.035 of 9 mm is 0.31 mm; the derivation leaves 0.014 mm.
    assert abs(both) < 0.014
    assert error("foreshortening") < -0.3


def test_light_spread_in_the_wall_moves_a_square_cones_distance_by_a_tenth_of_a_millimetre():
    d = np.array([0.5, 2.0, 4.0, 6.0])
    moved = error_causes.spread_shift(geometry(z_f=200.0), c=np.zeros(4), d=d, length=0.05)
    # As an independent sum over an evenly lit disc has it (`optics/test_wall_spread`); a spot seen
    # from 200 mm has its size on the wall to the sagitta of 0.01 mm over 211 mm.
    assert K * SCALE * moved == pytest.approx([-0.148, -0.134, -0.110, -0.091], abs=1e-3)
    paper = error_causes.spread_length(scenes.load_scene(None))
    assert paper == pytest.approx(0.0244, abs=1e-4)
    own = scenes.load_scene(None, ["phantom.spread=own", "phantom.spread_mm=[0.1,0.05,0.02]"])
    assert error_causes.spread_length(own) == 0.05


def test_an_eyes_shape_costs_what_another_program_found():
    found = error_causes.of_an_eye(geometry(z_f=200.0)).set_index("c_mm")
    # By light and geometry of other code, over its own distances and directions.
    for name, others in (("shape_mm", (0.009, 0.07, 0.19)), ("tilted_mm", (0.07, 0.20, 0.44))):
        assert found[name].to_numpy() == pytest.approx(others, rel=0.1), name


def test_shares_are_the_mean_gain_over_all_orders_of_joining():
    worth = np.random.default_rng(0).normal(size=16)
    gains = np.zeros(4)
    orders = list(itertools.permutations(range(4)))
    for order in orders:
        inside = 0
        for player in order:
            joined = inside | 1 << player
            gains[player] += worth[joined] - worth[inside]
            inside = joined
    assert shapley_values(worth) == pytest.approx(gains / len(orders))
    assert shapley_values(worth).sum() == pytest.approx(worth[-1] - worth[0])


@pytest.fixture(scope="module")
def withdrawals():
    return {
        z_f: eccentricity.withdrawals(geometry(z_f=z_f), eccentricities=C_MM, medium="air")
        for z_f in (11.5, 200.0)
    }


def test_fitting_c_hides_the_error_where_the_right_factor_is_below_one(withdrawals):
    row = withdrawals[11.5][1].set_index("c_mm").loc[4.0]
    # The right factor is (1 + cos phi)/2, which a cos of another phi can be.
    cos_phi = math.sqrt(1 - (4.0 / R) ** 2)
    expected = R * math.sqrt(1 - ((1 + cos_phi) / 2) ** 2)
    # Second order: (R/r)^2 = 0.2 % of the factor, 7 % of 1 - factor and half of that of c.
    assert row.fitted_c_mm == pytest.approx(expected, rel=0.035)
    assert row.largest_error_mm > 0.3
    assert row.largest_residual_mm < 0.01
    assert row.hidden_mm == row.largest_error_mm - row.largest_residual_mm


def test_fitting_c_cannot_hide_it_where_the_right_factor_is_above_one(withdrawals):
    row = withdrawals[200.0][1].set_index("c_mm").loc[4.0]
    assert row.at_bound
    assert row.fitted_c_mm < 0.01 * R
    assert row.largest_residual_mm > 0.5


def test_a_microscope_leaves_the_limits_sooner_than_a_pinhole_on_the_sphere(withdrawals):
    every = pd.concat([errors for errors, _ in withdrawals.values()])
    rows = eccentricity.limits(every)
    found = rows.set_index(["z_f_mm", "model", "limit_mm"]).c_mm
    for limit in LIMITS_MM:
        near, far = found[11.5, "small_plane", limit], found[200.0, "small_plane", limit]
        assert far < near
        # A row just below and one just above, linear between them.
        assert 0 < far < 8
    for model in ("corrected", "exact"):
        assert math.isnan(found[200.0, model, 0.5])


@pytest.mark.slow
def test_a_quick_run_finds_what_is_known_and_resumes(tmp_path, monkeypatch):
    tables = eccentricity.eccentricity(out=tmp_path / "run", quick=True)
    measured = tables["rendered"]
    # Of 2 x (3 tilted + 2 square) withdrawals with 3 frames, all models.
    assert len(measured) == 2 * 5 * 3 * len(optics.MODELS)
    worst = measured.error_mm.abs().groupby(measured.model).max()
    # Spots good to 0.1 px are distances good to k delta 0.1 px = 0.013 mm.
    assert worst["exact"] < 0.015
    assert worst["small_plane"] > 1.5
    by_spot = tables["causes"].groupby(["model", "z_f_mm", "c_mm", "d_mm"])
    for _, parts in by_spot:
        assert parts.cause.tolist() == list(CAUSES)
        assert parts.part_mm.sum() == pytest.approx(parts.whole_mm.iloc[0], abs=1e-9)
    rows = pd.read_csv(tmp_path / "run" / "model_error.csv")
    assert list(rows) == MODEL_ERROR
    for name in ("report.html", "model_error.csv", "limits.csv", "refit.csv", "causes.csv"):
        assert (tmp_path / "run" / name).stat().st_size > 0

    def never(*args: object, **kwargs: object) -> None:
        raise AssertionError("a finished stack was rendered again")

    monkeypatch.setattr(scenes, "render_stack", never)
    again = eccentricity.eccentricity(out=tmp_path / "run", quick=True)
    pd.testing.assert_frame_equal(again["rendered"], tables["rendered"])
