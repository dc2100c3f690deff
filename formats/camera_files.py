"""Camera calibrations as OpenCV, ROS and Kalibr write them, in YAML, JSON or XML.

ROS: the files of camera_calibration and camera_info_manager, and what `ros2 topic echo` or
`rostopic echo` print of a CameraInfo.
"""

import re
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from eyespot.formats.camera_sheet import LensDistortion
from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.whole_files import damage_reported

_NAMES = {
    "image_width": ("imagewidth", "width"),
    "image_height": ("imageheight", "height"),
    "camera_matrix": ("cameramatrix", "k"),
    "distortion_coefficients": tuple(
        "distortioncoefficients distortioncoeffs distcoeffs distcoeff d".split()
    ),
}
"""Spellings of OpenCV's samples, ROS and common tutorials, in lower case and without _."""
_COEFFICIENTS = {
    "plumb_bob": (4, 5),
    "radtan": (4,),  # what Kalibr calls plumb_bob
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
    "fisheye": (4,),  # what OpenCV calls equidistant
}
_MAX_COUNT = 2**20  # px, and largest binning
_MAX_NESTING = 10  # levels of lists and maps


def calibration_in(text: str) -> dict[str, Any]:
    """The content of a YAML or XML file.

    Raises:
        InputError: neither of them, or several YAML documents that differ.
    """
    with damage_reported("no camera calibration", "Give the file that the calibration wrote."):
        if text.lstrip().startswith("<"):
            found = [_of_xml(text)]
        else:
            # The first line of OpenCV's files is no YAML.
            found = list(yaml.load_all(_checked(re.sub(r"\A\s*%YAML.*", "", text)), _Loader))
    maps = [one for one in found if isinstance(one, dict)]
    if not maps:
        raise InputError(
            "neither a microscope.json (no `schema` in it) nor a camera calibration of OpenCV, ROS "
            "or Kalibr. Give the file that the calibration wrote, or take the one from a stack."
        )
    if any(one | {"header": 0} != maps[0] | {"header": 0} for one in maps):
        raise InputError(f"it has {len(maps)} parts between --- that differ. Keep one of them.")
    return maps[0]


def camera_of(content: dict[str, Any]) -> tuple[LensDistortion, list[int]]:
    """The camera of a calibration, and width and height of its frames, px.

    The matrix of a CameraInfo is that of the whole sensor, while its frames have `roi` and
    `binning`. Pixel centres are at integers, and a binned pixel is the middle of its n pixels, so u
    becomes (u - offset + 1/2)/n - 1/2. (image_geometry takes (u - offset)/n, which for n = 2 lies
    0.25 px further right.)

    Raises:
        InputError: a key is missing, not a number, or names another model; the message names it.
    """
    content = {str(key).replace("_", "").lower(): value for key, value in content.items()}
    if cameras := [key for key in content if re.fullmatch("cam[0-9]", key)]:
        content |= _of_kalibr(content, cameras)
    matrix = np.array(_numbers(content, "camera_matrix"))
    if matrix.size == 9:
        matrix = matrix.reshape(3, 3)
    size, roi = [], content.get("roi") or {}
    for axis, (name, side) in enumerate((("x", "width"), ("y", "height"))):
        whole = _count(_first(content, f"image_{side}"), f"image_{side}")
        binning = _count(content.get(f"binning{name}", 0), f"binning_{name}") or 1
        offset, part = (
            _count(roi.get(key, 0) if isinstance(roi, dict) else None, f"roi.{key}")
            for key in (f"{name}_offset", side)
        )
        part = part or whole - offset
        if not binning <= part <= whole - offset:
            raise InputError(
                f"{side} is {whole} px, but roi takes {part} px of it from {offset} on, and "
                f"binning_{name} is {binning}. Correct roi and binning_{name}."
            )
        size.append(part // binning)
        if matrix.shape == (3, 3):  # or else `LensDistortion` refuses it
            matrix[axis] /= binning
            matrix[axis, 2] += (0.5 - offset) / binning - 0.5
    return LensDistortion(matrix=matrix, **_distortion(content)), size


def _of_kalibr(content: dict[str, Any], cameras: list[str]) -> dict[str, Any]:
    """The same as ROS names it."""
    camera = content[cameras[0]]
    if len(cameras) > 1 or not isinstance(camera, dict):
        raise InputError(f"it holds {', '.join(cameras)}. Keep the camera that took the frames.")
    if camera.get("camera_model") != "pinhole":
        raise InputError(
            f"{cameras[0]}.camera_model must be pinhole; got "
            f"{shortened(camera.get('camera_model'))}. Calibrate with pinhole-radtan or "
            "pinhole-equi."
        )
    found = {key.replace("_", ""): value for key, value in camera.items() if isinstance(key, str)}
    fx, fy, cx, cy = _row(found, "intrinsics", 4)
    width, height = _row(found, "resolution", 2)
    return found | {"k": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], "width": width, "height": height}


