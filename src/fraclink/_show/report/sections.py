"""What the sections of a report say, as rows of text that a template sets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import TYPE_CHECKING

from fraclink._show.report.numbers import degrees, grams, milli, number, quantity, uncertain

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment
    from fraclink._arm.rig import Rig
    from fraclink._design import Design, Requirement
    from fraclink._identify import Fit
    from fraclink._law import Law
    from fraclink._simulate import Run
    from fraclink._workflow import Study

__all__ = [
    "controller_rows",
    "fit_rows",
    "in_short",
    "log_rows",
    "margin_rows",
    "move_rows",
    "relation",
    "requirement_rows",
    "rig_rows",
    "source_name",
]

Row = tuple[str, ...]


def source_name(log: Experiment | None) -> str:
    """The log's name without the folders of one machine."""
    return PurePath(log.source.replace("\\", "/")).name if log is not None and log.source else "unnamed log"


def rig_rows(rig: Rig) -> list[Row]:
    """Quantity, symbol and value of everything the rig states."""
    motor, link, gauge, encoder = rig.motor, rig.link, rig.gauge, rig.encoder
    counts = encoder.counts_per_revolution
    return [
        ("Motor inertia", "J", f"{number(motor.inertia)} kg·m²"),
        ("Motor viscous friction", "ν", f"{number(motor.viscous_friction)} N·m·s"),
        ("Motor torque constant", "K", f"{number(motor.torque_constant)} N·m/V"),
        ("Gear ratio", "", number(motor.gear_ratio)),
        ("Coulomb torque", "", f"{number(motor.coulomb_torque)} N·m"),
        ("Voltage limit", "", f"{number(motor.voltage_limit)} V"),
        ("Link length", "L", f"{number(link.length)} m"),
        ("Flexural rigidity", "EI", f"{number(link.flexural_rigidity)} N·m²"),
        ("Link stiffness", "c", f"{number(link.stiffness)} N·m/rad"),
        ("Link mass", "", f"{number(1e3 * link.mass)} g"),
        (
            "Payload range, nominal",
            "m",
            f"{number(1e3 * rig.payloads.low)} to {grams(rig.payloads.high)}, {grams(rig.payloads.nominal)}",
        ),
        ("Encoder", "", "exact" if counts is None else f"{counts} counts per turn"),
        (
            "Gauge noise, offset",
            "",
            f"{number(gauge.noise)} N·m, {number(gauge.offset)} N·m",
        ),
        ("Motor loop: double pole", "p", f"{number(rig.inner.pole)} rad/s"),
        (
            "Computation delay",
            "",
            f"{rig.inner.delay_samples} sample{'' if rig.inner.delay_samples == 1 else 's'}",
        ),
        ("Sampling period", "Ts", f"{number(1e3 * rig.period)} ms"),
    ]


def log_rows(log: Experiment) -> list[Row]:
    """Quantity and value of what is known about the log."""
    duration = log.period * (len(log.time) - 1)
    rows: list[Row] = [
        ("Samples", f"{len(log.time)} in {number(duration)} s, one each {number(1e3 * log.period)} ms"),
        ("Output", {"torque": "base torque [N·m]", "deflection": "deflection angle [rad]"}[log.output_kind]),
        ("Payload", grams(log.payload) if log.payload is not None else "not stated"),
    ]
    if log.sha256:
        rows.append(("SHA-256 of the file", log.sha256))
    rows += [
        (name.capitalize(), value)
        for name, value in log.notes
        if name in {"title", "simulated", "source", "damping"}
    ]
    return rows


def _parameter(fit: Fit, name: str) -> str:
    from fraclink._arm.link import structure

    value = getattr(fit.model, name)
    if name == "natural_frequency" and value == 0:
        return "–"  # a D-FOM that ended at its bound: the line below the table says which UD-FOM it is
    if name not in structure(fit.structure).free:
        return "–" if value == 0 or (name == "damping_order" and fit.model.damping == 0) else number(value)
    # A line may end before the sign, never behind it.
    return uncertain(value, fit.standard_errors.get(name)).replace("± ", "±\N{NO-BREAK SPACE}")


def fit_rows(fits: Mapping[str, Fit]) -> list[Row]:
    """One row for each structure: parameters with standard errors, then the criteria."""
    return [
        (
            name,
            _parameter(fit, "natural_frequency"),
            _parameter(fit, "order"),
            _parameter(fit, "damping"),
            _parameter(fit, "damping_order"),
            milli(fit.delay, 2),
            number(fit.mse),
            f"{fit.aic:.1f}".replace("-", "−"),
            number(fit.heldout_nmse),
        )
        for name, fit in fits.items()
    ]


