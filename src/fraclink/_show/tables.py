"""Each result as rows of text and as JSON, once: command line, notebook and report are templates over them.

`view` gives what people read (headline, tables, notes), `to_json` what programs read. Both look a result up
by the name of its class: importing the classes here would load every package whatever is shown.
"""

from __future__ import annotations

import html
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from fraclink._arm.link import structure
from fraclink._law import MODES, REASONS

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment
    from fraclink._arm.rig import Rig
    from fraclink._campaign import Summary
    from fraclink._campaign.faults import FaultTable
    from fraclink._design import Design, Requirement
    from fraclink._identify import Comparison, Fit
    from fraclink._law import Law
    from fraclink._simulate import Run
    from fraclink._workflow import Study, Verdict
    from fraclink.findings import Finding

__all__ = ["Table", "View", "marked", "plain_text", "to_json", "view"]

Row = tuple[str, ...]


# --- numbers as people read them: few digits, a real minus, powers of ten ---------------------------------

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 4) -> str:
    """Return `value` with `digits` significant digits.

    >>> number(-0.00068712), number(13399.771, 8), number(float("inf")), number(None)
    ('−6.871×10⁻⁴', '13399.771', '∞', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{digits}g}"
    mantissa, _, exponent = text.partition("e")
    if 0 < abs(value) < 1e-3 and not exponent:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    mantissa = mantissa.replace("-", "−")
    if not exponent:
        return mantissa
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{mantissa}×10{str(int(exponent)).translate(_RAISED)}"


def uncertain(value: float, error: float | None) -> str:
    """Return `value ± error`, both with the digits that the error leaves meaningful.

    >>> uncertain(1.918734, 0.000213), uncertain(10.02, None), uncertain(116.0, 145.0)
    ('1.91873 ± 0.00021', '10.02', 'undetermined')
    """
    if error is None or not math.isfinite(error) or error <= 0:
        return number(value, 5)
    if error >= abs(value):
        return "undetermined"
    places = max(0, 1 - math.floor(math.log10(error)))
    if places > 9 or abs(value) >= 1e6:
        return f"{number(value, 5)} ± {number(error, 2)}"
    return f"{value:.{places}f} ± {error:.{places}f}".replace("-", "−")


def grams(payload: float | None) -> str:
    """A payload in grams.

    >>> grams(0.0305)
    '30.5 g'
    """
    return "–" if payload is None else f"{number(1e3 * payload)} g"


def milli(value: float | None, places: int = 1) -> str:
    """A value in thousandths, with as many decimal places as matter beside its neighbours in a column.

    >>> milli(0.0633), milli(-0.0000519, 2), milli(-1e-9, 2)
    ('63.3', '−0.05', '0.00')
    """
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{1e3 * value:.{places}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def degrees(angle: float | None, places: int = 1) -> str:
    """An angle in degrees.

    >>> degrees(math.pi / 6)
    '30.0°'
    """
    if angle is None or math.isnan(angle):
        return "–"
    return f"{math.degrees(angle):.{places}f}°".replace("-", "−")


def quantity(value: float | None, unit: str) -> str:
    """A value with its unit; angles in degrees.

    >>> quantity(12.0, "rad/s"), quantity(math.pi / 4, "rad")
    ('12 rad/s', '45.0°')
    """
    return degrees(value) if unit == "rad" else f"{number(value)} {unit}".strip()


def sentence(text: str) -> str:
    """`text` with a capital and a full stop; the name of a field keeps its spelling.

    >>> sentence("measure it"), sentence("link.stiffness = 1.56 contradicts 3EI/L")
    ('Measure it.', 'link.stiffness = 1.56 contradicts 3EI/L.')
    """
    text = text.strip()
    first = text.partition(" ")[0]
    named = "_" in first or "." in first.rstrip(".") or first == "fraclink"
    ended = text.endswith((".", "?", "!", ":")) or not text
    return (text[:1] if named else text[:1].upper()) + text[1:] + ("" if ended else ".")


def finite(value: float | None) -> float | None:
    """JSON has no infinity: a number that is not finite is null."""
    return None if value is None or not math.isfinite(value) else float(value)


# --- tables and views -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """Header and rows of text; the last column is a word of a verdict where `judged`."""

    header: Row
    rows: tuple[Row, ...]
    judged: bool = False


@dataclass(frozen=True)
class View:
    """What people read of a result: verdict first, tables, then notes; `state` is the word of the verdict."""

    headline: str = ""
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    state: str = ""

    def __str__(self) -> str:
        return plain_text(self)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        parts = [f"<p><b>{html.escape(marked(self.state))}</b> {html.escape(self.headline)}</p>"]
        for table in self.tables:
            lines = [("th", table.header), *(("td", row) for row in table.rows)]
            cells = ("".join(f"<{t}>{html.escape(c)}</{t}>" for c in row) for t, row in lines)
            parts.append("<table>" + "".join(f"<tr>{row}</tr>" for row in cells) + "</table>")
        return "\n".join([*parts, *(f"<p>{html.escape(note)}</p>" for note in self.notes)])


_MARKS = {"passed": "✓", "failed": "✗", "missed": "✗", "not shown": "!", "not run": "–"}


def marked(state: str) -> str:
    """A verdict's word behind its sign, which is there without colours, too.

    >>> marked("passed"), marked("failed"), marked("")
    ('✓ passed', '✗ failed', '')
    """
    return f"{_MARKS[state]} {state}" if state in _MARKS else state


def plain_text(shown: View, width: int = 80) -> str:
    """Return `shown` as lines of at most `width` columns, broken between words."""
    lead = f"{marked(shown.state)}: " if shown.state and shown.headline else marked(shown.state)
    parts = [folded(lead + shown.headline, width)] if shown.headline or shown.state else []
    parts += [table_text(table, width) for table in shown.tables if table.rows]
    notes = "\n".join(folded(note, width) for note in shown.notes)
    return "\n\n".join([*parts, *([notes] if notes else [])])


def folded(text: str, width: int) -> str:
    """Every line of `text` broken between words, then indented by two columns more; paths stay whole."""
    return "\n".join(
        textwrap.fill(
            line,
            width,
            subsequent_indent=" " * (len(line) - len(line.lstrip()) + 2),
            break_long_words=False,
            break_on_hyphens=False,
        )
        for line in text.splitlines()
    )


def table_text(table: Table, width: int = 80) -> str:
    """A table of text: first column flush left, others right; heads and the last column wrap at words.

    >>> print(table_text(Table(("payload", "phase margin [°]"), (("20 g", "48.8"), ("8 g", "23.9"))), 16))
              phase
             margin
    payload     [°]
    20 g       48.8
    8 g        23.9
    """
    # What keeps a value and its error together on a page only shows as an escape in a terminal.
    plain = [tuple(cell.replace("\N{NO-BREAK SPACE}", " ") for cell in row) for row in table.rows]
    rows = [(*row[:-1], marked(row[-1])) if table.judged else row for row in plain]
    # A head folds into three lines at most, and never within a word.
    words = [max(-(-len(head) // 3), *map(len, head.split() or [""])) for head in table.header]
    widths = [max(word, *(len(row[k]) for row in rows)) for k, word in enumerate(words)]
    spare = width - sum(widths) - 2 * (len(widths) - 1)
    if spare < 0:
        # Sentences give way: the widest column folds, as far as a line of it can still be read.
        widest = max(range(len(widths)), key=widths.__getitem__)
        widths[widest] = max(24, widths[widest] + spare)
    # Heads need not fold where there is room: from left to right each takes what it needs.
    for k, head in enumerate(table.header):
        more = min(max(spare, 0), max(0, len(head) - widths[k])) if spare >= len(head) - widths[k] else 0
        widths[k], spare = widths[k] + more, spare - more
    last = len(widths) - 1
    left = [k == 0 or (k == last and table.judged) or _wordy(rows, k) for k in range(len(widths))]
    lines = _folded_row(table.header, widths, left, bottom=True)
    for row in rows:
        lines += _folded_row(row, widths, left, bottom=False)
    return "\n".join(lines)


def _wordy(rows: Sequence[Row], column: int) -> bool:
    return any(re.search(r"[^\W\d_]{4,} [^\W\d_]{2,}", row[column]) for row in rows)


def _folded_row(row: Row, widths: list[int], left: list[bool], *, bottom: bool) -> list[str]:
    cells = [
        textwrap.wrap(cell, size, break_long_words=False, break_on_hyphens=False) or [""]
        for cell, size in zip(row, widths, strict=True)
    ]
    height = max(map(len, cells))
    padded = [
        [""] * (height - len(cell)) + cell if bottom else cell + [""] * (height - len(cell)) for cell in cells
    ]
    return [
        "  ".join(
            part.ljust(size) if flush else part.rjust(size)
            for part, size, flush in zip(line, widths, left, strict=True)
        ).rstrip()
        for line in zip(*padded, strict=True)
    ]


# --- rows of the parts of a study -------------------------------------------------------------------------


def source_name(log: Experiment | None) -> str:
    """The log's name without the folders of one machine."""
    return PurePath(log.source.replace("\\", "/")).name if log is not None and log.source else "unnamed log"


