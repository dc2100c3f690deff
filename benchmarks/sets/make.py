"""`eyespot dataset make` and `push`: renders the missing stacks of a set on Dask workers.

The unit of work is a stack, which appears under its name when it is complete. So a stopped run can
be continued with the same spec and folder; also an unfinished stack is continued
(`scenes.render_stack`).
"""

import errno
import fcntl
import importlib
import importlib.metadata
import math
import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from cyclopts.types import PositiveInt
from dask.system import cpu_count
from distributed import Client, Future, as_completed
from rich.filesize import decimal

from eyespot import scenes
from eyespot.benchmarks.run_folder import claim
from eyespot.benchmarks.sets import card
from eyespot.benchmarks.sets.read import (
    SCHEMA,
    LabelledSet,
    SetStack,
    read_set,
    verify_set,
    write_set_manifest,
)
from eyespot.benchmarks.sets.spec import (
    Draw,
    PlannedStack,
    SetSpec,
    draw,
    impossible_report,
    load_spec,
)
from eyespot.benchmarks.sets.workers import local_workers, running_scheduler
from eyespot.estimator.run.options import OUT
from eyespot.estimator.run.progress_bar import duration, say
from eyespot.estimator.run.progress_bar import progress as bar
from eyespot.formats.inputs import InputError
from eyespot.formats.manifest import MANIFEST
from eyespot.formats.stack import StackWriter
from eyespot.formats.whole_files import BeingWrittenError, require_space, sweep
from eyespot.scenes.commands import Changes

# What a worker does: it renders one stack.

_PACKAGES = ("eyespot", "mitsuba", "drjit", "jax", "numpy", "opencv-python-headless", "scipy")

# A worker with several threads uses them all for one stack.
_one_at_a_time = threading.Lock()


def versions() -> dict[str, str]:
    """Versions of the packages that affect the bytes of a set."""
    return {name: importlib.metadata.version(name) for name in _PACKAGES}


def render_planned(scene: Mapping[str, Any], folder: str, wanted: Mapping[str, str]) -> None:
    """Render one stack into a folder that all workers can access, unless it already exists.

    Raises:
        InputError: this worker has other versions than the set, or the scene is impossible.
        BeingWrittenError: another run is rendering it.
    """
    if versions() != wanted:
        raise InputError(
            f"a worker has other versions than the set: {versions()} instead of {dict(wanted)}. "
            "Use the same environment for all workers."
        )
    out = Path(folder)
    with _one_at_a_time:
        if out.is_dir():
            return
        try:
            scenes.render_stack(scenes.Scene.model_validate(scene), out)
        except InputError:
            if not out.is_dir():  # else another run has just finished it
                raise


# Estimates number of images, size and time of a set without rendering.

_START_S = 4.0
"""Processor time before a stack's first image, s: the wall's picture, the light, the kernels."""
_IMAGE_S = 0.2
"""Processor time of an image of 640 x 480 px with 4 samples, s."""
_PNG_EXCESS = 1.4
"""Size of our PNG files over the entropy of their noise (8 bits, a lens and a cone)."""
_USUAL_LEVEL = 0.1
"""Mean level of an image over full scale: little of it is lit."""


def estimate(planned: Sequence[PlannedStack]) -> tuple[int, float, float]:
    """Number and bytes of a set's images, and the processor time of usual ones, s.

    Traced light, bounds and colours with their own lines of sight take longer.
    """
    images, size, seconds = 0, 0.0, 0.0
    for stack in planned:
        scene, microscope = stack.scene, stack.scene.microscope
        count = scenes.frame_count(scene) * len(scene.exposures.kinds)
        pixels = microscope.width_px * microscope.height_px
        images += count
        size += count * _PNG_EXCESS * scenes.noise_bytes(scene, level=_USUAL_LEVEL)
        seconds += _START_S + count * _IMAGE_S * pixels * microscope.samples / (640 * 480 * 4)
    return images, size, seconds


# Uploads a set to a repository of the Hugging Face Hub.


