"""Calibration file: JSON with a model's fitted parameters, their covariance and their origin.

    {"schema": 1,
     "model": "planar",
     "medium": {"name": "air", "index": 1.0},
     "parameters": {"k": {"value": 20.0, "unit": "1", "sigma": 0.1}, "b": {...}},
     "covariance": {"order": ["k", "b"], "matrix": [[...], [...]]},
     "fitted_on": {"description": "...", "sha256": "..."},
     "software": "eyespot 0.1.0"}

The standard errors stand twice, beside the values for the reader and in the covariance for the
software; a file in which the two disagree was edited by hand and is refused.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from estimator.files.model_parameters import CalibrationError, check_parameters, quantity
from estimator.files.writing import written_whole

SCHEMA = 1

_SAME = 1e-6  # relative; sigma and covariance are one number written twice


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Parameters of a model, how well they are known, and where they come from.

    Attributes:
        model: that was fitted, one of `model_parameters.MODELS`.
        values: by name in the units of `model_parameters.QUANTITIES`, in the covariance's order. A
            model of a cone has b and either k or half_angle; a lens has what `optics.glue_lens`
            takes.
        covariance: symmetric, in products of those units.
        medium: name of what lies between the tip and the wall; another medium needs another
            calibration.
        medium_index: its refractive index.
        fitted_on: free text: which data.
        data_sha256: fingerprint of those data, 64 hexadecimal digits.
        software: name and version that made the fit.
    """

    model: str
    values: Mapping[str, float]
    covariance: np.ndarray
    medium: str
    medium_index: float
    fitted_on: str
    data_sha256: str
    software: str

    def __post_init__(self) -> None:
        """Reject what no fit can give.

        Raises:
            CalibrationError: naming key, value and remedy.
        """
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))
        object.__setattr__(self, "covariance", np.asarray(self.covariance, float))
        check_parameters(self.model, self.values)
        _check_covariance(self.covariance, len(self.values))
        if not 1 <= self.medium_index <= 2:
            raise CalibrationError(
                f"medium index must lie in [1, 2]; got {self.medium_index}. Air has 1, vitreous "
                "1.336."
            )
        if not re.fullmatch("[0-9a-f]{64}", self.data_sha256):
            raise CalibrationError(
                "fitted_on sha256 must be 64 hexadecimal digits, lower case; got "
                f"{self.data_sha256!r}. Fit again to get a true one."
            )

    def sigma(self, name: str) -> float:
        """Standard error of a parameter, in its own unit."""
        index = list(self.values).index(name)
        return math.sqrt(self.covariance[index, index])


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration file, whole or not at all; an older one of the name is replaced."""
    content = {
        "schema": SCHEMA,
        "model": calibration.model,
        "medium": {"name": calibration.medium, "index": calibration.medium_index},
        "parameters": {
            name: {
                "value": value,
                "unit": quantity(name).unit,
                "sigma": calibration.sigma(name),
            }
            for name, value in calibration.values.items()
        },
        "covariance": {
            "order": list(calibration.values),
            "matrix": calibration.covariance.tolist(),
        },
        "fitted_on": {
            "description": calibration.fitted_on,
            "sha256": calibration.data_sha256,
        },
        "software": calibration.software,
    }
    text = json.dumps(content, indent=1) + "\n"
    with written_whole(Path(path)) as partial:
        partial.write_text(text, encoding="utf-8")


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration file.

    Raises:
        CalibrationError: not a calibration file, of another schema, or with a value that no fit
            can give; the text names the file, the key, the value and what to do.
        OSError: the file cannot be read.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: not a calibration file: {error}.") from error
    try:
        return _calibration(content)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error


def _calibration(content: object) -> Calibration:
    if not isinstance(content, dict) or "schema" not in content:
        raise CalibrationError("not a calibration file: `schema` is missing.")
    if content["schema"] != SCHEMA:
        raise CalibrationError(
            f"schema is {content['schema']!r}; this version reads {SCHEMA}. Fit again with this "
            "version, or use the one that wrote the file."
        )
    keys = ("schema", "model", "medium", "parameters", "covariance", "fitted_on", "software")
    _exactly(content, keys, "the file")
    medium = _exactly(content["medium"], ("name", "index"), "medium")
    origin = _exactly(content["fitted_on"], ("description", "sha256"), "fitted_on")
    covariance = _exactly(content["covariance"], ("order", "matrix"), "covariance")
    parameters = content["parameters"]
    if not isinstance(parameters, dict):
        raise CalibrationError(f"parameters must be an object; got {parameters!r}.")
    values = {name: _value(name, entry) for name, entry in parameters.items()}
    order = covariance["order"]
    if order != list(values):
        raise CalibrationError(
            f"covariance order must list the parameters in their order, {list(values)}; got "
            f"{order!r}. Sort rows and columns of the matrix likewise."
        )
    calibration = Calibration(
        model=_text(content, "model"),
        values=values,
        covariance=_matrix(covariance["matrix"]),
        medium=_text(medium, "name"),
        medium_index=_number(medium["index"], "medium index"),
        fitted_on=_text(origin, "description"),
        data_sha256=_text(origin, "sha256"),
        software=_text(content, "software"),
    )
    _sigmas_agree(calibration, {name: entry["sigma"] for name, entry in parameters.items()})
    return calibration


def _value(name: str, entry: object) -> float:
    entry = _exactly(entry, ("value", "unit", "sigma"), f"parameters.{name}")
    unit = quantity(name).unit
    if entry["unit"] != unit:
        raise CalibrationError(
            f"parameters.{name} must be in {unit!r}; got unit {entry['unit']!r}. "
            "Convert value, sigma and covariance."
        )
    if _number(entry["sigma"], f"sigma of {name}") < 0:
        raise CalibrationError(f"sigma of {name} must not be negative; got {entry['sigma']}.")
    return _number(entry["value"], f"value of {name}")


def _sigmas_agree(calibration: Calibration, sigmas: dict[str, float]) -> None:
    for name, sigma in sigmas.items():
        expected = calibration.sigma(name)
        if not math.isclose(sigma, expected, rel_tol=_SAME, abs_tol=1e-300):
            raise CalibrationError(
                f"sigma of {name} is {sigma:g}, but the covariance says {expected:g}. Change both, "
                "or fit again."
            )


def _check_covariance(matrix: np.ndarray, count: int) -> None:
    if matrix.shape != (count, count):
        raise CalibrationError(
            f"covariance must be {count}x{count}, a row and a column a parameter; got shape "
            f"{matrix.shape}."
        )
    if not np.isfinite(matrix).all():
        raise CalibrationError(
            "covariance must be finite. Leave out parameters that the data do not determine."
        )
    deviation = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.outer(deviation, deviation)
    if (np.diag(matrix) < 0).any() or (np.abs(matrix - matrix.T) > _SAME * scale).any():
        raise CalibrationError(
            "covariance must be symmetric with no negative variance. Restore the matrix."
        )
    fixed = deviation == 0
    correlation = matrix / np.where(scale > 0, scale, 1.0)
    if matrix[fixed].any() or np.linalg.eigvalsh(correlation).min() < -_SAME:
        raise CalibrationError(
            "covariance must be positive semi-definite: no correlation may exceed 1. Restore the "
            "matrix."
        )


def _exactly(content: object, keys: tuple[str, ...], where: str) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise CalibrationError(f"{where} must be an object with {', '.join(keys)}.")
    wrong = set(keys).symmetric_difference(content)
    if wrong:
        raise CalibrationError(
            f"{where} must hold {', '.join(keys)}; missing or unknown: {', '.join(sorted(wrong))}."
        )
    return content


def _number(value: object, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CalibrationError(f"{what} must be a finite number; got {value!r}.")
    return float(value)


def _text(content: dict[str, Any], key: str) -> str:
    if not isinstance(content[key], str):
        raise CalibrationError(f"{key} must be text; got {content[key]!r}.")
    return content[key]


def _matrix(rows: object) -> np.ndarray:
    try:
        return np.array(rows, float)
    except (TypeError, ValueError) as error:
        raise CalibrationError(
            f"covariance matrix must be rows of numbers; got {rows!r}."
        ) from error
