"""Distances through a contact lens and the eye's own lens: what each model makes of the spots."""

import math

import numpy as np
import pytest

from eyespot import optics
from eyespot.estimator.distance.ranger import Ranger
from eyespot.formats.microscope import PathSeries
from eyespot.optics import viewing
from tests.estimator.test_ranger import B, K, calibration, spot
from tests.support.drawn.exact_spots import exact_spots
from tests.support.drawn.made_up import a_microscope

pytestmark = pytest.mark.usefixtures("fast_compilation")

KAPPA = -0.0554
"""1/mm, of the pinhole that fits this path best up to c = 4 mm (eyespot.benchmarks.studies.eye)."""


@pytest.fixture(scope="module")
def path_camera():
    """Navarro's eye behind a flat contact lens; the pupil hides nothing."""
    eye = viewing.load_eye("navarro", wavelength_nm=555.0)
    path = viewing.viewing_path(
        eye, viewing.load_viewing_lens("flat"), pinhole_distance=203.0, pupil_radius=50.0
    )
    return viewing.path_camera(path, scale=0.0067)


def file_of(camera, **changed):
    given = {
        "scale_mm_px": float(camera.scale),
        "principal_point_px": (0.0, 0.0),
        "pinhole_height_mm": float(1 / camera.inverse_working_distance + camera.pole_height),
        "eye_radius_mm": -float(camera.pole_height),
        "viewing_path": PathSeries(
            crossing=camera.crossing.tolist(),
            steepness_per_mm=camera.steepness.tolist(),
            transmittance=camera.passing.tolist(),
            widest_mm=float(camera.widest),
            orientation=1.0,
        ),
        "retina_semi_axes_mm": (12.0, 12.0, 12.0),
    }
    return a_microscope(**given | changed)


def seen(camera, c, d, *, incidence_deg=0.0, towards_deg=0.0):
    place = (c, 0.7, math.radians(incidence_deg), math.radians(towards_deg), d)
    ellipses, beams = exact_spots(optics.Ellipsoid(np.full(3, 12.0)), camera, [place])
    (centre,), (major,), (minor,), (angle,) = ellipses
    return spot(*centre, major, minor, angle), beams.axis[0]


ALL_TILTS = [(0.0, 0.0), (30.0, 0.0), (30.0, 90.0), (30.0, 180.0)]


@pytest.mark.parametrize("model", [pytest.param("exact", marks=pytest.mark.slow), "area"])
def test_through_a_known_path_the_distance_returns_at_every_tilt(path_camera, model):
    """The solvers end below 1e-6 mm; the ellipse of 32 points is within 1e-7 px of 128."""
    ranger = Ranger(calibration(), file_of(path_camera), model=model)
    for c in (1.0, 4.0):
        for incidence, towards in ALL_TILTS:
            for d in (1.0, 5.0):
                one, axis = seen(path_camera, c, d, incidence_deg=incidence, towards_deg=towards)
                read = ranger.distance(one, axis=axis).distance_mm
                assert read == pytest.approx(d, abs=1e-5), (c, incidence, towards)


def test_corrected_takes_the_paths_own_magnification(path_camera):
    ranger = Ranger(calibration(), file_of(path_camera), model="corrected")
    for c in (0.0, 1.0, 2.0, 3.0, 4.0):
        for d in (1.0, 3.0, 5.0):
            one, _ = seen(path_camera, c, d)
            # A spot of radius R = 0.5 mm is not small: magnification changes over it by
            # (R/c)^2 of its change up to c, 0.2 at c = 4: below 0.3 % of d - b.
            assert ranger.distance(one).distance_mm == pytest.approx(d, abs=0.03), c


