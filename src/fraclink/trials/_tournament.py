"""All rivals on the same arm, with the same sensors, noise, motor loop and reference,
and what came out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated

import numpy as np

from fraclink._arm.link import LinkModel
from fraclink._arm.reference import Reference, checked_reference, smooth_step
from fraclink._arm.rig import Rig
from fraclink._display import displayed
from fraclink._files import write_json
from fraclink._simulate.arm import Twin
from fraclink._simulate.run import Run
from fraclink.errors import FieldError, InfeasibleError
from fraclink.trials._rival_runs import linear_growth, mode_gain, run_rival
from fraclink.trials._rivals import FRACLINK, OFFSET, Rival, builders
from fraclink.trials._setting import Setting, prepare
from fracsys.checks import (
    Between,
    Frequency,
    Length,
    Payload,
    PhaseMargin,
    Seed,
    Time,
    checked,
)

__all__ = ["Standing", "Tournament", "compare"]


def _chosen(known: tuple[str, ...], names: Sequence[str] | None) -> list[str]:
    """Return fraclink and the rivals whose names contain one of `names`; FieldError for
    one in no name.
    """
    if names is None:
        return list(known)
    words = [name.lower() for name in names]
    for word in words:
        if not any(word in name.lower() for name in known):
            allowed, remedy = ", ".join(known), "give a part of one of these"
            raise FieldError(
                "names", word, "part of no rival's name", allowed=allowed, remedy=remedy
            )
    return [
        name
        for name in known
        if name == FRACLINK or any(word in name.lower() for word in words)
    ]


PAYLOADS = (0.008, 0.012, 0.016, 0.020, 0.025, 0.030, 0.035, 0.040)
PHASE_MARGIN = math.radians(45.0)
AFTER = 5.0  # [s] of every run after the reference has come to rest


@dataclass(frozen=True)
class Standing:
    """What one rival reached; smaller is better for every number.

    settling_time [s] (2 %), overshoot [1], residual_vibration [rad]: nominal payload.
    offset_error [rad]: tip error over the last second after the gauge's offset has
    jumped by 0.05 N·m. motor_reference_noise [rad]: standard deviation at rest.
    saturated: part of the periods with the voltage at its limit. worst_payload [kg]:
    the one with the longest settling, worst_settling [s], infinite where the tip does
    not stay in its band for the last second. mode_gain: largest |L| around the twin's
    second mode. growth [1/s]: of the linear loop on the twin at the nominal payload, 0
    where that is stable. peak: Ms on the lumped model at the nominal payload, infinite
    where that is unstable. states and multiplications: of the outer controller, per
    tick. passed: neither unstable nor tripped at the nominal payload on the twin;
    reason: the verdict's words.
    """

    name: str
    rule: str
    knob: str
    passed: bool
    reason: str
    settling_time: float
    overshoot: float
    residual_vibration: float
    offset_error: float
    motor_reference_noise: float
    saturated: float
    worst_payload: float
    worst_settling: float
    mode_gain: float
    growth: float
    peak: float
    states: int
    multiplications: int

    @property
    def sound(self) -> bool:
        """Whether it passed, and not only because friction or a limit hides that its
        linear loop grows.
        """
        return self.passed and self.growth == 0.0


@displayed
@dataclass(frozen=True, eq=False)
class Tournament:
    """Every rival's standing, fraclink first, with what was assumed and the nominal
    runs for plots.
    """

    standings: tuple[Standing, ...]
    notes: tuple[str, ...]
    runs: dict[str, Run]

    def winners(self) -> dict[str, tuple[str, ...]]:
        """Return who is best in every figure, among the sound: those that passed with a
        stable linear loop.

        Several names stand together where they differ by less than 2 %, or 0.1 mrad, or
        10 ms. Empty where no rival is sound.
        """
        result: dict[str, tuple[str, ...]] = {}
        able = [s for s in self.standings if s.sound]
        if not able:
            return result
        for name, floor in _FIGURES.items():
            values = [float(getattr(s, name)) for s in able]
            best = min(values)
            # An infinite best is shared by all: inf · 1.02 + floor is inf, and nobody
            # has won.
            result[name] = tuple(
                s.name
                for s, v in zip(able, values, strict=True)
                if v <= best * 1.02 + floor or v == best
            )
        return result

    def verdicts(self) -> tuple[str, ...]:
        """Return a sentence for every figure: where fraclink is best, and where a rival
        is better.
        """
        winners, first = self.winners(), self.standings[0]
        if not winners:
            return (
                "no figure has a winner: no design passes with a stable linear loop",
            )
        if len(self.standings) == 1:
            return (f"{first.name} ran alone: nothing to compare with",)
        made = []
        for name, winner in winners.items():
            words = name.replace("_", " ")
            best = min(float(getattr(s, name)) for s in self.standings if s.sound)
            own = float(getattr(first, name))
            if first.name in winner:
                also = [w for w in winner if w != first.name]
                shared = f", with {', '.join(also)}" if also else ""
                made.append(
                    f"{words}: {first.name} is best ({_figure(name, own)}){shared}"
                )
            else:
                reached = f"{_figure(name, best)} against {_figure(name, own)}"
                made.append(
                    f"{words}: better than fraclink: {', '.join(winner)} ({reached})"
                )
        return tuple(made)

    def markdown(self) -> str:
        """Return the table, the rules and the verdicts as Markdown."""
        rows = [_HEAD, tuple("---" for _ in _HEAD), *(_row(s) for s in self.standings)]
        lines = ["| " + " | ".join(row) + " |" for row in rows]
        lines += _hidden(self)
        lines += [
            "",
            "Figure by figure:",
            "",
            *(f"- {sentence}" for sentence in self.verdicts()),
        ]
        lines += ["", "How each was tuned:", ""]
        lines += [f"- {s.name}: {s.rule} ({s.knob})" for s in self.standings]
        lines += ["", "Assumed:", "", *(f"- {note}" for note in self.notes)]
        return "\n".join(lines) + "\n"

    def draw(self, path: Path | str) -> None:
        """Draw a dot for every rival and figure to an SVG file; FieldError for a file
        of another kind.
        """
        # What draws lies floors above, as for the reprs of results.
        import_module("fraclink.view._fleets").draw_rivals(self, path)

    def save(self, path: Path | str) -> None:
        """Write the standings to a JSON file; infinite figures are the text "inf"."""
        rows = [
            {
                k: "inf" if isinstance(v, float) and math.isinf(v) else v
                for k, v in asdict(s).items()
            }
            for s in self.standings
        ]
        write_json(
            path,
            "comparison",
            1,
            {"standings": rows, "notes": self.notes, "verdicts": self.verdicts()},
        )


# Figure -> difference below which two rivals are called equal, in the figure's unit. On
# top of the 2 % of `winners`, since a figure near zero would be won by the last digit
# of its noise.
_FIGURES = {
    "settling_time": 0.01,
    "overshoot": 0.001,
    "residual_vibration": 1e-4,
    "offset_error": 1e-4,
    "motor_reference_noise": 1e-4,
    "saturated": 0.001,
    "worst_settling": 0.01,
    "mode_gain": 1e-3,
    "states": 0.0,
    "multiplications": 0.0,
}


@checked
def compare(
    rig: Rig,
    *,
    model: LinkModel | None = None,
    link_mass: Annotated[float, Between(0.0, 1e4, "kg")] | None = None,
    gain_crossover: Frequency = 12.0,
    phase_margin: PhaseMargin = PHASE_MARGIN,
    filter_time: Time | None = None,
    payloads: Annotated[Sequence[Payload], Length(1)] = PAYLOADS,
    reference: Reference | None = None,
    names: Sequence[str] | None = None,
    seed: Seed = 0,
    progress: Callable[[str], None] | None = None,
) -> Tournament:
    """Run fraclink's design and its rivals on one arm, each tuned by its rule.

    Parameters
    ----------
    rig
        with a light hub (W601) it gets a gear of 50:1, and a note says so
    model
        what the designers know; default the rig's
    link_mass
        of the twin's link [kg]; default the rig's, or 7.35 g (a carbon rod of 3 mm)
        where that is 0
    gain_crossover, phase_margin, filter_time
        of fraclink's design [rad/s], [rad], [s]; the filter's default is the 10 % rule
    payloads
        at which the worst is looked for [kg], all > 0
    reference
        the move of the tip; default 1 rad in 1 s
    names
        run only the rivals whose names contain one of these words; fraclink's design
        always runs
    seed
        of the gauge's noise, the same for all

    Raises
    ------
    FieldError
        the rig has no model, a value is out of range, or no rival's name contains one
        of `names`.

    >>> import fraclink as fl
    >>> result = compare(fl.Rig.named("paper-2023"), payloads=(0.030,), names=["ZV shaping"])
    >>> [s.name for s in result.standings]
    ['fraclink', 'ZV shaping']
    """
    move = (
        smooth_step(1.0, duration=1.0)
        if reference is None
        else checked_reference(reference)
    )
    # The arm is judged by the twin, the rivals are tuned by the model: nobody sees the
    # twin before its run.
    setting, twin, notes = prepare(
        rig,
        model,
        link_mass,
        gain_crossover=gain_crossover,
        phase_margin=phase_margin,
        filter_time=filter_time,
    )
    made = builders(setting)
    chosen = _chosen(tuple(made), names)
    standings, runs = [], {}
    for name in chosen:
        if progress is not None:
            progress(name)
        try:
            rival = made[name]()
        except InfeasibleError as error:
            # a requirement that a variant of the design cannot meet is no fault of the
            # table
            notes.append(f"{name} left out: {error}")
            continue
        standing, runs[name] = _standing(
            setting, twin, rival, move, tuple(payloads), seed
        )
        standings.append(standing)
    return Tournament(tuple(standings), tuple(notes), runs)


def _standing(
    setting: Setting,
    twin: Twin,
    rival: Rival,
    move: Reference,
    payloads: tuple[float, ...],
    seed: int,
) -> tuple[Standing, Run]:
    duration = move.duration + AFTER

    def run(payload: float, offset: float = 0.0) -> Run:
        return run_rival(
            twin.with_payload(payload),
            rival,
            move,
            setting.law,
            duration=duration,
            offset=offset,
            seed=seed,
        )

    nominal = run(setting.rig.payloads.nominal)
    # A run of its own: in one with the offset the figures of the move would be those of
    # a disturbed one.
    shifted = run(setting.rig.payloads.nominal, OFFSET)
    by_payload = {p: run(p) for p in payloads}
    settling = {p: _settled(r) for p, r in by_payload.items()}
    # Of several that never settle the farthest from the nominal payload is named.
    worst = max(
        settling, key=lambda p: (settling[p], abs(p - setting.rig.payloads.nominal))
    )
    m = nominal.metrics
    last = shifted.error[-round(1.0 / setting.rig.period) :]
    standing = Standing(
        name=rival.name,
        rule=rival.rule,
        knob=rival.knob,
        # A tip that noise carries over the edge of its band in the last second is no
        # loss of stability.
        passed=not nominal.verdict.reason.startswith(("unstable", "tripped")),
        reason=nominal.verdict.reason,
        settling_time=_settled(nominal),
        overshoot=m.overshoot,
        residual_vibration=m.residual_vibration,
        offset_error=abs(float(np.mean(last))) if shifted.finished else math.inf,
        motor_reference_noise=m.motor_reference_noise,
        saturated=m.saturated,
        worst_payload=worst,
        worst_settling=settling[worst],
        mode_gain=mode_gain(setting, twin, rival),
        growth=linear_growth(setting, twin, rival),
        peak=rival.peak,
        states=rival.states,
        multiplications=rival.multiplications,
    )
    return standing, nominal


def _settled(run: Run) -> float:
    """Settling time, infinite where the tip has not been in its band for at least a
    second.
    """
    time = run.metrics.settling_time
    return time if run.verdict and time <= run.time[-1] - 1.0 else math.inf


# ── in words
# ────────────────────────────────────────────────────────────────────────────────────────────────


_HEAD = (
    "rival",
    "settling [s]",
    "overshoot [%]",
    "residual [mrad]",
    "offset error [mrad]",
    "noise [mrad]",
    "saturated [%]",
    "worst payload",
    "gain at mode 2",
    "linear loop",
    "Ms",
    "states",
    "products",
)


def _number(value: float, digits: int = 3) -> str:
    return "never" if math.isinf(value) else f"{value:.{digits}g}"


def _row(s: Standing) -> tuple[str, ...]:
    settled = "never" if math.isinf(s.worst_settling) else f"{s.worst_settling:.2f} s"
    return (
        s.name if s.passed else f"{s.name} (failed)",
        "never" if math.isinf(s.settling_time) else f"{s.settling_time:.2f}",
        f"{100 * s.overshoot:.1f}",
        f"{1e3 * s.residual_vibration:.1f}",
        _number(1e3 * s.offset_error),
        f"{1e3 * s.motor_reference_noise:.1f}",
        f"{100 * s.saturated:.1f}",
        f"{1e3 * s.worst_payload:g} g: {settled}",
        f"{s.mode_gain:.3f}",
        "stable" if s.growth == 0.0 else f"grows {s.growth:.2g}/s",
        "unstable" if math.isinf(s.peak) else f"{s.peak:.2f}",
        str(s.states),
        str(s.multiplications),
    )


def _hidden(result: Tournament) -> list[str]:
    """Explain a rival that passes although its linear loop is unstable."""
    lines = []
    for s in result.standings:
        if s.growth == 0.0 or not s.passed:
            continue
        bounded = (
            f"the voltage limit, reached in {100 * s.saturated:.2g} % of the periods, bounds it"
            if s.saturated > 0.0
            else "friction holds the oscillation while it is small"
        )
        lines.append(
            f"- {s.name}: the linear loop on the twin is unstable, e-fold in {1.0 / s.growth:.2g} s; in "
            f"these runs {bounded}. It is not a design to ship, and wins no figure."
        )
    return (
        ["", "Unstable linear loop, although the runs passed:", "", *lines]
        if lines
        else []
    )


def _figure(name: str, value: float) -> str:
    if math.isinf(value):
        return "never"
    if name in ("residual_vibration", "offset_error", "motor_reference_noise"):
        return f"{1e3 * value if value > 1e-9 else 0.0:.3g} mrad"
    if name in ("settling_time", "worst_settling"):
        return f"{value:.3g} s"
    return (
        f"{100 * value:.2g} %" if name in ("overshoot", "saturated") else f"{value:.3g}"
    )
