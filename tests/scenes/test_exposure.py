"""The camera against EMVA 1288's own measurements and closed forms, on images of known light."""

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import poisson

from eyespot.scenes.description.scene_keys import CameraSettings
from eyespot.scenes.sensor import (
    after_jpeg,
    demosaiced,
    expose,
    fixed_patterns,
    full_wells,
    metered_exposure,
    mosaic,
)

SIDE = 512


def photograph(level, *, settings, seed, shape=(SIDE, SIDE), patterns=None):
    """Frame of a uniform wall whose light is a fraction of the full well."""
    rng = np.random.default_rng(seed)
    wall = np.full(shape, level, np.float32)
    return expose(wall, exposure=1.0, settings=settings, rng=rng, patterns=patterns)


def temporal_variance(level, *, settings, seed, **kwargs):
    """EMVA 1288's: half the variance of the difference of two frames, less that of rounding."""
    if settings.bayer != "none":
        kwargs["shape"] = (2 * SIDE, 2 * SIDE, 3)
    first, second = (
        photograph(level, settings=settings, seed=(seed, frame), **kwargs).astype(float)
        for frame in (0, 1)
    )
    if settings.bayer != "none":  # the green pixels of a red row, whose colour is not interpolated
        first, second = (frame[::2, 1::2, 1] for frame in (first, second))
    return (first - second).var() / 2 - 1 / 12, (first + second).mean() / 2


@pytest.mark.parametrize(
    "settings",
    [
        CameraSettings(read_noise_e=20.0, black_level_dn=8.0),
        CameraSettings(bit_depth=10, black_level_dn=64.0),
        CameraSettings(bit_depth=12, full_well_e=12_000.0, black_level_dn=100.0),
        CameraSettings(bit_depth=16, full_well_e=30_000.0, read_noise_e=5.0, black_level_dn=500.0),
        CameraSettings(bit_depth=12, full_well_e=12_000.0, black_level_dn=100.0, bayer="RGGB"),
    ],
    ids=lambda s: f"{s.bit_depth} bits, {s.bayer}",
)
def test_the_photon_transfer_curve_gives_back_gain_and_read_noise(settings):
    # n = 2^18 pixels a level: a variance from two frames has a relative deviation of sqrt(2/n) =
    # 0.28 %, the slope over 6 levels about 0.12 %; the dark deviation has 1/sqrt(2 n) = 0.14 %.
    # So 1 % is seven of its standard deviations, and it is what the standard's users quote.
    levels = np.linspace(0.05, 0.9, 6)
    points = [temporal_variance(x, settings=settings, seed=i) for i, x in enumerate(levels)]
    variance, mean = np.transpose(points)
    dark_variance, dark_mean = temporal_variance(0.0, settings=settings, seed=99)
    excess, signal = variance - dark_variance, mean - dark_mean
    gain = (excess / signal).mean()  # every level weighs alike: its relative deviation is the same

    true_gain = (2**settings.bit_depth - 1 - settings.black_level_dn) / settings.full_well_e
    assert gain == pytest.approx(true_gain, rel=0.01)
    assert math.sqrt(dark_variance) / gain == pytest.approx(settings.read_noise_e, rel=0.01)
    assert dark_mean == pytest.approx(settings.black_level_dn, abs=0.02)


def test_light_beyond_the_full_well_is_full_scale():
    for bit_depth, dtype in ((8, np.uint8), (9, np.uint16), (16, np.uint16)):
        frame = photograph(3.0, settings=CameraSettings(bit_depth=bit_depth), seed=2)
        assert frame.dtype == dtype
        assert (frame == 2**bit_depth - 1).all()


# One electron is one digital number, so a frame is the counts themselves.
COUNTER = CameraSettings(full_well_e=65535.0, bit_depth=16, black_level_dn=0.0, read_noise_e=0.0)


@pytest.mark.parametrize("mean_e", [0.3, 3.0, 5.9, 6.1, 20.0, 49.5])
def test_few_electrons_are_counted(mean_e):
    n = 1 << 20
    counts = photograph(mean_e / 65535.0, settings=COUNTER, seed=(3, int(mean_e)), shape=(n,))
    expected = n * poisson.pmf(np.arange(200), mean_e)
    often = expected > 20  # the usual rule for the chi-squared test; all others make one class
    seen = np.bincount(counts, minlength=len(expected))
    classes = np.append(seen[often], n - seen[often].sum())
    model = np.append(expected[often], n - expected[often].sum())
    chi_squared, freedom = ((classes - model) ** 2 / model).sum(), len(model) - 1
    # Chi-squared has this mean and deviation; four of them.
    assert chi_squared < freedom + 4 * math.sqrt(2 * freedom)


