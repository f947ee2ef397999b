"""The templates of all reports: one environment, which escapes whatever it sets."""

from __future__ import annotations

from importlib.resources import files

from fraclink._show.report.numbers import sentence
from fraclink.errors import MissingExtraError

__all__ = ["needed", "rendered"]


def needed() -> None:
    """Raise MissingExtraError where a report would fail half-way: at its first figure, or at its page."""
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "jinja2", "report") from error


def rendered(template: str, **contents: object) -> str:
    """Return the page that `template` makes of `contents`; a name that is missing is an error.

    >>> "&lt;script&gt;" in rendered("head.html", title="<script>", version="0")
    True
    """
    needed()
    import jinja2

    folder = files("fraclink._show.report") / "templates"
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: (folder / name).read_text("utf-8")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sentence"] = sentence
    return environment.get_template(template).render(contents)
