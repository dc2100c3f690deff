"""Labelled sets on disk: complete, the same bytes whoever renders them, damage that is named."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from distributed import Client

from eyespot.benchmarks.sets import make
from eyespot.benchmarks.sets.make import estimate, make_set
from eyespot.benchmarks.sets.read import read_set, verify_set
from eyespot.benchmarks.sets.spec import load_spec, plan
from eyespot.benchmarks.sets.workers import local_workers, running_scheduler
from eyespot.formats.inputs import InputError
from eyespot.scenes import SceneError
from tests.support.command_line import EYESPOT, run
from tests.support.drawn.drawn_sets import digests
from tests.support.files.held import another_process

SPEC = """\
name = "tiny"
description = "Five stacks of six small frames."
seed = 9
[splits]
train = 2
validation = 1
test = 1
[scene]
source.kind = "cone"
phantom.wall = "uniform"
motion.start_mm = 2.0
motion.travel_mm = 0.1
motion.frames = 6
microscope.width_px = 96
microscope.height_px = 72
microscope.scale_mm_px = 0.045
exposures.kinds = ["metered"]
clocks.kinematics_hz = 20.0
[vary]
spot.eccentricity_mm = { uniform = [0.0, 4.0] }
source.cone_k = { log_uniform = [10.0, 25.0] }
[adverse]
stacks = 1
[adverse.conditions.saturation]
exposures.kinds = ["paper"]
"""
STACKS = ["train/0000", "train/0001", "validation/0000", "test/0000", "adverse/saturation-0000"]


@contextmanager
def here() -> Iterator[Client]:
    """A Dask worker in this process, where everything is compiled already."""
    with Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=":0") as own:
        yield own


@contextmanager
def nobody() -> Iterator[Client]:
    raise AssertionError("there is nothing to render")
    yield


def seen_by(watch: Callable[[int, int], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a function see the bar: how many stacks are done, of how many."""

    @contextmanager
    def bar(what: str, *, total: int) -> Iterator[Callable[..., None]]:
        done = 0

        def advance(steps: int = 1) -> None:
            nonlocal done
            done += steps
            watch(done, total)

        yield advance

    monkeypatch.setattr(make, "bar", bar)


@pytest.fixture(scope="module")
def spec_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("spec") / "tiny.toml"
    file.write_text(SPEC)
    return file


@pytest.fixture(scope="module")
def spec(spec_file):
    return load_spec(spec_file)


@pytest.fixture(scope="module")
def whole(spec, tmp_path_factory):
    return make_set(spec, tmp_path_factory.mktemp("whole") / "set", workers=here()).folder


@pytest.fixture
def copy(whole, tmp_path):
    """The whole set, to be damaged."""
    return Path(shutil.copytree(whole, tmp_path / "copy"))


def test_a_set_holds_every_stack_of_its_spec_with_all_labels(spec, whole):
    labelled = read_set(whole)
    assert [f"{stack.split}/{stack.name}" for stack in labelled.stacks] == STACKS
    for planned, stack in zip(plan(spec), labelled.stacks, strict=True):
        opened = stack.open()
        assert opened.description["scene"] == planned.scene.model_dump(mode="json", by_alias=True)
        assert len(opened.labels) == 6
        opened.verify()
    # 3 files a frame would be 2 images and a label; every stack adds 5 files of its own.
    assert verify_set(whole) >= 5 * (12 + 5)


def test_a_split_has_one_line_an_image_with_its_own_scene_parameters(whole):
    labelled = read_set(whole)
    for split in labelled.splits:
        text = (whole / split / "metadata.jsonl").read_text()
        lines = [json.loads(line) for line in text.splitlines()]
        stacks = [stack for stack in labelled.stacks if stack.split == split]
        assert len(lines) == 6 * len(stacks)
        for line, stack in zip(lines[::6], stacks, strict=True):
            assert (whole / split / line["file_name"]).is_file()
            assert (whole / split / line["mask_file_name"]).is_file()
            assert line["condition"] == (stack.condition or "")
            assert line["c_mm"] == pytest.approx(line["spot.eccentricity_mm"], abs=1e-9)
            assert line["cone_k"] == pytest.approx(line["source.cone_k"], rel=1e-12)


