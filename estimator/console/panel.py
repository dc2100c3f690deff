"""The panel of a guided calibration on the page."""

from __future__ import annotations

from nicegui import ui

from estimator.console.guide import FEWEST_SPOTS, LEAST_MM, Guide, Stage
from optics import InputError

_LOOK_S = 0.25
_MEDIA = ("air", "water", "vitreous")
_STEPS = (
    "1. Touch the wall with the tip. 2. Start, and withdraw the tip along the tool by 3 to 6 mm. "
    "3. Fit: the calibration and its report with the residuals are written beside the bag."
)


class CalibrationPanel:
    """One window's panel; all windows show the same guide.

    Args:
        guide: of the session.
    """

    def __init__(self, guide: Guide) -> None:
        self._guide = guide
        with ui.expansion("Calibrate the beam").classes("calibrate"):
            ui.label(_STEPS).classes("note")
            with ui.row().classes("controls"):
                walls = {"plane": "a flat wall", "eyeball": "an eyeball"}
                self._phantom = ui.select(walls, value="plane").props("dense outlined")
                self._medium = ui.select(list(_MEDIA), value="air").props("dense outlined")
                self._start = ui.button("Start at contact", on_click=self._on_start)
                self._fit = ui.button("Fit", on_click=self._on_fit)
                self._covered = ui.linear_progress(0.0, show_value=False).classes("covered")
                self._state = ui.label().classes("note guide")
            self._said = ui.label().classes("said")
            self._report = ui.link("Report with residuals", "", new_tab=True).classes("report")
        ui.timer(_LOOK_S, self._update)

    def _update(self) -> None:
        guide = self._guide
        guide.look()
        self._fit.set_enabled(guide.stage is Stage.WITHDRAWING and guide.enough)
        self._start.set_enabled(guide.stage is not Stage.FITTING)
        self._covered.set_value(min(guide.covered_mm / LEAST_MM, guide.spots / FEWEST_SPOTS, 1.0))
        self._state.set_text(_state(guide))
        self._said.set_text(guide.said)
        self._report.set_visibility(guide.stage in (Stage.SAVED, Stage.REFUSED))
        self._report.props(f'href="/report/{guide.file.stem}"')

    def _on_start(self) -> None:
        try:
            self._guide.start()
        except (InputError, OSError) as error:
            self._guide.said = f"{error}"

    def _on_fit(self) -> None:
        try:
            self._guide.fit(phantom=self._phantom.value, medium=self._medium.value)
        except (InputError, OSError) as error:
            self._guide.said = f"{error}"


def _state(guide: Guide) -> str:
    match guide.stage:
        case Stage.IDLE:
            return ""
        case Stage.WITHDRAWING:
            return f"{guide.covered_mm:.1f} of {LEAST_MM:g} mm or more, {guide.spots} spots"
        case Stage.FITTING:
            return "fitting, half a minute"
        case Stage.SAVED:
            return f"Saved {guide.file.name}. Start the console with it to read distances."
        case Stage.REFUSED:
            return "No good calibration."
