"""Progress of a long command: a bar on a terminal, else a plain line now and then."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar

SECONDS_BETWEEN_LINES = 30.0
"""Without a terminal, so that a log stays short and still shows that the command is alive."""


_BARS, _WORDS = (ContextVar(name, default=True) for name in ("bars", "words"))


@contextmanager
def quiet(*, bars: bool = False) -> Iterator[None]:
    """Let commands that are called as functions print nothing, or progress only."""
    shown = _BARS.set(bars), _WORDS.set(False)
    try:
        yield
    finally:
        _BARS.reset(shown[0])
        _WORDS.reset(shown[1])


def say(text: str, *, result: bool = False) -> None:
    """Print what a command says, results on stdout; a function called from Python says nothing."""
    if _WORDS.get():
        print(text, file=sys.stdout if result else sys.stderr, flush=True)


Advance = Callable[..., None]
"""`advance(steps=1, *, note="")` adds to the steps done; a note is shown beside their number."""


def progress(what: str, *, total: int | None) -> AbstractContextManager[Advance]:
    """Show the progress of a loop on stderr: steps done, their total, the remaining time.

        with progress("Measuring", total=len(frames)) as advance:
            for frame in frames:
                measure(frame)
                advance()

    Returns:
        A block, in which a function is to be called after each step.
    """
    if not _BARS.get():
        return nullcontext(lambda steps=1, *, note="": None)
    return _bar(what, total) if sys.stderr.isatty() else _lines(what, total)


@contextmanager
def _bar(what: str, total: int | None) -> Iterator[Advance]:
    from rich import progress as rich
    from rich.console import Console

    columns = (
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.MofNCompleteColumn(),
        rich.TextColumn("{task.fields[note]}"),
        rich.TimeRemainingColumn(),
    )
    with rich.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total, note="")

        def advance(steps: int = 1, *, note: str = "") -> None:
            bar.update(task, advance=steps, note=note)

        yield advance


@contextmanager
def _lines(what: str, total: int | None) -> Iterator[Advance]:
    began = last = time.monotonic()
    done = first = 0  # the first step compiles, so the time of the others is foretold without it

    def advance(steps: int = 1, *, note: str = "") -> None:
        nonlocal began, done, first, last
        done += steps
        now = time.monotonic()
        if first == 0:
            began, first = now, done
        if now - last < SECONDS_BETWEEN_LINES:
            return
        last = now
        said = f"{what}: {done} done" if total is None else f"{what}: {done} of {total} done"
        if total is not None and done > first > 0:
            said += f", {duration((total - done) / (done - first) * (now - began))} left"
        print(f"{said}{', ' if note else ''}{note}.", file=sys.stderr, flush=True)

    yield advance


def duration(seconds: float) -> str:
    """A time in words: 44 s, 12 min, 3.4 h."""
    if seconds < 100:
        return f"{max(seconds, 0.0):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
