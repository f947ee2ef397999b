"""The user's actions in a step as a command and as Python code, which give the same
result without the studio.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fraclink._arm.log_columns import parse_columns
from fraclink._arm.rig import Rig
from fraclink._reading.reading import bundled_log
from fraclink.trials._study import Study

if TYPE_CHECKING:
    from fraclink.studio._session import Session

__all__ = ["as_command", "as_python", "copies"]

Copies = Mapping[str, Mapping[str, str]]


def copies(session: Session) -> Copies:
    """Return the command and the lines of Python of every step, by the step's name."""
    log, rig = _Log(session), _rig_name(session)
    design, law = str(session.folder / "design.json"), "fl.load({!r}).law()"
    asked, model = _completed(session), _model(session)
    command = as_command(
        dict(session.state), rig, model, session.folder / "design.json"
    )
    loaded = f"design = fl.load({design!r})"
    made, known = session.study.design, session.study.rig
    # With the heaviest payload, which moves slowest; 40 g is that of the bundled rig.
    payload = made.payloads[1] if made else known.payloads.high if known else 0.04
    found = {
        "log": (log.words("inspect"), log.lines("print(fl.inspect_log({log}))", rig=False)),
        "channels": (log.words("diagnose", rig), log.lines("log = {read}", "print(fl.logs.diagnose(log, rig))")),
        "model": (log.fit_words(rig), log.fit_lines()),
        "design": (command, as_python(asked, rig, model)),
        "move": (
            shlex.join(["fraclink", "simulate", design, "--payload", f"{payload:g}"]),
            _lines(loaded, "move = fl.smooth_step(1.0, duration=0.5)",
                   "run = fl.simulate(design.law(), move, rig=design.rig, model=design.model,"
                   f" payload={payload:g}, duration=4.0, motor_loop=\"sampled\")"),
        ),
        "proof": (
            shlex.join(["fraclink", "certify", design]),
            _lines(loaded, "proof = fl.certify(design, law=design.law())", "print(proof.verdict)"),
        ),
        "board": (
            shlex.join(["fraclink", "export", "c", design, "--out", str(session.folder / "firmware")]),
            _lines(f"law = {law.format(design)}", f"fl.export_c(law, {str(session.folder / 'firmware')!r})"),
        ),
    }  # fmt: skip
    return {
        step: {"command": words, "python": lines}
        for step, (words, lines) in found.items()
    }


def _lines(*lines: str) -> str:
    return "\n".join(["import fraclink as fl", "", *lines])


class _Log:
    """The name of a session's log in a command and in Python, and the statements of its
    columns.
    """

    def __init__(self, session: Session) -> None:
        self.session, self.rig = session, _rig_name(session)
        source, known = session.source, session.study.experiment
        if source is None:
            self.word = (
                "demo" if known is None else Path(known.source).name or "log.csv"
            )
        elif source.is_relative_to(
            session.draft
        ):  # uploaded by the page, which does not know its original place
            self.word = source.name
        else:
            # The command line calls the bundled log demo; its path belongs to this
            # installation.
            self.word = "demo" if source == bundled_log("prbs_30g") else str(source)

    def words(self, verb: str, rig: str = "", *more: str) -> str:
        """The command `verb` on the log, with the statements of its columns if a rig is
        named.
        """
        # `inspect` lists the content of a file regardless of its interpretation: it has
        # no such options.
        stated: Sequence[str] = self.session.columns if rig else ()
        words = ["fraclink", verb, self.word, *(["--rig", rig] if rig else [])]
        for column in stated:
            words += ["--column", column]
        if rig and self.session.payload is not None:
            words += ["--payload", f"{self.session.payload:g}"]
        if rig and self.session.stretch is not None:
            words += ["--keep", *(f"{time:g}" for time in self.session.stretch)]
        return shlex.join([*words, *more])

    def lines(self, *lines: str, rig: bool = True) -> str:
        """Lines of Python in which {log} is the log's file and {read} the call that
        reads it.
        """
        shown = 'fl.bundled_log("prbs_30g")' if self.word == "demo" else repr(self.word)
        stated = [f"rig={'rig'}"]
        if self.session.columns:
            stated = [f"columns={_python_columns(self.session.columns)}"]
        if self.session.payload is not None:
            stated.append(f"payload={self.session.payload!r}")
        if self.session.stretch is not None:
            stated.append(f"keep={self.session.stretch!r}")
        read = f"fl.read_log({', '.join([shown, *stated])})"
        first = [f"rig = {_python_rig(self.rig)}"] if rig else []
        return _lines(*first, *(line.format(log=shown, read=read) for line in lines))

    def _fit(self) -> tuple[str, float | None]:
        fit = self.session.study.fit
        return (fit.structure if fit else ""), self.session.heldout

    def fit_words(self, rig: str) -> str:
        """The command that creates the model used by the design."""
        structure, heldout = self._fit()
        more = ["--structure", structure] if structure else []
        more += [] if heldout is None else ["--heldout", f"{heldout:g}"]
        return self.words(
            "identify", rig, *more, "--out", str(self.session.folder / "model.json")
        )

    def fit_lines(self) -> str:
        """The same in Python."""
        structure, heldout = self._fit()
        given = f", {structure!r}" if structure else ""
        given += "" if heldout is None else f", heldout={heldout:g}"
        known = self.session.study.experiment
        # A deflection is a ratio of angles, in which the stiffness cancels: it must be
        # stated.
        if known is not None and known.output_kind == "deflection":
            given += ", stiffness=rig.link.stiffness"
        return self.lines("log = {read}", f"fit = fl.identify(log{given})")


