"""Image files of every kind show the spot that was drawn into them, or are refused."""

import struct
import sys
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image
from tifffile import TiffWriter

from eyespot.estimator import SubpixelSettings, track
from eyespot.estimator.sources.opening import open_source
from eyespot.estimator.sources.source import Frame
from eyespot.formats.camera_sheet import Response
from eyespot.formats.image_files import decoded_image
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import Spot
from tests.support.drawn.drawn_recording import write_video
from tests.support.drawn.drawn_spots import spot_image
from tests.support.files.bad_input import png_chunk

SHAPE = (96, 128)
TRUTH = (62.3, 47.7, 30.0, 22.0, 0.4)
# Cramér-Rao: std(b) = (noise/step) sqrt(3 edge/(sqrt(pi) b)), here 0.0019 px for noise 1, step 200,
# edge 1.5 px and b = 22 px. Profiles reach 3.3 times that; a bias of 0.02 px (the drawn profile is
# taken along normals) and 5 standard deviations.
TOLERANCE_PX = 0.02 + 5 * 3.3 * 0.0019

Write = Callable[[Path, np.ndarray], object]


@pytest.fixture(scope="module")
def light():
    """Of a spot, from 0 to 1, with the noise of an 8-bit camera."""
    return spot_image(SHAPE, *TRUTH, noise=1.0, rng=np.random.default_rng(0)) / 255


def samples(light: np.ndarray, bits: int) -> np.ndarray:
    return np.rint(light * (2**bits - 1)).astype(np.uint8 if bits <= 8 else np.uint16)


def error_px(frame: Frame) -> float:
    """Largest error of centre and semi-axes."""
    settings = SubpixelSettings(response=Response(full_scale=frame.full_scale))
    (spot,) = track([frame.image], settings)
    assert isinstance(spot, Spot), spot
    return float(np.abs(np.subtract(spot.ellipse[:4], TRUTH[:4])).max())


def grey_as_rgb(values: np.ndarray) -> np.ndarray:
    return np.dstack([values] * 3)


def planes(values: np.ndarray) -> np.ndarray:
    return np.stack([values] * 3)


def hiding(values: np.ndarray) -> np.ndarray:
    """RGBA with something bright under alpha 0, in a corner and beside the spot."""
    rgba = np.dstack([grey_as_rgb(values), np.full_like(values, np.iinfo(values.dtype).max)])
    for place in (np.s_[:30, :40], np.s_[80:, 30:110]):
        rgba[place] = (*[np.iinfo(values.dtype).max] * 3, 0)
    return rgba


def inks(values: np.ndarray) -> np.ndarray:
    """CMYK whose black has a share of the darkness, and cyan, magenta and yellow the rest."""
    most = np.iinfo(values.dtype).max
    lit = np.sqrt(values / most)
    ink = np.rint(most * (1 - lit)).astype(values.dtype)
    return np.dstack([ink] * 4)


def tiff(bits: int | None = 8, of: Callable = lambda v: v, **options: Any) -> Write:
    """Of samples with so many bits; without bits, of the light itself."""
    return lambda path, light: tifffile.imwrite(
        path, of(samples(light, bits) if bits else light), **options
    )


def shuffled(path: Path, light: np.ndarray, **options: Any) -> None:
    """A palette whose order has nothing to do with brightness."""
    order = np.random.default_rng(1).permutation(256)
    colours = np.zeros((3, 256), np.uint16)
    colours[:, order] = np.arange(256) * 257
    index = order.astype(np.uint8)[samples(light, 8)]
    tifffile.imwrite(path, index, photometric="palette", colormap=colours, **options)


def cfa_tags(pattern: bytes) -> list[tuple]:
    return [(33421, 3, 2, (2, 2), True), (33422, 1, 4, pattern, True)]


