"""Spots that a camera clips, at any level: measured within their stated errors, or refused."""

import math

import cv2
import numpy as np
import pytest

from eyespot.estimator import Frame, LiteralSettings, SubpixelSettings, TrackState, measure
from eyespot.estimator.camera_noise import CameraNoise
from eyespot.estimator.detector.ellipse_rays import AffineEllipse, Patch
from eyespot.estimator.detector.levels import Levels
from eyespot.estimator.detector.saturated_flank import hidden_edge
from eyespot.estimator.detector.tuning import RAYS
from eyespot.estimator.photon_transfer import measured_noise
from eyespot.estimator.pixels.frame_pixels import FramePixels
from eyespot.estimator.run.options import Options
from eyespot.formats.camera_sheet import CameraSheet, Response
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import NoSpot, Reason, Spot
from eyespot.scenes.drawn import Drawing, any_truth, any_wall, erf_edge, frame_of
from tests.support.drawn.drawn_spots import spot_image, spot_in
from tests.support.drawn.made_up import a_microscope_file

SHAPE = (240, 320)
LEVELS = [  # bits of the camera, where it clips, shift to the upper bits
    *((8, level, 0) for level in (235, 250, 255)),
    *((12, level, 0) for level in (1000, 1023, 3900, 4095)),
    (14, 16383, 0),
    (16, 60000, 0),
    (12, 4095, 4),
    (10, 1000, 6),
]


def drawn(
    rng: np.random.Generator,
    *,
    bits: int = 12,
    level: float = 4095,
    shift: int = 0,
    over: float = 1.5,
    profile: str = "disc",
    noise: float = 0.005,
) -> tuple[np.ndarray, tuple[float, float]]:
    """A frame and the true semi-axes; the peak is `over` times the level at which it is clipped."""
    minor = rng.uniform(22, 38)
    major = minor * rng.uniform(1, 1.4)
    image = spot_image(
        SHAPE,
        160 + rng.uniform(-8, 8),
        120 + rng.uniform(-8, 8),
        major,
        minor,
        rng.uniform(-1.5, 1.5),
        profile=profile,
        blur=rng.uniform(0.8, 3),
        peak=over * 0.93 * level,
        background=0.07 * level,
        noise=noise * level,
        clip=level,
        rng=rng,
    )
    whole = np.clip(np.rint(image), 0, level).astype(np.uint16) << shift
    return whole.astype(np.uint8 if bits == 8 else np.uint16), (major, minor)


def measured(frame: np.ndarray, settings: SubpixelSettings | None = None) -> Spot | NoSpot:
    return measure(frame, TrackState(), settings or SubpixelSettings())[0]


def assert_within(spot: Spot, truth: tuple[float, float], relative: float = 0.0) -> None:
    """Within five standard deviations and 0.1 px of the truth, or within a part of it."""
    for found, true, variance in zip(
        (spot.semi_major_px, spot.semi_minor_px), truth, np.diag(spot.covariance)[2:4], strict=True
    ):
        assert abs(found - true) < max(5 * math.sqrt(variance) + 0.1, relative * true)


@pytest.mark.parametrize(("bits", "level", "shift"), LEVELS)
def test_a_disc_clipped_anywhere_is_saturated_and_measured(bits, level, shift):
    rng = np.random.default_rng([bits, level, shift])
    found = 0
    for _ in range(6):
        frame, truth = drawn(rng, bits=bits, level=level, shift=shift, over=rng.uniform(1.1, 1.6))
        if spot := measured(frame):
            assert_within(spot, truth)
            # Of a region above half of its height, a rim of a few px is below the level.
            assert 0.6 < spot.saturated <= 1
            found += 1
    # With so much light the flank below the level still shows how high it goes.
    assert found >= 4