def test_a_normal_number_passes_for_poisson_above_fifty_electrons():
    mean_e, n = 51.0, 1 << 20
    counts = photograph(mean_e / 65535.0, settings=COUNTER, seed=4, shape=(n,)).astype(float)
    # Edgeworth: with rounding for a continuity correction the two distributions differ by
    # skewness / 6 sqrt(2 pi) = 0.0093 at most, to first order in 1/sqrt(mean). The sample adds
    # 1.95 / sqrt(n) = 0.0019 (Kolmogorov, one in a thousand).
    k = np.arange(200)
    sampled = np.searchsorted(np.sort(counts), k, side="right") / n
    bound = 1 / math.sqrt(mean_e) / (6 * math.sqrt(2 * math.pi)) + 1.95 / math.sqrt(n)
    assert np.abs(sampled - poisson.cdf(k, mean_e)).max() < bound
    # Mean and variance are Poisson's; four deviations, and the rounding's variance of 1/12.
    assert counts.mean() == pytest.approx(mean_e, abs=4 * math.sqrt(mean_e / n))
    assert counts.var() - 1 / 12 == pytest.approx(mean_e, rel=4 * math.sqrt(2 / n))


@pytest.mark.parametrize("read_noise_e", [0.5, 2.0, 2.8, 10.0])
@pytest.mark.parametrize("mean_e", [1.0, 8.0, 30.0])
def test_no_more_skewness_is_missed_than_that_of_fifty_electrons(mean_e, read_noise_e):
    settings = CameraSettings(
        full_well_e=65535.0 / 16, bit_depth=16, black_level_dn=0.0, read_noise_e=read_noise_e
    )
    # Sixteen numbers an electron, and light enough of dark signal that none is cut off at zero.
    light = np.full((400, 500), mean_e / settings.full_well_e)
    black = settings.model_copy(update={"black_level_dn": 2000.0})
    rng = np.random.default_rng(6)
    electrons = (expose(light, exposure=1.0, settings=black, rng=rng) - 2000.0) / black.system_gain
    variance = mean_e + read_noise_e**2
    found = np.mean((electrons - mean_e) ** 3) / variance**1.5
    # The error of a skewness of 200,000 samples is sqrt(6/200,000) = 0.0055, twice of it if skewed.
    assert abs(found - mean_e / variance**1.5) < 1 / math.sqrt(50) + 0.03
    assert electrons.mean() == pytest.approx(mean_e, abs=5 * math.sqrt(variance / light.size))
    assert electrons.var() == pytest.approx(variance, rel=0.02)


def test_dark_signal_adds_its_mean_and_its_shot_noise():
    settings = CameraSettings(
        bit_depth=12, full_well_e=4000.0, dark_signal_e=30.0, read_noise_e=4.0, black_level_dn=95.0
    )  # one electron a digital number
    variance, mean = temporal_variance(0.0, settings=settings, seed=5)
    # Deviations: 0.01 DN of the mean, 0.28 % of the variance; four of each.
    assert mean == pytest.approx(95 + 30, abs=0.05)
    assert variance == pytest.approx(30 + 4**2, rel=0.012)


def test_fixed_patterns_stay_over_a_stack_and_have_their_size():
    settings = CameraSettings(bit_depth=12, prnu=0.02, dsnu_e=15.0, black_level_dn=200.0)
    shape = (128, 128, 3)
    patterns = fixed_patterns(settings=settings, shape=shape, seed=6)
    kwargs = {"settings": settings, "shape": shape, "patterns": patterns}

    def pattern(level, seeds):
        frames = [photograph(level, seed=seed, **kwargs).astype(float) for seed in seeds]
        mean = np.mean(frames, axis=0)
        return mean - mean.mean()

    for level, expected_e in ((0.0, 15.0), (0.6, math.hypot(0.6 * 5000 * 0.02, 15.0))):
        first, second = pattern(level, range(10, 30)), pattern(level, range(30, 50))
        # The temporal noise that is left in either half is independent, so the covariance is the
        # pattern's variance: n = 49,152 pixels, relative deviation below 1.5 %; four of those,
        # halved by the square root.
        covariance = (first * second).mean()
        assert math.sqrt(covariance) == pytest.approx(expected_e * settings.system_gain, rel=0.03)


def test_a_sensor_is_its_seed():
    settings = CameraSettings(prnu=0.01, dsnu_e=2.0)
    same, again, other = (
        fixed_patterns(settings=settings, shape=(32, 32), seed=seed) for seed in (1, 1, 2)
    )
    assert np.array_equal(same.gain, again.gain)
    assert np.array_equal(same.offset_e, again.offset_e)
    # Independent sensors: a correlation of 1,024 pixels has a deviation of 1/32; four of those.
    assert abs(np.corrcoef(same.gain.ravel(), other.gain.ravel())[0, 1]) < 4 / 32


