"""What the sections of a report say, as rows of text that a template sets."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import TYPE_CHECKING

from fraclink.report.numbers import degrees, grams, number, quantity, uncertain

if TYPE_CHECKING:
    from fraclink.design import Plan
    from fraclink.experiment import Experiment
    from fraclink.identify import Comparison, Fit
    from fraclink.rig import Rig
    from fraclink.simulate import Run

__all__ = [
    "controller_rows",
    "fit_rows",
    "log_rows",
    "move_rows",
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
        ("Delay of the computation", "", f"{rig.inner.delay_samples} sample(s)"),
        ("Sampling period", "Ts", f"{number(1e3 * rig.period)} ms"),
    ]


def log_rows(log: Experiment) -> list[Row]:
    """Quantity and value of what is known about the log."""
    duration = log.period * (len(log.time) - 1)
    rows = [
        ("Samples", f"{len(log.time)} in {number(duration)} s, one each {number(1e3 * log.period)} ms"),
        ("Output", {"torque": "base torque [N·m]", "deflection": "deflection angle [rad]"}[log.output_kind]),
        ("Payload", grams(log.payload) if log.payload is not None else "not stated"),
    ]
    if log.sha256:
        rows.append(("SHA-256 of the file", log.sha256))
    rows += [
        (name, value) for name, value in log.notes if name in {"title", "simulated", "source", "damping"}
    ]
    return rows


def _parameter(fit: Fit, name: str) -> str:
    from fraclink.link import structure

    value = getattr(fit.model, name)
    if name not in structure(fit.structure).free:
        return "–" if value == 0 or (name == "damping_order" and fit.model.damping == 0) else number(value)
    return uncertain(value, fit.standard_errors.get(name))


def fit_rows(comparison: Comparison) -> list[Row]:
    """One row for each structure: parameters with standard errors, then the criteria."""
    return [
        (
            name,
            _parameter(fit, "natural_frequency"),
            _parameter(fit, "order"),
            _parameter(fit, "damping"),
            _parameter(fit, "damping_order"),
            f"{number(1e3 * fit.delay, 3)} ms",
            number(fit.mse),
            f"{fit.aic:.1f}".replace("-", "−"),
            f"{fit.bic:.1f}".replace("-", "−"),
            number(fit.heldout_nmse),
        )
        for name, fit in comparison.fits.items()
    ]


def controller_rows(plan: Plan) -> list[Row]:
    """Symbol, meaning and value of the controller's parameters."""
    controller = plan.controller
    rows = [
        ("k_d", "gain", f"{number(controller.gain, 6)} s^β"),
        ("β", "order of the derivative", number(controller.order, 6)),
    ]
    if controller.filter_time:
        rows.append(("δ, n", "filter", f"{number(controller.filter_time)} s, {controller.filter_order}"))
    else:
        rows.append(("δ", "filter", "none"))
    rows.append(("ω̄_c", "crossover at the lightest payload", f"{number(plan.gain_crossover_upper, 6)} rad/s"))
    return rows


def requirement_rows(plan: Plan) -> list[tuple[str, str, str, str, str, bool]]:
    """Name, wanted, achieved, payload, slack, and whether it holds."""
    return [
        (
            item.name,
            quantity(item.wanted, item.unit),
            quantity(item.achieved, item.unit),
            grams(item.at_payload),
            # The equations are solved to rounding: 1e-16 of slack is none.
            quantity(0.0 if abs(item.slack) < 1e-9 * max(1.0, abs(item.wanted)) else item.slack, item.unit),
            item.holds,
        )
        for item in plan.requirements
    ]


def margin_rows(plan: Plan, payloads: list[float]) -> list[Row]:
    """Margins at some payloads, of the loop asked for and of the sampled one."""
    rows = []
    for payload in payloads:
        asked, sampled = plan.at(payload), plan.sampled_at(payload)
        rows.append(
            (
                grams(payload),
                f"{number(asked.gain_crossover)} rad/s",
                degrees(asked.phase_margin),
                f"{number(sampled.gain_crossover)} rad/s",
                degrees(sampled.phase_margin),
                number(sampled.modulus_margin, 3),
            )
        )
    return rows


def move_rows(runs: tuple[Run, ...]) -> list[tuple[str, str, str, str, str, str, str, bool]]:
    """Payload, metrics, and whether the move holds."""
    return [
        (
            grams(run.payload),
            f"{100 * run.metrics.overshoot:.2f} %",
            f"{run.metrics.settling_time:.3f} s" if math.isfinite(run.metrics.settling_time) else "never",
            f"{number(1e3 * run.metrics.residual_vibration, 3)} mrad",
            f"{number(1e3 * run.metrics.steady_state_error, 3)} mrad",
            f"{number(run.metrics.peak_voltage, 3)} V",
            f"{number(1e3 * run.metrics.motor_reference_noise, 3)} mrad",
            run.verdict.holds,
        )
        for run in runs
    ]
