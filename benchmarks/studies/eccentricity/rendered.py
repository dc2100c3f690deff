"""The rendered part: frames, the spots measured in them, and what rendering adds to their size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

import optics
import scenes
from benchmarks.evaluation import (
    MODEL_ERROR,
    SUBPIXEL,
    Tracked,
    geometry_of,
    measured_errors,
    track_stack,
)
from benchmarks.reporting import Study
from benchmarks.studies.eccentricity import causes
from benchmarks.studies.eccentricity.causes import Shift
from benchmarks.studies.eccentricity.limits import refitted
from estimator import Stack
from scenes import Scene

_FINER = 2
"""Pixels of a noise-free frame for one of the camera's, along each side."""

_NOISE_FREE = {
    "camera.full_well_e": 1e9,
    "camera.read_noise_e": 0.0,
    "camera.dark_signal_e": 0.0,
    "camera.prnu": 0.0,
    "camera.dsnu_e": 0.0,
    "camera.bit_depth": 16,
    "camera.bayer": "none",
    "camera.jpeg_quality": 0,
}

_FEWEST_SPOTS = 3  # fewer do not determine c


class RenderedErrors(NamedTuple):
    """What the rendered part found.

    Attributes:
        errors: of all models on every measured spot, and of small_plane with c fitted.
        refits: a fit for each trial with enough spots, see `refitted`.
        shares: the errors by cause, for trials with a noise-free frame.
        frames: number of frames rendered for the errors.
        left_out: number of them without a spot that counts.
    """

    errors: pd.DataFrame
    refits: pd.DataFrame
    shares: pd.DataFrame
    frames: int
    left_out: int

    @property
    def with_true_c(self) -> pd.DataFrame:
        """The errors without those of a fitted c."""
        return self.errors[~self.errors.refit.astype(bool)]


class EccentricTrial(NamedTuple):
    """A withdrawal: one pinhole, incidence and eccentricity.

    Attributes:
        scene: with the instrument in view, or square to the wall and without it.
        noise_free: the same at twice the resolution without noise; None if not wanted.
    """

    name: str
    scene: Scene
    noise_free: Scene | None


def trials(
    scene: Scene,
    *,
    pinhole_heights: Sequence[float],
    eccentricities: Sequence[float],
    few: Sequence[float],
    frames: int,
) -> list[EccentricTrial]:
    """Withdrawals at the scene's incidence, and square ones without the instrument.

    Args:
        pinhole_heights: z_F, mm.
        eccentricities: c of the withdrawals at the scene's incidence, mm.
        few: those of them that are rendered without noise too, and with a square beam, which the
            instrument would hide.
    """
    return [
        _trial(scene, z_f=height, c=c, square=square, noise_free=c in few, frames=frames)
        for height in pinhole_heights
        for square, chosen in ((False, eccentricities), (True, few))
        for c in chosen
    ]


def measure(study: Study, every: Sequence[EccentricTrial]) -> RenderedErrors:
    """Render, track and compare."""
    wanted = {trial.name: trial.scene for trial in every}
    wanted |= {_fine(t): t.noise_free for t in every if t.noise_free is not None}
    spots = study.folder / "spots"
    spots.mkdir(exist_ok=True)

    def track(name: str, stack: Stack) -> Tracked:
        return track_stack(stack, SUBPIXEL, spots_file=spots / f"{name}.csv")

    tracked = study.measured(wanted, track)
    errors, refits, shares = [], [], []
    for trial in every:
        seen = tracked[trial.name]
        labels = seen.used_labels
        if labels:
            geometry = geometry_of(trial.scene)
            of_models = measured_errors(
                geometry, labels=labels, semi_minor_px=seen.semi_minor_px, models=optics.MODELS
            )
            errors.append(of_models)
            if len(labels) >= _FEWEST_SPOTS:
                rows, refit = refitted(
                    geometry,
                    before=of_models,
                    source="rendered",
                    medium=trial.scene.source.medium,
                    c=labels[0].c_mm,
                    d=np.array([row.d_mm for row in labels]),
                    semi_minor_px=seen.semi_minor_px,
                )
                errors.append(rows)
                refits.append(refit)
        if trial.noise_free is not None:
            of_trial = _shares(trial, seen, tracked[_fine(trial)])
            shares += [] if of_trial.empty else [of_trial]
    used = np.concatenate([tracked[trial.name].used for trial in every])
    return RenderedErrors(
        errors=pd.concat(errors, ignore_index=True)
        if errors
        else pd.DataFrame(columns=MODEL_ERROR),
        refits=pd.DataFrame(refits),
        shares=pd.concat(shares, ignore_index=True) if shares else pd.DataFrame(),
        frames=used.size,
        left_out=int(np.count_nonzero(~used)),
    )


def _trial(
    scene: Scene, *, z_f: float, c: float, square: bool, noise_free: bool, frames: int
) -> EccentricTrial:
    own = scenes.changed(
        scene,
        {
            "spot.eccentricity_mm": c,
            "microscope.pinhole_height_mm": z_f,
            "motion.kind": "withdrawal",
            "motion.start_mm": 0.5,
            "motion.travel_mm": 5.5,
            "motion.frames": frames,
            "exposures.kinds": ["metered"],
            **({"spot.incidence_deg": 0.0, "instrument.visible": False} if square else {}),
        },
    )
    view = own.microscope
    finer = {
        "microscope.scale_mm_px": view.scale_mm_px / _FINER,
        "microscope.width_px": view.width_px * _FINER,
        "microscope.height_px": view.height_px * _FINER,
    }
    kind = "square" if square else "tilted"
    again = scenes.changed(own, finer | _NOISE_FREE) if noise_free and not square else None
    return EccentricTrial(f"{kind}-pinhole-{z_f:g}-c-{c:g}", own, again)


def _fine(trial: EccentricTrial) -> str:
    return f"{trial.name}-noise-free"


def _shares(trial: EccentricTrial, seen: Tracked, noise_free: Tracked) -> pd.DataFrame:
    """The trial's errors by cause, in frames in which both measurements found the spot."""
    both = np.flatnonzero(seen.used & noise_free.used)
    if not both.size:
        return pd.DataFrame()
    measured, fine = (
        np.array([t.results[i].semi_minor_px for i in both])  # type: ignore[union-attr]
        for t in (seen, noise_free)
    )
    ideal = np.array([seen.labels[i].cone_semi_minor_px for i in both])
    fine, geometry = fine / _FINER, geometry_of(trial.scene)
    c = np.array([seen.labels[i].c_mm for i in both])
    d = np.array([seen.labels[i].d_mm for i in both])
    length = causes.spread_length(trial.scene)
    spread = causes.spread_shift(geometry, c=c, d=d, length=length)
    # A wall that spreads light does so in the frames already.
    edge = fine - ideal - (spread if trial.scene.phantom.spread != "none" else 0.0)
    return causes.shares(
        geometry,
        medium=trial.scene.source.medium,
        c=c,
        d=d,
        shift=Shift(edge=edge, pixels=measured - fine, spread=spread),
    )
