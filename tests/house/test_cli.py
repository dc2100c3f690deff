"""The command line: what a person sees when something goes wrong, and the exit codes."""

import errno
import importlib.metadata
import inspect
import os
from importlib import import_module

import pydantic
import pytest

from eyespot.command_line import COMMANDS, TASKS
from eyespot.formats.inputs import InputError
from eyespot.scenes.machine import doctor
from eyespot.scenes.machine.llvm import ENVIRONMENT_VARIABLE
from eyespot.scenes.machine.variant import RendererUnavailable
from tests.support.command_line import WORDS, command_of, options_of, run, run_process, run_python


def fail_with(monkeypatch, error):
    """Lets `eyespot version` raise the error, as a stand-in for any command."""

    def raise_error(_):
        raise error

    monkeypatch.setattr(importlib.metadata, "version", raise_error)


def test_version_is_that_of_the_distribution():
    assert run("version").stdout.strip() == importlib.metadata.version("eyespot")


ONE_BY_ONE = """
import os, sys
from eyespot.command_line import main
os.dup2(1, 2)
for words in EVERY:
    print("COMMAND", words, flush=True)
    sys.argv = ["eyespot", *words.split()]
    try:
        main()
    except SystemExit as end:
        if end.code:
            print("ended", end.code, "cv2" in sys.modules or "jax" in sys.modules, flush=True)
"""


def said_by_each(every):
    """What each command prints in a new process, one after the other."""
    told = run_python(f"EVERY = {every}" + ONE_BY_ONE, COLUMNS="400")
    assert told.stderr == ""
    parts = (part.partition("\n") for part in told.stdout.split("COMMAND ")[1:])
    return {words: text for words, _, text in parts}


@pytest.fixture(scope="module")
def helps():
    """The help of every group and command."""
    every = [f"{words} --help" for words in (*COMMANDS, *WORDS)]
    return {words.removesuffix(" --help"): text for words, text in said_by_each(every).items()}


@pytest.mark.parametrize("group", COMMANDS)
def test_the_list_of_commands_has_each_with_what_it_does(helps, group):
    for function, about in COMMANDS[group].items():
        assert function.rpartition(":")[2].replace("_", "-") in helps[group]
        assert about in helps[group]


@pytest.mark.parametrize("words", WORDS)
def test_every_option_of_every_command_is_explained_in_a_sentence(words):
    for option in options_of(words):
        told = option.parameter.help or ""
        assert told[:1].isupper() or told.startswith("microscope.json"), f"{words} {option.name}"
        assert told.endswith("."), f"{words} {option.name}: {told}"


@pytest.mark.parametrize("path", [path for group in COMMANDS.values() for path in group])
def test_an_argument_of_a_command_has_a_place_or_a_name_but_not_both(path):
    """Of others `signatures` takes no annotation, so that their options would have no type."""
    module, _, name = path.partition(":")
    parameters = inspect.signature(getattr(import_module(f"eyespot.{module}"), name)).parameters
    both = inspect.Parameter.POSITIONAL_OR_KEYWORD
    assert not [one.name for one in parameters.values() if one.kind is both]


@pytest.mark.parametrize("words", WORDS)
def test_the_help_of_a_command_is_its_docstring_and_needs_no_library_that_computes(helps, words):
    first_line, *_ = (command_of(words).default_command.__doc__ or "-").splitlines()
    assert first_line in " ".join(helps[words].split())
    # In this process every module is loaded; in a new one only the signatures.
    assert helps[words] == run(*words.split(), "--help").stdout


MISSPELT = {
    "trakc": "unknown command 'trakc'. Did you mean track?",
    "study eccentricty": "Did you mean eccentricity?",
    "scene chek": "Did you mean check?",
    "score set --mode fast": "Choose from",
    "error --shap 3 --colour": "Unknown option: --shap.",
    "dataset spec.toml --colour --shap": "Unknown option: --colour.",
    "export set --out o --shap": "`eyespot export` needs --to.",
}


def test_what_is_misspelt_is_named_before_anything_is_loaded():  # 7 s: it starts from nothing
    for words, text in said_by_each([*MISSPELT]).items():
        *lines, ended = text.splitlines()
        assert ended == "ended 2 False", text
        assert 1 <= len(lines) <= 2 and lines[0].startswith("eyespot: ")
        wrong = [word for word in ("--shap", "--colour") if word in words]
        for told in (MISSPELT[words], *(f"Unknown option: {word}." for word in wrong)):
            assert told in text


def test_a_device_that_is_not_there_is_named():
    code = "import jax; from eyespot.estimator.run.exit_codes import run_command\n"
    code += "run_command(lambda: jax.numpy.zeros(1))"  # JAX's own error may have no text
    run_python(code, JAX_PLATFORMS="cuda").assert_bad_input(
        "JAX finds no device for JAX_PLATFORMS=cuda. Unset this variable"
    )


@pytest.mark.parametrize("command", [["scene", "check"], ["render", "--out", "out"]])
def test_a_missing_scene_file_is_bad_input(tmp_path, command):
    scene = tmp_path / "missing.toml"
    run(*command, scene).assert_bad_input(str(scene))


