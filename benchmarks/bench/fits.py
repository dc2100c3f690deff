"""Accuracy and time of fits: a cone to spots, beams to pixels, a lens through its own glass.

Labels of the stacks are used for comparison only. Errors are fitted values less the true ones.
"""

from __future__ import annotations

import itertools
import math
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter1d

import calibration
import optics
from benchmarks.bench import tracks
from benchmarks.paper import rms
from benchmarks.studies.pose import PRIOR_DEG, angle_deg, drawn_prior
from calibration import Prior
from calibration.bridge import FLOAT32_LEVENBERG_MARQUARDT, render_as_jax
from calibration.pixels.data import Footage, read_footage
from calibration.pixels.fit import fit_image
from calibration.recordings import read_recording
from calibration.solvers import least_squares
from optics.wall_light.lens import lens_parameters
from scenes import Scene, load_mitsuba, render_stack

_CONE = {"half_angle": math.atan(1 / 20), "b": -5.117}


def _rendered(settings: dict[str, Any]) -> Footage:
    """The pixels of a stack of a scene with these tables."""
    shared: dict[str, Any] = {"schema": 1, "exposures": {"kinds": ["metered"]}}
    settings = {**shared, **settings, "phantom": {"wall": "uniform"} | settings.get("phantom", {})}
    with tempfile.TemporaryDirectory() as folder:
        return read_footage(render_stack(Scene.model_validate(settings), Path(folder) / "stack"))


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
                    fit = fit_image(
                        replace(_some(footage, [frame]), readings=np.zeros(1), axis=axis),
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
                            "chi_squared": fit.chi_squared_per_dof,
                        }
                    )
        return pd.DataFrame(rows)


def _some(footage: Footage, frames: list[int]) -> Footage:
    arrays = ("light", "clear", "exposure_s", "readings")
    return replace(footage, **{name: getattr(footage, name)[frames] for name in arrays})


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
        footage = _rendered(scene)
        began = time.perf_counter(), time.process_time()
        self.fit = fit_image(footage, source=kind, start=start, free=free)  # type: ignore[arg-type]
        self.seconds = time.perf_counter() - began[0], time.process_time() - began[1]


# A lens through its own glass, with Mitsuba behind JAX.
#
# Data and model share no code of the lens. The data come from Mitsuba's particle tracer through a
# dielectric cap. The model is `scenes.rendering.differentiable` behind `calibration.render_as_jax`,
# fitted by Levenberg-Marquardt.

_GLASS = "dome"
_SHOTS, _HEIGHT, _WIDTH = 2, 48, 64
_DATA_SEEDS, _PHOTONS_PER_PIXEL = 64, 8
# With more light, approximations of the model would be visible (docs/python.md).
_MODEL_SEEDS, _MODEL_PHOTONS = 8, 1 << 20
_FREE = ("sag", "glue_length", "numerical_aperture", "tip_z", "power")
_NAMES = ("sag_mm", "numerical_aperture", "tip_height_mm", "power_mw")
_START_OFF = np.array([0.7, 1.3, 1.0, 1.3])
"""Start values relative to the truth; the tip starts with an error of 0.2 mm."""
_TIP_OFF_MM = 0.2
_DARK = 0.01  # of the peak; the noise of darker pixels is set to that of this level
_INNER = (..., slice(1, -1), slice(1, -1))
"""Without the outermost pixels, which `in_spline_pixels` cannot compute."""
_BLUR_PX = 1.5
"""Blur of the residuals. Photons that move from pixel to pixel are noise in the Jacobian, which
makes steps and errors too small; the blur reduces this noise by a factor of ten."""


@tracks(
    truth=lambda _, fits, medium, name: float(fits[medium].truth[name]),
    fitted=lambda _, fits, medium, name: float(fits[medium].fitted[name]),
    off_in_sigmas=lambda _, fits, medium, name: float(
        (fits[medium].fitted - fits[medium].truth)[name] / fits[medium].sigma[name]
    ),
    # Over its expectation from the seeds.
    chi_squared_over_expected=lambda _, fits, medium, name: float(fits[medium].chi_squared[name]),
)
class PhotonFit:
    """The dome lens in 2 frames of 64 x 48 px, fitted to photons through its glass."""

    params = (["air", "vitreous"], [*_NAMES])
    param_names = ("medium", "parameter")

    def setup_cache(self) -> dict[str, pd.DataFrame]:
        """Fit in both media."""
        load_mitsuba()
        return {medium: photon_fit(medium) for medium in self.params[0]}


