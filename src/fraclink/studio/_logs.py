"""Steps 1 to 3: the channels of a log, the roles of its columns, and the fits, as
answers for the page.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fraclink._arm.draft import draft_text
from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES
from fraclink._arm.log_columns import UNITS_OF, LogColumns
from fraclink._arm.rig import Rig
from fraclink._display import number
from fraclink._identify import Fit
from fraclink._reading.formats import read_table
from fraclink._reading.reading import (
    bundled_log,
    bundled_logs,
    inspect_log,
    read_log,
)
from fraclink.errors import FieldError, LogError, required
from fraclink.logs import match
from fraclink.studio._copied import copies
from fraclink.studio._messages import Reply, held
from fraclink.studio._session import Session, Verb, bare, begun
from fraclink.trials._stages import examined
from fraclink.trials._study import Study
from fraclink.view._figures import fit_panels
from fraclink.view._scales import envelope
from fraclink.view._text import grid_of
from fracsys.checks import Real, checked_choice, rule

__all__ = ["LOG_VERBS", "fit_answer"]


def thinned(values: Real) -> Real:
    """Return a signal thinned to the extremes of its stretches, which the page draws at
    equal distances.
    """
    return envelope(values, values)[1]


def _choose_log(session: Session, given: Mapping[str, Any]) -> Reply:
    """List the channels of a log: an upload, a bundled one, or the one that the studio
    was opened with.
    """
    name = given.get("name")
    if name == "upload" and session.upload is not None:
        session.source = session.upload
    elif name is not None:
        remedy = "drop a file, or choose one of these"
        known = checked_choice("log", name, bundled_logs(), remedy=remedy)
        session.source = bundled_log(known)
    head: dict[str, Any] = {
        "bundled": bundled_logs(),
        "rigs": Rig.names(),
        "rig": session.study.rig.name if session.study.rig else "",
        "log": None,
        "copies": copies(session),
    }
    more, signals = _experiment(session)
    if session.source is None:
        return Reply(head | more, signals)
    listing = inspect_log(session.source)
    table = read_table(session.source)
    curves = {
        f"spark{k}": thinned(_scaled(held(values)))
        for k, values in enumerate(table.values)
    }
    # A listing only suggests roles; the user corrects a wrong guess by dragging.
    guessed = match(session.source)
    roles = {} if guessed.columns is None else guessed.columns.channels()
    places = {channel.column: role.replace("_", " ") for role, channel in roles.items()}
    units = {channel.column: channel.unit for channel in roles.values()}
    channels = listing.channels
    facts = [
        (
            places.get(entry.name),
            f"{number(entry.minimum)} … {number(entry.maximum)}",
            f"every {number(entry.period)}" if entry.period else "",
            f"{entry.missing} missing" if entry.missing else "",
        )
        for entry in channels
    ]
    head["log"] = {
        "said": f"{listing.path}: {listing.kind}, {len(channels)} channels, "
        f"{channels[0].samples if channels else 0} samples.",
        "channels": [
            {
                "name": entry.name,
                "unit": entry.unit or units.get(entry.name, ""),
                "facts": " · ".join(filter(None, parts)),
            }
            for entry, parts in zip(channels, facts, strict=True)
        ],
    }
    head["guesses"] = guessed.guesses
    head["roles"] = roles
    head["units"] = {role: [*units] for role, units in UNITS_OF.items()}
    return Reply(head | more, curves | signals)


def _scaled(values: Real) -> Real:
    """A signal scaled to 0 … 1, since a sparkline has no axis."""
    low, high = (
        float(values.min(initial=math.inf)),
        float(values.max(initial=-math.inf)),
    )
    return (values - low) / (high - low) if high > low else np.full(values.size, 0.5)


def _set_columns(session: Session, given: Mapping[str, Any]) -> Reply:
    """Read the log with the columns that the page states, and examine it."""
    texts = rule(tuple[str, ...]).check("columns", given.get("columns", ()))
    payload = given.get("payload")
    source = required("log", session.source, "a log", "choose one in step 1")
    rig = required("rig", session.study.rig, "a rig", "choose one in step 1")
    columns = None
    if texts:
        guessed = match(source, column=texts)
        columns = guessed.columns
        if columns is None:
            # The rest, such as a unit, is not guessed: a wrong guess would give a wrong
            # controller.
            questions = " ".join(question.text for question in guessed.questions)
            raise FieldError(
                "columns",
                ", ".join(texts),
                questions,
                "an answer to each question",
                "drag the channel to its place",
            )
    keep = given.get("keep")
    if keep is not None:  # its limits are checked by `read_log`
        keep = rule(tuple[float, float]).check("keep", keep)
    # Without statements those of the rig file apply, as on the command line.
    log = read_log(source, columns=columns or rig.log, payload=payload, keep=keep)
    session.columns = () if columns is None else _statements(columns)
    session.payload, session.stretch, session.heldout = payload, keep, None
    session.whole = log
    # the picture shows the surroundings of the stretch, if they can be read
    if keep is not None:
        try:
            # resample: outside the stretch the clock may be uneven, which does not
            # matter for a picture.
            session.whole = read_log(source, columns=columns or rig.log, resample=True)
        except LogError:
            session.whole = None
    session.become(examined(rig, log))
    head: dict[str, Any] = {**session.overview()}
    if columns is not None:
        head["toml"] = draft_text(rig.name, log.period, columns, {})
    more, signals = _experiment(session)
    return Reply(head | more, signals)


def _statements(columns: LogColumns) -> tuple[str, ...]:
    """The columns in the form of the command line, with guesses stated explicitly.

    >>> from fraclink._arm.log_columns import parse_columns
    >>> _statements(parse_columns(["time=t [s]", "motor_angle=-n * 0.25 [deg]", "torque=g [Nm]"]))
    ('time=t [s]', 'motor_angle=-n * 0.25 [deg]', 'torque=g [Nm]')
    """
    return tuple(
        f"{role}={'-' if channel.sign < 0 else ''}{channel.column}"
        f"{'' if channel.scale == 1.0 else f' * {channel.scale!r}'} [{channel.unit}]"
        for role, channel in columns.channels().items()
    )


def _experiment(session: Session) -> tuple[dict[str, Any], dict[str, Real]]:
    """The log in SI units: its facts, its findings, and two curves."""
    log = session.study.experiment
    if log is None:
        return {"experiment": None}, {}
    # The findings of the log and of its diagnosis overlap: each is shown once.
    findings = tuple(dict.fromkeys((*log.findings, *session.study.findings)))
    whole = session.whole or log
    name, period = Path(log.source).name or "unnamed log", number(1e3 * log.period)
    said = f"{name}: {log.output.size} samples, one every {period} ms."
    head = {
        "experiment": {"said": said, "findings": findings, "duration": whole.duration,
                       "kind": log.output_kind, "payload": log.payload,
                       "keep": session.stretch if session.whole else None, "whole": session.whole is not None}
    }  # fmt: skip
    return head, {
        "motor_angle": thinned(np.degrees(whole.motor_angle)),
        "output": thinned(whole.output),
    }


def _set_rig(session: Session, given: Mapping[str, Any]) -> Reply:
    """Use another rig, bundled or uploaded, or the model of an uploaded file; results
    for the old rig are discarded.
    """
    name, before = given.get("name"), session.study
    if name == "upload" and session.upload is not None:
        study = begun(session.upload, before.rig)
    else:
        rig = Rig.named(str(name))
        study = Study(rig=rig, assumptions=rig.assumptions)
    assert study.rig is not None  # noqa: S101
    # The log remains, since it is in SI units and independent of the rig, unless the
    # new model is that of another log.
    if before.experiment is not None and study.fit is None and study.design is None:
        study = examined(study.rig, before.experiment)
    session.become(study)
    session.renew()
    return Reply(
        {
            "state": session.state,
            **session.axes,
            **session.overview(),
        }
    )


# --- the fits -------------------------------------------------------------------------------------------


def _models(session: Session, given: Mapping[str, Any]) -> Reply:
    """Show the fits; with `structure`, design from that one."""
    name = given.get("structure")
    if name is not None:
        fit = session.study.fits.get(str(name))
        if fit is None:
            raise FieldError(
                "structure",
                name,
                "not fitted",
                ", ".join(session.study.fits) or "a fit",
                "fit the log first",
            )
        # The design was made for the other model and must not be shown with this one.
        session.become(bare(replace(session.study, fit=fit)))
    return fit_answer(session)


def fit_answer(session: Session) -> Reply:
    """Return every fit with its figures in words, and the curves of log, model and
    residual.
    """
    study = session.study
    log, fits = study.experiment, study.fits
    head: dict[str, Any] = {
        **session.overview(),
        "fits": [],
        "conclusion": "",
        "said": f"The arm {study.fit.model.sentence}."
        if study.fit is not None
        else "Not fitted yet."
        if log is not None
        else "Read a log first (steps 1 and 2).",
        **session.axes,
    }
    if not fits:
        return Reply(head)
    structure = study.fit.structure if study.fit else ""
    if study.comparison:
        head["table"] = grid_of(study.comparison.table)
        head["conclusion"] = study.comparison.verdict
    head["fits"] = [_card(name, fit, name == structure) for name, fit in fits.items()]
    if log is None or study.fit is None:
        return Reply(head)
    head["heldout"] = 1.0 - study.fit.fitted_samples / log.output.size
    head["duration"] = log.duration
    head["plots"], curves = _pictures(log, study.fit)
    return Reply(head, curves)


def _pictures(log: Experiment, fit: Fit) -> tuple[dict[str, Any], dict[str, Real]]:
    """The drawings about a fit: the ends of the axes and the lines of each plot, and the
    two coordinates of each line.
    """
    plots, curves = {}, {}
    for plot, (x, panel) in fit_panels(log, fit).items():
        lines = panel.lines()
        plots[plot] = {
            "label": panel.label,
            "axes": [{"low": side.low, "high": side.high} for side in (x, panel.y)],
            "lines": [line[:2] for line in lines],
        }
        for k, (_, _, across, up) in enumerate(lines):
            curves[f"{plot} {k}"] = np.stack([across, held(np.asarray(up))])
    return plots, curves


def _card(name: str, fit: Fit, used: bool) -> dict[str, Any]:
    return {
        "name": name,
        "what": STRUCTURES[name].sentence,
        "used": used,
        "passed": fit.passed,
        "words": fit.model.sentence,
        "findings": [f for f in fit.findings if f.severity != "info"],
        "heldout_nmse": fit.heldout_nmse,
    }


LOG_VERBS: dict[str, Verb] = {
    "log": _choose_log,
    "columns": _set_columns,
    "rig": _set_rig,
    "model": _models,
}