def test_a_new_scene_file_is_fine_and_is_not_written_over(tmp_path):
    scene = tmp_path / "scene.toml"
    assert run("scene", "init", scene).exit_code == 0
    # A cone, because the check of a lens computes its light first.
    assert run("scene", "check", scene, "--set", "source.kind=cone").exit_code == 0
    before = scene.read_bytes()
    run("scene", "init", scene).assert_bad_input(str(scene), "already exists")
    assert scene.read_bytes() == before


def test_a_results_folder_that_cannot_be_made_is_bad_input(tmp_path):
    # Permissions do not stop root; a file where a folder should be stops everybody.
    (tmp_path / "file").touch()
    out = tmp_path / "file" / "out"
    run("validate", "--quick", "--out", out).assert_bad_input(str(tmp_path / "file"))


# `validate` asks for the renderer as `render` does.
@pytest.mark.parametrize("command", ["render", pytest.param("validate", marks=pytest.mark.slow)])
def test_without_llvm_the_remedy_is_named_and_nothing_is_left_behind(tmp_path, command):
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    run("scene", "init", scene)
    arguments = {"render": [scene], "validate": ["--quick"]}[command]
    environment = {ENVIRONMENT_VARIABLE: str(tmp_path / "libLLVM-19.so")}
    outcome = run_process(command, *arguments, "--out", out, **environment)
    outcome.assert_bad_input("no such file", "apt-get install libllvm19", "--variant scalar_rgb")
    assert not out.exists()


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (InputError("Sphere(radius=...) must be positive"), "Sphere(radius=...) must be positive"),
        (RendererUnavailable("no usable libLLVM"), "no usable libLLVM"),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "a.png"), "a.png: No space left"),
        (
            ModuleNotFoundError("No module named 'jax'", name="jax"),
            "this needs the Python package jax",
        ),
    ],
)
def test_an_expected_error_is_one_message_and_exit_code_2(monkeypatch, error, message):
    fail_with(monkeypatch, error)
    run("version").assert_bad_input(f"eyespot: {message}")


def test_each_problem_of_a_settings_file_is_one_line(monkeypatch):
    class Eye(pydantic.BaseModel):
        radius_mm: float
        pinhole_mm: float

    with pytest.raises(pydantic.ValidationError) as caught:
        Eye.model_validate({"radius_mm": "wide", "pinhole_mm": None})
    fail_with(monkeypatch, caught.value)
    lines = run("version").stderr.splitlines()
    assert len(lines) == 2
    assert "radius_mm" in lines[0]
    assert "'wide'" in lines[0]
    assert "pinhole_mm" in lines[1]


@pytest.mark.parametrize("bug", [KeyError("semi_minor"), ValueError("math domain error")])
def test_a_bug_keeps_its_traceback(monkeypatch, bug):
    fail_with(monkeypatch, bug)
    with pytest.raises(type(bug)):
        run("version")


def test_the_environment_can_ask_for_the_traceback_of_an_expected_error(monkeypatch):
    fail_with(monkeypatch, InputError("too large"))
    monkeypatch.setenv("EYESPOT_TRACEBACK", "1")
    with pytest.raises(InputError, match="too large"):
        run("version")


def test_ctrl_c_ends_with_the_exit_code_of_an_interrupt(monkeypatch):
    fail_with(monkeypatch, KeyboardInterrupt())
    assert run("version").exit_code == 130  # 128 + SIGINT


def test_doctor_finds_the_main_variant_working():  # 6 s: it imports and renders in a process
    outcome = run_process("doctor")
    assert outcome.exit_code == 0, outcome.stdout
    line = next(line for line in outcome.stdout.splitlines() if "llvm_ad_rgb" in line)
    assert "renders" in line


def test_doctor_names_a_refused_llvm_and_the_remedy(monkeypatch, tmp_path):
    old = tmp_path / "libLLVM-15.so.1"
    old.touch()
    monkeypatch.setenv(ENVIRONMENT_VARIABLE, str(old))
    missing, refused = doctor.llvm_findings()
    assert missing.state is doctor.State.MISSING
    assert "apt-get install libllvm19" in missing.remedy
    assert f"{old}: LLVM 15" in refused.found


@pytest.mark.parametrize(("state", "code"), [("ok", 0), ("note", 0), ("missing", 1)])
def test_doctor_fails_only_where_something_needed_is_missing(monkeypatch, state, code):
    finding = doctor.Finding("cores", "2", doctor.State(state))
    monkeypatch.setattr(doctor, "examine", lambda rig: [finding])
    assert run("doctor").exit_code == code


def test_what_is_missing_is_named_and_what_has_no_value_as_well():
    assert "`eyespot render` needs --out (" in run("render", "scene.toml").stderr
    assert "--out requires an argument" in run("render", "scene.toml", "--out").stderr


def test_help_lists_every_command_by_task():
    lines = [line.strip("│ ╭─╮") for line in run("--help").stdout.splitlines()]
    order = [lines.index(task) for task in (*TASKS, "Other")]
    assert order == sorted(order)
    named = [name for names in TASKS.values() for name in names]
    commands = [path.rpartition(":")[2] for path in COMMANDS[""]]
    groups = [name for name in COMMANDS if name]
    assert sorted(named) == sorted(commands + groups)
    # In each task in the order in which it is done.
    places = [next(i for i, line in enumerate(lines) if line.startswith(f"{n} ")) for n in named]
    assert places == sorted(places)
