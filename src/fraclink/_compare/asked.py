"""What a comparison may be asked for: payloads, and words in the names of rivals."""

from __future__ import annotations

from collections.abc import Sequence

from fraclink._compare.rivals import OURS
from fraclink._validate import checked_between, checked_series
from fraclink.errors import FieldError

__all__ = ["checked_masses", "checked_words", "chosen_rivals"]


def checked_masses(payloads: Sequence[float]) -> tuple[float, ...]:
    """Return payloads [kg], each in (0, 1e4]; FieldError for anything else, an empty list among it."""
    masses = checked_series("payloads", payloads, remedy="give masses in kg")
    if masses.size == 0:
        raise FieldError("payloads", (), "empty", allowed="one or more", remedy="give masses in kg")
    return tuple(
        checked_between(f"payloads[{i}]", mass, 0.0, 1e4, "kg", open_low=True)
        for i, mass in enumerate(masses.tolist())
    )


def checked_words(names: Sequence[str] | None) -> tuple[str, ...] | None:
    """Return the words in small letters, None for every rival; FieldError for what is no list of words."""
    if names is None:
        return None
    listed = isinstance(names, Sequence) and not isinstance(names, str)
    if not listed or not all(isinstance(name, str) for name in names):
        raise FieldError(
            "names", repr(names), "no list of words", allowed="a list", remedy='names=["LQG"] runs one rival'
        )
    return tuple(name.lower() for name in names)


def chosen_rivals(known: tuple[str, ...], words: tuple[str, ...] | None) -> list[str]:
    """Return ours and the rivals whose names contain one of `words`; FieldError for a word in no name."""
    if words is None:
        return list(known)
    for word in words:
        if not any(word in name.lower() for name in known):
            raise FieldError(
                "names",
                word,
                "part of no rival's name",
                allowed=", ".join(known),
                remedy="give a part of one of these",
            )
    return [name for name in known if name == OURS or any(word in name.lower() for word in words)]
