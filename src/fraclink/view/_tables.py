"""Tables of the parts of a study, once: command line, notebook and report show the same
rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from fraclink._arm.link import structure
from fraclink.view._text import (
    Row,
    Table,
    degrees,
    grams,
    milli,
    number,
    quantity,
    uncertain,
)

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment
    from fraclink._arm.rig import Rig
    from fraclink._certify import Certificate
    from fraclink._design import Design, Requirement
    from fraclink._identify import Fit
    from fraclink._law import Law
    from fraclink._simulate import Run
    from fraclink.findings import Scope, Verdict
    from fraclink.trials._faults import FaultTable
    from fraclink.trials._study import Study
    from fraclink.trials._summary import Summary


def state_of(result: Any) -> str:
    """The word of a result's verdict."""
    return "passed" if result.passed else "failed"


def source_name(log: Experiment | None) -> str:
    """The log's name without the folders of one machine."""
    return (
        PurePath(log.source.replace("\\", "/")).name
        if log is not None and log.source
        else "unnamed log"
    )


# --- rig, log and models ----------------------------------------------------------------------------------


def rig_table(rig: Rig) -> Table:
    """Quantity, symbol and value of everything the rig states."""
    motor, link, gauge, counts = (
        rig.motor,
        rig.link,
        rig.gauge,
        rig.encoder.counts_per_revolution,
    )
    span = f"{number(1e3 * rig.payloads.low)} to {grams(rig.payloads.high)}, {grams(rig.payloads.nominal)}"
    samples = rig.motor_loop.delay_samples
    rows = (
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
        ("Payload range, nominal", "m", span),
        ("Encoder", "", "exact" if counts is None else f"{counts} counts per turn"),
        (
            "Gauge noise, offset",
            "",
            f"{number(gauge.noise)} N·m, {number(gauge.offset)} N·m",
        ),
        ("Motor loop: double pole", "p", f"{number(rig.motor_loop.pole)} rad/s"),
        ("Computation delay", "", f"{samples} sample{'' if samples == 1 else 's'}"),
        ("Sampling period", "Ts", f"{number(1e3 * rig.period)} ms"),
    )
    return Table(("quantity", "symbol", "value"), rows)


_OUTPUTS = {"torque": "base torque [N·m]", "deflection": "deflection angle [rad]"}


def log_table(log: Experiment) -> Table:
    """Quantity and value of what is known about the log."""
    duration = log.period * (len(log.time) - 1)
    rows: list[Row] = [
        (
            "Samples",
            f"{len(log.time)} in {number(duration)} s, one every {number(1e3 * log.period)} ms",
        ),
        ("Output", _OUTPUTS[log.output_kind]),
        ("Payload", grams(log.payload) if log.payload is not None else "not stated"),
    ]
    rows += [("SHA-256 of the file", log.sha256)] if log.sha256 else []
    shown = {"title", "simulated", "source", "damping"}
    rows += [(name.capitalize(), value) for name, value in log.notes if name in shown]
    return Table(("log", "value"), tuple(rows))


PARAMETERS = {
    "natural_frequency": "ω₀ [s^(−λ/2)]",
    "order": "λ",
    "damping": "μ [s^(α−λ)]",
    "damping_order": "α",
}


def _parameter(fit: Fit, name: str) -> str:
    value = getattr(fit.model, name)
    if name == "natural_frequency" and value == 0:
        # a D-FOM that ended at its bound: the line below the table says which UD-FOM it
        # is
        return "–"
    # A parameter that the structure holds is no estimate: it has no error, and 0
    # damping has no order.
    if name not in structure(fit.structure).free:
        return (
            "–"
            if value == 0 or (name == "damping_order" and fit.model.damping == 0)
            else number(value)
        )
    # A line may end before the sign, never behind it.
    return uncertain(value, fit.standard_errors.get(name)).replace(
        "± ", "±\N{NO-BREAK SPACE}"
    )


