"""Enclosures of the sampled loop and of its slopes over boxes of frequencies and
parameters.

L = F H. F is the part in front of the link: with x = 1/z = e^{-jωTs}, ``K = d + Σ g/(z
− p)`` (so that Ĉ = (1 − x) K) and h = ωTs/2, for the ideal and for the sampled motor
loop,

    F = 2j K (sin h)(sin h/h) e^{-jω(τ+Ts)} (1 + jω/p)^-2
    F = 2j Ts K C (sin h)(sin h/h)² e^{-jω(τ+3Ts/2)} / ((jω + B)(y²/A + Z)), y = 1 − x

with C = y Cm1 and Z = y² (Cm1 + Cm2) P_τ/A, P_τ the held motor, late by τ: 1/F is
affine in 1/A. H is the tip angle as the law computes it, θm − κΓ, over θm: ``H = 1 − E
(S/(1 + S) + R)``, with the link's ``S = q s^λ/(1 + η s^α)``, the reading of the
torque ``E = κ c g e^{-jωτ_g}``, and the second mode R. η = μ/ω₀² is of the link's
material, the same for every payload; q is not.

Where |L| is small, L is enclosed, by means of V = 1/S, which is affine in 1/q; where it
is large, 1/L is enclosed, which is nearly affine in q. L alone takes seven times as many
boxes, 1/L alone more than a hundred times as many.

An alias is L at ω + 2πn/Ts in place of ω, except in the periodic factors. Near the
Nyquist frequency the nearest few, `ALIASES`, are enclosed in the same way as L; for the
others, and for all of them at lower frequencies, only the moduli are bounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fraclink._certify.discs import ROUNDING, Disc, Span
from fraclink._certify.statement import (
    ALIASES,
    ALIASES_FROM,
    PARAMETERS,
    Statement,
)
from fraclink._law import block as layout
from fraclink._law.block import inside_circle, modes_of
from fracsys.checks import Mask, Real

# The axes of a box, and the letters by which the tree cuts them. The second mode is given
# by its detuning f/ω: R depends on nothing else, and all the rest of the loop varies
# slowly over the width of the mode.
AXES: tuple[str, ...] = (
    "frequency",
    *("detuning" if name == "mode_frequency" else name for name in PARAMETERS),
)
LETTERS = "wmtgdoupfa"
LEAVES = ".,"  # proved by L, proved by 1/L
Shifts = tuple[int, ...]
_MAIN: Shifts = (0,)


@dataclass(frozen=True)
class FrequencyWindow:
    """Functions of the frequency alone: F of each shift without delay and motor, the
    common factor of the aliases, x, and y (Cm1 + Cm2).
    """

    fronts: tuple[Disc, ...]
    alias: Real
    back: Disc
    both: Disc


class BoxLoop:
    """The loop of a statement: a box is a row of lower and a row of upper ends, one per
    parameter of `AXES`.
    """

    def __init__(self, statement: Statement) -> None:
        self.statement = s = statement
        c, self.motor_loop = s.coefficients, s.motor_loop
        self.period, self.direct = float(c["period"]), float(c["direct"])
        self.turn = math.tau / self.period
        self.modes = modes_of(c)
        self.read = float(c["compliance"]) * s.stiffness
        self.pid = {name: float(c[name]) for name in layout.PID}
        self.low, self.high = s.box
        self.low["frequency"] = s.lowest
        # π/Ts is not a double: the box ends slightly above it.
        self.high["frequency"] = math.nextafter(math.pi / self.period, math.inf) * (
            1 + ROUNDING
        )
        self.second = self.low["mode_frequency"], self.high["mode_frequency"]
        self.low["detuning"] = self.second[0] / self.high["frequency"]
        self.high["detuning"] = self.second[1] / self.low["frequency"]
        self.axes = tuple(name for name in AXES if self.low[name] < self.high[name])
        # Bound of all aliases below the lowest frequency, where L includes none of them,
        # divided by |K| |y|.
        low, high = self.root()
        low[:, 0] = 0.0
        self.tail = float(self._alias_sum(self.box(low, high))[0]) * 2 / self.period

    def root(self) -> tuple[Real, Real]:
        """The whole box, two arrays of shape (1, axes)."""
        ends = [[side[name] for name in AXES] for side in (self.low, self.high)]
        return np.array(ends[:1]), np.array(ends[1:])

    def box(self, low: Real, high: Real) -> dict[str, Span]:
        """The columns of many boxes by name."""
        return {name: Span(low[:, i], high[:, i]) for i, name in enumerate(AXES)}

    def possible(self, low: Real, high: Real) -> tuple[Real, Real, Mask]:
        """(lower ends, upper ends, whether anything is left) of boxes from which the
        detunings that put the second mode outside its interval are cut.
        """
        low, high = low.copy(), high.copy()
        first, last = self.second
        k = AXES.index("detuning")
        least = first / high[:, 0] * (1 - 4 * ROUNDING)
        most = last / low[:, 0] * (1 + 4 * ROUNDING)
        low[:, k], high[:, k] = (
            np.maximum(low[:, k], least),
            np.minimum(high[:, k], most),
        )
        return low, high, low[:, k] <= high[:, k]

    def place(self, point: Real) -> dict[str, float]:
        """The frequency and the parameters at a point of a box, by name."""
        at = dict(zip(AXES, map(float, point), strict=True))
        return at | {"mode_frequency": at.pop("detuning") * at["frequency"]}

    def _variable(self, name: str, span: Span) -> Disc:
        """A parameter over boxes, as a disc with its slope; an exact parameter has
        none.
        """
        disc = span.disc()
        one = Disc(np.ones(disc.c.shape), np.zeros(disc.c.shape))
        return Disc(disc.c, disc.r, {name: one} if name in self.axes else None)

    # ---- what stands in front of the link -----------------------------------------------------------------

    def fronts(
        self, box: dict[str, Span], shifts: Shifts = _MAIN
    ) -> tuple[list[Disc], Disc, Real]:
        """(F at ω + 2πn/Ts for the shifts n, 1/F for the first of them, bound of the
        aliases not included in L) over boxes.

        1/F is not formed from F, whose disc is unbounded where the disc of X contains
        zero, and whose slopes along the motor would enter three times.
        """
        window = self._window(box["frequency"], shifts)
        w, late = (
            self._variable("frequency", box["frequency"]),
            self._variable("delay", box["delay"]),
        )
        slow = self._variable("motor", box["motor"]).inverse()
        places = [w + n * self.turn for n in shifts]
        rests = [
            f * (at * late * -1j).exp()
            for f, at in zip(window.fronts, places, strict=True)
        ]
        alias, back = window.alias * self._alias_sum(box), rests[0].inverse()
        if self.motor_loop == "ideal":
            leads = [1 + at * slow * 1j for at in places]
            lags = [lead.inverse() for lead in leads]
            fronts = [rest * lag * lag for rest, lag in zip(rests, lags, strict=True)]
            return fronts, back * leads[0] * leads[0], alias
        # Near the resonance of the motor loop X is small; its slopes enclose it more
        # tightly than its terms.
        middle = box["frequency"].middle
        at_motor = Disc(box["motor"].middle).inverse()
        point = self._window(Span(middle, middle))
        centre = self.closing(point.back, point.both, Disc(late.c), at_motor)
        steps = {"frequency": w.r, "delay": late.r, "motor": box["motor"].disc().r}
        wide = self.closing(window.back, window.both, late, slow).closer(centre, steps)
        lag = wide.inverse()
        # The transfer function from Ĉ to the voltage is C/X, X = A (y²/A + Z); the alias
        # sum already contains the motor's A.
        alias = alias * lag.most() * slow.most()
        return [rest * lag for rest in rests], back * wide, alias

    def _window(self, frequency: Span, shifts: Shifts = _MAIN) -> FrequencyWindow:
        """The functions of the frequency alone."""
        w = self._variable("frequency", frequency)
        z, x = (w * (1j * self.period)).exp(), (w * (-1j * self.period)).exp()
        y = 1 - x
        kernel = self._kernel(z)
        factor = kernel * y * y * (1 / self.period)
        size = np.minimum(y.most(), 2.0)
        alias = kernel.most() * size**2 * (1 + 1e-9) / self.period
        both = y
        if self.motor_loop == "sampled":
            first, both = self.controllers(x)
            factor = factor * y * first
            alias = alias * size * first.most()
        fronts = [factor * self._aperiodic((w + n * self.turn) * 1j) for n in shifts]
        if np.any(frequency.low < frequency.high):
            middle = self._window(Span(frequency.middle, frequency.middle), shifts)
            steps = {"frequency": w.r}
            fronts = [
                f.closer(at, steps) for f, at in zip(fronts, middle.fronts, strict=True)
            ]
        return FrequencyWindow(tuple(fronts), alias, x, both)

    def _aperiodic(self, s: Disc) -> Disc:
        """The part of F that is not periodic, without the delay and the ideal motor loop; with
        the PID it includes the motor.
        """
        return (
            s if self.motor_loop == "ideal" else s * s * (s + self.statement.decay)
        ).inverse()

    def held(self, frequency: Real) -> Mask:
        """Whether L includes the nearest aliases for boxes from these frequencies on."""
        return frequency >= 0.5 * ALIASES_FROM * self.turn

    def _kernel(self, z: Disc) -> Disc:
        """K."""
        zero = np.zeros(z.c.shape)
        return sum(
            ((z - pole).inverse() * gain for pole, gain in self.modes),
            Disc(self.direct + zero, zero),
        )

    def controllers(self, x: Disc) -> tuple[Disc, Disc]:
        """(y Cm1, y (Cm1 + Cm2)) of the PID in the law's block, as polynomials in y
        over 1 − r x.

        In x their large terms would cancel, in y they do not.
        """
        p, y = self.pid, 1 - x
        r, late = p["filter_decay"], p["integral_before"]
        whole = p["integral_now"] + late
        lag = (1 - x * r).inverse()

        def over_lag(direct: float, now: float, before: float) -> Disc:
            linear = (direct - late) * (1 - r) + whole * r + now + before
            return (
                (y * ((direct - late) * r - before) + linear) * y + whole * (1 - r)
            ) * lag

        now, before = (
            p[f"filter_{when}"] + p[f"filter_angle_{when}"]
            for when in ("now", "before")
        )
        return (
            over_lag(p["inner_direct"], p["filter_now"], p["filter_before"]),
            over_lag(p["inner_direct"] + p["inner_angle"], now, before),
        )

    def closing(self, x: Disc, both: Disc, late: Disc, slow: Disc) -> Disc:
        """X/A = y²/A + Z, Z = y² (Cm1 + Cm2) P_τ/A with ``P_τ = A x (n x + y (n0 − n2
        x))/(y (1 − e x))``.
        """
        y = 1 - x
        n, n0, n2 = self.held_motor(late)
        e = math.exp(-self.statement.decay * self.period)
        tail = x * (1 - x * e).inverse() * (x * n + y * (n0 - x * n2))
        for _ in range(self.statement.whole):
            tail = tail * x
        return y * y * slow + both * tail

    def held_motor(self, late: Disc) -> tuple[float, Disc, Disc]:
        """(n, n0, n2) of the motor under a held voltage that is delayed by a fraction
        of a period in addition to whole periods.
        """
        decay, period = self.statement.decay, self.period
        late = late - self.statement.whole * period
        scales = (decay**-2, math.exp(-decay * period) * decay**-2)

        def of(delay: Disc) -> list[Disc]:
            angles = (delay - period) * decay, delay * decay
            return [
                (angle.exp() - 1 - angle) * scale
                for angle, scale in zip(angles, scales, strict=True)
            ]

        # Each is about half a square: its slope encloses it more tightly than its
        # terms.
        steps = {"delay": late.r}
        n0, n2 = (
            wide.closer(point, steps)
            for wide, point in zip(of(late), of(Disc(late.c)), strict=True)
        )
        return period * -math.expm1(-decay * period) / decay, n0, n2

    # ---- the loop in two forms ----------------------------------------------------------------------------

    def forms(
        self, low: Real, high: Real, held: Mask | None = None
    ) -> tuple[Disc, Disc, Real]:
        """(L, 1/L, bound of the aliases not included in L) over boxes, with their
        slopes.

        Slopes along the motor are with respect to p or A. For a point of a box, which
        must include the same aliases as the box, `held` is given.
        """
        # A box that is too wide gives infinities and NaN, which prove nothing.
        with np.errstate(all="ignore"):
            return self._forms(
                self.box(low, high), self.held(low[:, 0]) if held is None else held
            )

    def _forms(self, box: dict[str, Span], held: Mask) -> tuple[Disc, Disc, Real]:
        (front,), back, alias = self.fronts(box)
        w, log = (
            self._variable("frequency", box["frequency"]),
            self._log(box["frequency"], 1.0),
        )
        gauge, mode = self._read(box, w), self._mode(box)
        plain = front * (1 - gauge * ((self._compliant(box, log) + 1).inverse() + mode))
        x = self._soft(box, log) + 1
        inverse = back * (x * (gauge + (1 - gauge * (1 + mode)) * x).inverse())
        if not held.any():
            return plain, inverse, alias
        part = {
            name: Span(span.low[held], span.high[held]) for name, span in box.items()
        }
        fronts, _, _ = self.fronts(part, ALIASES)
        terms = [
            f * self._tip_at_alias(part, n)
            for f, n in zip(fronts, ALIASES, strict=True)
        ]
        aliases = sum(terms[1:], terms[0]).placed(held)
        return plain + aliases, inverse * (1 + aliases * inverse).inverse(), alias

    def _tip_at_alias(self, box: dict[str, Span], shift: int) -> Disc:
        """H at j(ω + 2πn/Ts)."""
        frequency, sign = box["frequency"], math.copysign(1.0, shift)
        ends = (
            sign * (end + shift * self.turn) for end in (frequency.low, frequency.high)
        )
        share = (
            self._compliant(box, self._log(Span.around(*ends), sign)) + 1
        ).inverse()
        w = self._variable("frequency", frequency) + shift * self.turn
        return 1 - self._read(box, w) * (share + self._mode(box, shift))

    def _log(self, frequency: Span, sign: float) -> Disc:
        """ln(±jω) with its slope along ω, which is negative where the frequency of the
        alias decreases with ω.
        """
        disc = (
            Span.around(np.log(frequency.low), np.log(frequency.high)).disc()
            + sign * 0.5j * math.pi
        )
        slopes = {
            "frequency": self._variable("frequency", frequency).plain.inverse() * sign
        }
        return Disc(disc.c, disc.r + ROUNDING, slopes)

    def _compliant(self, box: dict[str, Span], log: Disc) -> Disc:
        """V = 1/S."""
        order = self._variable("order", box["order"])
        compliance = (
            self._variable("softness", box["softness"]).inverse()
            * (-(log * order)).exp()
        )
        return (
            compliance * self._material(box, log) if self.high["loss"] else compliance
        )

    def _soft(self, box: dict[str, Span], log: Disc) -> Disc:
        """S."""
        order = self._variable("order", box["order"])
        softness = self._variable("softness", box["softness"]) * (log * order).exp()
        if not self.high["loss"]:
            return softness
        return softness * self._material(box, log).inverse()

    def _material(self, box: dict[str, Span], log: Disc) -> Disc:
        """D = 1 + η s^α."""
        power = (log * self.statement.damping_order).exp()
        return 1 + self._variable("loss", box["loss"]) * power

    def _read(self, box: dict[str, Span], w: Disc) -> Disc:
        """E."""
        return (
            (w * self._variable("gauge_delay", box["gauge_delay"]) * -1j).exp()
            * self._variable("gauge_gain", box["gauge_gain"])
            * self.read
        )

    def _mode(self, box: dict[str, Span], shift: int = 0) -> Disc:
        """R = a/(1 + 2ζ f/s + (f/s)²) at s = j(ω + 2πn/Ts)."""
        zero = np.zeros(box["frequency"].low.shape)
        if not self.high["mode_gain"]:
            return Disc(zero, zero)
        ratio = self._variable("detuning", box["detuning"]) * -1j
        if shift:
            own = self._variable("frequency", box["frequency"])
            ratio = ratio * own * (own + shift * self.turn).inverse()
        share = (1 + ratio * (ratio + 2 * self.statement.mode_damping)).inverse()
        # Over wide boxes the bound of the denominator may include zero; R itself never
        # exceeds its peak.
        most = self.mode_peak * (1 + 1e-9)
        # Negated, so that NaN counts as wide.
        wide = ~(share.r < most)
        share = Disc(
            np.where(wide, 0.0, share.c), np.where(wide, most, share.r), share.d
        )
        return share * self._variable("mode_gain", box["mode_gain"])

    def alias_at(self, place: dict[str, float]) -> float:
        """Bound at one point of the aliases not included in L."""
        detuning = place["mode_frequency"] / place["frequency"]
        at = place | {"detuning": detuning}
        point = np.array([[at[name] for name in AXES]])
        return float(self.fronts(self.box(point, point))[-1][0])

    # ---- bounds outside the tree --------------------------------------------------------------------------

    def _alias_sum(self, box: dict[str, Span]) -> Real:
        """Bound of ``Σ_{k≠0} |F(s_k)/s_k|`` over boxes, without the common factor of
        the terms.

        The nearest alias of ω <= w, the Nyquist frequency, lies at v = 2w − ω, and is
        bounded with the box's own gauge and motor. The others lie at 2jw + ω and (2j +
        2)w − ω for j = 1, 2, …, where |F(s)/s| falls at least like ω^-3. Since t^-3 is
        convex, the sum over all j but the first is at most half the integral from half
        a step before the second. Where L includes `ALIASES`, these sums begin with j =
        3.
        """
        w = math.pi / self.period
        ratio = np.minimum(
            Span.around(box["frequency"].low / w, box["frequency"].high / w).high, 1.0
        )
        near = w * (2.0 - ratio) * (1 - 1e-9)
        highest = (2.0 * w - box["frequency"].low) * (1 + 1e-9)
        motor = box["motor"].high
        first = self._tip_bound(box, near, highest) / near**3
        if self.motor_loop == "ideal":
            motor = motor**2
            first = first * (near**2 / (near**2 + motor))
        fast = self.held(box["frequency"].low)
        first, begin = (
            np.where(fast, 0.0, first),
            np.where(fast, len(ALIASES) - 1.0, 0.0),
        )
        above, below = begin + 2.0 + box["frequency"].low / w, begin + 4.0 - ratio
        terms = sum(t**-3 + 0.25 / (t + 1.0) ** 2 for t in (above, below))
        rest = self._tip_bound(
            box, np.full(near.shape, 2.0 * w), np.full(near.shape, math.inf)
        )
        return motor * (first + terms * rest / w**3) * (1 + 1e-9)

    def _tip_bound(self, box: dict[str, Span], low: Real, high: Real) -> Real:
        """Bound of |H| at frequencies in [low, high]: κ c g |G|, |1 − E| and |E R|.

        |G| falls with q, λ and ω, and rises with the damping. |1 − E|² = (1 − g)² + 4 g sin²(θ/2) with θ the
        angle by which the gauge is late: at most 1 + g from half a turn on.
        """
        gains = [
            self.read * end for end in (box["gauge_gain"].low, box["gauge_gain"].high)
        ]
        drag = box["loss"].high * low**self.statement.damping_order
        # |G| = |1 + η s^α|/|1 + q s^λ + η s^α| is at most (1 + drag)/(|q s^λ| - 1 -
        # drag) where that is positive.
        stiff = box["softness"].low * low ** box["order"].low - 1 - drag
        tip = np.where(
            stiff > 0, gains[1] * (1 + drag) / np.where(stiff > 0, stiff, 1.0), np.inf
        )
        late = box["gauge_delay"].high
        turn = np.where(
            late > 0.0, np.minimum(np.where(late > 0.0, late, 1.0) * high, math.pi), 0.0
        )
        off = np.maximum(np.abs(1 - gains[0]), np.abs(1 - gains[1]))
        unread = np.sqrt(off**2 + 4 * gains[1] * np.sin(0.5 * turn) ** 2)
        ratio = self.second[1] / low
        # Near the mode |R| never exceeds its gain times 1/(2ζ sqrt(1 − ζ²)).
        peak = np.where(ratio < 0.7, 1 / np.maximum(1 - ratio**2, 0.5), self.mode_peak)
        return (tip + unread + gains[1] * box["mode_gain"].high * peak) * (1 + 1e-9)

    @property
    def mode_peak(self) -> float:
        """Largest |R| relative to its gain, over all frequencies."""
        zeta = self.statement.mode_damping
        return 1 / (2 * zeta * math.sqrt(1 - zeta**2)) if zeta else 0.0

    def low_bound(self) -> float:
        """Bound of |L| for ω in [0, lowest], including aliases; |M| and the hold are at
        most 1 there.
        """
        s, w = self.statement, self.statement.lowest
        # Below 1 rad/s the smallest order gives the largest power. Far below the
        # resonance the tip follows the motor up to small terms x, and 1/(1 - x) bounds
        # the quotients.
        soft = self.high["softness"] * w ** self.low["order"]
        drag = self.high["loss"] * w**s.damping_order
        ratio = w / self.second[0] if self.high["mode_gain"] else 0.0
        if not (soft + drag < 0.5 and w < 1 < math.pi / self.period and ratio < 0.5):
            return math.inf
        mode = self.high["mode_gain"] * ratio**2 / (1 - ratio**2)
        tip = 1 + self.read * self.high["gauge_gain"] * (
            soft / (1 - soft - drag) + mode
        )
        # |e^(−jωTs) − 1| ≤ ωTs: one disc contains the arc from 0 to the lowest
        # frequency.
        arc = Disc(np.ones(1), np.array([w * self.period]))
        bound = float(self._kernel(arc).most()[0]) * w * self.period * (tip + self.tail)
        voltage = self._low_voltage(arc) if self.motor_loop == "sampled" else 1.0
        return float(bound * voltage * (1 + 1e-9))

    def _low_voltage(self, arc: Disc) -> float:
        """The factor of the sampled motor loop in `low_bound`."""
        first, both = self.controllers(arc)
        box = self.box(*self.root())
        closing = self.closing(
            arc, both, box["delay"].disc(), box["motor"].inverse().disc()
        )
        size = first.most() * closing.inverse().most() / self.low["motor"]
        return float(size[0]) * (
            self.period * self.high["motor"] / self.statement.decay + 2
        )

    def inner_is_stable(self, delay: float, motor: float) -> bool:
        """Whether the sampled motor loop is stable with one delay [s] and motor gain,
        by Jury's reflection coefficients.

        From one such pair it follows for all others by the tree: each leaf shows X ≠ 0
        on its part of the unit circle, so no pole can cross it while they change.
        """
        if self.motor_loop == "ideal":
            return True
        # The coefficients of (1 − e x)(1 − r x) X/A, ascending in x (highest power of z
        # first), from its values at as many roots of unity as there are coefficients.
        count = 6 + self.statement.whole
        x = Disc(np.exp(2j * math.pi / count * np.arange(count)))
        both = self.controllers(x)[1]
        late, slow = Disc(np.array(delay)), Disc(np.array(1 / motor))
        closing = self.closing(x, both, late, slow)
        decay = math.exp(-self.statement.decay * self.period)
        poles = (1 - x.c * decay) * (1 - x.c * self.pid["filter_decay"])
        coefficients = np.fft.fft(closing.c * poles).real / count
        return inside_circle(coefficients.tolist())
