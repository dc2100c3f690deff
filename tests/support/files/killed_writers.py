"""Stops writers at each step and at full disks, and lets the same command finish what is left.

Run as a program. It imports once and forks for each step, so that a step
costs milliseconds. A step is a call that makes, links, renames or removes a name, or a file's
first write or its end. At the chosen step the child ends at once, as a killed process does; what
Python has buffered is lost, and of a file that was being closed the first half is on the disk. A
full disk is a limit on the size of files (RLIMIT_FSIZE), which needs no rights.

Stubs: Mitsuba and Dask, which render, the check of a set's scenes, and the data card's figures.
"""

import contextlib
import errno
import os
import resource
import shutil
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from eyespot import scenes
from eyespot.benchmarks.reporting import Picture, Report, Section
from eyespot.benchmarks.sets import card, make
from eyespot.benchmarks.sets.formats.export import export
from eyespot.benchmarks.sets.spec import PlannedStack, SetSpec
from eyespot.benchmarks.study import Study
from eyespot.formats.inputs import InputError
from eyespot.formats.spot import NoSpot, Reason
from eyespot.formats.spots import SpotRecord, write_spots
from eyespot.formats.stack import Stack, StackWriter, read_stack
from eyespot.formats.whole_files import STOPPED, UNFINISHED, written_whole
from eyespot.scenes.commands import init
from tests.support.drawn.drawn_sets import MICROSCOPE, digests, labels_of

KILLED, FULL = 77, 78
SIZES = [0, 1, 100, 200, 500, 1000, 1500, 2000, 3000, 5000, 10_000, 20_000, 50_000]
OF_NAMES = {"mkdir", "rmdir", "link", "rename", "replace", "unlink", "remove", "truncate"}
OF_CONTENT = {"write", "close", "__exit__"}
FILES = {"TextIOWrapper", "BufferedWriter", "BufferedRandom", "FileIO"}


