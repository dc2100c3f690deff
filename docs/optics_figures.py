"""Draws the figures of docs/optics.md: `python docs/optics_figures.py`."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm, LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from PIL import Image

import optics
from benchmarks.model_error import MODEL_COLOURS, Geometry, estimates
from benchmarks.reporting import BLACK, BLUE, GREY, ORANGE, SKY, STYLE, VERMILION

_FOLDER = Path(__file__).resolve().parent / "optics"
_WIDTH_IN = 8.0
_MEDIA = {medium: optics.MEDIA[medium] for medium in ("air", "vitreous")}
_EYE, _K, _APEX = 11.5, 20.0, -5.117
_CONE: dict[str, Any] = {"half_angle": float(np.arctan(1.0 / _K)), "apex_offset": _APEX}
_CONE_TEXT = f"$k$ {_K:g}, $b$ −{-_APEX:g} mm, eye radius {_EYE:g} mm"

_REACH, _BROAD = 6.0, 1.4  # extent of the pictures of a beam along and across the axis, mm
_PROFILES_AT = (1.0, 3.0, 5.0)  # mm
_NEAREST, _FITTED_FROM = 0.02, 0.5  # mm
_LEVELS = 25  # number of colours of a map; odd, so that zero has its own colour
_AMBIGUOUS = "#F2E6D0"

_HEIGHTS = {"the eyeball's centre": 0.0, "on the sphere": _EYE, "a microscope": 200.0}
_SPOT_AT, _LARGEST_C, _SCALE = 2.0, 6.0, 0.0067  # d and c, mm; mm/px
_MODEL_LINES: dict[str, tuple[str, Any]] = {
    "planar": (ORANGE, "-"),
    "small_plane": (MODEL_COLOURS["small_plane"], "-"),
    "corrected": (MODEL_COLOURS["corrected"], "-"),
    # Dashed, so that lines below remain visible.
    "stereographic": (MODEL_COLOURS["stereographic"], (0, (4, 3))),
    "exact": (MODEL_COLOURS["exact"], (0, (1, 3))),
}

_POSE: dict[str, float] = {"distance": 4.0, "eccentricity": 3.0}
_NOISE_PX, _POSE_SCALE, _POINTS = 0.05, 0.0065, 128  # px, mm/px, points of the contour

Tables = dict[tuple[str, str], optics.IrradianceTable]
"""Tables by lens and medium."""


def main() -> None:
    """Draw every figure into docs/optics."""
    lenses = _lenses()
    tables = {
        (lens, medium): optics.irradiance_table(lenses[lens], medium_index=index)
        for lens in lenses
        for medium, index in _MEDIA.items()
    }
    drawings: dict[str, Callable[[], Figure]] = {
        "lenses": partial(beams, lenses, tables),
        "vector_irradiance": partial(vector_irradiance, "dome", tables),
        "pinholes": pinholes,
        "observability": observability,
    }
    _FOLDER.mkdir(exist_ok=True)
    with matplotlib.rc_context(STYLE):
        for name, draw in drawings.items():
            _save(draw(), _FOLDER / f"{name}.png")


def _save(figure: Figure, path: Path) -> None:
    """Write a PNG with 256 colours, which has a third of the size."""
    buffer = io.BytesIO()
    figure.savefig(buffer)
    partial_path = path.with_suffix(".partial")
    image = Image.open(buffer).convert("RGB")
    image = image.quantize(method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    image.save(partial_path, format="PNG", optimize=True)
    os.replace(partial_path, path)
    print(f"{path}  {path.stat().st_size / 1e3:.0f} kB")


def _lenses() -> dict[str, optics.GlueLens]:
    """The two presets, and a flat end with the aperture of `dome`."""
    dome = optics.load_lens("dome")
    flat = optics.glue_lens(
        core_radius=dome.core_radius,
        glue_length=0.0,
        aperture_radius=dome.aperture_radius,
        sag=0.0,
        glue_index=dome.glue_index,
        numerical_aperture=dome.numerical_aperture,
    )
    return {"paper-candidate": optics.load_lens("paper-candidate"), "flat end": flat, "dome": dome}


def beams(lenses: dict[str, optics.GlueLens], tables: Tables) -> Figure:
    """Meridional rays and half-maximum radius of each lens in each medium."""
    cone_label = f"cone $d = kR + b$ fitted to it from {_FITTED_FROM:g} to {_REACH:g} mm"
    figure = Figure(figsize=(_WIDTH_IN, 6.0), layout="constrained")
    grid = figure.subplots(len(_MEDIA), len(lenses), sharex=True, sharey=True)
    for axes_row, medium in zip(grid, _MEDIA, strict=True):
        for axes, (name, lens) in zip(axes_row, lenses.items(), strict=True):
            table = tables[name, medium]
            _draw_rays(axes, lens, medium_index=_MEDIA[medium])
            _draw_profiles(axes, table)
            cone = _draw_half_maximum(axes, table)
            b = f"{cone.b:+.2f}".replace("-", "−")
            axes.set_title(
                f"{name} in {medium}\n"
                f"sag {lens.sag:g} mm, NA {lens.numerical_aperture:.2f}\n"
                f"$k$ {cone.k:.1f}, $b$ {b} mm, $R^2$ {cone.r_squared:.3f}"
            )
            axes.set(xlim=(-0.5, _REACH), ylim=(-_BROAD, _BROAD))
            axes.grid(visible=False)
        axes_row[0].set_ylabel("distance from the axis (mm)")
    for axes in grid[-1]:
        axes.set_xlabel("$s$, distance from the tip (mm)")
    figure.legend(
        handles=[
            Line2D([], [], color=SKY, label="rays in a meridian plane"),
            Line2D([], [], color=BLACK, lw=0.9, label="irradiance across, over its peak"),
            Line2D([], [], color=VERMILION, lw=2, label="half-maximum radius"),
            Line2D([], [], color=VERMILION, lw=1, ls="--", label=cone_label),
            Patch(color=_AMBIGUOUS, label="one radius, several distances"),
        ],
        loc="outside lower center",
        ncols=2,
    )
    return figure


def _draw_rays(axes: Axes, lens: optics.GlueLens, *, medium_index: float) -> None:
    height, sine = np.meshgrid(
        0.96 * float(lens.face_radius) * np.linspace(-1.0, 1.0, 5),
        float(lens.sine_limit) * np.linspace(-1.0, 1.0, 5),
    )
    across = np.zeros_like(height)
    rays = optics.emitted_rays(
        lens,
        medium_index=medium_index,
        points=jnp.asarray(np.stack([height, across], axis=-1)),
        directions=jnp.asarray(np.stack([sine, across], axis=-1)),
    )
    passed = np.asarray(rays.status) == optics.TRANSMITTED
    leaves, direction = (np.asarray(x)[passed] for x in (rays.point, rays.direction))
    start = np.column_stack([np.full(passed.sum(), -float(lens.glue_length)), height[passed]])
    cap = leaves[:, [2, 0]]
    slope = direction[:, 0] / direction[:, 2]
    end = np.column_stack([np.full(len(cap), _REACH), cap[:, 1] + slope * (_REACH - cap[:, 0])])
    path = np.stack([start, cap, end])
    axes.plot(path[..., 0], path[..., 1], color=SKY, lw=0.6)
    rim = float(lens.aperture_radius)
    rho = np.linspace(-rim, rim, 101)
    face = np.full_like(rho, -float(lens.glue_length))
    axes.fill_betweenx(rho, -1.0, face, color=GREY, lw=0)
    axes.fill_betweenx(rho, face, -np.asarray(lens.sagitta(rho)), color=ORANGE, lw=0)


def _draw_profiles(axes: Axes, table: optics.IrradianceTable) -> None:
    for distance in _PROFILES_AT:
        rho = np.linspace(-_BROAD, _BROAD, 501)
        light = np.asarray(table(radius=np.abs(rho), distance=distance)[1])
        share = light / light.max()
        lit = share > 0.005
        axes.plot(distance + 0.8 * share[lit], rho[lit], color=BLACK, lw=0.9)


def _draw_half_maximum(axes: Axes, table: optics.IrradianceTable) -> optics.EffectiveCone:
    """Half-maximum radius, the ranges in which it is ambiguous, and the fitted cone."""
    distance = np.linspace(_NEAREST, _REACH, 400)
    radius = np.asarray(optics.half_maximum_radius(table, distance=distance))
    cone = optics.effective_cone(table, from_distance=_FITTED_FROM, to_distance=_REACH)
    for side in (-1, 1):
        axes.plot(distance, side * radius, color=VERMILION, lw=2)
        axes.plot(distance, side * (distance - cone.b) / cone.k, color=VERMILION, lw=1, ls="--")
    for ends in optics.ambiguous_distances(table, from_distance=_NEAREST, to_distance=_REACH):
        axes.axvspan(*ends, color=_AMBIGUOUS, lw=0, zorder=0)
    return cone


def vector_irradiance(lens: str, tables: Tables) -> Figure:
    """V_s and V_rho of one lens on the table's grid, and V_s in mm; one column per medium."""
    figure = Figure(figsize=(_WIDTH_IN, 8.6), layout="constrained")
    grid = figure.subplots(3, len(_MEDIA), sharex="row", sharey="row")
    unit = (0.0, 1.0, 0.0, 1.0)
    for (own, own_radial, in_mm), medium in zip(grid.T, _MEDIA, strict=True):
        table = tables[lens, medium]
        radial, axial = np.moveaxis(np.asarray(table.values), -1, 0)
        norm: Normalize = PowerNorm(0.5, 0.0)  # both bell and focus remain visible
        _draw_map(own, axial, unit, norm, "cividis", "$V_s\\,e(s)^2$, no unit")
        _draw_map(own_radial, radial, unit, CenteredNorm(), "PuOr", "$V_\\rho\\,e(s)^2$, no unit")
        for axes, part in ((own, "s"), (own_radial, "\\rho")):
            axes.set(title=f"{lens} in {medium}: $V_{part}$, the table", xlabel="$x = \\rho/e(s)$")
            ticks = np.array([0.01, 0.1, 1.0, 10.0])
            y = np.log(ticks / table.nearest) / np.log(table.farthest / table.nearest)
            axes.set_yticks(y, [f"{s:g}" for s in ticks])
        _draw_isophotes(own, axial, unit, peak_over=1)

        extent = (_NEAREST, _REACH, 0.0, _BROAD)
        s, rho = np.linspace(*extent[:2], 400), np.linspace(*extent[2:], 400)
        light = np.asarray(table(radius=rho[:, None], distance=s)[1])
        norm = LogNorm(1e-2, 10.0, clip=True)
        _draw_map(in_mm, light, extent, norm, "cividis", "$V_s$ of unit power (1/mm²)")
        _draw_isophotes(in_mm, light, extent, peak_over=0)
        in_mm.set(title=f"{lens} in {medium}: $V_s$", xlabel="$s$, distance from the tip (mm)")
        in_mm.set_xlim(left=0.0)
    for axes in grid[:2, 0]:
        axes.set_ylabel("$s$, distance from the tip (mm)")
    grid[2, 0].set_ylabel("$\\rho$, distance from the axis (mm)")
    figure.legend(
        handles=[
            Line2D([], [], color="white", lw=1.4, label="half of the peak at that $s$"),
            Line2D([], [], color="white", lw=1.0, ls="--", label="10 % of it"),
        ],
        loc="outside lower center",
        ncols=2,
        facecolor="#00204D",
        labelcolor="white",
        frameon=True,
        framealpha=1.0,
    )
    return figure