def test_the_data_card_counts_what_is_there(whole):
    card = (whole / "README.md").read_text()
    assert "30 rendered images" in card
    assert "| train |  | 2 | 12 |" in card
    assert "| adverse | saturation | 1 | 6 |" in card
    assert "license: cc-by-4.0" in card
    for picture in ("samples.png", "histograms.png"):
        assert picture in card
        assert (whole / picture).is_file()


def test_a_finished_set_is_left_as_it_is(spec, copy):
    before = {path: path.stat().st_mtime_ns for path in copy.rglob("*")}
    make_set(spec, copy, workers=nobody())
    assert {path: path.stat().st_mtime_ns for path in copy.rglob("*")} == before


def test_what_one_shard_has_made_the_next_leaves_and_the_last_one_finishes_the_set(
    spec, whole, tmp_path
):
    out = tmp_path / "set"
    first = make_set(spec, out, workers=here(), shard=(2, 2))
    assert [f"{stack.split}/{stack.name}" for stack in first.missing] == STACKS[::2]
    with pytest.raises(InputError, match="stack train/0000 is missing"):
        verify_set(out)
    before = (out / "train" / "0001" / "manifest.json").stat().st_mtime_ns
    assert not make_set(spec, out, workers=here(), shard=(1, 2)).missing
    assert (out / "train" / "0001" / "manifest.json").stat().st_mtime_ns == before
    assert digests(out) == digests(whole)


@pytest.mark.parametrize(
    "text", ["", "[]", "{", "[" * 100_000, '{"name": ' + "9" * 5000 + "}", "\udcff", "{}"]
)
def test_a_damaged_set_is_not_continued(spec, tmp_path, text):
    (tmp_path / "set.json").write_text(text, errors="surrogateescape")
    with pytest.raises(InputError, match=r"set\.json: |a set with other settings"):
        make_set(spec, tmp_path, workers=nobody())
    assert [path.name for path in tmp_path.iterdir()] == ["set.json"]


def test_a_folder_with_another_set_or_something_else_is_refused(spec, spec_file, copy, tmp_path):
    other = load_spec(spec_file, ["spot.incidence_deg = 20.0"])
    with pytest.raises(InputError, match=r"spot\.incidence_deg': None instead of 20"):
        make_set(other, copy, workers=nobody())
    description = json.loads((copy / "set.json").read_text())
    description["versions"]["mitsuba"] = "3.0.0"
    (copy / "set.json").write_text(json.dumps(description, indent=1) + "\n")
    with pytest.raises(InputError, match=r"versions\.mitsuba': '3\.0\.0' instead of"):
        make_set(spec, copy, workers=nobody())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    with pytest.raises(InputError, match="has files that are not from `eyespot dataset make`"):
        make_set(spec, tmp_path / "mine", workers=nobody())


def test_verify_names_every_file_that_is_missing_changed_or_does_not_belong(copy):
    frame = copy / "train" / "0000" / "frames" / "000003.png"
    content = frame.read_bytes()
    frame.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    (copy / "test" / "0000" / "masks" / "000001.png").unlink()
    (copy / "notes.txt").touch()
    with pytest.raises(InputError) as caught:
        verify_set(copy)
    told = str(caught.value).splitlines()
    assert len(told) == 3
    for line in (
        "notes.txt is not in manifest.json",
        "train/0000/frames/000003.png differs from its checksum in manifest.json",
        "test/0000/masks/000001.png is missing, though manifest.json lists it",
    ):
        assert f"{copy}: {line}" in told


def test_a_set_with_impossible_scenes_is_refused_before_any_is_rendered(spec_file, tmp_path):
    # At d = 5.9 mm and k < 12.7 the spot is wider than the 1.44 mm that 72 px of 0.02 mm show.
    changes = ["microscope.scale_mm_px = 0.02", "motion.start_mm = 5.9"]
    with pytest.raises(SceneError, match=r"\d of 5 stacks are impossible.* One window of"):
        make_set(load_spec(spec_file, changes), tmp_path / "set", workers=here())
    never = load_spec(spec_file, [*changes, "source.cone_k = 10"])
    with pytest.raises(SceneError, match=r"\w+/0000: .*the spot leaves the 96 x 72 px window"):
        make_set(never, tmp_path / "set", workers=here())
    assert not (tmp_path / "set").exists()