def push(
    folder: Path,
    repository: Annotated[str, Parameter(name="OWNER/NAME")],
    /,
    *,
    private: bool = False,
    endpoint: str | None = None,
) -> None:
    """Upload a complete set to the Hugging Face Hub.

    Args:
        folder: Folder of the set.
        repository: Dataset repository; created if missing.
        private: Make a new repository private.
        endpoint: Address of another Hub (default: huggingface.co).
    """
    try:
        importlib.import_module("huggingface_hub.errors")
    except ModuleNotFoundError as error:
        raise InputError(
            "`dataset push` needs the package huggingface_hub: pip install 'eyespot[hub]'."
        ) from error
    hub: Any = importlib.import_module("huggingface_hub")
    verify_set(folder)
    name = read_set(folder).name
    api = hub.HfApi(endpoint=endpoint, library_name="eyespot")
    # HTTPError is that of the HTTP library that huggingface_hub uses; a missing token an OSError.
    problems = (hub.errors.HTTPError, hub.errors.HFValidationError, OSError)
    try:
        api.create_repo(repository, repo_type="dataset", private=private, exist_ok=True)
        # Not upload_large_folder, which keeps its state in a folder within the set.
        commit = api.upload_folder(
            repo_id=repository,
            repo_type="dataset",
            folder_path=folder,
            commit_message=f"{name} as eyespot rendered it",
        )
    except (*problems, RuntimeError) as error:
        # A failed upload of one file is a RuntimeError that follows from one of the others.
        if isinstance(error, RuntimeError) and not isinstance(error.__cause__, problems):
            raise
        said = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"the Hub did not take {folder} as {repository}: {said[:300]}. Check the name, the "
            "network, and the access token with write permission (`hf auth login`, or HF_TOKEN)."
        ) from error
    print(f"Wrote {commit.commit_url}.")


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
_BETWEEN_TRIES_S = 1.0


def make_set(
    spec: SetSpec,
    out: Path,
    *,
    workers: AbstractContextManager[Client],
    shard: tuple[int, int] = (1, 1),
) -> LabelledSet:
    """Render the missing stacks of a set; the run that renders the last stack completes the set.

    Impossible scenes are found before anything is rendered, and refused or left out, as the spec
    says. Unless stacks of other shards are missing, the set is complete.

    Args:
        out: the set's folder: new, empty, or with a part of this set.
        workers: `local_workers` or `running_scheduler`; started only if a stack is missing.
        shard: which of how many parts of the set to render, the first is 1; others may run at the
            same time on any machine.

    Raises:
        InputError: `out` contains something else, the disk has too little space, a stack cannot be
            rendered, or Dask is gone.
        OSError: the disk is full or cannot be written; what is done is kept.
        SceneError: see `draw`.
    """
    out = Path(out).absolute()
    drawn = draw(spec, scenes.check_scene)
    if drawn.impossible:
        say(f"Left out: {impossible_report(drawn)}")
    planned = drawn.stacks
    share = planned[shard[0] - 1 :: shard[1]]
    missing = [stack for stack in share if not _folder(out, stack).is_dir()]
    _claim(out, spec, drawn)
    with bar("Rendering stacks", total=len(share)) as advance:
        advance(len(share) - len(missing))
        if missing:
            new = [stack for stack in missing if not StackWriter(_folder(out, stack)).has_begun]
            require_space(out, sum(scenes.least_bytes(stack.scene) for stack in new))
            with workers as client:
                _render(missing, out, client, advance)
    labelled = read_set(out)
    if not labelled.missing:
        with _alone_in(out):
            for folder in (out, *(out / name for name in labelled.splits)):
                sweep(folder)
            if not (out / MANIFEST).is_file():
                card.write_card(labelled)
                write_set_manifest(labelled)
    return labelled


def _render(
    missing: Sequence[PlannedStack], out: Path, client: Client, advance: Callable[[], None]
) -> None:
    """Render stacks; those that another run renders are waited for, and rendered if it stops."""
    problems: list[str] = []
    left = list(missing)
    while left:
        busy = []
        # One message with all tasks costs the scheduler half of what a message a task costs.
        futures = client.map(
            render_planned,
            [stack.scene.model_dump(mode="json", by_alias=True) for stack in left],
            [str(_folder(out, stack)) for stack in left],
            wanted=versions(),
            pure=False,
        )
        rendering = dict(zip(futures, left, strict=True))
        for future in _finished(futures, client):
            stack, error = rendering.pop(future), future.exception()
            if isinstance(error, BeingWrittenError):
                busy.append(stack)
                continue
            if error is not None:
                full = isinstance(error, OSError) and error.errno in _FULL
                if full or isinstance(error, scenes.RendererUnavailable):
                    raise error  # no other stack can be made either
                problems.append(f"{stack.split}/{stack.name}: {error or type(error).__name__}")
            advance()
        if busy and len(left) > len(busy):
            say(f"Waiting for {len(busy)} stacks that other runs render.")
        left = busy
        if busy:
            time.sleep(_BETWEEN_TRIES_S)
    if problems:
        raise InputError(
            "\n".join([*problems, f"{len(missing) - len(problems)} other stacks are done."])
        )


_LOOK_S = 5.0
_ALONE_S = 60.0
"""How long workers may be gone that were there. A nanny starts one again in seconds; a worker that
has lost its network ends after 30 s (Dask's `comm.timeouts.tcp`), and nobody starts it again."""


