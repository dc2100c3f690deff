"""Every encoding of a ROS image is what its mosaic, its YUV or its bits say, drawn by numpy."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from eyespot.estimator.sources.opening import open_source
from eyespot.estimator.sources.ros import frame_of_message
from eyespot.formats.inputs import InputError
from tests.support.rig.ros_messages import ROS1, ROS2, compressed_message, image_message, write

RNG = np.random.default_rng(1)
RGB = RNG.integers(0, 255, (6, 10, 3), dtype=np.uint8)
DEEP = RGB.astype(np.uint16) * 257
OPAQUE = np.full((6, 10, 1), 255, np.uint8)
GREY, WORDS = RGB[:, :, 0], DEEP[:, :, 0]
FLAT = np.broadcast_to(np.array([200, 120, 40], np.uint8), RGB.shape)
"""One colour: every way to fill the gaps of a mosaic, or of halved chroma, gives it back."""
DEEPER = FLAT * np.uint16(257)


def mosaic(pattern: str, rgb: np.ndarray) -> np.ndarray:
    """Each pixel's one channel: `pattern` names those of the first four, row by row."""
    v, u = np.mgrid[: rgb.shape[0], : rgb.shape[1]]
    channel = np.array(["rgb".index(letter) for letter in pattern])[2 * (v % 2) + u % 2]
    return np.take_along_axis(rgb, channel[:, :, None], 2)[:, :, 0]


