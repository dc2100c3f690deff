"""Whatever stops a writer, the next one finishes; two writers of one thing do not mix."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from eyespot.benchmarks.sets.formats.export import export
from eyespot.benchmarks.sets.score.score_command import score
from eyespot.benchmarks.study import Study
from eyespot.calibration.command.choices import Choices
from eyespot.calibration.command.fit_command import fit
from eyespot.formats.inputs import InputError
from eyespot.formats.stack import StackWriter, read_stack
from eyespot.formats.whole_files import BeingWrittenError, written_whole
from eyespot.scenes import load_scene, render_stack, write_preview
from tests.formats.test_whole_files import everything, make
from tests.support.drawn.drawn_sets import MICROSCOPE, labels_of
from tests.support.files.held import another_process

HOME = Path(__file__).resolve().parents[2]


def stopped_often(*arguments: str) -> dict[str, tuple[int, int]]:
    """How often each task was killed, and met a full disk; see killed_writers."""
    command = [
        sys.executable,
        "-W",
        "ignore",
        "-m",
        "tests.support.files.killed_writers",
        *arguments,
    ]
    done = subprocess.run(command, cwd=HOME, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    found = re.findall(r"(\w+): killed (\d+) times, full (\d+) times", done.stdout)
    return {name: (int(killed), int(full)) for name, killed, full in found}


# Half a minute: some eighty processes are stopped, and each leaves its work to another one.
def test_a_stopped_writer_leaves_what_the_same_command_finishes():
    found = stopped_often("--quick")
    assert list(found) == ["stack", "set", "run", "scene", "coco", "hdf5", "rosbag2"]
    # A file takes seven steps: a folder, its first write, its end, its name, and three to clean up.
    assert found["stack"][0] > 11 * 6 // 5
    assert found["scene"][0] >= 6
    assert all(killed > 1 and full > 0 for killed, full in found.values())


@pytest.mark.slow
def test_a_writer_that_is_stopped_at_any_step_leaves_what_the_same_command_finishes():
    found = stopped_often()
    assert found["stack"][0] > 11 * 6
    assert found["set"][0] > 30 * 6


def tiny_stack(folder: Path, *, stopped: bool = False) -> Path:
    with StackWriter(folder) as writer:
        writer.describe(stack={}, microscope=MICROSCOPE)
        writer.add(np.zeros((6, 8, 3), np.uint8), labels_of(0), np.zeros((6, 8), np.uint8))
        if stopped:
            raise KeyboardInterrupt
    return folder


def begun_stack(folder: Path) -> Path:
    """What a stopped render of a stack leaves; returns a frame of it."""
    with pytest.raises(KeyboardInterrupt):
        tiny_stack(folder, stopped=True)
    return folder.with_name(f".{folder.name}.partial") / "frames" / "000000.png"


def test_a_stopped_stack_outlives_a_run_that_fails_before_it_renders(tmp_path):
    frame = begun_stack(tmp_path / "stack")
    with pytest.raises(ZeroDivisionError), StackWriter(tmp_path / "stack"):
        raise ZeroDivisionError
    assert frame.is_file()


def test_a_run_that_fails_before_it_renders_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), StackWriter(tmp_path / "stack"):
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


WRITERS: dict[str, Callable[[Path, Path], object]] = {
    "render": lambda stack, out: render_stack(load_scene(None), out),
    "preview": lambda stack, out: write_preview(load_scene(None), out),
    "export": lambda stack, out: export(stack, to="coco", out=out),
    "score": lambda stack, out: score(stack, mode="literal", out=out),
    "fit": lambda stack, out: fit(stack, out=out, choices=Choices(model="cone")),
    "study": lambda stack, out: Study("static", out=out, quick=True),
}


ENTERED = {
    "render": "stack.StackWriter(path).__enter__()",
    "study": "path.mkdir(); whole_files.lock(path, of=path)",
}
"""How a process enters a writer of a path; any other is entered by its file."""


@pytest.mark.parametrize("writer", WRITERS)
def test_the_second_run_of_two_is_refused_at_once(writer, tmp_path):
    stack, out = tiny_stack(tmp_path / "stack"), tmp_path / "out"
    entered = ENTERED.get(writer, "w = whole_files.written_whole(path); w.__enter__()")
    with another_process(entered, out) as first:
        with pytest.raises(BeingWrittenError, match="out is being written by another process"):
            WRITERS[writer](stack, out)
        first.send_signal(signal.SIGKILL)
        first.wait()
    # What is locked is so while the process lives, and no longer.
    with pytest.raises(InputError, match="already exists"), written_whole(stack):
        pass
    StackWriter(out).__enter__() if writer == "render" else None


@pytest.mark.parametrize("writer", [name for name in WRITERS if name != "study"])
def test_no_command_writes_over_what_is_there(writer, tmp_path):
    stack = tiny_stack(tmp_path / "stack")
    make("link to a file", tmp_path / "out")
    before = everything(tmp_path)
    with pytest.raises(InputError, match="out already exists"):
        WRITERS[writer](stack, tmp_path / "out")
    assert everything(tmp_path) == before


def test_a_fit_refuses_before_it_starts_if_its_report_exists(tmp_path):
    (tmp_path / "c.html").write_text("mine")
    with pytest.raises(InputError, match=r"c\.html already exists"):
        fit(tmp_path / "no such recording", out=tmp_path / "c.json", choices=Choices(model="plane"))
    assert (tmp_path / "c.html").read_text() == "mine"


@pytest.mark.parametrize("writer", ["export", "score", "fit"])
def test_no_command_removes_a_stopped_stack_of_the_same_name(writer, tmp_path):
    frame = begun_stack(tmp_path / "out")
    broken = tiny_stack(tmp_path / "stack")
    (broken / "metadata.jsonl").unlink()
    with pytest.raises(InputError):  # the work fails once it has started
        WRITERS[writer](broken, tmp_path / "out")
    assert frame.is_file()


@pytest.mark.parametrize("writer", ["export", "score", "preview", "fit"])
def test_a_folder_that_does_not_exist_is_named_before_the_work(writer, tmp_path):
    with pytest.raises(InputError, match="nowhere is no folder"):
        WRITERS[writer](tmp_path / "no such stack", tmp_path / "nowhere" / "out")


@pytest.mark.parametrize("writer", ["render", "export", "score", "fit"])
def test_a_disk_that_is_too_small_is_refused_before_the_work(writer, tmp_path, monkeypatch):
    stack = tiny_stack(tmp_path / "stack")
    # A stub: a disk of that size needs the right to mount one.
    small = os.statvfs_result((4096, 4096, 0, 0, 0, 0, 0, 0, 0, 255))
    monkeypatch.setattr(os, "statvfs", lambda path: small)
    with pytest.raises(InputError, match=r"out needs at least [\d,.]+ MB, but .* has 0\.0 MB"):
        WRITERS[writer](stack, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["stack"]


def test_a_stack_is_verified_with_everything_in_its_folder(tmp_path):
    stack = read_stack(tiny_stack(tmp_path / "stack"))
    stack.verify()
    frame = stack.folder / "frames" / "000000.png"
    frame.rename(tmp_path / "same.png")
    frame.symlink_to(tmp_path / "same.png")
    with pytest.raises(InputError, match=r"frames/000000\.png is a link"):
        stack.verify()
    frame.unlink()
    (tmp_path / "same.png").rename(frame)
    stack.verify()
    extra = stack.folder / "extra"
    for put, said in (
        (lambda: extra.symlink_to("nothing"), "a link"),
        (lambda: os.mkfifo(extra), "a device, socket or pipe"),
        (extra.mkdir, "an empty folder"),
    ):
        put()
        with pytest.raises(InputError, match=f"extra is {said}"):
            stack.verify()
        extra.rmdir() if extra.is_dir() else extra.unlink()
    extra.touch()
    with pytest.raises(InputError, match=r"extra is not in manifest\.json"):
        stack.verify()
