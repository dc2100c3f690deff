"""Many random eyes calibrated as at the table, and distances read with each calibration.

Withdrawals at three eccentricities through an unknown eye and a viewing lens, by a robot whose axis
errs by half a degree and whose touches err by 0.05 mm; then spots elsewhere in the same eye. The
spots come from rays traced through the surfaces of each eye onto its own ellipsoidal retina. The
fit knows none of these.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array

from eyespot import optics
from eyespot.benchmarks.studies.eye_paths import cameras, drawn
from eyespot.calibration.command.choices import Choices
from eyespot.calibration.command.fit_verdict import Fitted
from eyespot.calibration.command.spot_models import fit_eye
from eyespot.calibration.recorded_trial import RecordedTrial
from eyespot.calibration.spots.cone_trials import ConeTrial, Prior
from eyespot.estimator.distance.ranger import Ranger
from eyespot.estimator.recording import Recording
from eyespot.estimator.sources.source import Source
from eyespot.formats.calibration import Calibration
from eyespot.formats.rig import Rig
from eyespot.formats.spot import Spot
from eyespot.optics.viewing.projection import PathCamera
from tests.support.drawn.exact_spots import Place, exact_spots
from tests.support.drawn.made_up import a_calibration, a_microscope, a_spot

HALF_ANGLE, B = math.atan(1 / 20), -5.117
CONE_SIGMA = np.array([5e-4 * HALF_ANGLE, 0.005])
"""Of a calibration on phantoms (docs/findings.md: 0.05 %, 0.004 mm)."""
SIGMA_PX = 0.05
AXIS_SIGMA, TOUCH = math.radians(0.5), Prior(0.12, 0.05)
WITHDRAWN_C_MM = (0.5, 1.5, 3.0)
READ_C_MM = (1.0, 2.0, 3.0)
DISTANCES = np.linspace(TOUCH.mean, 5.0, 12)
TILT = math.radians(25.0)

MICROSCOPE = a_microscope(
    scale_mm_px=0.0065, principal_point_px=(0.0, 0.0), pinhole_height_mm=200.0
)
"""What the table knows of the microscope: a pinhole far above, and a scale that is 3 % off."""


def seen(
    camera: PathCamera, semi_axes: Array, places: list[Place]
) -> tuple[np.ndarray, np.ndarray]:
    """Ellipses, n x 5, and axes of beams at (c, azimuth, incidence, its azimuth, d)."""
    ellipses, beams = exact_spots(
        optics.Ellipsoid(semi_axes), camera, places, half_angle=HALF_ANGLE, b=B
    )
    return np.column_stack(ellipses), beams.axis


RIG = Rig().changed({"robot.scale_sigma": 0.0, "robot.clock_sigma_s": 0.0})
"""The robot's scale and clock are drawn without errors, so none are stated."""


def covariance(ellipse: np.ndarray) -> np.ndarray:
    """White noise of 0.05 px on centre and axes; the angle's noise moves the contour as far."""
    sigma = np.full(5, SIGMA_PX)
    sigma[4] /= max(ellipse[2] - ellipse[3], SIGMA_PX)
    return np.diag(sigma**2)


def turned(axis: np.ndarray, by: np.ndarray) -> np.ndarray:
    """The axis turned along its two perpendiculars, rad."""
    found = axis + by @ np.stack([np.asarray(v) for v in optics.perpendicular_frame(axis)])
    return found / np.linalg.norm(found)


def recording(
    ellipses: np.ndarray, axis: np.ndarray, noise: np.random.Generator, errors: float
) -> RecordedTrial:
    """A withdrawal as the table records it; `errors` 0 leaves out every error."""
    covariances = np.stack([covariance(row) for row in ellipses])
    sigma = np.sqrt(np.einsum("nii->ni", covariances))
    seen = ellipses + errors * sigma * noise.standard_normal(ellipses.shape)
    touched = TOUCH.mean + errors * TOUCH.sigma * noise.standard_normal()
    told = turned(axis, errors * AXIS_SIGMA * noise.standard_normal(2))
    return RecordedTrial(
        name="withdrawal",
        recording=Recording(Source(name="withdrawal", read=lambda: iter(())), rig=RIG),
        trial=ConeTrial(
            ellipses=optics.Ellipse(*map(jnp.asarray, (seen[:, :2], *seen[:, 2:].T))),
            covariances=covariances,
            coverage=np.ones(len(DISTANCES)),
            # The tip started at `touched`, and the fit believes in `TOUCH`.
            readings=DISTANCES - touched,
            axis=told,
            principal_point=np.zeros(2),
            touch=TOUCH,
            kind="eyeball",
        ),
        tilt=(0.0, 0.0),
        across=np.eye(3)[:2],
        frames=len(ellipses),
        microscope=MICROSCOPE,
        medium="vitreous",
        fibre_radius_mm=0.25,
        sha256="0" * 64,
    )


