"""Ball arithmetic on the sampled loop: an enclosure of 1/L over a box of frequencies, payloads and delays.

1/L is affine in the payload and turns with the delay: both enter once; L itself would have them twice. With
``x = 1/z = e^{-jωTs}``, ``K = d + Σ g/(z - p)`` (so that Ĉ = (1 - x) K), ``D = 1/G`` and ``h = ωTs/2``:

    ideal     1/L = e^{jω(τ+Ts)} · 1/H · (1 + jω/p)² (-j/2) (h/sin h)(1/sin h)/K
    sampled   1/L = e^{jω(τ+3Ts/2)} · 1/H · X · (s + B)(-j/(2Ts)) (h/sin h)²(1/sin h)/(A K C)

with ``C = (1 - x) Cm1``, ``X = (1 - x)² (1 + (Cm1 + Cm2) P_τ)`` and P_τ the held motor, late by τ.
H is the tip angle as the law computes it, θm - κΓ, from what the gauge shows of Γ = c (1 - G + R) θm:
``H = 1 - E (1 - G + R)``, ``E = κ c g e^{-jωτ_g}`` (κ, the law's compliance; g and τ_g, the gauge's gain and
delay; R, the second mode), so that ``1/H = D/(E + (1 - E (1 + R)) D)``. With a gauge that reads true, H = G.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

from fraclink._certify.statement import Statement
from fraclink.errors import MissingExtraError

__all__ = ["BITS", "Ball", "BallLoop", "BallWindow", "Disc", "SampledMotor", "load_flint", "outside"]

Ball: TypeAlias = Any  # flint.arb, a real ball; python-flint has no type stubs
Disc: TypeAlias = Any  # flint.acb, a rectangle of two
BITS = 64  # of the midpoints: the radii of the boxes are what limits, so more bits buy nothing
ZETA_3 = 1.20206  # upper bound of Σ j^-3


def load_flint() -> Any:
    """python-flint at the working precision, or the error that names the extra."""
    try:
        import flint
    except ImportError as error:
        raise MissingExtraError("python-flint", "certify") from error
    flint.ctx.prec = BITS
    return flint


def outside(value: Ball) -> tuple[float, float]:
    """Floats below and above every point of a ball."""
    low, high = float(value.lower()), float(value.upper())
    return math.nextafter(low, -math.inf), math.nextafter(high, math.inf)


@dataclass(frozen=True)
class BallWindow:
    """What one interval of frequencies contributes, whatever payload and delay."""

    frequency: Ball
    factor: Disc  # of 1/L: everything but 1/H, X and the turn, which widens rectangles and comes last
    size: Ball  # its modulus from below
    inertia: Disc  # (jω)^λ
    drag: Disc  # μ (jω)^α
    correction: Ball  # bound of |Ĉ|
    read: Disc  # E
    unread: Disc  # 1 - E (1 + R)
    back: Disc  # x
    first: Disc  # C = (1 - x) Cm1; one where the motor loop is ideal
    both: Disc  # (1 - x)(Cm1 + Cm2)


# What the motor loop reads of the block.
_PID = (
    "inner_direct",
    "inner_angle",
    "integral_now",
    "integral_before",
    "filter_now",
    "filter_before",
    "filter_angle_now",
    "filter_angle_before",
    "filter_decay",
)


class SampledMotor:
    """The PID of a law's block around the motor A/(s(s + B)), at its period."""

    def __init__(
        self, flint: Any, period: Ball, gain: float, decay: float, coefficients: dict[str, Any]
    ) -> None:
        self.flint, self.period = flint, period
        self.gain, self.decay = flint.arb(gain), flint.arb(decay)
        self.pid = {k: flint.arb(coefficients[k]) for k in _PID}
        self.slow = (-self.decay * period).exp()

    def controllers(self, x: Disc) -> tuple[Disc, Disc]:
        """((1 - x) Cm1, (1 - x)(Cm1 + Cm2)) of the PID in the law's block.

        As polynomials in y = 1 - x over 1 - r x: in x their large terms cancel, in y they do not.
        """
        p, y = self.pid, 1 - x
        lag = 1 - p["filter_decay"] * x
        low, slow = p["inner_direct"], (p["filter_now"], p["filter_before"])
        first = self._numerator(low, *slow)
        both = self._numerator(
            low + p["inner_angle"], slow[0] + p["filter_angle_now"], slow[1] + p["filter_angle_before"]
        )
        return self._horner(first, y) / lag, self._horner(both, y) / lag

    def _numerator(self, direct: Ball, now: Ball, before: Ball) -> tuple[Ball, Ball, Ball]:
        """Coefficients in y of ``(d y + i0 + i1 x)(1 - r x) + y (f0 + f1 x)``."""
        r, late = self.pid["filter_decay"], self.pid["integral_before"]
        whole = self.pid["integral_now"] + late
        return (
            whole * (1 - r),
            (direct - late) * (1 - r) + whole * r + now + before,
            (direct - late) * r - before,
        )

    @staticmethod
    def _horner(c: tuple[Ball, Ball, Ball], y: Disc) -> Disc:
        return c[0] + y * (c[1] + y * c[2])

    def closing(self, x: Disc, both: Disc, delay: Ball) -> Disc:
        """X = (1 - x)² (1 + (Cm1 + Cm2) P_τ), regular at x = 1."""
        n, n0, n2 = self.held_motor(delay)
        edge = 1 - x
        return edge * edge + both * x * (n * x + edge * (n0 - n2 * x)) / (1 - self.slow * x)

    def held_motor(self, delay: Ball) -> tuple[Ball, Ball, Ball]:
        """(n, n0, n2) of ``P_τ = x (n x + (1 - x)(n0 - n2 x))/((1 - x)(1 - e x))``.

        n does not depend on the delay, n0 falls and n2 rises with it: the ends of an interval enclose them.
        """
        arb, scale = self.flint.arb, self.gain / self.decay**2
        ends = [arb(delay.lower()), arb(delay.upper())]

        def first(tau: Ball) -> Ball:
            left = self.decay * (self.period - tau)
            return left - 1 + (-left).exp()

        def last(tau: Ball) -> Ball:
            return self.slow * ((self.decay * tau).exp() - 1 - self.decay * tau)

        n0 = first(ends[0]).union(first(ends[1])) * scale
        n2 = last(ends[0]).union(last(ends[1])) * scale
        return self.gain * self.period * (1 - self.slow) / self.decay, n0, n2

    def is_stable(self, delay: float) -> bool:
        """Whether every pole lies inside the unit circle at one delay [s]: Schur–Cohn, in balls."""
        return self._inside_circle(self._characteristic(self.flint.arb(delay)))

    def _characteristic(self, delay: Ball) -> list[Ball]:
        """Coefficients of (1-e x)(1-r x) X, ascending in x: the highest power of z first."""
        arb_poly, p = self.flint.arb_poly, self.pid
        edge = arb_poly([1, -1])
        motor, filt = arb_poly([1, -self.slow]), arb_poly([1, -p["filter_decay"]])
        both = edge * filt * arb_poly([p["inner_direct"] + p["inner_angle"]])
        both += arb_poly([p["integral_now"], p["integral_before"]]) * filt
        lags = [p["filter_now"] + p["filter_angle_now"], p["filter_before"] + p["filter_angle_before"]]
        both += arb_poly(lags) * edge
        n, n0, n2 = self.held_motor(delay)
        total = edge * edge * filt * motor + both * (arb_poly([0, 0, n]) + edge * arb_poly([0, n0, -n2]))
        return [total[k] for k in range(total.degree() + 1)]

    def _inside_circle(self, coefficients: list[Ball]) -> bool:
        """Schur–Cohn: every reflection coefficient of a real polynomial below one in modulus."""
        a = list(coefficients)
        while len(a) > 1:
            if not abs(a[0]) > 0:
                return False
            k = a[-1] / a[0]
            if not abs(k) < 1:
                return False
            a = [a[i] - k * a[-1 - i] for i in range(len(a) - 1)]
        return True


