"""`{picture} name`, `{gallery}` and `{cards}`: drawings from `pictures` as parts of a
page, in the colours of the page.
"""

from __future__ import annotations

import re
from functools import cache
from html import escape
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from pictures import PICTURES
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from fraclink.view._pages import template_text


@cache
def drawn(name: str) -> str:
    """A picture as an element of a page."""
    made = PICTURES[name].draw()
    if isinstance(made, str):
        return (
            made[: made.index("<style>")]
            + made[made.index("/>", made.index("</style>")) + 2 :]
        )
    return made.inline()


def thumbnail(name: str) -> str:
    """A picture that is part of a link: the link says what it shows, the drawing would
    say it twice.
    """
    text = re.sub(r' role="img" aria-label="[^"]*"', ' aria-hidden="true"', drawn(name))
    text = re.sub(r' (id|data-\w+)="[^"]*"', "", text)
    return f'<span class="small">{text}</span>'


class PictureDirective(SphinxDirective):
    """``{picture} name`` with a caption below."""

    required_arguments = 1
    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {}

    def run(self) -> list[nodes.Node]:
        """One figure."""
        name = self.arguments[0]
        if name not in PICTURES:
            raise self.error(f"no picture is called {name!r}")
        box = nodes.container(classes=["picture"])
        box += nodes.raw("", drawn(name), format="html")
        if self.content:
            caption = nodes.container(classes=["picture-caption"])
            caption += self.parse_content_to_nodes()
            box += caption
        return [box]


class GalleryDirective(SphinxDirective):
    """``{gallery}``: every picture as a thumbnail that leads to its page; or those that
    are named.
    """

    optional_arguments = 30
    has_content = False

    def run(self) -> list[nodes.Node]:
        """A grid of links."""
        up = "../" * self.env.docname.count("/")
        parts = []
        for name in self.arguments or PICTURES:
            picture = PICTURES[name]
            title = f"<b>{escape(picture.title)}</b>"
            parts.append(
                f'<a class="thumb" href="{up}{picture.page}.html">{thumbnail(name)}{title}</a>'
            )
        return [
            nodes.raw("", f'<div class="gallery">{"".join(parts)}</div>', format="html")
        ]


class CardsDirective(SphinxDirective):
    """``{cards}``: lines of "title | page | picture | sentence" as cards beside one
    another.
    """

    has_content = True

    def run(self) -> list[nodes.Node]:
        """A grid of links."""
        parts = []
        for line in self.content:
            title, page, name, text = (part.strip() for part in line.split("|"))
            parts.append(
                f'<a class="thumb" href="{page}.html">{thumbnail(name)}<b>{escape(title)}</b>'
                f"<span>{escape(text)}</span></a>"
            )
        return [
            nodes.raw(
                "", f'<div class="gallery cards">{"".join(parts)}</div>', format="html"
            )
        ]


def write_styles(app: Sphinx, error: Exception | None) -> None:
    """The package's colours and drawings, for every page."""
    if error is None and app.builder.format == "html":
        place = Path(app.outdir) / "_static"
        # The drawing of a cell has a style of its own; on these pages the colours of
        # the page take precedence.
        figure = re.sub(
            r"(^|[,}]\s*|\n)\.fl\b", r"\1body .fl", template_text("figure.css")
        )
        (place / "drawings.css").write_text(
            template_text("palette.css") + figure, "utf-8"
        )


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("picture", PictureDirective)
    app.add_directive("gallery", GalleryDirective)
    app.add_directive("cards", CardsDirective)
    app.add_css_file("drawings.css")
    app.connect("build-finished", write_styles)
    return {"parallel_read_safe": True}