def sbit(shift: int) -> Write:
    """12 bits in a PNG of 16, which says so in a chunk after its header of 33 bytes."""
    chunk = png_chunk(b"sBIT", bytes([12]))

    def write(path: Path, light: np.ndarray) -> None:
        data = cv2.imencode(".png", samples(light, 12) << shift)[1].tobytes()
        path.write_bytes(data[:33] + chunk + data[33:])

    return write


def pnm(magic: str, most: int) -> Write:
    def write(path: Path, light: np.ndarray) -> None:
        values = np.rint(light * most).astype(np.uint32)
        values = grey_as_rgb(values) if magic in ("P3", "P6") else values
        binary = values.astype(">u2" if most > 255 else "u1").tobytes()
        text = " ".join(map(str, values.ravel())).encode() + b"\n"
        header = f"{magic}\n# drawn\n{SHAPE[1]} {SHAPE[0]}\n{most}\n".encode()
        path.write_bytes(header + (text if magic in ("P2", "P3") else binary))

    return write


def pillow(mode: str = "L", **options: Any) -> Write:
    def write(path: Path, light: np.ndarray) -> None:
        values = samples(light, 8)
        image = Image.fromarray(hiding(values) if mode == "RGBA" else values)
        image.convert(mode).save(path, **options)

    return write


def opencv(bits: int = 8, of: Callable[[np.ndarray], np.ndarray] = lambda v: v) -> Write:
    return lambda path, light: cv2.imwrite(str(path), of(samples(light, bits)))


def jpeg_2000(bits: int) -> Write:
    return lambda path, light: path.write_bytes(
        imagecodecs.jpeg2k_encode(samples(light, bits), level=0, bitspersample=bits)
    )


def ome(path: Path, light: np.ndarray) -> None:
    with TiffWriter(path, ome=True) as file:
        file.write(np.stack([samples(light, 16)] * 2), metadata={"axes": "TYX"}, subifds=1)
        for _ in range(2):
            file.write(samples(light, 16)[::2, ::2], subfiletype=1)


def with_thumbnail(path: Path, light: np.ndarray) -> None:
    with TiffWriter(path) as file:
        file.write(samples(light, 8)[::4, ::4], subfiletype=1)
        file.write(samples(light, 8))
        file.write(light > 0.5, subfiletype=4, photometric="mask")


