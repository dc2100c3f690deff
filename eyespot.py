"""The command `eyespot`: finds the command that was called.

Every command is a function beside the code that it calls; `COMMANDS` says where. JAX and Mitsuba
take seconds to load, so a command's module is imported only when that command runs. How a command
ends is decided in `estimator.run.exit_codes`.
"""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import importlib.util
import io
import os
import sys
from pathlib import Path
from typing import Any

import typer

HOME = Path(__file__).resolve().parent
PACKAGES = ("optics", "scenes", "estimator", "calibration", "benchmarks")

COMMANDS = {
    "validate": "benchmarks.studies.validate.command:validate",
    "render": "scenes.stacks.command:render",
    "track": "estimator.run.command:track",
    "console": "estimator.console.command:console",
    "budget": "estimator.run.budget_command:budget",
    "camera": "estimator.run.camera_command:camera",
    "fit": "calibration.command.command:fit",
    "export": "benchmarks.sets.formats.command:export",
    "score": "benchmarks.sets.score.command:score",
    "preregister": "benchmarks.predictions.command:preregister",
    "adjudicate": "benchmarks.predictions.command:adjudicate",
    "doctor": "scenes.machine.doctor:doctor",
    "version": "eyespot:version",
    "scene init": "scenes.description.command:init",
    "scene schema": "scenes.description.command:schema",
    "scene check": "scenes.stacks.command:check",
    "dataset make": "benchmarks.sets.make.command:make",
    "dataset verify": "benchmarks.sets.make.command:verify",
    "dataset push": "benchmarks.sets.make.command:push",
    "rivals run": "benchmarks.rivals.command:run",
    "rivals tune": "benchmarks.rivals.command:tune",
    "rivals train": "benchmarks.rivals.command:train",
    "study static": "benchmarks.studies.static.command:static",
    "study table-one": "benchmarks.studies.table_one.command:table_one",
    "study medium": "benchmarks.studies.medium.command:medium",
    "study pose": "benchmarks.studies.pose.command:pose",
    "study eccentricity": "benchmarks.studies.eccentricity.command:eccentricity",
    "study eye": "benchmarks.studies.eye.command:eye",
    "study rivals": "benchmarks.studies.rivals.command:rivals",
    "study dynamic": "benchmarks.studies.dynamic.command:dynamic",
}
"""The function behind each command: its parameters are the options, its docstring is the help."""

GROUPS = {
    "scene": "Write and check scene files.",
    "dataset": "Labelled sets: make, verify, push. `eyespot dataset SPEC` is `dataset make SPEC`.",
    "rivals": "Compare with other software and a learned estimator; tune and train them.",
    "study": "Run a study; each writes a report, CSV files and figures.",
}
"""The first words of commands that have two."""


class LazyGroup(typer.core.TyperGroup):
    """A group that lists its commands unloaded, and loads the one that is called."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read `dataset SPEC` as `dataset make SPEC`."""
        known = (*self.commands, *ctx.help_option_names)
        shortened = self.name == "dataset" and args and args[0] not in known
        return super().parse_args(ctx, ["make", *args] if shortened else args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Import the module of the command that is called."""
        name, command, rest = super().resolve_command(ctx, args)
        function = COMMANDS.get(f"{self.name} {name}".strip())
        return name, loaded(function) if function else command, rest


def loaded(function: str) -> Any:
    """The command of a function "module:name"."""
    module, _, name = function.partition(":")
    single = typer.Typer(add_completion=False)
    single.command()(getattr(importlib.import_module(module), name))
    return typer.main.get_command(single)


def summary(function: str) -> str:
    """First line of a function's docstring, read from its file: an import may take seconds."""
    module, _, name = function.partition(":")
    source = HOME.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return (ast.get_docstring(node) or "").partition("\n")[0]
    raise AttributeError(f"{module} has no function {name}")


def command_line() -> typer.Typer:
    """The app with every command of `COMMANDS`, none of them loaded."""
    whole = typer.Typer(
        cls=LazyGroup,
        help="How far can a distance be trusted that was read off a spot of light in a microscope "
        "image?",
        epilog="Set EYESPOT_TRACEBACK=1 in the environment to see where an error comes from.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    groups = {"": whole}
    for name, about in GROUPS.items():
        groups[name] = typer.Typer(cls=LazyGroup, help=about, no_args_is_help=True)
        whole.add_typer(groups[name], name=name)
    for words, function in COMMANDS.items():
        group, _, name = words.rpartition(" ")
        groups[group].command(name, help=summary(function))(lambda: None)
    return whole


app = command_line()


def version() -> None:
    """Print the version of eyespot."""
    typer.echo(importlib.metadata.version("eyespot"))


def main() -> None:
    """Run the command line."""
    # A terminal may have no Greek letters, and a file's name need not be UTF-8.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # Compilation is half of a short run; the next run takes it from this cache.
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(caches / "eyespot" / "jax"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    # OpenCV and FFmpeg would print their own account of an error that we report once.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    if message := _foreign_package():
        print(f"eyespot: {message}", file=sys.stderr)
        sys.exit(2)
    from estimator.run import run_command

    run_command(app)


def _foreign_package() -> str | None:
    """A message if Python finds another distribution's `benchmarks`; our names are common."""
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            return f"eyespot's package {name} is missing in {HOME}. Install it again."
        found = Path(spec.origin).resolve().parent
        if found != HOME / name:
            owners = importlib.metadata.packages_distributions().get(name, [])
            owner = next((owner for owner in owners if owner != "eyespot"), "its distribution")
            return (
                f"the package {name} that Python finds is {found}, not eyespot's. Uninstall "
                f"{owner}, or give eyespot an environment of its own (`make setup`)."
            )
    return None


if __name__ == "__main__":
    main()
