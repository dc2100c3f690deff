"""Pictures on the wall: drawn, photographed or random; and how far light spreads in it."""

import functools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from eyespot.formats.camera_sheet import light_of_srgb, srgb_of_light
from eyespot.formats.image_files import read_image
from eyespot.formats.inputs import InputError, shortened
from eyespot.optics.wall_light.unknown_wall import texture
from eyespot.scenes.description.scene_keys import Phantom, SceneError
from eyespot.scenes.walls.fundus import fundus


def wall_image(
    path: Path, *, width_mm: float, white: float, extent_mm: float, pixels: int
) -> NDArray[np.float32]:
    """Reflectance on a square map about the pole, from an image of 8 or 16 bits in sRGB.

    The centres of image and map coincide; the image's right is +X, its top +Y, as its rows are
    stored (an Exif orientation is not applied). The edge of the image is repeated outside it.

    Args:
        width_mm: the image's width on the map, mm; pixels are square.
        white: reflectance of white in the image.
        extent_mm: width and height of the map, mm.
        pixels: width and height of the map, px.

    Returns:
        Linear reflectance, pixels x pixels x 3 (R, G, B).

    Raises:
        SceneError: the file is missing or not an image.
    """
    image, full_scale = _image(path)
    linear = light_of_srgb(np.atleast_3d(image).astype(np.float32) / full_scale)
    ratio = (width_mm / linear.shape[1]) / (extent_mm / pixels)
    if ratio < 1:  # finer than the map: average, so that no pixel is skipped
        size = [max(1, round(side * ratio)) for side in linear.shape[1::-1]]
        linear = np.asarray(cv2.resize(linear, size, interpolation=cv2.INTER_AREA))
    height, width = linear.shape[:2]
    across = (np.arange(pixels, dtype=np.float32) + 0.5) / pixels - 0.5
    steps = across * np.float32(extent_mm * width / width_mm)  # image pixels from its centre
    columns, rows = np.meshgrid(steps + (width - 1) / 2, steps + (height - 1) / 2)
    mapped = cv2.remap(linear, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = np.broadcast_to(np.atleast_3d(mapped), (pixels, pixels, 3))  # grey is all three
    return np.asarray(white * colours, np.float32)


def _image(path: Path) -> tuple[NDArray, float]:
    """The image and its full scale."""
    try:
        image, full_scale, _ = read_image(path)
        if image.dtype.kind != "u":
            raise InputError("is not an image of 8 or 16 bits")
    except OSError as error:
        raise _wrong(path, f"cannot be read ({error.strerror})") from error
    except InputError as error:
        raise _wrong(path, str(error).rstrip(".")) from error
    return image, full_scale or float(np.iinfo(image.dtype).max)


def _wrong(path: Path, fault: str) -> SceneError:
    return SceneError(
        f"phantom.wall_image = {shortened(str(path))} {fault}. Give a PNG, JPEG or TIFF file; a "
        "relative path starts at the current folder."
    )


PICTURE_MM, PICTURE_PX = 24.0, 2048
"""Width and height of the picture, in mm along the wall and in pixels."""

PHOTOGRAPH = Path(__file__).with_name("fundus_photograph.png")
"""A part of "Fundus photograph of normal left eye" (CC0 1.0), from Häggström, Mikael: Medical
gallery of Mikael Häggström 2014. WikiJournal of Medicine 1 (2), doi 10.15347/wjm/2014.008."""
PHOTOGRAPH_MM = 4.9
"""Its width: 510 px of a field of 45°, of which a pixel is 9.6 um of retina. It is 8.7 mm high."""


def wall_colour(phantom: Phantom, *, pixels: int = PICTURE_PX) -> np.ndarray:
    """Mean linear reflectance of the wall per colour channel."""
    if phantom.wall == "uniform":
        return np.full(3, phantom.reflectance)
    return wall_picture(phantom, pixels=pixels).mean(axis=(0, 1), dtype=float)


def wall_picture(phantom: Phantom, *, pixels: int = PICTURE_PX) -> np.ndarray:
    """Linear reflectance on a plane about the pole, pixels x pixels x 3; row 0 at +Y.

    Raises:
        SceneError: phantom.wall_image cannot be read.
    """
    if phantom.wall == "image":
        path, width_mm = Path(phantom.wall_image), phantom.wall_image_mm
    elif phantom.wall == "photograph":
        path, width_mm = PHOTOGRAPH, PHOTOGRAPH_MM
    else:
        return _fundus(phantom.texture_seed, phantom.wall, pixels)
    return wall_image(
        path,
        width_mm=width_mm,
        white=phantom.reflectance,
        extent_mm=PICTURE_MM,
        pixels=pixels,
    )


@functools.lru_cache(maxsize=2)
def _fundus(seed: int, palette: Any, pixels: int) -> np.ndarray:
    # All trials of a run have the same wall.
    return fundus(seed=seed, extent_mm=PICTURE_MM, pixels=pixels, palette=palette)


_LEAST_REFLECTANCE = 0.0031308  # least reflectance in a random wall


def write_random_wall(path: Path, *, seed: int, width_mm: float) -> None:
    """Write a grey picture whose log reflectance is a Gaussian process.

    Its covariance is `unknown_wall.texture`, by the discrete Fourier transform, so that the
    picture repeats at its border. The median reflectance is half of white.

    Args:
        path: of the PNG file, 16 bits, for phantom.wall_image.
        width_mm: of the picture, a square; its 1024 pixels must resolve the grain of 0.08 mm.
    """
    pixels = 1024
    along = np.minimum(np.arange(pixels), pixels - np.arange(pixels)) * width_mm / pixels
    covariance = np.asarray(texture(np.hypot(along[:, None], along)))
    amplitude = np.sqrt(np.maximum(np.fft.fft2(covariance).real, 0.0))
    white = np.random.default_rng(seed).standard_normal((pixels, pixels))
    log_reflectance = np.fft.ifft2(np.fft.fft2(white) * amplitude).real
    coded = srgb_of_light(np.clip(0.5 * np.exp(log_reflectance), _LEAST_REFLECTANCE, 1.0))
    cv2.imwrite(str(path), np.round(65535 * coded).astype(np.uint16))


_PAPER_PERIOD_MM = 0.2
"""Period at which paper has half of its modulation, mm.

Arney, Chauvin, Nauman & Anderson, "Kubelka-Munk theory and the MTF of paper", J. Imaging Sci.
Technol. 47, 339 (2003) measure it as kappa_p with projected edges; J. S. Arney gives 0.15-0.35 mm
for all papers that he saw and 0.2 mm as usual. The length hardly depends on the colour (Namedanian,
Gooran & Nystrom 2011).
"""

PRESETS_MM = {
    # The modulation (1 + (2 pi L/period)^2)^(-3/2) is one half there.
    "printed paper": (np.sqrt(4.0 ** (1 / 3) - 1.0) / (2 * np.pi) * _PAPER_PERIOD_MM,) * 3,
}
"""L for red, green and blue, mm.

The retina has no entry: its layers were measured one by one on excised tissue (Hammer et al. 1995),
and no spread of the whole fundus, which the choroid's absorption and the sclera's depth decide, was
found that could be checked.
"""


def wall_spread(phantom: Phantom) -> np.ndarray | None:
    """L for red, green and blue, mm; None if light leaves the wall where it arrives."""
    if phantom.spread == "none":
        return None
    return np.array(PRESETS_MM.get(phantom.spread, phantom.spread_mm))