def held_out(share: float | None) -> str:
    """The error on the part of a log that was held out, as a headline has it.

    >>> held_out(0.0149), held_out(None)
    ('held-out error 1.5 %', 'nothing held out')
    """
    return (
        "nothing held out" if share is None else f"held-out error {100 * share:.2g} %"
    )


def _aic(fit: Fit) -> str:
    return f"{fit.aic:.1f}".replace("-", "−")


def fits_table(fits: Mapping[str, Fit], *, brief: bool = False) -> Table:
    """One row for each structure: parameters with standard errors, then the criteria.

    A terminal has room for the `brief` table: the two parameters of the fractional
    link, and no MSE.
    """
    # 80 columns of a terminal: damping and its order are in the file and in the report.
    shown = [name for name in PARAMETERS if not (brief and name.startswith("damping"))]
    errors = () if brief else ("MSE",)
    header = (
        "structure",
        *(PARAMETERS[n] for n in shown),
        "delay [ms]",
        *errors,
        "AIC",
        "held-out NMSE",
    )
    rows = tuple(
        (
            name,
            *(_parameter(fit, parameter) for parameter in shown),
            milli(fit.delay, 2),
            *(number(fit.mse) for _ in errors),
            _aic(fit),
            number(fit.heldout_nmse),
        )
        for name, fit in fits.items()
    )
    return Table(header, rows)


def coincidence(fits: Mapping[str, Fit]) -> list[str]:
    """What the dash of a table means: s²/(s² + μ s^α) is s^(2−α)/(s^(2−α) + μ), one
    model by two names.
    """
    damped = fits.get("D-FOM")
    if damped is None or damped.model.natural_frequency:
        return []
    order, frequency = 2.0 - damped.model.damping_order, math.sqrt(damped.model.damping)
    return [
        f"– D-FOM ended at ω₀ = 0: it is UD-FOM with λ = 2 − α = {order:.4f}, ω₀ = √μ = {frequency:.4f}."
    ]


def fit_table(fit: Fit) -> Table:
    """Parameters of one fit, each with its standard error, then what says how good it
    is.
    """
    held = "nothing held out" if fit.heldout_nmse is None else number(fit.heldout_nmse)
    rows = (
        *(
            (PARAMETERS[name], _parameter(fit, name))
            for name in structure(fit.structure).free
        ),
        ("gauge delay [ms]", milli(fit.delay, 2)),
        ("gain", number(fit.gain)),
        ("offset", number(fit.offset)),
        ("mean squared error", number(fit.mse)),
        ("AIC", _aic(fit)),
        ("held-out error (NMSE)", held),
    )
    return Table((fit.structure, "value"), rows)


# --- the design and its moves -----------------------------------------------------------------------------


def controller_table(design: Design, law: Law | None = None) -> Table:
    """Symbol, meaning and value of the controller's parameters, and of its law."""
    c = design.controller
    filtered = (
        f"{number(c.filter_time)} s, {c.filter_order}" if c.filter_time else "none"
    )
    rows: list[Row] = [
        ("k_d", "gain", f"{number(c.gain, 5)} s^β"),
        ("β", "order of the derivative", number(c.order, 5)),
        ("δ, n" if c.filter_time else "δ", "filter", filtered),
        (
            "ω̄_c",
            "crossover at the lightest payload",
            f"{number(design.gain_crossover_upper, 5)} rad/s",
        ),
    ]
    if law is not None:
        decibel, degree = law.correction_error
        order = len(law.correction.poles) + 2 * len(law.correction.pair_poles)
        rows.append(("", "states of the discrete law", str(order)))
        band = f"{number(law.band[0], 2)} to {number(law.band[1], 3)} rad/s"
        rows.append(
            (
                "",
                f"its error from {band}",
                f"{number(decibel, 2)} dB, {number(degree, 2)}°",
            )
        )
    return Table(("", "controller", "value"), tuple(rows))


def relation(item: Requirement) -> str:
    """Whether a requirement is a lower or an upper bound.

    >>> from fraclink._design import Requirement
    >>> relation(Requirement.at_most("noise gain", 2.0, 2.0, "", 0.02))
    '≤'
    """
    return "≤" if item.bound == "at most" else "≥"


