"""The tables [motion] and [clocks] of the scene file."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Withdrawal(_Settings):
    """The tip withdraws along the beam at constant speed."""

    kind: Literal["withdrawal"] = Field(
        "withdrawal", description="'withdrawal' | 'scan' | 'hand' | 'recorded', as below."
    )
    start_mm: float | Literal["contact"] = Field(
        "contact", description="First distance along the beam; contact: the tip's rim touches."
    )
    travel_mm: float = Field(6.0, gt=0)
    frames: int = Field(61, ge=1, description="Evenly spaced over the travel.")
    speed_mm_s: float = Field(0.1, gt=0)


class _NamedMotion(_Settings):
    """A motion that a scene names; only a withdrawal is meant where `kind` is missing."""

    model_config = ConfigDict(json_schema_extra={"required": ["kind"]})


_TROCAR = (
    "From the spot back along the beam to the point that the instrument pivots about; inf: its "
    "direction stays."
)


class Scan(_NamedMotion):
    """The spot moves along the wall, straight through the place of [spot], at constant distance."""

    kind: Literal["scan"] = "scan"
    distance_mm: float = Field(3.0, gt=0, description="Along the beam.")
    length_mm: float = Field(1.5, gt=0, description="Of the spot's path.")
    direction_deg: float = Field(0.0, description="0: towards growing eccentricity.")
    speed_mm_s: float = Field(1.0, gt=0, description="Of the spot.")
    trocar_mm: float = Field(20.0, gt=0, description=_TROCAR)


class Hand(_NamedMotion):
    """Synthetic: a hand drives the robot about a place, with what is left of its tremor.

    Tremor: 0.18 mm RMS in all (Singh and Riviere 2002) at 8-12 Hz, the band that Wells et al. 2013
    give for it. Voluntary motion lies below 2 Hz (99 % of its power; Riviere, Rader and Khosla
    1997). How much of the tremor the robot takes away is an assumption.
    """

    kind: Literal["hand"] = "hand"
    distance_mm: float = Field(3.0, gt=0, description="Mean, along the beam.")
    duration_s: float = Field(6.0, gt=0)
    top_speed_mm_s: float = Field(
        5.0, gt=0, description="The slow motion is as large as makes this the tip's top speed."
    )
    tremor_rms_mm: float = Field(0.18, ge=0, description="Before the robot's damping.")
    damping: float = Field(
        0.95, ge=0, le=1, description="Part of the tremor that the robot takes away; assumed."
    )
    trocar_mm: float = Field(20.0, gt=0, description=_TROCAR)
    seed: int = Field(0, ge=0, description="Of the motion.")


class Recorded(_NamedMotion):
    """The tip follows a file: CSV, or a ROS bag in the eye's frame."""

    kind: Literal["recorded"] = "recorded"
    file: str = Field(
        "kinematics.csv",
        description="Columns time_s, x_mm, y_mm, z_mm of the tip, axis_x, axis_y, axis_z; eye "
        "frame.",
    )


MOTIONS: dict[str, type[_Settings]] = {
    "withdrawal": Withdrawal,
    "scan": Scan,
    "hand": Hand,
    "recorded": Recorded,
}


def _kind_of_motion(motion: Any) -> str:
    """A withdrawal unless the scene says otherwise."""
    found = motion.get("kind", "withdrawal") if isinstance(motion, dict) else motion.kind
    return str(found)


Motion = Annotated[
    Annotated[Withdrawal, Tag("withdrawal")]
    | Annotated[Scan, Tag("scan")]
    | Annotated[Hand, Tag("hand")]
    | Annotated[Recorded, Tag("recorded")],
    Discriminator(_kind_of_motion),
]


class Clocks(_Settings):
    """When frames are taken, and what the robot's clock says; time counts on the camera's."""

    camera_hz: float = Field(
        10.0, gt=0, description="Frames a second; a withdrawal has its own number of frames."
    )
    camera_jitter_s: float = Field(
        0.0, ge=0, description="Standard deviation of a frame's moment about its turn."
    )
    kinematics_hz: float = Field(200.0, gt=0, description="Poses a second.")
    kinematics_offset_s: float = Field(
        0.0, description="What the robot's clock is ahead of the camera's."
    )
    kinematics_jitter_s: float = Field(
        0.0, ge=0, description="Standard deviation of a pose's time stamp."
    )
    seed: int = Field(0, ge=0, description="Of both jitters.")
