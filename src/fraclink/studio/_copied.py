"""What the user did by hand in a step, as a command: the same result without the
studio.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fraclink._arm.rig import Rig
from fraclink._reading.reading import bundled_log

if TYPE_CHECKING:
    from fraclink.studio._session import Session

__all__ = ["as_command", "copies"]


def copies(session: Session) -> dict[str, str]:
    """Return the command of every step, by the step's name."""
    rig, fit = _rig_name(session), session.study.fit
    design, model = session.folder / "design.json", session.folder / "model.json"
    options = ["--structure", fit.structure] if fit else []
    if session.heldout is not None:
        options += ["--heldout", f"{session.heldout:g}"]
    rest = {
        # the page adds the move that it shows
        "move": ("simulate", design),
        "proof": ("certify", design),
        "board": ("export", "c", design, "--out", session.folder / "firmware"),
    }
    return {
        "log": _log_words(session, "inspect"),
        "channels": _log_words(session, "diagnose", rig),
        "model": _log_words(session, "identify", rig, *options, "--out", str(model)),
        "design": as_command(session.state, rig, model if fit else None, design),
        **{
            step: shlex.join(["fraclink", *map(str, more)])
            for step, more in rest.items()
        },
    }


def _log_words(session: Session, verb: str, rig: str = "", *more: str) -> str:
    """The command `verb` on the log; with a rig, also with the user's statements about
    the columns, which `inspect` does not need.
    """
    source, log = session.source, session.study.experiment
    # The command line calls the bundled log demo; its path belongs to this
    # installation.
    word = "demo" if source == bundled_log("prbs_30g") else str(source)
    if source is None:
        word = "demo" if log is None else str(session.folder / "log.npz")
    elif source.is_relative_to(session.draft):
        # uploaded by the page, which does not know its original place
        word = source.name
    words = ["fraclink", verb, word]
    if rig:
        words += ["--rig", rig]
        words += [part for column in session.columns for part in ("--column", column)]
        if session.payload is not None:
            words += ["--payload", f"{session.payload:g}"]
        if session.stretch is not None:
            words += ["--keep", *(f"{time:g}" for time in session.stretch)]
    return shlex.join([*words, *more])


def _rig_name(session: Session) -> str:
    """The name of the rig in a command: a bundled one by its name, any other by the
    file that Keep writes.
    """
    rig = session.study.rig
    bundled = session.study.experiment is None and rig and rig.name in Rig.names()
    if rig and bundled and Rig.named(rig.name) == rig:
        return rig.name
    return str(session.folder / "rig.toml")


def as_command(
    request: Mapping[str, Any], rig: str, model: Path | None, out: Path
) -> str:
    """Return the command that makes the design of `request`, identical to the byte."""
    words = ["fraclink", "design", "--rig", rig]
    if model is not None:
        words += ["--model", str(model)]
    for name, value in request.items():
        if value is None:
            continue
        no = "no-" if value is False else ""
        words.append(f"--{no}{name.replace('_', '-')}")
        if not isinstance(value, bool):  # a flag has no word after it
            values = value if isinstance(value, tuple) else (value,)
            words += map(str, values)
    return shlex.join([*words, "--out", str(out)])
