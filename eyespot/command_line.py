"""The command `eyespot`: finds the command that was called.

Every command is a function beside the code that it calls; its signature and its docstring are what
the command line shows. A command's module is imported only when that command runs (see
`signatures`). How a command ends is decided in `estimator.run.exit_codes`.
"""

from __future__ import annotations

import io
import sys
from typing import Any

from cyclopts import App, Group, Parameter

COMMANDS = {
    "": {
        "benchmarks.studies.validate:validate": "Repeat the paper's experiment, rendered.",
        "scenes.commands:render": "Render a scene file to an image stack with labels.",
        "estimator.run.track_command:track": "Measure the spot in every frame; write a spots file.",
        "estimator.console.console_command:console": "Show a source and its distances live.",
        "benchmarks.rig_error:error": "Say how wrong each model is for a rig, in seconds.",
        "benchmarks.explore_page:explore": "Play with eye, beam and models in the browser.",
        "estimator.run.budget_command:budget": "Say how uncertain a distance is, and why.",
        "estimator.run.camera_command:camera": "Measure a camera's noise (EMVA 1288).",
        "estimator.rig.node:node": "Measure a microscope's images under ROS 1 or 2.",
        "calibration.command.fit_command:fit": "Fit a beam to recordings; write a calibration.",
        "benchmarks.sets.formats.export:export": "Write a set or a stack in another format.",
        "benchmarks.sets.score.score_command:score": "Compare spots with the labels of a set.",
        "benchmarks.predictions:preregister": "Predict an experiment before it is done.",
        "benchmarks.predictions:adjudicate": "Say which predictions of a plan held.",
        "scenes.machine.doctor:doctor": "Check this machine; explain what is missing.",
    },
    "scene": {
        "scenes.commands:init": "Write a scene file with every key and its default.",
        "scenes.commands:schema": "Print the JSON schema of scene files, for editors.",
        "scenes.commands:check": "Check whether a scene file can be rendered.",
    },
    "rig": {
        "estimator.run.rig_command:init": "Write a rig file with every key and its meaning.",
        "estimator.run.rig_command:check": "Compare a rig file with a recording, in seconds.",
    },
    "dataset": {
        "benchmarks.sets.make:make": "Render a labelled set.",
        "benchmarks.sets.read:verify": "List every file that is missing or changed.",
        "benchmarks.sets.make:push": "Upload a complete set to the Hugging Face Hub.",
    },
    "rivals": {
        "benchmarks.rivals.running:run": "Measure the images of a set with all entries.",
        "benchmarks.rivals.running:tune": "Choose the free constants of the entries.",
    },
    "study": {
        "benchmarks.studies.static:static": "The paper's Tables I and II, many times.",
        "benchmarks.studies.map:map": "Where in my workspace which model can be trusted.",
        "benchmarks.studies.table_one:table_one": "The lenses that give Table I.",
        "benchmarks.studies.medium:medium": "Calibrate in air, measure in vitreous.",
        "benchmarks.studies.pose:pose": "The tool's tip and axis from spots.",
        "benchmarks.studies.eccentricity:eccentricity": "Each model's error by cause.",
        "benchmarks.studies.eye:eye": "Contact and wide-field lenses, and many eyes.",
        "benchmarks.studies.sensors:sensors": "Spot, shadow and stereo pair.",
        "benchmarks.studies.dynamic:dynamic": "The error while the tip moves.",
        "benchmarks.studies.design:design": "Which drop of glue, and how little light.",
        "benchmarks.studies.loop:loop": "Keep a distance with a simulated robot.",
    },
}
"""By the first word of two, if there are two: each command's function, in a package of `eyespot`,
and its line in the list."""

TASKS = {
    "Start": ("scene", "render", "fit", "track"),
    "Judge": ("error", "explore", "budget", "score", "validate", "study", "rivals"),
    "Data": ("dataset", "export"),
    "Rig": ("rig", "camera", "console", "node", "doctor"),
    "Plan": ("preregister", "adjudicate"),
}
"""What `--help` lists together, in the order in which it is done."""

