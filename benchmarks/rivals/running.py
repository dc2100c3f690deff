"""`eyespot rivals run` and `tune`: entries over the stacks of a set, and their constants.

OUT/ENTRY/SPLIT/STACK.csv has the spots of a stack; of several exposures, STACK.EXPOSURE.csv.
OUT/ENTRY/entry.json has name, command, versions, constants, and the processor time per frame.
"""

import functools
import importlib.metadata
import json
import math
import shlex
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from cyclopts.types import PositiveInt
from dask.system import cpu_count
from distributed import Client

from eyespot.benchmarks.paper import VISIBLE_ENOUGH
from eyespot.benchmarks.rivals.entries import KINDS, Entry, chosen, unavailable
from eyespot.benchmarks.rivals.pupil import PACKAGE
from eyespot.benchmarks.run_folder import versions, write_json
from eyespot.benchmarks.sets.read import SetStack, exposures_of, stacks_of, true_beam
from eyespot.benchmarks.sets.workers import local_workers
from eyespot.estimator import Frame, Ranger, open_source
from eyespot.estimator.run.offline import record_of
from eyespot.estimator.run.options import OUT
from eyespot.estimator.run.progress_bar import progress
from eyespot.formats.inputs import InputError, in_file, read_text
from eyespot.formats.manifest import fingerprint
from eyespot.formats.microscope import read_microscope
from eyespot.formats.spot import Spot
from eyespot.formats.spots import SpotRecord, write_spots
from eyespot.formats.whole_files import require_space, written_whole

_LEAST_BYTES = 2**20  # The spots files need about as much.


Answers = tuple[str, str, list[SpotRecord], list[float]]
"""The answers of an entry on an exposure of a stack: the two's names, records, and times (s)."""


Names = Annotated[
    tuple[str, ...],
    Parameter(
        "--entry",
        help="Name of an entry; may be repeated (default: all entries).",
        show_default=False,
    ),
]


def run(
    folder: Path,
    /,
    *,
    out: Annotated[Path, OUT],
    names: Names = (),
    splits: Annotated[tuple[str, ...], Parameter("--split", show_default=False)] = (),
    constants: Path | None = None,
    workers: PositiveInt | None = None,
) -> None:
    """Measure the images of a set with all entries: other software, and our modes.

    `eyespot score SET --entries OUT` then ranks them.

    Args:
        folder: Labelled set.
        out: Folder of the entries; it is new.
        splits: Split to measure; may be repeated (default: all splits).
        constants: File of `rivals tune` (default: eyespot's own).
        workers: Worker processes on this machine (default: one per core).
    """
    entries = chosen(names)
    stacks = [entry for entry in stacks_of(folder) if not splits or entry.split in splits]
    if not stacks:
        raise InputError(f"{folder} has no split {' or '.join(splits)}. Choose another --split.")
    known = read_constants(constants or CONSTANTS)
    reasons = {name: unavailable(name) for name in entries}
    able = [name for name, reason in reasons.items() if not reason]
    for name, reason in reasons.items():
        if reason:
            print(f"{name} is left out: {reason}", file=sys.stderr)
    if not able:
        raise InputError("none of the entries can run on this machine. Name another --entry.")
    with (
        written_whole(out) as whole,
        local_workers(min(workers or cpu_count(), len(stacks))) as client,
        progress("Measuring stacks", total=len(stacks)) as advance,
    ):
        whole.mkdir()
        require_space(out, _LEAST_BYTES)
        seconds: dict[str, list[float]] = {name: [] for name in able}
        tasks = [(stack, able, known) for stack in stacks]
        for stack, future in zip(stacks, client.map(_answers, tasks, pure=False), strict=True):
            several = len(exposures_of(stack.open())) > 1
            for name, exposure, records, times in future.result():
                suffix = f".{exposure}" if several else ""
                file = whole / name / f"{stack.qualified_name}{suffix}.csv"
                file.parent.mkdir(parents=True, exist_ok=True)
                write_spots(file, records)
                seconds[name] += times
            advance()
        for name in able:
            write_json(whole / name / "entry.json", _about(name, known, seconds[name]))
    print(f"Wrote {out}: {len(able)} entries on {len(stacks)} stacks.")


def measure_stack(
    stack: SetStack,
    name: str,
    made: Entry,
    *,
    distances: bool = True,
    frames: Callable[..., Iterable[Frame]] = open_source,
) -> Iterable[Answers]:
    """The answers of an entry on a stack, one sequence for each exposure.

    Ellipses are turned into distances, too, if asked for. `frames` reads a folder's exposure.
    """
    microscope = read_microscope(stack.folder / "microscope.json")
    opened = stack.open()
    beam = true_beam(opened)
    ranger = Ranger(beam, microscope) if distances and not made.own_distance else None
    for exposure in exposures_of(opened):
        first = opened.exposed(exposure)[0]
        made.begin(microscope, beam, (first.half_max_x_px, first.half_max_y_px))
        records, seconds = [], []
        for frame in frames(stack.folder, exposure=exposure):
            began = time.process_time() + made.seconds_elsewhere
            reading = made.read(frame)._replace(mode=name)
            seconds.append(time.process_time() + made.seconds_elsewhere - began)
            if ranger is not None and isinstance(reading.result, Spot):
                found = ranger.distance(
                    reading.result, frame=frame.image, exposure_s=frame.exposure_s
                )
                reading = reading._replace(range=found)
            record = record_of(frame, reading)
            records.append(replace(record, measured_with=""))  # entry.json says it
        yield name, exposure, records, seconds


_made: dict[str, tuple[dict[str, Any], Entry]] = {}
"""The entries of a worker with their constants: the detector starts slowly."""


