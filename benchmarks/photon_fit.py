"""A lens fitted through its own glass: photons behind the bridge, Levenberg-Marquardt in front.

Two programs that share no code of the lens make the two sides. Data: Mitsuba's particle tracer
through a dielectric cap. Model: `scenes.differentiable` behind `calibration.render_as_jax`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

import optics
from calibration._least_squares import least_squares
from calibration.render_bridge import FLOAT32_LEVENBERG_MARQUARDT, render_as_jax
from scenes import Scene, load_mitsuba
from scenes.motion import frame_times, trajectory

_LENS = "dome"
_FRAMES = 2
_DATA_SEEDS, _PHOTONS_PER_PIXEL = 16, 128
_MODEL_PHOTONS = 1 << 19
"""Of a frame. Far fewer make derivatives so noisy that steps come out short."""
_FREE = ("sag", "glue_length", "numerical_aperture", "tip_z", "power")
_NAMES = ("sag, mm", "numerical aperture", "tip height, mm", "power, mW")
_START_OFF = np.array([0.75, 1.3, 1.0, 1.3])
"""Start over truth; the tip starts 0.2 mm off."""
_TIP_OFF_MM = 0.2
_DARK = 0.01  # of the peak: darker pixels count as if they had this much light


class Fit(NamedTuple):
    """A fitted lens: parameters with their error, truth, and how the residuals compare."""

    fitted: np.ndarray
    sigma: np.ndarray
    truth: np.ndarray
    start: np.ndarray
    chi_squared: float
    converged: bool
    seconds: float


def main() -> None:
    """Print the tables, all from this run."""
    load_mitsuba()
    console = Console()
    for medium in ("air", "vitreous"):
        console.print(_table(medium, fit_lens(medium)))


def fit_lens(medium: str) -> Fit:
    """Fit a lens to photon images of three distances in a medium."""
    from scenes.differentiable import PhotonImage  # Mitsuba's variant is set by now

    scene = _scene(medium)
    data = np.stack(
        [
            in_spline_pixels(
                glass_images(
                    scene,
                    frame=frame,
                    photons_per_pixel=_PHOTONS_PER_PIXEL,
                    seeds=range(100, 100 + _DATA_SEEDS),
                )
            )
            for frame in range(_FRAMES)
        ]
    )
    measured, seeds = data.mean(axis=1), data - data.mean(axis=1, keepdims=True)
    level = np.maximum(measured, _DARK * measured.max(axis=(1, 2), keepdims=True))
    noise = np.mean(seeds**2, axis=1) * _DATA_SEEDS / (_DATA_SEEDS - 1)
    per_light = np.sum(noise, axis=(1, 2)) / np.sum(measured, axis=(1, 2))
    # Of a mean over the seeds; the model's photons add their own.
    fresh = _PHOTONS_PER_PIXEL * measured[0].size * _DATA_SEEDS / _MODEL_PHOTONS
    inflation = (1 + fresh) / _DATA_SEEDS
    sigma = np.sqrt(per_light[:, None, None] * level * inflation)

    hosts = [
        PhotonImage(scene, free=_FREE, photons=_MODEL_PHOTONS, frame=frame, seed=1)
        for frame in range(_FRAMES)
    ]
    images = [render_as_jax(h.value, h.value_and_jacobian, shape=h.shape) for h in hosts]
    sag, length, aperture, _, power = hosts[0].start
    gap = length - sag
    truth = np.array([sag, aperture, 0.0, power])

    def residual(parameters: jax.Array) -> jax.Array:
        sag, aperture, offset, power = parameters
        rows = []
        for host, image, seen, error in zip(hosts, images, measured, sigma, strict=True):
            # The drop grows with its cap: the core's face stays where it is.
            values = jnp.stack([sag, sag + gap, aperture, host.start[3] + offset, power])
            rows.append((image(values)[..., 0] - seen) / error)
        return jnp.concatenate(rows, axis=None)

    start = truth * _START_OFF + np.array([0, 0, _TIP_OFF_MM, 0])
    began = time.perf_counter()
    solution = least_squares(
        residual,
        jnp.asarray(start),
        count=measured.size,
        solver=FLOAT32_LEVENBERG_MARQUARDT,
    )
    seconds = time.perf_counter() - began
    # What each seed's noise would do to the parameters: neighbours' noise hangs together.
    jacobian = np.asarray(jax.jacfwd(residual)(solution.parameters))
    to_parameters = np.linalg.solve(jacobian.T @ jacobian, jacobian.T)
    shifts = (
        to_parameters @ (seeds / sigma[:, None]).transpose(1, 0, 2, 3).reshape(_DATA_SEEDS, -1).T
    )
    spread = np.sqrt(np.sum(shifts**2, axis=1) / (_DATA_SEEDS - 1) * inflation)
    return Fit(
        np.asarray(solution.parameters),
        spread,
        truth,
        start,
        float(jnp.sum(solution.residuals**2)) / measured.size,
        bool(solution.converged),
        seconds,
    )


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
            "width_px": 64,
            "height_px": 48,
            "scale_mm_px": 0.05,
        },
    }
    return Scene.model_validate(content)


def glass_images(
    scene: Scene, *, frame: int, photons_per_pixel: int, seeds: Iterable[int]
) -> np.ndarray:
    """Images of a frame by Mitsuba's particle tracer and its own glass, seeds x H x W.

    Args:
        scene: of kind "photons", with a uniform wall.
        frame: of its motion.
        photons_per_pixel: leaving the core.
        seeds: of independent images.
    """
    mi = load_mitsuba()
    from scenes import build
    from scenes.photons import photon_image

    # Photons know nothing of the table, which takes half a minute to make.
    index = jnp.asarray(optics.MEDIA[scene.source.medium])
    empty = optics.IrradianceTable(jnp.zeros((2, 2, 2)), index, jnp.zeros(()), jnp.zeros(()))
    loaded = mi.load_dict(build.mitsuba_dict(scene, table=empty, uniform=np.zeros(3)))
    motion = trajectory(scene)
    pose = motion.at(frame_times(scene, motion)[frame : frame + 1])
    parameters = mi.traverse(loaded)
    parameters.update(
        build.pose_parameters(scene, tip=pose.tip[0], axis=pose.axis[0], apex=pose.tip[0])
    )
    images = [photon_image(loaded, photons_per_pixel=photons_per_pixel, seed=s) for s in seeds]
    return np.stack(images)[..., 0]


def in_spline_pixels(images: np.ndarray) -> np.ndarray:
    """Box pixels to quadratic-spline pixels, which are boxes blurred by a tent.

    The tent's second moment, 1/6 px^2, is that of (1, 10, 1)/12; light is smooth over a pixel.

    Args:
        images: of box pixels, n x H x W, dark at the edge.
    """
    for axis in (-2, -1):
        images = (10 * images + np.roll(images, 1, axis) + np.roll(images, -1, axis)) / 12
    return images


def _table(medium: str, fit: Fit) -> Table:
    table = Table(title=f"lens '{_LENS}' in {medium}, {_FRAMES} frames of 64 x 48 px")
    for heading in ("parameter", "truth", "start", "fitted", "sigma", "error / sigma"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    rows = zip(_NAMES, fit.truth, fit.start, fit.fitted, fit.sigma, strict=True)
    for name, truth, start, fitted, sigma in rows:
        numbers = (f"{truth:.5f}", f"{start:.5f}", f"{fitted:.5f}", f"{sigma:.5f}")
        table.add_row(name, *numbers, f"{(fitted - truth) / sigma:+.2f}")
    state = "converged" if fit.converged else "NOT converged"
    table.caption = f"{state}, chi^2/n {fit.chi_squared:.3f}, {fit.seconds:.0f} s"
    return table


if __name__ == "__main__":
    main()
