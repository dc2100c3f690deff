"""The commands `eyespot dataset make`, `verify` and `push`."""

import re
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.types import PositiveInt

from estimator.run.options import OUT
from formats.inputs import InputError, in_file, shortened
from scenes.commands import Changes


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
    from benchmarks.sets import make as cluster
    from benchmarks.sets.make import estimate, make_set
    from benchmarks.sets.spec import load_spec, plan
    from scenes import check_scene

    settings, part, parts = load_spec(spec, changes), 1, 1
    if shard is not None:
        match = re.fullmatch(r"(\d+)/(\d+)", shard)
        part, parts = map(int, match.groups()) if match else (0, 0)
        if not 1 <= part <= parts:
            raise InputError(f"--shard must be I/N, with I from 1 to N; got {shard!r}.")
    with in_file(shortened(spec)[1:-1]):
        planned = (plan(settings, check_scene) if dry_run else plan(settings))[part - 1 :: parts]
    if scheduler is not None and workers is not None:
        raise InputError(
            "--workers starts processes on this machine, but --scheduler has its own workers. Give "
            "only one of them."
        )
    count = workers or cluster.cores()
    if dry_run:
        from rich.filesize import decimal

        from estimator.run.progress_bar import duration

        found = estimate(planned)
        processor, wall = duration(found.processor_s), duration(found.processor_s / count)
        print(
            f"{found.images:,} images in {found.stacks:,} stacks, "
            f"{decimal(round(found.size_bytes))}, about {processor} of processor time, {wall} with "
            f"{count} workers on one core each. Estimated from {found.tried} images."
        )
        return
    if out is None:
        raise InputError("--out DIR is missing: the folder for the set.")
    hired = (
        cluster.running_scheduler(scheduler)
        if scheduler is not None
        else cluster.local_workers(count, first_core=(part - 1) * count)
    )
    labelled = make_set(settings, out, workers=hired, shard=(part, parts))
    if labelled.missing:
        print(f"Shard {shard} of {out} is done; {len(labelled.missing)} stacks are still missing.")
    else:
        print(f"Wrote the set {out}: {len(labelled.stacks)} stacks.")
        print(f"Next: eyespot score {out} --mode subpixel")


def verify(folder: Path, /) -> None:
    """Verify a set: list every file that is missing or changed.

    Args:
        folder: Folder of the set.
    """
    from benchmarks.sets.read import verify_set

    print(f"{folder}: complete, {verify_set(folder)} files match the manifest.")


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
    from benchmarks.sets.make import push_set

    print(f"Wrote {push_set(folder, repository, private=private, endpoint=endpoint)}.")
