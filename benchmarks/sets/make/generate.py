"""Renders the missing stacks of a set on Dask workers, then completes the set.

The unit of work is a stack, which appears under its name when it is complete. So a stopped run can
be continued with the same spec and folder; also an unfinished stack is continued
(`scenes.render_stack`).
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import scenes
from benchmarks.sets.make import card
from benchmarks.sets.make.manifest import write_set_manifest
from benchmarks.sets.make.worker import render_planned, versions
from benchmarks.sets.read.labelled_set import SCHEMA, LabelledSet, SetError, SetStack, read_set
from benchmarks.sets.spec.planning import PlannedStack, plan
from benchmarks.sets.spec.spec import SetSpec
from estimator.files import (
    MANIFEST,
    BeingWrittenError,
    StackWriter,
    object_in,
    require_space,
    sweep,
    written_whole,
)
from optics import in_file, read_text, shortened

if TYPE_CHECKING:
    from distributed import Client


class Shard(NamedTuple):
    """One of several equal parts of a set; the first is 1."""

    part: int
    parts: int

    def of(self, planned: Sequence[PlannedStack]) -> Sequence[PlannedStack]:
        """The stacks that this part renders."""
        return planned[self.part - 1 :: self.parts]


WHOLE = Shard(1, 1)

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
_BETWEEN_TRIES_S = 1.0


def make_set(
    spec: SetSpec,
    out: Path,
    *,
    workers: AbstractContextManager[Client],
    shard: Shard = WHOLE,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> LabelledSet:
    """Render the missing stacks of a set; the run that renders the last stack completes the set.

    Args:
        spec: the spec of the set.
        out: the set's folder: new, empty, or with a part of this set.
        workers: see `cluster`; started only if a stack is missing.
        shard: part of the set to render; others may run at the same time on any machine.
        progress: called with the number of finished stacks and of all stacks of the shard.

    Returns:
        The set. It is complete unless stacks of other shards are missing (`LabelledSet.missing`).

    Raises:
        SetError: `out` contains something else, or some scenes cannot be rendered (the others have
            been rendered).
        InputError: the disk has too little space.
        OSError: the disk is full or cannot be written; what is done is kept.
        SceneError: a scene key is unknown or a drawn value impossible; nothing is rendered.
    """
    out = Path(out).absolute()
    planned = plan(spec)
    _claim(out, spec, planned)
    share = shard.of(planned)
    missing = [stack for stack in share if not _folder(out, stack).is_dir()]
    progress(len(share) - len(missing), len(share))
    if missing:
        new = [stack for stack in missing if not StackWriter(_folder(out, stack)).has_begun]
        require_space(out, sum(scenes.least_bytes(stack.scene) for stack in new))
        with workers as client:
            _render(missing, out, client, lambda left: progress(len(share) - left, len(share)))
    labelled = read_set(out)
    if not labelled.missing:
        _finish(labelled)
    return labelled


def _render(
    missing: Sequence[PlannedStack], out: Path, client: Client, report: Callable[[int], None]
) -> None:
    """Render stacks; those that another run renders are waited for, and rendered if it stops."""
    problems: list[str] = []
    left, done = list(missing), 0
    while left:
        busy = []
        for stack, error in _tried(left, out, client):
            if isinstance(error, BeingWrittenError):
                busy.append(stack)
                continue
            if error is not None:
                if isinstance(error, scenes.RendererUnavailable) or _is_of_disk(error):
                    raise error
                problems.append(f"{stack.split}/{stack.name}: {error or type(error).__name__}")
            done += 1
            report(len(missing) - done)
        if busy and len(left) > len(busy):
            print(f"Waiting for {len(busy)} stacks that other runs render.", file=sys.stderr)
        left = busy
        if busy:
            time.sleep(_BETWEEN_TRIES_S)
    if problems:
        raise SetError(
            "\n".join([*problems, f"{len(missing) - len(problems)} other stacks are done."])
        )


def _tried(
    stacks: Sequence[PlannedStack], out: Path, client: Client
) -> Iterator[tuple[PlannedStack, BaseException | None]]:
    """Each stack when a worker has tried to render it, and the error if there was one."""
    from distributed import as_completed

    # One message with all tasks costs the scheduler half of what a message a task costs.
    futures = client.map(
        render_planned,
        [stack.scene.model_dump(mode="json", by_alias=True) for stack in stacks],
        [str(_folder(out, stack)) for stack in stacks],
        wanted=versions(),
        pure=False,
    )
    rendering = dict(zip(futures, stacks, strict=True))
    for future in as_completed(rendering):
        yield rendering[future], future.exception()


def _is_of_disk(error: BaseException) -> bool:
    """Whether no other stack can be written either."""
    return isinstance(error, OSError) and error.errno in _FULL


def _claim(out: Path, spec: SetSpec, planned: list[PlannedStack]) -> None:
    """Write set.json into a new folder, or check that it belongs to the same set."""
    content = {
        "schema": SCHEMA,
        "name": spec.name,
        "description": spec.description,
        "licence": spec.licence,
        "seed": spec.seed,
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
            for stack in planned
        ],
    }
    text = json.dumps(content, indent=1) + "\n"
    out.mkdir(parents=True, exist_ok=True)
    file = out / "set.json"
    with _alone_in(out):
        if file.is_file():
            with in_file(file, SetError):
                there = read_text(file)
                found = object_in(there)
            if there != text:
                raise SetError(_difference(out, found, content))
            return
        sweep(out)
        if any(out.iterdir()):
            raise SetError(f"{out} contains other files than a labelled set. Choose another --out.")
        with written_whole(file) as partial:
            partial.write_text(text)


def _difference(out: Path, found: dict[str, Any], wanted: dict[str, Any]) -> str:
    if found.get("spec") != wanted["spec"]:
        name = shortened(found.get("name"))
        return f"{out} contains a set of another spec, {name}. Choose another --out."
    there, here = found.get("versions"), wanted["versions"]
    if isinstance(there, dict) and there != here:
        names = [name for name in {**here, **there} if there.get(name) != here.get(name)]
        other, ours = ({name: each.get(name) for name in names} for each in (there, here))
        return (
            f"{out} was started with other versions: {shortened(other)} instead of "
            f"{shortened(ours)}. Install those, or choose another --out."
        )
    return f"{out / 'set.json'} was changed after it was written. Choose another --out."


def _finish(labelled: LabelledSet) -> None:
    """Write the data card and the manifest, once."""
    with _alone_in(labelled.folder):
        for folder in (labelled.folder, *(labelled.folder / name for name in labelled.splits)):
            sweep(folder)
        if not (labelled.folder / MANIFEST).is_file():
            card.write_card(labelled)
            write_set_manifest(labelled)


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