Extent = tuple[float, float, float, float]


def _draw_map(
    axes: Axes, values: np.ndarray, extent: Extent, norm: Normalize, colours: str, label: str
) -> None:
    levels = matplotlib.colormaps[colours].resampled(_LEVELS)
    image = axes.imshow(
        values, origin="lower", extent=extent, aspect="auto", norm=norm, cmap=levels
    )
    axes.grid(visible=False)
    axes.figure.colorbar(image, ax=axes, label=label)


def _draw_isophotes(axes: Axes, light: np.ndarray, extent: Extent, *, peak_over: int) -> None:
    """Contours at 50 and 10 % of the peak along an axis of the array."""
    axes.contour(
        light / light.max(axis=peak_over, keepdims=True),
        levels=[0.1, 0.5],
        extent=extent,
        colors="white",
        linestyles=["--", "-"],
        linewidths=[1.0, 1.4],
    )


def pinholes() -> Figure:
    """Error of each model against c for three pinholes, below sketches of the geometry."""
    figure = Figure(figsize=(_WIDTH_IN, 6.4), layout="constrained")
    figure.suptitle(f"$d$ = {_SPOT_AT:g} mm, square incidence, {_CONE_TEXT}", fontsize=9)
    sketches, panels = figure.subplots(2, len(_HEIGHTS), height_ratios=(1.0, 1.3), sharey="row")
    for sketch, axes, (place, height) in zip(sketches, panels, _HEIGHTS.items(), strict=True):
        _sketch(sketch, height)
        sketch.set_title(f"$z_F$ = {height:g} mm: {place}", loc="center")
        c = np.linspace(0.0, _LARGEST_C, 61)
        for model, error in _square_errors(height, c).items():
            label = f"{model}: {round(np.max(np.abs(error)), 6):.2g} mm"
            colour, dashes = _MODEL_LINES[model]
            axes.plot(c, error, color=colour, ls=dashes, label=label)
        axes.set_xlabel("eccentricity $c$ (mm)")
        axes.legend(loc="lower left", title="largest |error|", alignment="left")
    panels[0].set_ylabel("estimate − $d$ (mm)")
    return figure


