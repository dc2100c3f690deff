"""Progress of long commands: lines in a log, a bar on a terminal, nothing on stdout."""

import re

import pytest

from eyespot.estimator.run import progress_bar
from eyespot.estimator.run.progress_bar import progress


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test sets; it starts at 0 s."""
    now = [0.0]
    monkeypatch.setattr(progress_bar.time, "monotonic", lambda: now[0])
    return now


def test_without_a_terminal_a_line_comes_now_and_then_and_says_what_is_left(clock, capsys):
    with progress("Rendering", total=400) as advance:
        for _ in range(100):
            clock[0] += 1.0
            advance(note="2 spots")
    out, err = capsys.readouterr()
    assert out == ""
    # 100 s at a line every 30 s; a step takes 1 s, so 370, 340 and 310 s are left.
    assert err.splitlines() == [
        "Rendering: 30 of 400 done, 6 min left, 2 spots.",
        "Rendering: 60 of 400 done, 6 min left, 2 spots.",
        "Rendering: 90 of 400 done, 5 min left, 2 spots.",
    ]


def test_a_loop_of_unknown_length_counts_what_is_done(clock, capsys):
    with progress("Tracking", total=None) as advance:
        clock[0] = 31.0
        advance(7)
    assert capsys.readouterr().err == "Tracking: 7 done.\n"


def test_a_short_loop_prints_nothing(capsys):
    with progress("Tracking", total=2) as advance:
        advance()
        advance()
    assert capsys.readouterr() == ("", "")


def test_on_a_terminal_a_bar_shows_the_steps_and_vanishes(monkeypatch, capsys):
    monkeypatch.setattr(progress_bar.sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    with progress("Fitting", total=3) as advance:
        advance(2, note="so far")
    out, err = capsys.readouterr()
    assert out == ""
    assert re.search("Fitting.*2/3.*so far", err)
    assert err.endswith("\x1b[2K")  # the line of the bar is erased