def controller_rows(design: Design, law: Law | None) -> list[Row]:
    """Symbol, meaning and value of the controller's parameters, and of its law."""
    controller = design.controller
    rows: list[Row] = [
        ("k_d", "gain", f"{number(controller.gain, 6)} s^β"),
        ("β", "order of the derivative", number(controller.order, 6)),
    ]
    if controller.filter_time:
        rows.append(("δ, n", "filter", f"{number(controller.filter_time)} s, {controller.filter_order}"))
    else:
        rows.append(("δ", "filter", "none"))
    rows.append(
        ("ω̄_c", "crossover at the lightest payload", f"{number(design.gain_crossover_upper, 6)} rad/s")
    )
    if law is not None:
        decibel, degree = law.correction_error
        order = len(law.correction.poles) + 2 * len(law.correction.pair_poles)
        rows.append(("", "states of the discrete law", str(order)))
        band = f"{number(law.band[0], 2)} to {number(law.band[1], 3)} rad/s"
        rows.append(("", f"its error from {band}", f"{number(decibel, 2)} dB, {number(degree, 2)}°"))
    return rows


def relation(item: Requirement) -> str:
    """Whether a requirement is a lower or an upper bound.

    >>> from fraclink._design import Requirement
    >>> relation(Requirement.at_most("noise gain", 2.0, 2.0, "", 0.02))
    '≤'
    """
    return "≤" if item.bound == "at most" else "≥"


def requirement_rows(design: Design) -> list[tuple[str, str, str, str, str, bool]]:
    """Name, wanted, achieved, payload, slack, and whether it holds."""
    return [
        (
            item.name,
            f"{relation(item)} {quantity(item.wanted, item.unit)}",
            quantity(item.achieved, item.unit),
            grams(item.at_payload),
            # The equations are solved to rounding: 1e-16 of slack is none.
            quantity(0.0 if abs(item.slack) < 1e-9 * max(1.0, abs(item.wanted)) else item.slack, item.unit),
            item.passed,
        )
        for item in design.requirements
    ]


def margin_rows(design: Design, payloads: list[float]) -> list[Row]:
    """Margins at some payloads, of the loop asked for and of the sampled one."""
    rows: list[Row] = []
    for payload in payloads:
        asked, sampled = design.at(payload), design.sampled_at(payload)
        rows.append(
            (
                grams(payload),
                number(asked.gain_crossover),
                degrees(asked.phase_margin),
                number(sampled.gain_crossover),
                degrees(sampled.phase_margin),
                number(sampled.modulus_margin, 3),
            )
        )
    return rows


def move_rows(runs: tuple[Run, ...]) -> list[tuple[Row, bool, str]]:
    """Payload and metrics of each move, whether it holds, and why not."""
    return [
        (
            (
                grams(run.payload),
                f"{100 * run.metrics.overshoot:.1f}",
                f"{run.metrics.settling_time:.2f}" if math.isfinite(run.metrics.settling_time) else "never",
                milli(run.metrics.residual_vibration),
                milli(run.metrics.steady_state_error, 2),
                number(run.metrics.peak_voltage, 3),
                milli(run.metrics.motor_reference_noise),
            ),
            run.verdict.passed,
            run.verdict.reason,
        )
        for run in runs
    ]


def in_short(study: Study) -> list[Row]:
    """The handful of numbers that a reader looks for first."""
    rows: list[Row] = []
    if study.fit is not None:
        model = study.fit.model
        held = (
            "" if study.fit.heldout_nmse is None else f", held-out error {100 * study.fit.heldout_nmse:.2g} %"
        )
        order, frequency = number(model.order, 5), number(model.natural_frequency, 5)
        rows.append(("Model", f"{study.fit.structure}: λ = {order}, ω₀ = {frequency}{held}"))
    if study.design is not None:
        controller, (low, high) = study.design.controller, study.design.payloads
        filtered = f", δ = {number(1e3 * controller.filter_time, 3)} ms" if controller.filter_time else ""
        rows.append(
            ("Controller", f"k_d = {number(controller.gain, 5)}, β = {number(controller.order, 5)}{filtered}")
        )
        span = " and ".join(
            f"{degrees(study.design.sampled_at(payload).phase_margin)} at {grams(payload)}"
            for payload in sorted({low, high})
        )
        rows.append(("Phase margin of the sampled loop", span))
    if study.certificate is not None:
        statement = study.certificate.statement
        rows.append(("Proved for every payload and delay", f"|1 + L| > {number(statement.modulus, 3)}"))
    if study.runs:
        settled = max(run.metrics.settling_time for run in study.runs)
        shown = f"within {settled:.2f} s" if math.isfinite(settled) else "not for every payload"
        rows.append(("The tip settles to 2 %", shown))
    return rows
