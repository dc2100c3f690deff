"""Entries of a leaderboard: a folder with a spots file or folder for each estimator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field

from benchmarks.sets.score.spots_of_set import SPOTS_SUFFIXES
from estimator.files import in_utf8, object_in
from optics import InputError, Strict, in_file, read_text, validated

_ABOUT = "entry.json"
_Text = Annotated[str, Field(max_length=1000)]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An estimator whose spots are scored.

    Attributes:
        name: its name.
        spots: its spots file or folder, see `read_set_spots`; None if the images are measured in
            this run.
        command: the command that wrote the spots; empty if not stated.
        versions: versions of its software; empty if not stated.
        seed: its random seed; empty if it has none.
        ms_per_frame: its time per frame as stated, ms; None if not stated.
    """

    name: str
    spots: Path | None = None
    command: str = ""
    versions: str = ""
    seed: str = ""
    ms_per_frame: float | None = None


class _About(Strict):
    model_config = ConfigDict(extra="ignore")  # an entrant may say more

    name: _Text | None = None
    command: _Text = ""
    versions: dict[_Text, _Text] | _Text = ""
    seed: int | _Text | None = None
    ms_per_frame: Annotated[float, Field(ge=0.0)] | None = None


def entry_of(spots: Path) -> Entry:
    """The entry of a spots file or folder; a folder's entry.json may describe it.

    Raises:
        InputError: entry.json is damaged.
    """
    name = in_utf8(spots.stem if spots.suffix else spots.resolve().name)
    file = spots / _ABOUT
    if not file.is_file():
        return Entry(name=name, spots=spots)
    with in_file(file):
        about = validated(_About, object_in(read_text(file)), remedy="See docs/leaderboard.md.")
    versions = about.versions
    if not isinstance(versions, str):
        versions = ", ".join(f"{package} {version}" for package, version in versions.items())
    return Entry(
        name=about.name or name,
        spots=spots,
        command=about.command,
        versions=versions,
        seed="" if about.seed is None else str(about.seed),
        ms_per_frame=about.ms_per_frame,
    )


def entries_in(folder: Path) -> list[Entry]:
    """The entries in a folder, by name: each a folder, or a spots file.

    Raises:
        InputError: the folder is missing or has no entries.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder. Give the folder that contains the entries.")
    found = [
        entry_of(path)
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".")
        and (path.is_dir() or path.suffix.lower() in SPOTS_SUFFIXES)
    ]
    if not found:
        raise InputError(
            f"{folder} has no entries. An entry is a spots file, or a folder with spots files."
        )
    return found