def _row(content: dict[str, Any], name: str, length: int) -> list[float]:
    found = _array(content.get(name), name)
    if found.shape != (length,):
        raise InputError(f"{name} must hold {length} numbers; got {shortened(content.get(name))}.")
    return found.tolist()


def _distortion(content: dict[str, Any]) -> dict[str, Any]:
    """Coefficients and model of a `LensDistortion`."""
    values = _numbers(content, "distortion_coefficients").ravel()
    said = " ".join(f"{content.get(key)}" for key in ("model", "cameramodel")).lower()
    name = content.get("distortionmodel")
    if name is None and ("fisheye" in said or f"{content.get('fisheyemodel')}" in ("1", "True")):
        name = "fisheye"
    if name is None and values.size == 4 and values.any():
        raise InputError(
            "4 coefficients may be those of plumb_bob or of a fisheye (equidistant) calibration, "
            "and the file does not say which. Add a line `distortion_model: plumb_bob`, or "
            "equidistant."
        )
    model = f"{name or ''}".strip('"').lower()
    if not values.any() and model in ("", "none", "plumb_bob"):
        return {"distortion": np.zeros(5)}
    if name is None:
        return {"distortion": values}
    counts = _COEFFICIENTS.get(model)
    if counts is None:
        raise InputError(
            "distortion_model must be plumb_bob, rational_polynomial or equidistant (of Kalibr: "
            f"radtan, equidistant or none); got {shortened(name)}. Calibrate with one of these."
        )
    if not values[counts[-1] :].any():
        values = values[: counts[-1]]  # some drivers fill the message up with zeros
    if values.size not in counts:
        raise InputError(
            f"distortion_model {model} has {' or '.join(map(str, counts))} coefficients; got "
            f"{values.size}. Name the model that they were calibrated for."
        )
    is_fisheye = model in ("equidistant", "fisheye")
    return {"distortion": values, "model": "equidistant" if is_fisheye else "brown"}


def _first(content: dict[str, Any], name: str) -> Any:
    """The value under one of a key's spellings."""
    for spelling in _NAMES[name]:
        if content.get(spelling) is not None:
            return content[spelling]
    raise InputError(f"{name} (or {_NAMES[name][-1]}) is missing. Add it to the file.")


def _count(value: object, name: str) -> int:
    found = _array(value, name)
    if found.size != 1 or not 0 <= found <= _MAX_COUNT or not found == np.floor(found):
        raise InputError(
            f"{name} must be one whole number, at most {_MAX_COUNT:,}; got {shortened(value)}."
        )
    return int(found.item())


def _numbers(content: dict[str, Any], name: str) -> np.ndarray:
    """Numbers of a list, nested or not, or of a map of rows, cols (or sizes) and data."""
    value = _first(content, name)
    if not isinstance(value, dict):
        return _array(value, name)
    found = _array(value.get("data", []), name)
    sides = value.get("sizes", [value.get("rows"), value.get("cols")])
    shape = _array(sides, f"rows and cols of {name}").ravel()
    if (
        not (np.isfinite(shape) & (shape > 0)).all()
        or (shape % 1).any()
        or np.prod(shape) != found.size
    ):
        raise InputError(
            f"{name} has {found.size} numbers, but rows and cols say "
            f"{' x '.join(f'{side:g}' for side in shape)}."
        )
    return found.reshape(shape.astype(int))


def _array(value: object, name: str) -> np.ndarray:
    try:
        return np.asarray(value, float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must hold numbers; got {shortened(value)}.") from error


class _Loader(yaml.CSafeLoader):
    """YAML with OpenCV's matrices, which are maps."""


_Loader.add_multi_constructor(
    "tag:yaml.org,2002:opencv-", lambda loader, _, node: loader.construct_mapping(node, deep=True)
)


def _checked(text: str) -> str:
    """Refuse what grows when it is loaded: references to other parts, and nesting without end."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_NESTING or isinstance(event, yaml.AliasEvent):
            raise InputError(f"more than {_MAX_NESTING} levels, or a reference (*) to another part")
    return text


def _of_xml(text: str) -> Any:
    if "<!DOCTYPE" in text:
        raise InputError("it defines entities")

    def value(element: ElementTree.Element) -> Any:
        if len(element):
            return {child.tag: value(child) for child in element}
        words = (element.text or "").split()
        return words[0] if len(words) == 1 else words

    return value(ElementTree.fromstring(text))
