"""The page: image, distance, course of the last 30 s, controls."""

from __future__ import annotations

import ipaddress
import math
import secrets
import time
from collections.abc import Callable
from http.cookies import SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import numpy as np
from nicegui import app, ui
from starlette.responses import Response as Reply

from estimator.console.guide import CalibrationPanel, Guide, exposure_advice
from estimator.console.session import COURSE_S, Session, View
from estimator.distance.budget import Budget
from estimator.image import outline_px
from estimator.run.options import Options
from estimator.sources.source import Source
from formats.inputs import InputError
from formats.microscope import MicroscopeFile
from formats.poses import PoseTrack
from formats.spots import NoSpot, Spot

_COOKIE = "eyespot"
_ASK = """<!doctype html><title>eyespot</title><meta name=viewport content="width=device-width">
<style>body{font:20px sans-serif;display:grid;place-content:center;height:90vh;gap:1em}
input,button{font:inherit;padding:.4em}</style>
<form method=post action=/token><label>Token, as the console printed it:
<input name=token type=password autofocus></label> <button>Open</button></form>"""
_MOST_BYTES = 4096


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Gate:
    """ASGI middleware before all pages, pictures and sockets.

    A page of another site that is open in the same browser is refused (by the header Origin), and
    so is a name that only pretends to be this machine (by the header Host).

    Args:
        app: behind the gate.
        token: that is asked for; None on loopback.
    """

    def __init__(self, app: Any, *, token: str | None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Let a request through, or answer it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode(): value.decode("latin-1") for name, value in scope["headers"]}
        host = headers.get("host", "")
        name = host.rpartition(":")[0].strip("[]") or host
        own = headers.get("origin", f"http://{host}").partition("://")[2] == host
        if not own or (self._token is None and not is_loopback(name)):
            await _refuse(scope, send, 403, b"Forbidden")
        elif self._token is None or self._knows(headers):
            await self._app(scope, receive, send)
        elif scope["type"] == "http" and scope["path"] == "/token" and scope["method"] == "POST":
            await self._enter(receive, send)
        else:
            await _refuse(scope, send, 401, _ASK.encode())

    def _knows(self, headers: dict[str, str]) -> bool:
        cookie = SimpleCookie(headers.get("cookie", "")).get(_COOKIE)
        return cookie is not None and secrets.compare_digest(cookie.value, self._token or "")

    async def _enter(self, receive: Any, send: Any) -> None:
        body, more = b"", True
        while more and len(body) < _MOST_BYTES:
            message = await receive()
            body, more = body + message.get("body", b""), message.get("more_body", False)
        given = parse_qs(body.decode("latin-1")).get("token", [""])[0]
        cookie = f"{_COOKIE}={given}; HttpOnly; SameSite=Strict; Path=/"
        right = secrets.compare_digest(given.encode(), (self._token or "").encode())
        kept = [(b"set-cookie", cookie.encode("latin-1"))] if right else []
        await send(
            {
                "type": "http.response.start",
                "status": 303,
                "headers": [(b"location", b"/"), *kept],
            }
        )
        await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Any, send: Any, status: int, body: bytes) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/html; charset=utf-8")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


_EXPECTED_PX = 14  # radius of the circle where the spot was expected


def svg_of(view: View, microscope: MicroscopeFile | None) -> str:
    """The contour, its centre, the tip if it is known, and where the spot was expected.

    Args:
        view: what was measured.
        microscope: of the frames; None if unknown.
    """
    camera = microscope.camera() if microscope else None
    parts = []
    distance = view.reading.range
    if microscope and not microscope.viewing_path and distance and distance.poses:
        x, y = tip_px(distance.poses[0].tip_mm, microscope) + 0.5
        parts.append(
            f'<path d="M{x - 7:.1f} {y - 7:.1f}l14 14m0 -14l-14 14" stroke="#ff5ecb"'
            ' stroke-width="2" vector-effect="non-scaling-stroke"/>'
        )
    if view.expected_px is not None:
        x, y = (value + 0.5 for value in view.expected_px)
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{_EXPECTED_PX}" fill="none" stroke="#4aa3ff"'
            ' stroke-width="1.5" stroke-dasharray="4 3" vector-effect="non-scaling-stroke"/>'
        )
    spot = view.reading.result
    if isinstance(spot, Spot):
        points, centre = outline_px(spot.ellipse, camera)
        corners = " ".join(f"{x + 0.5:.1f},{y + 0.5:.1f}" for x, y in points)
        x, y = centre + 0.5
        colour = "#ffb000" if view.reading.doubt else "#2bff5e"
        parts.append(
            f'<polygon points="{corners}" fill="none" stroke="{colour}" stroke-width="2"'
            ' vector-effect="non-scaling-stroke"/>'
            f'<path d="M{x - 6:.1f} {y:.1f}h12M{x:.1f} {y - 6:.1f}v12" stroke="{colour}"'
            ' stroke-width="1.5" vector-effect="non-scaling-stroke"/>'
        )
    return "".join(parts)