def test_a_frame_is_its_seed_in_any_memory_layout():
    wall = np.linspace(0, 1, 60 * 80 * 3).reshape(60, 80, 3).astype(np.float32)
    frames = [
        expose(image, exposure=1.0, settings=CameraSettings(), rng=np.random.default_rng(7))
        for image in (wall, wall, np.asfortranarray(wall), wall.astype(np.float64))
    ]
    assert all(np.array_equal(frames[0], frame) for frame in frames[1:])
    other = expose(wall, exposure=1.0, settings=CameraSettings(), rng=np.random.default_rng(8))
    assert not np.array_equal(frames[0], other)


@pytest.mark.parametrize("response", ["linear", "srgb", 2.2, 0.8])
@pytest.mark.parametrize("bit_depth", [8, 10, 12])
def test_linearising_undoes_the_response(response, bit_depth):
    # A well of 1e12 electrons has a noise of 1e-6 of full scale and less.
    settings = CameraSettings(
        full_well_e=1e12, response=response, bit_depth=bit_depth, dark_signal_e=1e10
    )
    light = np.linspace(0.002, 0.97, 5000).astype(np.float32)
    dn = expose(light, exposure=1.0, settings=settings, rng=np.random.default_rng(9))

    def linearised(dn):
        return full_wells(dn / settings.full_scale_dn, settings)

    found = linearised(dn)
    # A number stands for half a step to either side; the step is wider by the 2^-16 of the
    # converter ahead of the curve, and single precision rounds the light itself.
    one_down = linearised(np.maximum(dn, 1) - 1)
    one_up = linearised(np.minimum(dn, settings.full_scale_dn - 1) + 1)
    half_step = 0.5 * np.maximum(found - one_down, one_up - found)
    assert (np.abs(found - light) < 1.1 * half_step + 2.0**-16).all()


def test_srgb_shows_middle_grey_as_118_and_half_as_188():
    # IEC 61966-2-1: linear 0.18 and 0.5 are 117.6 and 187.5(2) of 255.
    settings = CameraSettings(full_well_e=1e12, response="srgb", black_level_dn=0.0)
    for light, dn in ((0.18, 118), (0.5, 188), (0.001, 3)):
        assert (photograph(light, settings=settings, seed=1, shape=(4, 4)) == dn).all()


BAYER = ["RGGB", "BGGR", "GRBG", "GBRG"]


@pytest.mark.parametrize("bayer", BAYER)
def test_a_bayer_sensor_writes_the_colour_behind_each_filter_and_interpolates_the_others(bayer):
    # Light that is linear in place and colour: a mean of neighbours is then the truth itself, and
    # the well of 1e12 electrons has a noise of 1e-6. What is left is rounding: half a number of
    # the raw frame and half one of the mean.
    y, x = np.mgrid[0:40, 0:60] / 100
    light = np.stack([0.1 + x, 0.2 + y, 0.7 - 0.5 * x - 0.5 * y], axis=-1)
    settings = CameraSettings(full_well_e=1e12, bayer=bayer, black_level_dn=0.0)
    frame = expose(light, exposure=1.0, settings=settings, rng=np.random.default_rng(1))
    assert frame.shape == light.shape
    assert np.abs(frame - 255.0 * light)[1:-1, 1:-1].max() <= 1.01
    for position, colour in enumerate(bayer):
        row, column = divmod(position, 2)
        own = (slice(2 + row, -2, 2), slice(2 + column, -2, 2), "RGB".index(colour))
        assert np.abs(frame[own] - 255.0 * light[own]).max() <= 0.51


@pytest.mark.parametrize("bayer", BAYER)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_mosaic_of_a_demosaiced_frame_is_the_raw_frame(bayer, dtype):
    raw = np.random.default_rng(2).integers(0, np.iinfo(dtype).max, (20, 30)).astype(dtype)
    again = mosaic(demosaiced(raw, bayer=bayer), bayer=bayer)
    # Outermost pixels repeat others.
    assert np.array_equal(again[1:-1, 1:-1], raw[1:-1, 1:-1])


def test_a_response_curve_acts_on_colours_that_were_interpolated_in_linear_light():
    # Green falls from 0.9 to 0.1 between two columns; a red or blue pixel beside the edge has the
    # mean of its four green neighbours. sRGB of (3 * 0.9 + 0.1) / 4 = 0.7 is 217.8 and of
    # (0.9 + 3 * 0.1) / 4 = 0.3 is 148.9 (IEC 61966-2-1); means of the curve's own values, 0.954
    # and 0.349 of full scale, would be 204.8 and 127.6.
    light = np.zeros((8, 16, 3), np.float32)
    light[:, :8, 1], light[:, 8:, 1] = 0.9, 0.1
    settings = CameraSettings(full_well_e=1e12, bayer="RGGB", response="srgb", black_level_dn=0.0)
    frame = expose(light, exposure=1.0, settings=settings, rng=np.random.default_rng(3))
    assert frame[3, 7, 1] == 218
    assert frame[4, 8, 1] == 149


