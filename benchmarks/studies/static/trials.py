"""The rendered withdrawals, photographed and measured under each set of causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import scenes
from benchmarks.evaluation import LITERAL, Photographer, Shot, StaticTrial, Way, paper_trials
from benchmarks.reporting import Study
from scenes import Scene, SceneError

FROM_MM = 0.5
"""Least reading that the fits use; nearer, the fibre hides a large part of the spot."""
TOUCH_MM = 0.1
TILT_DEG = 5.0
LIGHT = 0.1
THRESHOLD_DN = 10

CAUSES = {
    "noise": "the camera's",
    "texture": "printed retina in place of an even wall",
    "touch": f"{TOUCH_MM:g} mm, normal, a trial",
    "tilt": f"plane {TILT_DEG:g}° either way, a trial",
    "exposure": f"{100 * LIGHT:g} %, normal, a trial",
    "threshold": f"{THRESHOLD_DN:g} grey levels, normal, a run",
}
"""The causes and their sizes, which are assumptions: the paper does not report them."""
NONE, TOGETHER, ALL = "none", "together", "all"
"""No cause; what all causes together add beyond their sum; all causes."""
EVEN = -1
"""Number of the even wall among the textures."""

Key = tuple[int, int, int]
"""Trial, texture, tilt (-1, 0 or 1)."""


class Measured(NamedTuple):
    """e1' (px, NaN where no spot counts) and d_r (mm) of runs x trials x frames."""

    semi_minor: np.ndarray
    readings: np.ndarray


def check(scene: Scene) -> None:
    """Refuse a scene that is not the paper's static experiment.

    Raises:
        SceneError: saying what to change.
    """
    motion = scene.motion
    if motion.kind != "withdrawal" or motion.start_mm != "contact":
        raise SceneError(
            "the static experiment withdraws the tip from contact; got motion.kind "
            f"'{motion.kind}'. Set motion.kind=withdrawal and motion.start_mm=contact."
        )
    if scene.spot.incidence_deg <= TILT_DEG:
        raise SceneError(
            f"the study tilts the plane by {TILT_DEG:g} deg either way; got spot.incidence_deg = "
            f"{scene.spot.incidence_deg:g}. Raise it."
        )


# Rendered.


def rendered_planes(study: Study, *, textures: int, frames: int) -> dict[Key, Photographer]:
    """Every trial on the plane, on every wall and with every tilt."""
    wanted = {
        (trial, texture, tilt): plane(study.scene, place, texture=texture, tilt=tilt, frames=frames)
        for trial, place in enumerate(_places("plane"))
        for texture in (EVEN, *range(textures))
        for tilt in (-1, 0, 1)
    }
    names = {key: "plane-{}-wall-{}-tilt-{}".format(*(x + 1 for x in key)) for key in wanted}
    stacks = study.stacks({names[key]: scene for key, scene in wanted.items()})
    return {
        key: Photographer(scene=scene, stack=stacks[names[key]]) for key, scene in wanted.items()
    }


def plane(scene: Scene, place: StaticTrial, *, texture: int, tilt: int, frames: int) -> Scene:
    """A trial on the plane; the instrument keeps its direction when the plane tilts under it.

    Args:
        scene: the study's.
        place: the trial that gives the place on the wall.
        texture: number of the wall, EVEN for the even one.
        tilt: 1 if the plane's normal leans the way the beam travels, -1 against it, 0 for none.
    """
    base = scene.spot
    travels = place.scene.spot.azimuth_deg + base.incidence_azimuth_deg
    return scenes.changed(
        scene,
        {
            **_shared(place, frames=frames),
            "phantom.kind": "plane",
            "phantom.pupil_radius_mm": 0.0,
            "phantom.tilt_deg": TILT_DEG * abs(tilt),
            "phantom.tilt_azimuth_deg": travels if tilt > 0 else travels + 180.0,
            "spot.incidence_deg": base.incidence_deg + TILT_DEG * tilt,
            **(
                {"phantom.wall": "uniform"}
                if texture == EVEN
                else {"phantom.texture_seed": scene.phantom.texture_seed + texture}
            ),
        },
    )


def rendered_spheres(study: Study, *, frames: int) -> list[Photographer]:
    """The trials in the eyeball."""
    wanted = {
        place.group.replace(" ", "-"): scenes.changed(
            study.scene, {**_shared(place, frames=frames), "phantom.kind": "eyeball"}
        )
        for place in _places("sphere")
    }
    stacks = study.stacks(wanted)
    return [Photographer(scene=scene, stack=stacks[name]) for name, scene in wanted.items()]