def rig_table(rig: Rig) -> Table:
    """Quantity, symbol and value of everything the rig states."""
    motor, link, gauge, counts = rig.motor, rig.link, rig.gauge, rig.encoder.counts_per_revolution
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
        ("Gauge noise, offset", "", f"{number(gauge.noise)} N·m, {number(gauge.offset)} N·m"),
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
        ("Samples", f"{len(log.time)} in {number(duration)} s, one each {number(1e3 * log.period)} ms"),
        ("Output", _OUTPUTS[log.output_kind]),
        ("Payload", grams(log.payload) if log.payload is not None else "not stated"),
    ]
    rows += [("SHA-256 of the file", log.sha256)] if log.sha256 else []
    shown = {"title", "simulated", "source", "damping"}
    rows += [(name.capitalize(), value) for name, value in log.notes if name in shown]
    return Table(("log", "value"), tuple(rows))


def _parameter(fit: Fit, name: str) -> str:
    value = getattr(fit.model, name)
    if name == "natural_frequency" and value == 0:
        return "–"  # a D-FOM that ended at its bound: the line below the table says which UD-FOM it is
    if name not in structure(fit.structure).free:
        return "–" if value == 0 or (name == "damping_order" and fit.model.damping == 0) else number(value)
    # A line may end before the sign, never behind it.
    return uncertain(value, fit.standard_errors.get(name)).replace("± ", "±\N{NO-BREAK SPACE}")