class BallLoop:
    """The sampled loop of a statement, in balls."""

    def __init__(self, statement: Statement, coefficients: dict[str, Any]) -> None:
        self.flint = load_flint()
        arb = self.flint.arb
        self.statement, c = statement, coefficients
        self.sampled = statement.motor_loop == "sampled"
        self.period = arb(c["period"])
        self.direct = arb(c["direct"])
        self.modes = self._modes(c)
        self.order, self.damping_order = arb(statement.order), arb(statement.damping_order)
        self.damping = arb(statement.damping)
        self.direction, self.drag_direction = self._direction(self.order), self._direction(self.damping_order)
        self.gain, self.decay = arb(statement.gain), arb(statement.decay)
        self.motor = SampledMotor(self.flint, self.period, statement.gain, statement.decay, c)
        self.gauge = arb(c["compliance"]) * arb(statement.stiffness) * arb(statement.gauge_gain)
        self.tail = self._tail()

    def hull(self, low: float, high: float) -> Ball:
        """The ball that holds every real of [low, high]."""
        return self.flint.arb(low).union(self.flint.arb(high))

    def turn(self, angle: Ball) -> Disc:
        """e^{j angle}."""
        return self.flint.acb(angle.cos(), angle.sin())

    def _direction(self, order: Ball) -> Disc:
        return self.turn(self.flint.arb.pi() * order / 2)

    def _modes(self, c: dict[str, Any]) -> list[tuple[Disc, Disc]]:
        """(pole, gain) of every mode, conjugates included."""
        acb = self.flint.acb
        real, pair = c["real"], c["pair"]
        found = [(acb(p), acb(g)) for p, g in zip(real[::2], real[1::2], strict=True) if g]
        for re, im, g, x in zip(*(pair[k::4] for k in range(4)), strict=True):
            if g or x:
                pole, gain = acb(re, im), acb(g, x) / 2
                found += [(pole, gain), (pole.conjugate(), gain.conjugate())]
        return found

    def kernel(self, z: Disc, ends: tuple[Disc, Disc]) -> tuple[Disc, Ball]:
        """K(z), the correction without its difference, and a bound of its modulus; `ends` are the arc's.

        Over wide arcs rectangles lose everything and the triangle inequality does not: |z - p| rises along
        the arc for a real p > 0 and falls for p < 0, so an end bounds it.
        """
        total, bound = self.flint.acb(self.direct), abs(self.direct)
        for p, g in self.modes:
            total += g / (z - p)
            near = abs(ends[0 if p.real > 0 else 1] - p) if p.imag == 0 else 1 - abs(p)
            bound += abs(g) / near
        return total, min(bound.upper(), abs(total).upper())

    def correction_is_stable(self) -> bool:
        """Whether every pole of Ĉ lies inside the unit circle."""
        return all(abs(p) < 1 for p, _ in self.modes)

    def _tail(self) -> Ball:
        """Bound of ``Σ_{k≠0} |F(s_k)/s_k| · 2/Ts``, what the aliases have beside Ĉ and the voltage.

        |ω + kω_s| >= j π/Ts for j = 1, 2, … and |F(s)/s| falls at least like ω^-3 from π/Ts on, so the sum is
        at most ζ(3) times its first term.
        """
        arb, s = self.flint.arb, self.statement
        w = arb.pi() / self.period
        soft = arb(s.softness) * s.payload_low
        drag = soft * self.damping * (w.log() * self.damping_order).exp()
        stiff = soft * (w.log() * self.order).exp() - 1 - drag
        if not stiff > 0:
            return arb(math.inf)
        motor = self.gain / w**2 if self.sampled else (arb(s.pole) / w) ** 2
        tip = self.gauge * (1 + drag) / stiff + self._unread_bound(w)
        return arb(ZETA_3) * motor * tip / w * 2 / self.period

    def _unread_bound(self, w: Ball) -> Ball:
        """Bound of |1 - E (1 + R)| from the frequency `w` on: |H| is at most κ c g |G| and this."""
        arb, s = self.flint.arb, self.statement
        turned = 1 + self.gauge if s.gauge_delay else abs(1 - self.gauge)
        if s.mode_frequency < 0.7 * float(w.mid()):
            peak = 1 / (1 - (arb(s.mode_frequency) / w) ** 2)
        else:  # the mode lies near the aliases: nowhere is |R| above its gain times 1/(2ζ sqrt(1 - ζ²))
            zeta = arb(s.mode_damping)
            peak = 1 / (2 * zeta * (1 - zeta**2).sqrt())
        return turned + self.gauge * abs(arb(s.mode_gain)) * peak

    def sensed(self, w: Ball) -> tuple[Disc, Disc]:
        """(E, 1 - E (1 + R)) over frequencies: what the law reads of the torque."""
        arb, acb, s = self.flint.arb, self.flint.acb, self.statement
        read = self.gauge * self.turn(-w * arb(s.gauge_delay))
        if not s.mode_frequency:
            return acb(read), 1 - acb(read)
        ratio = w / arb(s.mode_frequency)
        mode = arb(s.mode_gain) * ratio**2 / acb(ratio**2 - 1, -2 * arb(s.mode_damping) * ratio)
        return read, 1 - read * (1 + mode)

    def power(self, low: float, high: float, order: Ball) -> Ball:
        """ω^order over an interval: monotone, so its ends enclose it."""
        arb = self.flint.arb
        first = (arb(low).log() * order).exp() if low > 0.0 else arb(0)
        return first.union((arb(high).log() * order).exp())

    def window(self, low: float, high: float) -> BallWindow:
        """Enclose what frequencies [low, high] [rad/s] contribute, 0 < low < high <= π/Ts."""
        arb, acb = self.flint.arb, self.flint.acb
        w = self.hull(low, high)
        z = self.turn(w * self.period)
        ends = [arb(low) * self.period / 2, arb(high) * self.period / 2]
        sines = [h.sin() for h in ends]
        # h/sin h rises and 1/sin h falls on (0, π/2]: their ends enclose them, and h enters only there.
        sinc, inverse = (ends[0] / sines[0]).union(ends[1] / sines[1]), (1 / sines[0]).union(1 / sines[1])
        kernel, bound = self.kernel(z, (self.turn(2 * ends[0]), self.turn(2 * ends[1])))
        first, both = self.motor.controllers(z.conjugate()) if self.sampled else (acb(1), acb(0))
        if self.sampled:
            scale = sinc * sinc * inverse / (2 * self.period * self.gain)
            motor = acb(self.decay, w)
        else:
            scale = sinc * inverse / 2
            motor = acb(1, w / self.statement.pole) * acb(1, w / self.statement.pole)
        read, unread = self.sensed(w)
        return BallWindow(
            frequency=w,
            factor=motor * acb(0, -scale) / (kernel * first),
            inertia=self.power(low, high, self.order) * self.direction,
            drag=self.damping * self.power(low, high, self.damping_order) * self.drag_direction,
            correction=2 * sines[1] * bound,
            size=abs(motor) * scale / (bound * abs(first).upper()),
            read=read,
            unread=unread,
            back=z.conjugate(),
            first=first,
            both=both,
        )

    def closing_spread(self, window: BallWindow, delay: tuple[float, float]) -> tuple[float, float]:
        """Relative radius of X over a box that comes from the frequencies, and from the delays."""
        late = self.hull(*delay)
        value = self.motor.closing(window.back, window.both, late)
        point = self.motor.closing(window.back, window.both, self.flint.arb(late.mid()))
        size = float(abs(value.mid())) or 1.0
        spread = [float(x.real.rad()) + float(x.imag.rad()) for x in (value, point)]
        return spread[1] / size, (spread[0] - spread[1]) / size

    def inverse(
        self, window: BallWindow, payload: tuple[float, float], delay: tuple[float, float]
    ) -> tuple[Disc, Ball, float]:
        """Enclose 1/L without aliases over a box, then its modulus; bound what aliases add to L."""
        soft = self.hull(*payload) * self.statement.softness
        link = 1 + soft * window.inertia / (1 + soft * window.drag)
        # |H| from above where D is a wide rectangle: the quotient below has D twice
        tip = abs(window.read) / abs(link) + abs(window.unread)
        late, rest, size = self.hull(*delay), window.factor, window.size
        alias = window.correction * self.tail
        if self.sampled:
            closing = self.motor.closing(window.back, window.both, late)
            rest, size = rest * closing, size * abs(closing)
            alias = alias * 2 * abs(window.first) / abs(closing)
        ahead = self.period * (3 if self.sampled else 2) / 2
        inverse = link / (window.read + window.unread * link)
        value = inverse * (rest * self.turn(window.frequency * (late + ahead)))
        return value, size / tip, outside(alias)[1]

    def low_bound(self) -> float:
        """Bound of |L| for ω in [0, lowest], aliases included: |M| and the hold are at most one there."""
        s = self.statement
        w = self.hull(0.0, s.lowest)
        z = self.turn(w * self.period)
        soft = self.hull(s.payload_low, s.payload_high) * s.softness
        drag = soft * self.damping * self.power(0.0, s.lowest, self.damping_order) * self.drag_direction
        inverse = 1 + soft * self.power(0.0, s.lowest, self.order) * self.direction / (1 + drag)
        read, unread = self.sensed(w)
        tip = abs(read / inverse + unread)
        kernel = self.kernel(z, (self.flint.acb(1), self.turn(s.lowest * self.period)))[1]
        bound = s.lowest * self.period * kernel * (tip + self.tail)
        if self.sampled:
            first, both = self.motor.controllers(z.conjugate())
            closing = self.motor.closing(z.conjugate(), both, self.hull(s.delay_low, s.delay_high))
            bound = bound * (abs(first) / abs(closing)) * (self.period * self.gain / self.decay + 2)
        return outside(bound)[1]

    def inner_is_stable(self) -> bool:
        """Whether the sampled motor loop is stable at the smallest delay (Schur–Cohn, in balls).

        For every other delay it follows from the tree: each leaf shows X ≠ 0 on its part of the unit circle,
        so no pole can cross it while the delay grows.
        """
        return not self.sampled or self.motor.is_stable(self.statement.delay_low)
