"""What people read of every fit but that of a link to a log, and of the data it is made
from.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from fraclink._arm.link import structure
from fraclink.view._tables import PARAMETERS, held_out, source_name
from fraclink.view._text import Row, Table, View, grams, number, uncertain

if TYPE_CHECKING:
    from fraclink.findings import Finding

__all__ = ["driven_view"]
__all__ += [
    "experiment_view",
    "motor_view",
    "payloads_view",
    "recording_view",
    "response_view",
    "spectrum_view",
]
__all__ += ["structure_view", "validation_view", "worth_reading"]


def worth_reading(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Findings but those that are only good to know."""
    return tuple(str(finding) for finding in findings if finding.severity != "info")


def payloads_view(fit: Any) -> View:
    """Several payloads, fitted together."""
    free = structure(fit.structure).free
    rows = tuple(
        (
            grams(m.payload),
            number(m.natural_frequency, 6),
            number(m.order, 5),
            number(m.damping) if "damping" in free else "–",
            number(m.damping_order) if "damping_order" in free else "–",
            number(mse),
            number(alone),
        )
        for m, mse, alone in zip(fit.models, fit.mse, fit.alone_mse, strict=True)
    )
    names = (
        name.partition(" ")[0] if name.startswith("μ") else name
        for name in PARAMETERS.values()
    )
    return View(
        fit.verdict, (Table(("payload", *names, "MSE together", "MSE alone"), rows),)
    )


# Name of a figure of `Validation.figures`, its unit's factor and the words of it.
_FIGURES = {
    "resonance": ("resonance [rad/s]", 1.0),
    "order": ("λ", 1.0),
    "damping": ("μ", 1.0),
    "damping_order": ("α", 1.0),
    "delay": ("delay [ms]", 1e3),
    "gain": ("gain", 1.0),
}


def validation_view(found: Any) -> View:
    """A fit beside logs that it has not seen."""
    named = {
        source_name(each.log) or f"log {k}": each
        for k, each in enumerate(found.logs, 1)
    }
    errors: tuple[Row, ...] = tuple(
        (
            name,
            f"{100 * each.nmse:.3g} %",
            number(each.bias, 3),
            number(float(each.frequencies[each.share.argmax()]), 3),
        )
        for name, each in named.items()
    )
    columns = (found.figures, *map(found.figures_of, found.logs))
    rows = tuple(
        (
            words,
            *(
                uncertain(factor * x.value, 0.5 * factor * (x.high - x.low))
                for x in (column[key] for column in columns)
            ),
        )
        for key, (words, factor) in _FIGURES.items()
        if key in found.figures
    )
    tables = (
        Table(("log", "error (NMSE)", "bias", "worst at [rad/s]"), errors),
        Table(("95 % interval", "the model", *named), rows),
    )
    state = "passed" if found.passed else "failed"
    return View(found.verdict, tables, worth_reading(found.findings), state)


def motor_view(fit: Any) -> View:
    """A motor."""
    errors = fit.standard_errors
    rows: tuple[Row, ...] = (
        ("K/J [rad/(V·s²)]", uncertain(fit.gain, errors["gain"])),
        ("ν/J [1/s]", uncertain(fit.decay, errors["decay"])),
        (
            "Coulomb friction [V]",
            uncertain(fit.coulomb_voltage, errors["coulomb_voltage"]),
        ),
        ("Coulomb torque [N·m]", number(fit.coulomb_torque)),
        ("dead zone [V]", number(fit.dead_zone)),
        ("delay [ms]", number(1e3 * fit.delay, 3)),
    )
    state = "" if fit.passed else "not shown"
    return View(
        tables=(Table(("motor", "value"), rows),),
        notes=worth_reading(fit.findings),
        state=state,
    )


def spectrum_view(fit: Any) -> View:
    """Modes of a frequency response."""
    errors = fit.standard_errors
    named = {"resonance": fit.resonances, "anti-resonance": fit.anti_resonances}
    modes = {
        f"{kind} {i}": w
        for kind, values in named.items()
        for i, w in enumerate(values, 1)
    }
    delay = uncertain(
        1e3 * fit.delay, 1e3 * errors["delay"] if "delay" in errors else None
    )
    rows = (
        ("λ", uncertain(fit.order, errors.get("order"))),
        *(
            (f"{name} [rad/s]", uncertain(w, errors.get(name)))
            for name, w in modes.items()
        ),
        *(
            ("delay [ms]", delay),
            ("gain", number(fit.gain)),
            ("fit [%]", f"{fit.fit:.2f}"),
        ),
    )
    aside = (
        (f"{len(fit.outliers)} frequencies set aside as outliers",)
        if len(fit.outliers)
        else ()
    )
    notes = (*aside, *worth_reading(fit.findings))
    state = "" if fit.passed else "not shown"
    return View(
        tables=(Table(("frequency response", "value"), rows),), notes=notes, state=state
    )