_PARAMETERS = ("natural_frequency", "order", "damping", "damping_order")


def fits_table(fits: Mapping[str, Fit]) -> Table:
    """One row for each structure: parameters with standard errors, then the criteria."""
    header = (
        "structure",
        "ω₀ [s^(−λ/2)]",
        "λ",
        "μ [s^(α−λ)]",
        "α",
        "delay [ms]",
        "MSE",
        "AIC",
        "held-out NMSE",
    )
    rows = tuple(
        (
            name,
            *(_parameter(fit, parameter) for parameter in _PARAMETERS),
            milli(fit.delay, 2),
            number(fit.mse),
            f"{fit.aic:.1f}".replace("-", "−"),
            number(fit.heldout_nmse),
        )
        for name, fit in fits.items()
    )
    return Table(header, rows)


def fit_table(fit: Fit) -> Table:
    """Parameters of one fit, each with its standard error, then what says how good it is."""
    names = {
        "natural_frequency": "ω₀ [s^(−λ/2)]",
        "order": "λ",
        "damping": "μ [s^(α−λ)]",
        "damping_order": "α",
    }
    rows = [(names[name], _parameter(fit, name)) for name in structure(fit.structure).free]
    rows += [
        ("gauge delay [ms]", milli(fit.delay, 2)),
        ("gain", number(fit.gain)),
        ("offset", number(fit.offset)),
        ("mean squared error", number(fit.mse)),
        ("AIC", f"{fit.aic:.1f}".replace("-", "−")),
        (
            "held-out error (NMSE)",
            "nothing held out" if fit.heldout_nmse is None else number(fit.heldout_nmse),
        ),
    ]
    return Table((fit.structure, "value"), tuple(rows))


def controller_table(design: Design, law: Law | None = None) -> Table:
    """Symbol, meaning and value of the controller's parameters, and of its law."""
    c = design.controller
    filtered = f"{number(c.filter_time)} s, {c.filter_order}" if c.filter_time else "none"
    rows: list[Row] = [
        ("k_d", "gain", f"{number(c.gain, 5)} s^β"),
        ("β", "order of the derivative", number(c.order, 5)),
        ("δ, n" if c.filter_time else "δ", "filter", filtered),
        ("ω̄_c", "crossover at the lightest payload", f"{number(design.gain_crossover_upper, 5)} rad/s"),
    ]
    if law is not None:
        decibel, degree = law.correction_error
        order = len(law.correction.poles) + 2 * len(law.correction.pair_poles)
        rows.append(("", "states of the discrete law", str(order)))
        band = f"{number(law.band[0], 2)} to {number(law.band[1], 3)} rad/s"
        rows.append(("", f"its error from {band}", f"{number(decibel, 2)} dB, {number(degree, 2)}°"))
    return Table(("", "controller", "value"), tuple(rows))


def relation(item: Requirement) -> str:
    """Whether a requirement is a lower or an upper bound.

    >>> from fraclink._design import Requirement
    >>> relation(Requirement.at_most("noise gain", 2.0, 2.0, "", 0.02))
    '≤'
    """
    return "≤" if item.bound == "at most" else "≥"


def requirements_table(requirements: Iterable[Requirement]) -> Table:
    """Name, required value, achieved value, payload, slack, and whether it is met."""
    header = ("requirement", "required", "achieved", "worst at", "slack", "verdict")
    return Table(
        header,
        tuple(
            (
                item.name,
                f"{relation(item)} {quantity(item.wanted, item.unit)}",
                quantity(item.achieved, item.unit),
                grams(item.at_payload),
                # The equations are solved to rounding: 1e-16 of slack is none.
                quantity(
                    0.0 if abs(item.slack) < 1e-9 * max(1.0, abs(item.wanted)) else item.slack, item.unit
                ),
                "passed" if item.passed else "missed",
            )
            for item in requirements
        ),
        judged=True,
    )


