"""The table [camera] of the scene file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from optics import InputError

# A full well of 1e15 electrons makes a camera without noise.
_NonNegative = Annotated[float, Field(ge=0, le=1e15)]
_Positive = Annotated[float, Field(ge=1e-3, le=1e15)]


class CameraSettings(BaseModel):
    """The camera: its data sheet (EMVA 1288) and its image format.

    The defaults describe an 8-bit USB microscope with a full well of 5,000 electrons. Its temporal
    noise is 3 DN per channel at 180 DN.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    full_well_e: _Positive = Field(
        default=5000.0, description="Full well: electrons at full scale."
    )
    read_noise_e: _NonNegative = Field(
        default=10.0,
        description="Read noise: temporal standard deviation of a dark pixel, electrons.",
    )
    dark_signal_e: _NonNegative = Field(
        default=0.0, description="Dark signal: mean thermal electrons per pixel and exposure."
    )
    prnu: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="PRNU: standard deviation of the pixels' gain, relative to its mean.",
    )
    dsnu_e: _NonNegative = Field(
        default=0.0, description="DSNU: standard deviation of the pixels' dark signal, electrons."
    )
    black_level_dn: _NonNegative = Field(
        default=4.0, description="Mean value of a dark image before the response curve, DN."
    )
    bit_depth: int = Field(default=8, ge=8, le=16, description="Bits per channel in the file.")
    response: Literal["linear", "srgb"] | Annotated[float, Field(ge=0.01, le=100)] = Field(
        default="linear",
        description='Response curve: "linear", "srgb" (IEC 61966-2-1), or a number g for x^(1/g).',
    )
    bayer: Literal["none", "RGGB", "BGGR", "GRBG", "GBRG"] = Field(
        default="none",
        description="Bayer filter: colours of the first two rows. Other colours are interpolated.",
    )
    jpeg_quality: int = Field(
        default=0,
        ge=0,
        le=100,
        description="JPEG quality, with 4:2:2 colour as in USB video; 0: no JPEG.",
    )

    @property
    def dark_variance_e2(self) -> float:
        """Variance of a pixel without electrons, electrons²: of reading and of rounding."""
        return self.read_noise_e**2 + 1 / (12 * self.system_gain**2)

    @model_validator(mode="after")
    def _black_is_below_white(self) -> CameraSettings:
        if self.black_level_dn >= self.full_scale_dn:
            raise InputError(
                f"CameraSettings(black_level_dn=...) must lie below full scale; got black_level_dn="
                f"{self.black_level_dn:g} DN, full scale {self.full_scale_dn} DN at bit_depth="
                f"{self.bit_depth}. Lower black_level_dn or raise bit_depth."
            )
        return self

    @model_validator(mode="after")
    def _jpeg_has_eight_bits(self) -> CameraSettings:
        if self.jpeg_quality and self.bit_depth != 8:
            raise InputError(
                f"CameraSettings(jpeg_quality=...) needs 8 bits; got jpeg_quality="
                f"{self.jpeg_quality} at bit_depth={self.bit_depth}. Set bit_depth to 8 or "
                "jpeg_quality to 0."
            )
        return self

    @property
    def full_scale_dn(self) -> int:
        """Largest digital number (DN)."""
        return (1 << self.bit_depth) - 1

    @property
    def system_gain(self) -> float:
        """Overall system gain K before the response curve, DN per electron."""
        return (self.full_scale_dn - self.black_level_dn) / self.full_well_e

    def sensor_shape(self, *, height: int, width: int) -> tuple[int, ...]:
        """Shape of the raw frames: one value per pixel with a Bayer filter, otherwise three."""
        return (height, width, 3) if self.bayer == "none" else (height, width)
