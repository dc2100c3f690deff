"""Which libLLVM is chosen, and that one which would abort the process is never loaded."""

import importlib.util
import sys

import pytest

from eyespot.scenes.machine.llvm import ENVIRONMENT_VARIABLE, Llvm, find_llvm
from tests.support.command_line import run_python


@pytest.fixture
def library_folder(tmp_path, monkeypatch):
    """A folder for fake libraries, which hold their version as text.

    A fake interpreter prints that text where the real one would ask the library, and leaves the
    name of each library it was given in `asked`.
    """
    interpreter = tmp_path / "python"
    interpreter.write_text(f'#!/bin/sh\nbasename "$4" >>{tmp_path}/asked\ncat "$4"\n')
    interpreter.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(interpreter))
    folder = tmp_path / "lib"
    folder.mkdir()
    return folder


def find_in(*folders, **environment):
    return find_llvm(environment=environment, folders=map(str, folders))


def test_the_newest_usable_version_wins(library_folder):
    for name, version in [
        ("libLLVM.so.19.1", "19 1 7"),
        ("libLLVM-22.so.1", "22 1 0"),
        ("libLLVM.so.20.1", "20 1 2"),
        ("libLLVM-15.so.1", "15 0 6"),
    ]:
        (library_folder / name).write_text(version)
    found = find_in(library_folder)
    assert (found.path.name, found.version) == ("libLLVM-22.so.1", (22, 1, 0))


@pytest.mark.parametrize(
    "name",
    ["libLLVM-14.so.1", "libLLVM-14.0.6.so.1", "libLLVM-15.so", "libLLVM-16.so", "libLLVM.so.18.1"],
)
def test_a_version_that_its_name_rules_out_is_never_loaded(library_folder, name):
    (library_folder / name).write_text("19 1 7")
    found = find_in(library_folder)
    assert not found
    assert "needs 19 or newer" in found.refused[0].reason
    assert not (library_folder.parent / "asked").exists()


def test_a_name_without_a_version_is_judged_by_what_the_library_says(library_folder):
    (library_folder / "libLLVM.so").write_text("16 0 6")
    assert "LLVM 16" in find_in(library_folder).refused[0].reason


def test_links_to_one_library_are_asked_once(library_folder):
    (library_folder / "libLLVM.so.19.1").write_text("19 1 7")
    for link in ("libLLVM-19.so", "libLLVM.so"):
        (library_folder / link).symlink_to("libLLVM.so.19.1")
    assert find_in(library_folder, library_folder)
    assert (library_folder.parent / "asked").read_text().count("\n") == 1


def test_a_path_that_was_set_is_the_only_one_considered(library_folder):
    (library_folder / "libLLVM.so.19.1").write_text("19 1 7")
    old = library_folder / "libLLVM-15.so.1"
    old.write_text("15 0 6")
    found = find_in(library_folder, **{ENVIRONMENT_VARIABLE: str(old)})
    assert not found
    assert ENVIRONMENT_VARIABLE in found.remedy


def test_other_files_of_llvm_are_not_taken_for_the_library(library_folder):
    for name in ("libLLVMCore.a", "libLLVM-19-extra.so", "LLVMgold.so"):
        (library_folder / name).write_text("19 1 7")
    assert find_in(library_folder) == Llvm()


def test_the_message_names_every_refused_file_and_the_remedy(library_folder):
    for name in ("libLLVM-14.so.1", "libLLVM-16.so.1"):
        (library_folder / name).touch()
    message = str(find_in(library_folder))
    assert "libLLVM-14.so.1" in message
    assert "libLLVM-16.so.1" in message
    assert "apt-get install libllvm19" in message


def test_a_file_that_is_no_library_is_refused_in_the_words_of_the_loader(tmp_path):
    (tmp_path / "libLLVM.so").write_text("not a library")
    assert "cannot be loaded" in find_in(tmp_path).refused[0].reason


def test_a_library_that_cannot_tell_its_version_counts_as_too_old(tmp_path):
    # An extension module is a library that loads and has no LLVMGetVersion, like LLVM 15.
    extension = importlib.util.find_spec("_ctypes")
    assert extension is not None and extension.origin is not None
    (tmp_path / "libLLVM.so").symlink_to(extension.origin)
    assert "older than LLVM 16" in find_in(tmp_path).refused[0].reason


def test_drjit_runs_on_the_library_that_was_found_and_a_second_variant_is_refused():
    child = run_python(
        "from eyespot.scenes import load_mitsuba\n"
        "load_mitsuba()\n"
        "import drjit\n"
        "print(*drjit.detail.llvm_version())\n"
        "load_mitsuba('scalar_rgb')\n"
    )
    found = find_llvm()
    assert found, str(found)
    assert child.stdout.split() == [str(number) for number in found.version], child.stderr
    assert "RendererUnavailable" in child.stderr
    assert "Start a new process" in child.stderr
