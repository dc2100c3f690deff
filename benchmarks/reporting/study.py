"""What all studies share: what was asked for, the run's folder, and the report."""

from __future__ import annotations

import contextlib
import shlex
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

import scenes
from benchmarks.reporting import run_folder
from benchmarks.studies.validate import Conclusion, template, write_csv
from estimator import Stack
from scenes import Scene, SceneError

_RUN_SCHEMA = 1
_SUMMARY_SCHEMA = 1

MICROSCOPE_MM = 200.0
"""z_F of a real microscope."""

_SMALLEST_RADIUS_MM = 10.0


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a person asked a study for: the arguments that all studies take.

    Attributes:
        out: folder for the results; a run with the same request goes on where it was.
        scene: scene file, or None for the study's own.
        changes: "table.key=value" each, set after reading.
        quick: a smaller study, for a first look.
        seed: of whatever is drawn at random; None is the scene's.
        options: of this study alone, by the command line's name without dashes.
    """

    out: Path
    scene: Path | None = None
    changes: tuple[str, ...] = ()
    quick: bool = False
    seed: int | None = None
    options: Mapping[str, int | float | str] = field(default_factory=dict)


Row = Sequence[str | int | float]
"""Of a table in the report: numbers are rounded, texts and ints stand as they are."""


class Picture(NamedTuple):
    """A figure of the report; written as figures/NAME.png and .svg.

    Attributes:
        name: of its files.
        figure: drawn under `benchmarks.studies.validate.figures.STYLE`.
        caption: what is seen; "z_F" and "d_r" get their subscripts.
        data: the CSV file behind it.
    """

    name: str
    figure: Figure
    caption: str
    data: str = ""


class Table(NamedTuple):
    """A table of the report.

    Attributes:
        header: names of the columns, with units.
        rows: cells.
        caption: what is listed.
        digits: of floats.
        data: the CSV file behind it.
    """

    header: Sequence[str]
    rows: Sequence[Row]
    caption: str
    digits: int = 3
    data: str = ""


class Section:
    """A heading and what stands below it: paragraphs, tables and pictures in order."""

    def __init__(self, title: str, *parts: str | Table | Picture) -> None:
        self.title, self.parts = title, parts


class Data(NamedTuple):
    """A CSV file.

    Attributes:
        name: of the file.
        row_type: NamedTuple whose fields are the columns, with units.
        rows: of that type.
    """

    name: str
    row_type: type[Any]
    rows: Iterable[Any]


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a study found.

    Attributes:
        title: the question.
        lead: what was done, in a sentence or two.
        found: the answers, computed in this run.
        sections: what they rest on.
        data: CSV files to write; a name alone is of one that the study has written itself.
    """

    title: str
    lead: str
    found: Sequence[Conclusion]
    sections: Sequence[Section]
    data: Sequence[Data | str] = ()