def _square_errors(height: float, c: np.ndarray) -> dict[str, np.ndarray]:
    """Error (estimate - d) of every model, mm, for the closed-form image at square incidence."""
    geometry = Geometry(_SCALE, height, _EYE, **_CONE, incidence=0.0, incidence_azimuth=0.0)
    axes_px = optics.square_spot_axes(
        spot_radius=optics.square_spot_radius(distance=_SPOT_AT, k=_K, b=_APEX, eye_radius=_EYE),
        eccentricity=c,
        eye_radius=_EYE,
        scale=_SCALE,
        inverse_working_distance=1.0 / (height + _EYE),
    )
    seen = np.minimum(*map(np.asarray, axes_px))
    planar = optics.planar_distance(semi_minor_px=seen, scale=_SCALE, k=_K, b=_APEX)
    found = {"planar": planar, **estimates(geometry, c=c, semi_minor_px=seen)}
    return {model: np.asarray(found[model]) - _SPOT_AT for model in optics.MODELS}


def _sketch(axes: Axes, height: float) -> None:
    """Section through the eyeball with beam, spot and lines of sight to its edge, to scale."""
    wall = optics.Sphere(_EYE)
    beam = optics.beam_at_spot(wall, distance=_SPOT_AT, eccentricity=_LARGEST_C, **_CONE)
    edge = np.asarray(optics.cone_contour(beam, wall).point)
    edge = edge[[np.argmin(edge[:, 0]), np.argmax(edge[:, 0])]][:, [0, 2]]
    spot = np.asarray(beam.spot(wall).point)[[0, 2]]
    tip = np.asarray(beam.tip)[[0, 2]]
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    axes.plot(_EYE * np.sin(turn), _EYE * np.cos(turn), color=BLACK, lw=1)
    axes.axvline(0.0, color=GREY, lw=0.6, ls="-.")
    for x, z in edge:
        axes.plot([x, 0.0], [z, height], color=BLUE, lw=0.8)
    axes.plot(*zip(tip, spot, strict=True), color=ORANGE, lw=1.5)
    axes.plot(*edge.T, color=VERMILION, lw=3, solid_capstyle="butt")
    axes.plot(0.0, height, "o", color=BLUE, ms=5)
    if height < 2.0 * _EYE:
        axes.text(-1.0, height, "F", color=BLUE, ha="right", va="bottom")
    else:
        axes.text(7.0, 13.0, "to F", color=BLUE, va="center")
    axes.text(tip[0] - 0.5, tip[1], "tip", color=ORANGE, ha="right")
    axes.text(spot[0] + 0.9, spot[1] - 0.9, "spot", color=VERMILION, va="center")
    axes.set(aspect="equal", xlim=(-13, 13), ylim=(-12.5, 14.5))
    axes.axis("off")


