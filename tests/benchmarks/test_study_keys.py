"""Which keys of a scene a study reads, recorded in a quick run, against those that it varies."""

import sys
from fnmatch import fnmatch

import pytest

from eyespot import studies
from eyespot.benchmarks import study as of_studies
from eyespot.benchmarks.studies.eccentricity import VARIED as VARIED_BY_ECCENTRICITY
from eyespot.benchmarks.studies.map import VARIED as VARIED_BY_MAP
from eyespot.benchmarks.studies.medium import VARIED as VARIED_BY_MEDIUM
from eyespot.benchmarks.studies.pose import VARIED as VARIED_BY_POSE
from eyespot.benchmarks.studies.table_one import VARIED as VARIED_BY_TABLE_ONE
from eyespot.scenes import Scene
from eyespot.scenes.description import scene_file
from eyespot.scenes.description.scene_keys import SceneTable

IDLE = (
    *("phantom.reflectance", "seed", "schema", "second_tool.*", "viewing.*", "unrest.*"),
    *("clocks.*", "motion.*"),
    *("phantom.wall_image*", "phantom.spread_mm", "phantom.shift_mm", "phantom.tilt*"),
    *("source.lens", "source.cone_*", "source.photons_per_pixel"),
    *("exposures.paper_*", "exposures.bound", "microscope.focus_mm", "camera.jpeg_quality"),
)
"""Keys that other keys switch off, or that say how a motion is drawn: a run need not read them."""


class Recorded:
    """The keys of a study's own scene that are read, also through scenes derived from it."""

    def __init__(self, patch):
        self.read: set[str] = set()
        self._kept: list[Scene] = []
        self._own: dict[int, tuple[str, set[str]]] = {}
        plain_read, plain_changed, recorder = SceneTable.__getattribute__, scene_file.changed, self

        def read(table, name):
            own = recorder._own.get(id(table))
            if own is not None and name in own[1] and not recorder.pausing:
                recorder.read.add(f"{own[0]}.{name}" if own[0] else name)
            return plain_read(table, name)

        def changed(scene, changes):
            recorder.pausing = True  # writing a scene out reads its motion's kind
            made = plain_changed(scene, changes)
            recorder.pausing = False
            if id(scene) in recorder._own:
                recorder.follow(made, without={*recorder._lost[id(scene)], *changes})
            return made

        self._lost, self.pausing = {}, False
        patch.setattr(SceneTable, "__getattribute__", read)
        for module in [*sys.modules.values()]:
            if getattr(module, "changed", None) is plain_changed:
                patch.setattr(module, "changed", changed)
        plain = of_studies.Study.__init__

        def begin(study, *args, **more):
            plain(study, *args, **more)
            recorder.follow(study.scene, without=())

        patch.setattr(of_studies.Study, "__init__", begin)

    def follow(self, scene, without):
        self._kept.append(scene)
        self._lost[id(scene)] = {*without}
        self._own[id(scene)] = ("", set())
        for name, value in vars(scene).items():
            if isinstance(value, SceneTable):
                keys = {key for key in vars(value) if f"{name}.{key}" not in without}
                self._own[id(value)] = (name, keys)


def keys_of(scene):
    return {
        f"{name}.{key}"
        for name, value in vars(scene).items()
        if isinstance(value, SceneTable)
        for key in vars(value)
    }


VARIED = {
    "eccentricity": VARIED_BY_ECCENTRICITY,
    "pose": VARIED_BY_POSE,
    "loop": (),
    "table_one": (*VARIED_BY_TABLE_ONE, "phantom.stretch"),  # an eyeball's; its wall is a plane
    "medium": VARIED_BY_MEDIUM,
    "map": (*VARIED_BY_MAP, "source.medium"),  # of a rig it decides the cone
}
"""Not `design`, whose quick run renders nothing, so that it reads fewer keys than a full one."""


@pytest.mark.slow  # a quick run each
@pytest.mark.parametrize("name", VARIED)
def test_a_study_reads_every_key_that_it_does_not_vary(name, tmp_path, monkeypatch):
    recorded = Recorded(monkeypatch)
    getattr(studies, name)(out=tmp_path / "out", quick=True)
    every = keys_of(Scene())
    varied = {key for key in every if of_studies.among(key, VARIED[name])}
    may_be_idle = {key for key in every if any(fnmatch(key, idle) for idle in IDLE)}
    # Not so the other way: spot.eccentricity_mm is read, although every trial sets it.
    assert every - recorded.read - may_be_idle <= varied