def yuv(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """BT.601 in 16 to 235 and 16 to 240, of which ROS's converters take the numbers."""
    weights = np.array([0.299, 0.587, 0.114])
    y = rgb / 255 @ weights
    u, v = ((rgb[:, :, c] / 255 - y) / (2 * (1 - weights[c])) for c in (2, 0))
    bytes_of = [16 + 219 * y, 128 + 224 * u, 128 + 224 * v]
    first, second, third = (np.rint(one).astype(np.uint8) for one in bytes_of)
    return first, second, third


def packed(samples: np.ndarray, bits: int, packing: str) -> np.ndarray:
    """Rows of bytes, bit by bit, after GenICam's PFNC (p) and GigE Vision (packed)."""
    rows = []
    for row in samples.tolist():
        if packing == "p":  # one stream, the lowest bits first
            stream = sum(value << (bits * k) for k, value in enumerate(row))
            rows.append(stream.to_bytes(-(-len(row) * bits // 8), "little"))
        else:  # the high bytes outside, the low bits of both in the byte between them
            low = bits - 8
            mask = (1 << low) - 1
            pairs = zip(row[::2], row[1::2], strict=True)
            rows.append(
                b"".join(bytes([a >> low, (b & mask) << 4 | a & mask, b >> low]) for a, b in pairs)
            )
    return np.array([list(row) for row in rows], np.uint8)


def cases() -> Iterator[tuple[str, Any, np.ndarray, float | None]]:
    """Encoding, bytes or words as they are sent, frame, full scale."""
    yield from (
        (name, data, frame, None)
        for names, data, frame in (
            ("mono8 8UC1", GREY, GREY),
            ("mono16 16UC1 MONO16", WORDS, WORDS),
            ("mono16 16UC1", WORDS.astype(">u2"), WORDS),
            ("rgb8", RGB, RGB),
            ("bgr8 8UC3", RGB[:, :, ::-1], RGB),
            ("rgb16", DEEP, DEEP),
            ("bgr16 16UC3", DEEP[:, :, ::-1].astype(">u2"), DEEP),
            ("rgba8", np.dstack([RGB, OPAQUE]), RGB),
            ("bgra8 8UC4", np.dstack([RGB[:, :, ::-1], OPAQUE]), RGB),
            ("rgba16", np.dstack([DEEP, OPAQUE]), DEEP),
            ("bgra16 16UC4", np.dstack([DEEP[:, :, ::-1], OPAQUE]), DEEP),
            ("32FC1", WORDS / np.float32(65535), WORDS / np.float32(65535)),
            ("64FC1", (WORDS / 65535).astype(">f8"), WORDS / 65535),
        )
        for name in names.split()
    )
    yield "16SC1", WORDS.astype(np.int16) & 0x7FFF, WORDS & 0x7FFF, 32767.0
    for pattern in ("rggb", "bggr", "gbrg", "grbg"):
        yield f"bayer_{pattern}8", mosaic(pattern, FLAT), FLAT, None
        deep = DEEPER >> 4
        yield f"bayer_{pattern}16", mosaic(pattern, DEEPER).astype(">u2"), DEEPER, None
        yield f"bayer_{pattern}12", mosaic(pattern, deep), deep, 4095.0
        yield f"bayer_{pattern}12p", packed(mosaic(pattern, deep), 12, "p"), deep, 4095.0
    ramp = (np.arange(60).reshape(6, 10) * 17).astype(np.uint16)
    for bits in (10, 12):
        full = float(2**bits - 1)
        samples = ramp << (bits - 10) | np.uint16(bits > 10)
        yield f"mono{bits}", samples, samples, full
        yield f"mono{bits}", samples.astype(">u2"), samples, full
        for packing in ("p", "packed"):
            yield f"mono{bits}{packing}", packed(samples, bits, packing), samples, full
    for packing in ("p", "packed"):  # under the name of words, as avt_vimba_camera sends them
        for name in ("mono12", "mono16"):
            yield name, packed(samples, 12, packing), samples, 4095.0
    yield "mono14", samples, samples, 16383.0
    yield "mono12", samples << 4, samples << 4, None  # in the upper bits: 4095 is not the end
    y, u, v = yuv(FLAT)
    chroma = np.stack([u, v], axis=2)
    half = chroma[:, ::2].reshape(6, 10)
    for name in ("uyvy", "yuv422"):
        yield name, np.stack([half, y], axis=2), FLAT, None
    for name in ("yuyv", "yuv422_yuy2"):
        yield name, np.stack([y, half], axis=2), FLAT, None
    yield "nv12", np.concatenate([y, half[::2]]), FLAT, None
    yield "nv21", np.concatenate([y, chroma[::2, ::2, ::-1].reshape(3, 10)]), FLAT, None
    yield "nv24", np.concatenate([y, chroma.reshape(12, 10)]), FLAT, None


CASES = list(cases())


@pytest.mark.parametrize("types", [ROS1, ROS2], ids=["ros1", "ros2"])
def test_every_encoding_is_the_frame_that_was_drawn(tmp_path, types):
    messages = []
    for k, (name, data, _, _) in enumerate(CASES):
        # Planes share one step, and OpenCV's NV24 has no room between its rows.
        for padding in (0, 0 if name.startswith("nv") else 2):
            sent = image_message(types, data, name, time_s=1.0 + k, padding=padding)
            sent.height, sent.width = 6, 10
            messages.append(("/images", 1.0 + k, sent))
    path = tmp_path / ("a.bag" if types is ROS1 else "a")
    found = open_source(write(path, types, messages, **({} if types is ROS1 else {"version": 9})))
    for frame, (name, _, image, full) in zip(found, [c for c in CASES for _ in "ab"], strict=True):
        assert not frame.fault, f"{name}: {frame.fault}"
        assert frame.image.dtype == image.dtype, name
        assert frame.full_scale == full, name
        # A byte of Y is 1.16 grey values, one of U or V up to 2: half of each, and rounding.
        tolerance = 2.1 if name.startswith(("uyvy", "yuv", "yuyv", "nv")) else 0
        np.testing.assert_allclose(frame.image, image.astype(float), 0, tolerance, err_msg=name)


def test_colours_of_a_mosaic_are_where_they_were():
    """A disc of one colour stays where it is, to the pixel or two that a mosaic blurs."""
    v, u = np.mgrid[:60, :80]
    inside = np.hypot(u - 41.3, v - 27.8) < 15
    rgb = np.where(inside[..., None], [3000, 2000, 1000], [100, 100, 100]).astype(np.uint16)
    for pattern in ("rggb", "bggr", "gbrg", "grbg"):
        sent = image_message(ROS1, mosaic(pattern, rgb), f"bayer_{pattern}16")
        frame, _ = frame_of_message(sent)
        far = np.abs(np.hypot(u - 41.3, v - 27.8) - 15) > 2
        np.testing.assert_array_equal(frame[far], rgb[far], err_msg=pattern)


@pytest.mark.parametrize(
    ("form", "sent", "frame", "full"),
    [
        ("png", RGB, RGB, None),
        ("rgb8; png compressed bgr8", RGB, RGB, None),
        ("16UC1; png compressed ", WORDS, WORDS, None),
        ("mono16; png compressed ", WORDS, WORDS, None),
        ("mono12; png compressed ", WORDS >> 4, WORDS >> 4, 4095.0),
        ("rgb16; png compressed bgr16", DEEP, DEEP, None),
        ("mono8; jpeg compressed mono8", np.full((8, 8), 90, np.uint8), None, None),
        ("mono12; jpeg compressed mono8", np.full((8, 8), 90, np.uint8), None, None),
        ("yuv422; jpeg compressed bgr8", FLAT, FLAT, None),
        ("bayer_rggb8; jpeg compressed bgr8", FLAT, FLAT, None),
        ("bayer_rggb8; jpeg compressed mono8", np.full((8, 8), 90, np.uint8), None, None),
        ("bayer_grbg8; png compressed ", mosaic("grbg", FLAT), FLAT, None),
        (
            "bayer_gbrg16; png compressed ",
            mosaic("gbrg", FLAT * np.uint16(9)),
            FLAT * np.uint16(9),
            None,
        ),
        ("bayer_bggr8; jpeg compressed ", mosaic("bggr", FLAT // 9 + 100), FLAT // 9 + 100, None),
    ],
)
def test_compressed_images_are_what_their_format_says(form, sent, frame, full):
    message = compressed_message(ROS1, sent, "jpg" if "jpeg" in form else "png")
    message.format = form
    found, full_scale = frame_of_message(message)
    expected = sent if frame is None else frame
    assert (found.shape, found.dtype.itemsize) == (expected.shape, sent.dtype.itemsize)
    assert full_scale == full
    # JPEG of quality 95 rounds coefficients to a few grey values; a mosaic has steep ones.
    tolerance = 0 if "png" in form else 12 if "bayer_bggr8" in form else 3
    np.testing.assert_allclose(found, expected.astype(float), 0, tolerance)


@pytest.mark.parametrize(
    ("encoding", "data", "words"),
    [
        ("32SC1", GREY.astype("i4"), "got '32SC1'"),
        ("8UC2", np.dstack([GREY, GREY]), "got '8UC2'"),
        ("16SC1", -WORDS.astype("i2") - 1, "values below 0"),
        ("32FC1", np.full((6, 10), np.nan, "f4"), "must be finite"),
        ("mono12p", packed(WORDS >> 4, 10, "p"), "cannot be made of"),
    ],
)
def test_what_is_no_image_of_light_is_refused_by_name(encoding, data, words):
    sent = image_message(ROS1, data, encoding)
    sent.width = 10
    with pytest.raises(InputError, match=words):
        frame_of_message(sent)
