"""WebDataset: tar shards SPLIT-000000.tar; a sample is an image with mask and labels.

The files of a sample are SPLIT/STACK/000000.png, .mask.png and .json, one after the other, copied
from the stack. The same set gives the same bytes.
"""

import io
import itertools
import json
import tarfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from eyespot.benchmarks.sets.read import SetStack

_SHARD_BYTES = 2**28  # Larger is slow to shuffle, smaller slow to read.


def write(
    stacks: Sequence[SetStack],
    out: Path,
    progress: Callable[[], None],
    *,
    shard_bytes: int = _SHARD_BYTES,
) -> None:
    """Write the shards; each ends with the sample that reaches `shard_bytes`."""
    for part, group in itertools.groupby(stacks, key=lambda stack: stack.split_name):
        samples = itertools.chain.from_iterable(map(_samples, group))
        for shard in itertools.count():
            first = next(samples, None)
            if first is None:
                break
            _write_shard(
                out / f"{part}-{shard:06d}.tar",
                itertools.chain([first], samples),
                shard_bytes,
                progress,
            )


def _samples(entry: SetStack) -> Iterator[dict[str, bytes]]:
    """Names and contents of each sample's files."""
    stack = entry.open()
    for row in stack.labels:
        key = f"{entry.qualified_name}/{Path(row.file_name).stem}"
        yield {
            f"{key}.png": stack.path_of(row.file_name).read_bytes(),
            f"{key}.mask.png": stack.path_of(row.mask_file_name).read_bytes(),
            f"{key}.json": json.dumps(row.row()).encode(),
        }


def _write_shard(
    path: Path,
    samples: Iterator[dict[str, bytes]],
    shard_bytes: int,
    progress: Callable[[], None],
) -> None:
    written = 0
    # A new TarInfo has no date and no owner.
    with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as shard:
        for sample in samples:
            for name, content in sample.items():
                info = tarfile.TarInfo(name)
                info.size = len(content)
                shard.addfile(info, io.BytesIO(content))
                written += len(content)
            progress()
            if written >= shard_bytes:
                return
