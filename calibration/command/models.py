"""The models of `eyespot fit` by name, and the automatic choice of one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calibration.command.cone_model import fit_cone_to_spots
from calibration.command.eye_model import EYE, fit_eye
from calibration.command.fitted import Choices, Fitted
from calibration.command.paper_models import fit_planes, fit_sphere
from calibration.command.pixel_models import fit_image_of_cone, fit_image_of_lens
from calibration.pixels import CONE, FREE, known_names
from calibration.recordings import Recording
from calibration.spots import PARAMETERS
from optics import InputError

AUTO = "auto"
"""Name on the command line that chooses the model from the spots."""

SOFT_EDGE = 0.1
"""Edge width over semi-minor axis above which a spot's edge is soft.

A cone's edge is as wide as the camera's blur: 1 px for radii of 40 to 90 px in the renders. A blur
of 4 px would be a camera far out of focus. With a lens the edge is as wide as the core's image: for
caps of sag 0 to 0.12 mm and numerical apertures of 0.05 to 0.3, the upper quartile over distances
of 0.5 to 6 mm is 0.25 to 0.8.
"""


class Model(NamedTuple):
    """A model and its selectable parameters.

    Attributes:
        fit: function from recordings to the result.
        parameters: names that --free accepts.
        free: default of --free.
        of_pixels: whether the model is fitted to all pixels of one stack instead of to spots.
    """

    fit: Callable[[Sequence[Recording], Choices], Fitted]
    parameters: tuple[str, ...] = PARAMETERS
    free: tuple[str, ...] = CONE
    of_pixels: bool = False


MODELS = {
    "plane": Model(fit_planes),
    "sphere": Model(fit_sphere),
    "cone": Model(fit_cone_to_spots),
    "eye": Model(fit_eye, EYE, EYE),
    "image": Model(fit_image_of_cone, known_names("cone"), FREE["cone"], of_pixels=True),
    "lens": Model(fit_image_of_lens, known_names("lens"), FREE["lens"], of_pixels=True),
}
"""Models by their names on the command line."""


class ModelChoice(NamedTuple):
    """A model's name and the reason for its choice, as a sentence."""

    model: str
    reason: str


def chosen_model(recordings: Sequence[Recording]) -> ModelChoice:
    """Choose a lens if the spots' edges are soft, and a cone if they are sharp.

    Uses measured spots only. Uses the upper quartile of the edge widths, because a lens also makes
    a sharp edge at the distance where it images its core.

    Raises:
        InputError: the spots need a lens, but there are several recordings or no stack.
    """
    widths = np.concatenate([recording.relative_edge_width for recording in recordings])
    if np.isnan(widths).any():
        return ModelChoice("cone", "the spots' edges were not measured")
    width = float(np.quantile(widths, 0.75))
    seen = (
        f"the spots' edges are {{}}: {width:.2f} of the radius wide (a cone's: at most {SOFT_EDGE})"
    )
    if width <= SOFT_EDGE:
        return ModelChoice("cone", seen.format("sharp"))
    if len(recordings) > 1 or not recordings[0].is_stack:
        raise InputError(
            f"{seen.format('soft')}, so the light comes from a lens.\n"
            "A lens is fitted to the pixels of one stack: give one stack. To fit a cone instead, "
            "add --model cone."
        )
    return ModelChoice("lens", seen.format("soft"))
