"""Whether `error_estimate` keeps its promise: random responses of random functions
against mpmath.

Every call is checked at a few of its times by an independent inversion with 60 or more
digits: Talbot's method, plus the residues of the poles outside its contour, with more
and more nodes until two successive results agree. The true error must never exceed the
estimate, and the estimate should be at most 100 times the true error in the median.
"""

from __future__ import annotations

import collections
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpmath import mp, mpf

from fraclink import errors
from fracsys import (
    FractionalTransferFunction,
    impulse_response,
    poles,
    step_response,
    time_response,
)
from fracsys import s as laplace
from fracsys._terms import Term
from harness import line, sizes

AGREED = mpf(10) ** -19  # agreement of two contours relative to the response
Terms = tuple[Term, ...]


class UnknownError(Exception):
    """The oracle has no answer, since its contours do not agree or a pole cannot be
    refined: the call is left out and counted.
    """


# --- the oracle: f(t) = L⁻¹ [N(s)/D(s) s^(−n)] --------------------------------------------------------


def total(terms: Terms, log: Any, derivative: bool = False) -> Any:
    """Σ c s^a at s = e^log, or its derivative with respect to ln s."""
    return mp.fsum(
        mpf(t.coefficient)
        * (mpf(t.order) if derivative else 1)
        * mp.exp(mpf(t.order) * log)
        for t in terms
    )


