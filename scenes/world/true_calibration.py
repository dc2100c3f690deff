"""The calibration of a scene's own beam, as a fit without any error would find it."""

import hashlib
import json
from collections.abc import Mapping
from importlib.metadata import version

import numpy as np

from eyespot import optics
from eyespot.formats.calibration import LENS_PARAMETERS, Calibration
from eyespot.scenes.description.scene import Scene
from eyespot.scenes.world.world import World


def study_calibration(
    model: str,
    values: Mapping[str, float],
    *,
    medium: str,
    covariance: np.ndarray | None = None,
    fitted_on: str = "this study",
) -> Calibration:
    """A calibration for `estimator.Ranger`.

    Args:
        values: parameters of the model in the units of `QUANTITIES`.
        medium: a name in `optics.MEDIA`.
        covariance: covariance of the values; None if they are known exactly.
        fitted_on: origin of the values.
    """
    known = {name: float(value) for name, value in values.items()}
    return Calibration.of(
        model=model,
        values=known,
        covariance=np.zeros((len(known), len(known))) if covariance is None else covariance,
        medium=medium,
        medium_index=optics.MEDIA[medium],
        fitted_on=fitted_on,
        data_sha256=hashlib.sha256(json.dumps(known).encode()).hexdigest(),
        software=f"eyespot {version('eyespot')}",
    )


def true_calibration(scene: Scene) -> Calibration:
    """The true lens of a scene, or its ideal cone (model `exact`)."""
    if scene.source.kind == "cone":
        half_angle, apex_offset = World(scene).cone
        model, values = "exact", {"half_angle": half_angle, "b": apex_offset}
    else:
        lens = optics.load_lens(scene.source.lens)
        given = {name: getattr(lens, name) for name in LENS_PARAMETERS}
        model, values = "lens", {name: x for name, x in given.items() if x is not None}
    return study_calibration(
        model, values, medium=scene.source.medium, fitted_on="the scene as it is"
    )
