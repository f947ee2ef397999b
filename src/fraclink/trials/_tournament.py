"""All rivals on the same arm, with the same sensors, noise, motor loop and reference,
and their results.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from fraclink._arm.beam import DEFAULT_MASS
from fraclink._arm.reference import SETTLE, Reference, smooth_step
from fraclink._display import Overview, Row, Table, displayed, rows_of, state_of
from fraclink._law.design import Design
from fraclink._simulate.arm import Twin
from fraclink._simulate.events import SensorFault
from fraclink._simulate.run import Run
from fraclink._simulate.simulate import simulate
from fraclink.errors import FieldError, InfeasibleError
from fraclink.trials._rivals import FRACLINK, Rival, builders
from fracsys.checks import Payload, checked, length

__all__ = ["Standing", "Tournament", "compare"]

# [N·m], [s]. Five times the noise of the paper's gauge: an apparent deflection of 32
# mrad, more than the 2 % band in which a move of 1 rad settles.
OFFSET, OFFSET_TIME = 0.05, 0.2


# Words and unit of every figure of the table; smaller is better for each.
FIGURES = {
    "settling_time": ("settling", "s"),
    "overshoot": ("overshoot", "%"),
    "residual_vibration": ("residual vibration", "mrad"),
    "worst_settling": ("worst settling", "s"),
    "offset_error": ("offset error", "mrad"),
    "motor_reference_noise": ("motor reference noise", "mrad"),
    "saturated": ("saturated", "%"),
}
# The difference below which two rivals are called equal, in SI units.
EQUAL = {"s": 0.01, "%": 1e-3, "mrad": 1e-4}


@dataclass(frozen=True)
class Standing:
    """What one rival reached; smaller is better, except for worst_payload.

    settling_time [s] (2 %), overshoot [1], residual_vibration [rad]: nominal payload.
    offset_error [rad]: tip error over the last second after the gauge's offset has
    jumped by 0.05 N·m. motor_reference_noise [rad]: standard deviation at rest.
    saturated: part of the periods with the voltage at its limit. worst_payload [kg]:
    the one with the longest settling, worst_settling [s], infinite where the tip does
    not stay in its band for the last second. peak: Ms on the model at the nominal
    payload. passed: neither unstable nor tripped at the nominal payload on the twin;
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
    peak: float

    @property
    def rows(self) -> tuple[Row, ...]:
        """Every figure of the table."""
        return rows_of(
            self,
            Row("name", "rival", self.name if self.passed else f"{self.name} (failed)"),
            *map(self.row, FIGURES),
            ("worst_payload", "at", "g"),
            ("peak", "Ms", "", 3),
        )

    def row(self, figure: str) -> Row:
        """One of the figures."""
        words, unit = FIGURES[figure]
        value = getattr(self, figure)
        # Values below a thousandth of the smallest difference are rounding.
        size = value if abs(value) > 1e-3 * EQUAL[unit] else 0.0
        return Row(figure, words, size, unit, digits=3, infinite="never")


@displayed
@dataclass(frozen=True, eq=False)
class Tournament:
    """Every rival's standing, fraclink first, with what was assumed."""

    standings: tuple[Standing, ...]
    notes: tuple[str, ...]

    def winners(self) -> dict[str, tuple[str, ...]]:
        """Return the best in each figure, among those that passed.

        All within 2 % plus 0.1 mrad, 10 ms or 0.1 % (depending on the unit) of the best
        value share a figure. Empty where none passes.
        """
        able = [standing for standing in self.standings if standing.passed]
        result: dict[str, tuple[str, ...]] = {}
        for name, (_, unit) in FIGURES.items() if able else ():
            values = {each.name: float(getattr(each, name)) for each in able}
            best = min(values.values())
            # If the best value is infinite, all share the figure.
            result[name] = tuple(
                rival
                for rival, value in values.items()
                if value <= 1.02 * best + EQUAL[unit]
            )
        return result

    def overview(self) -> Overview:
        """Who is best in each figure, and all figures."""
        first, winners = self.standings[0], self.winners()
        wins = sum(first.name in names for names in winners.values())
        best = (
            f"{FIGURES[name][0]}: best {', '.join(names)}"
            for name, names in winners.items()
        )
        rules = (f"{each.name}: {each.rule} ({each.knob})" for each in self.standings)
        return Overview(
            f"{first.name} is best in {wins} of {len(FIGURES)} figures",
            state_of(first.passed),
            (Row("winners", "", winners),),
            (Table.of("standings", self.standings),),
            notes=(*best, *rules, *self.notes),
        )


