"""Noise that is measured in a recording is that of repeated frames."""

import cv2
import numpy as np
import pytest

from eyespot.estimator.camera_noise import CameraNoise
from eyespot.estimator.recording_noise import noise_of_frames
from eyespot.formats.camera_sheet import CameraSheet, Response
from eyespot.formats.inputs import InputError
from eyespot.scenes.description.scene_keys import CameraSettings
from eyespot.scenes.sensor import after_jpeg, expose

SHAPE = 360, 480
FRAMES = 32
CELL_PX = 6
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]


def textured_wall(rng: np.random.Generator) -> np.ndarray:
    """A wall's reflectance, H x W x 3: texture of 6 % RMS each in pixels and in spots of 8 px."""
    texture = np.ones(SHAPE)
    for width in (1.2, 8.0):
        drawn = cv2.GaussianBlur(rng.normal(size=SHAPE), (0, 0), width)
        texture += 0.06 * drawn / drawn.std()
    return 0.85 * np.clip(texture, 0.1, None)[..., None] * [1.0, 0.8, 0.6]


def spot(share: float, *, sharp: bool) -> np.ndarray:
    """The light of a growing spot over ambient light; `share` of the withdrawal is over."""
    radius, aside = 40 + 60 * share, np.hypot(COLUMNS - 240.0, ROWS - 180.0)
    if sharp:
        light = 1 / (1 + np.exp(np.clip((aside - 1.3 * radius) / 3, -50, 50)))
    else:
        light = np.exp(-((aside / radius) ** 2) / 2)
    return 0.03 + 0.85 * (1 - 0.4 * share) * light[..., None]


class Camera:
    """The camera of rendered scenes."""

    def __init__(self, seed, *, mono=False, **settings):
        usual = {"full_well_e": 4000.0, "read_noise_e": 8.0, "black_level_dn": 16.0}
        self.settings = CameraSettings(**usual | settings)
        self.response = Response(curve="srgb" if self.settings.response == "srgb" else "linear")
        self.rng, self.mono = np.random.default_rng(seed), mono

    def photograph(self, light: np.ndarray) -> np.ndarray:
        light = light[..., 1] if self.mono else light
        image = expose(light, exposure=1.0, settings=self.settings, rng=self.rng)
        quality = self.settings.jpeg_quality
        return after_jpeg(image, quality=quality) if quality else image

    def measured(self, frames) -> CameraNoise:
        return noise_of_frames(
            frames,
            response=self.response,
            bit_depth=self.settings.bit_depth,
            black_level_dn=self.settings.black_level_dn,
        )

    def light(self, image: np.ndarray) -> np.ndarray:
        sheet = CameraSheet(
            full_well_e=1e15,
            read_noise_e=0,
            black_level_dn=self.settings.black_level_dn,
            bit_depth=self.settings.bit_depth,
        )
        return CameraNoise(sheet, self.response).light(image)


def ratios(noise: CameraNoise, camera: Camera, scene: np.ndarray) -> np.ndarray:
    """Stated over true standard deviation of a cell's mean, in quarters of the cells by light."""
    half = CELL_PX // 2
    repeated = np.stack(
        [
            cv2.blur(camera.light(camera.photograph(scene)), (CELL_PX, CELL_PX))[
                half:-half:CELL_PX, half:-half:CELL_PX
            ].ravel()
            for _ in range(8)
        ]
    )
    light, true = repeated.mean(axis=0), repeated.var(axis=0, ddof=1)
    stated = noise.variance(light) / CELL_PX**2
    quarters = np.array_split(np.argsort(light), 4)
    return np.sqrt([stated[q].mean() / true[q].mean() for q in quarters])


