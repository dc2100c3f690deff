"""`eyespot study static`: the paper's Tables I and II over many runs, and what adds to their error.

DIR/static_tables.csv  every run's Table I and II, in both modes
    static_spread.csv  mean and standard deviation over runs beside the paper's figures
    static_causes.csv  what touch, tilt, exposure, texture, threshold and noise add to the error
    static_spots.csv   e1' of every frame of the first run
    stacks/            rendered frames, with the noise-free ones that all runs photograph
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import scenes
from benchmarks.evaluation import LITERAL, SUBPIXEL, Photographer, StaticTrial, paper_trials
from benchmarks.reporting import Request, Study
from benchmarks.studies.static import causes as static_causes
from benchmarks.studies.static.bench import EVEN, Bench, Key
from benchmarks.studies.static.causes import Draws
from benchmarks.studies.static.findings import ALL, TILT_DEG, StaticFindings
from benchmarks.studies.static.report import report
from benchmarks.studies.static.tables import entries, spreads
from scenes import Scene, SceneError

# Table I's R² and RMSE imply trials of 3.0, 3.5 and 3.7 mm (`eyespot study table-one`).
_DEFAULTS = ("motion.travel_mm=3.5",)


def run(request: Request) -> StaticFindings:
    """Render once, photograph and measure many times, fit and compare.

    Args:
        request: the arguments.

    Raises:
        SceneError: the scene is not a withdrawal from contact.
        InputError: the folder has other files.
        RendererUnavailable: Mitsuba cannot run here.
    """
    study = Study("static", request, defaults=_DEFAULTS, check=check)
    runs, textures, frames = (4, 1, 5) if request.quick else (20, 4, 21)
    with study.timed("render"):
        planes = _planes(study, textures=textures, frames=frames)
        spheres = _spheres(study, frames=frames)
    draws = Draws.of(runs=runs, trials=len(spheres), textures=textures, seed=study.seed)
    with study.timed("photograph and measure"), ThreadPoolExecutor(max_workers=2) as pool:
        bench = Bench(planes=planes, spheres=spheres, draws=draws, pool=pool)
        measured = bench.variants()
        subpixel = bench.together(SUBPIXEL)
        curved = {way.name: bench.curved(way) for way in (LITERAL, SUBPIXEL)}
    with study.timed("fit"):
        literal = {LITERAL.name: measured[ALL], SUBPIXEL.name: subpixel}
        table = [
            row
            for way, plane in literal.items()
            for row in entries(way, planes=plane, spheres=curved[way], scene=study.scene)
        ]
        findings = StaticFindings(
            scene=study.scene,
            runs=runs,
            planes=measured,
            subpixel=subpixel,
            spheres=curved,
            entries=table,
            spreads=spreads(table),
            parts=static_causes.parts(
                {name: m.semi_minor for name, m in measured.items()},
                {name: m.readings for name, m in measured.items()},
                texture=draws.texture,
            ),
        )
    study.publish(report, findings)
    return findings


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


def _planes(study: Study, *, textures: int, frames: int) -> dict[Key, Photographer]:
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
        frames: of the withdrawal.
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


def _spheres(study: Study, *, frames: int) -> list[Photographer]:
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
