"""Recordings for the Rerun viewer: frames, spots, beam and eyeball.

Everything is in the eye frame, mm: the origin is the eyeball's centre, +z points to the microscope.
"""

import contextlib
import math
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eyespot.estimator.image import outline_px, rgb_8bit
from eyespot.formats.camera_sheet import LensDistortion, Response
from eyespot.formats.inputs import InputError, in_utf8
from eyespot.formats.microscope import MicroscopeFile, read_microscope
from eyespot.formats.spot import NoSpot, Spot
from eyespot.formats.stack import FrameLabels, read_stack
from eyespot.formats.whole_files import written_whole

if TYPE_CHECKING:
    from eyespot.estimator.distance.range import Range
    from eyespot.estimator.run.reader import Reading
    from eyespot.estimator.sources.source import Frame


_GREY, _RING = (128, 128, 128), (190, 120, 90)
_RINGS_MM = range(1, 7)  # eccentricities, where beams are pointed
_POINTS = 73


def log_eyeball(stream: Any, microscope: MicroscopeFile) -> None:
    """Add a spherical eyeball, or a plane wall, with rings at every mm of eccentricity.

    An ellipsoidal retina is not drawn.
    """
    import rerun

    stream.log("eye", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if microscope.retina_semi_axes_mm is not None:
        return
    radius = microscope.eye_radius_mm
    if microscope.plane_normal is None:
        wires = rerun.components.FillMode.MajorWireframe
        ball = rerun.Ellipsoids3D(radii=[radius], colors=[_GREY], fill_mode=wires)
        stream.log("eye/ball", ball, static=True)
    angle = np.linspace(0, 2 * np.pi, _POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    rings = [
        np.column_stack([c * circle, _heights_mm(microscope, c * circle)])
        for c in _RINGS_MM
        if c < radius
    ]
    stream.log("eye/retina", rerun.LineStrips3D(rings, colors=[_RING]), static=True)


def _heights_mm(microscope: MicroscopeFile, points_mm: np.ndarray) -> np.ndarray:
    """z of the wall at points (..., 2) of the plane square to the microscope's axis."""
    if microscope.plane_normal is not None:
        nx, ny, nz = microscope.plane_normal
        return -microscope.eye_radius_mm - points_mm @ np.array([nx, ny]) / nz
    return -np.sqrt(microscope.eye_radius_mm**2 - np.sum(points_mm**2, axis=-1))


LIVE = "live"
"""The name that shows a recording in a viewer at once instead of writing it to a file."""

_MEASURED, _TRUE = (60, 255, 60), (255, 180, 40)
_PATIENCE_S = 20.0  # until the viewer's window is open, or has taken what was sent
_JPEG_QUALITY = 90  # a frame of 0.9 MB becomes 0.05 MB


def check_recording_path(target: str) -> None:
    """Raise an InputError unless a recording can be made: its name, and the package rerun."""
    if target != LIVE and Path(target).suffix != ".rrd":
        raise InputError(f"{target}: a recording is a file NAME.rrd, or {LIVE}. Choose one.")
    has_display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if target == LIVE and sys.platform == "linux" and not has_display:
        raise InputError(f"{LIVE} needs a display, and there is none. Record a file NAME.rrd.")
    try:
        import rerun  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError(
            "a recording needs the package rerun-sdk: pip install 'eyespot[rerun]'."
        ) from error


@contextmanager
def recording_of(
    target: str, *, name: str, microscope: MicroscopeFile | None
) -> Iterator["ViewerRecording"]:
    """Make a recording; a file gets its name when the block ends, whole or not at all.

    Args:
        target: a file NAME.rrd, or `LIVE`.
        microscope: of the frames; without one there is no eyeball, and frames are linear.

    Raises:
        InputError: as `check_recording_path`, something of this name exists, or the viewer does
            not open or was closed.
        OSError: it cannot be written.
    """
    check_recording_path(target)
    import rerun

    stream = rerun.RecordingStream("eyespot", recording_id=None)
    stream.send_recording_name(in_utf8(name))
    if target == LIVE:
        stream.connect_grpc(_opened_viewer(), default_blueprint=_blueprint())
        yield ViewerRecording(stream, microscope)
        try:
            stream.flush(timeout_sec=_PATIENCE_S)
        except RuntimeError as error:
            raise InputError(
                f"rerun's viewer was closed, or did not take all frames ({error}). All other"
                " results are complete. Record a file NAME.rrd, and open it with rerun."
            ) from error
        return
    with written_whole(Path(target)) as partial:
        stream.save(partial, default_blueprint=_blueprint())
        yield ViewerRecording(stream, microscope)
        stream.disconnect()


def record_stack(folder: Path, target: str) -> None:
    """Record the frames of a stack with its labels: their true contours, tips and distances.

    Args:
        folder: of the stack; of several exposures the first is taken.

    Raises:
        InputError: as `recording_of`, or the stack cannot be read.
        OSError: it cannot be written.
    """
    stack = read_stack(folder)
    microscope = read_microscope(folder / "microscope.json")
    with recording_of(target, name=folder.name, microscope=microscope) as recording:
        for labels in stack.exposed(stack.labels[0].exposure):
            recording.add_frame(labels.frame, labels.time_s, stack.image(labels))
            recording.add_truth(labels)


class ViewerRecording:
    """Frames, contours, distances, and the beam in the eye, on the timelines `frame` and `time`."""

    def __init__(self, stream: Any, microscope: MicroscopeFile | None) -> None:
        self._stream = stream
        self._response = microscope.response if microscope else Response()
        self._camera: LensDistortion | None = microscope.camera() if microscope else None
        if microscope is not None:
            log_eyeball(stream, microscope)

    def add_frame(self, index: int, time_s: float, image: np.ndarray | None) -> None:
        """Add a frame; what is added after it belongs to it.

        Args:
            image: as `rgb_8bit` takes it; None if there is only what was measured.
        """
        import rerun

        self._stream.reset_time()
        self._stream.set_time("frame", sequence=index)
        if not math.isnan(time_s):
            self._stream.set_time("time", duration=time_s)
        if image is None:
            return
        picture = rerun.Image(rgb_8bit(image, self._response)).compress(jpeg_quality=_JPEG_QUALITY)
        self._stream.log("microscope", picture)

    def add_reading(self, frame: "Frame", reading: "Reading") -> None:
        """Add a frame and what was measured in it."""
        self.add_frame(frame.index, frame.time_s, frame.image)
        self.add_measured(reading.result, reading.range, reading.doubt)

    def add_measured(self, result: Spot | NoSpot, distance: "Range | None", doubt: str) -> None:
        """Add what was measured in the frame: contour, distance with its σ, and pose of the tip.

        The distance's lower and upper lines are one standard deviation away from it.

        Args:
            doubt: why there is no spot, or why the distance is doubtful; empty if all is well.
        """
        import rerun

        log = self._stream.log
        if isinstance(result, NoSpot):
            log("microscope/spot", rerun.Clear(recursive=True))
        else:
            self._log_contour("microscope/spot", result.ellipse, _MEASURED)
        if distance is not None:
            for name, sigmas in (("measured", 0), ("lower", -1), ("upper", 1)):
                value = distance.distance_mm + (sigmas * distance.sigma_mm if sigmas else 0.0)
                if not math.isnan(value):
                    self.add_value(f"distance/{name}", value)
        log("eye/measured", rerun.Clear(recursive=True))
        if distance is not None and distance.poses:
            pose = distance.poses[0]
            arrow_mm = pose.distance_mm * pose.axis
            self._log_beam("eye/measured", pose.tip_mm, arrow_mm, _MEASURED)
        if doubt:
            log("status", rerun.TextLog(doubt, level=rerun.TextLogLevel.WARN))

    def add_value(self, path: str, value: float) -> None:
        """Add a number of the frame, such as "distance/robot" or "residuals/size"."""
        import rerun

        self._stream.log(path, rerun.Scalars(value))

    def add_truth(self, labels: FrameLabels) -> None:
        """Add what a stack's labels say of the frame."""
        names = ("x_px", "y_px", "semi_major_px", "semi_minor_px", "angle_rad")
        ellipse = [getattr(labels, f"half_max_{name}") for name in names]
        self._log_contour("microscope/truth", ellipse, _TRUE)
        self.add_value("distance/truth", labels.d_mm)
        arrow_mm = labels.d_mm * np.array(labels.axis)
        self._log_beam("eye/truth", np.array(labels.tip_mm), arrow_mm, _TRUE)

    def _log_beam(
        self, path: str, tip_mm: np.ndarray, arrow_mm: np.ndarray, colour: tuple[int, int, int]
    ) -> None:
        """Add the tip, and an arrow from there to the wall."""
        import rerun

        tip = rerun.Points3D([tip_mm], radii=[0.1], colors=[colour])
        arrow = rerun.Arrows3D(origins=[tip_mm], vectors=[arrow_mm], colors=[colour])
        self._stream.log(f"{path}/tip", tip)
        self._stream.log(f"{path}/beam", arrow)

    def _log_contour(
        self, path: str, ellipse: Sequence[float], colour: tuple[int, int, int]
    ) -> None:
        import rerun

        points, centre = outline_px(ellipse, self._camera)
        # Rerun counts pixels from the corner of the first, we from its centre.
        closed = np.concatenate([points, points[:1]]) + 0.5
        self._stream.log(path, rerun.LineStrips2D([closed], colors=[colour]))
        self._stream.log(f"{path}/centre", rerun.Points2D([centre + 0.5], colors=[colour]))


def _opened_viewer() -> str:
    """Open a viewer, which stays open, on a port of loopback; its address."""
    # rerun's own `spawn` would listen on all interfaces.
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", "--port", f"{port}"]
    viewer = subprocess.Popen([*command, "--hide-welcome-screen"], start_new_session=True)
    deadline = time.monotonic() + _PATIENCE_S
    while viewer.poll() is None and time.monotonic() < deadline:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return f"rerun+http://127.0.0.1:{port}/proxy"
        time.sleep(0.1)
    raise InputError("rerun's viewer did not open (see above). Record a file NAME.rrd.")


def _blueprint() -> Any:
    """The windows: microscope, eye, distance over time, and doubts."""
    from rerun import blueprint

    return blueprint.Blueprint(
        blueprint.Vertical(
            blueprint.Horizontal(
                blueprint.Spatial2DView(origin="microscope", name="Microscope"),
                blueprint.Spatial3DView(origin="eye", name="Eye, mm"),
            ),
            blueprint.Horizontal(
                blueprint.TimeSeriesView(origin="distance", name="Distance, mm"),
                blueprint.TimeSeriesView(origin="residuals", name="Residuals of a fit, σ"),
                blueprint.TextLogView(origin="status", name="Doubts"),
                column_shares=[3, 2, 1],
            ),
            row_shares=[3, 2],
        )
    )
