"""How reports look: their HTML pages, and the figures in them."""

from typing import Any

import jinja2

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#000000")
"""Of Okabe and Ito, which colour-blind readers can distinguish."""

STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "svg.hashsalt": "eyespot",  # the same data give the same file
}


UNITS = {
    "mw_mm2": "mW/mm²",
    "mm2_sr_mj": "mm² sr/mJ",
    "mm_px": "mm/px",
    "mm_s": "mm/s",
    "deg_s": "°/s",
    "per_mm": "1/mm",
    "mm": "mm",
    "deg": "°",
    "rad": "rad",
    "px2": "px²",
    "px": "px",
    "ms": "ms",
    "hz": "Hz",
    "nm": "nm",
    "mw": "mW",
    "s": "s",
    "d": "D",
    "e": "electrons",
    "dn": "DN",
}
"""Units by the end of a name of a key or a column."""


def unit_at_end(name: str) -> str:
    """The one of `UNITS` that a name ends with; empty if there is none."""
    return next((end for end in UNITS if name.endswith(f"_{end}")), "")


def templates(package: str) -> jinja2.Environment:
    """The templates of a package, beside the style `page.css` that they include."""
    places = (package, "eyespot.formats")
    return jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(place) for place in places]),
        autoescape=lambda name: name is not None and ".html" in name,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def in_figure(name: str) -> str:
    """A name as Matplotlib draws it.

    Between two dollar signs it would read mathematics, and a label that begins with an underscore
    would not be in the legend; a space before it cannot be seen.
    """
    literal = name.replace("$", r"\$")
    return f" {literal}" if literal.startswith("_") else literal