@pytest.mark.parametrize("seed", range(4))
def test_a_clipped_disc_is_refused_in_a_jpeg_and_measured_without(seed):
    rng = np.random.default_rng(seed)
    truth = any_truth(rng, rng.uniform(35, 75))
    blur, power = erf_edge(rng.uniform(0.8, 2)), 255 * rng.uniform(2.5, 3.3)
    disc = Drawing(truth=truth, profile=blur, amplitude=power, wall=any_wall(rng))
    frame = frame_of(disc, rng)
    # Red and green are cut; blue, a fifth of them, is not.
    spot = measured(frame)
    assert isinstance(spot, Spot)
    assert_within(spot, (truth.semi_major, truth.semi_minor))
    # A JPEG shifts the edge of each colour, by up to ten standard errors.
    _, encoded = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 85])
    decoded = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))
    assert measured(decoded) == NoSpot(Reason.SATURATED)


@pytest.mark.parametrize(("bits", "level", "shift"), LEVELS)
@pytest.mark.parametrize("noise", [0.0, 0.001, 0.01])
def test_what_is_not_clipped_is_not_saturated(bits, level, shift, noise):
    rng = np.random.default_rng([1, bits, level, shift])
    for profile in ("disc", "bell"):
        over = rng.uniform(0.5, 0.9)
        settings = {"bits": bits, "level": level, "shift": shift, "noise": noise}
        frame, truth = drawn(rng, over=over, profile=profile, **settings)
        spot = spot_in(frame)
        assert spot.saturated == 0
        assert_within(spot, truth)


def test_frames_of_random_depth_level_and_exposure_are_right_or_refused():
    for seed in range(150):
        rng = np.random.default_rng([2, seed])
        bits, level, shift = LEVELS[rng.integers(len(LEVELS))]
        level = int(level * rng.choice([1.0, rng.uniform(0.7, 1)]))
        frame, truth = drawn(
            rng,
            bits=bits,
            level=level,
            shift=shift,
            over=rng.uniform(0.3, 2.5),
            profile=rng.choice(["disc", "bell"]),
            noise=rng.choice([0.0, 0.001, 0.004, 0.012]),
        )
        if spot := measured(frame):
            assert_within(spot, truth)


@pytest.mark.parametrize("hidden", [0.02, 0.1, 0.2, 0.3])
def test_a_bell_is_measured_up_to_a_third_of_its_area_clipped(hidden):
    # Of a Gaussian's area above half of its peak, log2(peak / level) is above the level.
    for seed in range(5):
        frame, truth = drawn(np.random.default_rng([3, seed]), profile="bell", over=2**hidden)
        spot = spot_in(frame)
        assert_within(spot, truth, relative=0.05)


@pytest.mark.parametrize("hidden", [0.42, 0.7, 1.5, 3.0])
def test_a_bell_of_which_more_is_clipped_is_refused(hidden):
    for seed in range(5):
        frame, _ = drawn(np.random.default_rng([4, seed]), profile="bell", over=2**hidden)
        assert measured(frame) == NoSpot(Reason.SATURATED)


def test_hot_pixels_above_the_level_do_not_hide_it():
    rng = np.random.default_rng(5)
    frame, truth = drawn(rng, over=1.4)
    rows, columns = rng.integers(100, 140, 3), rng.integers(140, 180, 3)
    frame[rows, columns] = 65535
    spot = spot_in(frame)
    assert spot.saturated > 0.6
    assert_within(spot, truth)


@pytest.fixture(scope="module")
def frame():
    """Of 12 bits, with a curve."""
    light = spot_image(SHAPE, 160.3, 120.7, 40, 30, 0.4, peak=0.75, background=0.03)
    curved = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(4095 * curved).astype(np.uint16)


def test_a_curve_counts_from_the_cameras_full_scale(frame):
    for response in (Response(curve="srgb", full_scale=4095), Response(curve="srgb")):
        # Without a stated full scale, values whose lowest bits are 0 show it.
        shifted = frame << 4 if response.full_scale is None else frame
        spot = spot_in(shifted, SubpixelSettings(response=response))
        assert_within(spot, (40, 30))
    with pytest.raises(InputError, match=r"full scale of 16-bit images.*camera.full_scale"):
        measured(frame, SubpixelSettings(response=Response(curve="srgb")))
    with pytest.raises(InputError, match=r"full_scale.* is 1023, but the image has values up to"):
        measured(frame, SubpixelSettings(response=Response(full_scale=1023)))


