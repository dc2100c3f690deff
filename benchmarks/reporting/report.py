"""The parts of a report: claims, sections with tables and pictures, CSV files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from matplotlib.figure import Figure

from benchmarks.reporting.claims import Claim
from benchmarks.reporting.tables import Table


class Picture(NamedTuple):
    """A figure of the report; written as figures/NAME.png and .svg.

    Attributes:
        name: name of its files.
        figure: the drawing.
        caption: description; "z_F" and "d_r" get their subscripts.
        data: CSV file with the data.
        inline: format in the page; frames with a camera's noise are ten times smaller as JPEG.
    """

    name: str
    figure: Figure
    caption: str
    data: str = ""
    inline: Literal["svg", "jpeg"] = "svg"


class Section:
    """A heading with paragraphs, tables and pictures below it, in order."""

    def __init__(self, title: str, *parts: str | Table | Picture) -> None:
        self.title, self.parts = title, parts


class Data(NamedTuple):
    """A CSV file.

    Attributes:
        name: name of the file.
        row_type: NamedTuple whose fields are the columns, with units.
        rows: rows of that type.
    """

    name: str
    row_type: type[Any]
    rows: Iterable[Any]


@dataclass(frozen=True, kw_only=True)
class Report:
    """The report of a study.

    Attributes:
        title: the question.
        lead: the method, in a sentence or two.
        claims: the answers, computed in this run.
        sections: the evidence.
        data: CSV files to write; a name alone is a file that the study has already written.
        summary: further entries of summary.json.
    """

    title: str
    lead: str
    claims: Sequence[Claim]
    sections: Sequence[Section]
    data: Sequence[Data | str] = ()
    summary: Mapping[str, Any] = field(default_factory=dict)

    @property
    def pictures(self) -> list[Picture]:
        """The pictures of all sections."""
        return [p for section in self.sections for p in section.parts if isinstance(p, Picture)]
