"""`eyespot fit --model image` and `--model lens`: one stack in, a calibration out."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tomli_w

import eyespot
from eyespot import optics, scenes
from eyespot.calibration.command.pixel_models import pixel_residuals
from eyespot.calibration.least_squares import covariance_and_lost, propagated
from eyespot.calibration.pixels.data import footage_of
from eyespot.calibration.pixels.fit import fit_image
from eyespot.estimator.distance.ranger import Ranger
from eyespot.estimator.recording import Recording
from eyespot.formats.calibration import read_calibration
from eyespot.formats.microscope import read_microscope
from eyespot.optics.wall_light.lens_flux import lens_parameters
from tests.support.command_line import printed
from tests.support.drawn.made_up import DOME, a_spot
from tests.support.drawn.scene_tables import scene_of
from tests.support.files.fit_files import assert_within

ELLIPSE = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")
HALF_ANGLE, B = math.atan(1 / 20), -5.117


@pytest.mark.parametrize("side", [1, 4])
def test_maps_of_noise_alone_have_variance_one(side):
    rng = np.random.default_rng(5)
    of_squares = rng.normal(size=(60, 96 // side, 120 // side))
    residuals = np.kron(of_squares, np.ones((1, side, side)))
    residuals[:, :, :24] = np.nan
    residuals[30:, :12] = np.nan
    residuals[7] = np.nan
    fit: Any = SimpleNamespace(residuals=residuals, side=side, misfit=None)
    shown = pixel_residuals(fit)
    assert shown.frames.tolist() == [n for n in range(60) if n != 7]
    # Variance of 59 normal numbers, to four of its standard errors.
    assert np.mean(shown.of_frames**2) == pytest.approx(1.0, abs=4 * math.sqrt(2 / 59))
    assert shown.groups == [(0, 10), (11, 20), (21, 30), (31, 40), (41, 50), (51, 59)]
    assert np.isnan(shown.maps[:, :, :24]).all()
    # Smoothing leaves about (96 x 96)/(4 pi 3²) independent numbers a map, of six maps; the
    # smoothing's own error where a square is wider than its sigma is a few percent.
    assert np.nanmean(shown.maps**2) == pytest.approx(1.0, abs=4 * math.sqrt(2 / (6 * 81)) + 0.05)


def test_what_follows_an_undetermined_parameter_is_undetermined():
    follows = np.array([[1.0, 0.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    covariance = np.diag([0.04, 0.01, np.inf])
    covariance[2, :] = covariance[:, 2] = np.inf
    found = propagated(follows, covariance)
    # var(x + 2y) = 0.04 + 4 * 0.01, cov(x, x + 2y) = 0.04
    np.testing.assert_allclose(found[:2, :2], [[0.04, 0.04], [0.04, 0.08]], rtol=1e-12)
    assert np.isinf(found[2]).all() and np.isinf(found[:, 2]).all()


NAMES = ("half_angle", "b", "scale")


@pytest.mark.parametrize(
    ("seen", "values", "told"),
    [
        # d(log a) - d(log s) is seen: the ratio; with a plus, the product.
        (((0, 1, 0), (1, 0, -1)), (0.05, -5.0, 0.0067), "only the ratio of half_angle and scale"),
        (((0, 1, 0), (1, 0, 1)), (0.05, -5.0, 0.0067), "only the product of half_angle and scale"),
        # A negative parameter grows downwards.
        (((0, 0, 1), (1, 1, 0)), (0.05, -5.0, 0.0067), "only the ratio of half_angle and b"),
        (((0, 0, 1), (1, 3, 0)), (0.05, -5.0, 0.0067), "only a combination of half_angle and b"),
        (((1, 0, 0), (0, 1, 0)), (0.05, -5.0, 0.0067), "scale is not determined"),
    ],
)
def test_what_is_not_seen_is_said_with_a_remedy(seen, values, told):
    covariance, lost = covariance_and_lost(1e6 * np.transpose(seen) @ seen, NAMES, values)
    assert len(lost) == 1
    assert lost[0].startswith(told)
    assert "fix one, give a prior, or add" in lost[0]
    hidden = [name in told for name in NAMES]
    assert np.isinf(np.diag(covariance)[hidden]).all()
    assert np.isfinite(np.diag(covariance)[np.logical_not(hidden)]).all()


def render(folder, *, source, scale, samples, wall="uniform"):
    scene = {
        "seed": 3,
        "phantom": {"wall": wall},
        "source": source,
        "spot": {"eccentricity_mm": 2.0},
        "motion": {"travel_mm": 5.0, "frames": 10},
        "microscope": {"width_px": 128, "height_px": 128, "scale_mm_px": scale, "samples": samples},
        "exposures": {"kinds": ["metered"]},
    }
    return scenes.render_stack(scene_of(scene), folder)


@pytest.fixture(scope="module")
def cone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pixels") / "cone"
    return render(folder, source={"kind": "cone"}, scale=0.02, samples=64)


def again(frames, images, whole, **keys):
    """A recording of these images at the frames' times, with keys of its rig changed."""
    return Recording(
        np.array(images),
        times=[frame.time_s for frame in frames],
        exposure_s=[frame.exposure_s for frame in frames],
        poses=whole.robot(),
        rig=whole.rig.changed(keys),
    )


