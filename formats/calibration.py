"""Calibration file: JSON with a model's fitted parameters, their covariance and their origin.

    {"schema": 2,
     "model": "planar",
     "medium": {"name": "air", "index": 1.0},
     "parameters": {"k": {"value": 20.0, "unit": "1", "sigma": 0.1}, "b": {...}},
     "covariance": {"order": ["k", "b"], "matrix": [[...], [...]]},
     "fitted_on": {"description": "...", "sha256": "..."},
     "sigma_inflation": 1.0,
     "microscope": "A, zoom 1.6",
     "stated": {"robot_scale": [[-0.2, 0.05]], "touch": [[0.0, 0.02]]},
     "software": "eyespot 0.1.0"}

The standard errors are given twice, beside the values for people and in the covariance for
software. A file in which the two disagree was edited by hand and is refused.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import AllowInfNan, ConfigDict, Field

from eyespot.formats.inputs import (
    InputError,
    Strict,
    check_schema,
    in_file,
    object_in,
    read_text,
    shortened,
    validated,
)
from eyespot.formats.poses import Vector
from eyespot.formats.whole_files import write_text

CONE_MODELS = ("planar", "small_plane", "corrected", "stereographic", "exact", "area")
"""Models of a sharp cone: each can use a calibration that was fitted with another of them."""
MODELS = (*CONE_MODELS, "lens")


_MOST_ASKEW_RAD = math.radians(20)  # a fibre that is more askew belongs to another tool
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
    "scale": Quantity("mm/px", 0, 100),
    "eye_radius": Quantity("mm", 0, 1000),
    "inverse_working_distance": Quantity("1/mm", -_LARGE, _LARGE),
    "eccentricity": Quantity("mm", 0, _LARGE, low_included=True),
    "beam_x": Quantity("rad", -_MOST_ASKEW_RAD, _MOST_ASKEW_RAD),
    "beam_y": Quantity("rad", -_MOST_ASKEW_RAD, _MOST_ASKEW_RAD),
    "core_radius": Quantity("mm", 0, 10),
    "glue_length": Quantity("mm", 0, 10, low_included=True),
    "aperture_radius": Quantity("mm", 0, 10),
    "sag": Quantity("mm", 0, 10, low_included=True),
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
OF_MICROSCOPE = ("scale", "inverse_working_distance")
"""Parameters of the microscope and its zoom, which all recordings through it share."""
_COMMON = {"scale", "eye_radius", "inverse_working_distance", "eccentricity", *BEAM}


def check_parameters(model: str, values: Mapping[str, float]) -> None:
    """Refuse values that no fit of a model can give.

    Raises:
        InputError: unknown model, a parameter that is missing or not of this model, or a
            value out of range.
    """
    if model not in MODELS:
        raise InputError(f"model must be one of {', '.join(MODELS)}; got {shortened(model)}.")
    names = set(values)
    for name in names:
        quantity(name)
    if model == "lens":
        required, optional = set(_LENS_REQUIRED), set(LENS_PARAMETERS) | {"brightness"}
    else:
        if len(names & {"k", "half_angle"}) != 1:
            raise InputError(f"model {model} takes either k or half_angle; got {_listed(names)}.")
        required, optional = {"b"}, {"k", "half_angle"}
    missing, strange = required - names, names - required - optional - _COMMON
    if missing or strange:
        raise InputError(
            f"parameters of the model {model}: missing {_listed(missing)}; not of this model "
            f"{_listed(strange)}. Fit this model, or name the model that was fitted."
        )
    for name, value in values.items():
        unit, low, high, low_included = QUANTITIES[name]
        # NaN fails every comparison.
        if not ((value >= low if low_included else value > low) and value < high):
            raise InputError(
                f"parameters.{name} must lie in {'[' if low_included else '('}{low:.6g}, "
                f"{high:.6g}) {unit}; got {value}. Fit again, or restore the value."
            )


_NO_LARGER = (
    ("core_radius", "aperture_radius"),
    ("sag", "aperture_radius"),
    ("sag", "glue_length"),
    ("numerical_aperture", "glue_index"),
)
"""Parameters of a lens of which the first is at most the second."""
_WIDEST_BEAM_MM = 25.0  # radius at the tip; no beam is as wide as an eye
_INDICES = {"air": (1.0, 1.001), "water": (1.32, 1.35), "vitreous": (1.33, 1.35)}


def _check_together(calibration: "Calibration") -> None:
    """Refuse values of a file that are possible each by itself, but not together."""
    values = calibration.values
    for small, large in _NO_LARGER:
        if small in values and values[small] > values[large] * (1 + _SAME):
            raise InputError(
                f"parameters.{small} must be at most parameters.{large}; got {values[small]:g} and "
                f"{values[large]:g}. Fit again, or restore the value."
            )
    if "b" in values:
        half_angle, b, _ = calibration.cone
        if (radius := abs(b) * math.tan(half_angle)) > _WIDEST_BEAM_MM:
            raise InputError(
                f"parameters.b must leave a beam of at most {_WIDEST_BEAM_MM:g} mm radius at the "
                f"tip; got {b:g} mm, and with the cone's angle {radius:.3g} mm. Fit again, or "
                "restore the value."
            )
    low, high = _INDICES.get(calibration.medium, (1.0, 2.0))
    if not low <= calibration.medium_index <= high:
        raise InputError(
            f"medium.index of {calibration.medium} must lie from {low:g} to {high:g}; got "
            f"{calibration.medium_index:g}. Restore the value, or name another medium."
        )


def quantity(name: str) -> Quantity:
    """Unit and range of a parameter.

    Raises:
        InputError: there is no such parameter.
    """
    if name not in QUANTITIES:
        raise InputError(
            f"parameters.{shortened(name)[1:-1]} is unknown; known are {', '.join(QUANTITIES)}."
        )
    return QUANTITIES[name]


def _listed(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none"


SCHEMA = 3
HISTORY = {
    1: "the format of eyespot 0.1",
    2: "the parameters may contain beam_x and beam_y, the beam's direction in the tool's frame; "
    "sigma_inflation says by how much a misfit enlarges the standard errors",
    3: "microscope names the one whose scale and pinhole are among the parameters; stated says how "
    "far the parameters follow what a rig stated",
}

_LARGEST = 1e24  # largest covariance, in the square of a parameter's unit

_SAME = 1e-6  # relative; sigma and covariance are one number written twice


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Parameters of a model, their errors, and their origin.

    Attributes:
        model: the model that was fitted, one of `MODELS`.
        values: by name in the units of `QUANTITIES`, in the covariance's order. A model of a cone
            has b and either k or half_angle; a lens has what `optics.glue_lens` takes.
        covariance: symmetric, in products of those units.
        medium: name of the medium between tip and wall; another medium needs another calibration.
        medium_index: its refractive index.
        fitted_on: free text: the data of the fit.
        data_sha256: fingerprint of those data, 64 hexadecimal digits.
        software: name and version that made the fit.
        sigma_inflation: largest factor by which the standard errors exceed those from noise alone,
            because the model misses part of the light; 1 for a good fit and in files of version 1.
        microscope: name of the microscope and zoom to which scale and pinhole among the values
            belong; empty: they count for all images.
        stated: by what a rig states (`robot_scale`, `touch`, ...), how far the values follow one
            standard deviation of it, (m, p), a row for each independent statement. It is part of
            the covariance.
    """

    model: str
    values: Mapping[str, float]
    covariance: np.ndarray
    medium: str
    medium_index: float
    fitted_on: str
    data_sha256: str
    software: str
    sigma_inflation: float = 1.0
    microscope: str = ""
    stated: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Reject what no fit can give.

        Raises:
            InputError: naming key, value and remedy.
        """
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))
        object.__setattr__(self, "covariance", np.asarray(self.covariance, float))
        rows = {name: np.asarray(moved, float) for name, moved in self.stated.items()}
        object.__setattr__(self, "stated", MappingProxyType(rows))
        check_parameters(self.model, self.values)
        for name, moved in rows.items():
            if moved.ndim != 2 or moved.shape[1] != len(self.values):
                raise InputError(
                    f"stated.{shortened(name)[1:-1]} must have rows of {len(self.values)} numbers, "
                    f"one a parameter; got shape {moved.shape}."
                )
        _check_covariance(self.covariance, len(self.values))
        if not 1 <= self.medium_index <= 2:
            raise InputError(
                f"medium index must lie in [1, 2]; got {self.medium_index}. Air has 1, vitreous "
                "1.336."
            )
        if not re.fullmatch("[0-9a-f]{64}", self.data_sha256):
            raise InputError(
                "fitted_on sha256 must be 64 hexadecimal digits, lower case; got "
                f"{shortened(self.data_sha256)}. Fit again to get a true one."
            )

    @property
    def beam_in_tool(self) -> Vector:
        """Unit vector of the beam in the tool's frame; +z if the fit did not determine it."""
        x, y = (self.values.get(name, 0.0) for name in BEAM)
        size = math.hypot(x, y, 1.0)
        return x / size, y / size, 1.0 / size

    @property
    def cone(self) -> tuple[float, float, np.ndarray]:
        """half_angle, rad, and b, mm, of a cone, and the covariance of both."""
        name = "half_angle" if "half_angle" in self.values else "k"
        angle, b = self.values[name], self.values["b"]
        rows = [list(self.values).index(row) for row in (name, "b")]
        covariance = self.covariance[np.ix_(rows, rows)]
        if name == "k":  # half_angle = atan(1/k)
            slopes = np.diag([-1.0 / (1.0 + angle**2), 1.0])
            covariance, angle = slopes @ covariance @ slopes, math.atan(1.0 / angle)
        return angle, b, covariance

    def seen_by(self, microscope: str, *, own_path: bool = False) -> "Calibration":
        """The calibration for images of a microscope.

        Scale and pinhole of another one are left out; the errors of the other parameters contain
        theirs.

        Args:
            microscope: its name; empty if it has none.
            own_path: whether what lies between it and the wall is described elsewhere.
        """
        if not self.microscope:
            return self
        same = self.microscope == microscope
        out = set(OF_MICROSCOPE) if not same else {OF_MICROSCOPE[1]} if own_path else set()
        kept = [i for i, name in enumerate(self.values) if name not in out]
        names = list(self.values)
        return replace(
            self,
            values={names[i]: self.values[names[i]] for i in kept},
            covariance=self.covariance[np.ix_(kept, kept)],
            stated={name: rows[:, kept] for name, rows in self.stated.items()},
            microscope=microscope if same else "",
        )

    def sigma(self, name: str) -> float:
        """Standard error of a parameter, in its own unit."""
        index = list(self.values).index(name)
        return math.sqrt(self.covariance[index, index])


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration file, whole or not at all; InputError if one of this name exists."""
    content = {
        "schema": SCHEMA,
        "model": calibration.model,
        "medium": {"name": calibration.medium, "index": calibration.medium_index},
        "parameters": {
            name: {"value": value, "unit": quantity(name).unit, "sigma": calibration.sigma(name)}
            for name, value in calibration.values.items()
        },
        "covariance": {
            "order": list(calibration.values),
            "matrix": calibration.covariance.tolist(),
        },
        "fitted_on": {"description": calibration.fitted_on, "sha256": calibration.data_sha256},
        "sigma_inflation": calibration.sigma_inflation,
        "microscope": calibration.microscope,
        "stated": {name: rows.tolist() for name, rows in calibration.stated.items()},
        "software": calibration.software,
    }
    write_text(Path(path), json.dumps(content, indent=1) + "\n")


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration file.

    Raises:
        InputError: not a calibration file, of another schema, or with a value that no fit
            can give; the text names the file, the key, the value and what to do.
        OSError: the file cannot be read.
    """
    path = Path(path)
    with in_file(path):
        with in_file("not a calibration file"):
            content = object_in(read_text(path))
        return calibration_in(content)


