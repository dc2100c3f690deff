"""Calibration file: JSON with a model's fitted parameters, their covariance and their origin.

The standard errors are given twice, beside the values for people and in the covariance for
software. A file in which the two disagree was edited by hand and is refused.
"""

import json
import math
import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import AllowInfNan, ConfigDict, Field, model_validator

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

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

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

_MAX_COVARIANCE = 1e24  # largest covariance, in the square of a parameter's unit

_SIGMA_TOLERANCE = 1e-6  # relative; sigma and covariance are one number written twice


class CalibratedMedium(Strict):
    """What lies between the tip and the wall."""

    name: str = Field(description="Of the medium; another one needs another calibration.")
    index: float = Field(ge=1, le=2, description="Its refractive index.")


class Parameter(Strict):
    """A fitted value."""

    value: float = Field(description="Of the parameter.")
    unit: str = Field(description="Of the parameter.")
    sigma: float = Field(ge=0, description="Standard error of the parameter.")


class Covariance(Strict):
    """Covariance of all parameters."""

    order: list[str] = Field(description="Names of the parameters in the order of the matrix.")
    matrix: list[list[Annotated[float, AllowInfNan()]]] = Field(
        description="Covariance, in products of the parameters' units."
    )


class Origin(Strict):
    """The data of a fit."""

    description: str = Field(description="The data of the fit, in words.")
    sha256: str = Field(description="Fingerprint of those data, 64 hexadecimal digits.")