class Study:
    """One run of a study.

    Args:
        name: of the study, and of its command.
        request: what was asked for.
        defaults: changes of the default scene, used where no scene file is given; the person's own
            changes come after them.
        check: raises where the scene is none for this study.

    Attributes:
        scene: the scene to start from.
        seed: of whatever is drawn at random.
        folder: of the results.
        seconds: wall time of this run by step.

    Raises:
        ValueError: the scene cannot be, or the folder holds something else.
        RendererUnavailable: Mitsuba cannot run here.
    """

    def __init__(
        self,
        name: str,
        request: Request,
        *,
        defaults: Sequence[str] = (),
        check: Callable[[Scene], None] = lambda scene: None,
    ) -> None:
        own = defaults if request.scene is None else ()
        seed = () if request.seed is None else (f"seed={request.seed}",)
        self.name, self.request = name, request
        self.scene = scenes.load_scene(request.scene, (*own, *request.changes, *seed))
        self.seed = self.scene.seed
        self.folder = Path(request.out)
        self.seconds: dict[str, float] = {}
        check(self.scene)
        scenes.load_mitsuba()  # a machine that cannot render leaves no folder behind
        settings = {
            "schema": _RUN_SCHEMA,
            "study": name,
            "scene": self.scene.model_dump(mode="json", by_alias=True),
            "quick": request.quick,
            **request.options,
        }
        run_folder.claim(self.folder, settings, command=f"eyespot study {name}")

    @property
    def command(self) -> str:
        """The command line that makes this run again."""
        asked = self.request
        words = ["eyespot", "study", self.name]
        words += [str(asked.scene)] if asked.scene else []
        for change in asked.changes:
            words += ["--set", change]
        for name, value in asked.options.items():
            words += [f"--{name}", str(value)]
        words += ["--seed", str(self.seed), "--out", str(asked.out)]
        return shlex.join(words + ["--quick"] * asked.quick)

    def stack(self, name: str, scene: Scene) -> Stack:
        """A scene's stack in stacks/NAME, rendered unless an earlier run has finished it."""
        return self.stacks({name: scene})[name]

    def stacks(self, trials: Mapping[str, Scene]) -> dict[str, Stack]:
        """Stacks by name, in stacks/, with a bar that shows how far it is."""
        folder = self.folder / "stacks"
        folder.mkdir(exist_ok=True)
        columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, transient=True) as progress:
            total = sum(scenes.frame_count(scene) for scene in trials.values())
            task = progress.add_task("rendering", total=total)
            return {
                name: run_folder.finished_stack(
                    scene, folder / name, progress=lambda: progress.advance(task)
                )
                for name, scene in trials.items()
            }

    @contextlib.contextmanager
    def timed(self, step: str) -> Iterator[None]:
        """Note what a step takes; the report lists it."""
        start = time.perf_counter()
        yield
        self.seconds[step] = time.perf_counter() - start

    def publish(self, report: Report) -> None:
        """Write report.html, summary.json, scene.toml, CSV files and figures, all or none."""
        with run_folder.published(self.folder) as folder:
            for data in report.data:
                if isinstance(data, Data):
                    write_csv(folder / data.name, data.row_type, data.rows)
            (folder / "scene.toml").write_text(scenes.scene_toml(self.scene), encoding="utf-8")
            (folder / "figures").mkdir()
            images = {
                part.name: run_folder.save_figure(part.figure, folder / "figures" / part.name)
                for section in report.sections
                for part in section.parts
                if isinstance(part, Picture)
            }
            used = run_folder.versions()
            summary = {
                "schema_version": _SUMMARY_SCHEMA,
                "study": self.name,
                "command": self.command,
                "found": [conclusion._asdict() for conclusion in report.found],
                "versions": used,
                "seconds": self.seconds,
            }
            run_folder.write_json(folder / "summary.json", summary)
            html = template("study.html.j2").render(
                study=self,
                report=report,
                images=images,
                versions=used,
                scene_toml=scenes.scene_toml(self.scene),
                kind_of=_kind_of,
            )
            (folder / "report.html").write_text(html, encoding="utf-8")


def _kind_of(part: str | Table | Picture) -> str:
    return "text" if isinstance(part, str) else type(part).__name__.lower()


def require_roomy_eyeball(scene: Scene, reach: str) -> None:
    """Refuse a scene whose wall does not go as far out as a study's spots.

    Args:
        scene: the study's.
        reach: what reaches how far, for the message.

    Raises:
        SceneError: saying what to change.
    """
    if scene.phantom.kind != "eyeball" or scene.phantom.radius_mm < _SMALLEST_RADIUS_MM:
        raise SceneError(
            f"the study's {reach} in an eyeball of {_SMALLEST_RADIUS_MM:g} mm radius or more; got "
            f"phantom.kind '{scene.phantom.kind}' with radius_mm = {scene.phantom.radius_mm:g}. "
            "Set phantom.kind=eyeball and raise phantom.radius_mm."
        )