@dataclass(frozen=True)
class Exact:
    """The impulse (n = 0, without its δ), step (1) or ramp (2) response of a delay-free
    N/D, to many digits.
    """

    top: Terms
    bottom: Terms
    logs: tuple[Any, ...]  # ln s of the poles in the upper half plane, refined

    @classmethod
    def of(cls, top: Terms, bottom: Terms) -> Exact:
        found = poles(FractionalTransferFunction(top, bottom)) if top else np.empty(0)
        polished = []
        with mp.workdps(60):
            for p in found[(found.imag >= 0.0) & (found != 0.0)]:
                if p.imag or p.real > 0.0:
                    polished.append(cls._polish(bottom, mp.log(mp.mpc(complex(p)))))
        return cls(top, bottom, tuple(polished))

    @staticmethod
    def _polish(bottom: Terms, log: Any) -> Any:
        for _ in range(6):
            slope = total(bottom, log, derivative=True)
            if abs(slope) < 1e-12:
                raise UnknownError
            log -= total(bottom, log) / slope
        return log

    def at(self, t: Any, degree: int) -> Any:
        """The response at t > 0."""
        if not self.top:
            return mpf(0)
        before, nodes = None, 36
        while nodes < 420:
            with mp.workdps(45 + nodes // 2):
                value = self._talbot(mpf(t), degree, nodes)
                if before is not None and abs(value - before) <= AGREED * abs(value):
                    return value
            before, nodes = value, nodes + 12 + nodes // 4
        raise UnknownError

    def _talbot(self, t: Any, degree: int, nodes: int) -> Any:
        """Fixed Talbot method (Abate and Valkó, 2004) plus the residues of the poles
        outside its contour.
        """
        scale = mpf(2) * nodes / (5 * t)
        direct = mpf(0)
        if degree == 0 and self.top[0].order == self.bottom[0].order:
            direct = mpf(self.top[0].coefficient) / mpf(self.bottom[0].coefficient)

        def value(z: Any) -> Any:
            log = mp.log(z)
            return (total(self.top, log) / total(self.bottom, log) - direct) * mp.exp(
                -degree * log
            )

        result = mp.exp(scale * t) * value(mp.mpc(scale)).real / 2
        for k in range(1, nodes):
            angle = k * mp.pi / nodes
            cotangent = mp.cot(angle)
            z = scale * angle * (cotangent + 1j)
            turn = 1 + 1j * (angle + (angle * cotangent - 1) * cotangent)
            result += (mp.exp(t * z) * value(z) * turn).real
        result *= scale / nodes
        for log in self.logs:
            p = mp.exp(log)
            angle = p.imag / scale
            outside = angle >= mp.pi or p.real > (
                scale * angle * mp.cot(angle) if angle else scale
            )
            if outside:
                residue = total(self.top, log) / total(
                    self.bottom, log, derivative=True
                )
                part = residue * mp.exp((1 - degree) * log + t * p)
                result += part.real if abs(p.imag) < mpf(10) ** -30 else 2 * part.real
        return result


def delay_series(
    G: FractionalTransferFunction, horizon: float
) -> Iterator[tuple[float, Exact]]:
    """(delay, delay-free function) pairs that add up to G up to `horizon`: 1/(A + B) =
    Σ (−B)^k / A^(k+1).
    """
    free = tuple(t for t in G.denominator if not t.delay)
    late = tuple(t for t in G.denominator if t.delay)
    summands, power = (
        {0.0: FractionalTransferFunction(G.numerator, free)},
        FractionalTransferFunction(late, free),
    )
    layers = [summands[0.0]]
    if late:
        while len(layers) * min(t.delay for t in late) <= horizon:
            layers.append(layers[-1] * power * -1.0)
    for layer in layers:
        groups: dict[float, list[Term]] = collections.defaultdict(list)
        for t in layer.numerator:
            groups[t.delay].append(Term(t.coefficient, t.order))
        for delay, top in groups.items():
            if delay <= horizon:
                yield delay, Exact.of(tuple(top), layer.denominator)


def response(parts: list[tuple[float, Exact]], t: Any, degree: int) -> Any:
    """The response at t [s]; at a jump, its value after the jump."""
    value = mpf(0)
    for delay, exact in parts:
        late = mpf(t) - mpf(delay)
        if late > 0:
            value += exact.at(late, degree)
        elif (
            late == 0
            and degree == 1
            and exact.top
            and exact.top[0].order == exact.bottom[0].order
        ):
            value += mpf(exact.top[0].coefficient) / mpf(exact.bottom[0].coefficient)
    return value


# --- random functions ---------------------------------------------------------------------------------


def power(order: float) -> FractionalTransferFunction:
    return FractionalTransferFunction.power(order)


def lag(
    g: np.random.Generator, order: float, decades: float = 3.0
) -> FractionalTransferFunction:
    constant = 10.0 ** g.uniform(-decades, decades)
    return constant / (power(order) + constant)


def link(g: np.random.Generator) -> FractionalTransferFunction:
    order, natural = g.uniform(1.5, 2.0), 10.0 ** g.uniform(-1, 2)
    damped = power(order) + 10.0 ** g.uniform(-4, 0.5) * power(g.uniform(0.1, 1.2))
    return 1.56 * power(order) ** int(g.integers(0, 2)) / (damped + natural**2)


def near_integer(g: np.random.Generator) -> FractionalTransferFunction:
    order = int(g.integers(1, 3)) + float(g.choice([-1.0, 1.0])) * 10.0 ** g.uniform(
        -6, -1
    )
    return lag(g, order)


def polynomial(g: np.random.Generator) -> FractionalTransferFunction:
    """The reciprocal of a product of sums s^a + b, multiplied out: up to order 6.1,
    poles of any kind.
    """
    bottom = power(0.0)
    while bottom.numerator[0].order < 4.2:
        bottom = bottom * (power(g.uniform(0.2, 1.9)) + 10.0 ** g.uniform(-2, 2))
    return 1 / bottom


def unstable(g: np.random.Generator) -> FractionalTransferFunction:
    kind = int(g.integers(0, 3))
    if kind == 0:
        return 1 / (power(g.uniform(0.3, 1.5)) - 10.0 ** g.uniform(-2, 1))
    if kind == 1:
        return lag(g, g.uniform(2.01, 6.1), 2.0)
    return 1 / (
        laplace**2 - 10.0 ** g.uniform(-3, 0) * laplace + 10.0 ** g.uniform(-1, 2)
    )


def biproper(g: np.random.Generator) -> FractionalTransferFunction:
    order = g.uniform(0.1, 1.95)
    return (g.uniform(0.2, 3) * power(order) + g.uniform(0, 5)) / (
        power(order) + 10.0 ** g.uniform(-2, 3)
    )


def singular(g: np.random.Generator) -> FractionalTransferFunction:
    return (
        lag(g, g.uniform(0.1, 1.9))
        / power(g.uniform(0.02, 2.5))
        * (1 + g.integers(0, 2) / laplace)
    )


def stiff(g: np.random.Generator) -> FractionalTransferFunction:
    orders = g.uniform(0.3, 1.5, 2)
    return lag(g, orders[0]) * 1e6 / (
        power(orders[1]) + 10.0 ** g.uniform(3, 6)
    ) + g.integers(0, 2) * lag(g, 1.0)


def multiple(g: np.random.Generator) -> FractionalTransferFunction:
    return 1 / (
        power(g.choice([0.3, 0.5, 0.9, 1.0])) + 10.0 ** g.uniform(-1, 1)
    ) ** int(g.integers(2, 5))


def loop(g: np.random.Generator) -> FractionalTransferFunction:
    controller = g.uniform(0.05, 2) + g.uniform(0, 1) / power(g.uniform(0.1, 1.2))
    return (controller * link(g) / (0.02 * laplace + 1)).feedback()


def delayed(g: np.random.Generator) -> FractionalTransferFunction:
    return link(g).delayed(10.0 ** g.uniform(-3, 0)) + float(g.integers(0, 2)) * lag(
        g, g.uniform(0.2, 1.9)
    )


def retarded(g: np.random.Generator) -> FractionalTransferFunction:
    return (
        (g.uniform(0.1, 1.5) * lag(g, g.uniform(0.6, 1.8), 1.0))
        .delayed(10.0 ** g.uniform(-1, 0.5))
        .feedback()
    )


KINDS: dict[str, Callable[[np.random.Generator], FractionalTransferFunction]] = {
    "power lag .02-1.99": lambda g: lag(g, g.uniform(0.02, 1.99), 5.0),
    "near an integer": near_integer,
    "link": link,
    "order to 6.1": polynomial,
    "unstable": unstable,
    "biproper": biproper,
    "singular at 0": singular,
    "stiff": stiff,
    "multiple poles": multiple,
    "closed loop": loop,
    "delayed": delayed,
    "retarded loop": retarded,
}
MODES = ("step", "impulse", "held", "linear", "long")


# --- one call -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """True error and estimate of one call, both relative to the response's peak."""

    kind: str
    mode: str
    method: str
    true: float
    claimed: float
    about: str


def attempt(kind: str, mode: str, seed: int) -> Outcome:
    """Make one random call and judge it at some of its times."""
    g = np.random.default_rng(seed)
    G = KINDS[kind](g)
    if mode in ("step", "impulse"):
        return _fixed(kind, mode, seed, G, g)
    return _sampled(kind, mode, seed, G, g)


def _fixed(
    kind: str,
    mode: str,
    seed: int,
    G: FractionalTransferFunction,
    g: np.random.Generator,
) -> Outcome:
    degree = 1 if mode == "step" else 0
    if kind == "retarded loop":
        found = (
            step_response(G, 10.0 ** g.uniform(-1, 1), 10.0 ** g.uniform(-3, -2))
            if degree
            else None
        )
        if found is None:
            return _sampled(kind, "held", seed, G, g)
        chosen = g.integers(0, len(found.time), 3)
        times = [mpf(int(k)) * mpf(found.period) for k in chosen]
    else:
        wide = g.random() < 0.3
        ends = (-9, 6) if wide else (-3, 2)
        given = np.sort(10.0 ** g.uniform(*ends, int(g.integers(1, 6))))
        respond = step_response if degree else impulse_response
        found = respond(G, given)
        chosen = np.unique(g.integers(0, len(given), 3))
        times = [mpf(given[k]) for k in chosen]
    parts = list(delay_series(G, float(max(times))))
    true = [
        abs(mpf(found.output[k]) - response(parts, t, degree))
        for k, t in zip(chosen, times, strict=True)
    ]
    return _outcome(kind, mode, found, float(max(true)), G, seed)


def _sampled(
    kind: str,
    mode: str,
    seed: int,
    G: FractionalTransferFunction,
    g: np.random.Generator,
) -> Outcome:
    """Inputs with a few changes of value (held) or of slope (linear) at random samples."""
    hold = (
        "first" if mode == "linear" or (mode == "long" and g.random() < 0.5) else "zero"
    )
    exponent = g.uniform(5, 6) if mode == "long" else g.uniform(0.3, 3.5)
    count, period = max(2, int(10.0**exponent)), 10.0 ** g.uniform(-5, -1)
    if kind == "retarded loop":
        count, period = int(10.0 ** g.uniform(0.5, 3)), 10.0 ** g.uniform(-3, -1)
    changes = np.unique(
        np.concatenate([[0], g.integers(0, count, int(g.integers(0, 3)))])
    )
    sizes = g.uniform(-1, 1, len(changes))
    k = np.arange(count)
    u = np.zeros(count)
    for at, size in zip(changes, sizes, strict=True):
        u += size * np.where(k >= at, 1.0 if hold == "zero" else (k - at) * period, 0.0)
    start = float(g.uniform(-1, 1)) if hold == "first" else 0.0
    u += start
    found = time_response(G, u, period, hold=hold)
    chosen = np.unique(np.concatenate([g.integers(0, count, 2), [count - 1]]))
    parts, true = list(delay_series(G, count * period)), []
    # Of the rounded samples, which are what the package gets.
    steps = np.diff(u, prepend=0.0)
    for i in chosen:
        exact = mpf(0)
        if hold == "zero":
            exact = mp.fsum(
                mpf(steps[j]) * response(parts, (int(i) - int(j)) * mpf(period), 1)
                for j in changes
                if j <= i
            )
        else:
            exact = mpf(start) * response(parts, int(i) * mpf(period), 1)
            exact += mp.fsum(
                mpf(size) * response(parts, (int(i) - int(j)) * mpf(period), 2)
                for j, size in zip(changes, sizes, strict=True)
                if j < i
            )
        true.append(abs(mpf(found.output[i]) - exact))
    # The oracle takes the slopes of a linear input as drawn, so that the rounding of the
    # samples counts as an error of the response.
    return _outcome(kind, mode, found, float(max(true)), G, seed)


def _outcome(
    kind: str, mode: str, found: Any, true: float, G: Any, seed: int
) -> Outcome:
    finite = found.output[np.isfinite(found.output)]
    peak = float(np.max(np.abs(finite), initial=0.0)) or 1.0
    about = f"{G} (seed {seed}, {len(found.output)} times to {found.time[-1]:.3g} s)"
    return Outcome(
        kind, mode, found.method, true / peak, found.error_estimate / peak, about
    )


def main() -> None:
    given = sizes(__doc__, calls=(2000, 24), seed=(20, 20))
    calls, seed = given.calls, given.seed
    begin, done, left = time.process_time(), [], collections.Counter()
    names = list(KINDS)
    for n in range(calls):
        kind, mode = names[n % len(names)], MODES[(n // len(names)) % len(MODES)]
        if mode == "long" and (n // len(names)) // len(MODES) % 4:
            mode = "linear"  # a million samples take a second: one call in twenty
        try:
            done.append(attempt(kind, mode, seed * 100_000 + n))
        except UnknownError:
            left[f"{kind}: the oracle has no answer"] += 1
        except (errors.FieldError, errors.NotConvergedError) as error:
            left[
                f"{kind}: refused, {getattr(error, 'problem', type(error).__name__)[:60]}"
            ] += 1
    report(done, left, time.process_time() - begin)


def report(done: list[Outcome], left: collections.Counter[str], seconds: float) -> None:
    tiny = 1.1e-16  # half the spacing of doubles at 1; a smaller error counts as this
    broken = [o for o in done if o.true > o.claimed]
    for title, key in (("kind", "kind"), ("mode", "mode"), ("method", "method")):
        for name in sorted({getattr(o, key) for o in done}):
            these = [o for o in done if getattr(o, key) == name]
            ratio = np.median([o.claimed / max(o.true, tiny) for o in these])
            worst = max(o.true / max(o.claimed, 1e-300) for o in these)
            print(
                f"{title:7s} {name:20s} {len(these):5d} calls, median claimed/true {ratio:9.3g}, "
                f"largest true/claimed {worst:9.3g}, median true {np.median([o.true for o in these]):.1e}"
            )
    for o in sorted(broken, key=lambda o: -o.true / max(o.claimed, 1e-300))[:40]:
        print(
            f"broken  {o.mode} {o.method}: true {o.true:.2e} claimed {o.claimed:.2e}: {o.about[:150]}"
        )
    for reason, count in left.most_common():
        print(f"left    {count:4d} {reason}")
    line(
        "calls whose true error exceeds the estimate",
        f"{len(broken)} of {len(done)}",
        "0",
        not broken,
    )
    ratio = float(np.median([o.claimed / max(o.true, tiny) for o in done]))
    line("estimate over true error, median", f"{ratio:.3g}", "<= 100", ratio <= 100)
    print(f"        {seconds:.0f} s of CPU time")


if __name__ == "__main__":
    main()
