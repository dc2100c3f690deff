"""`eyespot explore`: a page with sliders, from which `explore` draws."""

from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlencode

from cyclopts import Parameter
from cyclopts.types import Port

from eyespot.estimator.console.console_command import check_free
from eyespot.estimator.run.options import RigChanges
from eyespot.formats.inputs import InputError
from eyespot.formats.rig import read_rig

_REDRAW_S = 0.05
_STYLE = Path(__file__).parent / "templates" / "explore.css"


def explore(
    *,
    rig: Annotated[Path | None, Parameter(help="Rig file to start from.")] = None,
    changes: RigChanges = (),
    host: str = "127.0.0.1",
    port: Port = 8081,
) -> None:
    """Show eye, beam and image, and what each model reads, on a page with sliders.

    The page's address keeps its state, so it can be sent. Ctrl-C ends it.

    Args:
        changes: Change a key of the rig file. Repeatable.
        host: Address to listen on.
        port: Port to listen on.
    """
    try:
        from nicegui import ui
        from starlette.requests import Request
    except ModuleNotFoundError as error:
        raise InputError(
            f"the page needs the package {error.name}: pip install 'eyespot[console]'."
        ) from error
    from eyespot.benchmarks.explore import state_of

    own = None if rig is None else read_rig(rig).changed(changes)
    state_of({}, own)  # refuses an impossible rig before a page is promised
    check_free(host, port)

    @ui.page("/")
    def page(request: Request) -> None:
        _show(state_of(dict(request.query_params), own))

    print(f"The page is at http://{host}:{port}. Ctrl-C ends it.", flush=True)
    more = {"reload": False, "show": False, "show_welcome_message": False}
    ui.run(host=host, port=port, title="eyespot explore", **more)


def _show(state: dict[str, Any]) -> None:
    """Build one window, which has a state of its own and is drawn again after each change."""
    from nicegui import ui

    from eyespot.benchmarks.explore import CHOICES, KNOBS, drawing

    pictures: dict[str, ui.html] = {}
    drawn: dict[str, Any] = {}

    def picture(name: str, caption: str) -> None:
        with ui.element("figure"):
            pictures[name] = ui.html("", sanitize=False)
            with ui.element("figcaption"):
                ui.label(caption)

    ui.add_css(_STYLE.read_text(encoding="utf-8"))
    ui.html("<h1>How far is the tip, by each model?</h1>", sanitize=False)
    with ui.element("main"):
        with ui.element("section"):
            for name, (label, unit, low, high, step, _) in KNOBS.items():
                with ui.element("div").classes("knob"):
                    text = f"{label}: {{:g}} {unit}"
                    ui.label().bind_text_from(state, name, backward=text.format)
                    slider = ui.slider(min=low, max=high, step=step).bind_value(state, name)
                    slider.props(f'aria-label="{label}"').classes(f"turns-{name}")
            with ui.element("div").classes("choices"):
                for name, choices in CHOICES.items():
                    ui.select([*choices], label=name).bind_value(state, name)
            fault = ui.label().classes("fault")
        picture("section", "Eye and beam, projected onto the plane of the microscope's axis and O")
        picture("image", "The microscope's image, 640 × 480 px around the spot")
        picture("curve", "Error of each model against c; dashed: ±0.1 mm; upright: this spot")
        picture("table", "Error = reading − d. The models know c, r, the pinhole and the cone")

    def redraw() -> None:
        if state == drawn:
            return
        drawn.update(state)
        try:
            made = drawing(state)
        except InputError as error:
            fault.set_text(f"{error}")
            return
        fault.set_text("")
        for name, content in made.items():
            pictures[name].set_content(content)
        query = {key: v if isinstance(v, str) else f"{v:.6g}" for key, v in state.items()}
        ui.run_javascript(f"history.replaceState(null, '', '?{urlencode(query)}')")

    ui.timer(_REDRAW_S, redraw)
