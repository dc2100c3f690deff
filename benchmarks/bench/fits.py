"""Accuracy and time of fits: a cone to spots, beams to pixels.

Labels of the stacks are used for comparison only. Errors are fitted values less the true ones.
"""

import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eyespot import calibration, optics
from eyespot.benchmarks.statistics import rms
from eyespot.calibration.pixels.data import footage_of
from eyespot.calibration.pixels.fit import fit_image
from eyespot.calibration.recorded_trial import recorded_trial
from eyespot.optics.wall_light.lens_flux import lens_parameters
from eyespot.scenes import Scene, render_stack

_CONE = {"half_angle": math.atan(1 / 20), "b": -5.117}


# A cone, from the ellipses of its spots.

_PLACES = (("plane", 1.5, 0.0), ("plane", 3.0, 120.0), ("eyeball", 4.0, 0.0), ("eyeball", 5.0, 240))
"""Phantom, c in mm, azimuth in degrees."""


def cone_withdrawals(full: bool = False) -> pd.DataFrame:
    """Four withdrawals of 13 rendered frames of a cone, from starts 30 % off; sub-pixel spots."""
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
            recordings.append(recorded_trial(stack))
    fit = calibration.fit_cone(
        [recording.trial for recording in recordings],
        recordings[0].microscope.pinhole(),
        start={"half_angle": 1.3 * _CONE["half_angle"], "b": 0.7 * _CONE["b"]},
    )
    found = pd.DataFrame(index=pd.Index(_CONE, name="parameter"))
    return found.assign(
        error=[fit.values[name] - true for name, true in _CONE.items()],  # rad or mm
        sigma=[np.sqrt(np.diag(fit.covariance))[fit.free.index(name)] for name in _CONE],
        c_rms_um=1e3 * rms(np.array(fit.eccentricity) - [c for _, c, _ in _PLACES]),
        chi_squared_per_dof=fit.chi_squared / fit.degrees_of_freedom,
    )


# Beams, from all pixels of a withdrawal.


def beam_fit(full: bool = False) -> pd.DataFrame:
    """A cone and the dome lens, from starts 30 % off (full: 40 frames of 640 x 480 px of a cone).

    The two free numbers of the beam are the half-angle and b, or sag and aperture; `off_in_sigmas`
    is their error in standard errors. Times contain compilation.
    """
    rows = []
    for beam in ("cone", "dome in air", "dome in vitreous"):
        motion: dict[str, Any] = {"travel_mm": 5.0, "frames": 10}
        if beam == "cone":
            source, kind, start = {"kind": "cone"}, "cone", dict(_CONE)
            view = {"width_px": 128, "height_px": 128, "scale_mm_px": 0.02, "samples": 1024}
            if full:
                view, motion["frames"] = {"samples": 256}, 40
        else:
            medium, kind = beam.rpartition(" ")[2], "lens"
            source = {"kind": "lens", "lens": "dome", "medium": medium}
            start = lens_parameters(optics.load_lens("dome"))
            scale = {"air": 0.03, "vitreous": 0.02}[medium]
            view = {"width_px": 192, "height_px": 144, "samples": 16, "scale_mm_px": scale}
        free = tuple(start) if kind == "cone" else ("sag", "numerical_aperture")
        true = {name: start[name] for name in free}
        start |= {name: start[name] * x for name, x in zip(free, (1.3, 0.7), strict=True)}
        spot = {"eccentricity_mm": 2.0}
        scene = {"seed": 11, "source": source, "spot": spot, "motion": motion, "microscope": view}
        scene |= {"phantom": {"wall": "uniform"}, "exposures": {"kinds": ["metered"]}}
        with tempfile.TemporaryDirectory() as folder:
            footage = footage_of(render_stack(Scene.model_validate(scene), Path(folder) / "stack"))
        began = time.perf_counter(), time.process_time()
        fit = fit_image(footage, source=kind, start=start, free=free)  # type: ignore[arg-type]
        row: dict[str, Any] = {"beam": beam}
        for which, name in zip(("first", "second"), free, strict=True):
            value, sigma = fit.parameters[name]
            row[f"{which}_off_in_sigmas"] = (value - true[name]) / sigma
            row[f"{which}_off_percent"] = 100 * (value / true[name] - 1)
        rows.append(
            row
            | {
                "chi_squared_per_dof": fit.chi_squared_per_dof,
                "data": fit.degrees_of_freedom,
                "wall_s": time.perf_counter() - began[0],
                "processor_s": time.process_time() - began[1],
            }
        )
    return pd.DataFrame(rows).set_index("beam")
