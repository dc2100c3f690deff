"""Runs commands, in this process or in a new one."""

import contextlib
import functools
import io
import os
import subprocess
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple
from unittest import mock

from cyclopts import App, Argument

from eyespot import command_line as eyespot

# The installed command; `python -m eyespot` would search the current folder for packages first.
EYESPOT = Path(sys.executable).with_name("eyespot")
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
    exception: BaseException | None = None

    @property
    def output(self) -> str:
        trace = traceback.format_exception(self.exception) if self.exception else ()
        return self.stdout + self.stderr + "".join(trace)

    def assert_bad_input(self, *words: str, lines: int = 1) -> None:
        """It ended with 2 and one message with these words, without a traceback."""
        assert self.exit_code == 2, self.output
        assert self.stderr.startswith("eyespot: ")
        assert "Traceback" not in self.stderr
        assert len(self.stderr.splitlines()) <= lines, self.stderr
        for word in words:
            assert word in self.stderr


def _called(command: Callable[[], object]) -> Called:
    with (
        # A command keeps its console, as wide as it was when it was first used.
        mock.patch.dict(os.environ, COLUMNS="400"),
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        code = 0
        try:
            command()
        except SystemExit as end:
            code = int(end.code or 0)
    return Called(code, out.getvalue(), err.getvalue())


def call(words: Sequence[str]) -> Called:
    """Run a command; an exception is a result, too."""
    caught = None

    def command() -> None:
        nonlocal caught
        try:
            eyespot.app(words)
        except Exception as error:
            caught = error
            sys.exit(1)

    return _called(command)._replace(exception=caught)


def run(*words: object) -> Called:
    """Run a command as a person does: an expected error is a message, a bug is raised."""
    with mock.patch.object(sys, "argv", ["eyespot", *map(str, words)]):
        return _called(eyespot.main)


def run_process(*words: object, cwd: Path | str | None = None, **environment: str) -> Called:
    """Run a command in a new process, with additions to the environment."""
    return _in_new_process([EYESPOT, *map(str, words)], cwd, {"COLUMNS": "400"} | environment)


def run_python(code: str, cwd: Path | str | None = None, **environment: str) -> Called:
    """Run a program, given as its text, in a new process."""
    return _in_new_process([sys.executable, "-c", code], cwd, environment)


def _in_new_process(
    command: Sequence[str | Path], cwd: Path | str | None, environment: dict[str, str]
) -> Called:
    environment = os.environ | environment
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    return Called(done.returncode, done.stdout, done.stderr)


def printed(*words: object) -> str:
    """What a command prints, which must end well."""
    done = call([str(word) for word in words])
    assert done.exit_code == 0, done.output
    return done.stdout
