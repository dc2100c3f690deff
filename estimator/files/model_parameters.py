"""Parameters of the models, with their units and ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from optics import InputError, shortened

CONE_MODELS = ("planar", "small_plane", "corrected", "stereographic", "exact", "area")
"""Models of a sharp cone: each can use a calibration that was fitted with another of them."""
MODELS = (*CONE_MODELS, "lens")


class CalibrationError(InputError):
    """A calibration that cannot be used; the text names file, key, value and remedy."""


_ASKEW = math.radians(20)  # of a fibre against its tool; more is another tool
_LARGE, _BRIGHTEST = 1e6, 1e12
"""End of a range that has none by nature; squares and products of such values stay finite."""


class Quantity(NamedTuple):
    """Unit and range of a parameter."""

    unit: str
    low: float
    high: float
    low_included: bool = False


QUANTITIES = {
    "k": Quantity("1", 0, _LARGE),
    "half_angle": Quantity("rad", 0, math.pi / 2),
    "b": Quantity("mm", -_LARGE, _LARGE),
    "scale": Quantity("mm/px", 0, _LARGE),
    "eye_radius": Quantity("mm", 0, _LARGE),
    "inverse_working_distance": Quantity("1/mm", -_LARGE, _LARGE),
    "eccentricity": Quantity("mm", 0, _LARGE, low_included=True),
    "beam_x": Quantity("rad", -_ASKEW, _ASKEW),
    "beam_y": Quantity("rad", -_ASKEW, _ASKEW),
    "core_radius": Quantity("mm", 0, _LARGE),
    "glue_length": Quantity("mm", 0, _LARGE, low_included=True),
    "aperture_radius": Quantity("mm", 0, _LARGE),
    "sag": Quantity("mm", 0, _LARGE, low_included=True),
    "glue_index": Quantity("1", 1, 4, low_included=True),
    "numerical_aperture": Quantity("1", 0, 4),
    "launch_radius": Quantity("mm", 0, _LARGE),
    "launch_aperture": Quantity("1", 0, _LARGE),
    "brightness": Quantity("mm2/s", 0, _BRIGHTEST),
}
"""Unit and range of every parameter that a file may hold.

k = 1/tan(half_angle); b: apex offset; scale: delta at the pole; inverse_working_distance: 1/(z_F +
r), 0 if telecentric, negative if the pinhole lies behind the retina; eccentricity: c of the trials
that were fitted; beam_x, beam_y: angles of the beam from the tool's +z axis, towards the tool's +x
and +y axes; core_radius ... launch_aperture: of the glue lens, as `optics.GlueLens` has them;
brightness: of the spot's peak as a fraction of full scale, over irradiance (1/mm2 per unit power)
and exposure time.
"""

_NAMES = tuple(QUANTITIES)
LENS_PARAMETERS = _NAMES[_NAMES.index("core_radius") : _NAMES.index("brightness")]
_LENS_REQUIRED = LENS_PARAMETERS[:6]
BEAM = ("beam_x", "beam_y")
_COMMON = {"scale", "eye_radius", "inverse_working_distance", "eccentricity", *BEAM}


def check_parameters(model: str, values: Mapping[str, float]) -> None:
    """Refuse values that no fit of a model can give.

    Raises:
        CalibrationError: unknown model, a parameter that is missing or not of this model, or a
            value out of range.
    """
    if model not in MODELS:
        raise CalibrationError(f"model must be one of {', '.join(MODELS)}; got {shortened(model)}.")
    names = set(values)
    for name in names:
        quantity(name)
    if model == "lens":
        required, optional = set(_LENS_REQUIRED), set(LENS_PARAMETERS) | {"brightness"}
    else:
        if len(names & {"k", "half_angle"}) != 1:
            raise CalibrationError(
                f"model {model} takes either k or half_angle; got {_listed(names)}."
            )
        required, optional = {"b"}, {"k", "half_angle"}
    missing, strange = required - names, names - required - optional - _COMMON
    if missing or strange:
        raise CalibrationError(
            f"parameters of the model {model}: missing {_listed(missing)}; not of this model "
            f"{_listed(strange)}. Fit this model, or name the model that was fitted."
        )

    for name, value in values.items():
        _check_value(name, value)


def quantity(name: str) -> Quantity:
    """Unit and range of a parameter.

    Raises:
        CalibrationError: there is no such parameter.
    """
    if name not in QUANTITIES:
        raise CalibrationError(
            f"parameters.{shortened(name)[1:-1]} is unknown; known are {', '.join(QUANTITIES)}."
        )
    return QUANTITIES[name]


def _check_value(name: str, value: float) -> None:
    unit, low, high, low_included = QUANTITIES[name]
    above = value >= low if low_included else value > low
    # NaN fails every comparison.
    if not (above and value < high):
        raise CalibrationError(
            f"parameters.{name} must lie in {'[' if low_included else '('}{low:.6g}, {high:.6g}) "
            f"{unit}; got {value}. Fit again, or restore the value."
        )


def _listed(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none"
