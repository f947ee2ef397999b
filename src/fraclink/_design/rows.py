"""The table of requirements of a design, both the user's and the built-in ones.

Each row has a key (its name in `Specification`, if a user may state it), words, a unit
and a sense, the value that a request requires, and the figure of the loops that it
judges. Solver, `Design.requirements`, command line, studio, tune, report and
certificate show this table; a new requirement is one row here, and its words in
`Specification`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

import numpy as np

from fraclink._design.table import Figure, Trial
from fraclink._law.design import Specification
from fraclink._law.modes import MODE_POINTS
from fraclink._law.requirement import Requirement
from fracsys.checks import Real
from fracsys.checks.rules import rule

if TYPE_CHECKING:
    from fraclink._design.request import Request

__all__ = ["NOISE_SHARE", "RESERVE", "ROWS", "SENSITIVITY", "Row", "specification"]


# Ms of 2 is the customary upper end for a robust loop (1.4 to 2); it implies a gain
# margin of 2 and a phase margin of 29°. Used if no margin is requested.
SENSITIVITY = 2.0
# A vibration that takes more than ten periods to decay to 2 % counts as ringing: ζ = ln
# 50/(2π·10) for small ζ. The limit is the same for a link with less damping of its own:
# with a resonance peak of 1/(2ζ), any gain crosses near it with a large margin, and such
# a loop would meet every other row without damping anything.
_DAMPING = math.log(50.0) / math.hypot(10.0 * math.tau, math.log(50.0))
# Three standard deviations of the noise leave half of the voltage for the motion.
NOISE_SHARE = 0.5 / 3.0
# Relative reserve that a search adds to each row, so that a payload between those of
# the table does not miss it.
RESERVE = 2e-4
_STABLE = math.radians(2.0)  # phase margin where only stability is required


@dataclass(frozen=True)
class Row:
    """One requirement of the table.

    ``figure`` is the logarithm of the judged value unless ``signed``. ``empty`` says
    whether it applies to the empty gripper instead of the payloads. ``bound`` replaces
    the figure in a search: values that must not be negative. ``absent`` counts as
    achieved where a loop has no such figure, for example no crossing. A row that is
    ``implied`` by another one is left out of a search.
    """

    key: str
    words: str
    unit: str
    sense: Literal["at least", "at most"]
    wanted: Callable[[Request], float | None]
    figure: Callable[[Request], Figure]
    signed: bool = False
    empty: bool = False
    bound: Callable[[float], tuple[Figure, ...]] | None = None
    absent: float = math.inf
    reserve: float = RESERVE
    implied: bool = False

    def kept(
        self, request: Request, wanted: float, reserve: float = 0.0
    ) -> tuple[Figure, ...]:
        """Return the slack of the row beyond a reserve, negative where the row is
        missed. The slack is relative, so that one number can relax all rows alike.
        """
        reserve += self.reserve
        if self.bound is not None:
            return tuple(one.scaled(1.0, -reserve) for one in self.bound(wanted))
        sign = 1.0 if self.sense == "at least" else -1.0
        factor = sign / (wanted or 1.0) if self.signed else sign
        zero = wanted if self.signed else math.log(wanted)
        return (self.figure(request).scaled(factor, -factor * zero - reserve),)

    def measured(
        self, trial: Trial, request: Request, wanted: float, payloads: Real
    ) -> list[Requirement]:
        """Return the worst value over the links of a trial, with the payload [kg] of the
        worst link; one for each mode in the row of the modes.
        """
        table, figure = trial.table, self.figure(request)
        value, judged = trial.value(figure), table.empty == self.empty
        value = value if self.signed else np.exp(value)
        value = np.where(np.isnan(value), self.absent, value)
        number = (
            table.modes_number[:, ::MODE_POINTS].T
            if figure.name == "modes"
            else np.zeros(value.shape, int)
        )
        best, worst = (
            (math.inf, np.argmin)
            if self.sense == "at least"
            else (-math.inf, np.argmax)
        )
        achieved = {}
        for mode in np.unique(number[:, judged]):
            one = np.where(judged & (number == mode), value, best)
            k = np.unravel_index(worst(one), one.shape)
            achieved[int(mode)] = float(one[k]), payloads[k[1]]
        assumed = self.empty and request.rig.payloads.empty is None
        note = " (assumed)" if assumed else ""
        return [
            Requirement(
                f"{self.words} {mode}" if mode else self.words + note,
                wanted,
                value,
                self.unit,
                float(payload),
                self.sense,
            )
            for mode, (value, payload) in achieved.items()
        ]


def _own(key: str) -> Callable[[Request], float | None]:
    """The value requested by the user, if any."""
    return lambda request: request.spec.get(key)


def _crossed_beyond(frequency: float) -> tuple[Figure, Figure]:
    """ln of the ratio of the crossover (of the resonance if there is none) to a frequency
    [rad/s]; and ln|L| at the resonance, which must be positive for a crossover.
    """
    return Figure("reach", offset=-math.log(frequency)), Figure("level")


def _noise_share(request: Request) -> Figure:
    rig = request.rig
    size = rig.gauge.noise / request.model.stiffness / rig.motor.voltage_limit
    return Figure("voltage", offset=math.log(size))


def _gain_margin(request: Request) -> float:
    """The gain margin implied by Ms."""
    return request.max_sensitivity / (request.max_sensitivity - 1.0)


ROWS = (
    Row(
        "gain_crossover",
        "gain crossover",
        "rad/s",
        "at least",
        lambda request: request.gain_crossover,
        lambda request: Figure("crossover"),
        bound=_crossed_beyond,
        absent=0.0,
    ),
    Row(
        "highest_crossover",
        "last gain crossing",
        "rad/s",
        "at most",
        lambda request: request.arms.highest,
        lambda request: Figure("last crossing"),
        # no crossing beyond the limit of the table, which is the wanted value
        bound=lambda wanted: (Figure("quiet"),),
        absent=0.0,
    ),
    Row(
        "settling_time",
        "settling time",
        "s",
        "at most",
        _own("settling_time"),
        lambda request: Figure("crossover", -1.0, math.log(math.tau)),
        bound=lambda wanted: _crossed_beyond(math.tau / wanted),
    ),
    Row(
        "phase_margin",
        "phase margin",
        "rad",
        "at least",
        lambda request: request.phase_margin,
        lambda request: Figure("margin"),
        signed=True,
        absent=math.pi,
    ),
    Row(
        "max_sensitivity",
        "sensitivity peak",
        "",
        "at most",
        lambda request: request.max_sensitivity,
        lambda request: Figure("distance", -1.0),
        absent=1.0,
    ),
    Row(
        "gain_margin",
        "gain margin",
        "",
        "at least",
        _gain_margin,
        lambda request: Figure("gain margin"),
        implied=True,
    ),
    # A single sample delayed by a period must not make the loop unstable.
    Row(
        "delay_margin",
        "delay margin",
        "s",
        "at least",
        lambda request: request.rig.period,
        lambda request: Figure("delay"),
        signed=True,
    ),
    Row(
        "mode_gain",
        "loop gain at mode",
        "",
        "at most",
        lambda request: request.mode_gain,
        lambda request: Figure("modes"),
    ),
    Row(
        "noise_gain",
        "noise gain",
        "",
        "at most",
        _own("noise_gain"),
        lambda request: Figure("noise"),
    ),
    Row(
        "noise_voltage",
        "noise, share of the voltage",
        "",
        "at most",
        lambda request: NOISE_SHARE if request.rig.gauge.noise > 0.0 else None,
        _noise_share,
    ),
    Row(
        "damping",
        "damping ratio of the vibration",
        "",
        "at least",
        lambda request: _DAMPING,
        lambda request: Figure("damping"),
        signed=True,
        absent=1.0,
        reserve=20.0 * RESERVE,
    ),
    Row(
        "empty",
        "phase margin, empty gripper",
        "rad",
        "at least",
        lambda request: 0.0,
        lambda request: Figure("margin"),
        signed=True,
        empty=True,
        absent=math.pi,
        reserve=_STABLE,
    ),
)

_HINTS: Mapping[str, Any] = get_type_hints(Specification, include_extras=True)


def specification(wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Return the request with every value checked for its range; a value of None is
    dropped, and its default applies.

    Raises TypeError for an unknown name, FieldError for a value out of its range.
    """
    unknown = sorted(set(wanted) - set(_HINTS))
    if unknown:
        raise TypeError(f"design() got an unexpected keyword argument {unknown[0]!r}")
    return {
        name: rule(_HINTS[name]).check(name, value)
        for name, value in wanted.items()
        if value is not None
    }
