"""What `eyespot explore` draws: eye and beam, the microscope's image, what each model reads.

Numbers in, SVG out, from closed forms and exact contours: nothing is rendered.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from eyespot import optics
from eyespot.benchmarks.model_error import (
    COLOURS,
    Geometry,
    cone_view,
    exact_spots,
    places,
    readings,
)
from eyespot.benchmarks.reporting import rows_of
from eyespot.benchmarks.workspace import geometry_of_rig, workspace_of
from eyespot.formats.rig import Rig

KNOBS = {
    "c": ("eccentricity c", "mm", 0.0, 10.0, 0.05, 3.0),
    "d": ("distance d", "mm", 0.2, 10.0, 0.05, 3.0),
    "tilt": ("tilt", "°", 0.0, 60.0, 0.5, 20.0),
    "azimuth": ("azimuth of tilt", "°", 0.0, 360.0, 5.0, 0.0),
    "height": ("pinhole height", "mm", 0.0, 400.0, 0.5, 200.0),
    "radius": ("radius of eye", "mm", 2.0, 16.0, 0.05, 11.5),
    "na": ("aperture NA", "", 0.02, 0.5, 0.005, 0.12),
    "core": ("radius of core", "mm", 0.0, 0.5, 0.005, 0.1),
}
"""What can be turned: label, unit, least and largest value, step, usual value."""
CONE = "ideal cone"
CHOICES = {"medium": tuple(optics.MEDIA), "source": (CONE, *optics.lens_names())}
TOLERANCE_MM = 0.1
_CURVE_POINTS = 49
_WINDOW_PX = (640, 480)
_INK, _FAINT, _LIGHT, _EDGE = "#444", "#999", "#ffe08a", "#d55e00"

State = Mapping[str, Any]
"""Values of `KNOBS` and `CHOICES` by name."""


def state_of(query: Mapping[str, str], rig: Rig | None = None) -> dict[str, Any]:
    """The state that an address keeps; what it lacks is the rig's, or usual."""
    state: dict[str, Any] = {name: knob[-1] for name, knob in KNOBS.items()}
    state |= {"medium": "air", "source": CONE}
    if rig is not None:
        geometry = geometry_of_rig(rig)
        space, medium = workspace_of(rig, geometry), rig.wall.medium or "air"
        ranges = {"c": space.eccentricity_mm or (0, 0), "d": space.distance_mm}
        ranges["tilt"] = space.tilt_deg
        state |= {name: round(sum(ends) / 2, 2) for name, ends in ranges.items()}
        state |= {"azimuth": space.azimuth_deg[0], "height": geometry.pinhole_height}
        state |= {"radius": geometry.eye_radius, "medium": medium}
        state["na"] = round(math.sin(geometry.half_angle) * optics.MEDIA[medium], 4)
        state["core"] = round(-geometry.apex_offset * math.tan(geometry.half_angle), 4)
    for name, text in query.items():
        if text in CHOICES.get(name, ()):
            state[name] = text
        elif name in KNOBS and math.isfinite(value := pd.to_numeric(text, errors="coerce")):
            state[name] = float(np.clip(value, *KNOBS[name][2:4]))
    return state


def geometry_of_state(state: State) -> Geometry:
    """Microscope, eye and tilted cone of a state; of a lens its effective cone.

    Raises:
        InputError: no tip, or no spot, can be there.
    """
    keys = {
        "microscope.pinhole_height_mm": state["height"],
        "wall.radius_mm": state["radius"],
        "wall.medium": state["medium"],
        "beam.numerical_aperture": state["na"],
        "instrument.core_radius_mm": state["core"],
        "workspace.eccentricity_mm": [0.0, state["c"]],
        "workspace.distance_mm": [state["d"], state["d"]],
        "workspace.tilt_deg": [0.0, state["tilt"]],
    }
    rig = Rig().changed(keys)
    geometry = geometry_of_rig(rig)
    workspace_of(rig, geometry)
    if state["source"] != CONE:
        from eyespot.scenes import Scene, changed
        from eyespot.scenes.world.world import World

        lens = {"source.lens": state["source"], "source.medium": state["medium"]}
        half_angle, b = World(changed(Scene(), lens)).cone
        geometry = geometry._replace(half_angle=half_angle, apex_offset=b)
    return geometry._replace(
        incidence=math.radians(state["tilt"]), incidence_azimuth=math.radians(state["azimuth"])
    )


def drawing(state: State) -> dict[str, str]:
    """The pictures `section`, `image` and `curve` of a state as SVG, and `table` as HTML.

    Raises:
        InputError: no tip, or no spot, can be there.
    """
    geometry, d = geometry_of_state(state), np.array([state["d"]])
    reach = max(0.7 * geometry.eye_radius, state["c"])
    c = np.append(np.linspace(0.0, reach, _CURVE_POINTS), state["c"])
    seen = exact_spots(geometry, c=c, d=np.full_like(c, state["d"]))
    found = readings(geometry, optics.MODELS, c=c, semi_minor_px=seen.semi_minor)
    errors = pd.DataFrame(found, index=c) - state["d"]
    here = pd.DataFrame({"reads_mm": errors.iloc[-1] + state["d"], "error_mm": errors.iloc[-1]})
    spot, axis = places(geometry, c[-1:])
    edge, contour = cone_view(geometry).spot_edge(spot=spot, axis=axis, distance=d)
    axes = seen.semi_major[-1], seen.semi_minor[-1]
    return {
        "section": _section(geometry, spot[0], axis[0], state["d"], edge[0]),
        "image": _image(contour[0], *axes),
        "curve": _curve(errors[:-1], here, state["c"]),
        "table": _table(here),
    }