def _places(kind: str) -> list[StaticTrial]:
    return [t for t in paper_trials(source="lens", quick=True, seed=0) if t.kind == kind]


def _shared(place: StaticTrial, *, frames: int) -> dict[str, object]:
    return {
        "spot.eccentricity_mm": place.scene.spot.eccentricity_mm,
        "spot.azimuth_deg": place.scene.spot.azimuth_deg,
        "motion.frames": frames,
        "exposures.kinds": ["paper", "metered"],
        "exposures.keep_linear": True,
    }


# Photographed and measured under each set of causes.


class Draws(NamedTuple):
    """Sizes of the causes by run (rows) and trial (columns).

    `touch` is the distance since contact minus the reading, mm; `tilt` is -1 or 1; `light` is a
    factor on the exposure. `threshold` of the literal mode and the number of the wall's `texture`
    are by run.
    """

    touch: np.ndarray
    tilt: np.ndarray
    light: np.ndarray
    threshold: np.ndarray
    texture: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Photographs and measures rendered withdrawals; the pool's workers measure."""

    planes: Mapping[Key, Photographer]
    spheres: Sequence[Photographer]
    draws: Draws
    pool: Executor

    def variants(self) -> dict[str, Measured]:
        """Literal mode on planes without causes, with each alone, and with all."""
        draws = self.draws

        def even(shot: Callable[[int, int], Shot]) -> Measured:
            return self._planes(lambda run, trial: ((trial, EVEN, 0), shot(run, trial)))

        without = even(lambda run, trial: Shot())
        return {
            NONE: without,
            "noise": even(lambda run, trial: Shot(seed=_seed(run, trial))),
            "texture": self._planes(
                lambda run, trial: ((trial, int(draws.texture[run]), 0), Shot())
            ),
            "touch": self._touched(without),
            "tilt": self._planes(
                lambda run, trial: ((trial, EVEN, int(draws.tilt[run, trial])), Shot())
            ),
            "exposure": even(lambda run, trial: Shot(light=float(draws.light[run, trial]))),
            "threshold": even(lambda run, trial: Shot(threshold=int(draws.threshold[run]))),
            ALL: self.together(LITERAL),
        }

    def together(self, way: Way) -> Measured:
        """Planes under all causes at once."""
        texture, tilt = self.draws.texture, self.draws.tilt
        return self._touched(
            self._planes(
                lambda run, trial: (
                    (trial, int(texture[run]), int(tilt[run, trial])),
                    self._shot(way, run, trial),
                ),
                way=way,
            )
        )

    def curved(self, way: Way) -> Measured:
        """Spheres under all causes that apply: they have one wall, and no plane to tilt."""
        tasks = [
            (self.spheres[trial], self._shot(way, run, trial))
            for run, trial in np.ndindex(self.draws.touch.shape)
        ]
        return self._touched(self._measured(tasks, way))

    def _shot(self, way: Way, run: int, trial: int) -> Shot:
        shot = Shot(seed=_seed(run, trial))
        if way is not LITERAL:  # metered frames, no threshold
            return shot
        return shot._replace(
            light=float(self.draws.light[run, trial]), threshold=int(self.draws.threshold[run])
        )

    def _planes(
        self, task: Callable[[int, int], tuple[Key, Shot]], *, way: Way = LITERAL
    ) -> Measured:
        tasks = [task(run, trial) for run, trial in np.ndindex(self.draws.touch.shape)]
        return self._measured([(self.planes[key], shot) for key, shot in tasks], way)

    def _measured(self, tasks: Sequence[tuple[Photographer, Shot]], way: Way) -> Measured:
        """Measure every task once, however many runs share it."""
        shots: dict[Photographer, dict[Shot, None]] = {}
        for photographer, shot in tasks:
            shots.setdefault(photographer, {})[shot] = None
        spots = self.pool.map(lambda of: of[0].measure(way, list(of[1])), shots.items())
        found = {
            (photographer, shot): semi_minor
            for (photographer, asked), measured in zip(shots.items(), spots, strict=True)
            for shot, semi_minor in zip(asked, measured, strict=True)
        }
        shape = (*self.draws.touch.shape, -1)
        semi_minor = np.reshape([found[task] for task in tasks], shape)
        readings = np.reshape([photographer.readings for photographer, _ in tasks], shape)
        return Measured(np.where(readings > FROM_MM - 1e-6, semi_minor, np.nan), readings)

    def _touched(self, measured: Measured) -> Measured:
        """The same with readings that count from a missed touch."""
        return measured._replace(readings=measured.readings - self.draws.touch[..., None])


def _seed(run: int, trial: int) -> int:
    return 1 + 1000 * run + trial