RGB: dict[str, Any] = {"photometric": "rgb"}
ALPHA: dict[str, Any] = {"extrasamples": ["unassalpha"]}
INVERTED: dict[str, Any] = {"photometric": "miniswhite"}
READ: dict[str, Write] = {
    "8.tif": tiff(),
    "16.tif": tiff(16),
    "big-endian.tif": tiff(16, byteorder=">"),
    "big.tif": tiff(16, bigtiff=True, tile=(32, 48)),
    "10-in-16.tif": tiff(16, lambda v: v >> 6, extratags=[(281, 3, 1, 1023, True)]),
    "signed.tif": tiff(16, lambda v: (v >> 1).astype(np.int16)),
    "signed-8.tif": tiff(8, lambda v: (v >> 1).astype(np.int8)),
    "negative.tif": tiff(16, lambda v: (v >> 1).astype(np.int16) - np.int16(2000)),
    "half.tif": tiff(None, np.float16),
    "single.tif": tiff(None, np.float32, predictor=True, compression="zlib"),
    "double.tif": tiff(None),
    "rgb.tif": tiff(8, grey_as_rgb, **RGB),
    "planar.tif": tiff(16, planes, planarconfig="separate", compression="lzw", **RGB),
    "hiding.tif": tiff(8, hiding, **ALPHA, **RGB),
    "hiding-16.tif": tiff(16, hiding, compression="zlib", **ALPHA, **RGB),
    "hiding-planar.tif": tiff(
        8, lambda v: np.moveaxis(hiding(v), 2, 0), planarconfig="separate", **ALPHA, **RGB
    ),
    "hiding-white.tif": tiff(
        8, lambda v: np.dstack([255 - hiding(v)[..., 0], hiding(v)[..., 3]]), **ALPHA, **INVERTED
    ),
    "white.tif": tiff(8, lambda v: 255 - v, **INVERTED),
    "white-lzw.tif": tiff(8, lambda v: 255 - v, compression="lzw", **INVERTED),
    "white-16.tif": tiff(16, lambda v: 65535 - v, **INVERTED),
    "palette.tif": shuffled,
    "palette-lzw.tif": lambda path, light: shuffled(path, light, compression="lzw"),
    "cmyk.tif": tiff(8, inks, photometric="separated"),
    "cmyk-16.tif": tiff(16, inks, photometric="separated", compression="zlib", predictor=True),
    "ycbcr.tif": tiff(8, grey_as_rgb, compression="jpeg", compressionargs={"level": 100}, **RGB),
    "jpeg.tif": tiff(8, compression="jpeg", compressionargs={"level": 100}),
    "bayer.tif": tiff(16, photometric="cfa", extratags=cfa_tags(b"\0\1\1\2")),
    "ome.tif": ome,
    "imagej.tif": tiff(16, lambda v: np.stack([v, v]), imagej=True, metadata={"axes": "TYX"}),
    "depth.tif": tiff(8, lambda v: np.stack([v, v]), imagej=True, metadata={"axes": "ZYX"}),
    "thumbnail.tif": with_thumbnail,
    "8.png": opencv(),
    "16.png": opencv(16),
    "rgb-16.png": opencv(16, grey_as_rgb),
    "hiding.png": opencv(8, hiding),
    "hiding-16.png": opencv(16, hiding),
    "palette.png": pillow("P"),
    "sbit-low.png": sbit(0),
    "sbit-high.png": sbit(4),
    "8.bmp": opencv(),
    "palette.bmp": pillow("P"),
    "hiding.bmp": opencv(8, hiding),
    "grey.jpg": pillow(quality=100),
    "rgb.jpg": pillow("RGB", quality=100),
    "cmyk.jpg": pillow("CMYK", quality=100),
    "rgb.webp": pillow("RGB", lossless=True),
    "hiding.webp": pillow("RGBA", lossless=True, exact=True),
    "8.jp2": jpeg_2000(8),
    "12.jp2": jpeg_2000(12),
    "16.jp2": jpeg_2000(16),
    **{f"{m}-{most}.pnm": pnm(m, most) for m in ("P2", "P3", "P5", "P6") for most in (200, 4095)},
}
for _bits in (10, 12, 14):
    READ[f"packed-{_bits}.tif"] = tiff(_bits, bitspersample=_bits)
    READ[f"packed-white-{_bits}.tif"] = tiff(
        _bits, partial(np.subtract, np.uint16(2**_bits - 1)), bitspersample=_bits, **INVERTED
    )
for _name in ("lzw", "zlib", "packbits", "zstd", "lzma", "jpeg2000", "png", "webp", "jpegxl"):
    READ[f"{_name}.tif"] = tiff(8, *([grey_as_rgb] if _name == "webp" else []), compression=_name)
FULL_SCALES = {
    **{f"packed-{bits}.tif": 2**bits - 1 for bits in (10, 12, 14)},
    **{"10-in-16.tif": 1023, "signed.tif": 32767, "negative.tif": 32767, "signed-8.tif": 127},
    **{"sbit-low.png": 4095, "sbit-high.png": 65520, "12.jp2": 4095},
    **{f"{m}-4095.pnm": 4095 for m in ("P2", "P3", "P5", "P6")},
    **{f"{m}-200.pnm": 200 for m in ("P5", "P6")},
}


