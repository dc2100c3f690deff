"""The keys of a microscope file that describe a viewing path and the retina."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from optics import InputError, Strict

if TYPE_CHECKING:
    import optics
    from optics.viewing import PathCamera

_Series = Annotated[
    list[Annotated[float, Field(ge=-1e12, le=1e12)]], Field(min_length=1, max_length=1000)
]
_NEGLIGIBLE_MM = 1e-7  # 2e-5 px
Length = Annotated[float, Field(gt=0, le=1e6)]
"""A positive number of mm."""


def _sign(value: float) -> float:
    if abs(value) != 1.0:
        raise InputError("must be 1 (upright image) or -1 (inverted)")
    return value


class PathSeries(Strict):
    """Lines of sight through a viewing path, as `optics.viewing.PathCamera` describes them.

    Attributes:
        crossing: Chebyshev coefficients of a.
        steepness_per_mm: Chebyshev coefficients of b, 1/mm.
        transmittance: Chebyshev coefficients of the transmittance.
        widest_mm: largest t of the series.
        pupil_mm: largest t that passes the iris; None if the iris stops no line of sight.
        orientation: +1 if the image is upright, -1 if it is inverted.
    """

    crossing: _Series
    steepness_per_mm: _Series
    transmittance: _Series
    widest_mm: Length
    pupil_mm: Length | None = None
    orientation: Annotated[float, AfterValidator(_sign)]

    @model_validator(mode="after")
    def _is_a_path(self) -> Self:
        lengths = [len(s) for s in (self.crossing, self.steepness_per_mm, self.transmittance)]
        if len(set(lengths)) > 1:
            raise InputError(
                "must have equally many coefficients of crossing, steepness_per_mm and "
                f"transmittance, not {lengths[0]}, {lengths[1]} and {lengths[2]}"
            )
        if not _on_axis(self.crossing):
            raise InputError("must have a crossing that is not 0 on the axis")
        return self

    @property
    def inverse_working_distance(self) -> float:
        """kappa of the path's paraxial pinhole, 1/mm."""
        return _on_axis(self.steepness_per_mm) / _on_axis(self.crossing)

    def camera(
        self,
        *,
        scale_mm_px: float,
        principal_point_px: tuple[float, float],
        eye_radius_mm: float,
    ) -> PathCamera:
        """The microscope behind the path. Loads JAX."""
        from optics.viewing import PathCamera

        # Arrays: for plain numbers JAX would compile every time.
        array: Any = np.array
        # The time to compile a pose grows with the terms.
        terms = max(self._terms(self.crossing), self._terms(self.steepness_per_mm))
        return PathCamera(
            scale=array(scale_mm_px),
            principal_point=array(principal_point_px),
            pole_height=array(-eye_radius_mm),
            crossing=array(self.crossing[:terms]),
            steepness=array(self.steepness_per_mm[:terms]),
            passing=array(self.transmittance),
            widest=array(self.widest_mm),
            pupil=array(math.inf if self.pupil_mm is None else self.pupil_mm),
            orientation=array(self.orientation),
        )

    def _terms(self, series: list[float]) -> int:
        """Number of terms without which a line of sight moves by more than 1e-7 mm."""
        beyond = np.cumsum(np.abs(series[::-1]))[::-1] * self.widest_mm
        return max(int(np.sum(beyond > _NEGLIGIBLE_MM)), 1)


def _on_axis(series: list[float]) -> float:
    """A Chebyshev series at t = 0, where its argument is -1 and T_n = (-1)^n."""
    return sum(series[::2]) - sum(series[1::2])


@dataclass(frozen=True, kw_only=True)
class Retina:
    """The retina as an ellipsoid through the pole, placed as `optics.Ellipsoid` describes it.

    Attributes:
        semi_axes_mm: x, y and z.
        tilt_deg: angle of its z from the microscope's axis.
        tilt_azimuth_deg: azimuth of the direction in which its z leans.
        shift_mm: of its centre across the microscope's axis.
    """

    semi_axes_mm: tuple[float, ...]
    tilt_deg: float = 0.0
    tilt_azimuth_deg: float = 0.0
    shift_mm: tuple[float, ...] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse a retina that the microscope's axis does not meet."""
        across = min(self.semi_axes_mm[:2])
        if not math.hypot(*self.shift_mm) < across:
            raise InputError(
                f"retina_shift_mm must be less than {across:g} mm, its smaller semi-axis across; "
                f"got {list(self.shift_mm)}. Restore the key."
            )

    def surface(self) -> optics.Ellipsoid:
        """The wall. Loads JAX."""
        import optics

        x, y = self.shift_mm
        return optics.Ellipsoid(
            np.array(self.semi_axes_mm),
            shift=(x, y),
            tilt=math.radians(self.tilt_deg),
            tilt_azimuth=math.radians(self.tilt_azimuth_deg),
        )
