"""The models that `eyespot fit` knows, by name, and the choice of one from the spots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calibration.command.cone_model import fit_cone_to_spots
from calibration.command.fitted import Choices, Fitted
from calibration.command.paper_models import fit_planes, fit_sphere
from calibration.command.pixel_models import fit_image_of_cone, fit_image_of_lens
from calibration.pixels import CONE, FREE, known_names
from calibration.recordings import Recording
from calibration.spots import PARAMETERS

AUTO = "auto"
"""Name on the command line: choose the model from the spots."""

SOFT_EDGE = 0.1
"""Edge width over semi-minor axis above which a spot's edge is soft.

A cone's edge is as wide as the camera's blur: 1 px of 40 to 90 px in the renders, and 4 px at 40 px
would be a camera far out of focus. Behind a lens the edge is as wide as the core's image: for caps
of sag 0 to 0.12 mm and numerical apertures of 0.05 to 0.3, the upper quartile over 0.5 to 6 mm is
0.25 to 0.8.
"""


class Model(NamedTuple):
    """A model and what may be chosen about it.

    Attributes:
        fit: recordings in, result out.
        parameters: that --free knows.
        free: of these, by default.
        of_pixels: whether it is fitted to all pixels of one stack, and not to spots.
    """

    fit: Callable[[Sequence[Recording], Choices], Fitted]
    parameters: tuple[str, ...] = PARAMETERS
    free: tuple[str, ...] = CONE
    of_pixels: bool = False


MODELS = {
    "plane": Model(fit_planes),
    "sphere": Model(fit_sphere),
    "cone": Model(fit_cone_to_spots),
    "image": Model(fit_image_of_cone, known_names("cone"), FREE["cone"], of_pixels=True),
    "lens": Model(fit_image_of_lens, known_names("lens"), FREE["lens"], of_pixels=True),
}
"""By the name on the command line."""


class ModelChoice(NamedTuple):
    """A model's name, and in a sentence why it was chosen."""

    model: str
    reason: str


def chosen_model(recordings: Sequence[Recording]) -> ModelChoice:
    """The model for these spots: a lens if their edges are soft, a cone if they are sharp.

    Only measured spots are looked at. The upper quartile, because a lens too makes a sharp edge at
    the distance at which it shows its core.

    Raises:
        ValueError: the light is a lens's, and these are several recordings or no stack.
    """
    widths = np.concatenate([recording.relative_edge_width for recording in recordings])
    if np.isnan(widths).any():
        return ModelChoice("cone", "the spots' edges were not measured")
    width = float(np.quantile(widths, 0.75))
    seen = (
        f"the spots' edges are {{}}: {width:.2f} of the radius wide, a cone's at most {SOFT_EDGE}"
    )
    if width <= SOFT_EDGE:
        return ModelChoice("cone", seen.format("sharp"))
    if len(recordings) > 1 or not recordings[0].is_stack:
        raise ValueError(
            f"{seen.format('soft')}, so the light comes from a lens.\n"
            "A lens is fitted to the pixels of one stack: give one stack. To fit a cone all the "
            "same, add --model cone."
        )
    return ModelChoice("lens", seen.format("soft"))
