"""Names, units and valid ranges of the parameters of the fit to all pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calibration.spots import Prior
from optics import InputError
from optics.wall_light import PARAMETERS as LENS

UNITS = {
    "half_angle": "rad",
    "b": "mm",
    "blur": "px",
    "spread": "mm",
    "core_radius": "mm",
    "aperture_radius": "mm",
    "rim_height": "mm",
    "sag": "mm",
    "glue_index": "1",
    "numerical_aperture": "1",
    "scale": "mm/px",
    "eye_radius": "mm",
    "reflectance": "1",
    "power": "mW",
    "sensitivity": "mm2 sr/mJ",
    "illumination": "mW/mm2",
    "touch": "mm",
    "u": "px",
    "v": "px",
    "lean": "rad",
    "lean_sideways": "rad",
    "boresight": "rad",
    "boresight_sideways": "rad",
}
"""Every parameter's unit. `sensitivity`: full wells per radiance and second. `u`, `v`: image of
the point where the beam meets the wall at reading 0, in the first frame. `touch`: distance along
the beam there. `lean`, `lean_sideways`: rotation of the robot's directions against the eye, along
`optics.perpendicular_frame` of the tool's axis. `boresight`, `boresight_sideways`: angle of the
beam from the tool's axis, along the same vectors. `spread`: L of the light's spread in the wall
(`optics.spread_nodes`); without a start value there is none."""

CONE = ("half_angle", "b")
FREE = {"cone": CONE, "lens": ("sag", "numerical_aperture")}
"""Parameters that are free by default."""
POSE = ("touch", "u", "v", "lean", "lean_sideways", "boresight", "boresight_sideways")
"""Parameters of the frames' poses."""
_ANGLES = ("lean", "lean_sideways", "boresight", "boresight_sideways")
NUISANCES = ("sensitivity", "illumination", "touch", "u", "v", *_ANGLES)
"""Parameters that are free in every fit, because no log book contains them accurately enough."""
DEFAULTS = {"reflectance": 0.5, "power": 1.0, "sensitivity": 1.0}
_MAY_BE_NEGATIVE = {"b", "illumination", "touch", "u", "v", *_ANGLES, "rim_height", "sag"}
_HOLLOW = 0.01  # depth of a hollow end over its radius up to which the light is linear in it


def beam_names(lens: bool) -> tuple[str, ...]:
    """Names of a beam's own parameters, which its light takes."""
    return LENS if lens else CONE


def known_names(source: str) -> tuple[str, ...]:
    """Names of the parameters for the source "cone" or "lens"."""
    others = (*CONE, "blur") if source == "lens" else LENS
    return tuple(name for name in UNITS if name not in others)


def check_names(
    source: str, start: Mapping[str, float], free: Sequence[str], priors: Mapping[str, Prior]
) -> None:
    """Check the names of parameters.

    Raises:
        InputError: unknown names or missing start values.
    """
    own = CONE if source == "cone" else LENS
    names = known_names(source)
    unknown = [name for name in (*start, *free, *priors) if name not in names]
    missing = [name for name in own if name not in start]
    missing += [name for name in ("blur", "spread") if name in free and name not in start]
    if unknown or missing:
        raise InputError(
            f"the image fit of a {source} has the parameters {', '.join(names)} and needs start "
            f"values of {', '.join(own)}. Unknown: {', '.join(unknown) or 'none'}; missing: "
            f"{', '.join(missing) or 'none'}."
        )


def possible(values: Mapping[str, float]) -> bool:
    """Whether the parameters are physically possible; the solver rejects steps that are not.

    A flat end may seem hollow by the noise.
    """
    positive = all(value > 0 for name, value in values.items() if name not in _MAY_BE_NEGATIVE)
    lens = "sag" not in values or (
        -_HOLLOW <= values["sag"] / values["aperture_radius"] <= 1.0
        and values["aperture_radius"] >= values["core_radius"]
        and values["rim_height"] >= 0
    )
    return positive and lens and values["reflectance"] < 1
