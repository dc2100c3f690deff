"""The commands `eyespot rig init` and `eyespot rig check`."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from eyespot.estimator.run.options import OUT


def init(path: Path, /) -> None:
    """Write a rig file with every key, its default and its meaning.

    Args:
        path: The file to write; must not exist.
    """
    from eyespot.formats.rig import rig_template
    from eyespot.formats.whole_files import refuse_existing, write_text

    refuse_existing(path)
    write_text(path, rig_template())
    print(f"Wrote {path}. Fill in [microscope], [wall] and [robot].")
    print(f"Next: eyespot rig check {path} RECORDING --poses robot.csv")


def check(
    rig: Path,
    source: str,
    /,
    *,
    changes: Annotated[
        tuple[str, ...], Parameter("--set", metavar="KEY=VALUE", show_default=False)
    ] = (),
    poses: Path | None = None,
    fps: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
    out: Annotated[Path, OUT] = Path("rig-check.png"),
    overwrite: bool = False,
) -> None:
    """Compare a rig file with a recording: what is stated, what is found, what to do.

    Seconds, before a fit of minutes: times, poses, units, directions, contact, clipping, noise.
    The exit code is 1 if a line is wrong.

    Args:
        rig: Rig file.
        source: Recording, as of `eyespot track`.
        changes: Change a key of the rig file. Repeatable.
        poses: Robot's poses (CSV or bag; default: the recording's own).
        fps: Images a second, of a folder without frames.csv or of a TIFF.
        out: Picture to write (.png, .pdf or .svg).
        overwrite: Replace OUT if it exists.
    """
    from rich.console import Console
    from rich.table import Table

    from eyespot.estimator.recording import Recording
    from eyespot.estimator.run.rig_check import checked
    from eyespot.formats.whole_files import written_whole

    recording = Recording.open(source, rig=rig, changes=changes, poses=poses, fps=fps)
    with written_whole(out, replace=overwrite) as partial:
        found = checked(recording)
        found.figure().savefig(partial, format=out.suffix.removeprefix(".") or "png", dpi=110)
    table = Table(title=found.title)
    for name in found.lines.columns:
        table.add_column(name, overflow="fold", no_wrap=name in ("key", "verdict"))
    for row in found.lines.itertuples(index=False):
        table.add_row(*row)
    Console(markup=False).print(table)  # a key such as [robot] is no markup
    wrong = int((found.lines.verdict == "wrong").sum())
    lines = "line is" if wrong == 1 else "lines are"
    said = f"{wrong} {lines} wrong." if wrong else "Nothing contradicts the rig file."
    print(f"{said} Wrote {out}.")
    sys.exit(int(wrong > 0))