def test_an_odd_image_has_no_bayer_mosaic():
    with pytest.raises(ValueError, match=r"even H and W; got shape \(3, 4, 3\)"):
        photograph(0.5, settings=CameraSettings(bayer="RGGB"), seed=1, shape=(3, 4, 3))


def test_jpeg_keeps_grey_and_blurs_colour_along_rows_only():
    # A block of one grey is its mean, written in steps of 1/8 of the first quantiser, at quality
    # 90 of 3: within half a number. Two columns of chroma share one sample, rows keep theirs.
    grey = np.full((64, 64, 3), 137, np.uint8)
    assert np.abs(after_jpeg(grey, quality=90).astype(int) - 137).max() <= 1
    rows = np.zeros((64, 64, 3), np.uint8)
    rows[::2] = (200, 50, 50)
    rows[1::2] = (50, 50, 200)
    columns = rows.swapaxes(0, 1)
    lost = [
        np.abs(after_jpeg(image, quality=100).astype(int) - image).mean()
        for image in (rows, np.ascontiguousarray(columns))
    ]
    # Quality 100 rounds by half a number in each of three channels and back; shared chroma mixes
    # red and blue that are 150 apart, to 75 off.
    assert lost[0] < 2
    assert lost[1] > 30


def test_jpeg_costs_more_at_lower_quality():
    noisy = photograph(0.5, settings=CameraSettings(), seed=1, shape=(64, 64, 3))
    errors = [np.std(after_jpeg(noisy, quality=q).astype(float) - noisy) for q in (95, 75, 40)]
    assert 0 < errors[0] < errors[1] < errors[2]


@pytest.mark.parametrize("response", ["linear", "srgb", 2.2])
def test_metering_puts_the_brightest_channel_where_it_is_asked(response):
    settings = CameraSettings(full_well_e=1e9, response=response, dark_signal_e=1e7)
    y, x = np.mgrid[0:240, 0:320]
    spot = ((x - 160) ** 2 + (y - 120) ** 2 < 40**2).astype(np.float32)
    wall = 7.0 * spot[..., None] * np.array([0.6, 0.3, 0.1], np.float32)
    wall[0, 0] = 1e4  # a glint
    exposure = metered_exposure(wall, settings=settings, peak_fraction=0.7)
    frame = expose(wall, exposure=exposure, settings=settings, rng=np.random.default_rng(1))
    # 0.7 of 255 is 178.5: rounded either way.
    assert frame[120, 160].max() in (178, 179)
    assert frame[120, 160, 0] == frame[120, 160].max()


def test_metering_looks_only_at_the_mask():
    wall = np.ones((40, 40, 3), np.float32)
    wall[:, 20:] = 5.0
    mask = np.zeros((40, 40), bool)
    mask[:, :20] = True
    settings = CameraSettings(black_level_dn=0.0)
    # Linear and without black level the exposure is the fraction itself over the light.
    assert metered_exposure(wall, settings=settings, mask=mask) == pytest.approx(0.8)
    assert metered_exposure(wall, settings=settings) == pytest.approx(0.8 / 5)


@pytest.mark.parametrize(
    ("image", "kwargs", "message"),
    [
        (np.full((2, 2), -1.0), {}, "not negative; got values from -1"),
        (np.full((2, 2), np.nan), {}, "finite"),
        (np.full((2, 2), np.inf), {}, "finite"),
        (np.ones((0, 2)), {}, "contain pixels"),
        (np.ones((2, 2)), {"exposure": -1.0}, "exposure="),
        (np.ones((2, 2)), {"exposure": math.nan}, "exposure="),
        (np.zeros((4, 4, 3)), {"peak_fraction": 0.8}, "needs light"),
        (np.ones((4, 4, 3)), {"peak_fraction": 0.01}, "above the dark image"),
    ],
)
def test_bad_light_and_bad_metering_are_named(image, kwargs, message):
    settings = CameraSettings()
    with pytest.raises(ValueError, match=message):
        if "peak_fraction" in kwargs:
            metered_exposure(image, settings=settings, **kwargs)
        else:
            rng = np.random.default_rng(0)
            expose(image, **{"exposure": 1.0, "settings": settings, "rng": rng, **kwargs})


@pytest.mark.parametrize(
    "setting", [{"black_level_dn": 255.0}, {"jpeg_quality": 90, "bit_depth": 10}]
)
def test_impossible_cameras_are_refused(setting):
    with pytest.raises(ValidationError, match=next(iter(setting))):
        CameraSettings(**setting)
