"""What makes frames fast changes nothing: pixels rendered again, and lenses kept on disk."""

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eyespot import optics
from eyespot.formats.whole_files import kept_arrays
from eyespot.scenes import Scene, load_mitsuba
from eyespot.scenes.rendering.images import Images
from eyespot.scenes.world.world import LIGHT_FILES, World
from tests.support.drawn.scene_tables import scene_of


def scene(**parts: Any) -> Scene:
    """A withdrawal of the ideal cone with its instrument, in a small window."""
    window = {"width_px": 200, "height_px": 150, "scale_mm_px": 0.025}
    parts.setdefault("motion", {"travel_mm": 4.0, "frames": 3})
    return scene_of({"source": {"kind": "cone"}, "microscope": window}, parts)


@pytest.mark.parametrize(
    "settings",
    [
        scene(),
        scene(spot={"eccentricity_mm": 3.0, "incidence_deg": 0.0}, instrument={"gauge": 20}),
        scene(
            second_tool={"visible": True, "tip_mm": [-0.8, 0.3, -10.8]},
            microscope={"pinhole_height_mm": 200.0, "samples": 9},
        ),
        scene(
            phantom={"kind": "plane", "tilt_deg": 20.0},
            microscope={"pinhole_height_mm": np.inf, "light": "ambient", "vignetting": 0.3},
        ),
        scene(
            microscope={"distortion": [-0.2, 0.3, 0.02, -0.03, 0.5], "samples": 1},
            motion={"kind": "hand", "duration_s": 0.2, "distance_mm": 1.0},
        ),
    ],
    ids=["plain", "square", "second tool", "telecentric plane", "distorted hand"],
)
def test_a_frame_of_which_only_the_changes_are_rendered_is_the_whole_frame(settings):
    world = World(settings)
    images = Images(world, variant="llvm_ad_rgb")
    seen = []
    for tip, axis in zip(*world.motion.at(world.times), strict=True):
        radiance, wall = images.at(tip=tip, axis=axis, seed=0)
        # Mitsuba's own loop over all pixels, with the tip where it is now.
        whole = np.array(load_mitsuba().render(images.mitsuba_scene))
        # Single precision: sums in another order, places on the film that differ in the last bit.
        np.testing.assert_allclose(radiance, whole[..., :3], rtol=0, atol=1e-6 * whole.max())
        np.testing.assert_allclose(wall, whole[..., 3], atol=1e-6)
        seen.append(wall.min())
    assert min(seen) == 0, "no instrument in view"


def saved(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def test_what_was_computed_once_is_read_and_a_damaged_file_is_written_anew(tmp_path):
    file, computed = tmp_path / "cache" / "lens.npz", []

    def compute() -> dict[str, np.ndarray]:
        computed.append(1)
        return {"values": np.arange(1000.0)}

    for runs, damage in [
        (1, lambda whole: whole),
        (1, lambda whole: whole[: len(whole) // 2]),
        (2, lambda whole: whole[:500] + bytes([whole[500] ^ 1]) + whole[501:]),
        (3, lambda whole: b""),
        (4, lambda whole: saved(other=np.arange(1000.0))),
        (5, lambda whole: saved(values=np.full(1000, np.nan))),
        (6, lambda whole: saved(values=np.arange(8.0)).replace(b"(8,), ", b"(9999999999,), ")),
        (7, lambda whole: whole),
    ]:
        found = kept_arrays(file, ["values"], compute)["values"]
        np.testing.assert_array_equal(found, np.arange(1000.0))
        assert len(computed) == runs
        file.write_bytes(damage(file.read_bytes()))
    assert [path.name for path in file.parent.iterdir()] == ["lens.npz"]


def test_a_lens_is_computed_anew_if_any_code_that_it_depends_on_changes():
    folder = Path(optics.__file__).parent
    text = "".join((folder / file).read_text() for file in LIGHT_FILES)
    imported = re.findall(r"^from eyespot\.optics\.(\w+) import", text, re.MULTILINE)
    used = {f"{name}.py" for name in imported}
    assert used <= {*LIGHT_FILES}


def test_a_cache_that_cannot_be_written_costs_no_result(tmp_path):
    (tmp_path / "cache").write_text("a file where the folder would be")
    kept = kept_arrays(
        Path(tmp_path / "cache" / "lens.npz"), ["values"], lambda: {"values": np.ones(3)}
    )
    np.testing.assert_array_equal(kept["values"], np.ones(3))
