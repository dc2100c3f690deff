"""The choices of a fit: the options of `eyespot fit`, defined once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from cyclopts import Parameter
from pydantic import Field

from eyespot.estimator.run.options import Exposure, Given, Options
from eyespot.formats.inputs import InputError, shortened

if TYPE_CHECKING:
    from eyespot.calibration.recordings import LogBook
    from eyespot.calibration.spots.cone_trials import Prior
    from eyespot.calibration.spots.paper import Loss
    from eyespot.formats.calibration import Calibration
    from eyespot.formats.poses import Quaternion

_T = TypeVar("_T")

_LARGEST = 1e12
"""Largest number of a prior, in any unit; its square is finite."""
_ELSEWHERE = Parameter(group="Sources other than stacks")


@Parameter(name="*")
class Choices(Given):
    """What is fitted, and where sources other than stacks were recorded."""

    model: Literal["auto", "cone", "eye", "plane", "sphere", "image", "lens"] = "auto"
    """Model to fit; auto chooses cone or lens by how sharp the spots' edges are. Fitted to spots:
    cone, the exact geometry; eye, how an unknown eye and its viewing lens show a cone that is known
    (--calibration); plane, the paper's line through planes; sphere, the paper's eccentricity of one
    eyeball, beside planes. Fitted to all pixels of one stack: image, a cone; lens, a glue lens."""
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
    microscope: Annotated[Path | None, _ELSEWHERE] = None
    """Microscope file of the sources; a stack contains its own."""
    poses: Annotated[tuple[Path, ...], _ELSEWHERE, Parameter(show_default=False)] = ()
    """Robot poses (CSV or ROS bag), one file per source in the same order; a stack contains its
    own, and a ROS bag may."""
    phantom: Annotated[
        tuple[str, ...], _ELSEWHERE, Parameter(metavar="plane|eyeball", show_default=False)
    ] = ()
    """Shape of the wall, given once or once per source; a stack contains it."""
    medium: Annotated[str | None, _ELSEWHERE] = None
    """Medium between tip and wall: air, water, …; a stack contains it."""
    fibre_diameter_mm: Annotated[float, Field(gt=0), _ELSEWHERE] = 0.5
    """Diameter of the tip's face, whose rim touches the wall first; a stack contains it."""
    eye_from_robot: Annotated[
        str | None, _ELSEWHERE, Parameter(metavar="QX,QY,QZ,QW", allow_leading_hyphen=True)
    ] = None
    """Rotation (unit quaternion) from the poses' frame to the eye's."""

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

    @property
    def rotation(self) -> Quaternion:
        """The unit quaternion of --eye-from-robot."""
        given = Options.of({"eye_from_robot": self.eye_from_robot})
        return given.eye_from_robot or (0.0, 0.0, 0.0, 1.0)

    def log_books(self, sources: Sequence[Path]) -> dict[Path, LogBook]:
        """The log book of each source that is not a stack; a stack contains its own.

        Raises:
            InputError: an option is missing, or does nothing because all sources are stacks.
        """
        from eyespot import optics
        from eyespot.calibration.recordings import LogBook

        if not sources:
            for name in ("microscope", "poses", "phantom", "medium", "eye_from_robot"):
                if getattr(self, name):
                    raise InputError(
                        f"--{name.replace('_', '-')} does nothing: a stack contains its own. Leave "
                        "it out."
                    )
            return {}
        if self.microscope is None or self.medium is None or not self.phantom:
            raise InputError(
                f"{sources[0]} is no stack, so the fit needs --microscope, --phantom and --medium, "
                "and --poses unless the source is a bag. Add them."
            )
        if self.medium not in optics.MEDIA:
            raise InputError(
                f"--medium must be one of {', '.join(optics.MEDIA)}; got {shortened(self.medium)}."
            )
        kinds = _one_each("--phantom", self.phantom, sources)
        # A bag of images also contains the poses, unless a file is given.
        tracks = _one_each("--poses", self.poses or tuple(sources), sources)
        return {
            source: LogBook(
                kind=kind,
                medium=self.medium,
                fibre_diameter_mm=self.fibre_diameter_mm,
                microscope=self.microscope,
                poses=track,
                eye_from_robot=self.rotation,
            )
            for source, kind, track in zip(sources, kinds, tracks, strict=True)
        }


def _one_each(option: str, given: tuple[_T, ...], sources: Sequence[Path]) -> tuple[_T, ...]:
    if len(given) == 1:
        return given * len(sources)
    if len(given) != len(sources):
        raise InputError(
            f"{option} must be given once, or once per source other than a stack ({len(sources)} "
            f"here); got {len(given)}."
        )
    return given
