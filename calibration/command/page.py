"""The templates of all HTML pages: one style, for screens, in the dark, and on paper."""

import jinja2


def templates(*packages: str) -> jinja2.Environment:
    """The templates of packages, beside the style `page.css` that they include."""
    places = ("calibration.command", *packages)
    return jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(package) for package in places]),
        autoescape=lambda name: name is not None and ".html" in name,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