class Accuracy(NamedTuple):
    """Standard errors of a pose, and the misfit of the mirror solution."""

    tip_um: jax.Array
    distance_um: jax.Array
    axis_deg: jax.Array
    known_tip_um: jax.Array
    known_distance_um: jax.Array
    mirror_misfit_px: jax.Array


def observability() -> Figure:
    """Standard errors of the pose and misfit of the mirror solution, against incidence."""
    figure = Figure(figsize=(_WIDTH_IN, 4.2), layout="constrained")
    figure.suptitle(
        f"$d$ = {_POSE['distance']:g} mm, $c$ = {_POSE['eccentricity']:g} mm, {_CONE_TEXT}; "
        f"{_POINTS} points, {_NOISE_PX:g} px noise, {1e3 * _POSE_SCALE:g} µm/px",
        fontsize=9,
    )
    lengths, directions, mirrors = panels = figure.subplots(1, 3)
    heights, incidence_deg = np.array([_EYE, 200.0]), np.linspace(0.5, 40.0, 80)
    over_both = jax.jit(jax.vmap(jax.vmap(_accuracy, (None, 0)), (0, None)))
    found: Accuracy = over_both(heights, np.radians(incidence_deg))
    for axes, values, colour, dashes, label in (
        (lengths, found.tip_um, BLUE, "-", "tip, in space"),
        (lengths, found.distance_um, ORANGE, "-", "distance $d$"),
        # Interleaved dashes, because the two coincide.
        (lengths, found.known_tip_um, BLUE, (0, (3, 3)), "tip, axis known"),
        (lengths, found.known_distance_um, ORANGE, (3, (3, 3)), "$d$, axis known"),
        (directions, found.axis_deg, BLUE, "-", "axis"),
        (mirrors, found.mirror_misfit_px, VERMILION, "-", "mirror solution"),
    ):
        on_sphere, above = np.asarray(values)
        axes.plot(incidence_deg, on_sphere, color=colour, ls=dashes, label=label)
        axes.plot(incidence_deg[9::10], above[9::10], "o", color=colour, mfc="none", ms=4)
    mirrors.axhline(_NOISE_PX, color=GREY, lw=1, ls=":", label="noise of a point")
    lengths.set(ylabel="standard error (µm)", title="tip and distance")
    directions.set(ylabel="standard error (deg)", title="direction of the axis")
    mirrors.set(ylabel="root mean square misfit (px)", title="mirror solution")
    for axes in panels:
        axes.set(yscale="log", xlabel="incidence (deg)", xlim=(0.0, 41.0))
    lengths.legend()
    mirrors.legend()
    figure.legend(
        handles=[
            Line2D([], [], color=BLACK, label=f"$z_F$ = {heights[0]:g} mm"),
            Line2D(
                [],
                [],
                color=BLACK,
                ls="",
                marker="o",
                mfc="none",
                ms=4,
                label=f"$z_F$ = {heights[1]:g} mm",
            ),
        ],
        loc="outside lower center",
        ncols=2,
    )
    return figure


def _accuracy(height: jax.Array, incidence: jax.Array) -> Accuracy:
    wall = optics.Sphere(_EYE)
    camera = optics.microscope(scale=_POSE_SCALE, pinhole_height=height, eye_radius=_EYE)
    true = optics.beam_at_spot(wall, incidence=incidence, **_POSE, **_CONE)
    contour = optics.spot_contour(true, wall, camera, points=_POINTS)
    free = optics.pose_from_contour(contour, wall, camera, sigma_px=_NOISE_PX, **_CONE)
    held = optics.tip_from_contour(
        contour, wall, camera, axis=true.axis, sigma_px=_NOISE_PX, **_CONE
    )
    return Accuracy(
        tip_um=1e3 * jnp.sqrt(jnp.trace(free.best.covariance[:3, :3])),
        distance_um=1e3 * free.best.distance_error,
        axis_deg=jnp.degrees(jnp.sqrt(0.5 * jnp.trace(free.best.covariance[3:, 3:]))),
        known_tip_um=1e3 * jnp.sqrt(jnp.trace(held.covariance[:3, :3])),
        known_distance_um=1e3 * held.distance_error,
        mirror_misfit_px=free.mirror.misfit_px,
    )


if __name__ == "__main__":
    main()
