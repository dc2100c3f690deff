"""Roles `test`, `source` and `api`, with which pages cite the code (see `docs/cited.py`)."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.util.docutils import SphinxRole

from docs.cited import label_of


class _CodeRole(SphinxRole):
    """A link to the code on one of the two pages."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        link = _link(self, domain="std", kind="ref", target=label_of(self.text))
        link += nodes.literal(self.text, self.text.removeprefix("test_"), classes=["xref"])
        return [link], []


class _ApiRole(SphinxRole):
    """A link to a name of the Python interface, whatever its kind."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        link = _link(self, domain="py", kind="obj", target=self.text)
        link += nodes.literal(self.text, self.text, classes=["xref", "py"])
        return [link], []


def _link(role: SphinxRole, *, domain: str, kind: str, target: str) -> addnodes.pending_xref:
    return addnodes.pending_xref(
        "",
        refdomain=domain,
        reftype=kind,
        reftarget=target,
        refexplicit=True,
        refdoc=role.env.docname,
        refwarn=True,
    )


def add_roles(app: Any) -> None:
    """Make the three roles known to Sphinx."""
    app.add_role("test", _CodeRole())
    app.add_role("source", _CodeRole())
    app.add_role("api", _ApiRole())