def test_stacks_that_are_left_out_are_listed_in_the_set_and_its_card(spec_file, tmp_path):
    (tmp_path / "spec.toml").write_text('impossible = "leave out"\n' + spec_file.read_text())
    changes = ["microscope.scale_mm_px = 0.02", "motion.start_mm = 5.9", "motion.frames = 1"]
    spec = load_spec(tmp_path / "spec.toml", changes)
    out = make_set(spec, tmp_path / "set", workers=here()).folder
    left_out = json.loads((out / "set.json").read_text())["left_out"]
    assert 0 < len(left_out) < 5
    card = (out / "README.md").read_text()
    assert f"**{len(left_out)} stacks were left out**" in card
    for one in left_out:
        # The spot is wider by 1/cos(30 degrees) along the tilt: 1.44 mm at k 15.7.
        assert one["parameters"]["source.cone_k"] < 15.7
        assert f"| {one['split']}/{one['name']} | {one['problem']} |" in card
    verify_set(out)


def test_an_estimate_counts_the_images_and_weighs_them(spec, whole):
    planned = plan(spec)
    count, size, seconds = estimate(planned)
    assert (len(planned), count) == (5, 30)
    images = sum(path.stat().st_size for path in whole.glob("*/*/*/*.png"))
    # Five of six like frames stand for the others; descriptions and labels are a few per cent.
    assert size == pytest.approx(images, rel=0.5)
    assert seconds > 0


