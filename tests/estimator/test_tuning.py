"""The detector's constants stand in one table, each with unit, meaning and origin."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator
from pathlib import Path
from statistics import NormalDist

import pytest

from estimator.detector import tuning
from estimator.detector.tuning import Trimming

FOLDER = Path(tuning.__file__).parent


def entries(body: list[ast.stmt], of: str = "") -> Iterator[tuple[str, ast.stmt]]:
    """Every constant of the table with the statement that follows it."""
    for here, after in itertools.pairwise([*body, ast.Pass()]):
        if isinstance(here, ast.ClassDef):
            yield from entries(here.body, f"{here.name}.")
        elif isinstance(here, ast.Assign):
            yield of + ast.unparse(here.targets[0]), after


def test_every_constant_has_a_unit_a_meaning_and_an_origin():
    found = dict(entries(ast.parse(Path(tuning.__file__).read_text(encoding="utf-8")).body))
    assert len(found) > 100
    for name, after in found.items():
        assert isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant), name
        unit, meaning, origin = " ".join(str(after.value.value).split()).split(" | ")
        assert unit and meaning, name
        assert origin.startswith(("derived", "fitted", "set by hand")), name


@pytest.mark.parametrize(
    "path", sorted(set(FOLDER.glob("*.py")) - {FOLDER / "tuning.py"}), ids=lambda path: path.stem
)
def test_no_other_module_of_the_detector_has_a_constant_of_its_own(path):
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign | ast.AnnAssign) and statement.value is not None:
            try:
                value = ast.literal_eval(statement.value)
            except ValueError:
                continue  # computed from the table, or no number
            assert not _is_number(value), ast.unparse(statement)


def _is_number(value: object) -> bool:
    if isinstance(value, tuple | list):
        return any(map(_is_number, value))
    return isinstance(value, int | float)


def test_what_is_said_to_be_derived_is():
    # A third of normal errors lies within so many standard deviations on either side.
    assert pytest.approx(NormalDist().inv_cdf(2 / 3), abs=1e-4) == Trimming.THIRD
    # One sample of five edges, half of which belong, is pure with a probability of 1/32.
    assert 1 - (31 / 32) ** Trimming.SAMPLES > 0.95
