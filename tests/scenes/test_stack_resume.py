"""Stacks on disk: stopped runs that go on, damage that is named, frames exposed again."""

import shutil
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from eyespot.formats.inputs import InputError
from eyespot.formats.stack import read_stack
from eyespot.scenes import Scene, SceneError, check_scene, least_bytes, render_stack
from tests.support.drawn.drawn_sets import digests
from tests.support.drawn.scene_tables import scene_of


def scene(**parts: Any) -> Scene:
    """Ten small frames of a slow withdrawal, with everything that a stack can hold."""
    plain = {
        "source": {"kind": "cone"},
        "phantom": {"wall": "uniform"},
        "motion": {"start_mm": 2.0, "travel_mm": 0.1, "frames": 10},
        "microscope": {"width_px": 96, "height_px": 72, "scale_mm_px": 0.045},
        "exposures": {"keep_linear": True},
        "clocks": {"kinematics_hz": 20.0},
    }
    return scene_of(plain, parts)


def stop(frames: int) -> Mock:
    """A progress bar that stops the run after so many frames."""
    return Mock(side_effect=[None] * (frames - 1) + [KeyboardInterrupt])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return render_stack(scene(), tmp_path_factory.mktemp("whole") / "stack")


@pytest.fixture
def copy(whole, tmp_path):
    """The whole stack, to be damaged."""
    return Path(shutil.copytree(whole.folder, tmp_path / "copy"))


def test_a_run_that_was_stopped_goes_on_and_ends_byte_for_byte_the_same(whole, tmp_path):
    out = tmp_path / "stack"
    for frames in (4, 7):
        with pytest.raises(KeyboardInterrupt):
            render_stack(scene(), out, progress=stop(frames))
        assert not out.exists()
    partial = tmp_path / ".stack.partial"
    before = {path.name: path.stat().st_mtime_ns for path in (partial / "frames").iterdir()}
    assert len(before) >= 6
    render_stack(scene(), out)
    assert digests(out) == digests(whole.folder)
    # What was there has not been written again.
    after = {path.name: path.stat().st_mtime_ns for path in (out / "frames").iterdir()}
    assert all(after[name] == written for name, written in before.items())
    assert [path.name for path in tmp_path.iterdir()] == ["stack"]


def test_a_label_line_that_was_being_written_counts_as_missing(whole, tmp_path):
    out = tmp_path / "stack"
    with pytest.raises(KeyboardInterrupt):
        render_stack(scene(), out, progress=stop(6))
    lines = tmp_path / ".stack.partial" / "metadata.jsonl"
    lines.write_bytes(lines.read_bytes()[:-40])
    left = tmp_path / ".stack.partial" / "frames" / ".000003.png.unfinished"
    left.mkdir()
    (left / "000003.png").write_bytes(b"half")
    (tmp_path / ".stack.partial" / "frames" / "000003.png").write_bytes(b"half")
    kept = [line for line in lines.read_text().splitlines(keepends=True) if "000003" not in line]
    lines.write_text("".join(kept))
    render_stack(scene(), out)
    assert digests(out) == digests(whole.folder)


def test_frames_of_another_scene_are_not_used(whole, tmp_path):
    out = tmp_path / "stack"
    with pytest.raises(KeyboardInterrupt):
        render_stack(scene(seed=5), out, progress=stop(5))
    render_stack(scene(), out)
    assert digests(out) == digests(whole.folder)


def test_frames_of_another_wall_image_are_not_used(tmp_path):
    picture = tmp_path / "wall.png"

    def painted(grey: int) -> Scene:
        cv2.imwrite(str(picture), np.full((40, 40, 3), grey, np.uint8))
        return scene(phantom={"wall": "image", "wall_image": str(picture)}, motion={"frames": 3})

    with pytest.raises(KeyboardInterrupt):
        render_stack(painted(90), tmp_path / "stack", progress=stop(2))
    render_stack(painted(200), tmp_path / "stack")
    render_stack(painted(200), tmp_path / "whole")
    assert digests(tmp_path / "stack") == digests(tmp_path / "whole")


def test_a_frame_without_a_line_and_a_line_without_a_frame_are_named(copy):
    (copy / "frames" / "000007.png").rename(copy / "frames" / "000099.png")
    with pytest.raises(InputError, match=r"metadata\.jsonl, line 8: .*000007\.png is missing"):
        read_stack(copy)
    (copy / "frames" / "000099.png").rename(copy / "frames" / "000007.png")
    lines = copy / "metadata.jsonl"
    text = lines.read_text().splitlines(keepends=True)
    lines.write_text("".join(text[:-1]))
    with pytest.raises(InputError, match=r"000019\.png has no line in .* ends after line 19"):
        read_stack(copy)
    lines.write_text("".join([*text, text[2]]))
    with pytest.raises(InputError, match=r"line 21: frames/000002\.png has a line already"):
        read_stack(copy)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda line: line[: len(line) // 2], "line 3: not JSON"),
        (lambda line: line.replace('"d_mm"', '"d_cm"'), "line 3: missing or unknown: d_cm, d_mm"),
    ],
)
def test_a_broken_label_line_is_named(copy, change, message):
    lines = (copy / "metadata.jsonl").read_text().splitlines()
    lines[2] = change(lines[2])
    (copy / "metadata.jsonl").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=rf"metadata\.jsonl, {message}"):
        read_stack(copy)


def test_a_truncated_frame_is_named(copy):
    stack = read_stack(copy)
    frame = copy / stack.labels[4].file_name
    frame.write_bytes(frame.read_bytes()[: frame.stat().st_size // 2])
    with pytest.raises(InputError, match=r"000004\.png is truncated"):
        stack.image(stack.labels[4])


def test_a_linear_frame_is_the_light_behind_its_image(whole):
    settings = scene()
    for row in whole.labels[:4]:
        light = whole.linear(row)
        assert light.dtype == np.float32
        camera = settings.camera
        wells = light * row.exposure_s * settings.exposures.sensitivity_mm2_sr_mj
        expected = camera.black_level_dn + np.minimum(wells, 1) * (255 - camera.black_level_dn)
        expected = np.minimum(expected, 255)
        below = wells < 0.95
        difference = (whole.image(row) - expected)[below]
        # Noise of 3 DN at most in some thousand samples, of mean 0.
        assert abs(difference.mean()) < 0.1
        assert np.abs(difference).max() < 6 * 3.5


def test_no_stack_is_smaller_than_the_space_that_is_asked_for(whole):
    size = sum(path.stat().st_size for path in whole.folder.rglob("*") if path.is_file())
    # Its radiance alone is 10 frames x 2 exposures x 96 x 72 pixels x 3 channels x 4 bytes.
    assert 20 * 96 * 72 * 3 * 4 < least_bytes(scene()) < size


def test_no_exposure_outlasts_the_time_between_frames(tmp_path):
    dim = {"sensitivity_mm2_sr_mj": 10.0}
    content = scene(exposures=dim).model_dump(mode="json", by_alias=True)
    content["motion"] = {"kind": "scan", "length_mm": 0.1}
    message = r"paper exposure takes .*camera_hz allows 0\.100 s"
    with pytest.raises(SceneError, match=message):
        render_stack(Scene.model_validate(content), tmp_path / "paper")
    with pytest.raises(SceneError, match=message):
        check_scene(Scene.model_validate(content))
    content["exposures"]["kinds"] = ["metered"]
    check_scene(Scene.model_validate(content))
    stack = render_stack(Scene.model_validate(content), tmp_path / "metered")
    assert [row.exposure_s for row in stack.labels] == [0.1, 0.1]