@checked
def compare(
    design: Design,
    *,
    payloads: Annotated[Sequence[Payload], length(1)] | None = None,
    reference: Reference | None = None,
    names: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Tournament:
    """Run a design and its rivals on one arm, each tuned by its rule.

    Parameters
    ----------
    design
        every rival is tuned for its rig, model and Ms; the twin's link has the rig's
        mass, or 7.35 g (a carbon rod of 3 mm) where that is 0
    payloads
        among which the worst is sought [kg], all > 0; default the ends of the design's
        range and the rig's nominal payload
    reference
        the move of the tip; default 1 rad in 1 s
    names
        run only the rivals whose names contain one of these words; the design always
        runs
    progress
        called with the name of each rival before it runs

    Raises
    ------
    FieldError
        a value is out of range, or no rival's name contains one of `names`.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023-geared")
    >>> design = fl.design(rig.model, rig, payloads=(0.020, 0.040), gain_crossover=12.0,
    ...                    phase_margin=fl.deg(50))
    >>> result = compare(design, payloads=(0.030,), names=["ZV shaping"])
    >>> [standing.name for standing in result.standings]
    ['fraclink', 'ZV shaping']
    """
    move = smooth_step(1.0, duration=1.0) if reference is None else reference
    rig = design.rig
    mass = rig.link.mass or DEFAULT_MASS
    # The rivals run on the twin but are tuned with the model: none of them uses the twin
    # before its run.
    twin = Twin.from_rig(rig, model=design.model, link_mass=mass)
    tried = payloads or (*design.payloads, rig.payloads.nominal)
    notes = [f"link of {1e3 * mass:g} g, {twin.damping.label}"]
    notes += [str(finding) for finding in twin.findings]
    standings = []
    makers = builders(design)
    for name in _chosen(tuple(makers), names):
        if progress is not None:
            progress(name)
        try:
            rival = makers[name]()
        except InfeasibleError as error:
            # a requirement that a variant of the design cannot meet does not stop the
            # tournament
            notes.append(f"{name} left out: {error}")
            continue
        standings.append(_standing(design, twin, name, rival, move, tried))
    return Tournament(tuple(standings), tuple(notes))


def _chosen(rivals: tuple[str, ...], names: Sequence[str] | None) -> list[str]:
    """Return fraclink and the rivals whose names contain one of `names`; FieldError for
    an entry that matches no name.
    """
    words = [name.lower() for name in names or ("",)]
    for word in words:
        if not any(word in name.lower() for name in rivals):
            raise FieldError(
                "names",
                word,
                "part of no rival's name",
                ", ".join(rivals),
                "give a part of one of these",
            )
    return [
        name
        for name in rivals
        if name == FRACLINK or any(word in name.lower() for word in words)
    ]


def _standing(
    design: Design,
    twin: Twin,
    name: str,
    rival: Rival,
    move: Reference,
    payloads: Sequence[float],
) -> Standing:
    followed = rival.shaped(move)
    # After the start: the law would take an offset present from the first sample as the
    # zero of the gauge.
    shift = SensorFault(OFFSET_TIME, followed.duration + SETTLE, "gauge offset", OFFSET)

    def run(payload: float, *events: SensorFault) -> Run:
        return simulate(
            rival.law,
            followed,
            arm=twin,
            payload=payload,
            events=events,
        )

    usual = design.rig.payloads.nominal
    nominal = run(usual)
    # A separate run: with the offset in it, the figures of the move would be those of a
    # disturbed one.
    shifted = run(usual, shift)
    settling = {payload: _settled(run(payload)) for payload in payloads}
    # If several never settle, the one farthest from the nominal payload is reported.
    worst = max(settling, key=lambda p: (settling[p], abs(p - usual)))
    figures = nominal.metrics
    last = shifted.error[-round(1.0 / design.rig.period) :]
    return Standing(
        name=name,
        rule=rival.rule,
        knob=rival.knob,
        # A tip that noise moves out of its band in the last second has not lost
        # stability.
        passed=not nominal.verdict.reason.startswith(("unstable", "tripped")),
        reason=nominal.verdict.reason,
        settling_time=_settled(nominal),
        overshoot=figures.overshoot,
        residual_vibration=figures.residual_vibration,
        offset_error=abs(float(np.mean(last))) if shifted.finished else math.inf,
        motor_reference_noise=figures.motor_reference_noise,
        saturated=figures.saturated,
        worst_payload=worst,
        worst_settling=settling[worst],
        peak=rival.peak,
    )


def _settled(run: Run) -> float:
    """Settling time, infinite unless the tip was in its band for at least the last
    second.
    """
    time = run.metrics.settling_time
    return time if run.verdict and time <= run.time[-1] - 1.0 else math.inf
