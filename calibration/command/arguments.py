"""Command-line text of `eyespot fit` converted to values: priors, rotation, log books."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import optics
from calibration.recordings import LogBook
from calibration.spots import Prior
from estimator.files import Quaternion, unit_quaternion
from optics import InputError, shortened

_T = TypeVar("_T")

_LARGEST = 1e12  # of a prior, in any unit; its square is finite


def read_priors(given: Iterable[str]) -> dict[str, Prior]:
    """`--prior NAME=MEAN,SIGMA`, each a normal distribution.

    Raises:
        InputError: wrong format, or a sigma that is not positive.
    """
    found = {}
    for text in given:
        name, _, numbers = text.partition("=")
        try:
            mean, sigma = map(float, numbers.split(","))
        except ValueError:
            mean = sigma = math.nan
        if not (abs(mean) <= _LARGEST and 1 / _LARGEST <= sigma <= _LARGEST):
            raise InputError(
                f"--prior must be NAME=MEAN,SIGMA with a positive sigma, both of at most "
                f"{_LARGEST:g}, such as "
                f"eye_radius=11.5,0.2; got {shortened(text)}."
            )
        found[name] = Prior(mean, sigma)
    return found


def read_rotation(text: str | None) -> Quaternion:
    """`--eye-from-robot QX,QY,QZ,QW`, a unit quaternion (default: no rotation).

    Raises:
        InputError: not a unit quaternion.
    """
    if text is None:
        return (0.0, 0.0, 0.0, 1.0)
    try:
        x, y, z, w = map(float, text.split(","))
        return unit_quaternion((x, y, z, w))
    except ValueError:
        raise InputError(
            f"--eye-from-robot must be a unit quaternion QX,QY,QZ,QW; got {shortened(text)}."
        ) from None


def log_books(
    sources: Sequence[Path],
    microscope: Path | None,
    poses: Sequence[Path],
    phantoms: Sequence[str],
    medium: str | None,
    fibre_diameter_mm: float,
    eye_from_robot: Quaternion,
) -> dict[Path, LogBook]:
    """The log book of each source that is not a stack; a stack contains its own.

    Raises:
        InputError: an option is missing, or does nothing because all sources are stacks.
    """
    if not sources:
        for option, said in (
            ("--microscope", microscope),
            ("--poses", poses),
            ("--phantom", phantoms),
            ("--medium", medium),
        ):
            if said:
                raise InputError(f"{option} does nothing: a stack contains its own. Leave it out.")
        return {}
    if microscope is None or medium is None or not phantoms:
        raise InputError(
            f"{sources[0]} is no stack, so the fit needs --microscope, --phantom and --medium, and "
            "--poses unless the source is a bag. Add them."
        )
    if medium not in optics.MEDIA:
        raise InputError(
            f"--medium must be one of {', '.join(optics.MEDIA)}; got {shortened(medium)}."
        )
    kinds = _one_each("--phantom", phantoms, sources)
    # A bag of images also contains the poses, unless a file is given.
    tracks = _one_each("--poses", poses, sources) if poses else list(sources)
    return {
        source: LogBook(
            kind=kind,
            medium=medium,
            fibre_diameter_mm=fibre_diameter_mm,
            microscope=microscope,
            poses=track,
            eye_from_robot=eye_from_robot,
        )
        for source, kind, track in zip(sources, kinds, tracks, strict=True)
    }


def _one_each(option: str, given: Sequence[_T], sources: Sequence[Path]) -> Sequence[_T]:
    if len(given) == 1:
        return [*given] * len(sources)
    if len(given) != len(sources):
        raise InputError(
            f"{option} must be given once, or once per source other than a stack ({len(sources)} "
            f"here); got {len(given)}."
        )
    return given
