"""The choices of a fit: the options of `eyespot fit`, defined once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from cyclopts import Parameter
from pydantic import Field

from eyespot.estimator.run.options import Exposure, Given, RigChanges
from eyespot.formats.inputs import InputError, shortened

if TYPE_CHECKING:
    from eyespot.calibration.spots.cone_trials import Prior
    from eyespot.calibration.spots.paper_fits import Loss
    from eyespot.formats.calibration import Calibration

_T = TypeVar("_T")

_LARGEST = 1e12
"""Largest number of a prior, in any unit; its square is finite."""
_RIG = Parameter(group="Rig")


@Parameter(name="*")
class Choices(Given):
    """What is fitted, and the rig that recorded it."""

    model: Literal["auto", "cone", "eye", "plane", "sphere", "image", "lens"] = "auto"
    """Model to fit; auto chooses cone or lens by how sharp the spots' edges are. Fitted to spots:
    cone, the exact geometry; eye, how an unknown eye and its viewing lens show a cone that is known
    (--calibration); plane, the paper's line through planes; sphere, the paper's eccentricity of one
    eyeball, beside planes. Fitted to all pixels: image, a cone; lens, a lens."""
    exposure: Exposure = None
    free: Annotated[str | None, Parameter(metavar="NAME,…")] = None
    """Parameters to fit (default: half_angle,b; of a lens sag,numerical_aperture, without --lens
    core_radius,aperture_radius, too). A cone has half_angle, b, scale, eye_radius,
    inverse_working_distance, tilt_x, tilt_y; a lens has sag, numerical_aperture, glue_index and
    others. In the fits to pixels, spread is the length over which the wall spreads light.
    robot_scale, true distances over the robot's, needs a prior."""
    prior: Annotated[tuple[str, ...], Parameter(metavar="NAME=MEAN,SIGMA", show_default=False)] = ()
    """Prior knowledge of a fitted parameter (mm, rad), or of touch, the distance in the first
    frame. Repeatable."""
    robust: bool = False
    """Find outliers and fit without them (plane, sphere)."""
    lens: str | None = None
    """Preset or lens file to start the model lens from, within 30 % (default: guessed from the
    spots)."""
    calibration: Path | None = None
    """Calibration of the same fibre, made before. The fit starts from it, with its covariance as
    prior, and says what it learned; the model eye takes its cone, made on a phantom."""
    rig: Annotated[tuple[Path, ...], _RIG, Parameter(show_default=False)] = ()
    """Rig file, once or once per source in the same order (default: the stack's own)."""
    changes: Annotated[RigChanges, _RIG] = ()
    """Change a key of the rig files, such as wall.medium=air. Repeatable."""
    poses: Annotated[tuple[Path, ...], _RIG, Parameter(show_default=False)] = ()
    """Robot poses (CSV or ROS bag), one file per source in the same order; a stack contains its
    own, and a ROS bag may."""
    fps: Annotated[float | None, Field(gt=0), _RIG] = None
    """Images a second, of a folder without frames.csv (file,time_s,exposure_s) or of a TIFF."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names of --free; empty for the model's default."""
        return tuple(self.free.split(",")) if self.free is not None else ()

    @property
    def loss(self) -> Loss:
        """The loss function of the paper's fits."""
        return "huber" if self.robust else "squares"

    @cached_property
    def priors(self) -> dict[str, Prior]:
        """Normal distributions of parameters, and of `touch`, each trial's first distance.

        Raises:
            InputError: wrong format, or a sigma that is not positive.
        """
        from eyespot.calibration.spots.cone_trials import Prior

        found = {}
        for text in self.prior:
            name, _, numbers = text.partition("=")
            try:
                mean, sigma = map(float, numbers.split(","))
            except ValueError:
                mean = sigma = math.nan
            if not (abs(mean) <= _LARGEST and 1 / _LARGEST <= sigma <= _LARGEST):
                raise InputError(
                    f"--prior must be NAME=MEAN,SIGMA with a positive sigma, both of at most "
                    f"{_LARGEST:g}, such as eye_radius=11.5,0.2; got {shortened(text)}."
                )
            found[name] = Prior(mean, sigma)
        return found

    @cached_property
    def known(self) -> Calibration | None:
        """The calibration that was made before."""
        from eyespot.formats.calibration import read_calibration

        return read_calibration(self.calibration) if self.calibration else None


def one_each(name: str, given: Sequence[_T], count: int) -> Sequence[_T | None]:
    """What was given once, or once for each source; None for each if it was not given.

    Raises:
        InputError: another number.
    """
    if len(given) == 1 or not given:
        return [given[0] if given else None] * count
    if len(given) != count:
        raise InputError(
            f"{name} must be given once, or once per source ({count} here); got {len(given)}."
        )
    return given