def requirements_table(requirements: Iterable[Requirement]) -> Table:
    """Name, required value, achieved value, payload, slack in the same unit, and whether
    it is met.
    """

    def slack(item: Requirement) -> str:
        if item.unit == "rad":
            return degrees(item.slack)
        # As far as the achieved value is shown: what is left behind it is the solver's.
        size = max(abs(item.achieved), abs(item.wanted))
        if not (math.isfinite(item.slack) and size):
            return number(item.slack)
        return number(round(item.slack, 3 - math.floor(math.log10(size))))

    rows = tuple(
        (
            item.name,
            f"{relation(item)} {quantity(item.wanted, item.unit)}",
            quantity(item.achieved, item.unit),
            grams(item.at_payload),
            slack(item),
            "passed" if item.passed else "missed",
        )
        for item in requirements
    )
    return Table(
        ("requirement", "required", "achieved", "worst at", "slack", "verdict"),
        rows,
        judged=True,
    )


def proof_sentence(certificate: Certificate) -> str:
    """What a certificate claims, in units that a person reads; the exact statement is
    its `verdict`.

    |1 + L| > m leaves a phase margin above 2 asin(m/2) and a gain margin above
    1/(1 − m), and the arms of the table `proof_table` lie inside the claim.
    """
    if not certificate.passed:
        return certificate.verdict
    claim = certificate.statement
    low, high = number(1e3 * claim.payload_low), grams(claim.payload_high)
    delays = f"{number(1e3 * claim.delay_low)} to {number(1e3 * claim.delay_high)} ms"
    # Downwards: a digit that is rounded up would claim what is not proved.
    modulus = math.floor(1e3 * claim.modulus + 1e-9) / 1e3
    angle = math.degrees(2.0 * math.asin(min(1.0, 0.5 * modulus)))
    margin = degrees(math.radians(math.floor(10.0 * angle) / 10.0))
    factor = math.floor(100.0 / (1.0 - modulus)) / 100.0 if modulus < 1.0 else math.inf
    return (
        f"proved stable for every payload from {low} to {high}, every computation delay "
        f"from {delays} and every arm of the stated box; distance to −1 above "
        f"{number(modulus)}, which is at least {margin} of phase margin and a gain margin "
        f"of {number(factor)}"
    )


def proof_table(certificate: Certificate) -> Table:
    """Quantity, least and largest value of the box that a certificate is about."""
    claim = certificate.statement
    named = (
        ("payload [g]", "payload", 1e3),
        ("computation delay [ms]", "delay", 1e3),
        ("order λ", "order", 1.0),
        ("1/ω₀² over the payload [1/(kg·s^−λ)]", "softness", 1.0),
        ("damping μ", "damping", 1.0),
        ("gain of the gauge", "gauge_gain", 1.0),
        ("delay of the gauge [ms]", "gauge_delay", 1e3),
        ("second mode [rad/s]", "mode_frequency", 1.0),
        ("gain of the second mode", "mode_gain", 1.0),
        ("pole of the motor loop [rad/s]", "pole", 1.0),
        ("gain of the motor [rad/(V·s²)]", "gain", 1.0),
    )
    rows = [
        (words, low * factor, high * factor)
        for words, name, factor in named
        for low, high in [
            (getattr(claim, f"{name}_low"), getattr(claim, f"{name}_high"))
        ]
    ]
    return Table(
        ("inside the proof", "from", "to"),
        tuple((words, number(a), number(b)) for words, a, b in rows if a or b),
    )