class Calibration(Strict):
    """Parameters of a model, their errors, and their origin, as the file has them.

    A model of a cone has b and either k or half_angle; a lens has what `optics.glue_lens` takes.
    """

    model_config = ConfigDict(protected_namespaces=())  # `model` is the format's own key

    schema_: int = Field(SCHEMA, alias="schema")
    model: str = Field(description="The model that was fitted.")
    medium: CalibratedMedium = Field(description="Between the tip and the wall.")
    parameters: dict[str, Parameter] = Field(
        description="Values with standard errors, by name, in the covariance's order."
    )
    covariance_: Covariance = Field(alias="covariance", description="Of the parameters.")
    fitted_on: Origin = Field(description="The data of the fit.")
    sigma_inflation: float = Field(
        1.0,
        ge=1,
        le=_MAX_COVARIANCE,
        description="Largest factor by which the standard errors exceed those from noise alone, "
        "because the model misses part of the light; 1 for a good fit.",
    )
    microscope: str = Field(
        "",
        max_length=80,
        description="Name of the microscope and zoom to which scale and pinhole among the "
        "parameters belong; empty: they count for all images.",
    )
    stated_: dict[
        str, list[list[Annotated[float, Field(ge=-_MAX_COVARIANCE, le=_MAX_COVARIANCE)]]]
    ] = Field(
        {},
        alias="stated",
        description="By what a rig states (`robot_scale`, `touch`, ...), how far the parameters "
        "follow one standard deviation of it, a row for each independent statement. It is part of "
        "the covariance.",
    )
    software: str = Field(description="Name and version that made the fit.")

    @classmethod
    def of(
        cls,
        *,
        model: str,
        values: Mapping[str, float],
        covariance: "ArrayLike",
        medium: str,
        medium_index: float,
        fitted_on: str,
        data_sha256: str,
        software: str,
        sigma_inflation: float = 1.0,
        microscope: str = "",
        stated: "Mapping[str, ArrayLike] | None" = None,
    ) -> Self:
        """A calibration from numbers.

        Args:
            values: by name, in the units of `QUANTITIES`.
            covariance: (n, n), in their order and in products of their units.
            stated: (m, n) by name.

        Raises:
            InputError: no fit can give this; the text has key, value and remedy.
        """
        matrix = np.asarray(covariance, float)
        known = np.sqrt(np.maximum(np.diag(matrix), 0)) if matrix.ndim == 2 else np.zeros(0)
        sigmas = dict(zip(values, known.tolist(), strict=False))  # their number is checked below
        content = {
            "schema": SCHEMA,
            "model": model,
            "medium": {"name": medium, "index": medium_index},
            "parameters": {
                name: {
                    "value": float(value),
                    "unit": quantity(name).unit,
                    "sigma": sigmas.get(name, 0.0),
                }
                for name, value in values.items()
            },
            "covariance": {"order": list(values), "matrix": matrix.tolist()},
            "fitted_on": {"description": fitted_on, "sha256": data_sha256},
            "sigma_inflation": float(sigma_inflation),
            "microscope": microscope,
            "stated": {name: np.asarray(rows).tolist() for name, rows in (stated or {}).items()},
            "software": software,
        }
        return validated(cls, content, remedy="Fit again.")

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        values, units = self.values, {name: quantity(name).unit for name in self.parameters}
        check_parameters(self.model, values)
        for name, entry in self.parameters.items():
            if entry.unit != units[name]:
                raise InputError(
                    f"parameters.{name} must be in {units[name]!r}; got unit "
                    f"{shortened(entry.unit)}. Convert value, sigma and covariance"
                )
        if self.covariance_.order != list(values):
            raise InputError(
                f"covariance order must list the parameters in their order, {list(values)}; got "
                f"{shortened(self.covariance_.order)}. Sort rows and columns of the matrix likewise"
            )
        matrix = self.covariance_.matrix
        for name, rows in {"covariance matrix": matrix, **self.stated_}.items():
            square = rows is not matrix or len(rows) == len(values)
            if {len(row) for row in rows} != {len(values)} or not square:
                raise InputError(
                    f"{name} must have rows of {len(values)} numbers, one a parameter; got "
                    f"{shortened(rows)}"
                )
        check_covariance(self.covariance)
        if not re.fullmatch("[0-9a-f]{64}", self.fitted_on.sha256):
            raise InputError(
                "fitted_on.sha256 must be 64 hexadecimal digits, lower case; got "
                f"{shortened(self.fitted_on.sha256)}"
            )
        for name, entry in self.parameters.items():
            expected = self.sigma(name)
            if not math.isclose(entry.sigma, expected, rel_tol=_SIGMA_TOLERANCE, abs_tol=1e-300):
                raise InputError(
                    f"sigma of {name} is {entry.sigma:g}, but the covariance says {expected:g}. "
                    "Change both"
                )
        return self

    @cached_property
    def values(self) -> Mapping[str, float]:
        """Values by name, in the covariance's order."""
        return MappingProxyType({name: entry.value for name, entry in self.parameters.items()})

    @property
    def covariance(self) -> np.ndarray:
        """(n, n), in the values' order."""
        return np.array(self.covariance_.matrix, float)

    @property
    def stated(self) -> dict[str, np.ndarray]:
        """(m, n) by what a rig states: how far the values follow one standard deviation of it."""
        return {name: np.array(rows, float) for name, rows in self.stated_.items()}

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
        rows = [i for i, name in enumerate(self.values) if name not in out]
        names = [name for name in self.values if name not in out]
        content = self.model_dump(by_alias=True) | {
            "parameters": {name: dict(self.parameters[name]) for name in names},
            "covariance": {
                "order": names,
                "matrix": self.covariance[np.ix_(rows, rows)].tolist(),
            },
            "stated": {name: moved[:, rows].tolist() for name, moved in self.stated.items()},
            "microscope": microscope if same else "",
        }
        return validated(Calibration, content, remedy="Fit again.")

    def sigma(self, name: str) -> float:
        """Standard error of a parameter, in its own unit."""
        index = list(self.values).index(name)
        return math.sqrt(self.covariance[index, index])


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration file, whole or not at all; InputError if one of this name exists."""
    content = calibration.model_dump(by_alias=True) | {"schema": SCHEMA}
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


def calibration_in(content: dict[str, Any]) -> Calibration:
    """The calibration that the content of a file describes.

    Raises:
        InputError: as `read_calibration`.
    """
    check_schema(content.get("schema"), HISTORY, remedy="Fit again, or restore the file.")
    calibration = validated(Calibration, content, remedy="Restore the file, or fit again.")
    _check_together(calibration)
    return calibration


def _check_together(calibration: "Calibration") -> None:
    """Refuse values of a file that are possible each by itself, but not together."""
    values = calibration.values
    for small, large in _NO_LARGER:
        if small in values and values[small] > values[large] * (1 + _SIGMA_TOLERANCE):
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
    low, high = _INDICES.get(calibration.medium.name, (1.0, 2.0))
    if not low <= calibration.medium.index <= high:
        raise InputError(
            f"medium.index of {calibration.medium.name} must lie from {low:g} to {high:g}; got "
            f"{calibration.medium.index:g}. Restore the value, or name another medium."
        )


def check_covariance(matrix: np.ndarray, *, most: float = _MAX_COVARIANCE) -> None:
    """Refuse a matrix, (n, n), that is no covariance of errors.

    Args:
        most: largest absolute value, in the products of the values' units.

    Raises:
        InputError: it is not finite, not symmetric, or not positive semi-definite.
    """
    if not (np.abs(matrix) <= most).all():
        raise InputError(
            f"covariance must be finite, at most {most:g}. Leave out parameters that the data do "
            "not determine"
        )
    deviation = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.outer(deviation, deviation)
    if (np.diag(matrix) < 0).any() or (np.abs(matrix - matrix.T) > _SIGMA_TOLERANCE * scale).any():
        raise InputError("covariance must be symmetric with no negative variance")
    fixed = deviation == 0
    # Values differ in scale, so the correlations are what must be definite.
    correlation = matrix / np.where(scale > 0, scale, 1.0)
    if matrix[fixed].any() or np.linalg.eigvalsh(correlation).min() < -_SIGMA_TOLERANCE:
        raise InputError("covariance must be positive semi-definite: no correlation may exceed 1")
