"""One run of a study: its request, its scene, its stacks, its folder."""

import functools
import math
import os
import shlex
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib
import pandas as pd

from eyespot import scenes
from eyespot.benchmarks.model_error import Geometry
from eyespot.benchmarks.paper import SUBPIXEL, Photographer, track_stack
from eyespot.benchmarks.reporting import STYLE, Report, write_page
from eyespot.benchmarks.run_folder import claim, published, versions, write_json
from eyespot.benchmarks.workspace import scene_of_rig, workspace_of_scene
from eyespot.estimator import Reader
from eyespot.estimator.recording import Recording
from eyespot.estimator.run.options import Options
from eyespot.estimator.run.progress_bar import progress, say
from eyespot.formats.inputs import InputError, read_toml
from eyespot.formats.rig import read_rig
from eyespot.formats.rig_keys import WorkspaceKeys
from eyespot.formats.settings_files import by_dotted_name, change_of
from eyespot.formats.stack import Stack, StackWriter, read_stack
from eyespot.formats.whole_files import lock, require_space
from eyespot.scenes import Scene, SceneError
from eyespot.scenes.description.scene_keys import OutsideWindow
from eyespot.scenes.world.true_calibration import true_calibration
from eyespot.scenes.world.world import World

_RUN_SCHEMA = 1
_SUMMARY_SCHEMA = 2
_OF_CLAIM = ("name", "text", "value", "low", "high", "holds")

P = ParamSpec("P")
T = TypeVar("T")


