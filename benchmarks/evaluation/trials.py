"""The trials of the main job: the paper's six, and a grid over eccentricity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from benchmarks.evaluation.paper import TABLE_II
from scenes import Scene, SceneError

# Places on the printed plane, so far apart that they share no wall texture.
_PLANE_ECCENTRICITIES_MM = (1.5, 3.0, 4.5)
_AZIMUTHS_DEG = (0.0, 120.0, 240.0)
PINHOLE_HEIGHTS_MM = (11.5, 200.0)
"""On the eyeball's sphere (equation 8 of Zhou et al. 2020), and a real microscope."""
TILT_AZIMUTHS_DEG = (0.0, 90.0, 180.0)
"""Of a tilted beam: towards growing c, across the meridian, and towards the axis."""

MICROSCOPE_MM = 200.0
"""z_F of a real microscope."""

_SMALLEST_RADIUS_MM = 10.0


TrialKind = Literal["plane", "sphere", "grid"]


@dataclass(frozen=True, kw_only=True)
class StaticTrial:
    """A withdrawal of the static experiment.

    Attributes:
        name: of the trial and of its stack's folder.
        kind: the wall, or the grid of the model errors.
        group: the row of the paper's tables that it is compared with, or the grid's name.
    """

    name: str
    kind: TrialKind
    group: str
    scene: Scene

    @property
    def source(self) -> str:
        """Kind of light: "lens" or "cone"."""
        return self.scene.source.kind


def paper_trials(*, source: str, quick: bool, seed: int) -> list[StaticTrial]:
    """Three withdrawals on the plane and three in the eyeball, with one kind of source.

    Args:
        source: "lens" or "cone".
        quick: 9 frames a trial instead of 61.
        seed: of camera noise and wall texture.
    """
    frames = 9 if quick else 61
    places: list[tuple[str, TrialKind, float]] = [
        *((f"plane {n}", "plane", c) for n, c in enumerate(_PLANE_ECCENTRICITIES_MM, start=1)),
        *((name, "sphere", row.c) for name, row in TABLE_II.items()),
    ]
    return [
        StaticTrial(
            name=f"{source}-{group.replace(' ', '-')}",
            kind=kind,
            group=group,
            scene=Scene.model_validate(
                {
                    "schema": 1,
                    "seed": seed + number,
                    "phantom": {
                        "kind": "eyeball" if kind == "sphere" else "plane",
                        "texture_seed": seed,
                    },
                    "source": {"kind": source},
                    "spot": {
                        "eccentricity_mm": c,
                        "azimuth_deg": _AZIMUTHS_DEG[number % len(_AZIMUTHS_DEG)],
                    },
                    "motion": {"frames": frames},
                }
            ),
        )
        for number, (group, kind, c) in enumerate(places)
    ]


def grid_trials(*, quick: bool, seed: int) -> list[StaticTrial]:
    """Ideal cones at each eccentricity from 0 to 7 mm, for both pinholes, tilted three ways."""
    eccentricities = (0.0, 3.0, 5.0, 7.0) if quick else tuple(float(c) for c in range(8))
    return [
        StaticTrial(
            name=f"grid-pinhole-{height:g}-azimuth-{azimuth:g}-c-{c:g}",
            kind="grid",
            group=f"pinhole {height:g} mm",
            scene=Scene.model_validate(
                {
                    "schema": 1,
                    "seed": seed,
                    "phantom": {"texture_seed": seed},
                    "source": {"kind": "cone"},
                    "spot": {"eccentricity_mm": c, "incidence_azimuth_deg": azimuth},
                    "motion": {"start_mm": 0.5, "travel_mm": 5.5, "frames": 4 if quick else 12},
                    "microscope": {"pinhole_height_mm": height},
                    "exposures": {"kinds": ["metered"]},
                }
            ),
        )
        for height in PINHOLE_HEIGHTS_MM
        for azimuth in TILT_AZIMUTHS_DEG
        for c in eccentricities
    ]


def require_roomy_eyeball(scene: Scene, reach: str) -> None:
    """Refuse a scene whose wall ends before a study's spots do.

    Args:
        scene: the study's.
        reach: what reaches how far, for the message.

    Raises:
        SceneError: the wall is no eyeball, or too small.
    """
    if scene.phantom.kind != "eyeball" or scene.phantom.radius_mm < _SMALLEST_RADIUS_MM:
        raise SceneError(
            f"the study's {reach} in an eyeball of {_SMALLEST_RADIUS_MM:g} mm radius or more; got "
            f"phantom.kind '{scene.phantom.kind}' with radius_mm = {scene.phantom.radius_mm:g}. "
            "Set phantom.kind=eyeball and raise phantom.radius_mm."
        )
