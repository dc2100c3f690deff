"""What a reader of the repository sees agrees with itself: versions, links, sizes."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

HOME = Path(__file__).resolve().parents[2]
_MADE = {"generated", "auto_gallery", "jupyter_execute"}
PAGES = [
    *sorted(path for path in (HOME / "docs").rglob("*.md") if not _MADE & {*path.parts}),
    HOME / "README.md",
]
EXAMPLES = sorted((HOME / "docs" / "gallery").rglob("plot_*.py"))
_LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


def test_one_version_is_stated_everywhere():
    version = tomllib.loads((HOME / "pyproject.toml").read_text())["project"]["version"]
    cited = re.search(r"^version: (\S+)$", (HOME / "CITATION.cff").read_text(), re.MULTILINE)
    released = re.search(r'^date-released: "(\S+)"$', (HOME / "CITATION.cff").read_text(), re.M)
    latest = re.search(r"^## \[(\d[^]]*)\] - (\S+)$", (HOME / "CHANGELOG.md").read_text(), re.M)
    assert cited and released and latest
    assert cited[1] == latest[1] == version
    assert released[1] == latest[2]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(HOME).as_posix())
def test_no_link_between_files_is_dead(page):
    for target in _LINK.findall(page.read_text(encoding="utf-8")):
        made = any(part in target for part in ("generated/", "auto_gallery/"))
        if not made and not target.startswith(("http:", "https:", "mailto:")):
            assert (page.parent / target).exists(), target


def test_the_readme_is_one_page_and_links_to_every_page():
    text = (HOME / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 80  # what a printed page has
    linked = {(HOME / target).resolve() for target in _LINK.findall(text)}
    pages = {page for page in PAGES if page.parent == HOME / "docs" and page.name != "index.md"}
    tutorials = {page for page in PAGES if page.parent.name == "tutorials"}
    tutorials = {page for page in tutorials if page.name != "index.md"}
    assert pages | tutorials <= linked


def test_the_gallery_has_twenty_examples_of_thirty_lines():
    # A file is an example, or has several cells after what they share.
    files = [file.read_text(encoding="utf-8").split('"""', 2)[2] for file in EXAMPLES]
    cells = [cell for code in files for cell in code.split("# %%")[1:] or [code]]
    assert len(cells) >= 20
    for cell in cells:
        lines = [line for line in cell.splitlines() if line.strip()]
        assert len(lines) <= 30, cell


def test_no_tracked_page_is_generated():
    listed = subprocess.run(
        ["git", "ls-files", "docs"], cwd=HOME, capture_output=True, text=True, check=False
    )
    assert "docs/reference/generated" not in listed.stdout