class _MediumKey(Strict):
    name: str = Field(description="Of the medium.")
    index: float = Field(description="Refractive index of the medium.")


class _Parameter(Strict):
    value: float = Field(description="Of the parameter.")
    unit: str = Field(description="Of the parameter.")
    sigma: Annotated[float, Field(ge=0)] = Field(description="Standard error of the parameter.")


class _Covariance(Strict):
    order: list[str] = Field(description="Names of the parameters in the order of the matrix.")
    matrix: list[list[Annotated[float, AllowInfNan()]]] = Field(
        description="Covariance, in products of the parameters' units."
    )


class _Origin(Strict):
    description: str = Field(description="The data of the fit, in words.")
    sha256: str = Field(description="Fingerprint of those data.")


class _CalibrationFile(Strict):
    model_config = ConfigDict(protected_namespaces=())  # `model` is the format's own key

    schema_: Annotated[int, Field(alias="schema")]
    model: str
    medium: _MediumKey
    parameters: dict[str, _Parameter] = Field(description="Values with standard errors, by name.")
    covariance: _Covariance
    fitted_on: _Origin
    sigma_inflation: Annotated[float, Field(ge=1, le=_LARGEST)] = 1.0
    microscope: str = Field("", max_length=80)
    stated: dict[str, list[list[Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]]]] = Field({})
    software: str