def photon_fit(medium: str) -> pd.DataFrame:
    """Fit a lens to photon images at two distances in a medium; rows are parameters."""
    from scenes.rendering.differentiable import PhotonImage  # needs Mitsuba's variant

    scene = _photon_scene(medium)
    data = _data(scene)[_INNER]
    measured, noise = data.mean(axis=1), data.var(axis=1) / _DATA_SEEDS
    level = np.maximum(measured, _DARK * measured.max(axis=(1, 2), keepdims=True))
    per_light = noise.sum(axis=(1, 2)) / measured.sum(axis=(1, 2))
    sigma = np.sqrt(per_light[:, None, None] * level)

    settings: Any = {"free": _FREE, "photons": _MODEL_PHOTONS}
    hosts = [
        [PhotonImage(scene, frame=frame, seed=seed, **settings) for frame in range(_SHOTS)]
        for seed in range(_MODEL_SEEDS)
    ]
    images = [render_as_jax(h.value, h.value_and_jacobian, shape=h.shape) for h in hosts[0]]
    sag, length, aperture, _, power = hosts[0][0].start
    gap = length - sag
    heights = [host.start[3] for host in hosts[0]]
    truth = np.array([sag, aperture, 0.0, power])

    def model(parameters: jax.Array, images: Iterable[Callable[..., Any]]) -> jax.Array:
        sag, aperture, offset, power = parameters
        frames = []
        for image, height in zip(images, heights, strict=True):
            # The drop grows with its cap, so that the core's face does not move.
            values = jnp.stack([sag, sag + gap, aperture, height + offset, power])
            frames.append(image(values)[..., 0])
        return jnp.stack(frames)[_INNER]

    def residual(parameters: jax.Array) -> jax.Array:
        return _blurred((model(parameters, images) - measured) / sigma).ravel()

    start = truth * _START_OFF + np.array([0, 0, _TIP_OFF_MM, 0])
    solution = least_squares(
        residual,
        jnp.asarray(start),
        count=measured.size,
        solver=FLOAT32_LEVENBERG_MARQUARDT,
    )

    seeds = [model(solution.parameters, [host.value for host in seed]) for seed in hosts]
    # The noise of neighbouring pixels is correlated, so it is propagated seed by seed.
    ours, theirs = (_blurred(x / sigma[:, None]) for x in (np.stack(seeds, axis=1), data))
    expected = ours.var(axis=1, ddof=1) + theirs.var(axis=1, ddof=1) / _DATA_SEEDS
    jacobian = np.asarray(jax.jacfwd(residual)(solution.parameters))
    variance = _variance(jacobian, ours) + _variance(jacobian, theirs) / _DATA_SEEDS
    found = {"truth": truth, "fitted": np.asarray(solution.parameters)}
    chi_squared = float(jnp.sum(solution.residuals**2)) / expected.sum()
    columns = {**found, "sigma": np.sqrt(variance), "chi_squared": chi_squared}
    return pd.DataFrame(columns, index=list(_NAMES))


def _data(scene: Scene) -> np.ndarray:
    """Mitsuba's images of every frame, frames x seeds x H x W."""
    seeds = range(100, 100 + _DATA_SEEDS)
    settings: Any = {"photons_per_pixel": _PHOTONS_PER_PIXEL, "seeds": seeds}
    from scenes.rendering.glass import glass_images  # needs Mitsuba's variant

    frames = [glass_images(scene, frame=frame, **settings) for frame in range(_SHOTS)]
    return in_spline_pixels(np.stack(frames))


def _blurred(images: Any) -> Any:
    """Images (... x H x W, NumPy or JAX) after a Gaussian blur that keeps the variance of noise."""
    rows, columns = (
        gaussian_filter1d(np.eye(size), _BLUR_PX, axis=0) for size in images.shape[-2:]
    )
    rows, columns = (m / np.linalg.norm(m, axis=1, keepdims=True) for m in (rows, columns))
    return rows @ images @ columns.T


def _variance(jacobian: np.ndarray, images: np.ndarray) -> np.ndarray:
    """Variance of the parameters from the noise of one seed; images are frames x seeds x H x W."""
    noise = np.swapaxes(images - images.mean(axis=1, keepdims=True), 0, 1)
    shifts, *_ = np.linalg.lstsq(jacobian, noise.reshape(len(noise), -1).T, rcond=None)
    return shifts.var(axis=1, ddof=1)


def _photon_scene(medium: str) -> Scene:
    content: dict[str, Any] = {
        "schema": 1,
        "phantom": {"wall": "uniform", "indirect": "off"},
        "source": {
            "kind": "photons",
            "lens": _GLASS,
            "medium": medium,
            "photons_per_pixel": _PHOTONS_PER_PIXEL,
        },
        "instrument": {"visible": False},
        "motion": {"start_mm": 2.0, "travel_mm": 2.0, "frames": _SHOTS},
        "microscope": {
            "illumination_mw_mm2": 0.0,
            "width_px": _WIDTH,
            "height_px": _HEIGHT,
            "scale_mm_px": 0.05,
        },
    }
    return Scene.model_validate(content)


def in_spline_pixels(images: np.ndarray) -> np.ndarray:
    """Convert box pixels to quadratic-spline pixels, which are boxes blurred by a tent.

    The kernel (1, 10, 1)/12 has the second moment of the tent, 1/6 px^2, which is enough where
    light is smooth over a pixel.

    Args:
        images: images with box pixels, ... x H x W. The result is wrong at edges that are not dark.
    """
    for axis in (-2, -1):
        images = (10 * images + np.roll(images, 1, axis) + np.roll(images, -1, axis)) / 12
    return images
