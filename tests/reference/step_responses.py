"""Make step_responses.json: step responses of link models to 40 digits, each value by
two methods.

Method 1: residues of the principal sheet's poles plus the branch-cut integral in ln r
(python-flint: adaptive Gauss-Legendre quadrature in ball arithmetic, so that the
integral is enclosed). Method 2: Talbot's contour of degree M > 1.5 (5t/π) max|Im p|, no
poles, no cut (mpmath; working precision 0.174 M digits for the growth of e^(st) on the
contour, and 60 besides). Method 3, where the series needs fewer than 6000 terms: w t^λ
E_{λ,λ+1}(-w t^λ) by its power series (UD-FOM).

A value is kept only where the methods agree to 1e-41 absolute. Run: python
tests/reference/step_responses.py
"""

from __future__ import annotations

import cmath
import itertools
import json
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import mpmath as mp
from flint import acb, arb, ctx

TIMES = ("0.004", "0.02", "0.1", "0.4", "1", "3", "10", "30", "60", "100")
ORDERS = (
    "1.01",
    "1.05",
    "1.2",
    "1.37",
    "1.5",
    "1.7",
    "1.85",
    "1.92",
    "1.97",
    "1.99",
    "1.999",
    "2",
)
# (order, damping, damping order, natural frequency): the torque model c = 1 is s^λ / D,
# its complement ϖ²/D
DAMPED = (
    ("2", "0.9", "0.5", "10.5"),
    ("2", "0.9", "1.2", "10.5"),
    ("1.92", "0.5", "0.8", "11.54"),
    ("1.37", "0.9", "0.6", "10.5"),
    ("2", "3", "1.9", "9.42"),
    ("1.01", "0.4", "0.3", "8"),
)
DIGITS = 50


def denominator(case: tuple[str, ...]) -> list[tuple[mp.mpf, mp.mpf]]:
    """Pairs (coefficient, order); the decimal strings are read as doubles, as by the
    package.
    """
    if len(case) == 2:
        order, frequency = (mp.mpf(float(x)) for x in case)
        return [(mp.mpf(1), order), (frequency**2, mp.mpf(0))]
    order, damping, damping_order, frequency = (mp.mpf(float(x)) for x in case)
    return [(mp.mpf(1), order), (damping, damping_order), (frequency**2, mp.mpf(0))]


def value(
    terms: list[tuple[mp.mpf, mp.mpf]], z: mp.mpc, derivative: bool = False
) -> mp.mpc:
    """D, or dD/dz, at s = e^z."""
    return mp.fsum(c * (a if derivative else 1) * mp.exp(a * z) for c, a in terms)


def zeros(terms: list[tuple[mp.mpf, mp.mpf]]) -> list[mp.mpc]:
    """Zeros with 0 < Im z < π, from a dense grid of starting points; completeness is
    tested by method 2.
    """
    found: list[mp.mpc] = []
    scale = mp.log(terms[-1][0]) / terms[0][1]
    for x, y in itertools.product((-0.5, 0.0, 0.5), range(1, 33)):
        z = newton(terms, complex(float(scale) + x, math.pi * y / 32))
        if z is None or any(abs(z - r) < 1e-9 for r in found):
            continue
        root = mp.mpc(z)
        for _ in range(6):  # 1e-14, 1e-28, …
            root -= value(terms, root) / value(terms, root, True)
        if 0 < root.imag < mp.pi:
            found.append(root)
    return found


def newton(terms: list[tuple[mp.mpf, mp.mpf]], z: complex) -> complex | None:
    """Newton's method in double precision; None if it leaves the neighbourhood."""
    pairs = [(float(c), float(a)) for c, a in terms]
    for _ in range(60):
        slope = sum(c * a * cmath.exp(a * z) for c, a in pairs)
        step = sum(c * cmath.exp(a * z) for c, a in pairs) / slope if slope else 1.0
        z -= step / max(1.0, abs(step) / 0.3)
        if not 0.0 < z.imag < 4.0 or abs(z.real) > 20.0:
            return None
        if abs(step) < 1e-14:
            return z
    return None