def margins_table(design: Design, payloads: Iterable[float]) -> Table:
    """Margins at some payloads, of the continuous loop designed for and of the sampled one."""
    header = ("payload", "ω_c [rad/s]", "φ_m", "sampled ω_c [rad/s]", "sampled φ_m", "distance to −1")
    rows: list[Row] = []
    for payload in payloads:
        continuous, sampled = design.at(payload), design.sampled_at(payload)
        pairs = ((m.gain_crossover, m.phase_margin) for m in (continuous, sampled))
        cells = (cell for crossover, margin in pairs for cell in (number(crossover), degrees(margin)))
        rows.append((grams(payload), *cells, number(sampled.modulus_margin, 3)))
    return Table(header, tuple(rows))


def moves_table(runs: Sequence[Run]) -> Table:
    """Payload and metrics of each move, and its verdict."""
    header = (
        *(
            "payload",
            "overshoot [%]",
            "settles to 2 % [s]",
            "residual vibration [mrad]",
            "final error [mrad]",
        ),
        *("peak voltage [V]", "reference noise [mrad]", "verdict"),
    )
    rows = tuple(
        (
            grams(run.payload),
            f"{100 * run.metrics.overshoot:.1f}",
            f"{run.metrics.settling_time:.2f}" if math.isfinite(run.metrics.settling_time) else "never",
            milli(run.metrics.residual_vibration),
            milli(run.metrics.steady_state_error, 2),
            number(run.metrics.peak_voltage, 3),
            milli(run.metrics.motor_reference_noise),
            "passed" if run.verdict.passed else "failed",
        )
        for run in runs
    )
    return Table(header, rows, judged=True)


