"""What people see of a tuning and of a shaped move: what was promised beside what was
measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from fraclink.view._text import Row, Table, View, finding_line, grams, milli, number

if TYPE_CHECKING:
    from fraclink._design.pid_tuning import PidTuning
    from fraclink._simulate.shaped_move import Measured, ShapedMove
    from fraclink.lab._tuning import Tuning
    from fraclink.lab._watch import Watch

__all__ = ["pid_view", "shaped_view", "tuning_view", "watch_view"]


def tuning_view(made: Tuning) -> View:
    """The three scopes, what was measured with how sure it is, and the first moves."""
    verdict = made.verdict
    tables = (
        [Table(("what", "found", "± standard error"), tuple(_measured(made)))]
        if made.wiring
        else []
    )
    if made.moves:
        rows = tuple(
            (
                f"{number(math.degrees(move.amplitude), 3)}° in {number(move.duration, 3)} s",
                f"{move.promised_settling:.2f} / {move.measured_settling:.2f}",
                f"{1e3 * move.promised_residual:.1f} / {1e3 * move.measured_residual:.1f}",
                number(1e3 * move.jump, 2),
                number(move.peak_voltage, 3),
            )
            for move in made.moves
        )
        header = (
            "move",
            "settles, promised / measured [s]",
            "residual, promised / measured [mrad]",
        )
        tables.append(Table((*header, "hand-over [mrad]", "peak [V]"), rows))
    scopes = tuple(
        (name, scope.state, "; ".join(scope.reasons))
        for name, scope in verdict.scopes.items()
    )
    tables.append(Table(("scope", "state", "why"), scopes))
    time = f"{made.arm_time:.0f} s of the arm, {made.computing:.1f} s of computing"
    headline = (
        f"stopped: {made.stopped}"
        if made.stopped
        else f"{made.attempts} experiments on the link, {time}"
    )
    return View(
        headline,
        tuple(tables),
        made.wiring.evidence if made.wiring else (),
        verdict.state,
    )


def pid_view(made: PidTuning) -> View:
    """The controller, what was asked for and achieved, and how the step of the
    reference is answered.
    """
    rows = tuple(
        (
            name.replace("[rad]", "[°]"),
            *(_shown(name, x) for x in (asked, got)),
            "kept" if kept else "not kept",
        )
        for name, asked, got, kept in made.kept
    )
    others = (
        ("gain margin", "–", number(made.margins.gain_margin), ""),
        ("sensitivity peak", "–", number(made.margins.sensitivity_peak), ""),
    )
    asked_for = {row[0] for row in rows}
    table = Table(
        ("what", "asked for", "achieved", ""),
        (*rows, *(r for r in others if r[0] not in asked_for)),
    )
    notes = [
        f"ITAE {number(made.itae)} s² over {number(made.horizon)} s after a unit step"
    ]
    if made.delay:
        notes.append(
            f"{number(1e3 * made.delay)} ms of the delay in the loop are those of the sampling"
        )
    if not made.stable:
        notes.append("the closed loop is not stable")
    # A reader of arms' certificates must not take this verdict for one.
    notes.append(
        "computed, not proved: certificates know the loop of an arm, and no other plant"
    )
    state = "passed" if made.passed else "failed"
    return View(
        made.controller.formula, (table,), (*notes, *map(str, made.findings)), state
    )


def _shown(name: str, value: float) -> str:
    # Solved to rounding, a margin of 60° reads 59.99999999: rounded before it is cut to
    # four digits; + 0.0 takes the sign of −0.
    return (
        number(round(math.degrees(value), 5) + 0.0, 4)
        if name.endswith("[rad]")
        else number(value)
    )


def watch_view(seen: Watch) -> View:
    """What has changed, and everything that was compared."""
    rows = tuple(
        (
            each.name.replace("_", " "),
            number(each.was),
            number(each.now),
            number(each.standard_error, 2),
            "changed" if each.changed else "as before",
        )
        for each in seen.changes
    )
    due = ", ".join(name.replace("_", " ") for name in seen.due)
    headline = (
        f"a retune is due: {due}"
        if due
        else f"as it was tuned, by {seen.motion:.0f} s of motion"
    )
    left = f"the fit leaves {number(seen.residual, 2)} N·m, the gauge's noise was {number(seen.expected, 2)} N·m"
    table = Table(("what", "tuned", "now", "± standard error", ""), rows)
    return View(headline, (table,), (left,), "passed" if seen.passed else "failed")


def _measured(made: Tuning) -> Iterator[Row]:
    if made.motor is not None:
        # The motor measured with its link is the later and better one; the errors are
        # those of the motor's own experiments, which are larger.
        fit, errors = (
            (made.link.motor if made.link else made.motor).fit,
            made.motor.fit.standard_errors,
        )
        yield "K/J [rad/(s²·V)]", number(fit.gain), number(errors["gain"], 2)
        yield "ν/J [1/s]", number(fit.decay), number(errors["decay"], 2)
        yield (
            "friction [V]",
            number(fit.coulomb_voltage + fit.dead_zone),
            number(errors["coulomb_voltage"], 2),
        )
        yield "delay of the voltage [ms]", number(1e3 * fit.delay, 3), ""
        yield "motor loop [rad/s]", number(made.motor.loop.pole), ""
    if made.link is not None:
        model, found = made.link.fit.model, made.link.fit.standard_errors
        for name, word in (
            ("natural_frequency", "ω₀ [s^(−λ/2)]"),
            ("order", "λ"),
            ("damping", "μ"),
        ):
            if name in found:
                yield word, number(getattr(model, name)), number(found[name], 2)
        yield (
            "torque over bend [N·m/rad]",
            number(model.stiffness),
            number(found.get("gain"), 2),
        )
        late = found.get("delay")
        yield (
            "delay of the gauge [ms]",
            number(1e3 * model.gauge_delay, 3),
            number(late and 1e3 * late, 2),
        )
        mode = model.second_mode
        if mode is not None:
            yield "second mode [rad/s]", number(mode.frequency), ""


# --- a shaped move ----------------------------------------------------------------------------------------


def _seconds(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "never"


def shaped_view(made: ShapedMove) -> View:
    """The settling time, or along a path the largest distance, as promised and as
    measured.
    """
    ours, along = made.shaped, made.target is not None
    low, high = map(grams, made.payloads)
    carried = low if low == high else f"{low} to {high}"
    what = f"{number(made.amplitude)} rad with {carried}, payload {'given' if made.told else 'not given'}"
    if along:
        result = f"the tip stays within {milli(ours.largest_error)} mrad of the path"
    else:
        time = ours.settling_time
        result = (
            f"settles in {_seconds(time)} s"
            if math.isfinite(time)
            else "does not settle"
        )
    voltage = f"{number(ours.peak_voltage, 3)} V of {number(made.voltage)} V"
    last = "farthest [mrad]" if along else "residual vibration [mrad]"
    promised = (
        ("promised [mrad]", "lasts [s]")
        if along
        else ("promised [s]", "settles to 2 % [s]")
    )
    header = (
        "reference",
        *promised,
        last,
        "peak voltage [V]",
        "guards act [% of runs]",
    )
    table = Table(header, tuple(_row(each, along=along) for each in made.measured))
    state = "passed" if made.passed else "failed"
    return View(
        f"{what}: {result}, {voltage}",
        (table,),
        tuple(map(finding_line, made.findings)),
        state,
    )


def _row(each: Measured, *, along: bool) -> Row:
    first = (milli(each.predicted), _seconds(each.duration), milli(each.largest_error))
    if not along:
        settled = _seconds(each.predicted), _seconds(each.settling_time)
        first = (*settled, milli(each.residual_vibration))
    return (
        each.name,
        *first,
        number(each.peak_voltage, 3),
        f"{100 * each.limited:.0f}",
    )
