"""The verbs as `fraclink --help` lists them: by what they are for, each with its whole sentence."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

__all__ = ["Listing"]

_SECTIONS = {
    "From a log to a board": (
        *("run", "inspect", "diagnose", "identify", "design", "simulate", "twin"),
        *("certify", "export", "run-realtime", "serve-arm", "report"),
    ),
    "More on logs and models": (
        *("identify-all", "identify-payloads", "identify-motor", "identify-spectrum"),
        *("plan-experiment", "record"),
    ),
    "More on designs and laws": ("assess", "optimise", "compare", "design-map", "campaign", "replay"),
}
_LAST = "Further verbs"


def _section(name: str) -> str:
    return next((title for title, names in _SECTIONS.items() if name in names), _LAST)


class Listing(TyperGroup):
    """A group of verbs that lists them in sections.

    click cuts a summary off behind some fifty characters and sorts by the order of registration; a user
    who looks for the next stage finds neither what it does nor where it stands.
    """

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of the verbs: the application's in the order of the sections, a group's as registered."""
        if ctx.parent is not None:
            return list(self.commands)
        order = [name for names in _SECTIONS.values() for name in names]
        return sorted(self.commands, key=lambda name: order.index(name) if name in order else len(order))

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section for each purpose: verb and whole sentence."""
        rows: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            sentence = (self.commands[name].help or "").partition("\n\n")[0]
            rows.setdefault(_section(name) if ctx.parent is None else "Commands", []).append(
                (name, " ".join(sentence.split()))
            )
        for title, listed in rows.items():
            with formatter.section(title):
                formatter.write_dl(listed)