def calibration_in(content: dict[str, Any]) -> Calibration:
    """The calibration that the content of a file describes.

    Raises:
        InputError: as `read_calibration`.
    """
    check_schema(content.get("schema"), HISTORY, remedy="Fit again, or restore the file.")
    file = validated(_CalibrationFile, content, remedy="Restore the file, or fit again.")
    for name, entry in file.parameters.items():
        unit = quantity(name).unit
        if entry.unit != unit:
            raise InputError(
                f"parameters.{name} must be in {unit!r}; got unit {shortened(entry.unit)}. "
                "Convert value, sigma and covariance."
            )
    names, rows = list(file.parameters), file.covariance.matrix
    if file.covariance.order != names:
        raise InputError(
            f"covariance order must list the parameters in their order, {names}; got "
            f"{shortened(file.covariance.order)}. Sort rows and columns of the matrix likewise."
        )
    if len({len(row) for row in rows}) > 1:
        raise InputError(
            f"covariance matrix must have rows of equal length; got {shortened(rows)}."
        )
    calibration = Calibration(
        model=file.model,
        values={name: entry.value for name, entry in file.parameters.items()},
        covariance=np.array(rows, float),
        medium=file.medium.name,
        medium_index=file.medium.index,
        fitted_on=file.fitted_on.description,
        data_sha256=file.fitted_on.sha256,
        software=file.software,
        sigma_inflation=file.sigma_inflation,
        microscope=file.microscope,
        stated={name: _rectangular(name, moved) for name, moved in file.stated.items()},
    )
    _check_together(calibration)
    for name, entry in file.parameters.items():
        expected = calibration.sigma(name)
        if not math.isclose(entry.sigma, expected, rel_tol=_SAME, abs_tol=1e-300):
            raise InputError(
                f"sigma of {name} is {entry.sigma:g}, but the covariance says {expected:g}. Change "
                "both, or fit again."
            )
    return calibration


