"""Pages of the reference about failures: reasons, messages of wrong input, and exit codes."""

import ast
import errno
import inspect
import itertools
import re
from collections.abc import Iterator, Mapping
from operator import itemgetter
from pathlib import Path

from eyespot.calibration.command.verdict import Fault, remedy
from eyespot.estimator.distance.budget import Cause
from eyespot.estimator.distance.range import WallMemory
from eyespot.estimator.run import exit_codes
from eyespot.formats.spots import Reason

HOME = Path(__file__).resolve().parents[1]
PACKAGES = ("formats", "optics", "scenes", "estimator", "calibration", "benchmarks")
_FIT_MODELS = ("plane", "sphere", "cone", "eye", "image", "lens")
_ERRORS = (
    *("InputError", "SceneError", "OutsideWindow", "BeingWrittenError"),
    *("SpecError", "SetError", "RendererUnavailable", "PupilUnavailable"),
)
"""What a user can correct; anything else that is raised is a bug."""


def reasons_page() -> Iterator[str]:
    """The page of reasons that results have."""
    yield "# Reasons\n"
    yield "A result that is missing or doubtful has one of these reasons. What a command says of"
    yield "wrong input is on [another page](errors.md).\n"
    yield "## Why a frame has no spot, or a spot no distance or a doubtful one\n"
    yield "The column `reason` of a spots file, the console, and the node's diagnostics.\n"
    yield from _rows({reason.value: reason.meaning for reason in Reason})
    yield "\n## What the mode pixels knew of the wall\n"
    yield "The column `wall_memory` of a spots file, and the node's diagnostics."
    yield "[Every pixel](../../pixels.md) says how the wall is learnt.\n"
    yield from _rows({memory.value: memory.meaning for memory in WallMemory if memory.value})
    yield "\n## What makes a distance uncertain\n"
    yield "The column `largest_cause` of a spots file, and the node's diagnostics. `eyespot budget`"
    yield "says what halves it; [the budget](../../worth.md#the-formulas), how each is computed.\n"
    yield from _rows({cause.value: cause.meaning for cause in Cause})
    yield "\n## Why a fit is not good\n"
    yield "What `eyespot fit` says to try, by the model that was fitted.\n"
    yield "| criterion | model | try |"
    yield "|---|---|---|"
    for fault in Fault:
        tries = {model: remedy(fault, model=model) for model in _FIT_MODELS}
        name = fault.name.lower().replace("_", " ")
        if not any(tries.values()):
            yield f"| {name} | all | nothing: the values are right within their stated errors |"
        for advice in dict.fromkeys(filter(None, tries.values())):
            models = ", ".join(model for model, said in tries.items() if said == advice)
            yield f"| {name} | {models} | {cell(advice)} |"


def errors_page() -> Iterator[str]:
    """The page of error messages and exit codes."""
    found = list(messages())
    yield "# Errors\n"
    yield "## Exit codes\n"
    codes = inspect.cleandoc(exit_codes.__doc__ or "").partition("Exit codes:\n")[2]
    yield "| code | meaning |"
    yield "|---|---|"
    for code, meaning in re.findall(r"^ *(\d+) +(.*(?:\n {5,}\S.*)*)", codes, flags=re.MULTILINE):
        yield f"| {code} | {cell(' '.join(meaning.split()))} |"
    yield "\nAn error of the operating system is shown with its own words and a remedy:\n"
    yield "| error | remedy |"
    yield "|---|---|"
    for number, advice in sorted(exit_codes._REMEDIES.items()):
        yield f"| {errno.errorcode[number]} | {cell(advice)} |"
    yield f"\n## Messages of wrong input ({len(found)})\n"
    yield "A message names what is wrong, with value and unit, the rule, and the way out. The words"
    yield "in braces are replaced by values. In Python these messages are those of"
    yield "`eyespot.formats.inputs.InputError`."
    for package in PACKAGES:
        mine = [(file, text) for file, text in found if file.startswith(f"{package}/")]
        yield f"\n### {package} ({len(mine)})\n"
        for file, texts in itertools.groupby(mine, itemgetter(0)):
            yield f"\n`{file}`\n"
            yield from (f"- {_quoted(text)}" for _, text in texts)


def messages() -> Iterator[tuple[str, str]]:
    """File and text of every error that a user can correct, with {names} of inserted values."""
    for package in PACKAGES:
        for path in sorted((HOME / package).rglob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found = sorted((node.lineno, _text(node)) for node in _raised(tree))
            file = path.relative_to(HOME).as_posix()
            yield from ((file, text) for _, text in found if text)


def _raised(tree: ast.Module) -> Iterator[ast.Call]:
    """Calls that make an error which is raised."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in _ERRORS and node.args:
                yield node


def _text(call: ast.Call) -> str:
    argument = call.args[0]
    if isinstance(argument, ast.Constant):
        return str(argument.value)
    if isinstance(argument, ast.JoinedStr):
        return "".join(
            str(part.value) if isinstance(part, ast.Constant) else f"{{{_inserted(part)}}}"
            for part in argument.values
        )
    return ""  # passes on the message of another error


def _inserted(part: ast.expr) -> str:
    """The name of a value that is inserted, without how it is shown."""
    assert isinstance(part, ast.FormattedValue)
    value = part.value
    if isinstance(value, ast.Call) and value.args and isinstance(value.func, ast.Name):
        value = value.args[0]  # shortened(value), _listed(names)
    text = ast.unparse(value)
    return text if len(text) <= 40 and text.count("(") < 2 else "…"


def _quoted(text: str) -> str:
    """A message as plain text, whatever characters it has."""
    fence = "``" if "`" in text else "`"
    return f"{fence} {' '.join(text.split())} {fence}"


def _rows(meanings: Mapping[str, str]) -> Iterator[str]:
    yield "| value | meaning and remedy |"
    yield "|---|---|"
    for value, meaning in meanings.items():
        yield f"| `{value}` | {cell(meaning)} |"


def cell(text: str) -> str:
    """A text as a cell of a table in Markdown."""
    return text.replace("|", "\\|").replace("\n", " ")
