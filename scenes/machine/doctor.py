"""The command `eyespot doctor`: checks this machine and explains how to fix problems."""

import importlib.metadata
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from rich.console import Console
from rich.table import Table
from rich.text import Text

from eyespot.scenes.machine.llvm import find_llvm
from eyespot.scenes.machine.packages import NOT_ON_A_RIG

GIB = 2**30
MEMORY_NEEDED = 4 * GIB

HOME = Path(__file__).resolve().parents[2]
"""Folder of the packages: the checkout, or site-packages."""


class State(StrEnum):
    """Severity of a finding; only MISSING prevents `eyespot validate`."""

    OK = "ok"
    NOTE = "note"
    MISSING = "missing"


@dataclass(frozen=True)
class Finding:
    """One line of the report: what was checked, the result, and what to do."""

    what: str
    found: str
    state: State = State.OK
    remedy: str = ""


def doctor(*, rig: bool = False) -> None:
    """Check this machine, and explain how to install what is missing.

    The exit code is 1 if something that `eyespot validate` needs is missing, or with --rig
    something that `eyespot track`, `fit` or `node` needs.

    Args:
        rig: The machine of a rig (`make setup-rig`): it measures and fits, and renders nothing.
    """
    table = Table(title="eyespot doctor")
    for heading in ("", "found", "", "what to do"):
        table.add_column(heading, overflow="fold")
    colours = {State.OK: "green", State.NOTE: "yellow", State.MISSING: "red"}
    missing = []
    for finding in examine(rig=rig):
        # Text, because rich reads square brackets in a string as markup.
        state = Text(finding.state, style=colours[finding.state])
        table.add_row(Text(finding.what), Text(finding.found), state, Text(finding.remedy))
        if finding.state is State.MISSING:
            missing.append(finding.what)
    Console().print(table)
    if missing:
        print(f"Not ready: {', '.join(missing)}. Do what the last column says, then run it again.")
    elif rig:
        print("Ready: this machine can measure and fit.")
        print("Next: eyespot rig init rig.toml")
    else:
        print("Ready: this machine can render, measure and fit.")
        print("Next: eyespot scene init scene.toml, then eyespot render scene.toml --out stack")
    sys.exit(int(bool(missing)))


def examine(*, rig: bool = False) -> Iterator[Finding]:
    """All findings about this machine, or those that concern a rig's."""
    yield from _versions(NOT_ON_A_RIG if rig else frozenset())
    yield Finding("eyespot's packages", str(HOME))
    if not rig:
        yield from llvm_findings()
        remedy = "Follow the message, then run `make setup` again."
        yield _variant("llvm_ad_rgb", State.MISSING, remedy)
        remedy = "Not needed, but unexpected. Run `make setup` again."
        yield _variant("scalar_rgb", State.NOTE, remedy)
        remedy = "Not needed. Requires an NVIDIA GPU and its driver."
        yield _variant("cuda_ad_rgb", State.NOTE, remedy)
    yield _jax()
    yield Finding("cores", str(len(os.sched_getaffinity(0))))
    memory, remedy = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), ""
    if memory < MEMORY_NEEDED and not rig:
        remedy = f"`eyespot validate` may need {MEMORY_NEEDED / GIB:.0f} GiB; use --quick."
    state = State.NOTE if remedy else State.OK
    yield Finding("memory", f"{memory / GIB:.1f} GiB", state, remedy)
    folder = Path.cwd()
    try:
        with tempfile.TemporaryFile(dir=folder):
            yield Finding("this folder", f"{folder} can be written to")
    except OSError as error:
        remedy = "Choose another folder with --out."
        yield Finding("this folder", f"{folder}: {error.strerror}", State.NOTE, remedy)


def _versions(unneeded: frozenset[str]) -> Iterator[Finding]:
    """Versions of Python and the packages, compared with the required and tested ones."""
    yield Finding("Python", f"{platform.python_version()} ({sys.executable})")
    constraints, tested = HOME / "constraints.txt", {}
    if constraints.is_file():  # in a checkout
        lines = (line.strip() for line in constraints.read_text().splitlines())
        pins = (line.split("==") for line in lines if "==" in line)
        tested = {canonicalize_name(name): version for name, version in pins}
    for line in importlib.metadata.requires("eyespot") or []:
        requirement = Requirement(line)
        if requirement.marker and not requirement.marker.evaluate({"extra": ""}):
            continue
        if requirement.name in unneeded:
            continue
        name = requirement.name
        try:
            version = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            remedy = "Run `make setup`."
            if name in NOT_ON_A_RIG:
                remedy += " A rig needs it not: eyespot doctor --rig."
            yield Finding(name, "not installed", State.MISSING, remedy)
            continue
        pinned = tested.get(canonicalize_name(name), version)
        if version not in requirement.specifier:
            remedy = f"eyespot needs {name}{requirement.specifier}. Run `make setup` again."
            yield Finding(name, version, State.MISSING, remedy)
        elif version != pinned:
            yield Finding(name, version, State.NOTE, f"eyespot was tested with {pinned}.")
        else:
            yield Finding(name, version)


def llvm_findings() -> Iterator[Finding]:
    """The libLLVM that Mitsuba will use, then those that were refused."""
    llvm = find_llvm()
    if llvm:
        version = ".".join(map(str, llvm.version))
        yield Finding("libLLVM", f"{version} ({llvm.path})")
    else:
        yield Finding("libLLVM", "none that works", State.MISSING, llvm.remedy)
    for refused in llvm.refused:
        yield Finding("libLLVM, not used", f"{refused.path}: {refused.reason}", State.NOTE)


def _jax() -> Finding:
    """Whether JAX has a device; in its own process, as it would keep the device."""
    code = "import jax; print(*jax.devices())"
    child = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    if child.returncode == 0:
        return Finding("JAX's devices", child.stdout.strip())
    platforms = os.environ.get("JAX_PLATFORMS", "")
    remedy = "Unset JAX_PLATFORMS, or set it to cpu." if platforms else "Run `make setup` again."
    return Finding("JAX's devices", f"none (JAX_PLATFORMS={platforms!r})", State.MISSING, remedy)


def _variant(variant: str, state_of_failure: State, remedy: str) -> Finding:
    # In its own process, because a variant that fails may abort it.
    command = [sys.executable, "-m", "eyespot.scenes.machine.variant", variant]
    child = subprocess.run(command, cwd=HOME, capture_output=True, text=True, check=False)
    what = f"Mitsuba {variant}"
    if child.returncode == 0:
        return Finding(what, "renders")
    problem = (child.stderr.strip().splitlines() or [f"exit code {child.returncode}"])[-1]
    return Finding(what, problem, state_of_failure, remedy)