def _rectangular(name: str, rows: list[list[float]]) -> np.ndarray:
    if len({len(row) for row in rows}) != 1:
        raise InputError(f"stated.{name} must have rows of equal length; got {shortened(rows)}.")
    return np.array(rows, float)


def _check_covariance(matrix: np.ndarray, count: int) -> None:
    if matrix.shape != (count, count):
        raise InputError(
            f"covariance must be {count}x{count}, a row and a column a parameter; got shape "
            f"{matrix.shape}."
        )
    if not (np.abs(matrix) <= _LARGEST).all():
        raise InputError(
            f"covariance must be finite, at most {_LARGEST:g}. Leave out parameters that the "
            "data do not determine."
        )
    deviation = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.outer(deviation, deviation)
    if (np.diag(matrix) < 0).any() or (np.abs(matrix - matrix.T) > _SAME * scale).any():
        raise InputError(
            "covariance must be symmetric with no negative variance. Restore the matrix."
        )
    fixed = deviation == 0
    correlation = matrix / np.where(scale > 0, scale, 1.0)
    if matrix[fixed].any() or np.linalg.eigvalsh(correlation).min() < -_SAME:
        raise InputError(
            "covariance must be positive semi-definite: no correlation may exceed 1. Restore the "
            "matrix."
        )
