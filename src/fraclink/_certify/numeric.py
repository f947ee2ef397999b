"""The loop of the proof in plain floating point, for a search that precedes it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from fraclink._certify.statement import ALIASES, ALIASES_FROM, PARAMETERS, Statement
from fracsys.checks import Complex, Mask, Real

if TYPE_CHECKING:
    from fraclink._law import Law

__all__ = [
    "CornerLoops",
    "corner_loops",
    "loop_values",
    "motor_loop",
    "unstable_corner",
    "worst_distance",
]


def loop_values(
    statement: Statement,
    law: Law,
    frequency: ArrayLike,
    place: Mapping[str, ArrayLike],
    *,
    held: Mask | None = None,
    held_law: Complex | None = None,
) -> Complex:
    """Return L at `frequency` [rad/s], up to Nyquist; `place` contains the parameters
    of the statement.

    It includes the same aliases as the proof: `ALIASES`, from `ALIASES_FROM` of the
    Nyquist frequency on, or instead where `held` is set. "softness" is q = 1/ω₀²,
    "loss" η = μ/ω₀², "motor" p or A. All arguments are broadcast. `held_law`: the
    response of the law with its hold, if it has already been computed.
    """
    w, at = (
        np.asarray(frequency, float),
        {k: np.asarray(v, float) for k, v in place.items()},
    )
    turn = math.tau / law.period
    outer = _held_law(law, w) if held_law is None else held_law
    if statement.motor_loop == "sampled":
        outer = outer * motor_loop(statement, w, at["delay"], at["motor"])[0]
    # Sampling folds the spectrum: L at e^jωTs is a sum over all ω + 2πn/Ts, with the
    # periodic factors outside.
    spectrum = np.asarray(_continuous(statement, w, at))
    held = w >= 0.5 * ALIASES_FROM * turn if held is None else held
    fast = np.broadcast_to(held, spectrum.shape)
    w = np.broadcast_to(w, spectrum.shape)[fast]
    at = {k: np.broadcast_to(v, spectrum.shape)[fast] for k, v in at.items()}
    spectrum[fast] += sum(_continuous(statement, w + n * turn, at) for n in ALIASES)
    return outer * spectrum


def _held_law(law: Law, frequency: Real) -> Complex:
    """The response of a law with the factor of the hold that all aliases share."""
    return (
        law.frequency_response(frequency.ravel()).reshape(frequency.shape)
        * -np.expm1(-1j * frequency * law.period)
        / law.period
    )


def _continuous(
    statement: Statement, frequency: Real, at: Mapping[str, Real]
) -> Complex:
    """Motor, delay and tip angle as the law computes it, divided by s: the path of a
    held command.
    """
    s = 1j * frequency
    drag = at["loss"] * s**statement.damping_order if np.any(at["loss"]) else 0.0
    tip = (1.0 + drag) / (1.0 + at["softness"] * s ** at["order"] + drag)
    mode = 0.0 * s
    if np.any(at["mode_gain"]):
        ratio = s / at["mode_frequency"]
        mode = (
            at["mode_gain"]
            * ratio**2
            / (ratio**2 + 2 * statement.mode_damping * ratio + 1)
        )
    gauge = (
        float(statement.coefficients["compliance"])
        * statement.stiffness
        * at["gauge_gain"]
    )
    link = (
        (1.0 - gauge * np.exp(-s * at["gauge_delay"]) * (1.0 - tip + mode))
        * np.exp(-s * at["delay"])
        / s
    )
    if statement.motor_loop == "ideal":
        return link / (1.0 + s / at["motor"]) ** 2
    return link * at["motor"] / (s * (s + statement.decay))


def motor_loop(
    statement: Statement, frequency: Real, delay: ArrayLike, gain: ArrayLike
) -> tuple[Complex, Complex]:
    """Return (voltage, θm) over θm* of the sampled motor loop, ``Cm1/(1 + (Cm1 + Cm2)
    P_τ)`` and P_τ times that, with the held motor delayed by any fraction of a period.
    """
    c = statement.coefficients
    period, decay = float(c["period"]), statement.decay
    x = np.exp(-1j * frequency * period)
    slow = 1.0 / (1.0 - float(c["filter_decay"]) * x)

    def pair(name: str) -> Complex:
        return c[f"{name}_now"] + c[f"{name}_before"] * x

    first = c["inner_direct"] + pair("integral") / (1.0 - x) + slow * pair("filter")
    both = first + c["inner_angle"] + slow * pair("filter_angle")
    # The motor A/(s(s + B)) with a hold and the given delay, at the sampling instants:
    # one partial fraction each for the integrator and the pole; `rest` is what remains
    # of the period after the delayed edge.
    rest = (1 + statement.whole) * period - np.asarray(delay)
    response = (decay * rest - 1.0) + decay * period * x / (1.0 - x)
    response = response + np.exp(-decay * rest) * (1.0 - x) / (
        1.0 - np.exp(-decay * period) * x
    )
    motor = x ** (1 + statement.whole) * np.asarray(gain) / decay**2 * response
    voltage = first / (1.0 + both * motor)
    return voltage, voltage * motor


@dataclass(frozen=True)
class CornerLoops:
    """1 + L over frequencies [rad/s], a row for each corner of the box, its middle, and
    corners with a payload inside the range; `place` holds their parameters.
    """

    frequency: Real
    place: dict[str, Real]
    value: Complex

    def row(self, row: int, at: int) -> dict[str, float]:
        """The parameters of a row and a frequency of the grid, by name."""
        place = {name: float(column[row]) for name, column in self.place.items()}
        return place | {"frequency": float(self.frequency[at])}


def corner_loops(statement: Statement, law: Law) -> CornerLoops:
    """Return the loop of a statement at the corners of its box."""
    w, place = _grid(statement, law), _corners(statement)
    held_law = _held_law(law, w)
    # One row at a time: with many uncertain parameters all rows at once would take 200
    # MB and more time.
    rows = [
        loop_values(
            statement,
            law,
            w,
            {name: column[k] for name, column in place.items()},
            held_law=held_law,
        )
        for k in range(len(place["softness"]))
    ]
    return CornerLoops(w, place, 1.0 + np.array(rows))


def _grid(statement: Statement, law: Law) -> Real:
    """Frequencies up to the Nyquist frequency, dense near the modes of the payloads: if
    1 + L turned by more than π between two of them, a turn would be lost.
    """
    low, high = statement.box
    modes = [
        end["softness"] ** (-1.0 / order["order"])
        for end, order in ((high, high), (low, low))
    ]
    nyquist = np.pi / law.period
    # |1 + L| is smallest near the falling crossing, which lies between the mode and
    # four times its frequency.
    near = np.geomspace(0.5 * min(modes), min(4.0 * max(modes), nyquist), 1200)
    parts = [near, np.geomspace(0.05, nyquist, 600)]
    # the second mode is narrow and may lie anywhere in its interval
    if high["mode_gain"]:
        spread = np.linspace(-6, 6, 49) * statement.mode_damping
        ends = (low["mode_frequency"], high["mode_frequency"])
        parts += [np.minimum(f * np.exp(spread), nyquist) for f in ends]
    return np.unique(np.concatenate(parts))


def _corners(statement: Statement) -> dict[str, Real]:
    """Parameters of the corners of the box and of its middle, by name."""
    low, high = statement.box
    names = [name for name in PARAMETERS if low[name] < high[name]]
    # The payload has by far the widest interval: a loop may come closest to -1 inside
    # it, where no corner lies.
    levels = [(0.0, 0.4, 1.0) if name == "softness" else (0.0, 1.0) for name in names]
    ends = np.array([*itertools.product(*levels), [0.5] * len(names)])
    shares = dict.fromkeys(PARAMETERS, np.zeros(len(ends)))
    shares |= dict(zip(names, ends.T, strict=True))
    return {
        name: low[name] + (high[name] - low[name]) * shares[name] for name in shares
    }


def worst_distance(
    statement: Statement, law: Law, loops: CornerLoops
) -> tuple[float, dict[str, float]]:
    """Return (|1 + L|, place) at which a search, over corners and then by descent,
    finds the loop closest to -1.
    """
    distance = np.abs(loops.value)
    # The descent starts at the three closest corners, since the closest one on the grid
    # need not lead to the global minimum.
    starts = [
        loops.row(row, int(np.argmin(distance[row])))
        for row in np.argsort(np.min(distance, axis=1))[:3]
    ]
    found = [_downhill(statement, law, start) for start in starts]
    return min(found, key=lambda candidate: candidate[0])


def _downhill(
    statement: Statement, law: Law, start: dict[str, float]
) -> tuple[float, dict[str, float]]:
    """Minimise |1 + L| inside the box, with each axis scaled by its width."""
    low, high = statement.box
    low["frequency"] = 0.5 * start["frequency"]
    high["frequency"] = min(2.0 * start["frequency"], math.pi / law.period)
    names = [name for name in ("frequency", *PARAMETERS) if low[name] < high[name]]
    width = {name: high[name] - low[name] for name in names}

    def place(shares: Real) -> dict[str, float]:
        position = zip(names, shares, strict=True)
        return start | {
            name: float(low[name] + share * width[name]) for name, share in position
        }

    def distance(shares: Real) -> float:
        at = place(shares)
        return float(abs(1.0 + loop_values(statement, law, at["frequency"], at)))

    first = [(start[name] - low[name]) / width[name] for name in names]
    bounds, options = [(0.0, 1.0)] * len(names), {"ftol": 1e-12}
    minimum = minimize(
        distance, first, method="L-BFGS-B", bounds=bounds, options=options
    )
    return float(minimum.fun), place(minimum.x)


def unstable_corner(loops: CornerLoops) -> dict[str, float] | None:
    """Return an unstable corner with the ω of the crossing left of -1, or None.

    The final phase of 1 + L counts the encirclements of -1; L itself is open-loop
    stable.
    """
    value = loops.value
    # From 0 to the Nyquist frequency 1 + L runs from 1 to a real number: half the
    # encirclements of the whole unit circle.
    phase = np.unwrap(np.angle(value), axis=-1)
    rows = np.flatnonzero(np.round((phase[:, -1] - phase[:, 0]) / np.pi))
    if not rows.size:
        return None
    row = int(rows[np.argmax(loops.place["softness"][rows])])
    crossing = np.nonzero((value[row, :-1].imag > 0) != (value[row, 1:].imag > 0))[0]
    beyond = [i for i in crossing if value[row, i].real < 0.0]
    at = beyond[0] if beyond else int(np.argmin(np.abs(value[row])))
    return loops.row(row, int(at))
