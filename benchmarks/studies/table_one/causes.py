"""What makes trials of one lens differ: each cause's effect on delta k, b and -b/delta k."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.evaluation import PlaneRow
from benchmarks.studies.table_one.findings import CauseLine, LensChoice, LensMark
from benchmarks.studies.table_one.isophotes import Isophotes
from benchmarks.studies.table_one.scan import readings
from calibration import Lines, fit_lines
from scenes import Scene

TOUCH_MM = 0.5
LIGHT = 0.2
TILT_DEG = 10.0
HEIGHT_MM = 1.0
MORE_LIGHT = 0.1


def causes(isophotes: Isophotes, choice: LensChoice, scene: Scene) -> list[CauseLine]:
    """The choice's line, without a cause and with each cause alone.

    A wrong touch shifts all readings alike, so b by as much and nothing else. More light lowers the
    level that the threshold stands for, a steeper tilt raises it. A lower wall is seen smaller.
    """
    scale, level = choice.scale_mm_px, choice.level
    reading = readings(choice.from_mm, choice.to_mm)

    def line(d_r: np.ndarray = reading, *, level: float = level, turn: float = 0.0) -> Lines:
        incidence = isophotes.incidence + math.radians(turn)
        radius = isophotes.radius(d_r, level=np.full_like(d_r, level), incidence=incidence)
        return fit_lines(radius / scale, d_r)

    own = line()
    height = scene.microscope.pinhole_height_mm + scene.phantom.radius_mm
    smaller = height / (height + HEIGHT_MM)
    longer = min(choice.from_mm + 1.5 * (choice.to_mm - choice.from_mm), 8.0)
    changed = {
        "none": own,
        f"touch {TOUCH_MM:g} mm too far off": own._replace(b=own.b - TOUCH_MM),
        f"{100 * LIGHT:g} % more light": line(level=level / (1 + LIGHT)),
        f"{100 * LIGHT:g} % less light": line(level=level / (1 - LIGHT)),
        f"tilt {TILT_DEG:g}° steeper": line(turn=TILT_DEG),
        f"tilt {TILT_DEG:g}° less steep": line(turn=-TILT_DEG),
        f"wall {HEIGHT_MM:g} mm lower": own._replace(delta_k=own.delta_k / smaller),
        f"readings up to {longer:.1f} mm": line(readings(choice.from_mm, longer)),
    }
    return [cause_line(name, row, own) for name, row in changed.items()]


def mark(isophotes: Isophotes, choice: LensChoice) -> LensMark:
    """What distinguishes this lens from others."""
    reading = readings(choice.from_mm, choice.to_mm)
    middle = np.array([0.5 * (choice.from_mm + choice.to_mm)])
    sizes = [
        float(isophotes.radius(middle, level=np.array([choice.level / light]))[0])
        for light in (1.0, 1.0 + MORE_LIGHT)
    ]
    half = isophotes.half_maximum(reading)
    line = fit_lines(half / choice.scale_mm_px, reading)
    return LensMark(
        *isophotes.family,
        level=choice.level,
        from_mm=choice.from_mm,
        to_mm=choice.to_mm,
        contact_radius_px=-choice.b_mm / choice.delta_k_mm_px,
        growth_px=(sizes[1] - sizes[0]) / choice.scale_mm_px,
        half_maximum_delta_k_mm_px=float(line.delta_k),
        half_maximum_b_mm=float(line.b),
        half_maximum_r_squared=float(line.r_squared),
        half_maximum_turns_at_mm=float(reading[np.argmin(half)]),
    )


def light_and_touch(row: PlaneRow, other: PlaneRow) -> tuple[float, float]:
    """The light and the missed touch that explain the difference of two lines of one lens.

    Light moves delta k and b in proportion, so that -b/delta k stays; touch moves b alone.

    Returns:
        Ratio of the slopes, due to light; what touch adds to b, mm.
    """
    ratio = row.delta_k / other.delta_k
    return ratio, row.b - ratio * other.b


def cause_line(name: str, row: Lines | PlaneRow, own: Lines | PlaneRow) -> CauseLine:
    """The row of a line, with its change from the own one."""
    contact = -row.b / row.delta_k
    return CauseLine(
        name,
        delta_k_mm_px=float(row.delta_k),
        b_mm=float(row.b),
        contact_radius_px=float(contact),
        r_squared=float(row.r_squared),
        rmse_mm=float(row.rmse),
        delta_k_change_percent=float(100 * (row.delta_k / own.delta_k - 1)),
        b_change_mm=float(row.b - own.b),
        contact_radius_change_px=float(contact + own.b / own.delta_k),
    )
