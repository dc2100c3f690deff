"""Draws the figure of docs/viewing.md and README.md: `python docs/viewing_figures.py`."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.reporting import BLACK, BLUE, GREY, SKY, STYLE, VERMILION
from benchmarks.studies.eye import fields, path_errors
from benchmarks.studies.eye_paths import PATHS, PINHOLE_ABOVE_MM, Recipe, grid
from optics import viewing

_FILE = Path(__file__).resolve().parent / "viewing_paths.png"
_TITLES = {
    "flat, phakic": "flat contact lens, phakic eye",
    "flat, aphakic": "flat contact lens, aphakic eye",
    "wide-field 90 D, phakic": "wide-field lens 90 D, phakic eye",
}
_C_MM = np.arange(0.0, 5.1, 0.5)
_DISTANCES_MM = np.array([1.0, 2.0, 4.0, 6.0])
_NM = 555.0
_WIDE_MM, _FIELD_MM = 50.0, 4.0  # radius of an open pupil; c that the outermost line reaches
_DRAWN_RECIPES = {Recipe.SMALL_PLANE: VERMILION, Recipe.AREA: BLUE}
_ABOVE_MM = 14.0  # height above the cornea at which the drawing begins
_DISTANCES = f"{_DISTANCES_MM[0]:g} to {_DISTANCES_MM[-1]:g} mm"


def main() -> None:
    """Draw the figure."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 5.4), layout="constrained")
        rays, errors = figure.subplots(2, len(_TITLES), height_ratios=[1.1, 1.0], sharex="row")
        for path, above, below in zip(_TITLES, rays, errors, strict=True):
            _draw_path(above, path)
            _draw_errors(below, path)
            below.sharey(errors[0])
        rays[0].set_ylabel("across (mm)")
        errors[0].set_ylabel("error of the distance (mm)")
        figure.legend(
            handles=[
                Line2D([], [], color=SKY, label="lines of sight"),
                Line2D([], [], color=VERMILION, marker="o", ms=3, label="small_plane"),
                Line2D(
                    [], [], color=BLUE, marker="o", ms=3, label="pinhole fitted in the eye, area"
                ),
                Line2D([], [], color=GREY, lw=0.8, label="largest $c$ that a 7 mm pupil shows"),
            ],
            loc="outside lower center",
            ncols=4,
        )
        figure.savefig(_FILE)
    print(f"{_FILE}  {_FILE.stat().st_size / 1e3:.0f} kB")


def _eye() -> viewing.Eye:
    return viewing.load_eye("navarro", wavelength_nm=_NM)


def _viewing_path(name: str) -> viewing.ViewingPath:
    lens, form = PATHS[name]
    viewing_lens = viewing.load_viewing_lens(lens)
    above = getattr(viewing_lens, "thickness", getattr(viewing_lens, "height", 0.0))
    return viewing.viewing_path(
        _eye(),
        viewing_lens,
        form=form,
        pupil_radius=_WIDE_MM,
        pinhole_distance=PINHOLE_ABOVE_MM + above,
    )


def _draw_path(axes: Axes, name: str) -> None:
    """Lines of sight in a meridian plane, from the microscope (left) to the retina."""
    path = _viewing_path(name)
    (across, _, along), pole = np.asarray(path.retina_semi_axes), float(path.pole_depth)
    angle = np.radians(np.linspace(-120.0, 120.0, 181))  # the retina ends behind the lens
    axes.plot(pole - along + along * np.cos(angle), across * np.sin(angle), color=GREY)
    heights = _heights_up_to(path, _FIELD_MM)
    for x, y in _polylines(path, np.concatenate([-heights[::-1], heights])):
        axes.plot(x, y, color=SKY, lw=0.8)
    for element in path.elements:
        _draw_element(axes, element)
    axes.set(xlim=(-_ABOVE_MM, pole + 1.0), ylim=(-12.5, 12.5), title=_TITLES[name], aspect="equal")
    axes.set_xlabel("depth below the cornea (mm)")
    axes.grid(visible=False)