@pytest.mark.parametrize(
    ("settings", "sharp"),
    [
        ({}, True),
        pytest.param(
            {"bit_depth": 12, "full_well_e": 10_000.0, "black_level_dn": 64.0},
            True,
            marks=pytest.mark.slow,
        ),
        pytest.param({"full_well_e": 500.0}, False, marks=pytest.mark.slow),
        ({"mono": True}, False),
        pytest.param({"response": "srgb", "black_level_dn": 0.0}, False, marks=pytest.mark.slow),
        ({"bayer": "RGGB"}, False),
    ],
    ids=lambda given: (" ".join(given) or "plain") if isinstance(given, dict) else None,
)
def test_the_noise_of_cells_is_that_of_repeated_frames(settings, sharp):
    camera = Camera(1, **settings)
    wall = textured_wall(np.random.default_rng(2))
    shares = np.linspace(0, 1, FRAMES)
    frames = [camera.photograph(wall * spot(share, sharp=sharp)) for share in shares]
    noise = camera.measured(frames)
    assert noise.channel_count == (1 if camera.mono else 3)
    # The truth has 1,200 cells a quarter in 8 frames: a scatter of 0.8 %.
    np.testing.assert_allclose(ratios(noise, camera, wall * spot(0.5, sharp=sharp)), 1.0, atol=0.1)


@pytest.mark.parametrize("bayer", ["none", pytest.param("RGGB", marks=pytest.mark.slow)])
def test_jpeg_makes_the_noise_of_cells_larger_by_what_is_measured(bayer):
    camera = Camera(1, jpeg_quality=90, bayer=bayer)
    wall = textured_wall(np.random.default_rng(2))
    frames = [camera.photograph(wall * spot(s, sharp=False)) for s in np.linspace(0, 1, FRAMES)]
    found = ratios(camera.measured(frames), camera, wall * spot(0.5, sharp=False))
    # JPEG's noise is largest where the texture's waves are as high as its steps, which no function
    # of the light describes: there up to a fifth, on average within a tenth.
    np.testing.assert_allclose(found, 1.0, atol=0.2)
    assert abs(np.sqrt(np.mean(found**2)) - 1) < 0.1


@pytest.mark.slow
def test_an_instrument_that_moves_through_the_light_is_no_noise():
    camera = Camera(1)
    wall = textured_wall(np.random.default_rng(2))
    frames = []
    for n, share in enumerate(np.linspace(0, 1, FRAMES)):
        light = wall * spot(share, sharp=False)
        light[:160, 100 + 4 * n : 125 + 4 * n] *= 0.1
        frames.append(camera.photograph(light))
    found = ratios(camera.measured(frames), camera, wall * spot(0.5, sharp=False))
    np.testing.assert_allclose(found, 1.0, atol=0.1)


def test_frames_that_a_capture_card_repeats_tell_nothing_and_mislead_nobody():
    camera = Camera(1)
    wall = textured_wall(np.random.default_rng(2))
    frames = [camera.photograph(wall * spot(s, sharp=False)) for s in np.linspace(0, 1, FRAMES)]
    twice = [frame for frame in frames for _ in range(2)]
    assert camera.measured(twice).sheet == camera.measured(frames).sheet
    with pytest.raises(InputError, match=r"0 pairs of unequal .*\[camera\.noise\]: full_well_e"):
        camera.measured([frames[0]] * 5)
    with pytest.raises(InputError, match="0 pairs of unequal"):
        camera.measured([frame[:30, :30] for frame in frames])
    white = [np.full_like(frames[0], 255), np.full_like(frames[0], 255)]
    white[1][0, 0] = 0
    with pytest.raises(InputError, match=r"1 pairs of unequal .* 0 places clear"):
        camera.measured(white)


def test_light_that_does_not_reach_a_channel_is_measured_in_the_others():
    camera = Camera(1, black_level_dn=0.0, read_noise_e=0.5)
    wall = textured_wall(np.random.default_rng(2)) * [1.0, 1.0, 0.0]
    frames = [camera.photograph(wall * spot(s, sharp=False)) for s in np.linspace(0, 1, FRAMES)]
    found = ratios(camera.measured(frames), camera, wall * spot(0.5, sharp=False))
    np.testing.assert_allclose(found, 1.0, atol=0.1)