def started(role: str, *arguments: object, on: Sequence[str] = ()) -> subprocess.Popen[bytes]:
    """A process of Dask's; `on` runs it on another machine."""
    module = f"distributed.cli.dask_{role}"
    return subprocess.Popen(
        [*on, sys.executable, "-m", module, "--dashboard-address", ":0", *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@pytest.mark.slow
def test_two_processes_make_the_same_set_though_one_is_killed_again_and_again(
    spec, whole, tmp_path, monkeypatch
):
    out = tmp_path / "set"
    killed: list[int] = []
    with local_workers(2) as client:

        @contextmanager
        def these() -> Iterator[Client]:
            yield client

        def kill_one(done: int, total: int) -> None:
            # Dask gives up on a stack whose workers died more than three times.
            if done < total and len(killed) < 3:
                client.wait_for_workers(1)
                killed.append(next(iter(client.run(os.getpid, on_error="ignore").values())))
                os.kill(killed[-1], signal.SIGKILL)

        seen_by(kill_one, monkeypatch)
        make_set(spec, out, workers=these())
    assert len(killed) == 3
    verify_set(out)
    assert digests(out) == digests(whole)


def test_a_stack_that_another_run_writes_is_waited_for_and_rendered_if_that_run_stops(
    spec, whole, tmp_path, monkeypatch
):
    out = tmp_path / "set"
    busy = out / "train" / ".0000.partial"
    busy.mkdir(parents=True)
    shutil.copy(whole / "set.json", out)
    done: list[int] = []
    with another_process("whole_files.lock(path, of=path)", busy) as other:

        def stop_the_other(stacks: int, total: int) -> None:
            done.append(stacks)
            if stacks == total - 1:
                assert not (out / "train" / "0000").exists()
                other.communicate()

        seen_by(stop_the_other, monkeypatch)
        make_set(spec, out, workers=here())
    assert done == [0, 1, 2, 3, 4, 5]
    verify_set(out)
    assert digests(out) == digests(whole)


@pytest.mark.slow
@pytest.mark.parametrize("shards", [[], ["1/2", "2/2"]])
def test_two_runs_at_the_same_time_both_end_well_and_the_set_is_complete(
    spec_file, whole, tmp_path, shards
):
    out = tmp_path / "set"
    runs = [
        subprocess.Popen(
            [EYESPOT, "dataset", spec_file, "--out", out, "--workers", "1"]
            + (["--shard", shard] if shard else [])
        )
        for shard in shards or ["", ""]
    ]
    assert [run.wait() for run in runs] == [0, 0]
    assert verify_set(out) == verify_set(whole)
    assert digests(out) == digests(whole)


@contextmanager
def cluster(
    folder: Path, *, host: str = "127.0.0.1", on: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """A scheduler and one worker, in processes of their own; `file` says where it is."""
    file = folder / "scheduler.json"
    scheduler = started("scheduler", "--host", host, "--port", 0, "--scheduler-file", file)
    worker = started("worker", "--scheduler-file", file, "--nthreads", 1, "--no-nanny", on=on)
    try:
        while not file.is_file():
            assert scheduler.poll() is None, "it ended too early"
            time.sleep(0.02)
        yield {"file": file, "scheduler": scheduler, "worker": worker}
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()


@pytest.mark.slow
def test_the_workers_of_a_running_scheduler_make_the_same_set(spec, whole, tmp_path):
    with cluster(tmp_path) as there:
        address = json.loads(there["file"].read_text())["address"]
        make_set(spec, tmp_path / "set", workers=running_scheduler(address))
    assert digests(tmp_path / "set") == digests(whole)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [10, 90])
def test_a_worker_that_does_not_answer_for_a_while_is_waited_for(
    spec_file, whole, tmp_path, monkeypatch, seconds
):
    out = tmp_path / "set"
    with cluster(tmp_path) as there:
        worker = there["worker"]

        def stop(done: int, total: int) -> None:
            if done == 1:
                worker.send_signal(signal.SIGSTOP)
                threading.Timer(seconds, worker.send_signal, [signal.SIGCONT]).start()

        seen_by(stop, monkeypatch)
        outcome = run("dataset", spec_file, "--out", out, "--scheduler", there["file"])
    assert outcome.exit_code == 0, outcome.stderr
    assert digests(out) == digests(whole)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("who", "words"),
    [
        ("scheduler", "the Dask scheduler no longer answers; 4 stacks are still missing"),
        ("worker", "Dask has had no worker for 5 s; 4 stacks are still missing"),
    ],
)
def test_what_dies_for_good_is_named_and_the_next_run_continues(
    spec_file, whole, tmp_path, monkeypatch, who, words
):
    out = tmp_path / "set"
    monkeypatch.setattr(make, "_ALONE_S", 5.0)
    with cluster(tmp_path) as there:
        seen_by(lambda done, total: there[who].kill() if done == 1 else None, monkeypatch)
        outcome = run("dataset", spec_file, "--out", out, "--scheduler", there["file"])
        outcome.assert_bad_input(words, "run the same command")
    monkeypatch.undo()
    assert run("dataset", spec_file, "--out", out, "--workers", 1).exit_code == 0
    assert digests(out) == digests(whole)


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@pytest.fixture
def cable():
    """A cable to another machine: a network namespace, whose worker reaches us by this alone."""
    name = f"eye{os.getpid()}"
    try:
        ip("netns", "add", name)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"a network namespace needs root and the program ip: {error}")
    try:
        ip("link", "add", name, "type", "veth", "peer", "name", "near", "netns", name)
        ip("addr", "add", "10.213.77.1/24", "dev", name)
        ip("-n", name, "addr", "add", "10.213.77.2/24", "dev", "near")
        ip("link", "set", name, "up")
        ip("-n", name, "link", "set", "lo", "up")
        ip("-n", name, "link", "set", "near", "up")
        yield name
    finally:
        ip("netns", "del", name)  # and with it the cable


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "survives"), [(10, True), (90, False)])
def test_a_network_that_is_cut_costs_at_most_another_run(
    spec_file, whole, tmp_path, monkeypatch, cable, seconds, survives
):
    out = tmp_path / "set"

    def cut(done: int, total: int) -> None:
        if done == 1:
            ip("link", "set", cable, "down")
            threading.Timer(seconds, ip, ["link", "set", cable, "up"]).start()

    with cluster(tmp_path, host="10.213.77.1", on=["ip", "netns", "exec", cable]) as there:
        seen_by(cut, monkeypatch)
        outcome = run("dataset", spec_file, "--out", out, "--scheduler", there["file"])
    if survives:
        assert outcome.exit_code == 0, outcome.stderr
    else:
        # Dask gives a connection up after 30 s, and we a cluster without workers after 60 s.
        outcome.assert_bad_input("Dask has had no worker for 60 s; 4 stacks are still missing")
        monkeypatch.undo()
        assert run("dataset", spec_file, "--out", out, "--workers", 1).exit_code == 0
    assert digests(out) == digests(whole)


def test_a_scheduler_that_does_not_answer_is_named():
    with pytest.raises(ValueError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        running_scheduler("tcp://127.0.0.1:9", patience="0.2s").__enter__()