def _python_columns(texts: Sequence[str]) -> str:
    """The call that creates the columns stated by `texts`."""
    columns = parse_columns(texts)

    def channel(role: str) -> str:
        found = columns.channels()[role]
        beside = "" if found.sign > 0 else ", sign=-1"
        beside += "" if found.scale == 1.0 else f", scale={found.scale!r}"
        return f"fl.Channel({found.column!r}, {found.unit!r}{beside})"

    given = (f"{role}={channel(role)}" for role in columns.channels())
    return f"fl.LogColumns({', '.join(given)})"


def _python_rig(rig: str) -> str:
    return (
        f"fl.Rig.load({rig!r})" if rig.endswith(".toml") else f"fl.Rig.named({rig!r})"
    )


def _rig_name(session: Session) -> str:
    """The name of the rig in a command: a bundled one by its name, any other by the
    file that Keep writes.
    """
    study: Study = session.study
    rig = study.rig
    if rig is not None and study.experiment is None and rig.name in Rig.names():
        return (
            rig.name if Rig.named(rig.name) == rig else str(session.folder / "rig.toml")
        )
    return str(session.folder / "rig.toml")


def _model(session: Session) -> Path | None:
    return session.folder / "model.json" if session.study.fit is not None else None


def _completed(session: Session) -> dict[str, Any]:
    """The state with the rig's defaults, which `fraclink.design` in Python does not
    apply.
    """
    study, request = session.study, dict(session.state)
    made = study.design
    if made is None:
        return request
    known = study.rig.design if study.rig else None
    # Defaults are read from the design instead of being determined again, so that the
    # two cannot differ.
    request["payloads"] = made.payloads
    request["gain_crossover"] = made.gain_crossover
    # If Ms was requested, the margin is a result; stated as well, it would be a second
    # request.
    if request["max_sensitivity"] is None or request["phase_margin_deg"] is not None:
        request["phase_margin_deg"] = request["phase_margin_deg"] or round(
            math.degrees(made.phase_margin), 9
        )
    bounds = (request["noise_gain"], request["mode_gain"])
    if known is not None and request["filter_time"] is None and bounds == (None, None):
        request["filter_time"] = known.filter_time
    return request


def as_command(
    request: Mapping[str, Any], rig: str, model: Path | None, out: Path
) -> str:
    """Return the command that creates the design of `request`, byte for byte."""
    words = ["fraclink", "design", "--rig", rig]
    if model is not None:
        words += ["--model", str(model)]
    for name, value in request.items():
        if value is None or value is False:
            continue
        words.append(f"--{name.replace('_', '-')}")
        # A flag has no value.
        if value is not True:
            words += map(_plain, value if isinstance(value, tuple) else (value,))
    return shlex.join([*words, "--out", str(out)])


def as_python(request: Mapping[str, Any], rig: str, model: Path | None) -> str:
    """Return the lines of Python that create the same design, with the defaults of the
    rig.
    """
    by_file = rig.endswith(".toml")
    lines = ["import fraclink as fl", ""]
    lines.append(
        f"rig = fl.Rig.load({rig!r})" if by_file else f"rig = fl.Rig.named({rig!r})"
    )
    link = "rig.model" if model is None else "fit"
    if model is not None:
        lines.append(f"fit = fl.load({str(model)!r})")
    lines += ["design = fl.design(", f"    {link}, rig,"]
    for name, value in request.items():
        if value is None or value is False:
            continue
        if name == "phase_margin_deg":
            lines.append(f"    phase_margin=fl.deg({_plain(value)}),")
        else:
            lines.append(f"    {name}={value!r},")
    return "\n".join(
        [*lines, "    law=False,", ").with_law()", "law = fl.discretize(design)"]
    )


def _plain(value: object) -> str:
    return repr(value) if isinstance(value, float) else str(value)