@pytest.mark.parametrize("name", READ)
def test_a_file_shows_the_spot_that_was_drawn_alone_and_in_a_folder(tmp_path, light, name):
    path = tmp_path / name
    READ[name](path, light)
    alone = list(open_source(path))
    assert len(alone) == (2 if name in ("ome.tif", "imagej.tif", "depth.tif") else 1)
    assert error_px(alone[-1]) < TOLERANCE_PX
    full_scale = FULL_SCALES.get(name, FULL_SCALES.get(name.replace("white-", "")))
    assert alone[0].full_scale == full_scale
    if len(alone) == 1:
        (in_folder,) = open_source(tmp_path)
        np.testing.assert_array_equal(in_folder.image, alone[0].image)
        assert in_folder.image.dtype == alone[0].image.dtype
        assert in_folder.full_scale == full_scale
    else:
        with pytest.raises(InputError, match=r"holds 2 frames\. Give it as a source"):
            list(open_source(tmp_path))


def written(*parts: np.ndarray, **options: Any) -> Write:
    """Pages written one by one, of shapes of their own."""

    def write(path: Path, light: np.ndarray) -> None:
        with TiffWriter(path, **options) as file:
            for part in parts:
                file.write(part)

    return write


def stack(axes: str, *sizes: int, **options: Any) -> Write:
    return lambda path, light: tifffile.imwrite(
        path, np.zeros((*sizes, 8, 9), np.uint8), metadata={"axes": axes}, **options
    )


