"""The page of the reference about failures: reasons, exit codes, and errors of the system."""

import errno
import inspect
import re
from collections.abc import Iterator, Mapping

from eyespot.calibration.command.fit_verdict import Fault, remedy
from eyespot.estimator.distance.budget import Cause
from eyespot.estimator.distance.range import WallMemory
from eyespot.estimator.run import exit_codes
from eyespot.formats.spot import Reason

_FIT_MODELS = ("plane", "sphere", "cone", "eye", "image", "lens")


def failures_page() -> Iterator[str]:
    """The page of reasons that results have, and of how a command ends."""
    yield "# Reasons and exit codes\n"
    yield "A result that is missing or doubtful has one of these reasons. Wrong input ends a"
    yield "command with one message: what is wrong, with value and unit, the rule, and the way out."
    yield "In Python it is the message of an `eyespot.formats.inputs.InputError`.\n"
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
    yield "\n## How a command ends\n"
    codes = inspect.cleandoc(exit_codes.__doc__ or "").partition("Exit codes:\n")[2]
    yield "| exit code | meaning |"
    yield "|---|---|"
    for code, meaning in re.findall(r"^ *(\d+) +(.*(?:\n {5,}\S.*)*)", codes, flags=re.MULTILINE):
        yield f"| {code} | {cell(' '.join(meaning.split()))} |"
    yield "\nAn error of the operating system is shown with its own words and a remedy:\n"
    yield "| error | remedy |"
    yield "|---|---|"
    for number, advice in sorted(exit_codes._REMEDIES.items()):
        yield f"| {errno.errorcode[number]} | {cell(advice)} |"


def _rows(meanings: Mapping[str, str]) -> Iterator[str]:
    yield "| value | meaning and remedy |"
    yield "|---|---|"
    for value, meaning in meanings.items():
        yield f"| `{value}` | {cell(meaning)} |"


def cell(text: str) -> str:
    """A text as a cell of a table in Markdown."""
    return text.replace("|", "\\|").replace("\n", " ")
