"""Frames rendered by Mitsuba, with the labels of their scene."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.bench.estimator.frame_kinds import CLEAN
from benchmarks.bench.estimator.methods import MethodInput
from scenes.drawn import Truth

RENDERS = {"rendered cone, incidence 30°": 30.0, "rendered cone behind its shaft, 12°": 12.0}
"""Incidence of the beam (deg) by the name of the kind of frame."""

LIMITS = CLEAN
_FRAMES = 12
_VISIBLE = 0.5  # frames with a smaller visible fraction of the contour are skipped
_NEAREST_MM, _TRAVEL_MM = 1.5, 4.0


def rendered(name: str, rng: np.random.Generator) -> Iterator[tuple[MethodInput, Truth]]:
    """Noisy frames of a withdrawal from a uniform wall, with the half-maximum ellipse of each.

    Raises:
        RendererUnavailable: Mitsuba cannot run here.
    """
    from scenes import Scene, render_stack

    scene = Scene.model_validate(
        {
            "schema": 1,
            "phantom": {"wall": "uniform"},
            "source": {"kind": "cone"},
            "spot": {"incidence_deg": RENDERS[name]},
            "motion": {"start_mm": _NEAREST_MM, "travel_mm": _TRAVEL_MM, "frames": _FRAMES},
            "exposures": {"kinds": ["metered"]},
        }
    )
    with tempfile.TemporaryDirectory() as folder:
        stack = render_stack(scene, Path(folder) / "stack")
        for labels in stack.exposed("metered"):
            if labels.visible_fraction < _VISIBLE:
                continue
            image = stack.image(labels)
            dark, bright = np.percentile(image @ (0.299, 0.587, 0.114), [50, 99])
            truth = Truth(
                x=labels.half_max_x_px,
                y=labels.half_max_y_px,
                semi_major=labels.half_max_semi_major_px,
                semi_minor=labels.half_max_semi_minor_px,
                angle=labels.half_max_angle_rad,
            )
            dx, dy = rng.uniform(-10, 10, 2)
            at = truth.x + dx, truth.y + dy
            yield MethodInput(image, at, (dark + bright) / 2, None), truth
