"""A process that has a path of ours in hand."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def another_process(code: str, path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has run a line of code with `path` and stays there until its input ends."""
    before = "import sys, pathlib; from eyespot.formats import stack, whole_files"
    given = "path = pathlib.Path(sys.argv[1])"
    after = "print('here', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", f"{before}; {given}; {code}; {after}", str(path)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout and process.stdout.readline() == "here\n"
        yield process