def by_residues(terms: list[tuple[mp.mpf, mp.mpf]], time: mp.mpf) -> mp.mpf:
    """Method 1, for ϖ²/D."""
    gain, poles = terms[-1][0], zeros(terms)
    total = mp.mpf(1)
    for z in poles:
        total += 2 * mp.re(gain / value(terms, z, True) * mp.exp(mp.exp(z) * time))
    if all(a == int(a) for _, a in terms):
        return total
    low, high = -mp.mpf(130) / min(a for _, a in terms if a > 0), mp.log(130 / time)
    balls = [(ball(c), ball(a)) for c, a in terms]
    turns = [(c * (acb(0, 1) * a * acb.pi()).exp(), a) for c, a in balls]

    def integrand(x: acb, _analytic: bool) -> acb:
        above = sum((c * (a * x).exp() for c, a in turns), acb(0))
        below = sum((c.conjugate() * (a * x).exp() for c, a in turns), acb(0))
        # Im G on the cut as an analytic function of x: half the difference between the
        # two sides.
        return (
            balls[-1][0]
            * (1 / above - 1 / below)
            * (-x.exp() * ball(time)).exp()
            / acb(0, 2)
        )

    steps = 40
    edges = [ball(low + (high - low) * k / steps) for k in range(steps + 1)]
    integral = sum(
        (
            acb.integral(
                integrand, a, b, rel_tol=arb(2) ** -190, abs_tol=arb(2) ** -190
            )
            for a, b in itertools.pairwise(edges)
        ),
        acb(0),
    )
    if not integral.real.rad() < arb("1e-44"):
        raise ValueError(
            f"the enclosure of the cut integral is too wide: {integral.real}"
        )
    return total + mp.mpf(integral.real.mid().str(60, radius=False)) / mp.pi


def ball(x: mp.mpf) -> acb:
    return acb(arb(mp.nstr(x, 70)))


def by_talbot(
    terms: list[tuple[mp.mpf, mp.mpf]], time: mp.mpf, largest: mp.mpf
) -> mp.mpf:
    """Method 2; `largest` is the largest imaginary part that the contour must pass."""
    degree = int(max(120, 1.6 * 5 * time / mp.pi * largest + 150))
    with mp.workdps(int(0.174 * degree) + 70):
        radius = mp.mpf(2 * degree) / (5 * time)
        gain = terms[-1][0]
        total = mp.exp(radius * time) * gain / value(terms, mp.log(radius)) / radius / 2
        for k in range(1, degree):
            angle = k * mp.pi / degree
            cot = mp.cot(angle)
            s = radius * angle * mp.mpc(cot, 1)
            slope = mp.mpc(1, angle + (angle * cot - 1) * cot)
            total += mp.re(
                mp.exp(time * s) * slope * gain / value(terms, mp.log(s)) / s
            )
        return total * radius / degree


def by_series(case: tuple[str, ...], time: mp.mpf) -> mp.mpf | None:
    """Method 3, or None where it would take too many terms."""
    if len(case) != 2:
        return None
    order, gain = mp.mpf(float(case[0])), mp.mpf(float(case[1])) ** 2
    size = mp.power(gain * time**order, 1 / order)
    if 3 * size / order > 6000:
        return None
    with mp.workdps(int(size / mp.log(10)) + 70):
        z, total, k = -gain * time**order, mp.mpf(0), 0
        while True:
            term = z**k * mp.rgamma(order * (k + 1) + 1)
            total += term
            if order * k > size and abs(term) < mp.mpf(10) ** -60:
                return gain * time**order * total
            k += 1


def entry(job: tuple[tuple[str, ...], str]) -> dict[str, object]:
    case, text = job
    mp.mp.dps = DIGITS + 15
    ctx.prec = 230
    terms, time = denominator(case), mp.mpf(float(text))
    first = by_residues(terms, time)
    largest = max((abs(mp.exp(z).imag) for z in zeros(terms)), default=mp.mpf(0))
    others = [by_talbot(terms, time, largest)]
    series = by_series(case, time)
    if series is not None:
        others.append(series)
    gap = max(abs(first - other) for other in others)
    if not gap < mp.mpf(10) ** -41:
        raise ValueError(f"{case} t = {text}: the methods differ by {mp.nstr(gap, 3)}")
    return {
        "case": list(case),
        "time": text,
        "step": mp.nstr(first, 42),
        "hex": float(first).hex(),
        "methods": 1 + len(others),
        "difference": mp.nstr(gap, 3),
    }


def main() -> None:
    cases = [(order, "11.54") for order in ORDERS] + list(DAMPED)
    jobs = [(case, time) for case in cases for time in TIMES]
    with ProcessPoolExecutor(2) as pool:
        entries = list(pool.map(entry, jobs))
    place = Path(__file__).with_suffix(".json")
    header = {
        "quantity": "step response of ϖ²/(s^λ + μ s^α + ϖ²); case = (λ, ϖ) or (λ, μ, α, ϖ), read as doubles",
        "methods": "residues + branch cut; Talbot; Mittag-Leffler series where short; agreement to 1e-41",
        "generator": "tests/reference/step_responses.py",
    }
    place.write_text(
        json.dumps({**header, "values": entries}, indent=0) + "\n", encoding="utf-8"
    )
    sys.stdout.write(
        f"{len(entries)} values, worst difference {max(float(e['difference']) for e in entries):.1e}\n"
    )


if __name__ == "__main__":
    main()
