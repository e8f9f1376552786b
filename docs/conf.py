"""The site of the documentation: Sphinx reads the pages as they stand, and docs/index.md sorts them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from pygments.lexers.special import TextLexer

if TYPE_CHECKING:
    from sphinx.application import Sphinx

INDEX = "docs/index"
# The first link of a row or of an item: its text, the page, and a # where only a part is meant.
LINK = re.compile(r"^(?:\||\d+\.) \[([^]]+)\]\(([^)#]+)(#?)", re.MULTILINE)

project = "Spinbench"
root_doc = INDEX
include_patterns = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**.md"]
exclude_patterns = [".*", "out", "logs", "build", "dist"]
extensions = ["myst_parser"]
myst_heading_anchors = 6
smartquotes = False

html_theme = "furo"
html_title = project
html_static_path = html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False


def contents(index: str) -> dict[str, dict[str, str]]:
    """Kinds of pages as the index has them: the pages of each, and what they are called there.

    A page stands once: where it is linked as a whole, or else where it is linked first.
    """
    sections = re.split(r"^## ", index, flags=re.MULTILINE)[1:]
    kinds = [section.partition("\n")[0].partition(":")[0] for section in sections]
    links = [(kind, *link) for kind, section in zip(kinds, sections, strict=True) for link in LINK.findall(section)]
    place: dict[str, tuple[str, str]] = {}
    for kind, name, page, _ in sorted(links, key=lambda link: link[3]):
        place.setdefault(page, (kind, name))
    found: dict[str, dict[str, str]] = {kind: {} for kind in kinds}
    for kind, name, page, _ in links:
        if place[page] == (kind, name):
            found[kind][page] = name
    return found


def add_contents(app: Sphinx, page: str, source: list[str]) -> None:
    """Give the index the contents that the theme shows at the side, and a page without a title the index' name."""
    kinds = contents((Path(app.srcdir) / f"{INDEX}.md").read_text(encoding="utf-8"))
    if page == INDEX:
        for kind, pages in kinds.items():
            lines = [f"{name} <{place}>" for place, name in pages.items()]
            source[0] += "\n".join(["", "```{toctree}", ":hidden:", f":caption: {kind}", "", *lines, "```", ""])
    elif not source[0].startswith("# "):
        names = {place: name for pages in kinds.values() for place, name in pages.items()}
        source[0] = f"# {names[page.removeprefix('docs/') + '.md']}\n\n{source[0]}"


def lead_in(app: Sphinx, error: Exception | None) -> None:
    """Write the page that one opens first."""
    if error is None:
        text = f'<!doctype html><title>{html_title}</title><meta http-equiv="refresh" content="0; url={INDEX}.html">\n'
        (Path(app.outdir) / "index.html").write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.add_lexer("csv", TextLexer)
    app.connect("source-read", add_contents)
    app.connect("build-finished", lead_in)