def structure_view(fit: Any) -> View:
    """A structure of one's own."""
    rows = []
    for name, value in fit.parameters.items():
        interval = fit.intervals.get(name)
        if name in fit.fixed:
            known = "given"
        # Before the interval: at a bound the curvature says nothing, and an interval
        # from it would be an invention.
        elif name in fit.at_bound:
            known = "at a bound of its range"
        elif interval is None or name in fit.undetermined:
            known = "not determined"
        else:
            known = _span(interval)
        rows.append((name, number(value, 6), known))
    state = "passed" if fit.passed else "not shown"
    table = Table((fit.expression, "value", "95 % interval"), tuple(rows))
    notes = (f"G(s) = {fit.transfer_function}", *worth_reading(fit.findings))
    return View(
        f"error {100 * fit.nmse:.2g} %, {held_out(fit.heldout_nmse)}",
        (table,),
        notes,
        state,
    )


def driven_view(found: Any) -> View:
    """A link with its motor."""
    fit = found.fit
    named = (
        ("λ", "l"),
        (
            "anti-resonance [rad/s]"
            if found.output == "motor_angle"
            else "link, motor held [rad/s]",
            "z",
        ),
        ("c/J [1/s²]", "m"),
        ("ν/J [1/s]", "B"),
        ("K/J [rad/(V·s²)]", "A") if found.output == "motor_angle" else ("K c/J", "k"),
        ("delay [s]", "T"),
    )
    shown = {
        name: interval
        for name, interval in fit.intervals.items()
        if name not in fit.undetermined
    }
    rows = [
        (
            text,
            number(fit.parameters[name], 5),
            _span(shown[name]) if name in shown else "not determined",
        )
        for text, name in named
    ]
    # Derived from the parameters before it, hence without an interval of its own.
    rows.insert(
        2, ("peak [rad/s]", "–" if found.peak is None else number(found.peak, 5), "")
    )
    state = "passed" if found.passed else "not shown"
    table = Table(("link and motor", "value", "95 % interval"), tuple(rows))
    return View(
        f"error {100 * fit.nmse:.2g} %", (table,), worth_reading(found.findings), state
    )


def _span(interval: Any) -> str:
    return f"{number(interval.low, 5)} to {number(interval.high, 5)}"


def recording_view(record: Any) -> View:
    """Two channels of a file."""
    rows = (
        ("samples", f"{record.input.size}"),
        ("period [s]", number(record.period, 6)),
        (
            "input",
            f"{number(float(record.input.min()), 4)} to {number(float(record.input.max()), 4)}",
        ),
        (
            "output",
            f"{number(float(record.output.min()), 4)} to {number(float(record.output.max()), 4)}",
        ),
    )
    return View(source_name(record), (Table(("recording", "value"), rows),))


def response_view(measured: Any) -> View:
    """A frequency response."""
    low, high = measured.band
    rows = (
        ("lines", f"{measured.frequency.size}"),
        ("band [rad/s]", f"{number(low, 4)} to {number(high, 4)}"),
        (
            "coherence",
            "–"
            if measured.coherence is None
            else f"{number(float(measured.coherence.min()), 3)} or more",
        ),
    )
    return View(source_name(measured), (Table(("frequency response", "value"), rows),))


def experiment_view(plan: Any) -> View:
    """A planned experiment."""
    rows = {
        "kind": plan.kind,
        "amplitude [rad]": number(plan.amplitude, 5),
        "bit [s]": number(plan.bit, 5),
        "band [rad/s]": f"{number(plan.band[0], 3)} to {number(plan.band[1], 3)}",
        "duration [s]": number(plan.duration, 5),
        "standard error of λ": number(plan.standard_error, 5),
        "peak deflection [rad]": number(plan.peak_deflection, 5),
        "peak voltage [V]": number(plan.peak_voltage, 5),
    }
    # An excitation for the motor alone has no standard error of λ, and is not told that
    # it has none.
    known = tuple((name, value) for name, value in rows.items() if value != "–")
    return View(tables=(Table(("experiment", "value"), known),))
