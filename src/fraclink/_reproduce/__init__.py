"""The paper recomputed: every printed number, statement and figure, with a verdict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fraclink._files import write_text
from fraclink._reproduce.published import Published, read_published

__all__ = ["Published", "read_published", "reproduce"]


def _silent(part: str) -> None:
    """Progress that nobody watches."""


def reproduce(published: Path | str, out: Path | str, *, begin: Callable[[str], None] = _silent) -> Path:
    """Recompute the paper from `published`/*.toml; write RESULTS.md and figures/ to `out`, return the former.

    Every number comes out the same on a second run. Raises FileFormatError where the files of `published` are
    missing or wrong.
    """
    from fraclink._reproduce import pictures, tracking
    from fraclink._reproduce.results import results_text
    from fraclink._reproduce.values import computed

    told = read_published(Path(published))
    begin("numbers")
    values = computed(told)
    begin("figures 3 to 10")
    drawn = [*pictures.identification_pictures(), pictures.nyquist_picture(), *pictures.margin_pictures()]
    begin("figures 11 to 16")
    drawn += tracking.tracking_pictures()
    place = Path(out)
    for picture in drawn:
        write_text(place / "figures" / picture.name, picture.drawing + "\n")
    begin("statements")
    write_text(place / "RESULTS.md", results_text(told, values, tuple(drawn)))
    return place / "RESULTS.md"
