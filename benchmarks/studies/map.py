"""`eyespot study map`: over the workspace of a rig, how far each model errs, by cause.

Exact contours and first-order uncertainties (`rig_uncertainty`); nothing is rendered.
"""

import math
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from cyclopts.types import PositiveFloat
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import ndtri

from eyespot import optics
from eyespot.benchmarks import reporting as page
from eyespot.benchmarks.model_error import ECCENTRICITY, Geometry
from eyespot.benchmarks.reporting import number
from eyespot.benchmarks.rig_uncertainty import NOISE_PX, UNTOLD, errors_at
from eyespot.benchmarks.statistics import first_reached, rms
from eyespot.benchmarks.study import Study, geometry_of
from eyespot.benchmarks.study_command import command
from eyespot.benchmarks.workspace import azimuths_deg, calibrated_cone
from eyespot.formats.calibration import read_calibration
from eyespot.formats.rig import Rig
from eyespot.formats.rig_keys import WorkspaceKeys

_SAME_CONTOUR = 3.84
"""Chi squared of the mirrored pose below which the contour does not refuse it, at 95 %."""
_NORMAL = ndtri((np.arange(200) + 0.5) / 200)
"""Evenly probable values of a standard normal variable."""


def mapped(
    geometry: Geometry,
    space: WorkspaceKeys,
    rig: Rig,
    cone: np.ndarray | None,
    *,
    quick: bool,
) -> pd.DataFrame:
    """`errors_at` over the workspace, with the combined sigma and the largest |error| at 95 %."""
    low, high = space.eccentricity_mm or (0.0, 0.0)
    c_count, d_count, tilt_count = (7, 3, 3) if quick else (17, 6, 4)
    places = np.linspace(low, high, c_count), np.linspace(*space.distance_mm, d_count)
    c, d = (axis.ravel() for axis in np.meshgrid(*places))
    tables = []
    for tilt in np.unique(np.linspace(*space.tilt_deg, tilt_count)):
        for azimuth in azimuths_deg(space)[:: 3 if quick else 2] if tilt else (0.0,):
            lean = {"incidence": math.radians(tilt), "incidence_azimuth": math.radians(azimuth)}
            own = geometry._replace(**lean)
            tables.append(errors_at(own, rig, cone, c=c, d=d))
    found = pd.concat(tables, ignore_index=True)
    found = found.assign(sigma_mm=np.sqrt((found[causes_of(found)] ** 2).sum(axis=1)))
    return found.assign(at_95_mm=np.quantile(np.abs(drawn(found)), 0.95, axis=1))


def causes_of(errors: pd.DataFrame) -> list[str]:
    """The columns with standard deviations by cause."""
    about = {"c_mm", "d_mm", "bias_mm", "sigma_mm", "at_95_mm"}
    return [f"{name}" for name in errors.columns if f"{name}".endswith("_mm") and name not in about]


def drawn(errors: pd.DataFrame) -> np.ndarray:
    """Evenly probable errors at each place, mm: rows x 200."""
    return errors.bias_mm.to_numpy()[:, None] + errors.sigma_mm.to_numpy()[:, None] * _NORMAL


# What one contour does not say: the mirrored pose.


def ambiguity(
    geometry: Geometry, space: WorkspaceKeys, *, sigma_rad: float, quick: bool
) -> pd.DataFrame:
    """By tilt: the share of poses whose mirror image the contour does not refuse, and the robot.

    Columns: tilt; the share of ambiguous poses from the contour alone and with the robot's axis;
    how far the two tips are apart, mm.
    """
    low, high = space.eccentricity_mm or (0.0, 0.0)
    c = np.linspace(low, high, 3 if quick else 5)
    azimuths, d = azimuths_deg(space)[:: 3 if quick else 2], float(np.mean(space.distance_mm))
    rows = []
    for tilt in np.unique(np.linspace(*space.tilt_deg, 3 if quick else 6)):
        if tilt == 0:
            continue  # the mirror image is the pose itself
        places = jnp.asarray([*product(c, np.radians(azimuths))])
        alone, told, apart = _mirrors(geometry, places, d, math.radians(tilt), sigma_rad)
        rows.append((tilt, *(float(np.mean(cost < _SAME_CONTOUR)) for cost in (alone, told))))
        rows[-1] += (float(np.median(apart)),)
    return pd.DataFrame(rows, columns=["tilt_deg", "contour_alone", "with_axis", "tips_apart_mm"])