def _svg(box: Sequence[float], label: str, parts: Iterable[str]) -> str:
    view = " ".join(f"{value:.5g}" for value in box)
    return f'<svg viewBox="{view}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def _line(points: Iterable[Sequence[float]], *, stroke: str = _FAINT, **style: object) -> str:
    corners = " ".join(f"{x:.5g},{y:.5g}" for x, y in points if math.isfinite(x + y))
    look = {"fill": "none", "stroke": stroke, "stroke_width": 1.5} | style
    kept = " ".join(f'{name.replace("_", "-")}="{value}"' for name, value in look.items())
    return f'<polyline points="{corners}" vector-effect="non-scaling-stroke" {kept}/>'


def _text(x: float, y: float, text: str, size: float, fill: str = _INK, anchor: str = "") -> str:
    return (
        f'<text x="{x:.5g}" y="{y:.5g}" font-size="{size:.3g}" fill="{fill}" '
        f'text-anchor="{anchor or "start"}">{text}</text>'
    )


def _section(
    geometry: Geometry, spot: np.ndarray, axis: np.ndarray, d: float, edge: np.ndarray
) -> str:
    """Eye and beam, projected onto the plane of the microscope's axis and the spot."""
    r, tip = geometry.eye_radius, spot - d * axis
    turn, size = np.radians(np.linspace(0.0, 360.0, 121)), 0.1 * r
    ends = edge[[int(np.argmin(edge[:, 0])), int(np.argmax(edge[:, 0]))]]
    pinhole = np.array([0.0, 0.0, min(geometry.pinhole_height, 1.2 * r)])
    if geometry.pinhole_height > 1.2 * r:  # the line of sight leaves the picture
        sight = (1.2 * r - spot[2]) / (geometry.pinhole_height - spot[2])
        pinhole[0] = spot[0] * (1 - sight)

    def flat(*points: np.ndarray) -> list[tuple[float, float]]:
        return [(float(p[0]), -float(p[2])) for p in points]

    ((tip_x, tip_y), (spot_x, spot_y)) = flat(tip, spot)
    parts = [
        _line(zip(r * np.cos(turn), r * np.sin(turn), strict=True)),
        _line([(0, -1.2 * r), (0, r)], stroke_dasharray="4 4"),
        _line(flat(ends[0], tip, ends[1]), stroke="none", fill=_LIGHT),
        _line(flat(pinhole, spot)),
        _line(flat(*edge, edge[0]), stroke=_EDGE, stroke_width=2.5),
        _line(flat(tip - 0.7 * r * axis, tip), stroke=_INK, stroke_width=4),
        _text(spot_x + 0.3 * size, spot_y + size, "O", size),
        _text(tip_x - size, tip_y, "S", size),
    ]
    return _svg((-1.2 * r, -1.25 * r, 2.4 * r, 2.5 * r), "The eye in section", parts)


def _image(contour: np.ndarray, semi_major: float, semi_minor: float) -> str:
    """The spot in the microscope's window, which is centred on it."""
    (width, height), middle = _WINDOW_PX, contour.mean(axis=0)
    left, top = middle - np.array(_WINDOW_PX) / 2
    said = f"semi-axes {semi_major:.1f} and {semi_minor:.1f} px"
    parts = [
        f'<rect x="{left:.5g}" y="{top:.5g}" width="{width}" height="{height}" fill="#3a2a24"/>',
        _line([*contour, contour[0]], stroke=_EDGE, fill=_LIGHT, stroke_width=2),
        _text(left + 12, top + height - 14, said, 22, "#fff"),
    ]
    return _svg((left, top, width, height), "The microscope's image", parts)


def _curve(errors: pd.DataFrame, here: pd.DataFrame, c: float) -> str:
    """Errors against c at this distance and tilt, with the place of the state."""
    largest = float(np.nanmax(np.abs(errors.to_numpy())))
    top, reach = max(2 * TOLERANCE_MM, min(1.1 * largest, 3.0)), float(errors.index.max())
    width, height, left = 400.0, 240.0, 44.0

    def at(c: float, error: float) -> tuple[float, float]:
        upright = float(np.clip(error / top, -1.1, 1.1))
        return left + (width - left - 8) * c / reach, height / 2 * (1 - 0.84 * upright)

    level = TOLERANCE_MM
    parts = [
        _line([at(0, 0), at(reach, 0)]),
        *(_line([at(0, y), at(reach, y)], stroke_dasharray="4 4") for y in (-level, level)),
        _line([(at(c, 0)[0], 6), (at(c, 0)[0], height - 20)], stroke=_INK),
    ]
    for model, colour in COLOURS.items():
        points = zip(errors.index.to_list(), errors[model].to_list(), strict=True)
        parts.append(_line([at(*point) for point in points], stroke=colour, stroke_width=2))
        x, y = at(c, here.error_mm[model])
        parts.append(f'<circle cx="{x:.5g}" cy="{y:.5g}" r="4" fill="{colour}"/>')
    for error in (-top, 0.0, top):
        parts.append(_text(left - 4, at(0, error)[1] + 4, f"{error:+.2g}", 12, anchor="end"))
    parts.append(_text(left, height - 4, f"error, mm, against c up to {reach:.3g} mm", 12))
    return _svg((0, 0, width, height), "Error against eccentricity", parts)


def _table(here: pd.DataFrame) -> str:
    rows = "".join(
        f'<tr><td><span class="key" style="background:{COLOURS[row.model]}"></span> {row.model}'
        f'</td><td>{row.reads_mm:.3f}</td><td class="{kind}">{row.error_mm:+.3f}</td></tr>'
        for row in rows_of(here.reset_index(names="model"))
        for kind in ("near" if abs(row.error_mm) <= TOLERANCE_MM else "far",)
    )
    return f"<table><tr><th>model</th><th>reads, mm</th><th>error, mm</th></tr>{rows}</table>"
