"""Bad input: whatever a file or a value holds, the answer is one short message and exit code 2."""

from __future__ import annotations

import resource
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator.run.exit_codes import message_of
from tests.bad_input import TARGETS, VALUES, given_value, samples, spoilt
from tests.command_line import run_process

_LONGEST_S = 2.0
_MOST_KB = 2**20


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Good files; each case spoils one and puts it back."""
    return samples(tmp_path_factory.mktemp("bad input") / "samples")


def fault_of(read: Callable[[], object], *names: str, most_lines: int = 3) -> str | None:
    """What is wrong with the answer to bad input; None if it is as it should be."""
    began, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        read()
    except Exception as error:
        message = message_of(error)
        if message is None:
            return f"a traceback: {type(error).__name__}: {error!s:.300}"
        if len(message.splitlines()) > most_lines:
            return f"{len(message.splitlines())} lines: {message:.500}"
        if len(message) > 2000:
            return f"{len(message)} characters: {message:.500}"
        if names and not any(name in message for name in names):
            return f"no name of the file: {message:.300}"
    spent = time.process_time() - began
    if spent > _LONGEST_S:
        return f"{spent:.1f} s"
    more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return f"{more / 2**20:.1f} GB" if more > _MOST_KB else None


def fault_of_file(folder: Path, name: str, seed: int) -> str | None:
    target, rng = TARGETS[name], np.random.default_rng([seed, len(name)])
    path = folder / target.file
    with spoilt(path, rng, target.form):
        # A stack or set is blamed as a whole where the fault is not in one of its files.
        places = path.name, path.parent.name, "motion.file", "train/0000", "adverse/"
        # What is missing or changed in a set is listed, up to twenty files.
        most = 21 if name == "set's manifest" else 3
        return fault_of(lambda: target.read(folder), *places, most_lines=most)


def fault_of_value(name: str, seed: int) -> str | None:
    return fault_of(lambda: given_value(name, np.random.default_rng([seed, len(name)])))


def cases(count: int) -> dict[str, int]:
    """How many seeds each kind of file and value gets."""
    kinds = (*TARGETS, *VALUES)
    return {kind: -(-count // len(kinds)) for kind in kinds}


def faults(folder: Path, kind: str, seeds: range) -> list[str]:
    found = []
    for seed in seeds:
        if kind in TARGETS:
            fault = fault_of_file(folder, kind, seed)
        else:
            fault = fault_of_value(kind, seed)
        if fault:
            found.append(f"{kind}, seed {seed}: {fault}")
    return found


def test_the_samples_are_read(folder: Path) -> None:
    for name, target in TARGETS.items():
        fault = None
        try:
            target.read(folder)
        except Exception as error:
            fault = str(error)
        # The set lacks its two pictures, see `test_house_old_files`.
        whole = "histograms.png" if name.startswith("set") else None
        assert fault is None or (whole and whole in fault), f"{name}: {fault}"


@pytest.mark.parametrize(("kind", "count"), cases(500).items())
def test_a_mutated_input_is_answered_with_one_message(folder: Path, kind: str, count: int) -> None:
    assert not faults(folder, kind, range(count))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), cases(10_000).items())
def test_ten_thousand_mutated_inputs(folder: Path, kind: str, count: int) -> None:
    found = faults(folder, kind, range(1000, 1000 + count))
    assert not found, "\n".join(found)


COMMANDS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(
        ("frame", "labels", "stack", "stack's microscope"),
        ("track", "small-v1/train/0000", "--out", "out.csv"),
    ),
    **{
        kind: ("track", TARGETS[kind].file, "--out", "out.csv")
        for kind in ("png", "jpg", "tif", "video", "ros 1")
    },
    "ros 2": ("track", "ros2", "--out", "out.csv"),
    "poses": ("track", "image.png", "--out", "out.csv", "--poses", "poses.csv"),
    "microscope": ("track", "image.png", "--out", "out.csv", "--microscope", "microscope.json"),
    "opencv yaml": (
        *("track", "image.png", "--out", "out.csv", "--microscope", "camera.yml"),
        *("--pinhole-height-mm", "200", "--eye-radius-mm", "11.5"),
    ),
    "scene": ("scene", "check", "scene.toml"),
    "set": ("dataset", "verify", "small-v1"),
    "set's manifest": ("dataset", "verify", "small-v1"),
    "manifest": ("export", "small-v1/train/0000", "--to", "webdataset", "--out", "out"),
    "mask": ("export", "small-v1/train/0000", "--to", "webdataset", "--out", "out"),
}
"""A command for a kind of file, from the folder of the samples."""


def outcome(folder: Path, command: tuple[str, ...]) -> tuple[int, str, float]:
    """Exit code, stderr and processor time of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    child = run_process(*command, cwd=folder)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    # Decoders of images, which are written in C, also print a word of their own.
    theirs = ("libpng", "Corrupt JPEG data", "[")
    own = [line for line in child.stderr.splitlines() if not line.startswith(theirs)]
    return child.exit_code, "\n".join(own), spent


@pytest.mark.slow
@pytest.mark.parametrize("kind", COMMANDS)
def test_a_command_ends_with_2_and_leaves_nothing(folder: Path, kind: str) -> None:
    def removed_results() -> list[str]:
        shutil.rmtree(folder / "out", ignore_errors=True)
        (folder / "out.csv").unlink(missing_ok=True)
        return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))

    there, target, found = removed_results(), TARGETS[kind], []
    usual_s = outcome(folder, COMMANDS[kind])[2]
    removed_results()
    for seed in range(-(-500 // len(COMMANDS))):
        rng = np.random.default_rng([seed, 7])
        with spoilt(folder / target.file, rng, target.form):
            code, words, spent_s = outcome(folder, COMMANDS[kind])
        if code != 0:
            lines = 21 if target.file == "small-v1/manifest.json" else 3
            one = words.startswith("eyespot: ") and len(words.splitlines()) <= lines
            if code != 2 or not one or "Traceback" in words:
                found.append(f"seed {seed}: {code}: {words:.600}")
        if spent_s > usual_s + _LONGEST_S:
            found.append(f"seed {seed}: {spent_s:.1f} s; usually {usual_s:.1f} s")
        if (left := removed_results()) != there:
            found.append(f"seed {seed} left {sorted(set(left) ^ set(there))}")
    assert not found, "\n".join(found)
