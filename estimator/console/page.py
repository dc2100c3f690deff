"""The page: image, distance, course of the last 30 s, controls."""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import app, ui
from starlette.responses import Response as Reply

from eyespot.estimator.console.gate import Gate
from eyespot.estimator.console.guide import FEWEST_SPOTS, LEAST_MM, Guide, Stage, exposure_advice
from eyespot.estimator.console.session import COURSE_S, Session, View, svg_of
from eyespot.estimator.run.reader import Reader
from eyespot.estimator.sources.source import Source
from eyespot.formats.inputs import InputError
from eyespot.formats.poses import PoseTrack
from eyespot.formats.rig import Rig
from eyespot.formats.spot import NoSpot

_PICTURE_S, _COURSE_S = 0.04, 0.25  # how often a page looks for something new
_STYLE = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")


def serve(
    open_: Callable[[], Source],
    reader: Reader,
    rig: Rig,
    *,
    beam: Path | None,
    folder: Path,
    host: str,
    port: int,
    token: str | None,
    poses: Callable[[], PoseTrack] | None = None,
) -> None:
    """Serve the page until Ctrl-C.

    Args:
        rig: of the frames, which a guided calibration needs.
        beam: the calibration's file, whose age the page shows.

    Raises:
        InputError: the source is wrong.
        OSError: a file cannot be read.
    """
    microscope = rig.view
    response = microscope.response if microscope else None
    session = Session(open_, reader, response=response, poses=poses)

    @app.get("/frame/{version}")
    def frame(version: int) -> Reply:
        # The newest, which may be newer than the one that was asked for.
        content = session.view.jpeg() if session.view else b""
        return Reply(content, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    guide = Guide(session, folder, rig)

    @app.get("/report/{name}")
    def report(name: str) -> Reply:
        # The guide's own file, whatever name was asked for.
        page = guide.file.with_suffix(".html")
        if name != guide.file.stem or not page.is_file():
            return Reply("there is no such report", status_code=404)
        return Reply(page.read_bytes(), media_type="text/html")

    @ui.page("/")
    def page() -> None:
        Page(session, beam, folder, lambda view: svg_of(view, microscope))
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
    """One window; all windows show the same session."""

    def __init__(
        self, session: Session, beam: Path | None, folder: Path, overlay: Callable[[View], str]
    ) -> None:
        self._session, self._folder, self._overlay = session, folder, overlay
        self._shown = -1
        ui.add_css(_STYLE)
        ui.keyboard(on_key=self._on_key)
        self._dark = ui.dark_mode(None)
        with ui.row().classes("top"):
            ui.label("eyespot").classes("brand")
            ui.label(session.source.name).classes("source")
            calibration = "no calibration: no distance"
            if beam is not None:
                days = (time.time() - beam.stat().st_mtime) / 86400
                calibration = f"calibration {beam.name}, {days:.0f} days old"
            ui.label(calibration).classes("note")
            ui.space()
            ui.label(f"mode: {session.mode}").classes("note")
            ui.button("Light / dark", on_click=self._dark_light).props("flat dense")
        with ui.element("main"):
            with ui.element("section").classes("image"):
                self._image = ui.interactive_image(
                    on_mouse=lambda at: session.look_at(at.image_x - 0.5, at.image_y - 0.5),
                    events=["click"],
                    cross=True,
                    sanitize=False,
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
            self._play = ui.button("Pause", on_click=lambda: session.pause(not session.paused))
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
                self._slider.on("change", lambda event: self._seek(event.args))
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
            self._set_state("lost", "no image")
            self._distance.set_text("– mm")
            for label in (self._sigma, self._worth):
                label.set_text("")
            self._reason.set_text(session.fault or "waiting for the first frame")
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

    def _seek(self, place: object) -> None:
        """Show the frame that the slider says; whatever else a browser sends is ignored."""
        if isinstance(place, int | float) and math.isfinite(place):
            self._session.seek(int(place))

    def _show_reading(self, view: View) -> None:
        reading = view.reading
        no_spot = isinstance(reading.result, NoSpot) and reading.range is None
        doubt = reading.doubt.replace("_", " ")
        kind = "lost" if no_spot else "doubtful" if doubt else "good"
        self._set_state(kind, "no spot" if no_spot else "doubtful" if doubt else "good")
        distance, sigma = reading.distance_mm, reading.sigma_distance_mm
        self._distance.set_text("– mm" if math.isnan(distance) else f"{distance:.2f} mm")
        self._sigma.set_text("" if math.isnan(sigma) else f"σ {1e3 * sigma:.0f} µm")
        budget, worth = reading.budget, ""
        if budget and budget.largest and not math.isnan(budget.sigma_mm):
            low, high = budget.interval_mm
            worth = f"95 %: {low:.2f} to {high:.2f} mm, mostly {budget.largest.cause.meaning}"
        self._worth.set_text(worth)
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

    def _dark_light(self) -> None:
        self._dark.set_value(not self._dark.value)

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

    def _on_key(self, event: Any) -> None:
        if not event.action.keydown or event.modifiers.ctrl:
            return
        session = self._session
        actions: dict[str, Callable[[], object]] = {
            " ": lambda: session.pause(not session.paused),
            "ArrowRight": lambda: session.step(1),
            "ArrowLeft": lambda: session.step(-1),
            "f": session.search,
            "r": self._on_record,
            "d": self._dark_light,
        }
        if action := actions.get(event.key.name):
            action()


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


_STEPS = (
    "1. Touch the wall with the tip. 2. Start, and withdraw the tip along the tool by 3 to 6 mm. "
    "3. Fit: the calibration and its report with the residuals are written beside the bag."
)


class CalibrationPanel:
    """One window's panel; all windows show the same guide."""

    def __init__(self, guide: Guide) -> None:
        self._guide = guide
        with ui.expansion("Calibrate the beam").classes("calibrate"):
            ui.label(_STEPS).classes("note")
            with ui.row().classes("controls"):
                walls = {"plane": "a flat wall", "eyeball": "an eyeball"}
                self._phantom = ui.select(walls, value="plane").props("dense outlined")
                media = ["air", "water", "vitreous"]
                self._medium = ui.select(media, value="air").props("dense outlined")
                self._start = ui.button("Start at contact", on_click=lambda: self._try(guide.start))
                self._fit = ui.button("Fit", on_click=lambda: self._try(self._on_fit))
                self._covered = ui.linear_progress(0.0, show_value=False).classes("covered")
                self._state = ui.label().classes("note guide")
            self._said = ui.label().classes("said")
            self._report = ui.link("Report with residuals", "", new_tab=True).classes("report")
        ui.timer(_COURSE_S, self._update)

    def _update(self) -> None:
        guide = self._guide
        guide.look()
        self._fit.set_enabled(guide.stage is Stage.WITHDRAWING and guide.enough)
        self._start.set_enabled(guide.stage is not Stage.FITTING)
        self._covered.set_value(min(guide.covered_mm / LEAST_MM, guide.spots / FEWEST_SPOTS, 1.0))
        withdrawn = f"{guide.covered_mm:.1f} of {LEAST_MM:g} mm or more, {guide.spots} spots"
        saved = f"Saved {guide.file.name}. Start the console with it to read distances."
        states = {
            Stage.IDLE: "",
            Stage.WITHDRAWING: withdrawn,
            Stage.FITTING: "fitting, half a minute",
            Stage.SAVED: saved,
            Stage.REFUSED: "No good calibration.",
        }
        self._state.set_text(states[guide.stage])
        self._said.set_text(guide.said)
        self._report.set_visibility(guide.stage in (Stage.SAVED, Stage.REFUSED))
        self._report.props(f'href="/report/{guide.file.stem}"')

    def _on_fit(self) -> None:
        self._guide.fit(phantom=self._phantom.value, medium=self._medium.value)

    def _try(self, action: Callable[[], None]) -> None:
        try:
            action()
        except (InputError, OSError) as error:
            self._guide.said = f"{error}"