def _entry(name: str, constants: dict[str, Any]) -> Entry:
    if name not in _made or _made[name][0] != constants:
        if name in _made:
            _made[name][1].close()
        _made[name] = constants, KINDS[name].make(constants)
    return _made[name][1]


def _answers(task: tuple[SetStack, list[str], "Constants"]) -> list[Answers]:
    stack, names, known = task
    made = {name: _entry(name, known.get(name, {})) for name in names}
    return [answer for name in names for answer in measure_stack(stack, name, made[name])]


def _about(name: str, known: "Constants", seconds: list[float]) -> dict[str, Any]:
    """Content of entry.json; the median processor time of a frame is without its distance."""
    kind = KINDS[name]
    own = {package: importlib.metadata.version(package) for package in kind.packages}
    if name == "pupil-detectors":
        package, _, version = PACKAGE.partition("==")
        own[package] = version
    return {
        "name": name,
        "about": kind.about,
        "command": shlex.join(["eyespot", *sys.argv[1:]]),
        "versions": {"python": versions()["python"], **own},
        "seed": None,
        "constants": known.get(name, {}),
        "ms_per_frame": round(1e3 * statistics.median(seconds), 3),
    }


CONSTANTS = Path(__file__).with_name("constants.json")
SCHEMA = 1

Constants = dict[str, dict[str, Any]]  # constants by name, by entry


def read_constants(path: Path = CONSTANTS) -> Constants:
    """The constants of a file of `eyespot rivals tune`; InputError if it is none."""
    with in_file(path):
        try:
            entries = json.loads(read_text(path))["entries"]
            return {name: dict(found["constants"]) for name, found in entries.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"not a file of `eyespot rivals tune` ({error}).") from error


# Chooses the free constants of the entries on the split `train`, one constant after another.
#
# The cost of a frame is the error of the semi-minor axis, at most ten pixels, which is also the
# cost of a miss. From the first value of each constant, each one in turn takes the value with the
# least mean cost, until nothing changes or everything was chosen twice.

_MOST_PX = 10.0
_ROUNDS = 2
_KEPT_STACKS = 32  # A worker keeps their frames: 600 MB at 20 frames of 640 x 480 px.


def tune(
    folder: Path,
    /,
    *,
    out: Annotated[Path, OUT],
    names: Names = (),
    every: PositiveInt = 1,
    workers: PositiveInt | None = None,
) -> None:
    """Choose the free constants of the entries on the split train of a set.

    Args:
        folder: Labelled set.
        out: New JSON file.
        every: Use one stack of so many.
        workers: Worker processes on this machine (default: one per core).
    """
    stacks = [entry for entry in stacks_of(folder) if entry.split == "train"][::every]
    if not stacks:
        raise InputError(f"{folder} has no split train. Constants are chosen on nothing else.")
    able = [name for name in chosen(names) if KINDS[name].grid and not unavailable(name)]
    found: dict[str, Any] = {}
    with (
        written_whole(out) as partial,
        local_workers(workers or cpu_count()) as client,
        progress("Tuning", total=len(able)) as advance,
    ):
        for name in able:
            found[name] = _chosen(name, stacks, client)
            advance(note=f"{name} {found[name]['cost_px']:.2f} px")
        manifest = folder / "manifest.json"
        origin = {
            "command": shlex.join(["eyespot", *sys.argv[1:]]),
            "set": folder.resolve().name,
            "manifest": fingerprint(manifest) if manifest.is_file() else None,
            "stacks": [entry.qualified_name for entry in stacks],
            "versions": versions(),
        }
        write_json(partial, {"schema": SCHEMA, **origin, "entries": found})
    print(f"Wrote {out}.")


def _chosen(name: str, stacks: Sequence[SetStack], client: Client) -> dict[str, Any]:
    """The constants of an entry, with their mean cost and the number of values tried."""
    grid = KINDS[name].grid
    now = {constant: values[0] for constant, values in grid.items()}
    costs: dict[tuple[Any, ...], float] = {}

    def cost(constants: dict[str, Any]) -> float:
        key = tuple(constants.values())
        if key not in costs:
            tasks = [(name, constants, stack) for stack in stacks]
            found = client.gather(client.map(stack_costs, tasks, pure=False))
            costs[key] = float(np.mean(np.concatenate(found)))
        return costs[key]

    for _ in range(_ROUNDS):
        before = dict(now)
        for constant, values in grid.items():
            now[constant] = min(values, key=lambda value: cost(now | {constant: value}))
        if now == before:
            break
    return {"constants": now, "cost_px": round(cost(now), 4), "tried": len(costs)}


_kept_frames = functools.lru_cache(_KEPT_STACKS)(
    lambda folder, exposure: list(open_source(folder, exposure=exposure))
)


def stack_costs(task: tuple[str, dict[str, Any], SetStack]) -> list[float]:
    """Cost of each frame of a stack whose spot is visible, px."""
    name, constants, stack = task
    truth = {labels.file_name: labels for labels in stack.open().labels}
    costs = []
    made = _entry(name, constants)
    answers = measure_stack(stack, name, made, distances=False, frames=_kept_frames)
    for record in chain.from_iterable(records for _, _, records, _ in answers):
        labels, spot = truth[record.file_name], record.result
        if labels.visible_fraction >= VISIBLE_ENOUGH:
            size = spot.semi_minor_px if isinstance(spot, Spot) else math.inf
            # `fmin` takes the most for NaN, too.
            costs.append(float(np.fmin(abs(size - labels.half_max_semi_minor_px), _MOST_PX)))
    return costs
