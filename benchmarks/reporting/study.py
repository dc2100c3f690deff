"""One run of a study: its request, its scene, its stacks, its folder."""

from __future__ import annotations

import contextlib
import os
import shlex
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

import matplotlib

import scenes
from benchmarks.reporting import run_folder
from benchmarks.reporting.figures import STYLE
from benchmarks.reporting.report import Report, write_page
from estimator import Stack, StackWriter
from estimator.files import require_space
from estimator.run import progress
from scenes import Scene

_RUN_SCHEMA = 1
_SUMMARY_SCHEMA = 2

F = TypeVar("F")
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Request:
    """The arguments that all studies take.

    Attributes:
        out: folder for the results; a run with the same request is resumed.
        scene: scene file, or None for the study's own.
        changes: "table.key=value" each, set after reading.
        quick: a smaller study, for a first look.
        seed: random seed; None uses the scene's.
        options: options of this study only, by their names on the command line without dashes.
    """

    out: Path
    scene: Path | None = None
    changes: tuple[str, ...] = ()
    quick: bool = False
    seed: int | None = None
    options: Mapping[str, int | float | str] = field(default_factory=dict)


class Study:
    """One run of a study.

    Args:
        defaults: changes of the default scene, used if no scene file is given; the request's own
            changes come after them.
        check: raises if the study cannot use the scene.
        command: words of the command line; `eyespot study NAME` if not given.

    Attributes:
        scene: the scene to start from.
        seconds: wall time of this run by step.

    Raises:
        InputError: the scene is not valid, the folder has other files, or another process uses it.
        RendererUnavailable: Mitsuba cannot run here.
    """

    def __init__(
        self,
        name: str,
        request: Request,
        *,
        defaults: Sequence[str] = (),
        check: Callable[[Scene], None] = lambda scene: None,
        command: Sequence[str] = (),
    ) -> None:
        own = defaults if request.scene is None else ()
        seed = () if request.seed is None else (f"seed={request.seed}",)
        self.name, self.request = name, request
        self.scene = scenes.load_scene(request.scene, (*own, *request.changes, *seed))
        self.seed = self.scene.seed
        self.folder = Path(request.out)
        self.seconds: dict[str, float] = {}
        self._words = tuple(command) or ("eyespot", "study", name)
        check(self.scene)
        scenes.load_mitsuba()  # before the folder is made, in case this machine cannot render
        settings = {
            "schema": _RUN_SCHEMA,
            "study": name,
            "scene": self.scene.model_dump(mode="json", by_alias=True),
            "quick": request.quick,
            **request.options,
        }
        claimed = run_folder.claim(self.folder, settings, command=shlex.join(self._words))
        weakref.finalize(self, os.close, claimed)

    @property
    def command(self) -> str:
        """The command line that repeats this run."""
        asked = self.request
        words = [*self._words]
        words += [str(asked.scene)] if asked.scene else []
        for change in asked.changes:
            words += ["--set", change]
        for name, value in asked.options.items():
            words += [f"--{name}", str(value)]
        words += ["--seed", str(self.seed), "--out", str(asked.out)]
        return shlex.join(words + ["--quick"] * asked.quick)

    def stack(self, name: str, scene: Scene) -> Stack:
        """A scene's stack in stacks/NAME, rendered unless an earlier run finished it."""
        return self.stacks({name: scene})[name]

    def stacks(self, trials: Mapping[str, Scene]) -> dict[str, Stack]:
        """Stacks by name, in stacks/."""
        return self.measured(trials, lambda name, stack: stack)

    def measured(
        self, trials: Mapping[str, Scene], measure: Callable[[str, Stack], T]
    ) -> dict[str, T]:
        """The results of `measure(name, stack)` by name.

        A thread measures a stack while the next one is rendered, because rendering does not use all
        cores fully.
        """
        folder = self.folder / "stacks"
        folder.mkdir(exist_ok=True)
        total = sum(scenes.frame_count(scene) for scene in trials.values())
        new = [name for name in trials if not StackWriter(folder / name).has_begun]
        new = [name for name in new if not (folder / name).exists()]
        require_space(self.folder, sum(scenes.least_bytes(trials[name]) for name in new))
        with (
            ThreadPoolExecutor(max_workers=1) as beside,
            progress("Rendering", total=total) as advance,
        ):
            try:
                found = {}
                for name, scene in trials.items():
                    stack = run_folder.finished_stack(
                        scene, folder / name, progress=partial(advance, note=name)
                    )
                    found[name] = beside.submit(measure, name, stack)
                return {name: future.result() for name, future in found.items()}
            except BaseException:
                beside.shutdown(cancel_futures=True)
                raise

    @contextlib.contextmanager
    def timed(self, step: str) -> Iterator[None]:
        """Measure the wall time of a step for the report."""
        start = time.perf_counter()
        yield
        self.seconds[step] = time.perf_counter() - start

    def publish(self, report: Callable[[F], Report], findings: F) -> None:
        """Write report.html, summary.json, scene.toml, CSV files and figures, all or none; say so.

        Args:
            report: function that makes the report; its figures use the common style.
        """
        with matplotlib.rc_context(STYLE), run_folder.published(self.folder) as folder:
            self._write(report(findings), folder)
        print(f"Wrote {self.folder / 'report.html'}.")

    def _write(self, report: Report, folder: Path) -> None:
        scene_toml = scenes.scene_toml(self.scene)
        (folder / "scene.toml").write_text(scene_toml, encoding="utf-8")
        used = run_folder.versions()
        summary = {
            "schema_version": _SUMMARY_SCHEMA,
            "study": self.name,
            "command": self.command,
            "found": [claim.row for claim in report.claims],
            **report.summary,
            "versions": used,
            "seconds": self.seconds,
        }
        run_folder.write_json(folder / "summary.json", summary)
        write_page(
            folder,
            report,
            command=self.command,
            versions=used,
            template="report.html.j2",
            study=self,
            scene_toml=scene_toml,
        )