IMAGEJ = {"imagej": True}
REFUSED: dict[str, tuple[Write, str]] = {
    "channels.tif": (stack("CYX", 2, **IMAGEJ), r"has the axes C = 2 beside"),
    "volume.tif": (stack("TZYX", 3, 2, **IMAGEJ), r"has the axes T = 3, Z = 2 beside"),
    "channels.ome.tif": (stack("TCYX", 3, 2), r"has the axes T = 3, C = 2 beside"),
    "unnamed.tif": (written(np.zeros((3, 2, 8, 9), np.uint8)), r"has the axes Q = "),
    "series.ome.tif": (
        written(np.zeros((2, 8, 9), np.uint8), np.zeros((2, 4, 9), np.uint8), ome=True),
        "holds 2 series of images",
    ),
    "sizes.tif": (
        written(np.zeros((8, 9), np.uint8), np.zeros((4, 9), np.uint8)),
        "sizes.tif#1 has 9x4 px, but sizes.tif#0 9x8 px",
    ),
    "lab.tif": (tiff(8, grey_as_rgb, photometric="cielab"), "8 bits as CIELAB"),
    "ycbcr.tif": (tiff(8, grey_as_rgb, photometric="ycbcr"), "8 bits as YCBCR"),
    "ycbcr-planar.tif": (
        tiff(8, planes, photometric="ycbcr", compression="jpeg", planarconfig="separate"),
        "8 bits as YCBCR",
    ),
    "mosaic.tif": (
        tiff(16, photometric="cfa", extratags=cfa_tags(b"\0\1\2\1")),
        r"raw mosaic with the CFAPattern",
    ),
    "two.tif": (
        tiff(8, lambda v: np.dstack([v, v.T.reshape(v.shape)]), extrasamples=["unspecified"]),
        "does not state whether it is alpha",
    ),
    "five.tif": (
        tiff(8, lambda v: np.dstack([v] * 5), planarconfig="contig", **RGB),
        "has 5 samples a pixel",
    ),
    "complex.tif": (tiff(None, np.complex64), "samples of the type complex64"),
    "white.tif": (tiff(None, **INVERTED), "floats or negative values as MINISWHITE"),
    "raw.tif": (tiff(8, subfiletype=1), "no image of full size"),
    "transparent.png": (
        opencv(8, lambda v: np.dstack([grey_as_rgb(v), 0 * v])),
        r"is transparent everywhere \(alpha 0\)",
    ),
    "animated.png": (
        lambda path, light: pillow(save_all=True, append_images=[Image.new("L", SHAPE[::-1])])(
            path, light
        ),
        "is an animation of 2 images",
    ),
    "12.jpg": (
        lambda path, light: path.write_bytes(
            imagecodecs.jpeg8_encode(samples(light, 12), bitspersample=12)
        ),
        "not an image of a kind that is read",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_be_misread_is_refused_with_the_reason(tmp_path, light, name):
    write, reason = REFUSED[name]
    write(tmp_path / name, light)
    with pytest.raises(InputError, match=reason) as caught:
        list(open_source(tmp_path / name))
    assert name in str(caught.value)


def test_numbers_of_32_bits_are_kept(tmp_path):
    values = np.array([[0, 1, 2**24 + 1], [2**31, 2**32 - 1, 7]], np.uint32)
    tifffile.imwrite(tmp_path / "a.tif", values)
    (frame,) = open_source(tmp_path / "a.tif")
    assert frame.full_scale is None
    np.testing.assert_array_equal(frame.image, values)


@pytest.mark.parametrize("name", ["a.tif", "white.tif", "a.png", "a.bmp", "a.pbm"])
def test_one_bit_is_black_or_white(tmp_path, light, name):
    lit = light > 0.5
    if name.endswith(".tif"):
        inverted = name == "white.tif"
        kind = "miniswhite" if inverted else "minisblack"
        tifffile.imwrite(tmp_path / name, lit ^ inverted, photometric=kind)
    elif name == "a.pbm":
        rows = np.packbits(~lit, axis=1).tobytes()  # 1 is black
        (tmp_path / name).write_bytes(b"P4\n%d %d\n" % SHAPE[::-1] + rows)
    else:
        Image.fromarray(lit).save(tmp_path / name)
    (frame,) = open_source(tmp_path / name)
    assert frame.image.dtype == np.uint8
    assert frame.full_scale is None
    grey = frame.image if frame.image.ndim == 2 else frame.image[:, :, 0]
    np.testing.assert_array_equal(grey, np.where(lit, 255, 0))


@pytest.mark.parametrize("transparent", [False, True])
@pytest.mark.parametrize("bits", [1, 2, 4, 8, "grey", "rgb"])
def test_a_png_is_what_pillow_shows_over_black(tmp_path, bits, transparent):
    values = np.random.default_rng(0).integers(0, 4, (6, 5), dtype=np.uint8)
    if bits == "rgb":
        image = Image.fromarray(grey_as_rgb(values))
    else:
        image = Image.fromarray(values if bits != 1 else values // 2)
    options: dict[str, Any] = {}
    if isinstance(bits, int):
        image.putpalette([10, 20, 30, 200, 100, 50, 1, 2, 3, 9, 9, 9])
        options = {"bits": bits}
    if transparent:
        options["transparency"] = (1, 1, 1) if bits == "rgb" else 1
    image.save(tmp_path / "a.png", **options)
    with Image.open(tmp_path / "a.png") as again:
        black = Image.new("RGBA", image.size, (0, 0, 0, 255))
        expected = np.asarray(Image.alpha_composite(black, again.convert("RGBA")))[..., :3]
    (frame,) = open_source(tmp_path / "a.png")
    shown = grey_as_rgb(frame.image) if frame.image.ndim == 2 else frame.image
    np.testing.assert_array_equal(shown, expected)


def test_a_bad_profile_of_a_png_is_no_word_in_the_middle(capfd):
    written = cv2.imencode(".png", np.full((4, 5), 90, np.uint8))[1].tobytes()
    profile = png_chunk(b"iCCP", b"x\0\0" + zlib.compress(b"too short"))
    found = decoded_image(written[:33] + profile + written[33:])
    assert (found.image == 90).all()
    assert capfd.readouterr() == ("", "")


def test_alpha_in_between_dims_and_a_constant_one_does_nothing(tmp_path):
    values = np.array([[[200, 100, 50, 255], [200, 100, 50, 51]]], np.uint8)
    for name, alpha, seen in (("a", [255, 51], [40, 20, 10]), ("b", [51, 51], [200, 100, 50])):
        values[..., 3] = alpha
        paths = tmp_path / f"{name}.png", tmp_path / f"{name}.tif"
        Image.fromarray(values).save(paths[0])
        tifffile.imwrite(paths[1], values, **ALPHA, **RGB)
        for path in paths:
            (frame,) = open_source(path)
            np.testing.assert_array_equal(frame.image[0], [[200, 100, 50], seen])


@pytest.mark.parametrize(
    ("pattern", "colours"),
    {b"\0\1\1\2": "RGGB", b"\2\1\1\0": "BGGR", b"\1\0\2\1": "GRBG", b"\1\2\0\1": "GBRG"}.items(),
)
def test_a_bayer_mosaic_has_the_colours_of_its_pattern(tmp_path, pattern, colours):
    levels = {"R": 8000, "G": 4000, "B": 1000}
    tile = np.array([levels[colour] for colour in colours], np.uint16).reshape(2, 2)
    extra = cfa_tags(pattern)
    tifffile.imwrite(tmp_path / "a.tif", np.tile(tile, (8, 8)), photometric="cfa", extratags=extra)
    (frame,) = open_source(tmp_path / "a.tif")
    np.testing.assert_array_equal(frame.image[4:-4, 4:-4], [[[8000, 4000, 1000]] * 8] * 8)


def rotated_mp4(path: Path, frame: np.ndarray) -> None:
    """A video of phones: the matrix of its track turns it by 90 degrees."""
    write_video(path, [grey_as_rgb(frame)] * 3, "mp4v")
    data = path.read_bytes()
    one, whole = 1 << 16, 1 << 30
    upright = struct.pack(">9i", one, 0, 0, 0, one, 0, 0, 0, whole)
    at = data.index(upright, data.index(b"tkhd"))
    turned = struct.pack(">9i", 0, one, 0, -one, 0, 0, SHAPE[0] * one, 0, whole)
    path.write_bytes(data[:at] + turned + data[at + 36 :])


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.webp", "a.tif", "a.mp4"])
def test_a_flag_of_rotation_is_said_and_the_frame_is_as_the_sensor_saw_it(tmp_path, light, name):
    path = tmp_path / name
    exif = Image.Exif()
    exif[274] = 6
    if name == "a.mp4":
        rotated_mp4(path, samples(light, 8))
    elif name == "a.tif":
        tifffile.imwrite(path, samples(light, 8), extratags=[(274, 3, 1, 6, True)])
    else:
        Image.fromarray(samples(light, 8)).save(path, exif=exif, quality=100)
    source = open_source(path)
    assert len(source.notes) == 1
    assert "as the sensor saw" in source.notes[0]
    frame = next(iter(source))
    assert frame.image.shape[:2] == SHAPE
    # The video's compression moves the edge.
    assert error_px(frame) < (0.3 if name == "a.mp4" else TOLERANCE_PX)


def test_a_sequence_of_two_sizes_ends_where_the_size_changes(tmp_path, light):
    for name in ("f0.png", "f1.png", "f2.png"):
        cv2.imwrite(str(tmp_path / name), samples(light, 8)[: 50 if name == "f2.png" else None])
    frames = iter(open_source(tmp_path))
    assert [next(frames).index for _ in range(2)] == [0, 1]
    with pytest.raises(InputError, match=r"f2\.png has 128x50 px, but f0\.png 128x96 px"):
        next(frames)
    (tmp_path / "f2.png").rename(tmp_path / "other.png")  # unrelated images may differ
    assert len(list(open_source(tmp_path))) == 3


@pytest.mark.parametrize("at", [4, 8, 20, 60])
def test_a_tiff_damaged_in_its_first_page_is_refused(tmp_path, light, at):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, samples(light, 8))
    data = path.read_bytes()
    path.write_bytes(data[:at] + b"\xff" * 40 + data[at + 40 :])
    with pytest.raises(InputError, match=r"a\.tif") as caught:
        list(open_source(path))
    assert "frame -1" not in str(caught.value)


def test_a_decoder_that_is_not_installed_is_not_called_a_damaged_image(monkeypatch):
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    _, png = cv2.imencode(".png", np.zeros((4, 4), np.uint8))
    with pytest.raises(ImportError, match="imagecodecs"):
        decoded_image(png.tobytes())
