"""Stacks as trials: spots measured by the estimator, readings and axis from the robot's report.

The labels of a stack stay unread, but for each frame's time: what is fitted is what a rig would
have. What else is used, a rig's log book would say: the wall's kind and the medium.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import optics
from calibration._cone_fit import Prior, Trial, phantom_wall
from estimator import Spot, read_poses, read_stack, track_source
from estimator.microscope_file import MicroscopeFile, read_microscope
from estimator.options import Options
from estimator.sources import open_source

_FEWEST_SPOTS = 3
_TOUCH_SIGMA_MM = 0.02
"""How well a hand finds the moment of contact; the paper's own trials scatter by more."""
_LEAST_COVERAGE = 0.5
"""Of the contour: with less, the ellipse rests on its model (as in the paper's trials here)."""


class Recording(NamedTuple):
    """A stack, ready to be fitted.

    Attributes:
        name: of its folder.
        trial: spots, readings and axis.
        frames: number of frames, with a usable spot or without.
        microscope: as the stack describes it.
        medium: name of what lies between the tip and the wall.
        sha256: of the stack's manifest, which holds the checksums of all its files.
    """

    name: str
    trial: Trial
    frames: int
    microscope: MicroscopeFile
    medium: str
    sha256: str


def read_recording(folder: Path, *, exposure: str | None = None) -> Recording:
    """Track a stack and join its spots with the robot's poses.

    A withdrawal begins where the tip touches the wall: readings count from the first frame, along
    the mean axis that the robot reports.

    Args:
        folder: the stack.
        exposure: "paper" or "metered", where the stack holds both.

    Raises:
        ValueError: no stack, no report of the robot, or too few spots to fit.
    """
    folder = Path(folder)
    stack = read_stack(folder)
    source = open_source(folder, exposure=exposure)
    records = track_source(source, Options(microscope=source.microscope_file).reader()).records
    poses = read_poses(folder / "kinematics.csv")
    known = [poses.at(record.time_s) for record in records]
    if None in known:
        raise ValueError(
            f"{folder / 'kinematics.csv'} begins after the first frame. Record the robot's poses "
            "from before the camera starts."
        )
    seen = [pose for pose, _ in filter(None, known)]
    axis = np.mean([pose.axis for pose in seen], axis=0)
    axis /= np.linalg.norm(axis)
    gone = np.array([pose.position_mm for pose in seen])
    readings = (gone[0] - gone) @ axis
    usable = [
        (record.result, reading)
        for record, reading in zip(records, readings, strict=True)
        if isinstance(record.result, Spot) and record.result.coverage >= _LEAST_COVERAGE
    ]
    if len(usable) < _FEWEST_SPOTS:
        raise ValueError(
            f"{folder} has {len(usable)} usable spots in {len(records)} frames; a fit needs "
            f"{_FEWEST_SPOTS}. See why with `eyespot track {folder} --out spots.csv`."
        )
    spots = [spot for spot, _ in usable]
    scene = stack.description["scene"]
    microscope = read_microscope(folder / "microscope.json")
    ellipses = _ellipses(spots)
    wall = phantom_wall(scene["phantom"]["kind"], eye_radius=microscope.eye_radius_mm)
    normal = wall.intersect(*microscope.ideal_microscope().ray(ellipses.centre[0])).normal
    # The rim of a tilted tip touches before its centre does.
    touch = optics.contact_distance(
        wall,
        incidence=jnp.arccos(-normal @ axis),
        rim_radius=scene["instrument"]["fibre_diameter_mm"] / 2,
    )
    return Recording(
        name=folder.name,
        trial=Trial(
            ellipses=ellipses,
            covariances=np.stack([spot.covariance for spot in spots]),
            readings=np.array([reading for _, reading in usable]),
            axis=axis,
            principal_point=np.array(microscope.principal_point_px),
            touch=Prior(float(touch), _TOUCH_SIGMA_MM),
            kind=scene["phantom"]["kind"],
        ),
        frames=len(records),
        microscope=microscope,
        medium=scene["source"]["medium"],
        sha256=hashlib.sha256((folder / "manifest.json").read_bytes()).hexdigest(),
    )


def _ellipses(spots: Sequence[Spot]) -> optics.Ellipse:
    def column(name: str) -> jnp.ndarray:
        return jnp.array([getattr(spot, name) for spot in spots])

    return optics.Ellipse(
        centre=jnp.stack([column("x_px"), column("y_px")], axis=-1),
        semi_major=column("semi_major_px"),
        semi_minor=column("semi_minor_px"),
        angle=column("angle_rad"),
    )