def calibration(values: dict[str, float], matrix: np.ndarray, model: str) -> Calibration:
    """In vitreous."""
    medium = {"medium": "vitreous", "medium_index": 1.336}
    return a_calibration(values, covariance=matrix, model=model, **medium)


def fitted(
    trials: list[RecordedTrial], cone: np.ndarray, priors: dict[str, Prior] | None = None
) -> Fitted:
    """The calibration of an eye with a cone (half_angle, b) that was calibrated before."""
    values = {"half_angle": float(cone[0]), "b": float(cone[1])}
    known = calibration(values, np.diag(CONE_SIGMA**2), "exact")
    given = tuple(f"{name}={mean!r},{sigma!r}" for name, (mean, sigma) in (priors or {}).items())
    return fit_eye(trials, Choices(prior=given), known)


def eyes(count: int, *, seed: int, path: str):
    """Cameras and retinas of random eyes behind one path; the pupil hides nothing."""
    group = drawn(count, seed).eyes()
    every = cameras(path, group, jnp.asarray(50.0))
    for n in range(count):
        yield jax.tree.map(lambda leaf, n=n: leaf[n], every), group.retina_semi_axes[n]


def calibrated_eyes(count: int, *, seed: int = 0, path: str = "flat, phakic") -> pd.DataFrame:
    """Calibrate random eyes and read a distance at each of `READ_C_MM` in them; a row an eye.

    `errors_mm` and `sigmas_mm` are those of the distances; `kappa_pull` is the error of the fitted
    kappa over its standard error, against a fit without any error or prior of the retina.
    """
    return pd.DataFrame(
        _calibrated(camera, semi_axes, np.random.default_rng([seed, n]))
        for n, (camera, semi_axes) in enumerate(eyes(count, seed=seed, path=path))
    )


def _calibrated(camera: PathCamera, semi_axes: Array, noise: np.random.Generator) -> dict[str, Any]:
    withdrawn = [
        (c, azimuth, TILT, towards, d)
        for c, azimuth, towards in zip(
            WITHDRAWN_C_MM, *(2 * np.pi * noise.random((2, 3))), strict=True
        )
        for d in DISTANCES
    ]
    read = [
        (c, azimuth, TILT * tilt, towards, 0.5 + 4.5 * d)
        for c, azimuth, towards, tilt, d in zip(
            READ_C_MM, *(2 * np.pi * noise.random((2, 3))), *noise.random((2, 3)), strict=True
        )
    ]
    ellipses, axes = seen(camera, semi_axes, withdrawn + read)

    def trials(errors: float) -> list[RecordedTrial]:
        return [
            recording(ellipses[k : k + DISTANCES.size], axes[k], noise, errors)
            for k in range(0, len(withdrawn), DISTANCES.size)
        ]

    cone = np.array([HALF_ANGLE, B])
    best = fitted(trials(0.0), cone, {"eye_radius": Prior(13.0, 100.0)})
    fit = fitted(trials(1.0), cone + CONE_SIGMA * noise.standard_normal(2))
    own = calibration(fit.values, fit.covariance, fit.calibration_model)
    ranger = Ranger(own, MICROSCOPE)
    ranges = [
        ranger.distance(
            measured(ellipse, noise),
            axis=turned(axis, AXIS_SIGMA * noise.standard_normal(2)),
            axis_sigma_rad=AXIS_SIGMA,
        )
        for ellipse, axis in zip(ellipses[len(withdrawn) :], axes[len(withdrawn) :], strict=True)
    ]
    kappa = "inverse_working_distance"
    return {
        "errors_mm": np.array([r.distance_mm for r in ranges]) - [row[-1] for row in read],
        "sigmas_mm": np.array([r.sigma_mm for r in ranges]),
        "kappa_pull": (fit.values[kappa] - best.values[kappa]) / own.sigma(kappa),
    }


def measured(ellipse: np.ndarray, noise: np.random.Generator) -> Spot:
    """A spot with noise."""
    matrix = covariance(ellipse)
    shift = np.sqrt(np.diag(matrix)) * noise.standard_normal(5)
    return a_spot(*(ellipse + shift).tolist(), covariance=matrix)


def pulls(found: pd.DataFrame) -> pd.DataFrame:
    """Errors over stated standard deviations, by what was measured; a row an eye."""
    names = [f"d at c = {c:g} mm" for c in READ_C_MM]
    table = pd.DataFrame([*(found.errors_mm / found.sigmas_mm)], columns=names)
    return table.assign(kappa=found.kappa_pull)
