"""The studies, each a function: `eyespot.studies.static(out="static", quick=True)`.

The arguments are the options of `eyespot study NAME`, and `progress=True` shows a bar. A study that
was stopped continues in the same folder. It returns its tables, its figures and its page.
"""

from __future__ import annotations

import functools
import inspect
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

from eyespot.benchmarks.studies.design import design as _design
from eyespot.benchmarks.studies.dynamic import dynamic as _dynamic
from eyespot.benchmarks.studies.eccentricity import eccentricity as _eccentricity
from eyespot.benchmarks.studies.eye import eye as _eye
from eyespot.benchmarks.studies.loop import loop as _loop
from eyespot.benchmarks.studies.map import map as _map
from eyespot.benchmarks.studies.medium import medium as _medium
from eyespot.benchmarks.studies.pose import pose as _pose
from eyespot.benchmarks.studies.sensors import sensors as _sensors
from eyespot.benchmarks.studies.static import static as _static
from eyespot.benchmarks.studies.table_one import table_one as _table_one
from eyespot.benchmarks.studies.validate import validate as _validate
from eyespot.estimator.run.progress_bar import quiet

if TYPE_CHECKING:
    import pandas as pd

P = ParamSpec("P")


@dataclass(frozen=True)
class Findings:
    """What a study has written into its folder."""

    folder: Path

    @property
    def page(self) -> Path:
        """The page with text, tables and figures."""
        return self.folder / "report.html"

    @property
    def summary(self) -> dict[str, Any]:
        """Claims, numbers, versions and times."""
        content: dict[str, Any] = json.loads((self.folder / "summary.json").read_text())
        return content

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables by the names of their CSV files."""
        import pandas as pd

        return {file.stem: pd.read_csv(file) for file in sorted(self.folder.glob("*.csv"))}

    @property
    def figures(self) -> dict[str, Path]:
        """The figures' files by name."""
        return {file.stem: file for file in sorted(self.folder.rglob("*.svg"))}


def _study(command: Callable[P, Any]) -> Callable[P, Findings]:
    @functools.wraps(command)
    def study(*args: P.args, **kwargs: P.kwargs) -> Findings:
        with quiet(bars=bool(kwargs.pop("progress", False))):
            command(*args, **kwargs)
        return Findings(Path(str(kwargs["out"])))

    of = inspect.signature(command)
    shown = inspect.Parameter("progress", inspect.Parameter.KEYWORD_ONLY, default=False)
    study.__signature__ = of.replace(parameters=[*of.parameters.values(), shown])  # type: ignore[attr-defined]
    return study


design = _study(_design)
dynamic = _study(_dynamic)
eccentricity = _study(_eccentricity)
eye = _study(_eye)
loop = _study(_loop)
map = _study(_map)
medium = _study(_medium)
pose = _study(_pose)
sensors = _study(_sensors)
static = _study(_static)
table_one = _study(_table_one)
validate = _study(_validate)
