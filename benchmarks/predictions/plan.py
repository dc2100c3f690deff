"""The plan's file: JSON with predictions, their intervals, and a SHA-256 of all of it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field
from pydantic import Strict as StrictType

from estimator.files import object_in, written_whole
from optics import InputError, Strict, check_schema, in_file, read_text, validated

SCHEMA = 1
HISTORY = {1: "the first format"}
"""What changed with each version of the format that is read."""

_MOST_BYTES = 2**28

QUANTITIES = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "distance_mm", "robot_mm")
"""What is predicted for every frame.

x_px, y_px: centre of the spot from the principal point; semi_major_px, semi_minor_px: of its
ellipse; distance_mm: read with the plan's calibration; robot_mm: how far the robot says that the
tip is from its first pose.
"""

ELLIPSE = 4
"""The first of them are the spot's ellipse, from which the distance follows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Predictions of n frames; NaN where nothing is predicted.

    Attributes:
        scene: the planned experiment, as the text of a scene file.
        software: that made the plan.
        exposure: kind of the images, as in the scene.
        calibration: content of the calibration file for `distance_mm`; None without distances.
        model: of the distance.
        microscope: content of the microscope file.
        uncertain: keys of the scene, each with its value there and its standard uncertainty.
        times_s: of the frames, (n,).
        expected: of `QUANTITIES`, (n, 6).
        noise: standard deviations of the measurement, (n, 6).
        moved: by each uncertain key, for one standard uncertainty of it, (keys, n, 6).
    """

    scene: str
    software: str
    exposure: str
    calibration: dict[str, Any] | None
    model: str | None
    microscope: dict[str, Any]
    uncertain: dict[str, tuple[float, float]]
    times_s: np.ndarray
    expected: np.ndarray
    noise: np.ndarray
    moved: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        """Standard uncertainty of each prediction: what is stated, and the noise, (n, 6)."""
        return np.sqrt(self.noise**2 + np.sum(self.moved**2, axis=0))


_Positive = Annotated[float, Field(gt=0)]


class _PlanFile(Strict):
    model_config = ConfigDict(protected_namespaces=())  # `model` is the format's own key

    schema_: Annotated[int, Field(alias="schema")]
    software: str
    scene: str
    exposure: str
    calibration: dict[str, Any] | None
    model: str | None
    microscope: dict[str, Any]
    uncertain: dict[str, Annotated[tuple[float, _Positive], StrictType(False)]]
    quantities: list[str]
    times_s: list[float]
    expected: list[list[float | None]]
    low: list[list[float | None]]
    high: list[list[float | None]]
    noise: list[list[float | None]]
    moved: list[list[list[float | None]]]
    sha256: str


def write_plan(path: Path, plan: Plan) -> str:
    """Write a plan, whole or not at all.

    Returns:
        Its SHA-256: publish it, and nobody can say later that the plan was another one.
    """
    half = 1.959964 * plan.sigma
    content = {"schema": SCHEMA, **asdict(plan), "quantities": list(QUANTITIES)}
    content |= {"low": plan.expected - half, "high": plan.expected + half}
    content = {name: _plain(value) for name, value in content.items()}
    content["sha256"] = fingerprint_of(content)
    with written_whole(path) as partial:
        partial.write_text(json.dumps(content) + "\n", encoding="utf-8")
    return str(content["sha256"])


def read_plan(path: Path) -> tuple[Plan, str]:
    """A plan and its SHA-256.

    Raises:
        InputError: not a plan, or changed since it was made.
        OSError: the file cannot be read.
    """
    remedy = "Restore the file."
    with in_file(path, InputError):
        content = object_in(read_text(path, most_bytes=_MOST_BYTES))
        check_schema(content.get("schema"), HISTORY, remedy=remedy)
        file = validated(_PlanFile, content, remedy=remedy)
        made = fingerprint_of({key: value for key, value in content.items() if key != "sha256"})
        if made != file.sha256:
            raise InputError(
                f"the plan was changed after it was made: its SHA-256 is {made[:12]}…, and it says "
                f"{file.sha256[:12]}…. {remedy}"
            )
        if file.quantities != list(QUANTITIES):
            raise InputError(f"quantities must be {', '.join(QUANTITIES)}. {remedy}")
    return (
        Plan(
            scene=file.scene,
            software=file.software,
            exposure=file.exposure,
            calibration=file.calibration,
            model=file.model,
            microscope=file.microscope,
            uncertain=file.uncertain,
            times_s=np.array(file.times_s),
            expected=np.array(file.expected, float),
            noise=np.array(file.noise, float),
            moved=np.array(file.moved, float),
        ),
        made,
    )


def fingerprint_of(content: dict[str, Any]) -> str:
    """SHA-256 of a content, in whatever order and layout it is written."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Arrays as lists, with null for NaN."""
    if not isinstance(value, np.ndarray):
        return value
    found = value.astype(object)
    found[np.isnan(value)] = None
    return found.tolist()
