"""HTML pages from templates: one place for the environment, in which everything from outside is escaped."""

from __future__ import annotations

from importlib.resources import files

from fraclink._show.text import marked, sentence
from fraclink.errors import MissingExtraError

__all__ = ["rendered", "template_text"]

_FOLDER = files("fraclink._show") / "templates"


def template_text(name: str) -> str:
    """Return the text of one of the files beside the templates."""
    return (_FOLDER / name).read_text("utf-8")


def rendered(template: str, **contents: object) -> str:
    """Return the page that `template` makes of `contents`; a name that is missing is an error."""
    try:
        import jinja2
    except ModuleNotFoundError as error:
        raise MissingExtraError("jinja2", "report") from error
    from fraclink import __version__  # the root's stub names this module: a circle for the type checker

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(template_text),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"sentence": sentence, "marked": marked}
    return environment.get_template(template).render(version=__version__, **contents)
