"""Accuracy of the fit of the exact geometry to ellipses: exact contours and rendered stacks.

The labels of the stacks are used for comparison only, not for the fit.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rich.table import Table

import calibration
import optics
from benchmarks.bench.output import show, table
from calibration.recordings import read_recording
from scenes import Scene, load_mitsuba, render_stack

_TRUE = {"half_angle": math.atan(1 / 20), "b": -5.117}
_START = {"half_angle": 1.3 * _TRUE["half_angle"], "b": 0.7 * _TRUE["b"]}
_PLACES = (("plane", 1.5, 0.0), ("plane", 3.0, 120.0), ("eyeball", 4.0, 0.0), ("eyeball", 5.0, 240))
"""Phantom, c in mm, azimuth in degrees."""
_FRAMES = 13


def run(*, full: bool) -> None:
    """Fit, and print the parameters with their true values (`full` changes nothing)."""
    load_mitsuba()
    eye = optics.microscope(scale=0.0067, pinhole_height=200.0, eye_radius=11.5)
    trials = [_exact_trial(kind, c, math.radians(azimuth), eye) for kind, c, azimuth in _PLACES]
    fit = calibration.fit_cone(trials, eye, start=_START)
    show(_table("exact contours without noise", fit))
    with tempfile.TemporaryDirectory() as folder:
        stacks = [
            render_stack(_scene(*place), Path(folder) / f"{number}")
            for number, place in enumerate(_PLACES)
        ]
        recordings = [read_recording(stack.folder) for stack in stacks]
    fit = calibration.fit_cone(
        [recording.trial for recording in recordings],
        recordings[0].microscope.pinhole(),
        start=_START,
    )
    show(
        _table("rendered cones with camera noise, sub-pixel spots", fit),
        f"chi squared per degree of freedom {fit.chi_squared / fit.degrees_of_freedom:.3f} over "
        f"{fit.degrees_of_freedom}; converged: {fit.converged}",
    )


def _exact_trial(
    kind: str, c: float, azimuth: float, eye: optics.Microscope
) -> calibration.ConeTrial:
    wall = optics.Sphere(11.5) if kind == "eyeball" else optics.pole_plane(eye_radius=11.5)
    distances = jnp.linspace(0.5, 6.0, _FRAMES)

    def at(distance: jax.Array) -> tuple[optics.Ellipse, jax.Array]:
        beam = optics.beam_at_spot(
            wall,
            eccentricity=c,
            azimuth=azimuth,
            incidence=math.radians(30.0),
            distance=distance,
            half_angle=_TRUE["half_angle"],
            apex_offset=_TRUE["b"],
        )
        return optics.spot_ellipse(beam, wall, eye), beam.axis

    ellipses, axes = jax.jit(jax.vmap(at))(distances)
    return calibration.ConeTrial(
        ellipses=ellipses,
        covariances=np.tile(np.diag([0.01, 0.01, 0.01, 0.01, 0.005]) ** 2, (_FRAMES, 1, 1)),
        readings=np.asarray(distances),
        axis=np.asarray(axes[0]),
        principal_point=np.zeros(2),
        touch=calibration.Prior(0.0, 0.02),
        kind=kind,
    )


def _scene(kind: str, c: float, azimuth: float) -> Scene:
    return Scene.model_validate(
        {
            "schema": 1,
            "phantom": {"kind": kind, "wall": "uniform"},
            "source": {"kind": "cone", "cone_k": 20.0, "cone_apex_offset_mm": _TRUE["b"]},
            "spot": {"eccentricity_mm": c, "azimuth_deg": azimuth},
            "motion": {"frames": _FRAMES},
            "exposures": {"kinds": ["metered"]},
        }
    )


def _table(title: str, fit: calibration.ConeFit) -> Table:
    made = table(title, "parameter", "true", "found", "± σ", "error")
    sigma = np.sqrt(np.diag(fit.covariance))
    rows = [
        *((n, _TRUE[n], fit.values[n], s) for n, s in zip(fit.free, sigma, strict=True)),
        *(
            (f"c, {kind}", c, found, error)
            for (kind, c, _), found, error in zip(
                _PLACES, fit.eccentricity, fit.eccentricity_error, strict=True
            )
        ),
    ]
    for name, true, found, error in rows:
        cells = (f"{true:.6g}", f"{found:.6g}", f"{error:.2g}", f"{found - true:+.2g}")
        made.add_row(name, *cells)
    return made
