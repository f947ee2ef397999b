"""Adds markup for screen readers that the theme leaves out, when the pages are written.

In every page of furo, axe finds captions that are headings without a level and two
landmarks without a name, and in pages with folded cells, summaries whose label differs
from their text.
"""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx

MENDED = {
    '<p class="caption" role="heading">': '<p class="caption" role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="All pages">',
    '<aside class="toc-drawer': '<aside aria-label="This page" class="toc-drawer',
    '<summary aria-label="Toggle hidden content">': "<summary>",
}


def mend(app: Sphinx, error: Exception | None) -> None:
    """Add the markup where it is missing."""
    if error is not None or app.builder.format != "html":
        return
    for place in Path(app.outdir).rglob("*.html"):
        if "_static" in place.parts:
            continue
        text = mended = place.read_text("utf-8")
        for old, new in MENDED.items():
            mended = mended.replace(old, new)
        if mended != text:
            place.write_text(mended, "utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("build-finished", mend)
    return {"parallel_read_safe": True}
