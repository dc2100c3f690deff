"""GenICam cameras: the simulated ones that come with the package genicam, and drawn buffers."""

from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from eyespot.estimator.sources.genicam import _message
from eyespot.estimator.sources.opening import open_source
from eyespot.estimator.sources.ros import frame_of_message
from eyespot.formats.inputs import InputError


@pytest.fixture
def cameras(monkeypatch):
    """Three cameras with a ball of one colour that bounces in 400x400 px."""
    genicam = pytest.importorskip("genicam", reason="pip install 'eyespot[genicam]'")
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(Path(genicam.__file__).parent))


@pytest.mark.usefixtures("cameras")
@pytest.mark.parametrize("name", ["1", "VikyTL_DEV_green"])
def test_a_simulated_camera_sends_frames_by_its_number_and_its_name(name):
    source = open_source(f"genicam:{name}")
    assert source.live
    for _ in range(2):  # it can be opened again, as after it was lost
        frames = list(islice(source, 3))
        assert [frame.image.shape for frame in frames] == [(400, 400, 3)] * 3
        times = [frame.time_s for frame in frames]
        assert times == sorted(times)


@pytest.mark.usefixtures("cameras")
def test_a_camera_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(InputError, match=r"no camera genicam:'7'. .*1, 1, VikyTL_DEV_green; 2, 2"):
        open_source("genicam:7")


def test_without_a_producer_the_vendors_software_is_missing(monkeypatch, tmp_path):
    pytest.importorskip("harvesters", reason="pip install 'eyespot[genicam]'")
    for folders in ("", str(tmp_path)):
        monkeypatch.setenv("GENICAM_GENTL64_PATH", folders)
        with pytest.raises(InputError, match=r"no GenTL producer .*Install the software"):
            open_source("genicam:0")


RGB = np.array([200, 120, 40])
"""Of an even image, in which a mosaic and halved chroma lose nothing."""


@pytest.mark.parametrize(
    ("form", "data", "pixel", "full_scale"),
    [
        ("Mono8", np.full(96, 90, "u1"), 90, None),
        ("Mono12", np.full(96, 900, "u2"), 900, 4095.0),
        ("Mono12p", np.full(96, 900, "u2"), 900, 4095.0),  # harvesters has unpacked it
        ("Mono10Packed", np.full(96, 900, "u2"), 900, 1023.0),
        ("RGB8", np.tile(RGB, 96).astype("u1"), RGB, None),
        ("BGRa8", np.tile([*RGB[::-1], 255], 96).astype("u1"), RGB, None),
        ("BayerGB8", np.tile([*[120, 40] * 6, *[200, 120] * 6], 4).astype("u1"), RGB, None),
        ("BayerRG12", np.tile([*[2000, 1200] * 6, *[1200, 400] * 6], 4), RGB * 10, 4095.0),
        ("YUV422_8", np.tile([90, 128], 96).astype("u1"), (90 - 16) * 255 / 219, None),
        ("YUV422_8_UYVY", np.tile([128, 90], 96).astype("u1"), (90 - 16) * 255 / 219, None),
    ],
)
def test_pixel_formats_are_read_as_genicam_names_them(form, data, pixel, full_scale):
    """8 rows of 12 pixels, as harvesters gives the bytes of a buffer."""
    data = data if data.dtype == np.uint8 else data.astype(np.uint16)
    buffer = SimpleNamespace(data_format=form, width=12, height=8, data=data)
    frame, said = frame_of_message(_message(buffer))
    assert frame.shape[:2] == (8, 12)
    assert said == full_scale
    np.testing.assert_allclose(frame, np.broadcast_to(pixel, frame.shape), atol=0.5)
