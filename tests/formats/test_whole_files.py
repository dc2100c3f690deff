"""Files appear whole or not at all, and nothing is written over that this run did not make."""

import errno
import os
import shutil
from pathlib import Path

import pytest

from eyespot.formats.inputs import InputError
from eyespot.formats.whole_files import sweep, written_whole
from tests.support.command_line import run_python

KINDS = ["file", "folder", "link to a file", "link to a folder", "link to nothing", "pipe"]


def make(kind: str, path: Path) -> None:
    """Something of the user's, which must stay as it is."""
    mine = path.parent / "mine"
    match kind:
        case "file":
            path.write_text("mine")
        case "folder":
            path.mkdir()
        case "link to a file":
            mine.write_text("mine")
            path.symlink_to(mine)
        case "link to a folder":
            mine.mkdir()
            path.symlink_to(mine)
        case "link to nothing":
            path.symlink_to(mine)
        case "pipe":
            os.mkfifo(path)


def everything(folder: Path) -> dict[str, tuple[int, str]]:
    return {
        path.name: (path.lstat().st_ino, path.read_text() if path.is_file() else "")
        for path in folder.iterdir()
    }


@pytest.mark.parametrize("kind", KINDS)
def test_what_exists_is_refused_before_the_work_and_left_as_it_is(kind, tmp_path):
    make(kind, tmp_path / "out")
    before = everything(tmp_path)
    with pytest.raises(InputError, match="out already exists"), written_whole(tmp_path / "out"):
        pytest.fail("the work has begun")
    assert everything(tmp_path) == before


@pytest.mark.parametrize(("replace", "offered"), [(None, False), (False, True)])
def test_replacing_is_offered_where_it_can_be_asked_for(tmp_path, replace, offered):
    (tmp_path / "out").write_text("theirs")
    with pytest.raises(InputError) as caught, written_whole(tmp_path / "out", replace=replace):
        pytest.fail("the work has begun")
    assert ("--overwrite" in str(caught.value)) == offered


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("made", ["file", "folder"])
def test_what_appears_during_the_work_is_left_as_it_is(kind, made, tmp_path):
    before = {}
    with pytest.raises(InputError, match="out already exists"):
        with written_whole(tmp_path / "out") as partial:
            partial.write_text("ours") if made == "file" else partial.mkdir()
            make(kind, tmp_path / "out")
            before = everything(tmp_path)
    del before[".out.unfinished"]
    assert everything(tmp_path) == before


@pytest.mark.parametrize("kind", KINDS[1:])
def test_only_a_file_is_replaced(kind, tmp_path):
    make(kind, tmp_path / "out")
    before = everything(tmp_path)
    with pytest.raises(InputError, match="is a link or no file"):
        with written_whole(tmp_path / "out", replace=True) as partial:
            partial.write_text("ours")
    assert everything(tmp_path) == before


def test_a_file_of_ours_is_replaced_in_one_step(tmp_path):
    (tmp_path / "out").write_text("old")
    with written_whole(tmp_path / "out", replace=True) as partial:
        partial.write_text("new")
        assert (tmp_path / "out").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out").read_text() == "new"


def test_a_failure_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), written_whole(tmp_path / "out") as partial:
        partial.mkdir()
        (partial / "half").touch()
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


def test_a_stopped_render_of_the_same_name_is_left_as_it_is(tmp_path):
    stopped = tmp_path / ".out.partial"
    (stopped / "frames").mkdir(parents=True)
    with written_whole(tmp_path / "out") as partial:
        partial.mkdir()
    assert (stopped / "frames").is_dir()


def test_a_link_in_place_of_what_is_unfinished_is_not_followed(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis").touch()
    (tmp_path / ".out.unfinished").symlink_to(tmp_path / "mine")
    with pytest.raises(InputError, match="is no folder"), written_whole(tmp_path / "out"):
        pytest.fail("the work has begun")
    assert (tmp_path / "mine" / "thesis").exists()


def test_only_what_a_killed_writer_left_is_swept(tmp_path):
    killed = """
import os
from pathlib import Path
from eyespot.formats.whole_files import written_whole
with written_whole(Path("left")) as partial:
    partial.write_text("half")
    os._exit(9)
"""
    assert run_python(killed, cwd=tmp_path).exit_code == 9
    (left,) = tmp_path.iterdir()
    assert left.name == ".left.unfinished"
    shutil.copytree(left, tmp_path / ".other.unfinished")
    with written_whole(tmp_path / "left") as partial:
        sweep(tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == [left.name]
        partial.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == ["left"]
    assert (tmp_path / "left").read_text() == "whole"


def test_an_error_of_the_disk_names_the_finished_file(tmp_path):
    # As `write` raises it, without a name, and `shutil.copyfile`, with that of the source first.
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(OSError) as caught, written_whole(tmp_path / "out.h5"):
        raise full
    assert caught.value.filename == str(tmp_path / "out.h5")
    with pytest.raises(OSError) as caught, written_whole(tmp_path / "out") as partial:
        partial.mkdir()
        raise OSError(errno.ENOSPC, "full", "source/a.png", None, str(partial / "a.png"))
    assert caught.value.filename == str(tmp_path / "out" / "a.png")
    with pytest.raises(FileNotFoundError) as caught, written_whole(tmp_path / "out"):
        Path("source/b.png").read_bytes()
    assert caught.value.filename == "source/b.png"


def test_a_working_folder_that_was_removed_is_refused(tmp_path, monkeypatch):
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    # The folder "." is still there, but nothing can be made in it.
    with pytest.raises(InputError, match="is no folder"), written_whole(Path("out")):
        pytest.fail("the work has begun")
