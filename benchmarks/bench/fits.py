"""Accuracy and time of fits: a cone to spots, beams to pixels.

Labels of the stacks are used for comparison only. Errors are fitted values less the true ones.
"""

from __future__ import annotations

import itertools
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import calibration
import optics
from benchmarks.bench import tracks
from benchmarks.paper import rms
from benchmarks.studies.pose import PRIOR_DEG, angle_deg, drawn_prior
from calibration import Prior
from calibration.pixels.data import read_footage
from calibration.pixels.fit import fit_image
from calibration.recordings import read_recording
from optics.wall_light.lens import lens_parameters
from scenes import Scene, load_mitsuba, render_stack

_CONE = {"half_angle": math.atan(1 / 20), "b": -5.117}


# A cone, from the ellipses of its spots.

_PLACES = (("plane", 1.5, 0.0), ("plane", 3.0, 120.0), ("eyeball", 4.0, 0.0), ("eyeball", 5.0, 240))
"""Phantom, c in mm, azimuth in degrees."""


@tracks(
    error=lambda _, fit, name: fit.values[name] - _CONE[name],  # rad or mm
    sigma=lambda _, fit, name: float(np.sqrt(np.diag(fit.covariance))[fit.free.index(name)]),
    c_rms_um=lambda _, fit, name: (
        1e3 * rms(np.array(fit.eccentricity) - [c for _, c, _ in _PLACES])
    ),
    chi_squared_per_dof=lambda _, fit, name: fit.chi_squared / fit.degrees_of_freedom,
)
class ConeWithdrawals:
    """Four withdrawals of 13 rendered frames of a cone, from starts 30 % off."""

    params = (["half_angle", "b"],)
    param_names = ("parameter",)

    def setup_cache(self) -> calibration.ConeFit:
        """Fit sub-pixel spots."""
        load_mitsuba()
        with tempfile.TemporaryDirectory() as folder:
            recordings = []
            for number, (kind, c, azimuth) in enumerate(_PLACES):
                scene: dict[str, Any] = {
                    "schema": 1,
                    "phantom": {"kind": kind, "wall": "uniform"},
                    "source": {"kind": "cone", "cone_k": 20.0, "cone_apex_offset_mm": _CONE["b"]},
                    "spot": {"eccentricity_mm": c, "azimuth_deg": azimuth},
                    "motion": {"frames": 13},
                    "exposures": {"kinds": ["metered"]},
                }
                stack = render_stack(Scene.model_validate(scene), Path(folder) / f"{number}")
                recordings.append(read_recording(stack.folder))
        return calibration.fit_cone(
            [recording.trial for recording in recordings],
            recordings[0].microscope.pinhole(),
            start={"half_angle": 1.3 * _CONE["half_angle"], "b": 0.7 * _CONE["b"]},
        )


# Tip and axis, from all pixels of one frame.

_DISTANCE_SIGMA_MM = 0.5
_LIGHT = {"sensitivity": Prior(200.0, 0.2), "illumination": Prior(0.05, 5e-4)}
"""Prior knowledge of the camera's sensitivity and the microscope light."""


def _of_poses(column: str, unit: float = 1.0) -> Callable[..., float]:
    """RMS of a column over a row's frames."""

    def number(_: Any, frames: pd.DataFrame, source: str, incidence: float) -> float:
        here = (frames.source == source) & (frames.incidence_deg == incidence)
        return unit * rms(frames[column][here])

    return number