def tip_px(tip_mm: np.ndarray, microscope: MicroscopeFile) -> np.ndarray:
    r"""Where a point appears in the frame.

    $u = u_0 + X / s$ and $v = v_0 - Y / s$ with the scale $s = \delta (1 - \kappa (Z + r))$ at the
    point's height.

    Args:
        tip_mm: (X, Y, Z) in the eye frame, (3,).
        microscope: a pinhole or telecentric, without a viewing path.

    Returns:
        (u, v), px, (2,).
    """
    x, y, z = tip_mm
    height = z + microscope.eye_radius_mm
    scale = microscope.scale_mm_px * (1 - microscope.inverse_working_distance * height)
    point = np.array(microscope.principal_point_px) + np.array([x, -y]) / scale
    camera = microscope.camera()
    return point if camera is None else camera.all_distorted(point[None])[0]


_PICTURE_S, _COURSE_S = 0.04, 0.25  # how often a page looks for something new
_STYLE = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")


def serve(
    open_: Callable[[], Source],
    options: Options,
    *,
    folder: Path,
    host: str,
    port: int,
    token: str | None,
    poses: Callable[[], PoseTrack] | None = None,
) -> None:
    """Serve the page until Ctrl-C.

    Args:
        open_: opens the source.
        options: of the measurement.
        folder: of the recordings.
        host: address to listen on.
        port: to listen on.
        token: that the page asks for; None for none.
        poses: as of `Session`.

    Raises:
        InputError: options, files or the source are wrong.
        OSError: a file cannot be read.
    """
    microscope = options.microscope_file()
    response = microscope.response if microscope else None
    session = Session(open_, options.reader(), response=response, poses=poses)

    @app.get("/frame/{version}")
    def frame(version: int) -> Reply:
        # The newest, which may be newer than the one that was asked for.
        content = session.view.jpeg() if session.view else b""
        return Reply(content, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    guide = Guide(session, folder, options.microscope)

    @app.get("/report/{name}")
    def report(name: str) -> Reply:
        # The guide's own file, whatever name was asked for.
        page = guide.file.with_suffix(".html")
        if name != guide.file.stem or not page.is_file():
            return Reply("there is no such report", status_code=404)
        return Reply(page.read_bytes(), media_type="text/html")

    @ui.page("/")
    def page() -> None:
        Page(session, options, folder, lambda view: svg_of(view, microscope))
        CalibrationPanel(guide)

    app.add_middleware(Gate, token=token)
    try:
        ui.run(
            host=host,
            port=port,
            title="eyespot",
            dark=None,
            reload=False,
            show=False,
            show_welcome_message=False,
        )
    finally:
        guide.close()
        session.close()


class Page:
    """One window; all windows show the same session.

    Args:
        session: that is shown.
        options: of the measurement.
        folder: of the recordings.
        overlay: makes the SVG of a view.
    """

    def __init__(
        self, session: Session, options: Options, folder: Path, overlay: Callable[[View], str]
    ) -> None:
        self._session, self._folder, self._overlay = session, folder, overlay
        self._shown = -1
        ui.add_css(_STYLE)
        ui.keyboard(on_key=self._on_key)
        self._dark = ui.dark_mode(None)
        with ui.row().classes("top"):
            ui.label("eyespot").classes("brand")
            ui.label(session.source.name).classes("source")
            ui.label(_calibration_of(options)).classes("note")
            ui.space()
            ui.label(f"mode: {session.mode}").classes("note")
            ui.button("Light / dark", on_click=self._dark_light).props("flat dense")
        with ui.element("main"):
            with ui.element("section").classes("image"):
                self._image = ui.interactive_image(
                    on_mouse=self._on_click, events=["click"], cross=True, sanitize=False
                )
                self._image.props('alt="The microscope\'s image"')
            with ui.element("section").classes("reading") as self._reading:
                self._state = ui.label().classes("state")
                self._distance = ui.label("– mm").classes("distance")
                self._sigma = ui.label().classes("sigma")
                self._worth = ui.label().classes("note worth")
                self._reason = ui.label().classes("reason")
                self._advice = ui.label().classes("advice")
                self._where = ui.label().classes("note where")
        with ui.row().classes("controls"):
            self._play = ui.button("Pause", on_click=self._on_play)
            if not session.source.live:
                ui.button("◀ Step", on_click=lambda: session.step(-1)).props("outline")
                ui.button("Step ▶", on_click=lambda: session.step(1)).props("outline")
            ui.button("Search anew", on_click=session.search).props("outline")
            self._record = ui.button("Record", on_click=self._on_record)
            kinds = {"csv": "spots (CSV)", "bag": "frames (ROS bag)"}
            self._kind = ui.select(kinds, value="csv").props("dense outlined")
            self._recorded = ui.label().classes("note recorded")
            if session.source.length:
                self._slider = ui.slider(min=0, max=session.source.length - 1).classes("scrub")
                self._slider.on("change", lambda event: session.seek(int(event.args)))
        self._chart = ui.echart(_chart(robot=session.has_poses)).classes("course")
        ui.label(
            "Click the image to show where the spot is. Keys: space pause, ← → step, F search anew,"
            " R record, D light or dark."
        ).classes("note help")
        ui.timer(_PICTURE_S, self._update)
        ui.timer(_COURSE_S, self._update_course)

    def _update(self) -> None:
        session, view = self._session, self._session.view
        self._play.set_text("Play" if session.paused else "Pause")
        self._record.set_text("Stop recording" if session.recording else "Record")
        if session.recording:
            self._recorded.set_text(f"{session.recording.name}: {session.recorded} frames")
        elif session.recording_fault:
            self._recorded.set_text(session.recording_fault)
        if session.fault or view is None:
            self._show_fault(session.fault or "waiting for the first frame")
            if session.fault:
                self._shown = -1
                return
        if view is None or view.version == self._shown:
            return
        self._shown = view.version
        self._image.set_source(f"/frame/{view.version}?read={view.arrived_s:.3f}")
        self._image.set_content(self._overlay(view))
        self._show_reading(view)
        if session.source.length:
            self._slider.set_value(view.number)

    def _show_fault(self, fault: str) -> None:
        self._set_state("lost", "no image")
        self._distance.set_text("– mm")
        self._sigma.set_text("")
        self._worth.set_text("")
        self._reason.set_text(fault)

    def _show_reading(self, view: View) -> None:
        reading = view.reading
        no_spot = isinstance(reading.result, NoSpot) and reading.range is None
        doubt = reading.doubt.replace("_", " ")
        kind = "lost" if no_spot else "doubtful" if doubt else "good"
        self._set_state(kind, "no spot" if no_spot else "doubtful" if doubt else "good")
        distance, sigma = reading.distance_mm, reading.sigma_distance_mm
        self._distance.set_text("– mm" if math.isnan(distance) else f"{distance:.2f} mm")
        self._sigma.set_text("" if math.isnan(sigma) else f"σ {1e3 * sigma:.0f} µm")
        self._worth.set_text(_worth(reading.budget))
        self._reason.set_text(doubt)
        advice = exposure_advice(reading.result, view.frame.image, view.response)
        self._advice.set_text(advice)
        at = "" if math.isnan(view.frame.time_s) else f", {view.frame.time_s:.2f} s"
        length = f" of {self._session.source.length}" if self._session.source.length else ""
        self._where.set_text(f"frame {view.number + 1}{length}{at}")

    def _set_state(self, kind: str, text: str) -> None:
        self._state.set_text(text)
        self._reading.classes(add=kind, remove=" ".join({"good", "doubtful", "lost"} - {kind}))

    def _update_course(self) -> None:
        course = self._session.course
        now = course[-1].time_s if course else 0.0
        # The robot knows by how much, not from where: it starts at the first distance.
        offset = next((o for m in course if not math.isnan(o := m.distance_mm - m.robot_mm)), 0.0)

        def points(value: Callable[[Any], float]) -> list[list[float | None]]:
            values = [(m.time_s - now, value(m)) for m in course]
            return [[round(t, 3), None if math.isnan(y) else round(y, 4)] for t, y in values]

        lines = (
            lambda m: m.distance_mm,
            lambda m: m.distance_mm - m.sigma_mm,
            lambda m: m.distance_mm + m.sigma_mm,
            lambda m: m.radius_px,
            lambda m: m.robot_mm + offset,
        )
        for series, line in zip(self._chart.options["series"], lines, strict=True):
            series["data"] = points(line)
        self._chart.update()

    def _on_click(self, event: Any) -> None:
        self._session.look_at(event.image_x - 0.5, event.image_y - 0.5)

    def _on_play(self) -> None:
        self._session.pause(not self._session.paused)

    def _on_record(self) -> None:
        session = self._session
        if session.recording:
            name, number = session.recording, session.recorded
            session.stop_recording()
            self._recorded.set_text(f"Wrote {name} ({number} frames).")
            return
        path = self._folder / time.strftime(f"session-%Y%m%d-%H%M%S.{self._kind.value}")
        try:
            session.start_recording(path)
        except (InputError, OSError) as error:
            self._recorded.set_text(f"{error}")

    def _dark_light(self) -> None:
        self._dark.set_value(not self._dark.value)

    def _on_key(self, event: Any) -> None:
        if not event.action.keydown or event.modifiers.ctrl:
            return
        actions: dict[str, Callable[[], object]] = {
            " ": self._on_play,
            "ArrowRight": lambda: self._session.step(1),
            "ArrowLeft": lambda: self._session.step(-1),
            "f": self._session.search,
            "r": self._on_record,
            "d": self._dark_light,
        }
        if action := actions.get(event.key.name):
            action()


def _worth(budget: Budget | None) -> str:
    """The 95 % interval of a distance, and what makes it wide."""
    if budget is None or budget.largest is None or math.isnan(budget.sigma_mm):
        return ""
    low, high = budget.interval_mm
    return f"95 %: {low:.2f} to {high:.2f} mm, mostly {budget.largest.cause.meaning}"


def _calibration_of(options: Options) -> str:
    """The calibration that is loaded, and its age."""
    if options.calibration is None:
        return "no calibration: no distance"
    days = (time.time() - options.calibration.stat().st_mtime) / 86400
    return f"calibration {options.calibration.name}, {days:.0f} days old"


def _chart(*, robot: bool) -> dict[str, Any]:
    """Distance with its σ, by the robot, and radius, against the seconds before now."""
    thin = {"width": 1, "type": "dotted"}
    line = {"type": "line", "showSymbol": False, "data": []}
    # Readable on white and on black.
    axis = {
        "type": "value",
        "axisLabel": {"color": "#888"},
        "axisLine": {"onZero": False},
        "nameTextStyle": {"color": "#888"},
        "splitLine": {"lineStyle": {"color": "rgba(128, 128, 128, 0.3)"}},
    }
    titled = axis | {"scale": True, "nameLocation": "middle", "nameGap": 44}
    radius = titled | {"name": "semi-minor axis, px", "splitLine": {"show": False}}
    return {
        "animation": False,
        "grid": {"left": 70, "right": 70, "top": 34, "bottom": 30},
        "legend": {
            "data": ["distance", *["distance by the robot"] * robot, "semi-minor axis"],
            "top": 0,
            "textStyle": {"color": "#888"},
        },
        "xAxis": axis | {"min": -COURSE_S, "max": 0, "name": "s"},
        "yAxis": [titled | {"name": "distance, mm"}, radius],
        "series": [
            {**line, "name": "distance", "color": "#2a9d3f"},
            {**line, "name": "− σ", "color": "#2a9d3f", "lineStyle": thin},
            {**line, "name": "+ σ", "color": "#2a9d3f", "lineStyle": thin},
            {**line, "name": "semi-minor axis", "color": "#3b82d6", "yAxisIndex": 1},
            {**line, "name": "distance by the robot", "color": "#d9822b"},
        ],
    }
