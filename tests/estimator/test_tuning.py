"""The detector's constants stand in one table, each with what it decides."""

import ast
from pathlib import Path
from statistics import NormalDist

import pytest

from eyespot.estimator.detector import tuning
from eyespot.estimator.detector.tuning import Trimming

FOLDER = Path(tuning.__file__).parent


def test_every_constant_says_what_it_decides():
    text = Path(tuning.__file__).read_text(encoding="utf-8")
    lines = text.splitlines()
    constants = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Assign)]
    assert len(constants) > 100
    for node in constants:
        here, above = lines[node.lineno - 1], lines[node.lineno - 2]
        assert "  # " in here or above.lstrip().startswith("# "), here


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
            numbers = value if isinstance(value, tuple | list) else [value]
            assert not any(isinstance(one, int | float) for one in numbers), ast.unparse(statement)


def test_what_is_said_to_be_derived_is():
    # A third of normal errors lies within so many standard deviations on either side.
    assert pytest.approx(NormalDist().inv_cdf(2 / 3), abs=1e-4) == Trimming.THIRD
