"""Standard errors of lens fits hold for light that comes from elsewhere, also if it is unusual.

Hours of fits, each a line in a file of pytest's cache, so that a run that was killed goes on.
`python -m tests.photon_fits` prints the same as tables.
"""

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import calibration
import eyespot
import optics
from estimator.files import read_calibration
from tests.photon_fits import (
    PARAMETERS,
    binomial_limits,
    coverage,
    departures,
    inside,
    random_recording,
)
from tests.photon_stacks import (
    Recording,
    footage_of,
    frames_of,
    half_maximum,
    light_of,
    photographs,
    poses,
    write_photons,
)
from tests.photons import Drop

FITS = 200


@pytest.fixture
def results(request):
    """File of finished fits, new for every version of the code that is tested."""
    packages = (Path(module.__file__ or "").parent for module in (calibration, optics))
    files = [Path(__file__), *sorted(path for root in packages for path in root.rglob("*.py"))]
    version = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]
    folder = request.config.cache.mkdir("photon_fits")
    return lambda name: folder / f"{name}-{version}.jsonl"


@pytest.mark.slow  # an hour or more on two cores
def test_intervals_contain_the_lens_as_often_as_they_say(results):
    rows = coverage(results("coverage"), FITS)
    assert sum(row["good"] for row in rows.values()) > 0.9 * FITS
    for name in PARAMETERS:
        for sigmas in (1.0, 1.959964):
            count, total = inside(rows.values(), name, sigmas)
            low, high = binomial_limits(total, math.erf(sigmas / math.sqrt(2)))
            assert low <= count <= high, f"{name}: {count} of {total} within {sigmas} sigma"
        count, total = inside(rows.values(), name, 3.0)
        assert count >= 0.99 * total, f"{name}: {count} of {total} within 3 sigma"


@pytest.mark.slow  # half an hour on two cores
def test_light_that_the_model_does_not_know_is_refused_or_contained_in_sigma(results):
    for name, row in departures(results("departures")).items():
        for parameter in PARAMETERS:
            error, sigma = row[parameter]
            # Twice: the noise, whose own share of the error is as large if nothing is enlarged.
            assert not row["good"] or abs(error) < 2 * sigma, f"{name}: {row['said']}"


@pytest.mark.slow  # a minute of it to compile
def test_a_lens_is_found_in_a_stack_of_files_that_photons_made(tmp_path):
    drop = Drop(core=0.25, aperture=0.30, sag=0.07, rim=0.04, aperture_na=0.15)
    recording = Recording(
        drop=drop, beam_off=(math.radians(0.3), 0.0), frames=8, width=96, height=72, scale=0.035
    )
    frames = frames_of(recording, light_of(recording, count=1 << 23))
    images = photographs(recording, frames, np.random.default_rng(5))
    stack = write_photons(tmp_path / "stack", recording, frames, images)
    start, out = tmp_path / "start.toml", tmp_path / "lens.json"
    start.write_text(
        f"schema = 1\n[lens]\ncore_radius = {drop.core}\naperture_radius = {drop.aperture}\n"
        f"glue_index = {drop.index}\nsag = {1.26 * drop.sag}\n"
        f"glue_length = {drop.rim + 1.26 * drop.sag}\n"
        f"numerical_aperture = {drop.aperture_na / 1.26}\n"
    )
    # The first frame is not at contact, which the command is told.
    first = frames.where.touch + recording.first
    arguments: list[Any] = ["fit", stack, "--model", "lens", "--lens", start, "--out", out]
    arguments += ["--prior", f"touch={first},0.02"]
    ran = CliRunner().invoke(eyespot.app, list(map(str, arguments)))
    assert ran.exit_code == 0, ran.output
    assert "A good fit" in ran.output
    found = read_calibration(out)
    truth = {"sag": drop.sag, "numerical_aperture": drop.aperture_na}
    for name, true in (truth | {"brightness": recording.brightness}).items():
        assert abs(found.values[name] - true) < 3 * found.sigma(name), name
        assert found.sigma(name) < 0.02 * true
    assert found.sigma_inflation >= 1
    assert "Maps of residuals for groups of frames" in out.with_suffix(".html").read_text()


def test_random_recordings_show_their_spots():
    for seed in range(3):
        recording = random_recording(seed)
        light = light_of(recording, count=1 << 17)
        frames = frames_of(recording, light)
        images = photographs(recording, frames, np.random.default_rng(seed))
        assert images.shape == (recording.frames, recording.height, recording.width, 3)
        footage = footage_of(recording, frames, images)
        assert footage.clear.mean() > 0.5
        # The brightest pixel lies at 70 % of full scale, and noise of 1.7 % is around it.
        assert 0.6 < np.median(footage.light.max(axis=(1, 2))) < 0.85


def test_drawn_spot_of_a_long_narrow_beam_has_the_size_of_its_geometry():
    # A flat end far away: photons leave a disc of radius a at up to asin NA, so half of the peak is
    # where half of the cone's disc reaches the core's disc; for d NA >> a it is at d tan(asin NA).
    drop = Drop(core=0.02, aperture=0.02, sag=0.0, rim=0.0, aperture_na=0.1)
    recording = Recording(
        drop=drop, incidence=0.0, first=8.0, last=8.0, frames=1, illumination=0.0, scale=0.02
    )
    frames = frames_of(recording, light_of(recording, count=1 << 20))
    contour = half_maximum(frames.radiance[0])
    radius = np.hypot(*(contour - [(160 - 1) / 2, (120 - 1) / 2]).T).mean() * recording.scale
    expected = float(np.linalg.norm(poses(recording).tips[0] - [0, 0, -11.5]))
    # The edge is 0.04 mm wide and cos⁴ falls by 1 % across the spot.
    assert radius == pytest.approx(expected * math.tan(math.asin(0.1)), rel=5e-3)