@jax.jit
def _mirrors(
    geometry: Geometry, places: jax.Array, d: float, tilt: float, sigma: float
) -> tuple[jax.Array, jax.Array, jax.Array]:
    wall, camera = geometry.world
    cone: dict[str, Any] = {
        "half_angle": geometry.half_angle,
        "apex_offset": geometry.apex_offset,
    }

    def of(place: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        lean: dict[str, Any] = {"incidence": tilt, "incidence_azimuth": place[1]}
        beam = optics.beam_at_spot(wall, eccentricity=place[0], distance=d, **lean, **cone)
        contour = optics.spot_contour(beam, wall, camera)
        known: dict[str, Any] = {"sigma_px": NOISE_PX, **cone}
        prior = optics.DirectionPrior(beam.axis, sigma)
        alone = optics.pose_from_contour(contour, wall, camera, **known)
        told = optics.pose_from_contour(contour, wall, camera, **known, prior=prior)
        apart = jnp.linalg.norm(alone.best.tip - alone.mirror.tip)
        return alone.mirror.cost, told.mirror.cost, apart

    return jax.lax.map(of, places)


# Tables, figures, page.


def f2554(errors: pd.DataFrame) -> pd.DataFrame:
    """Errors of each model over the workspace, in the form of ASTM F2554, mm."""
    rows = []
    for model, own in page.grouped(errors, "model"):
        each, size = drawn(own), np.abs(drawn(own))
        rows.append((model, each.mean(), each.std(), np.quantile(size, 0.95), size.max()))
    names = ["mean_mm", "standard_deviation_mm", "at_95_mm", "largest_mm"]
    return pd.DataFrame(rows, columns=["model", *names])


def limits(errors: pd.DataFrame, tolerance: float) -> pd.DataFrame:
    """c at which the largest |error| at 95 % over d, tilt and azimuth reaches the tolerance, mm."""
    rows = []
    for model, own in page.grouped(errors, "model"):
        worst = own.groupby(own.c_mm.round(9)).at_95_mm.max()
        rows.append((model, first_reached(worst.index, worst, tolerance)))
    return pd.DataFrame(rows, columns=["model", "c_mm"])


_SHOWN = ("small_plane", "corrected", "exact", UNTOLD)


def _heat(errors: pd.DataFrame, tolerance: float) -> Figure:
    """Largest |error| at 95 % over c and tilt."""
    shown = errors[errors.model.isin(_SHOWN)].groupby(["c_mm", "tilt_deg", "model"]).at_95_mm.max()
    least = float(np.log10(shown.min()))
    top = float(np.log10(max(errors.at_95_mm.max(), 2 * tolerance)))

    def draw(axes: Axes, _: str, model: str) -> None:
        own = errors[errors.model == model]
        grid = own.pivot_table(index="tilt_deg", columns="c_mm", values="at_95_mm", aggfunc="max")
        levels = np.linspace(least, top, 12)
        shown = np.log10(np.maximum(grid, 10 ** levels[0]))
        if min(grid.shape) < 2:
            axes.plot(grid.columns, grid.iloc[0], color=page.BLUE)
            return
        axes.contourf(grid.columns, grid.index, shown, levels=levels, cmap="cividis")
        if grid.to_numpy().min() < tolerance < grid.to_numpy().max():
            axes.contour(grid.columns, grid.index, grid, levels=[tolerance], colors="white")
        axes.grid(visible=False)

    return page.small_multiples(
        draw,
        columns=_SHOWN,
        x=ECCENTRICITY,
        y="tilt (°)",
        legend_columns=0,
        sharey=True,
    )


def _report(
    errors: pd.DataFrame, mirrored: pd.DataFrame, space: WorkspaceKeys, tolerance: float
) -> page.Report:
    limit, summary = limits(errors, tolerance), f2554(errors)
    reached = dict(zip(limit.model, limit.c_mm, strict=True))
    causes = ["bias_mm", *causes_of(errors)]
    by_cause = errors.groupby("model", sort=False)[causes].agg(rms).reset_index()
    told = " to ".join(f"{end:g}" for end in space.tilt_deg)
    end = number(errors.c_mm.max())

    def up_to(model: str) -> str:
        c = reached[model]
        if math.isnan(c):
            return f"beyond {end} mm"
        return f"up to c = {number(c)} mm" if c > 0 else "nowhere"

    return page.Report(
        title="Where in the workspace can which model be trusted?",
        answer=f"At 95 %, |error| stays below {tolerance:g} mm {up_to('small_plane')} with "
        f"small_plane, {up_to('corrected')} with corrected, {up_to(UNTOLD)} with the exact "
        f"geometry alone, and {up_to('exact')} if the robot reports the beam's axis.",
        lead="Exact contours of a cone in a spherical eye, read with what the rig states and its "
        f"standard uncertainties, which are taken as independent; c to {end} mm, d from "
        f"{space.distance_mm[0]:g} to {space.distance_mm[1]:g} mm, tilts from {told}°. Nothing is "
        "rendered: texture, how a lens's light differs from its effective cone, and an eye that "
        "is no sphere are not in it.",
        first=[
            page.Picture(
                "map",
                _heat(errors, tolerance),
                "Dark is good: largest |error| at 95 % over d and azimuth, up to "
                f"{number(errors.at_95_mm.max())} mm (yellow), on a logarithmic scale. White line: "
                f"{tolerance:g} mm.",
                data="map.csv",
            ),
            page.Table(
                summary.assign(limit_mm=limit.c_mm),
                {
                    "model": page.Column("model"),
                    "mean_mm": page.Column("mean, mm"),
                    "standard_deviation_mm": page.Column("standard deviation, mm"),
                    "at_95_mm": page.Column("95 %, mm"),
                    "largest_mm": page.Column("largest, mm"),
                    "limit_mm": page.Column("limit of c, mm", 2),
                },
                "Errors over the workspace, all places alike, in the form of ASTM F2554; and the c "
                f"up to which |error| stays below {tolerance:g} mm at 95 % (a dash: everywhere).",
                data="summary.csv",
            ),
        ],
        claims=list(_claims(errors, mirrored)),
        sections=[
            page.Section(
                "By cause",
                page.Table(
                    by_cause,
                    ["model", *causes],
                    "Root mean square over the workspace, mm: the model's own bias, and the "
                    f"standard deviation by cause. Image: {NOISE_PX:g} px across each of 128 "
                    "points. Axis: the robot's, or the directions that the beam may have.",
                    data="causes.csv",
                ),
            ),
            page.Section(
                "Two poses for one contour",
                page.Table(
                    mirrored,
                    ["tilt_deg", "contour_alone", "with_axis", "tips_apart_mm"],
                    "Share of places where the mirrored pose explains the contour as well (at "
                    "95 %), without and with the robot's axis, and the median distance of the two "
                    "tips. Both poses have nearly the same d.",
                    data="ambiguous.csv",
                ),
            ),
        ],
        data={
            "map.csv": errors,
            "summary.csv": summary,
            "limits.csv": limit,
            "causes.csv": by_cause,
            "ambiguous.csv": mirrored,
        },
    )


def _claims(errors: pd.DataFrame, mirrored: pd.DataFrame) -> Iterator[page.Claim]:
    bias = float(errors[errors.model == "exact"].bias_mm.abs().max())
    yield page.Claim(
        name="exact, bias",
        sentence=f"With the axis known the exact geometry errs by {bias:.1e} mm at most.",
        value=bias,
        high=1e-6,
    )
    if len(mirrored):
        alone, told = (100 * mirrored[name].mean() for name in ("contour_alone", "with_axis"))
        yield page.Claim(
            name="ambiguous poses",
            sentence=f"{alone:.0f} % of the poses have a mirror image with the same contour; the "
            f"robot's axis leaves {told:.0f} %.",
            value=told,
        )


VARIED = (
    *("spot.eccentricity_mm", "spot.azimuth_deg", "spot.incidence_azimuth_deg", "motion"),
    *("exposures", "camera", "source.power_mw", "phantom.coat", "phantom.texture_seed"),
    "rig_errors",
    *("instrument.gauge", "instrument.visible", "instrument.fibre_length_mm"),
    *("microscope.width_px", "microscope.height_px", "microscope.samples"),
    *("microscope.window_offset_px", "microscope.illumination_mw_mm2", "microscope.vignetting"),
    "microscope.numerical_aperture",
)
"""Keys of the scene that have no part in the study."""


@command(
    defaults=("source.kind=cone",),
    varies=VARIED,
    in_workspace=True,
    check_options=lambda calibration, **others: calibration and read_calibration(calibration),
)
def map(
    study: Study, *, calibration: Path | None = None, tolerance: PositiveFloat = 0.1
) -> dict[str, pd.DataFrame]:
    """Say where in a rig's workspace which model can be trusted, and what limits it.

    Exact contours only; nothing is rendered.

    Args:
        calibration: Calibration file of the beam; a lens counts as its effective cone.
        tolerance: Largest error that is acceptable at 95 %, mm.
    """
    geometry, own = geometry_of(study.scene), study.rig or Rig()
    geometry = geometry._replace(incidence=0.0, incidence_azimuth=0.0)
    covariance = None
    if calibration is not None:
        half_angle, b, covariance = calibrated_cone(read_calibration(calibration))
        geometry = geometry._replace(half_angle=half_angle, apex_offset=b)
    with study.timed("errors"):
        errors = mapped(geometry, study.space, own, covariance, quick=study.quick)
    with study.timed("mirrored poses"):
        sigma = math.radians(own.robot.axis_sigma_deg)
        mirrored = ambiguity(geometry, study.space, sigma_rad=sigma, quick=study.quick)
    study.publish(_report, errors, mirrored, study.space, tolerance)
    return {"map": errors, "ambiguous": mirrored}
