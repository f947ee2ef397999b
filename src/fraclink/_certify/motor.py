"""The sampled motor loop in ball arithmetic: its controllers, X whose zeros are its poles, a stable delay."""

from __future__ import annotations

from typing import Any

__all__ = ["SampledMotor"]

Ball = Any  # flint.arb; python-flint has no type stubs
Disc = Any  # flint.acb


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