def _heights_up_to(path: viewing.ViewingPath, c: float) -> np.ndarray:
    """Aims of lines of sight that reach the retina at even steps of the distance from the axis."""
    radius = float(path.retina_semi_axes[2])
    points = [[x, 0.0, -np.sqrt(radius**2 - x**2)] for x in np.linspace(c / 4, c, 4)]
    camera = viewing.path_camera(path, scale=1.0)
    pixels = np.abs(np.asarray(camera.project(jnp.asarray(points)))[:, 0])
    return pixels / abs(float(camera.magnification))


def _polylines(path: viewing.ViewingPath, aims: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Depths and heights at which lines of sight meet each element and the retina."""
    depth = -_ABOVE_MM
    across = np.zeros_like(aims)
    closeness = float(path.pinhole_closeness)
    start = np.stack([aims * (1.0 + closeness * depth), across, across + depth], axis=-1)
    direction = np.stack([aims * closeness, across, across + 1.0], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    places = [start]
    for count in range(1, len(path.elements) + 1):
        rays = viewing.trace(path.elements[:count], jnp.asarray(start), jnp.asarray(direction))
        places.append(np.asarray(rays.point))
    point, along = np.asarray(rays.point), np.asarray(rays.direction)
    radius = float(path.retina_semi_axes[2])
    from_centre = point - np.array([0.0, 0.0, float(path.pole_depth) - radius])
    ahead = np.sum(from_centre * along, axis=-1)
    reach = np.sqrt(ahead**2 + radius**2 - np.sum(from_centre**2, axis=-1)) - ahead
    places.append(point + reach[:, None] * along)
    lines = np.stack(places)
    return [(lines[:, k, 2], lines[:, k, 0]) for k in range(len(aims))]


def _draw_element(axes: Axes, element: viewing.Element) -> None:
    match element:
        case viewing.Refracting(surface=surface):
            edge = 5.5 if float(surface.depth) < 3.0 else 4.2  # half the diameter, for the eye only
            y = np.linspace(-edge, edge, 101)
            c, stretch = float(surface.curvature), 1.0 + float(surface.asphericity)
            under_root = 1.0 - stretch * c**2 * y**2
            inside = under_root > 0
            sag = c * y[inside] ** 2 / (1.0 + np.sqrt(under_root[inside]))
            axes.plot(float(surface.depth) + sag, y[inside], color=BLACK, lw=0.8)
        case viewing.ThinLens(depth=depth):
            axes.annotate(
                "",
                (float(depth), 11.0),
                (float(depth), -11.0),
                arrowprops={"arrowstyle": "<->", "color": BLACK, "lw": 0.8},
            )
        case viewing.Iris(depth=depth):
            for side in (-1.0, 1.0):
                edges = [side * viewing.DILATED_MM, side * 6.0]
                axes.plot([float(depth)] * 2, edges, color=BLACK, lw=1.6)


def _draw_errors(axes: Axes, name: str) -> None:
    """Largest error over the distances, with its sign, for perpendicular beams."""
    eyes = jax.tree.map(lambda leaf: jnp.stack([leaf]), _eye())
    found = path_errors(name, [eyes], grid(_C_MM, _DISTANCES_MM, ((0.0, 0.0),)), seed=None)
    for recipe, colour in _DRAWN_RECIPES.items():
        errors = found.errors[recipe][0, :, :, 0]
        largest = np.take_along_axis(errors, np.abs(errors).argmax(axis=1)[:, None], axis=1)
        axes.plot(_C_MM, largest, "o-", ms=3, color=colour)
        print(f"{name}, {recipe}: {largest[-1, 0]:+.3f} mm at c = {_C_MM[-1]:g}, d {_DISTANCES}")
    field = float(fields(name, eyes)[0])
    if field < _C_MM[-1]:
        axes.axvline(field, color=GREY, lw=0.8)
    axes.set_xlabel("$c$ (mm)")


if __name__ == "__main__":
    main()