@pytest.mark.slow
def test_the_cone_is_found_in_pixels(cone, tmp_path):
    out = tmp_path / "cone.json"
    printed("fit", cone.folder, "--model", "image", "--out", out)
    found = read_calibration(out)
    assert found.model == "exact"
    assert found.fitted_on.description == "10 frames of cone"
    assert_within(found, {"half_angle": HALF_ANGLE, "b": B}, 3)
    # Asked of rendered frames with camera noise.
    assert found.values["half_angle"] == pytest.approx(HALF_ANGLE, rel=0.003)
    page = out.with_suffix(".html").read_text()
    assert "<b>A good fit.</b>" in page
    assert "Maps of residuals for groups of frames" in page


@pytest.mark.slow
@pytest.mark.parametrize("known", ["distance", "core"])
def test_the_cone_is_found_in_pixels_of_a_recording_that_begins_far_from_contact(cone, known):
    whole = Recording.open(cone)
    frames = [*whole.source][3:]
    keys: dict[str, Any] = {"robot.touch": [cone.labels[3].d_mm, 0.02]}
    if known == "core":
        keys = {"robot.touch": "free", "instrument.core_radius_mm": -B * math.tan(HALF_ANGLE)}
    recording = again(frames, [frame.image for frame in frames], whole, **keys)
    found = eyespot.fit(recording, model="image").calibration
    assert_within(found, {"half_angle": HALF_ANGLE, "b": B}, 3)
    # b is known as well as the distance, 0.02 mm, or as the core, 1 %.
    assert found.sigma("b") == pytest.approx({"distance": 0.02, "core": 0.0512}[known], rel=0.3)


@pytest.mark.slow
def test_a_ghost_of_the_spot_is_said(cone):
    whole = Recording.open(cone)
    frames = [*whole.source]
    images = np.array([frame.image for frame in frames]).astype(float)
    dark = np.median(images, axis=(1, 2), keepdims=True)
    ghost = 0.15 * np.roll(np.maximum(images - dark, 0.0), (8, 22), axis=(1, 2))
    seen = np.clip(images + ghost, 0, 255).round().astype(np.uint8)
    fit = eyespot.fit(again(frames, seen, whole), model="image")
    assert not fit.good
    assert "the spot has a ghost" in fit.verdict


@pytest.mark.slow  # the lens's light takes a minute to compute
@pytest.mark.parametrize("wall", ["printed paper", "retina", "photograph"])
def test_a_lens_is_found_over_a_wall_that_nobody_knows(tmp_path, wall):
    source = {"kind": "lens", "lens": "dome", "medium": "air"}
    textured = render(tmp_path / "lens", source=source, scale=0.03, samples=16, wall=wall)
    dome = lens_parameters(optics.load_lens("dome"))
    start = dome | {"sag": 0.09, "numerical_aperture": 0.24}
    metered = Recording.open(textured, exposure="metered")
    fit = fit_image(footage_of(metered), source="lens", start=start)
    assert fit.converged
    assert fit.textured
    truth = {name: dome[name] for name in ("sag", "numerical_aperture")}
    assert_within(fit, truth, 3)
    assert all(fit.parameters[name][1] < 0.01 * true for name, true in truth.items())


@pytest.mark.slow  # most of it for the lens's light, to render, to fit and to range with
def test_a_lens_found_in_pixels_ranges_the_spots_that_it_makes(tmp_path):
    dome = optics.load_lens("dome")
    source = {"kind": "lens", "lens": "dome", "medium": "air"}
    stack = render(tmp_path / "lens", source=source, scale=0.03, samples=16)
    start, out = tmp_path / "start.toml", tmp_path / "lens.json"
    other = DOME | {"sag": 0.10, "glue_length": 0.10, "numerical_aperture": 0.23}
    start.write_text(tomli_w.dumps({"schema": 1, "lens": other}))
    printed("fit", stack.folder, "--model", "lens", "--lens", start, "--out", out)
    found = read_calibration(out)
    for name in ("sag", "glue_length", "numerical_aperture"):
        assert 0 < abs(found.values[name] - float(getattr(dome, name))) < 3 * found.sigma(name)
    assert found.sigma("core_radius") == 0
    ranger = Ranger(found, read_microscope(stack.folder / "microscope.json"))
    for label in stack.labels[2:]:
        # The label's contour: small frames hold no dark wall round the bell's tails to measure by.
        contour = (getattr(label, f"half_max_{name}") for name in ELLIPSE)
        covariance = np.diag([0.01, 0.01, 0.01, 0.01, 0.001]) ** 2
        result = ranger.distance(a_spot(*contour, covariance=covariance))
        assert abs(result.distance_mm - label.d_mm) < 4 * result.sigma_mm
        assert result.sigma_mm < 0.05
