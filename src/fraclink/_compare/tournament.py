"""All rivals on the same twin, and what came out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fraclink._arm.reference import Reference, checked_reference, smooth_step
from fraclink._compare.asked import checked_masses, checked_words, chosen_rivals
from fraclink._compare.rivals import OFFSET, Rival, builders
from fraclink._compare.run import run_rival
from fraclink._compare.setting import Request, Setting, prepare
from fraclink._compare.spillover import linear_growth, mode_gain
from fraclink._simulate.arm import Twin
from fraclink._simulate.run import Run
from fraclink._validate import checked_whole
from fraclink.errors import InfeasibleError

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._arm.rig import Rig

__all__ = ["Standing", "Tournament", "compare"]

PAYLOADS = (0.008, 0.012, 0.016, 0.020, 0.025, 0.030, 0.035, 0.040)
AFTER = 5.0  # [s] of every run after the reference has come to rest


@dataclass(frozen=True)
class Standing:
    """What one rival reached; smaller is better for every number.

    settling_time [s] (2 %), overshoot [1], residual_vibration [rad]: nominal payload. offset_error [rad]:
    tip error over the last second after the gauge's offset has jumped by 0.05 N·m. motor_reference_noise
    [rad]: standard deviation at rest. saturated: part of the periods with the voltage at its limit.
    worst_payload [kg]: the one with the longest settling, worst_settling [s], infinite where the tip does
    not stay in its band for the last second. mode_gain: largest |L| around the twin's second mode. growth
    [1/s]: of the linear loop on the twin at the nominal payload, 0 where that is stable. peak: Ms on the
    lumped model at the nominal payload, infinite where that is unstable. states and multiplications: of
    the outer controller, per tick. holds: neither unstable nor tripped at the nominal payload on the
    twin; reason: the verdict's words.
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
        """Whether it holds, and not only because friction or a limit hides that its linear loop grows."""
        return self.passed and self.growth == 0.0


@dataclass(frozen=True, eq=False)
class Tournament:
    """Every rival's standing, ours first, with what was assumed and the nominal runs for plots."""

    standings: tuple[Standing, ...]
    notes: tuple[str, ...]
    runs: dict[str, Run]

    def winners(self) -> dict[str, tuple[str, ...]]:
        """Return who is best in every figure, among the sound: those that hold and whose linear loop does.

        Several names stand together where they differ by less than 2 %, or 0.1 mrad, or 10 ms. Empty where
        nobody is sound.
        """
        result: dict[str, tuple[str, ...]] = {}
        able = [s for s in self.standings if s.sound]
        if not able:
            return result
        for name, floor in _FIGURES.items():
            values = [float(getattr(s, name)) for s in able]
            best = min(values)
            result[name] = tuple(
                s.name for s, v in zip(able, values, strict=True) if v <= best * 1.02 + floor or v == best
            )
        return result

    def verdicts(self) -> tuple[str, ...]:
        """Return a sentence for every figure: where ours is best, and where a rival is better."""
        from fraclink._compare.text import sentences

        return sentences(self)

    def markdown(self) -> str:
        """Return the table, the rules and the verdicts as Markdown."""
        from fraclink._compare.text import markdown

        return markdown(self)

    def draw(self, path: Path | str) -> None:
        """Draw the figures as bars to a file (SVG, PDF or PNG by its ending)."""
        from fraclink._compare.figure import draw

        draw(self, path)

    def save(self, path: Path | str) -> None:
        """Write the standings to a JSON file; infinite figures are the text "inf"."""
        from fraclink._files import write_json

        rows = [
            {k: "inf" if isinstance(v, float) and math.isinf(v) else v for k, v in asdict(s).items()}
            for s in self.standings
        ]
        write_json(
            path, "comparison", 1, {"standings": rows, "notes": self.notes, "verdicts": self.verdicts()}
        )


# Figure -> difference below which two rivals are called equal, in the figure's unit.
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


def compare(
    rig: Rig,
    *,
    model: LinkModel | None = None,
    link_mass: float | None = None,
    gain_crossover: float = 12.0,
    phase_margin: float = math.radians(50.0),
    filter_time: float | None = None,
    payloads: Sequence[float] = PAYLOADS,
    reference: Reference | None = None,
    names: Sequence[str] | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Tournament:
    """Run our design and its rivals on one twin, each tuned by its rule.

    Parameters
    ----------
    rig
        with a light hub (W601) it gets a gear of 50:1, and a note says so
    model
        what the designers know; default the rig's
    link_mass
        of the twin's link [kg]; default the rig's, or 7.35 g (a carbon rod of 3 mm) where that is 0
    gain_crossover, phase_margin, filter_time
        of our design [rad/s], [rad], [s]; the filter's default is the 10 % rule
    payloads
        at which the worst is looked for [kg], all > 0
    reference
        the move of the tip; default 1 rad in 1 s
    names
        run only the rivals whose names contain one of these words; ours always runs
    seed
        of the gauge's noise, the same for all

    Raises
    ------
    FieldError
        the rig has no model, a value is out of range, or no rival's name contains one of `names`.

    >>> import fraclink as fl
    >>> result = compare(fl.Rig.named("paper-2023"), payloads=(0.030,), names=["ZV shaping"])
    >>> [s.name for s in result.standings]
    ['ours', 'ZV shaping']
    """
    request: Request = {
        "gain_crossover": gain_crossover,
        "phase_margin": phase_margin,
        "filter_time": filter_time,
    }
    masses, words = checked_masses(payloads), checked_words(names)
    checked_whole("seed", seed, 0, 2**64 - 1)
    move = smooth_step(1.0, duration=1.0) if reference is None else checked_reference(reference)
    setting, twin, notes = prepare(rig, model, link_mass, request)
    made = builders(setting)
    chosen = chosen_rivals(tuple(made), words)
    standings, runs = [], {}
    for name in chosen:
        if progress is not None:
            progress(name)
        try:
            rival = made[name]()
        except InfeasibleError as error:
            # a request that our own variant cannot meet is no fault of the table
            notes.append(f"{name} left out: {error}")
            continue
        standing, runs[name] = _standing(setting, twin, rival, move, masses, seed)
        standings.append(standing)
    return Tournament(tuple(standings), tuple(notes), runs)


def _standing(
    setting: Setting, twin: Twin, rival: Rival, move: Reference, payloads: tuple[float, ...], seed: int
) -> tuple[Standing, Run]:
    duration = move.duration + AFTER

    def run(payload: float, offset: float = 0.0) -> Run:
        return run_rival(
            twin.with_payload(payload), rival, move, setting.ours, duration=duration, offset=offset, seed=seed
        )

    nominal = run(setting.rig.payloads.nominal)
    shifted = run(setting.rig.payloads.nominal, OFFSET)
    by_payload = {p: run(p) for p in payloads}
    settling = {p: _settled(r) for p, r in by_payload.items()}
    worst = max(settling, key=lambda p: (settling[p], abs(p - setting.rig.payloads.nominal)))
    m = nominal.metrics
    last = shifted.error[-round(1.0 / setting.rig.period) :]
    standing = Standing(
        name=rival.name,
        rule=rival.rule,
        knob=rival.knob,
        # A tip that noise carries over the edge of its band in the last second is no loss of stability.
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
    """Settling time, infinite where the tip has not been in its band for at least a second."""
    time = run.metrics.settling_time
    return time if run.verdict and time <= run.time[-1] - 1.0 else math.inf
