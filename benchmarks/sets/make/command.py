"""What `eyespot dataset` does with its arguments."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

from rich.filesize import decimal
from rich.progress import Progress

from benchmarks.sets.make import cluster
from benchmarks.sets.make.estimate import Estimate, estimate
from benchmarks.sets.make.generate import WHOLE, Shard, make_set
from benchmarks.sets.make.manifest import verify_set
from benchmarks.sets.spec import load_spec, plan


def make(
    source: str,
    *,
    out: Path | None,
    workers: int | None,
    scheduler: str | None,
    shard: str | None,
    changes: Sequence[str],
    dry_run: bool,
) -> None:
    """Make a set, or say what it would take.

    Args:
        source: path of a spec, or the name of one that comes with the software.
        out: the set's folder; not needed for a dry run.
        workers: of a local cluster; None for one a core.
        scheduler: address of a running one, instead of a local cluster.
        shard: "i/n".
        changes: "table.key = value" of the spec's [scene].
        dry_run: only estimate.

    Raises:
        ValueError: of the arguments, the spec or the folder; the message says what to change.
    """
    spec, part = load_spec(source, changes), _shard(shard)
    if scheduler is not None and workers is not None:
        raise ValueError("--workers counts those on this machine; --scheduler has its own.")
    count = workers or cluster.cores()
    if dry_run:
        _say(estimate(part.of(plan(spec))), workers=count)
        return
    if out is None:
        raise ValueError("--out DIR is missing: the folder for the set.")
    hired = (
        cluster.running_scheduler(scheduler)
        if scheduler is not None
        else cluster.local_workers(count, first_core=(part.part - 1) * count)
    )
    with Progress(transient=True) as progress:
        task = progress.add_task("Stacks")
        labelled = make_set(
            spec,
            out,
            workers=hired,
            shard=part,
            progress=lambda done, total: progress.update(task, completed=done, total=total),
        )
    if labelled.missing:
        print(f"Shard {shard} of {out} is done; the set lacks {len(labelled.missing)} stacks.")
    else:
        print(f"Wrote the set {out}: {len(labelled.stacks)} stacks.")


def verify(folder: Path) -> None:
    """Say that a set is whole.

    Raises:
        SetError: it is not; the message says what is missing or changed.
    """
    print(f"{folder}: whole, {verify_set(folder)} files as the manifest says.")


def _shard(text: str | None) -> Shard:
    if text is None:
        return WHOLE
    if match := re.fullmatch(r"(\d+)/(\d+)", text):
        shard = Shard(int(match[1]), int(match[2]))
        if 1 <= shard.part <= shard.parts:
            return shard
    raise ValueError(f"--shard is i/n, with i from 1 to n; got {text!r}.")


def _say(found: Estimate, *, workers: int) -> None:
    processor, wall = (
        timedelta(seconds=round(seconds))
        for seconds in (found.processor_s, found.processor_s / workers)
    )
    print(
        f"{found.images:,} images in {found.stacks:,} stacks, {decimal(round(found.size_bytes))}, "
        f"{processor} h of processor time: {wall} h with {workers} workers, each with a core to "
        f"itself. Measured on {found.tried} images."
    )
