"""What all studies share: a report that stands alone, a folder of their own, what they refuse."""

import json
import math
import shlex

import pandas as pd
import pytest
from matplotlib.figure import Figure

from eyespot import scenes
from eyespot.benchmarks.reporting import Claim, Column, Picture, Report, Section, Table
from eyespot.benchmarks.studies import dynamic, eccentricity, medium, pose, static, table_one
from eyespot.benchmarks.study import Study
from eyespot.formats.inputs import InputError

LIMIT = pd.DataFrame({"model": ["exact"], "c_mm": [math.nan]})


def small_report(_: None) -> Report:
    figure = Figure()
    figure.subplots().plot([0, 1])
    return Report(
        title="Is z_F < 3 & fine?",
        lead="A test.",
        claims=[
            Claim(name="topic", sentence=f"{0.7:.2f} of {1.0:g} < 2.", value=0.7, high=1.0),
            Claim(name="other", sentence=f"At {math.nan:.1f} mm."),
        ],
        sections=[
            Section(
                "Section",
                "A paragraph.",
                Table(
                    pd.DataFrame({"z": [1.23456], "name": ["first"]}),
                    {"z": Column("z_F, mm"), "name": Column("name")},
                    "A table.",
                ),
                Picture("line", figure, "A line.", data="limits.csv"),
            )
        ],
        data={"limits.csv": LIMIT},
    )


def test_a_report_says_how_to_make_it_again_and_stands_alone(tmp_path):
    study = Study(
        "eccentricity",
        out=tmp_path / "a run",
        changes=("spot.incidence_deg=20",),
        quick=True,
        seed=4,
        options={"exposure-ms": 20},
        defaults=("source.kind=cone",),
    )
    with study.timed("a step"):
        pass
    study.publish(small_report, None)
    html = (study.folder / "report.html").read_text(encoding="utf-8")
    command = (
        "eyespot study eccentricity --set spot.incidence_deg=20 --exposure-ms 20 --seed 4 --out "
        f"'{tmp_path / 'a run'}' --quick"
    )
    assert shlex.split(study.command) == shlex.split(command)
    assert study.command.replace("'", "&#39;") in html
    assert "Is z<sub>F</sub> &lt; 3 &amp; fine?" in html
    assert ">1.235<" in html
    again = scenes.load_scene(study.folder / "scene.toml")
    assert (again.source.kind, again.spot.incidence_deg, again.seed) == ("cone", 20.0, 4)
    summary = json.loads((study.folder / "summary.json").read_text())
    assert summary["command"] == study.command
    first, second = summary["found"]
    assert (first["text"], first["holds"]) == ("0.70 of 1 < 2.", True)
    assert (second["text"], second["holds"], second["value"]) == ("At – mm.", None, None)


def test_a_folder_takes_the_same_request_again_and_refuses_another(tmp_path):
    Study("pose", out=tmp_path / "run", seed=1)
    Study("pose", out=tmp_path / "run", seed=1)
    with pytest.raises(ValueError, match=r"'study': 'pose' instead of 'static'"):
        Study("static", out=tmp_path / "run", seed=1)
    with pytest.raises(ValueError, match="other settings"):
        Study("pose", out=tmp_path / "run", seed=2)


def test_a_persons_scene_file_is_not_overruled_by_the_studys_defaults(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text('schema = 1\n[source]\nkind = "lens"\n')
    given = Study("pose", out=tmp_path / "a", scene=file, defaults=("source.kind=cone",))
    bare = Study("pose", out=tmp_path / "b", defaults=("source.kind=cone",))
    changed = Study(
        "pose", out=tmp_path / "c", changes=("source.kind=lens",), defaults=("source.kind=cone",)
    )
    kinds = [study.scene.source.kind for study in (given, bare, changed)]
    assert kinds == ["lens", "cone", "lens"]


@pytest.mark.parametrize(
    ("study", "changes", "words"),
    [
        (
            eccentricity.eccentricity,
            ["phantom.kind=plane"],
            r"varies c in an eyeball.*Set phantom\.kind=eyeball",
        ),
        (dynamic.dynamic, ["phantom.kind=plane"], r"Set phantom\.kind=eyeball"),
        (pose.pose, ["source.kind=lens"], r"Set source\.kind=cone"),
        (pose.pose, ["source.kind=cone", "phantom.kind=plane"], r"Set phantom\.kind=eyeball"),
        (medium.medium, ["source.kind=cone"], r"Set source\.kind=lens"),
        (table_one.table_one, ["source.kind=cone"], "source.kind"),
        (table_one.table_one, ["motion.start_mm=1"], "contact"),
        (static.static, ["motion.start_mm=1"], "withdraws"),
    ],
)
def test_a_scene_that_a_study_cannot_use_is_refused_before_a_folder_is_made(
    tmp_path, study, changes, words
):
    with pytest.raises(InputError, match=words):
        study(out=tmp_path / "run", changes=tuple(changes))
    assert not (tmp_path / "run").exists()
