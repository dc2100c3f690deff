"""`eyespot error` and `eyespot.model_error`: how wrong each model is for a rig, in seconds.

From closed forms and the exact contour of a cone on a sphere, in NumPy: nothing is rendered, and
JAX, whose import alone takes as long, is not needed.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import matplotlib
import numpy as np
import pandas as pd
from cyclopts import Parameter
from cyclopts.types import PositiveFloat
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eyespot import optics
from eyespot.benchmarks import model_error as errors_of_models
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.model_error import error_limits, errors_of
from eyespot.benchmarks.workspace import azimuths_deg, geometry_of_rig, workspace_of
from eyespot.estimator.run.options import OUT, RigChanges
from eyespot.formats.rig import Rig, read_rig
from eyespot.formats.whole_files import written_whole

_ECCENTRICITIES = 129
"""They grow as squares, as errors do: a limit that is interpolated linearly between them errs by
(c_max / 2) / 128^2, which is 0.0002 mm at c_max = 8 mm."""
_FEWER = 8
"""One c of so many is enough for `exact`, which has no error to be interpolated."""
_DISTANCES = 12
_SHOWN_AZIMUTHS_DEG = (0.0, 90.0, 180.0)


def model_error(
    rig: Rig | Path | str | None = None,
    *,
    changes: Mapping[str, Any] | Sequence[str] = (),
    height: float | None = None,
    eye_radius: float | None = None,
    na: float | None = None,
    core_radius: float | None = None,
    tilt: float | None = None,
    medium: Literal["air", "water", "vitreous"] | None = None,
) -> pd.DataFrame:
    """Each model's error for a rig: over c, d, tilt and azimuth, on exact contours.

    The models are given the true c, r, pinhole and cone; `exact` also the beam's direction.

    Args:
        rig: the rig or its file; its [workspace] has the ranges.
        changes: values of the rig to change, such as {"workspace.distance_mm": [1, 4]}.
        height: of the microscope's pinhole above the eye's centre, mm.
        eye_radius: mm.
        na: numerical aperture of the light that leaves the fibre.
        core_radius: of the fibre's core, mm.
        tilt: the only angle between beam and wall, degrees.
        medium: between tip and wall.

    Returns:
        A row for each model, c, d, tilt and azimuth (0: towards larger c), mm and degrees; error =
        estimate - truth. `exact`, which is right to rounding here, has every eighth c.

    Raises:
        InputError: a number is missing, or the workspace is impossible.
    """
    stated = {
        "microscope.pinhole_height_mm": height,
        "wall.radius_mm": eye_radius,
        "beam.numerical_aperture": na,
        "instrument.core_radius_mm": core_radius,
        "workspace.tilt_deg": None if tilt is None else [tilt, tilt],
        "wall.medium": medium,
    }
    own = rig if isinstance(rig, Rig) else Rig() if rig is None else read_rig(rig)
    own = own.changed(changes).changed({key: v for key, v in stated.items() if v is not None})
    geometry = geometry_of_rig(own)
    space = workspace_of(own, geometry)
    low, high = space.eccentricity_mm or (0.0, 0.0)
    c = low + (high - low) * np.linspace(0.0, 1.0, _ECCENTRICITIES) ** 2
    c, d = np.meshgrid(c, np.linspace(*space.distance_mm, _DISTANCES), indexing="ij")
    few = c[::_FEWER].ravel(), d[::_FEWER].ravel()
    every = c.ravel(), d.ravel()
    tables = []
    for tilt_deg in dict.fromkeys(space.tilt_deg):
        for azimuth_deg in azimuths_deg(space) if tilt_deg else (0.0,):
            lean = {"incidence": tilt_deg, "incidence_azimuth": azimuth_deg}
            tilted = geometry._replace(**{name: math.radians(a) for name, a in lean.items()})
            for models, (at_c, at_d) in ((optics.CLOSED_FORMS, every), (("exact",), few)):
                tables.append(errors_of(tilted, models, c=at_c, d=at_d))
    return pd.concat(tables, ignore_index=True)


def error_figure(errors: pd.DataFrame, tolerance: float) -> Figure:
    """Largest error over d against c, of the square beam and of three directions of the tilt."""
    tilts = [tilt for tilt in errors.incidence_deg.unique() if tilt]
    shown = errors[errors.incidence_deg.isin([0.0, *tilts[-1:]])]
    pairs = shown[["incidence_deg", "azimuth_deg"]].drop_duplicates()
    chosen = pairs[(pairs.incidence_deg == 0) | pairs.azimuth_deg.isin(_SHOWN_AZIMUTHS_DEG)]
    if chosen.incidence_deg.eq(0).all() and tilts:
        chosen = pairs.iloc[[0, -1]].drop_duplicates()

    def draw(axes: Axes, _: str, panel: tuple[float, float]) -> None:
        here = page.where(shown, incidence_deg=panel[0], azimuth_deg=panel[1])
        errors_of_models.draw_largest_errors(axes, here, limits=(tolerance,))

    return page.small_multiples(
        draw,
        columns=[*chosen.itertuples(index=False, name=None)],
        title=lambda _, panel: view_name(*panel),
        x=errors_of_models.ECCENTRICITY,
        y="largest |error| (mm)",
        legend_columns=5,
        sharey=True,
    )


def view_name(tilt_deg: float, azimuth_deg: float) -> str:
    """A tilt and its direction in words; NaN is the worst direction."""
    if not tilt_deg:
        return "square"
    direction = "worst azimuth" if math.isnan(azimuth_deg) else f"azimuth {azimuth_deg:g}°"
    return f"tilt {tilt_deg:g}°, {direction}"


def limits_table(errors: pd.DataFrame, tolerance: float) -> pd.DataFrame:
    """Limits of c as texts: a row a model, a column for each of a few directions of the beam."""
    limits, end = error_limits(errors, tolerance), errors.c_mm.max()
    views = map(view_name, limits.incidence_deg, limits.azimuth_deg)
    texts = limits.c_mm.map(lambda c: f"> {end:.2f}" if math.isnan(c) else f"{c:.3f}")
    # The worst azimuth of a square beam is its only one.
    shown = limits.azimuth_deg.isin(_SHOWN_AZIMUTHS_DEG)
    shown |= limits.azimuth_deg.isna() & (limits.incidence_deg > 0)
    found = pd.DataFrame({"model": limits.model, "view": [*views], "c": texts})[shown]
    wide = found.pivot(index="model", columns="view", values="c")
    return wide.loc[[*optics.MODELS], [*dict.fromkeys(found.view)]]


def error(
    *,
    rig: Annotated[Path | None, Parameter(help="Rig file.")] = None,
    changes: RigChanges = (),
    height: float | None = None,
    eye_radius: PositiveFloat | None = None,
    na: PositiveFloat | None = None,
    core_radius: PositiveFloat | None = None,
    tilt: float | None = None,
    medium: Literal["air", "water", "vitreous"] | None = None,
    tolerance: PositiveFloat = 0.1,
    out: Annotated[Path, OUT] = Path("model-error.png"),
    overwrite: bool = False,
) -> None:
    """Say how wrong each model of the distance is for a rig, and up to which c to use it.

    Takes seconds, because nothing is rendered. Each number is a key of the rig file, too. An eye
    is a sphere here; `eyespot study eccentricity` also tries other shapes.

    Args:
        changes: Change a key of the rig file. Repeatable.
        height: Height of the microscope's pinhole above the eye's centre, mm; inf: telecentric.
        eye_radius: Radius of the eye, mm.
        na: Numerical aperture of the light that leaves the fibre.
        core_radius: Radius of the fibre's core, mm.
        tilt: Angle between the beam and the wall's normal, degrees.
        medium: Medium between tip and wall.
        tolerance: Largest error that is acceptable, mm.
        out: Figure to write (.png, .pdf or .svg).
        overwrite: Replace OUT if it exists.
    """
    from rich.console import Console
    from rich.table import Table

    with written_whole(out, replace=overwrite) as partial, matplotlib.rc_context(page.STYLE):
        errors = model_error(
            rig,
            changes=changes,
            height=height,
            eye_radius=eye_radius,
            na=na,
            core_radius=core_radius,
            tilt=tilt,
            medium=medium,
        )
        figure = error_figure(errors, tolerance)
        figure.savefig(partial, format=out.suffix.removeprefix(".") or "png")
    one, found = errors.iloc[0], limits_table(errors, tolerance)
    table = Table(title=f"Largest c, mm, up to which |error| stays below {tolerance:g} mm")
    table.add_column("model", no_wrap=True)
    for name in found.columns:
        table.add_column(name.replace(", ", "\n"), justify="right")
    for model, row in found.iterrows():
        table.add_row(str(model), *row)
    console = Console()
    console.print(
        f"Half-angle {one.half_angle_deg:.3f}°, b {one.apex_offset_mm:.3f} mm; pinhole at "
        f"{one.z_f_mm:g} mm, eye of {one.r_mm:g} mm; d from {errors.d_mm.min():g} to "
        f"{errors.d_mm.max():g} mm.",
        highlight=False,
    )
    console.print(table)
    console.print(
        "The models know c, r, the pinhole and the cone, and `exact` the beam's direction, too. "
        f"Azimuth 0°: the beam tilts towards larger c. Wrote {out}.",
        highlight=False,
    )