def test_a_calibrated_pinhole_goes_before_the_path(path_camera):
    """At c = 4 mm `small_plane` is off by 1.5 mm (an independent trace: benchmarks/test_study_eye).

    A pinhole stands for the path within 0.05 mm; with its ellipse's area also at 30 degrees, where
    the semi-minor axis is off by a millimetre and more.
    """
    fitted = calibration(k=K, b=B, scale=0.0067, inverse_working_distance=KAPPA, eye_radius=12.0)
    corrected = Ranger(fitted, file_of(path_camera), model="corrected")
    assert corrected.microscope.viewing_path is None
    area = Ranger(fitted, file_of(path_camera), model="area")
    paper = Ranger(calibration(), file_of(path_camera), model="small_plane")
    for c in (1.0, 2.0, 3.0, 4.0):
        one, _ = seen(path_camera, c, 2.0)
        assert corrected.distance(one).distance_mm == pytest.approx(2.0, abs=0.05), c
        for incidence, towards in ALL_TILTS:
            one, axis = seen(path_camera, c, 2.0, incidence_deg=incidence, towards_deg=towards)
            assert area.distance(one, axis=axis).distance_mm == pytest.approx(2.0, abs=0.05), c
    one, _ = seen(path_camera, 4.0, 2.0)
    assert paper.distance(one).distance_mm == pytest.approx(2.0 - 1.49, abs=0.05)
    tilted, _ = seen(path_camera, 4.0, 2.0, incidence_deg=30.0, towards_deg=180.0)
    assert corrected.distance(tilted).distance_mm > 3.0


def test_a_spot_outside_the_field_has_no_distance(path_camera):
    for model in ("corrected", "area"):
        ranger = Ranger(calibration(), file_of(path_camera), model=model)
        outside = spot(5000.0, 0.0, 60.0, 50.0)
        down = np.array([0.0, 0.0, -1.0])
        assert math.isnan(ranger.distance(outside, axis=down).distance_mm)


def test_without_an_axis_the_area_gives_no_distance(path_camera):
    ranger = Ranger(calibration(), file_of(path_camera), model="area")
    one, _ = seen(path_camera, 2.0, 3.0)
    assert math.isnan(ranger.distance(one).distance_mm)


def test_the_areas_sigma_is_the_spread_of_noisy_repeats(path_camera):
    noise = np.random.default_rng(3)
    values = {"k": K, "b": B, "scale": 0.0067, "inverse_working_distance": KAPPA}
    values |= {"eye_radius": 12.0}
    sigmas = np.array([0.05, 0.02, 1e-5, 0.002, 0.5])
    correlation = 0.6 ** np.abs(np.subtract.outer(range(5), range(5)))
    covariance = correlation * np.outer(sigmas, sigmas)
    clean, axis = seen(path_camera, 3.0, 4.0, incidence_deg=30.0, towards_deg=40.0)
    of_spot = np.diag([0.1, 0.1, 0.3, 0.2, 0.01]) ** 2
    across = np.linalg.svd(axis[None])[2][1:]
    off = math.radians(1.0)

    def read(ranger, values, ellipse, direction):
        measured = spot(*ellipse, covariance=of_spot)
        return ranger.distance(measured, axis=direction, axis_sigma_rad=off)

    ellipse = np.array(clean.ellipse)
    ranger = Ranger(
        calibration(covariance=covariance, **values), file_of(path_camera), model="area"
    )
    said = read(ranger, values, ellipse, axis)
    count = 60
    found = []
    for _ in range(count):
        drawn = noise.multivariate_normal(list(values.values()), covariance)
        other = Ranger(
            calibration(**dict(zip(values, drawn.tolist(), strict=True))),
            file_of(path_camera),
            model="area",
        )
        turned = axis + off * noise.standard_normal(2) @ across
        moved = ellipse + noise.multivariate_normal(np.zeros(5), of_spot)
        found.append(read(other, values, moved, turned / np.linalg.norm(turned)).distance_mm)
    # A standard deviation of n normal numbers is known to 1/sqrt(2n); four of these.
    assert np.std(found) == pytest.approx(said.sigma_mm, rel=4 / math.sqrt(2 * count))
    assert np.mean(found) == pytest.approx(said.distance_mm, abs=4 * said.sigma_mm / count**0.5)
