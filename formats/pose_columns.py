"""Which columns of a robot's table are time, place and direction: by their names, or as stated."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from eyespot.formats.inputs import InputError, shortened
from eyespot.formats.tables import SECONDS

MILLIMETRES = {"mm": 1.0, "m": 1e3, "um": 1e-3}
"""Units of length."""
POSITION = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
ROTATION_VECTOR = ("rx", "ry", "rz")
AXIS = ("axis_x", "axis_y", "axis_z")

_PLACES = r"(?:(?:p|t|pos|position|translation|tip|tcp)_?)?"
_FORMS = {
    "time": r"(?:t|time|stamp|timestamp|time_stamp)()",
    "": rf"{_PLACES}([xyz])",
    "q": r"(?:q|quat|quaternion|orientation|rotation)_?([xyzw])",
    "r": r"(?:r|rotvec|rotation_vector)_?([xyz])(?:_rad)?",
    "axis_": r"(?:axis|tool_axis|dir|direction)_?([xyz])",
    "travel": r"(?:travel|displacement|position|pos)()",
}
"""Names of columns by what they are, as `_plain` writes them, without the unit."""
_UNITS = {
    "time": {**SECONDS, "sec": 1.0, "seconds": 1.0, "msec": 1e-3, "usec": 1e-6, "nsec": 1e-9},
    "": MILLIMETRES,
    "travel": MILLIMETRES,
}
_USUAL = {"time_s", *(f"{axis}_mm" for axis in POSITION), *QUATERNION, *AXIS}
"""Names that eyespot itself writes; they are meant where others have the same meaning."""
_HEADER = "time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw"
_MOST_NAMES = 40
_LONGEST_NAME = 100
REMEDY = (
    'Name them in the rig file, such as robot.columns = { time_s = "stamp", x = "px", y = "py", '
    'z = "pz", rx = "rx", ry = "ry", rz = "rz" }.'
)
"""What to do about columns whose names say nothing."""


class PoseColumn(NamedTuple):
    """A column of a table.

    Attributes:
        name: as the table has it.
        unit: the column's unit in s or mm; 1 where there is none.
    """

    name: str
    unit: float


def _plain(name: str) -> str:
    """A name in lower case, with one underscore between its words; ROS's paths without the path."""
    words = re.sub(r"[^a-z0-9]+", "_", re.sub("[µμ]", "u", name).lower()).strip("_")
    return re.sub(r"^(?:field_)?(?:header_|pose_|transform_)*", "", words)


def recognised(name: str) -> tuple[str, float | None] | None:
    """What a column is by its name, such as ("qx", None) or ("x", 1e3) of "Pos X [m]"."""
    plain = _plain(name)
    for kind, form in _FORMS.items():
        units = _UNITS.get(kind, {})
        ending = rf"(?:_({'|'.join(units)}))?" if units else "()"
        if found := re.fullmatch(form + ending, plain):
            return kind + found[1], units.get(found[2])
    return None


def _unit_at_end(name: str, part: str) -> float | None:
    units = _UNITS.get("" if part in POSITION else part, {})
    found = re.search(rf"_({'|'.join(units)})$", _plain(name)) if units else None
    return units[found[1]] if found else None


def pose_columns(
    names: Sequence[str], *, stated: Mapping[str, str], unit: str | None
) -> dict[str, PoseColumn]:
    """The columns of a table of poses by what they are: "time", and those named above, "travel".

    Args:
        names: of the table's columns.
        stated: names of columns by what they are, such as {"time_s": "stamp", "x": "px"}.
        unit: stated for the positions, "mm", "m" or "um"; None if it is not.

    Raises:
        InputError: no time or no position, a stated column is missing, several have one meaning, or
            units contradict each other; the text names the columns and the key of the rig file.
    """
    listed = ", ".join(map(shortened, names[:_MOST_NAMES])) or "none"
    candidates: dict[str, list[tuple[str, float | None]]] = {}
    for name in names:
        if (meaning := recognised(name)) and len(name) <= _LONGEST_NAME:
            candidates.setdefault(meaning[0], []).append((name, meaning[1]))
    for key, name in stated.items():
        if name not in names:
            raise InputError(f"robot.columns names {shortened(name)}; the columns are {listed}.")
        part, length = recognised(key) or ("", None)
        own = _unit_at_end(name, part)
        if length and own and length != own:
            raise InputError(
                f"robot.columns says {key} = {shortened(name)}, but their units differ. Write "
                f"{part}_ms, {part}_m, ... as the column's unit is."
            )
        candidates[part] = [(name, length or own)]
    found = {part: _column(part, columns, unit) for part, columns in candidates.items()}
    if "time" not in found and names and all(map(_is_number, names)):
        raise InputError(
            f"no header: the first line is the numbers {listed}. Write the columns' names above "
            f"them, such as {_HEADER}."
        )
    if "time" not in found:
        raise InputError(f"no times among the columns {listed}. {REMEDY}")
    if "travel" not in found and not found.keys() >= set(POSITION):
        raise InputError(f"no positions among the columns {listed}. {REMEDY}")
    return found


def _is_number(name: str) -> bool:
    with suppress(ValueError):
        float(name)
        return True
    return False


def _column(part: str, columns: list[tuple[str, float | None]], unit: str | None) -> PoseColumn:
    usual = [column for column in columns if column[0] in _USUAL]
    if len(columns) > 1 and len(usual) != 1:
        choice = " and ".join(shortened(name) for name, _ in columns)
        raise InputError(
            f"the columns {choice} can both be {part!r}. Name the right one in the rig file, such "
            f"as robot.columns = {{ {part if part != 'time' else 'time_s'} = ... }}."
        )
    name, own = (usual or columns)[0]
    stated = MILLIMETRES[unit] if unit and part in (*POSITION, "travel") else None
    if own and stated and own != stated:
        raise InputError(
            f"the column {shortened(name)} and robot.unit = {unit!r} differ in their unit. Correct "
            "robot.unit, or remove it."
        )
    return PoseColumn(name, own or stated or 1.0)