SHEET = {"full_well_e": 9000.0, "read_noise_e": 8.0, "black_level_dn": 8.0, "bit_depth": 12}


@pytest.mark.parametrize("keys", [{"camera": SHEET}, {"full_scale": 4095}])
def test_a_microscope_file_says_the_full_scale(frame, keys, tmp_path):
    size = SHAPE[1], SHAPE[0]
    microscope = a_microscope_file(tmp_path, size, pinhole_height_mm=11.5, response="srgb", **keys)
    reader = Options.of({"rig": microscope}).reader()
    spot = reader.read(Frame(index=0, image=frame)).result
    assert isinstance(spot, Spot)
    assert_within(spot, (40, 30))


def test_floats_beyond_one_need_their_full_scale():
    frame = spot_image(SHAPE, 160.3, 120.7, 40, 30, 0.4).astype(np.float32)
    with pytest.raises(InputError, match=r"floats up to 220.*camera.full_scale"):
        Options.of({}).reader().read(Frame(index=0, image=frame))
    for reading in (
        Options.of({"changes": {"camera.full_scale": 255.0}})
        .reader()
        .read(Frame(index=0, image=frame)),
        # As the source says.
        Options.of({}).reader().read(Frame(index=0, image=frame, full_scale=255.0)),
    ):
        assert isinstance(reading.result, Spot)
        assert_within(reading.result, (40, 30))


def test_the_literal_mode_and_the_pixels_see_the_level():
    frame, _ = drawn(np.random.default_rng(6), bits=8, level=235, over=1.5)
    spot = spot_in(frame, LiteralSettings())
    assert spot.saturated > 0.6
    sheet = CameraSheet(full_well_e=9e3, read_noise_e=8.0, black_level_dn=0.0, bit_depth=8)
    noise = CameraNoise(sheet, Response())
    picture = FramePixels.of(np.dstack([frame] * 3), noise)
    assert (picture.full[..., 0] == (frame == 235)).all()
    assert picture.ends == pytest.approx([235 / 255] * 3)
    with pytest.raises(InputError, match=r"end at 255.* up to 4000.*bit_depth"):
        FramePixels.of(np.full((9, 9, 3), 4000, np.uint16), noise)


def test_clipped_pairs_do_not_measure_a_camera():
    """A clipped pair has no noise, and would bend the line of the others' variances."""
    rng = np.random.default_rng(7)

    def pair(light: float) -> tuple[np.ndarray, np.ndarray]:
        frames = rng.poisson(light, (2, 80, 80, 3)) / 4 + rng.normal(8, 1, (2, 80, 80, 3))
        first, second = np.clip(np.rint(frames), 0, 3000).astype(np.uint16)
        return first, second

    pairs = [pair(light) for light in (0, 2000, 4000, 8000, 14000)]
    found = measured_noise(pairs, bit_depth=12)
    # 4 electrons a DN; the standard error of the slope is a hundredth.
    assert found.gain_dn_e == pytest.approx(0.25, rel=0.04)
    with pytest.raises(InputError, match=r"values up to .* above the full scale 1023"):
        measured_noise(pairs, bit_depth=10)


@pytest.mark.parametrize(("radius", "grey"), [(9.5, 0.3), (11.75, 0.85), (13.5, 0.85)])
def test_a_flank_of_a_single_grey_pixel_hides_its_edge(radius, grey):
    v, u = np.mgrid[:41, :41]
    off = np.hypot(u - 20.0, v - 20.0) - radius
    part = np.select([off < -0.25, off < 0.25], [1.0, grey])
    levels = Levels(
        peak=255.0,
        dome=(1.0, 0.0, 0.0),
        variance=0.0,
        background=0.0,
        background_radius=1.5,
        scatter=1.0,
        width=0.011,
        half_radius=1.0,
    )
    patch = Patch((255.0 * part).astype(np.float32), 0.0, 0.0, ceiling=255.0)
    ellipse = AffineEllipse.from_axes(20.0, 20.0, radius, radius, 0.0)
    # One number cannot tell height, place and width apart.
    assert hidden_edge(patch, ellipse, np.ones(RAYS, bool), levels, 0.2) is None
