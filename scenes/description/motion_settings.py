"""The tables [motion] and [clocks] of the scene file."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AllowInfNan, BaseModel, ConfigDict, Discriminator, Field, Tag

from optics import shortened

MOST_FRAMES = 100_000
"""Most frames of a scene. Their labels take a minute and 1 GB, their images days."""
MOST_HZ = 1e5
_MOST_MM = 1e4  # larger than any room; squares of it are exact to a nanometre
_MOST_S = 1e6
_LONGEST_HAND_S = 600.0  # its top speed is sought at steps of 1 ms, in 1 GB
_LEAST = 1e-6  # of lengths and speeds that something is divided by

Positive = Annotated[float, Field(ge=_LEAST, le=_MOST_MM)]
"""A length in mm, or a speed in mm/s."""
Angle = Annotated[float, Field(ge=-3600, le=3600)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Withdrawal(_Settings):
    """The tip withdraws along the beam at constant speed."""

    kind: Literal["withdrawal"] = Field(
        "withdrawal",
        description="'withdrawal' | 'scan' | 'hand' | 'recorded'; the others follow below.",
    )
    start_mm: Annotated[float, Field(ge=0, le=_MOST_MM)] | Literal["contact"] = Field(
        "contact",
        description="First distance along the beam; 'contact': the tip's rim touches the wall.",
    )
    travel_mm: Positive = Field(6.0, description="Distance that the tip withdraws.")
    frames: int = Field(
        61, ge=1, le=MOST_FRAMES, description="Number of frames, evenly spaced over the travel."
    )
    speed_mm_s: Positive = Field(0.1, description="Speed of the tip.")


class _NamedMotion(_Settings):
    """A motion that needs the key `kind`; without that key the motion is a withdrawal."""

    model_config = ConfigDict(json_schema_extra={"required": ["kind"]})


_TROCAR = (
    "Distance along the beam from the spot to the point about which the instrument pivots; inf: "
    "the beam keeps its direction."
)


class Scan(_NamedMotion):
    """The spot moves along the wall in a line through [spot], at constant distance."""

    kind: Literal["scan"] = "scan"
    distance_mm: Positive = Field(3.0, description="Distance along the beam.")
    length_mm: Positive = Field(1.5, description="Length of the spot's path.")
    direction_deg: Angle = Field(
        0.0, description="Direction of the path; 0: towards larger eccentricity."
    )
    speed_mm_s: Positive = Field(1.0, description="Speed of the spot.")
    trocar_mm: Annotated[float, AllowInfNan(), Field(gt=0)] = Field(20.0, description=_TROCAR)


class Hand(_NamedMotion):
    """A synthetic hand moves the tip near [spot]; the robot damps its tremor.

    Tremor: 0.18 mm RMS in total (Singh and Riviere 2002) at 8-12 Hz (Wells et al. 2013). Voluntary
    motion: 99 % of its power lies below 2 Hz (Riviere, Rader and Khosla 1997). The damping by the
    robot is an assumption.
    """

    kind: Literal["hand"] = "hand"
    distance_mm: Positive = Field(3.0, description="Mean distance along the beam.")
    duration_s: float = Field(
        6.0, ge=_LEAST, le=_LONGEST_HAND_S, description="Duration of the trial."
    )
    top_speed_mm_s: Positive = Field(
        5.0, description="Highest speed of the tip; the slow motion is scaled to reach it."
    )
    tremor_rms_mm: float = Field(
        0.18, ge=0, le=_MOST_MM, description="Tremor before the robot damps it."
    )
    damping: float = Field(
        0.95,
        ge=0,
        le=1,
        description="Fraction of the tremor that the robot removes (an assumption).",
    )
    trocar_mm: Annotated[float, AllowInfNan(), Field(gt=0)] = Field(20.0, description=_TROCAR)
    seed: Seed = Field(0, description="Random seed of the motion.")


class Recorded(_NamedMotion):
    """The tip follows recorded poses: a CSV file, or a ROS bag in the eye's frame."""

    kind: Literal["recorded"] = "recorded"
    file: str = Field(
        "kinematics.csv",
        max_length=4096,
        description="File with the columns time_s, x_mm, y_mm, z_mm (tip), axis_x, axis_y, axis_z "
        "in the eye's frame.",
    )


UNNAMED = "withdrawal"
"""The motion of a scene without `motion.kind`."""

MOTIONS: dict[str, type[_Settings]] = {
    "withdrawal": Withdrawal,
    "scan": Scan,
    "hand": Hand,
    "recorded": Recorded,
}


def _kind_of_motion(motion: Any) -> str:
    """The kind of a motion: a withdrawal if none is given."""
    kind = getattr(motion, "kind", UNNAMED)
    if isinstance(motion, dict):
        kind = motion.get("kind", UNNAMED)
    return kind if isinstance(kind, str) else shortened(kind)


Motion = Annotated[
    Annotated[Withdrawal, Tag("withdrawal")]
    | Annotated[Scan, Tag("scan")]
    | Annotated[Hand, Tag("hand")]
    | Annotated[Recorded, Tag("recorded")],
    Discriminator(_kind_of_motion),
]


class Clocks(_Settings):
    """Clocks of the camera and of the robot. Times are those of the camera's clock."""

    camera_hz: float = Field(
        10.0,
        ge=_LEAST,
        le=MOST_HZ,
        description="Frame rate; a withdrawal sets its own number of frames.",
    )
    camera_jitter_s: float = Field(
        0.0,
        ge=0,
        le=_MOST_S,
        description="Standard deviation of the times at which frames are taken.",
    )
    kinematics_hz: float = Field(
        200.0, ge=_LEAST, le=MOST_HZ, description="Poses per second from the robot."
    )
    kinematics_offset_s: float = Field(
        0.0,
        ge=-_MOST_S,
        le=_MOST_S,
        description="Time by which the robot's clock is ahead of the camera's.",
    )
    kinematics_jitter_s: float = Field(
        0.0, ge=0, le=_MOST_S, description="Standard deviation of the time stamps of poses."
    )
    seed: Seed = Field(0, description="Random seed of both jitters.")
