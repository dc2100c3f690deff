"""The same stack from every variant of Mitsuba that a machine can run."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from eyespot.formats.stack import Stack, read_stack
from eyespot.scenes import SceneError, load_scene, render_stack
from eyespot.scenes.machine.llvm import ENVIRONMENT_VARIABLE
from tests.support.command_line import run_process, run_python

SCENE = """\
schema = 1
[source]
kind = "cone"
[spot]
eccentricity_mm = 2.0
[motion]
start_mm = 3.0
frames = 1
[microscope]
scale_mm_px = 0.1
width_px = 24
height_px = 16
[exposures]
kinds = ["metered"]
"""


def compare(folder: Path, variant: str, **environment: str) -> None:
    """A stack that a process of its own has rendered, as a process runs one variant, with ours."""
    scene = folder / "scene.toml"
    scene.write_text(SCENE)
    options = ("--out", folder / variant, "--variant", variant)
    done = run_process("render", scene, *options, **environment)
    assert done.exit_code == 0, done.stderr
    reference = render_stack(load_scene(folder / "scene.toml"), folder / "llvm_ad_rgb")
    other: Stack = read_stack(folder / variant)
    assert other.description["run"]["variant"] == variant
    for own, row in zip(other.labels, reference.labels, strict=True):
        assert own.half_max_semi_minor_px == row.half_max_semi_minor_px
        assert own.exposure_s == pytest.approx(row.exposure_s, rel=1e-4)
        image, expected = (
            np.asarray(cv2.imread(str(stack.folder / label.file_name)), int)
            for stack, label in ((other, own), (reference, row))
        )
        # The same noise on light that differs by float32: a value may be rounded the other way,
        # and of the few samples on a sharp edge one may fall on its other side.
        changed = np.abs(image - expected).max(axis=-1)
        assert (changed > 1).mean() < 0.01
        assert expected.max() > 150  # there is a spot


@pytest.mark.slow
def test_without_llvm_a_cone_is_rendered_in_scalar_mode(tmp_path):
    nowhere = {ENVIRONMENT_VARIABLE: str(tmp_path / "libLLVM-15.so.1")}
    compare(tmp_path, "scalar_rgb", **nowhere)


@pytest.mark.parametrize(
    "change", ["source.kind=lens", "phantom.indirect=traced", "phantom.spread=printed paper"]
)
def test_scalar_mode_refuses_what_it_cannot_do_in_time(tmp_path, change):
    scene = load_scene(None, ["source.kind=cone", change])
    with pytest.raises(SceneError, match="'cone' without traced or spread light; got"):
        render_stack(scene, tmp_path / "stack", variant="scalar_rgb")
    assert not (tmp_path / "stack").exists()


@pytest.mark.gpu
def test_a_gpu_renders_the_same_stack(tmp_path):
    compare(tmp_path, "cuda_ad_rgb")


_FORK = """
import os
from eyespot.scenes import RendererUnavailable, load_mitsuba
load_mitsuba()
if os.fork() == 0:
    try:
        load_mitsuba()
    except RendererUnavailable as refused:
        print(refused, flush=True)
    os._exit(0)
os.wait()
"""


def test_a_fork_of_a_process_that_has_rendered_is_refused():
    assert "get_context('spawn')" in run_python(_FORK).stdout