def margins_table(design: Design, payloads: Iterable[float]) -> Table:
    """Margins at some payloads, of the continuous loop designed for and of the sampled
    one.
    """
    header = (
        "payload",
        "ω_c [rad/s]",
        "φ_m",
        "sampled ω_c [rad/s]",
        "sampled φ_m",
        "distance to −1",
    )
    rows: list[Row] = []
    for payload in payloads:
        both = (
            design.at(payload),
            *((design.sampled_at(payload),) if design.has_law else ()),
        )
        cells = [
            cell
            for m in both
            for cell in (number(m.gain_crossover), degrees(m.phase_margin))
        ]
        sampled = (
            [number(both[1].modulus_margin, 3)] if design.has_law else 3 * ["no law"]
        )
        rows.append((grams(payload), *cells, *sampled))
    return Table(header, tuple(rows))


def _time(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "never"


def _carried(run: Run) -> str:
    """The payload at the tip, and what the law was given of it."""
    given = run.about.get("payload_given", 0.0)
    if not given:
        return grams(run.payload)
    if given == "estimated":
        found = float(run.extras["payload_estimate"][-1])
        return f"{grams(run.payload)}, estimated " + (
            grams(found) if found else "not yet"
        )
    # "told" and the true payload are one; any other number is a payload that the law
    # was wrongly given, and both are shown.
    own = isinstance(given, str) or given == run.payload
    return (
        f"{grams(run.payload)}, given"
        if own
        else f"{grams(run.payload)}, given {grams(given)}"
    )


def moves_table(runs: Sequence[Run]) -> Table:
    """Payload and metrics of each move, and its verdict."""
    errors = (
        "residual vibration [mrad]",
        "final error [mrad]",
        "peak voltage [V]",
        "reference noise [mrad]",
    )
    rows = tuple(
        (
            _carried(run),
            f"{100 * run.metrics.overshoot:.1f}",
            _time(run.metrics.settling_time, ".2f"),
            milli(run.metrics.residual_vibration),
            milli(run.metrics.steady_state_error, 2),
            number(run.metrics.peak_voltage, 3),
            milli(run.metrics.motor_reference_noise),
            state_of(run.verdict),
        )
        for run in runs
    )
    return Table(
        ("payload", "overshoot [%]", "settles to 2 % [s]", *errors, "verdict"),
        rows,
        judged=True,
    )


# --- many runs --------------------------------------------------------------------------------------------

# Unit and factor of a campaign's metrics.
UNITS = {
    "overshoot": ("%", 100.0),
    "settling_time": ("s", 1.0),
    "residual_vibration": ("mrad", 1e3),
    "steady_state_error": ("mrad", 1e3),
    "peak_tip_error": ("mrad", 1e3),
    "peak_voltage": ("V", 1.0),
    "motor_reference_noise": ("mrad", 1e3),
    "saturated": ("%", 100.0),
    "growth": ("1/s", 1.0),
}


def metric_name(name: str) -> str:
    """A metric with its unit.

    >>> metric_name("settling_time")
    'settling time [s]'
    """
    return f"{name.replace('_', ' ')} [{UNITS[name][0]}]"


def metric_text(name: str, value: float) -> str:
    """A metric's value in its unit."""
    # Infinite is a time that never comes: the tip does not settle, or no growth could
    # be found.
    return number(UNITS[name][1] * value, 3) if math.isfinite(value) else "never"


# The lowest class of the drawing of all drivers: a parameter below it explains some 2 %
# of the variance of the ranks, which nobody would act on. No test of significance: of
# ten parameters without any effect one exceeds it by chance in three of four campaigns
# of 100 runs, but in one of 50 000 campaigns of 1000 runs.
WEAK = 0.15


def spread_table(summary: Summary) -> Table:
    """Quantiles of every metric over the arms of a campaign, and what drives it most."""
    shares = [f"{100 * q.probability:g} %" for q in summary.metrics[0].quantiles]
    rows = []
    for metric in summary.metrics:
        values = (metric_text(metric.name, q.value) for q in metric.quantiles)
        # One driver: the strongest. The drawing of all of them is in the campaign's
        # report.
        strong = [(name, r) for name, r in metric.drivers[:1] if abs(r) >= WEAK]
        driver = ", ".join(f"{name.replace('_', ' ')} {r:+.2f}" for name, r in strong)
        rows.append(
            (metric_name(metric.name), *values, driver.replace("-", "−") or "–")
        )
    return Table(("metric", *shares, "driven by"), tuple(rows))


def faults_table(table: FaultTable) -> Table:
    """One row for each fault, those that miss their requirement first."""
    # sorted is stable: within met and missed the order of the catalogue stays.
    rows = tuple(
        (
            f"{row.number} {row.title}",
            str(row.runs),
            str(row.failed or "–"),
            state_of(row),
        )
        for row in sorted(table.rows(), key=lambda row: row.passed)
    )
    return Table(("fault", "runs", "failed", "verdict"), rows, judged=True)


def faults_sentence(table: FaultTable) -> str:
    """How many faults meet their requirement in every run, as a sentence's part."""
    rows = table.rows()
    met = sum(row.passed for row in rows)
    return f"{met} of {len(rows)} faults meet their requirement in every run, {len(table.outcomes)} runs"


# --- the study --------------------------------------------------------------------------------------------


def verdict_sentence(verdict: Verdict) -> str:
    """The three states in one line, as a headline carries them.

    >>> from fraclink.findings import Scope, Verdict
    >>> verdict_sentence(Verdict(Scope("passed"), Scope("passed"), Scope("not run")))
    'promise passed, model passed, reality not run'
    """
    return ", ".join(f"{name} {scope.state}" for name, scope in verdict.scopes.items())


_SCOPES = {
    "promise": "requirements and proof",
    "model": "simulated moves of the model",
    "reality": "arms that differ, on the twin",
}


def verdict_table(verdict: Verdict) -> Table:
    """The three scopes, each with its reasons."""
    rows = tuple(
        (name, _SCOPES[name], "; ".join(scope.reasons) or "–", scope.state)
        for name, scope in verdict.scopes.items()
    )
    return Table(("scope", "what", "why", "verdict"), rows, judged=True)


def scopes(verdict: Verdict) -> list[tuple[str, str, Scope]]:
    """Name, what it is about, and scope: what a page lays side by side."""
    return [(name, _SCOPES[name], scope) for name, scope in verdict.scopes.items()]


def summary_rows(study: Study) -> list[Row]:
    """The handful of numbers that a reader looks for first."""
    rows: list[Row] = []
    if study.fit is not None:
        model, share = study.fit.model, study.fit.heldout_nmse
        held = "" if share is None else f", held-out error {100 * share:.2g} %"
        order, frequency = number(model.order, 5), number(model.natural_frequency, 5)
        rows.append(
            ("Model", f"{study.fit.structure}: λ = {order}, ω₀ = {frequency}{held}")
        )
    if study.design is not None:
        c = study.design.controller
        filtered = f", δ = {number(1e3 * c.filter_time, 3)} ms" if c.filter_time else ""
        rows.append(
            (
                "Controller",
                f"k_d = {number(c.gain, 4)}, β = {number(c.order, 4)}{filtered}",
            )
        )
    if study.design is not None and study.design.has_law:
        # A design for one payload has both ends alike, and is told once.
        ends = sorted(set(study.design.payloads))
        margins = (
            f"{degrees(study.design.sampled_at(m).phase_margin)} at {grams(m)}"
            for m in ends
        )
        rows.append(("Phase margin of the sampled loop", " and ".join(margins)))
    if study.certificate is not None:
        modulus = number(study.certificate.statement.modulus, 3)
        rows.append(("Proved for every payload and delay", f"|1 + L| > {modulus}"))
    if study.runs:
        settled = max(run.metrics.settling_time for run in study.runs)
        shown = (
            f"within {settled:.2f} s"
            if math.isfinite(settled)
            else "not for every payload"
        )
        rows.append(("The tip settles to 2 %", shown))
    if study.arms is not None:
        failure = study.arms.failure
        rows.append(
            (
                "Arms that differ",
                f"{failure.runs - failure.count} of {failure.runs} passed",
            )
        )
    if study.faults is not None:
        rows.append(("Faults on the twin", faults_sentence(study.faults)))
    return rows