class Killer:
    """Ends the process at a step; to be given to `sys.setprofile`."""

    def __init__(self, step: int) -> None:
        self.left = step
        self._writing: Any = None

    def __call__(self, frame: Any, event: str, called: Any) -> None:
        if event != "c_call":
            return
        owner: Any = getattr(called, "__self__", None)
        if called.__name__ in OF_NAMES and getattr(owner, "__name__", "") == "posix":
            self._step()
        elif called.__name__ in OF_CONTENT and type(owner).__name__ in FILES:
            if owner.closed or not owner.writable() or not isinstance(owner.name, str | Path):
                return
            if called.__name__ != "write":
                self._step(owner)
            elif owner is not self._writing:
                self._writing = owner
                self._step()

    def _step(self, closing: Any = None) -> None:
        self.left -= 1
        if self.left == 0:
            if closing is not None:
                closing.flush()
                os.truncate(closing.name, os.stat(closing.name).st_size // 2)
            os._exit(KILLED)


def tiny_stack(folder: Path) -> None:
    """What `render_stack` writes: frames, masks and radiance, resumed where it was stopped."""
    with StackWriter(folder) as writer:
        writer.describe(
            stack={"scene": DESCRIBED, "cone": {"half_angle": 1}},
            microscope={**MICROSCOPE, "width_px": 8, "height_px": 6},
            kinematics=np.array([[n, 1, 2, n, 0, 0, -1] for n in (1, 2, 3)]),
        )
        for index in range(2):
            labels = labels_of(index)
            if not writer.has(labels.file_name):
                light = np.full((6, 8, 3), index + 1.0)
                mask = np.full((6, 8), 255, np.uint8)
                writer.add(light.astype(np.uint8), labels, mask, light)


def render_stub(scene: scenes.Scene, folder: Path, progress: Callable[[], None]) -> Stack:
    tiny_stack(folder)
    return read_stack(folder)


def render_set_stub(missing: Sequence[PlannedStack], out: Path, *rest: object) -> None:
    for planned in missing:
        tiny_stack(out / planned.split / planned.name)


def picture_stub(rows: object, path: Path) -> None:
    with written_whole(path, replace=True) as partial_picture:
        partial_picture.write_bytes(b"picture")


def nothing(folder: Path) -> None:
    pass


def write_stack(folder: Path) -> None:
    tiny_stack(folder / "stack")


def write_set(folder: Path) -> None:
    workers: Any = contextlib.nullcontext()
    make.make_set(SPEC, folder / "set", workers=workers)


def write_run(folder: Path) -> None:
    os.chdir(folder)
    study = Study("static", out=Path("run"), quick=True)
    spots = study.folder / "spots"
    spots.mkdir(exist_ok=True)

    def measure(name: str, stack: Stack) -> int:
        row = stack.labels[0]
        none = NoSpot(Reason.NONE_FOUND)
        write_spots(
            spots / f"{name}.csv",
            [SpotRecord(frame=0, file_name=row.file_name, time_s=0, mode="literal", result=none)],
        )
        return len(stack.labels)

    with contextlib.redirect_stdout(None):
        study.publish(report, study.measured({"a": study.scene}, measure))


def report(found: dict[str, int]) -> Report:
    figure = Figure(figsize=(1, 1))
    figure.add_axes((0, 0, 1, 1)).plot([0, found["a"]])
    picture = Picture("line", figure, "A line.")
    return Report(title="?", lead="!", claims=(), sections=[Section("s", picture)])


def write_scene(folder: Path) -> None:
    with contextlib.redirect_stdout(None):
        init(folder / "scene.toml")


def write_export(folder: Path, *, to: Any) -> None:
    export(folder / "stack", to=to, out=folder / "out")


class Task(NamedTuple):
    """What is to be written, twice if the first process is killed."""

    write: Callable[[Path], None]
    prepare: Callable[[Path], None] = nothing
    few: int = 1
    """Of the steps only every so manieth is tried in a quick run."""


DESCRIBED = scenes.load_scene(None).model_dump(mode="json", by_alias=True)
SPEC = SetSpec.model_validate(
    {
        "name": "tiny",
        "description": "Two stacks.",
        "seed": 1,
        "splits": {"train": 1, "test": 1},
        "vary": {"spot.eccentricity_mm": {"uniform": [0.0, 4.0]}},
    }
)
TASKS = {
    "stack": Task(write_stack, few=5),
    "set": Task(write_set, few=40),
    "run": Task(write_run, few=40),
    "scene": Task(write_scene),
    "coco": Task(partial(write_export, to="coco"), prepare=write_stack, few=5),
    "hdf5": Task(partial(write_export, to="hdf5"), prepare=write_stack),
    "rosbag2": Task(partial(write_export, to="rosbag2"), prepare=write_stack, few=5),
}


def in_child(write: Callable[[Path], None], folder: Path) -> int:
    """Exit code of a child that writes."""
    if child := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    code = 1
    try:
        write(folder)
        code = 0
    except BaseException:
        sys.setprofile(None)
        traceback.print_exc()
    finally:
        sys.setprofile(None)
        os._exit(code)


def killed_at(step: int, write: Callable[[Path], None], folder: Path) -> None:
    """Write, and end the process at a step."""
    killer = Killer(step)
    threading.setprofile(killer)
    sys.setprofile(killer)
    write(folder)


def on_full_disk(size: int, write: Callable[[Path], None], folder: Path) -> None:
    """Write where no file can have more than some bytes; the error must name a file of the user."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    try:
        write(folder)
    except OSError as error:
        assert error.errno == errno.EFBIG, error
        assert isinstance(error.filename, str), "no name"
        named = folder / error.filename
        assert not any(part.endswith((UNFINISHED, STOPPED)) for part in named.parts), named
        os._exit(FULL)


def complete(task: Task, folder: Path) -> None:
    """Write again what a killed process may have left; what it has finished is refused."""
    try:
        task.write(folder)
    except InputError as error:
        if "already exists" not in str(error):
            raise


def stop(name: str, task: Task, *, quick: bool) -> str:
    """Stop a task at each step and at each size of the disk; returns how often."""
    with tempfile.TemporaryDirectory() as home:
        whole = Path(home) / "whole"
        whole.mkdir()
        task.prepare(whole)
        complete(task, whole)
        wanted = digests(whole)

        def stopped(how: Callable[..., None], value: int) -> int:
            """Exit code of a process that was stopped; another one must have finished its work."""
            folder, where = Path(home) / "stopped", f"{name}, {how.__name__} {value}"
            folder.mkdir()
            task.prepare(folder)
            code = in_child(partial(how, value, task.write), folder)
            assert code in (0, KILLED, FULL), f"{where}: exit code {code}"
            left = sorted(digests(folder))
            again = in_child(partial(complete, task), folder)
            assert again == 0, f"{where}: the next process does not finish; left: {left}"
            differences = digests(folder).items() ^ wanted.items()
            assert not differences, f"{where}: {sorted(differences)}"
            shutil.rmtree(folder)
            return code

        killed, full = 0, 0
        while stopped(killed_at, 1 + killed * (task.few if quick else 1)) == KILLED:
            killed += 1
        for size in SIZES[:: 6 if quick else 1]:
            full += stopped(on_full_disk, size) == FULL
    return f"{name}: killed {killed} times, full {full} times"


def main(*, quick: bool) -> None:
    """Stop every task; print how often."""
    stubs: list[tuple[Any, str, Any]] = [
        (scenes, "load_mitsuba", lambda: None),
        (scenes, "render_stack", render_stub),
        (make, "_render", render_set_stub),
        (scenes, "check_scene", lambda scene: None),  # JAX does not survive a fork
        (card, "histograms", picture_stub),
        (card, "samples", picture_stub),
    ]
    for module, name, stub in stubs:
        setattr(module, name, stub)
    for name, task in TASKS.items():
        print(stop(name, task, quick=quick), flush=True)


if __name__ == "__main__":
    main(quick="--quick" in sys.argv)
