"""Lenses fitted to stacks that photons made: how far off, in standard errors of the fit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from eyespot.calibration.command.fit_verdict import Fitted, PixelResiduals, doubts, verdict
from eyespot.calibration.pixels.fit import fit_image
from eyespot.calibration.pixels.fit_result import ImageFit
from tests.support.light.photon_frames import footage_of, photographed, widened
from tests.support.light.photon_stacks import Recording
from tests.support.light.photons import Drop

PARAMETERS = ("sag", "numerical_aperture", "sensitivity")
"""`sensitivity` is the brightness: power and reflectance are fixed at their true values."""
LEAN = math.radians(1.0)
BORESIGHT = math.radians(3.0)
TOUCH_MM = 0.02
"""Scatter of what a fit knows in advance; its priors have these standard deviations."""
_SMALL: dict[str, Any] = {"frames": 10, "width": 96, "height": 72}
"""Some 15 million photons, which take 2 to 4 s."""
_START_OFF = 0.26

_DROP = Drop(core=0.25, aperture=0.30, sag=0.07, rim=0.04, aperture_na=0.15)


def departures() -> list[Recording]:
    """Recordings of one lens, each with light that the model does not know."""
    air = Recording(drop=_DROP, **_SMALL, scale=0.035)
    vitreous = dataclasses.replace(air, medium="vitreous", scale=0.02)
    return [
        dataclasses.replace(air, drop=dataclasses.replace(_DROP, gaussian=True)),
        dataclasses.replace(vitreous, drop=dataclasses.replace(_DROP, shift=0.02)),
        dataclasses.replace(air, drop=dataclasses.replace(_DROP, tilt=math.radians(2.0))),
        dataclasses.replace(vitreous, spread=0.05),
        dataclasses.replace(air, texture=0.02),
    ]


def random_recording(seed: int) -> Recording:
    """A lens, wall and medium at random; frames as wide as the light."""
    rng = np.random.default_rng([26, seed])
    core = rng.uniform(0.15, 0.30)
    aperture = rng.uniform(core, 0.35)
    drop = Drop(
        core=core,
        aperture=aperture,
        sag=aperture * rng.uniform(0.05, 1.0),
        rim=rng.uniform(0.0, 0.4),
        aperture_na=rng.uniform(0.05, 0.30),
        index=rng.uniform(1.45, 1.55),
    )
    recording = Recording(
        drop=drop,
        medium=str(rng.choice(["air", "vitreous"])),
        wall=str(rng.choice(["plane", "eyeball"])),
        eccentricity=rng.uniform(0.0, 3.0),
        azimuth=rng.uniform(-np.pi, np.pi),
        incidence=rng.uniform(0.0, 0.6),
        incidence_azimuth=rng.uniform(-np.pi, np.pi),
        beam_off=tuple(BORESIGHT * rng.standard_normal(2)),
        lean=tuple(LEAN * rng.standard_normal(2)),
        touch_off=TOUCH_MM * rng.standard_normal(),
        pinhole=float(rng.choice([11.5, 200.0])),
        **_SMALL,
    )
    return widened(recording, 0.9, rng)


def fitted(recording: Recording, seed: int) -> ImageFit:
    """Photons, photographs and a fit from a start that is 26 % off."""
    rng = np.random.default_rng([27, seed])
    footage = footage_of(recording, photographed(recording, rng))
    drop = recording.drop
    off = 1 + _START_OFF * rng.choice([-1.0, 1.0], 2)
    start = {
        "core_radius": drop.core,
        "aperture_radius": drop.aperture,
        "rim_height": drop.rim,
        "glue_index": drop.index,
        "sag": min(drop.sag * off[0], drop.aperture),
        "numerical_aperture": drop.aperture_na * off[1],
    }
    return fit_image(footage, source="lens", start=start)


def result(recording: Recording, seed: int) -> dict[str, Any]:
    """The verdict, and each parameter's relative error and standard error."""
    fit = fitted(recording, seed)
    nothing = np.zeros(0)
    found = doubts(
        Fitted(
            calibration_model="lens",
            values={},
            covariance=np.zeros((0, 0)),
            converged=fit.converged,
            failed=fit.failed,
            undetermined=fit.undetermined,
            chi_squared=fit.chi_squared,
            degrees_of_freedom=fit.degrees_of_freedom,
            residuals={},
            recordings=[],
            used=0,
            pixels=PixelResiduals(nothing, [], nothing.astype(int), nothing, fit.misfit),
        )
    )
    good = all(doubt.fault.harmless for doubt in found)
    truth = {
        "sag": recording.drop.sag,
        "numerical_aperture": recording.drop.aperture_na,
        "sensitivity": recording.sensitivity,
    }
    return {
        "good": good,
        "said": verdict(found) if good else "; ".join(doubt.reason for doubt in found),
        **{
            name: [(fit.parameters[name][0] - true) / true, fit.parameters[name][1] / true]
            for name, true in truth.items()
        },
    }


def results(recordings: Iterable[Recording]) -> pd.DataFrame:
    return pd.DataFrame([result(recording, n) for n, recording in enumerate(recordings)])