_FACTORS = {  # unit and factor of a campaign's metrics
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


def spread_table(summary: Summary) -> Table:
    """Quantiles of every metric over the arms of a campaign, and what drives it most."""
    shares = [f"{100 * q.probability:g} %" for q in summary.metrics[0].quantiles]
    rows = []
    for metric in summary.metrics:
        unit, factor = _FACTORS.get(metric.name, ("SI", 1.0))
        values = (
            number(factor * q.value, 3) if math.isfinite(q.value) else "never" for q in metric.quantiles
        )
        driver = ", ".join(f"{name.replace('_', ' ')} {r:+.2f}" for name, r in metric.drivers[:1])
        rows.append((f"{metric.name.replace('_', ' ')} [{unit}]", *values, driver.replace("-", "−")))
    return Table(("metric", *shares, "driven by"), tuple(rows))


def faults_table(table: FaultTable) -> Table:
    """One row for each fault, those that miss their requirement first."""
    rows = sorted(table.rows(), key=lambda row: row.passed)
    return Table(
        ("fault", "required", "runs", "failed", "worst run", "verdict"),
        tuple(
            (
                f"{row.number} {row.title}",
                row.required.replace("<=", "≤").replace(" x ", " × "),
                str(row.runs),
                str(row.failed or "–"),
                row.worst,
                "passed" if row.passed else "failed",
            )
            for row in rows
        ),
        judged=True,
    )


def faults_sentence(table: FaultTable) -> str:
    """How many faults meet their requirement in every run, as a sentence's part."""
    rows = table.rows()
    met = sum(row.passed for row in rows)
    return f"{met} of {len(rows)} faults meet their requirement in every run, {len(table.outcomes)} runs"


def verdict_table(verdict: Verdict) -> Table:
    """The three scopes, each with its first reason."""
    what = {
        "promise": "requirements and proof",
        "model": "simulated moves of the model",
        "reality": "arms that differ, on the twin",
    }
    rows = tuple(
        (name, what[name], "; ".join(scope.reasons) or "–", scope.state)
        for name, scope in verdict.scopes.items()
    )
    return Table(("scope", "what", "why", "verdict"), rows, judged=True)


def summary_rows(study: Study) -> list[Row]:
    """The handful of numbers that a reader looks for first."""
    rows: list[Row] = []
    if study.fit is not None:
        model, share = study.fit.model, study.fit.heldout_nmse
        held = "" if share is None else f", held-out error {100 * share:.2g} %"
        order, frequency = number(model.order, 5), number(model.natural_frequency, 5)
        rows.append(("Model", f"{study.fit.structure}: λ = {order}, ω₀ = {frequency}{held}"))
    if study.design is not None:
        c = study.design.controller
        filtered = f", δ = {number(1e3 * c.filter_time, 3)} ms" if c.filter_time else ""
        rows.append(("Controller", f"k_d = {number(c.gain, 4)}, β = {number(c.order, 4)}{filtered}"))
        ends = sorted(set(study.design.payloads))
        margins = (f"{degrees(study.design.sampled_at(m).phase_margin)} at {grams(m)}" for m in ends)
        rows.append(("Phase margin of the sampled loop", " and ".join(margins)))
    if study.certificate is not None:
        modulus = number(study.certificate.statement.modulus, 3)
        rows.append(("Proved for every payload and delay", f"|1 + L| > {modulus}"))
    if study.runs:
        settled = max(run.metrics.settling_time for run in study.runs)
        shown = f"within {settled:.2f} s" if math.isfinite(settled) else "not for every payload"
        rows.append(("The tip settles to 2 %", shown))
    if study.arms is not None:
        failure = study.arms.failure
        rows.append(("Arms that differ", f"{failure.runs - failure.count} of {failure.runs} passed"))
    if study.faults is not None:
        rows.append(("Faults on the twin", faults_sentence(study.faults)))
    return rows


# --- views ------------------------------------------------------------------------------------------------


def view(result: Any) -> View:
    """Return what people read of a result.

    >>> from fraclink.findings import Finding
    >>> print(view((Finding("W210", "warning", "the gauge has an offset", {}, "subtract it"),)))
    ! not shown: 1 warning
    <BLANKLINE>
    W210 warning: the gauge has an offset; subtract it
    """
    return _looked_up(_VIEWS, result)(result)


def to_json(result: Any) -> dict[str, Any]:
    """Return what programs read of a result: plain values in SI units and radians, null where not finite."""
    values: dict[str, Any] = _looked_up(_JSON, result)(result)
    return values


def _looked_up(by_class: Mapping[str, Callable[[Any], Any]], result: Any) -> Callable[[Any], Any]:
    return next(by_class[kind.__name__] for kind in type(result).__mro__ if kind.__name__ in by_class)


def _findings_view(findings: tuple[Finding, ...]) -> View:
    worst = [f.severity for f in findings]
    state = "failed" if "error" in worst else "not shown" if "warning" in worst else "passed"
    counts = [(worst.count(word), word) for word in ("error", "warning", "info") if word in worst]
    said = ", ".join(f"{n} {word}{'s' if n > 1 and word != 'info' else ''}" for n, word in counts)
    return View(said or "no findings", notes=tuple(map(str, findings)), state=state)


def _fit_view(fit: Fit) -> View:
    errors = [f for f in fit.findings if f.severity == "error"]
    share = (
        "nothing held out" if fit.heldout_nmse is None else f"held-out error {100 * fit.heldout_nmse:.2g} %"
    )
    notes = tuple(str(f) for f in fit.findings if f.severity != "info")
    return View(f"{fit.structure}, {share}", (fit_table(fit),), notes, "not shown" if errors else "passed")


def _comparison_view(comparison: Comparison) -> View:
    warned = (
        f"{name}: {finding}"
        for name, fit in comparison.fits.items()
        for finding in fit.findings
        if finding.severity != "info"
    )
    notes = (*coincidence(comparison.fits), *warned)
    return View(comparison.verdict, (fits_table(comparison.fits),), notes)


def coincidence(fits: Mapping[str, Fit]) -> list[str]:
    """What the dash of a table means: s²/(s² + μ s^α) is s^(2−α)/(s^(2−α) + μ), one model by two names."""
    damped = fits.get("D-FOM")
    if damped is None or damped.model.natural_frequency:
        return []
    order, frequency = 2.0 - damped.model.damping_order, math.sqrt(damped.model.damping)
    return [f"– D-FOM ended at ω₀ = 0: it is UD-FOM with λ = 2 − α = {order:.4f}, ω₀ = √μ = {frequency:.4f}."]


def _payloads_view(fit: Any) -> View:
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
    table = Table(("payload", "ω₀ [s^(−λ/2)]", "λ", "μ", "α", "MSE together", "MSE alone"), rows)
    return View(fit.verdict, (table,))


def _motor_view(fit: Any) -> View:
    errors = fit.standard_errors
    rows: tuple[Row, ...] = (
        ("K/J [rad/(V·s²)]", uncertain(fit.gain, errors["gain"])),
        ("ν/J [1/s]", uncertain(fit.decay, errors["decay"])),
        ("Coulomb friction [V]", uncertain(fit.coulomb_voltage, errors["coulomb_voltage"])),
        ("Coulomb torque [N·m]", number(fit.coulomb_torque)),
        ("dead zone [V]", number(fit.dead_zone)),
        ("delay [ms]", number(1e3 * fit.delay, 3)),
    )
    return View(tables=(Table(("motor", "value"), rows),))


def _spectrum_view(fit: Any) -> View:
    errors = fit.standard_errors
    rows = [("λ", uncertain(fit.order, errors.get("order")))]
    for name, values in (("resonance", fit.resonances), ("anti-resonance", fit.anti_resonances)):
        rows += [
            (f"{name} {i + 1} [rad/s]", uncertain(w, errors.get(f"{name} {i + 1}")))
            for i, w in enumerate(values)
        ]
    delay = uncertain(1e3 * fit.delay, 1e3 * errors["delay"] if "delay" in errors else None)
    rows += [("delay [ms]", delay), ("gain", number(fit.gain)), ("fit [%]", f"{fit.fit:.2f}")]
    aside = (f"{len(fit.outliers)} frequencies set aside as outliers",) if len(fit.outliers) else ()
    return View(tables=(Table(("frequency response", "value"), tuple(rows)),), notes=aside)


def _experiment_view(plan: Any) -> View:
    rows = [("kind", plan.kind), ("amplitude [rad]", number(plan.amplitude, 5))]
    rows += [] if plan.bit is None else [("bit [s]", number(plan.bit, 5))]
    rows += [
        ("band [rad/s]", f"{number(plan.band[0], 3)} to {number(plan.band[1], 3)}"),
        ("duration [s]", number(plan.duration, 5)),
        ("standard error of λ", number(plan.standard_error, 5)),
        ("peak deflection [rad]", number(plan.peak_deflection, 5)),
    ]
    rows += [] if plan.peak_voltage is None else [("peak voltage [V]", number(plan.peak_voltage, 5))]
    return View(tables=(Table(("experiment", "value"), tuple(rows)),))


def _design_view(design: Design) -> View:
    c = design.controller
    filtered = (
        f", filter δ = {number(c.filter_time)} s, n = {c.filter_order}" if c.filter_time else ", no filter"
    )
    headline = f"controller k_d = {number(c.gain, 5)}, β = {number(c.order, 5)}{filtered}"
    notes = tuple(map(str, design.findings))
    state = "passed" if design.passed else "failed"
    return View(headline, (requirements_table(design.requirements),), notes, state)


def _optimised_view(found: Any) -> View:
    figure = "worst noise gain" if found.goal == "noise" else "smallest crossover [rad/s]"
    rows = tuple(
        (
            s.structure,
            "none found in the bounds" if math.isnan(s.value) else number(s.value),
            "taken" * s.taken,
        )
        for s in found.steps
    )
    shown = _design_view(found.design)
    notes = shown.notes
    if not found.pays:
        notes = (f"no structure is better by {100 * found.least:g} %: the closed-form design is kept", *notes)
    return View(shown.headline, (Table(("structure", figure, ""), rows), *shown.tables), notes, shown.state)


def _run_view(run: Run) -> View:
    where = "" if run.verdict.passed else run.verdict.reason
    return View(
        where or "move settled", (moves_table([run]),), (), "passed" if run.verdict.passed else "failed"
    )


def _certificate_view(certificate: Any) -> View:
    text = certificate.verdict.removeprefix("Not certified: ")
    return View(text, state="passed" if certificate.passed else "failed")


def _summary_view(summary: Summary) -> View:
    trips = tuple(f"{count} runs: {MODES[mode]} ({REASONS[reason]})" for mode, reason, count in summary.trips)
    state = "failed" if summary.failure.count else "passed"
    return View(summary.failure.sentence, (spread_table(summary),), trips, state)


def _faults_view(table: FaultTable) -> View:
    rows = faults_table(table)
    short = Table(
        ("fault", "runs", "failed", "verdict"),
        tuple((r[0], r[2], r[3], r[5]) for r in rows.rows),
        judged=True,
    )
    return View(faults_sentence(table), (short,), (), "passed" if table.passed else "failed")


def _study_view(study: Study) -> View:
    verdict = study.verdict
    tables = [verdict_table(verdict)]
    notes = list(verdict.remarks)
    warned = (*study.findings, *(study.design.findings if study.design else ()))
    notes += [f"{finding.code}: {finding.message}" for finding in warned if finding.severity != "info"]
    if study.comparison:
        # The terminal has room for one number a structure; the report shows all.
        shown = fits_table(study.comparison.fits)
        picked = tuple(tuple(row[k] for k in (0, 1, 2, 5, 7, 8)) for row in shown.rows)
        tables.append(Table(tuple(shown.header[k] for k in (0, 1, 2, 5, 7, 8)), picked))
        notes += [*coincidence(study.comparison.fits), study.comparison.verdict]
    if study.design:
        tables.append(requirements_table(study.design.requirements))
    if study.runs:
        tables.append(moves_table(study.runs))
    return View(verdict_sentence(verdict), tuple(tables), tuple(notes), verdict.state)


def verdict_sentence(verdict: Verdict) -> str:
    """The three states in one line, as a headline carries them.

    >>> from fraclink._workflow import Scope, Verdict
    >>> verdict_sentence(Verdict(Scope("passed"), Scope("passed"), Scope("not run")))
    'promise passed, model passed, reality not run'
    """
    return ", ".join(f"{name} {scope.state}" for name, scope in verdict.scopes.items())


def _realtime_view(run: Any) -> View:
    spreads = (("latency of the wake-up", run.latencies), ("work of the period", run.works))
    rows = tuple((name, *(f"{1e6 * value:.1f}" for value in values)) for name, values in spreads)
    headline = (
        f"{len(run.tick)} periods of {1e3 * run.period:g} ms, {run.missed} missed, "
        f"{run.overruns} overruns, {run.lost_samples} lost samples"
    )
    notes = [f"scheduling {run.scheduling}, memory {run.memory}"]
    notes += ["the record replays through the law to the last bit"] if run.first_difference is None else []
    notes += [] if run.passed else [f"stopped: {run.problem}"]
    table = Table(("time [µs]", "least", "mean", "99.9 %", "most"), rows)
    return View(headline, (table,), tuple(notes), "passed" if run.passed else "failed")


def _served_view(served: Any) -> View:
    headline = (
        f"{len(served.voltage)} periods, {served.late} late; {served.controllers} controllers, "
        f"{served.silences} of them left without a stop; {served.rejected} messages rejected"
    )
    return View(headline, state="passed" if served.passed else "failed")


def _replay_view(result: Any) -> View:
    if result.passed:
        return View(f"{len(result.mode)} periods agree to the last bit", state="passed")
    where = f"first difference in period {result.first_difference}, largest {result.largest_difference:.3g}"
    return View(where, state="failed")


def _tournament_view(result: Any) -> View:
    return View("\n".join(result.verdicts()), state="passed" if result.standings[0].passed else "failed")


_VIEWS: dict[str, Callable[[Any], View]] = {
    "tuple": _findings_view,
    "Fit": _fit_view,
    "Comparison": _comparison_view,
    "JointFit": _payloads_view,
    "MotorFit": _motor_view,
    "SpectrumFit": _spectrum_view,
    "ExperimentDesign": _experiment_view,
    "Design": _design_view,
    "Optimised": _optimised_view,
    "Run": _run_view,
    "Certificate": _certificate_view,
    "Summary": _summary_view,
    "FaultTable": _faults_view,
    "Study": _study_view,
    "RealtimeRun": _realtime_view,
    "ServedArm": _served_view,
    "Replay": _replay_view,
    "Tournament": _tournament_view,
}


# --- JSON -------------------------------------------------------------------------------------------------


def _finding_json(finding: Finding) -> dict[str, Any]:
    evidence = {name: finite(value) for name, value in finding.evidence.items()}
    return {
        "code": finding.code,
        "severity": finding.severity,
        "message": finding.message,
        "evidence": evidence,
        "remedy": finding.remedy,
    }


def _findings_json(findings: tuple[Finding, ...]) -> dict[str, Any]:
    return {"findings": [_finding_json(finding) for finding in findings]}


def _fit_json(fit: Fit) -> dict[str, Any]:
    names = ("stiffness", *_PARAMETERS, "payload")
    numbers = ("gain", "offset", "delay", "mse", "nmse", "aic", "bic", "heldout_nmse")
    return {
        "structure": fit.structure,
        "model": {name: getattr(fit.model, name) for name in names},
        **{name: finite(getattr(fit, name)) for name in numbers},
        "standard_errors": {name: finite(value) for name, value in fit.standard_errors.items()},
        "findings": [_finding_json(finding) for finding in fit.findings],
    }


def _comparison_json(comparison: Comparison) -> dict[str, Any]:
    fits = {name: _fit_json(fit) for name, fit in comparison.fits.items()}
    return {"preferred": comparison.preferred, "verdict": comparison.verdict, "fits": fits}


def _payloads_json(fit: Any) -> dict[str, Any]:
    return {
        "structure": fit.structure,
        "common": list(fit.common),
        "natural_frequencies": [model.natural_frequency for model in fit.models],
        "orders": [model.order for model in fit.models],
        "dampings": [model.damping for model in fit.models],
        "damping_orders": [model.damping_order for model in fit.models],
        "mse": list(fit.mse),
        "standard_errors": fit.standard_errors,
        "stiffness": fit.stiffness,
        "p_value": fit.test.p_value,
        "verdict": fit.verdict,
    }


def _spectrum_json(fit: Any) -> dict[str, Any]:
    return {
        "order": fit.order,
        "resonances": list(fit.resonances),
        "anti_resonances": list(fit.anti_resonances),
        "gain": fit.gain,
        "delay": fit.delay,
        "fit_percent": fit.fit,
        "outliers": [int(k) for k in fit.outliers],
        "standard_errors": fit.standard_errors,
    }


def _experiment_json(plan: Any) -> dict[str, Any]:
    names = ("kind", "amplitude", "bit", "duration", "standard_error", "peak_deflection", "peak_voltage")
    return {name: getattr(plan, name) for name in names} | {"band": list(plan.band)}


def requirement_json(item: Requirement) -> dict[str, Any]:
    """A requirement for programs."""
    names = ("wanted", "achieved", "at_payload", "slack")
    numbers = {name: finite(getattr(item, name)) for name in names}
    return {"name": item.name, "unit": item.unit, "passed": item.passed} | numbers


def _design_json(design: Design) -> dict[str, Any]:
    names = ("gain", "order", "filter_time", "filter_order")
    return {
        "passed": design.passed,
        "margins": design.margins_kind,
        "controller": {name: getattr(design.controller, name) for name in names},
        "requirements": [requirement_json(item) for item in design.requirements],
        "findings": [_finding_json(finding) for finding in design.findings],
    }


def _optimised_json(found: Any) -> dict[str, Any]:
    tried = [{"structure": s.structure, "value": finite(s.value), "taken": s.taken} for s in found.steps]
    return _design_json(found.design) | {"pays": found.pays, "tried": tried}


def _run_json(run: Run) -> dict[str, Any]:
    names = (
        *("overshoot", "settling_time", "residual_vibration", "steady_state_error"),
        *("peak_voltage", "motor_reference_noise"),
    )
    metrics = {name: finite(getattr(run.metrics, name)) for name in names}
    verdict = {"passed": run.verdict.passed, "reason": run.verdict.reason}
    return {"payload": run.payload} | verdict | {"metrics": metrics}


def _certificate_json(certificate: Any) -> dict[str, Any]:
    names = ("passed", "verdict", "payload", "frequency")
    return {name: getattr(certificate, name) for name in names} | {
        "sha256": certificate.sha256 if certificate.passed else None
    }


def _summary_json(summary: Summary) -> dict[str, Any]:
    def limit(x: float) -> float | str:
        return x if math.isfinite(x) else str(x)

    failure = summary.failure
    return {
        "passed": not failure.count,
        "runs": failure.runs,
        "failures": failure.count,
        "probability": [failure.estimate, failure.low, failure.high],
        "trips": [{"mode": m, "reason": r, "runs": c} for m, r, c in summary.trips],
        "failed": list(summary.failed),
        "metrics": {
            m.name: {
                "quantiles": [
                    [q.probability, limit(q.value), limit(q.low), limit(q.high)] for q in m.quantiles
                ],
                "worst": [[n, limit(v)] for n, v in m.worst],
                "drivers": dict(m.drivers),
            }
            for m in summary.metrics
        },
    }


def _faults_json(table: FaultTable) -> dict[str, Any]:
    faults = {row.number: {"runs": row.runs, "failed": row.failed} for row in table.rows()}
    return {"passed": table.passed, "runs": len(table.outcomes), "faults": faults}


def _study_json(study: Study) -> dict[str, Any]:
    verdict = study.verdict
    fits = study.comparison.fits.values() if study.comparison else ()
    return {
        "passed": verdict.passed,
        "verdict": {"state": verdict.state, **asdict(verdict)},
        "reasons": list(verdict.reasons),
        "findings": [_finding_json(finding) for finding in study.findings],
        "fits": [_fit_json(fit) for fit in fits],
        "design": _design_json(study.design) if study.design else None,
        "runs": [_run_json(run) for run in study.runs],
        "arms": _summary_json(study.arms) if study.arms else None,
        "assumptions": list(study.assumptions),
    }


def _realtime_json(run: Any) -> dict[str, Any]:
    def spread(values: Any) -> dict[str, float] | None:
        return None if math.isnan(values.mean) else {name: float(v) for name, v in values._asdict().items()}

    names = ("passed", "problem", "stopped", "missed", "overruns", "lost_samples", "lost_commands")
    return {name: getattr(run, name) for name in (*names, "scheduling", "memory")} | {
        "periods": len(run.tick),
        "latency_s": spread(run.latencies),
        "work_s": spread(run.works),
        "last_mode": int(run.mode[-1]) if len(run.mode) else None,
        "replays": run.first_difference is None,
    }


def _served_json(served: Any) -> dict[str, Any]:
    names = ("passed", "late", "controllers", "silences", "rejected")
    return {name: getattr(served, name) for name in names} | {
        "periods": len(served.voltage),
        "last_tip_angle": float(served.tip_angle[-1]) if len(served.tip_angle) else None,
    }


def _replay_json(result: Any) -> dict[str, Any]:
    return {
        "passed": result.passed,
        "periods": len(result.mode),
        "first_difference": result.first_difference,
        "largest_difference": result.largest_difference,
        "last_mode": int(result.mode[-1]),
    }


_JSON: dict[str, Callable[[Any], dict[str, Any]]] = {
    "tuple": _findings_json,
    "Finding": _finding_json,
    "Fit": _fit_json,
    "Comparison": _comparison_json,
    "JointFit": _payloads_json,
    "MotorFit": asdict,
    "SpectrumFit": _spectrum_json,
    "ExperimentDesign": _experiment_json,
    "Design": _design_json,
    "Optimised": _optimised_json,
    "Run": _run_json,
    "Certificate": _certificate_json,
    "Summary": _summary_json,
    "FaultTable": _faults_json,
    "Study": _study_json,
    "RealtimeRun": _realtime_json,
    "ServedArm": _served_json,
    "Replay": _replay_json,
    "Tournament": lambda result: {"verdicts": list(result.verdicts()), "winners": result.winners()},
}