_EXAMPLE = """\
How far can you trust a distance measured from a spot of light in a microscope image?

Four commands, from a scene to distances:

    eyespot scene init scene.toml
    eyespot render scene.toml --out stack
    eyespot fit stack --out lens.json
    eyespot track stack --calibration lens.json --out spots.csv

Each command explains itself, such as eyespot fit --help."""


_PANELS = {task: Group(task, sort_key=number) for number, task in enumerate(TASKS)}


def _place(name: str) -> dict[str, Any]:
    """Where `--help` lists a command."""
    for task, names in TASKS.items():
        if name in names:
            return {"group": _PANELS[task], "sort_key": names.index(name)}
    return {}


# No --no-quick beside --quick; of an option that is given twice the last one counts; the default of
# a flag, or of an option that may be left out, goes without saying.
_PLAIN = Parameter(
    negative=(),
    allow_repeating=True,
    show_default=lambda value: None if value in (None, ()) or value is False else str(value),
)

app = App(
    name="eyespot",
    help=_EXAMPLE,
    group_commands=Group("Other", sort_key=len(TASKS)),
    help_epilogue="Set EYESPOT_TRACEBACK=1 in the environment to see where an error comes from.",
    help_format="plaintext",  # importing a markdown parser would double the time of --help
    version=lambda: _version(),
    version_flags=["--version", "-v"],
    default_parameter=_PLAIN,
    # Called from Python a command returns its results; the command line shows files.
    result_action="sys_exit",
    # What these would do, `run_command` does.
    exit_on_error=False,
    print_error=False,
    suppress_keyboard_interrupt=False,
)
groups = {"": app} | {
    name: App(name=name, help=about, default_parameter=_PLAIN, **_place(name))
    for name, about in (
        ("scene", "Write and check scene files."),
        ("rig", "Write a rig file, and check it with a recording."),
        ("dataset", "Labelled sets: make, verify, push. `dataset SPEC` is `dataset make SPEC`."),
        ("rivals", "Compare with other software, and choose its constants."),
        ("study", "Run a study; each writes a report, CSV files and figures."),
    )
}
app.register_install_completion_command(help="Complete words with Tab in bash, zsh and fish.")
for _name, _group in groups.items():
    for _function, _about in COMMANDS[_name].items():
        _word = _function.rpartition(":")[2].replace("_", "-")
        _own: dict[str, Any] = {"name": _word, "help": _about, "help_format": "markdown"}
        _own |= {} if _name else _place(_word)
        _group.command(f"eyespot.signatures:{_function.replace(':', '.')}", **_own)
    if _name:
        app.command(_group)


@app.command
def version() -> None:
    """Print the version of eyespot."""
    print(_version())


def _version() -> str:
    from importlib import metadata  # 0.05 s

    return metadata.version("eyespot")


def show_docstring(command: App) -> None:
    """Make a command's docstring its help, instead of the line that the list shows."""
    function = command.default_command
    if function and function.__module__ != __name__:
        command.help = None


def _check_command(words: list[str]) -> None:
    """Refuse a command that does not exist: to propose one, cyclopts would load every command."""
    group = groups.get(words[0], app) if words else app
    known = [name for name in group if not name.startswith("-")]
    for name in words[:1] if group is app else words[1:2]:
        if name.startswith("-") or name in known:
            continue
        import difflib

        from eyespot.formats.inputs import InputError

        close = difflib.get_close_matches(name, known, 1)
        meant = f" Did you mean {close[0]}?" if close else ""
        asked = " ".join(["eyespot", *words[:1]] if group is not app else ["eyespot"])
        raise InputError(f"unknown command {name!r}.{meant} {asked} --help lists all.")


def run() -> None:
    """Run the command that the command line names."""
    words = sys.argv[1:]
    if words[:1] == ["dataset"] and words[1:] and words[1] not in groups["dataset"]:
        words.insert(1, "make")  # `dataset SPEC`
    _check_command(words)
    for command in app.parse_commands(words)[1]:
        show_docstring(command)
    app(words)


def main() -> None:
    """Run the command line."""
    # A terminal may have no Greek letters, and a file's name need not be UTF-8.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    from eyespot.estimator.run.exit_codes import run_command

    run_command(run)
