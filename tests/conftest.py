"""What all tests share: no display, no GPU by accident, and the same examples on every run."""

from __future__ import annotations

import os
import signal

from hypothesis import settings

# Before the first import of matplotlib and JAX, which read them once.
os.environ["MPLBACKEND"] = "Agg"
os.environ["JAX_PLATFORMS"] = "cpu"

# A shell's background job ignores Ctrl-C, and so would the programs that tests interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Derandomised: a test that fails once fails again. No deadline: JAX compiles in the first example.
settings.register_profile("reproducible", derandomize=True, deadline=None, database=None)
settings.load_profile("reproducible")
