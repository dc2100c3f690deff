"""Calls commands in this process."""

from __future__ import annotations

import contextlib
import functools
import io
import traceback
from collections.abc import Sequence
from typing import NamedTuple

from cyclopts import App, Argument

from eyespot import command_line as eyespot

WORDS = [
    "version",
    *(
        f"{group} {function.rpartition(':')[2].replace('_', '-')}".strip()
        for group, functions in eyespot.COMMANDS.items()
        for function in functions
    ),
]
"""Every command, as a person writes it."""


def command_of(words: str) -> App:
    """A command, loaded."""
    return functools.reduce(App.__getitem__, words.split(), eyespot.app)


def options_of(words: str) -> list[Argument]:
    """Its arguments and options, as the help shows them."""
    with eyespot.app.app_stack(words.split()):
        found = command_of(words).assemble_argument_collection(parse_docstring=True)
    return [option for option in found if option.parse and not option.children]


class Called(NamedTuple):
    """How a command ended."""

    exit_code: int
    stdout: str
    stderr: str
    exception: BaseException | None

    @property
    def output(self) -> str:
        trace = traceback.format_exception(self.exception) if self.exception else ()
        return self.stdout + self.stderr + "".join(trace)


def call(words: Sequence[str]) -> Called:
    """Run a command; an exception is a result, too."""
    code, caught = 0, None
    with (
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        try:
            eyespot.app(words)
        except SystemExit as end:
            code = int(end.code or 0)
        except BaseException as error:
            code, caught = 1, error
    return Called(code, out.getvalue(), err.getvalue(), caught)


def printed(*words: object) -> str:
    """What a command prints, which must end well."""
    done = call([str(word) for word in words])
    assert done.exit_code == 0, done.output
    return done.stdout