class Study:
    """One run of a study.

    The first arguments are those of a study's command; the same ones resume a run.

    Args:
        defaults: changes of the default scene, used if no scene file is given, before `changes`.
        check: raises if the study cannot use the scene.
        rig: the rig, whose numbers come before `changes`.
        varies: keys of the scene that the study sets itself, so that a change of one has no effect;
            "motion" is the whole table.
        in_workspace: whether the study works over `space`, which is then checked.

    Attributes:
        space: ranges of c, d, tilt and azimuth: those of the rig, or usual ones.
        options: of this study only, by their names on the command line without dashes; those that
            are None are left out.

    Raises:
        InputError: the scene is not valid, the folder has other files, or another process uses it.
        RendererUnavailable: Mitsuba cannot run here.
    """

    def __init__(
        self,
        name: str,
        out: Path,
        scene: Path | None = None,
        changes: Sequence[str] = (),
        quick: bool = False,
        seed: int | None = None,
        defaults: Sequence[str] = (),
        check: Callable[[Scene], None] = lambda scene: None,
        *,
        options: Mapping[str, Any] | None = None,
        rig: Path | None = None,
        varies: Sequence[str] = (),
        in_workspace: bool = False,
    ) -> None:
        self.name, self.quick = name, quick
        self.options = {
            key: str(v) if isinstance(v, Path) else v
            for key, v in (options or {}).items()
            if v is not None
        }
        own = defaults if scene is None else ()
        seeded = () if seed is None else (f"seed={seed}",)
        self.rig = None if rig is None else read_rig(rig)
        stated, self.unread = ({}, []) if self.rig is None else scene_of_rig(self.rig)
        self.unread += [key for key in stated if among(key, varies)]
        of_rig = [change_of(*item) for item in stated.items()]
        self.scene = scenes.load_scene(scene, (*own, *of_rig, *changes, *seeded))
        _refuse_varied(name, changes, varies)
        if scene is not None:
            self.unread += [key for key in by_dotted_name(read_toml(scene)) if among(key, varies)]
        self.seed = self.scene.seed
        self.folder = Path(out)
        self.seconds: dict[str, float] = {}
        start = "eyespot validate" if name == "validate" else f"eyespot study {name}"
        words = [str(scene)] if scene else []
        words += ["--rig", str(rig)] if rig else []
        words += [word for change in changes for word in ("--set", change)]
        words += [word for key, value in self.options.items() for word in (f"--{key}", str(value))]
        words += ["--seed", str(self.seed), "--out", str(out), *(["--quick"] * quick)]
        self.command = f"{start} {shlex.join(words)}"  # repeats this run
        check(self.scene)
        self.space = WorkspaceKeys()
        if in_workspace:
            self.space = workspace_of_scene(self.scene, self.rig, geometry_of(self.scene))
        scenes.load_mitsuba()  # before the folder is made, in case this machine cannot render
        settings = {
            "schema": _RUN_SCHEMA,
            "study": name,
            "scene": self.scene.model_dump(mode="json", by_alias=True),
            "quick": quick,
            **({} if self.rig is None else {"workspace": self.space.model_dump(mode="json")}),
            **self.options,
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        locked = lock(self.folder.resolve(), of=self.folder)
        self._let_go = weakref.finalize(self, os.close, locked)
        try:
            claim(self.folder / "run.json", settings, of="a run", command=start)
        except BaseException:
            self._let_go()
            raise
        say(
            f"Running {start} into {out}: minutes with --quick, else a quarter of an hour to hours."
            " If it is stopped, the same command continues it."
        )

    @staticmethod
    def demand(scene: Scene, needed: Mapping[str, object], why: str) -> None:
        """Refuse a scene whose keys do not have the values that a study needs (SceneError).

        A later key need not exist if an earlier one is wrong. `why` is for the message.
        """
        for key, value in needed.items():
            if (found := attrgetter(key)(scene)) != value:
                remedy = " and ".join(f"{name}={wanted}" for name, wanted in needed.items())
                raise SceneError(f"{why}; got {key} = {found!r}. Set {remedy}.")

    def stacks(self, trials: Mapping[str, Scene]) -> dict[str, Stack]:
        """Stacks by name, in stacks/, rendered unless an earlier run finished them."""
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
        require_possible({n: s for n, s in trials.items() if not (folder / n).exists()})
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
                    stack = finished_stack(
                        scene, folder / name, progress=functools.partial(advance, note=name)
                    )
                    found[name] = beside.submit(measure, name, stack)
                return {name: future.result() for name, future in found.items()}
            except BaseException:
                beside.shutdown(cancel_futures=True)
                raise

    def tracked(self, trials: Mapping[str, Scene]) -> dict[str, pd.DataFrame]:
        """The spots of every trial in sub-pixel mode, by name (`paper.spots_of`)."""
        return self.measured(trials, lambda name, stack: track_stack(stack, SUBPIXEL))

    def photographers(self, trials: Mapping[str, Scene]) -> dict[str, Photographer]:
        """Those who photograph the trials' linear frames again, by name."""
        stacks = self.stacks(trials)
        return {n: Photographer(scene=scene, stack=stacks[n]) for n, scene in trials.items()}

    def reader(self, stack: Stack, scene: Scene, mode: str, **options: Any) -> Reader:
        """A reader of a stack's frames that knows the true light of its scene."""
        rig = Recording.open(stack).rig
        return Options.of({"mode": mode, **options}).reader(rig, true_calibration(scene))

    @contextmanager
    def timed(self, step: str) -> Iterator[None]:
        """Measure the wall time of a step for the report."""
        start = time.perf_counter()
        yield
        self.seconds[step] = time.perf_counter() - start

    def publish(self, report: Callable[P, Report], *of: P.args, **named: P.kwargs) -> None:
        """Write report.html, summary.json, scene.toml, CSV files and figures, all or none; say so.

        `report` makes the report, whose figures use the common style.
        """
        with matplotlib.rc_context(STYLE), published(self.folder) as folder:
            made, used = report(*of, **named), versions()
            scene_toml = scenes.scene_toml(self.scene)
            (folder / "scene.toml").write_text(scene_toml, encoding="utf-8")
            summary = {
                "schema_version": _SUMMARY_SCHEMA,
                "study": self.name,
                "command": self.command,
                "found": [{key: getattr(one, key) for key in _OF_CLAIM} for one in made.claims],
                "versions": used,
                "seconds": self.seconds,
            }
            write_json(folder / "summary.json", summary)
            run: dict[str, Any] = {"study": self, "scene_toml": scene_toml}
            write_page(folder, made, command=self.command, versions=used, **run)
        self._let_go()
        say(f"Wrote {self.folder / 'report.html'}. Open it in a browser.", result=True)


def geometry_of(scene: Scene) -> Geometry:
    """The geometry that the models are given of a scene."""
    half_angle, b = World(scene).cone
    return Geometry(
        scale=scene.microscope.scale_mm_px,
        pinhole_height=scene.microscope.pinhole_height_mm,
        eye_radius=scene.phantom.radius_mm,
        half_angle=half_angle,
        apex_offset=b,
        incidence=math.radians(scene.spot.incidence_deg),
        incidence_azimuth=math.radians(scene.spot.incidence_azimuth_deg),
    )


def among(key: str, keys: Sequence[str]) -> bool:
    """Whether a key, or the table that it belongs to, is one of some."""
    return key in keys or key.partition(".")[0] in keys


def _refuse_varied(study: str, changes: Sequence[str], varies: Sequence[str]) -> None:
    for change in changes:
        key = change.partition("=")[0].strip()
        if among(key, varies):
            raise InputError(
                f"{key} has no effect in this study: `{study}` sets it itself. Leave it out."
            )


def require_possible(trials: Mapping[str, Scene]) -> None:
    """Refuse trials that cannot be rendered, all at once and before the first one is.

    Raises:
        SceneError: of the first trial that is impossible; if spots leave the window, it has the
            size of a window that shows them all.
    """
    leaving = []
    for scene in trials.values():
        try:
            scenes.check_scene(scene)
        except OutsideWindow as problem:
            leaving.append((problem, scene.microscope))
    if not leaving:
        return
    # Trials may differ in scale, as noise-free ones of twice the resolution do.
    sizes = [(p.needed_px[0] / m.width_px, p.needed_px[1] / m.height_px) for p, m in leaving]
    view = leaving[0][1]
    across, along = (max(size) for size in zip(*sizes, strict=True))
    width, height = (
        16 * math.ceil(x / 16) for x in (across * view.width_px, along * view.height_px)
    )
    scale = view.scale_mm_px * max(across, along)
    raise OutsideWindow(
        f"in {len(leaving)} of {len(trials)} trials the spot leaves the {view.width_px} x "
        f"{view.height_px} px window. Set microscope.width_px={width} and "
        f"microscope.height_px={height}, or microscope.scale_mm_px={scale:.3g}.",
        (width, height),
    )


def finished_stack(
    scene: Scene, folder: Path, *, progress: Callable[[], None] = lambda: None
) -> Stack:
    """The scene's stack, rendered unless finished; InputError if it is that of another scene."""
    if not folder.is_dir():
        return scenes.render_stack(scene, folder, progress=progress)
    stack = read_stack(folder)
    if stack.description["scene"] != scene.model_dump(mode="json", by_alias=True):
        raise InputError(
            f"{folder} was rendered from another scene than this version would render. Remove it, "
            "or choose another --out."
        )
    for _ in range(scenes.frame_count(scene)):
        progress()
    return stack
