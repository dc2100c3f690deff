"""The page of the reference about failures: reasons, exit codes, and errors of the system."""

import errno
import inspect
import re
from collections.abc import Iterable, Iterator, Sequence

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
    yield from _meanings(Reason)
    yield "\n## What the mode pixels knew of the wall\n"
    yield "The column `wall_memory` of a spots file, and the node's diagnostics."
    yield "[Every pixel](../../pixels.md) says how the wall is learnt.\n"
    yield from _meanings(WallMemory)
    yield "\n## What makes a distance uncertain\n"
    yield "The column `largest_cause` of a spots file, and the node's diagnostics. `eyespot budget`"
    yield "says what halves it; [the budget](../../worth.md#the-formulas), how each is computed.\n"
    yield from _meanings(Cause)
    yield "\n## Why a fit is not good\n"
    yield "What `eyespot fit` says to try, by the model that was fitted.\n"
    advised = []
    for fault in Fault:
        tries = {model: remedy(fault, model=model) for model in _FIT_MODELS}
        name = fault.name.lower().replace("_", " ")
        if not any(tries.values()):
            right = "nothing: the values are right within their stated errors"
            advised.append((name, "all", right))
        for advice in dict.fromkeys(filter(None, tries.values())):
            models = ", ".join(model for model, said in tries.items() if said == advice)
            advised.append((name, models, advice))
    yield from table("criterion | model | try", advised)
    yield "\n## How a command ends\n"
    codes = inspect.cleandoc(exit_codes.__doc__ or "").partition("Exit codes:\n")[2]
    ends = re.findall(r"^ *(\d+) +(.*(?:\n {5,}\S.*)*)", codes, flags=re.MULTILINE)
    yield from table("exit code | meaning", ends)
    yield "\nAn error of the operating system is shown with its own words and a remedy:\n"
    remedies = sorted(exit_codes._REMEDIES.items())
    yield from table("error | remedy", [(errno.errorcode[n], remedy) for n, remedy in remedies])


def _meanings(kind: type[Reason | WallMemory | Cause]) -> Iterator[str]:
    known = [(f"`{one.value}`", one.meaning) for one in kind if one.value]
    yield from table("value | meaning and remedy", known)


def table(headings: str, rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """A table in Markdown; its headings are separated by |."""
    yield f"| {headings} |"
    yield "|---" * len(headings.split("|")) + "|"
    for row in rows:
        cells = (" ".join(cell.split()).replace("|", "\\|") for cell in row)
        yield f"| {' | '.join(cells)} |"
