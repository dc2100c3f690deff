"""Accuracy of a lens fitted through its own glass, with Mitsuba behind JAX.

Data and model share no code of the lens. The data come from Mitsuba's particle tracer through a
dielectric cap. The model is `scenes.rendering.differentiable` behind `calibration.render_as_jax`,
fitted by Levenberg-Marquardt.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.table import Table
from scipy.ndimage import gaussian_filter1d

from benchmarks.bench.output import show, table
from calibration.bridge import FLOAT32_LEVENBERG_MARQUARDT, render_as_jax
from calibration.solvers import least_squares
from scenes import Scene, load_mitsuba

_LENS = "dome"
_FRAMES, _HEIGHT, _WIDTH = 2, 48, 64
_DATA_SEEDS, _PHOTONS_PER_PIXEL = 64, 8
# With more light, approximations of the model would be visible (docs/python.md).
_MODEL_SEEDS, _MODEL_PHOTONS = 8, 1 << 20
_FREE = ("sag", "glue_length", "numerical_aperture", "tip_z", "power")
_NAMES = ("sag, mm", "numerical aperture", "tip height, mm", "power, mW")
_START_OFF = np.array([0.7, 1.3, 1.0, 1.3])
"""Start values relative to the truth; the tip starts with an error of 0.2 mm."""
_TIP_OFF_MM = 0.2
_DARK = 0.01  # of the peak; the noise of darker pixels is set to that of this level
_INNER = (..., slice(1, -1), slice(1, -1))
"""Without the outermost pixels, which `in_spline_pixels` cannot compute."""
_BLUR_PX = 1.5
"""Blur of the residuals. Photons that move from pixel to pixel are noise in the Jacobian, which
makes steps and errors too small; the blur reduces this noise by a factor of ten."""


class Fit(NamedTuple):
    """A fitted lens with errors and truth; chi^2 is relative to its expectation from the seeds."""

    fitted: np.ndarray
    sigma: np.ndarray
    truth: np.ndarray
    start: np.ndarray
    chi_squared: float
    converged: bool
    seconds: float


def run(*, full: bool) -> None:
    """Fit a lens in air and in vitreous, and print the results (`full` changes nothing)."""
    load_mitsuba()
    for medium in ("air", "vitreous"):
        show(_table(medium, fit_lens(medium)))


def fit_lens(medium: str) -> Fit:
    """Fit a lens to photon images at two distances in a medium."""
    from scenes.rendering import PhotonImage  # needs Mitsuba's variant

    scene = _scene(medium)
    data = _data(scene)[_INNER]
    measured, noise = data.mean(axis=1), data.var(axis=1) / _DATA_SEEDS
    level = np.maximum(measured, _DARK * measured.max(axis=(1, 2), keepdims=True))
    per_light = noise.sum(axis=(1, 2)) / measured.sum(axis=(1, 2))
    sigma = np.sqrt(per_light[:, None, None] * level)

    settings: Any = {"free": _FREE, "photons": _MODEL_PHOTONS}
    hosts = [
        [PhotonImage(scene, frame=frame, seed=seed, **settings) for frame in range(_FRAMES)]
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
    began = time.process_time()
    solution = least_squares(
        residual,
        jnp.asarray(start),
        count=measured.size,
        solver=FLOAT32_LEVENBERG_MARQUARDT,
    )
    seconds = time.process_time() - began

    seeds = [model(solution.parameters, [host.value for host in seed]) for seed in hosts]
    # The noise of neighbouring pixels is correlated, so it is propagated seed by seed.
    ours, theirs = (_blurred(x / sigma[:, None]) for x in (np.stack(seeds, axis=1), data))
    expected = ours.var(axis=1, ddof=1) + theirs.var(axis=1, ddof=1) / _DATA_SEEDS
    jacobian = np.asarray(jax.jacfwd(residual)(solution.parameters))
    variance = _variance(jacobian, ours) + _variance(jacobian, theirs) / _DATA_SEEDS
    return Fit(
        np.asarray(solution.parameters),
        np.sqrt(variance),
        truth,
        start,
        float(jnp.sum(solution.residuals**2)) / expected.sum(),
        bool(solution.converged),
        seconds,
    )


def _data(scene: Scene) -> np.ndarray:
    """Mitsuba's images of every frame, frames x seeds x H x W."""
    seeds = range(100, 100 + _DATA_SEEDS)
    settings: Any = {"photons_per_pixel": _PHOTONS_PER_PIXEL, "seeds": seeds}
    from scenes.rendering import glass_images  # needs Mitsuba's variant

    frames = [glass_images(scene, frame=frame, **settings) for frame in range(_FRAMES)]
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


def _scene(medium: str) -> Scene:
    content: dict[str, Any] = {
        "schema": 1,
        "phantom": {"wall": "uniform", "indirect": "off"},
        "source": {
            "kind": "photons",
            "lens": _LENS,
            "medium": medium,
            "photons_per_pixel": _PHOTONS_PER_PIXEL,
        },
        "instrument": {"visible": False},
        "motion": {"start_mm": 2.0, "travel_mm": 2.0, "frames": _FRAMES},
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


def _table(medium: str, fit: Fit) -> Table:
    state = "converged" if fit.converged else "NOT converged"
    made = table(
        f"lens '{_LENS}' in {medium}, {_FRAMES} frames of {_WIDTH} x {_HEIGHT} px",
        *("parameter", "truth", "start", "fitted", "sigma", "error / sigma"),
        caption=f"{state}, chi^2 / expected {fit.chi_squared:.3f}, {fit.seconds:.0f} s of CPU",
    )
    rows = zip(_NAMES, fit.truth, fit.start, fit.fitted, fit.sigma, strict=True)
    for name, truth, start, fitted, sigma in rows:
        numbers = (f"{truth:.5f}", f"{start:.5f}", f"{fitted:.5f}", f"{sigma:.5f}")
        made.add_row(name, *numbers, f"{(fitted - truth) / sigma:+.2f}")
    return made