@tracks(
    tip_um=_of_poses("tip_mm", 1e3),
    axis_deg=_of_poses("axis_deg"),
    stated_axis_deg=_of_poses("sigma_axis_deg"),
    distance_um=_of_poses("distance_mm", 1e3),
)
class FramePose:
    """Single frames of a known beam on an even wall; the robot's axis is 5 degrees off.

    `eyespot study pose` uses the contour only.
    """

    params = (["cone", "lens"], [10.0, 20.0, 30.0])
    param_names = ("source", "incidence_deg")

    def setup_cache(self) -> pd.DataFrame:
        """Render, and fit each frame alone."""
        load_mitsuba()
        dome = {"width_px": 192, "height_px": 144, "scale_mm_px": 0.03, "samples": 16}
        lens = lens_parameters(optics.load_lens("dome"))
        rows: list[dict[str, Any]] = []
        for kind, beam, view, known in (
            ("cone", {"kind": "cone"}, {"samples": 256}, _CONE),
            ("lens", {"kind": "lens", "lens": "dome"}, dome, lens),
        ):
            rng = np.random.default_rng(0)
            for incidence, c in itertools.product(self.params[1], (0.0, 2.5, 5.0)):
                scene: dict[str, Any] = {
                    "schema": 1,
                    "seed": int(10 * c + incidence),
                    "phantom": {"wall": "uniform"},
                    "instrument": {"visible": False},
                    "source": beam,
                    "spot": {"eccentricity_mm": c, "incidence_deg": incidence},
                    "motion": {"travel_mm": 3.9, "frames": 4},
                    "microscope": view,
                    "exposures": {"kinds": ["metered"]},
                }
                with tempfile.TemporaryDirectory() as folder:
                    stack = render_stack(Scene.model_validate(scene), Path(folder) / "stack")
                    footage = read_footage(stack)
                for frame, labels in enumerate(stack.labels[1:], 1):
                    axis = drawn_prior(np.array(labels.axis), rng)
                    distance = labels.d_mm + _DISTANCE_SIGMA_MM * rng.uniform(-1, 1)
                    alone = {
                        name: getattr(footage, name)[[frame]]
                        for name in ("light", "clear", "exposure_s")
                    }
                    fit = fit_image(
                        replace(footage, **alone, readings=np.zeros(1), axis=axis),
                        source=kind,  # type: ignore[arg-type]
                        start=known,
                        free=(),
                        priors={"touch": Prior(distance, _DISTANCE_SIGMA_MM), **_LIGHT},
                        lean_sigma=math.radians(PRIOR_DEG),
                    )
                    sigmas = (fit.parameters[name][1] for name in ("lean", "lean_sideways"))
                    rows.append(
                        {
                            "source": kind,
                            "incidence_deg": incidence,
                            "tip_mm": float(np.linalg.norm(fit.tips[0] - labels.tip_mm)),
                            "axis_deg": angle_deg(fit.axis, np.array(labels.axis)),
                            "distance_mm": fit.values["touch"] - labels.d_mm,
                            "sigma_axis_deg": math.degrees(math.hypot(*sigmas)),
                        }
                    )
        return pd.DataFrame(rows)


# Beams, from all pixels of a withdrawal.


def _off(number: int, *, percent: bool) -> Callable[..., float]:
    """Error of a free number of the beam, in standard errors or in per cent of its value."""

    def error(bench: BeamFit, *_: Any) -> float:
        name, true = list(bench.true.items())[number]
        value, sigma = bench.fit.parameters[name]
        return (value - true) / (0.01 * true if percent else sigma)

    return error


@tracks(
    first_off_in_sigmas=_off(0, percent=False),
    first_off_percent=_off(0, percent=True),
    second_off_in_sigmas=_off(1, percent=False),
    second_off_percent=_off(1, percent=True),
    chi_squared_per_dof=lambda bench, *_: bench.fit.chi_squared_per_dof,
    data=lambda bench, *_: bench.fit.degrees_of_freedom,
    # With compilation.
    wall_s=lambda bench, *_: bench.seconds[0],
    processor_s=lambda bench, *_: bench.seconds[1],
)
class BeamFit:
    """A cone and the dome lens, from starts 30 % off (full: 40 frames of 640 x 480 px).

    The two free numbers of the beam are the half-angle and b, or sag and aperture.
    """

    params = (["cone", "dome in air", "dome in vitreous"],)
    param_names = ("beam",)
    full = False

    def setup(self, beam: str) -> None:
        """Render and fit."""
        motion: dict[str, Any] = {"travel_mm": 5.0, "frames": 10}
        if beam == "cone":
            source, kind, start = {"kind": "cone"}, "cone", dict(_CONE)
            view = {"width_px": 128, "height_px": 128, "scale_mm_px": 0.02, "samples": 1024}
            if self.full:
                view, motion["frames"] = {"samples": 256}, 40
        else:
            medium, kind = beam.rpartition(" ")[2], "lens"
            source = {"kind": "lens", "lens": "dome", "medium": medium}
            start = lens_parameters(optics.load_lens("dome"))
            scale = {"air": 0.03, "vitreous": 0.02}[medium]
            view = {"width_px": 192, "height_px": 144, "samples": 16, "scale_mm_px": scale}
        free = tuple(start) if kind == "cone" else ("sag", "numerical_aperture")
        self.true = {name: start[name] for name in free}
        start |= {name: start[name] * x for name, x in zip(free, (1.3, 0.7), strict=True)}
        spot = {"eccentricity_mm": 2.0}
        scene = {"seed": 11, "source": source, "spot": spot, "motion": motion, "microscope": view}
        scene |= {"phantom": {"wall": "uniform"}, "exposures": {"kinds": ["metered"]}}
        with tempfile.TemporaryDirectory() as folder:
            stack = render_stack(Scene.model_validate(scene), Path(folder) / "stack")
            footage = read_footage(stack)
        began = time.perf_counter(), time.process_time()
        self.fit = fit_image(footage, source=kind, start=start, free=free)  # type: ignore[arg-type]
        self.seconds = time.perf_counter() - began[0], time.process_time() - began[1]
