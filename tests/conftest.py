"""What all tests share: no display, no GPU by accident, and the same examples on every run."""

import gc
import os
import signal
import sys
from pathlib import Path

import psutil
import pytest
from hypothesis import settings

# Before the first import of matplotlib and JAX, which read them once.
os.environ["MPLBACKEND"] = "Agg"
os.environ["JAX_PLATFORMS"] = "cpu"
# Half of a run is compilation. The workers of one run share it, with the programs that they start:
# what takes a moment to compile too, because every file compiles hundreds of such operations.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path.home() / ".cache" / "eyespot" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# A worker a core: threads of BLAS beside it wait for each other, nine times as long as they work.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell's background job ignores Ctrl-C, and so would the programs that tests interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

TESTS = Path(__file__).resolve().parent
LONGEST_FIRST = ("calibration", "benchmarks", "estimator", "scenes", "house", "docs", "optics")
MOST_MEMORY_BYTES = 3e9  # Of a worker: what it compiled for one file is kept for the next below.

# Derandomised: a test that fails once fails again. No deadline: JAX compiles in the first example.
settings.register_profile("reproducible", derandomize=True, deadline=None, database=None)
settings.load_profile("reproducible")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, so that no worker ends alone; a folder's files share what they compile."""
    order = {name: rank for rank, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: order.get(item.path.relative_to(TESTS).parts[0], len(order)))


def pytest_collection_finish() -> None:
    """What was imported to collect the tests stays: no search for garbage looks at it again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="module")
def _memory_is_limited():
    """Free what was compiled where a worker has grown: that of all files would be 5 GB."""
    yield
    if psutil.Process().memory_info().rss < MOST_MEMORY_BYTES:
        return
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()
    if "drjit" in sys.modules:
        sys.modules["drjit"].flush_kernel_cache()
        sys.modules["drjit"].flush_malloc_cache()
    gc.collect()


@pytest.fixture(scope="module")
def fast_compilation(request: pytest.FixtureRequest):
    """Compile with few optimisations, for a file whose time goes into compiling.

    The light of a lens then takes 21 s of a processor instead of 37 s to compile. Slow tests run
    for longer than they compile, and a cone's fit ten times as long without optimisations.
    """
    if any(item.get_closest_marker("slow") for item in request.session.items):
        yield
        return
    import jax

    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