def _finished(futures: Sequence[Future], client: Client) -> Iterator[Future]:
    """The futures as they finish.

    Raises:
        InputError: the scheduler or all workers are gone.
    """
    left, seen_s = set(futures), math.inf

    def gone(who: str) -> InputError:
        return InputError(
            f"{who}; {len(left)} stacks are still missing. Start the scheduler and its workers "
            "again, then run the same command: it continues the set."
        )

    while left:
        try:
            for future in as_completed(left, timeout=_LOOK_S):
                if future.cancelled():  # with the scheduler all is gone that is not done
                    raise gone("the Dask scheduler no longer answers")
                left.remove(future)
                seen_s = time.monotonic()
                yield future
        except TimeoutError:
            # The first worker may wait in the queue of a cluster for hours.
            if client.scheduler_info()["workers"]:
                seen_s = time.monotonic()
            elif time.monotonic() - seen_s > _ALONE_S:
                raise gone(f"Dask has had no worker for {_ALONE_S:.0f} s") from None


def _claim(out: Path, spec: SetSpec, drawn: Draw) -> None:
    """Write set.json into a new folder, or check that it belongs to the same set."""
    content = {
        "schema": SCHEMA,
        **{name: getattr(spec, name) for name in ("name", "description", "licence", "seed")},
        "versions": versions(),
        "spec": spec.model_dump(mode="json", by_alias=True, exclude_none=True),
        "stacks": [
            {
                "split": stack.split,
                "name": stack.name,
                "condition": stack.condition,
                **({"pair": stack.pair} if stack.pair else {}),
                "parameters": stack.parameters,
            }
            for stack in drawn.stacks
        ],
    }
    if drawn.impossible:
        content["left_out"] = [
            {**one._asdict(), "problem": str(one.problem)} for one in drawn.impossible
        ]
    out.mkdir(parents=True, exist_ok=True)
    with _alone_in(out):
        claim(out / "set.json", content, of="a set", command="eyespot dataset make")


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Lock a folder; waits until no other process has locked it."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _folder(out: Path, stack: PlannedStack | SetStack) -> Path:
    return out / stack.split / stack.name


# The command.


def make(
    spec: str,
    /,
    *,
    out: Annotated[Path | None, OUT] = None,
    workers: PositiveInt | None = None,
    scheduler: str | None = None,
    shard: Annotated[str | None, Parameter(metavar="I/N")] = None,
    changes: Changes = (),
    dry_run: bool = False,
) -> None:
    """Render a labelled set: splits of stacks, a data card and a manifest.

    If a run was stopped, the same command continues it.

    Args:
        spec: Spec file (TOML), or a named set: static-v2, eccentricity-v2, dynamic-v2, adverse-v2,
            eye-v2, or static-v1, eccentricity-v1, dynamic-v1, adverse-v1.
        out: Folder of the set; not needed with --dry-run.
        workers: Worker processes on this machine (default: one per core).
        scheduler: Address of a Dask scheduler whose workers render the set; see docs/datasets.md.
        shard: Render only part I of N, for job arrays on a cluster.
        dry_run: Print the number of frames, size and time; render nothing.
    """
    settings, part, parts = load_spec(spec, changes), 1, 1
    if shard is not None:
        match = re.fullmatch(r"(\d+)/(\d+)", shard)
        part, parts = map(int, match.groups()) if match else (0, 0)
        if not 1 <= part <= parts:
            raise InputError(f"--shard must be I/N, with I from 1 to N; got {shard!r}.")
    if scheduler is not None and workers is not None:
        raise InputError(
            "--workers starts processes on this machine, but --scheduler has its own workers. Give "
            "only one of them."
        )
    count = workers or cpu_count()
    if dry_run:
        drawn = draw(settings, scenes.check_scene)
        if drawn.impossible:
            print(f"Left out: {impossible_report(drawn)}")
        share = drawn.stacks[part - 1 :: parts]
        images, size, seconds = estimate(share)
        print(
            f"{images:,} images in {len(share):,} stacks, {decimal(round(size))}, about "
            f"{duration(seconds)} of processor time, {duration(seconds / count)} with {count} "
            "workers on one core each."
        )
        return
    if out is None:
        raise InputError("--out DIR is missing: the folder for the set.")
    hired = (
        running_scheduler(scheduler)
        if scheduler is not None
        else local_workers(count, first_core=(part - 1) * count)
    )
    labelled = make_set(settings, out, workers=hired, shard=(part, parts))
    if labelled.missing:  # those of other shards
        print(f"Shard {shard} of {out} is done; {len(labelled.missing)} stacks are still missing.")
    else:
        print(f"Wrote the set {out}: {len(labelled.stacks)} stacks.")
        print(f"Next: eyespot score {out} --mode subpixel")
