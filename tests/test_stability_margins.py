"""Margins against closed forms, polynomial roots, root finding with 30 digits and dense
grids.
"""

from __future__ import annotations

import math
import re

import control
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink.errors import FieldError
from fracsys import FractionalTransferFunction, Margins, is_stable, margins, s

K, BETA, W = 0.148, 0.65, 10.0


def link_loop(
    order: float, gain: float = K, beta: float = BETA
) -> FractionalTransferFunction:
    return gain * s**beta * W**2 / (s**order + W**2)


def exact_crossings(
    order: float, gain: float = K, beta: float = BETA
) -> tuple[list[float], list[float]]:
    """Frequencies and phase margins of the crossovers of the link loop, to 30 digits."""
    with mpmath.workdps(30):
        k, b, a, w2 = (mpmath.mpf(v) for v in (gain, beta, order, W**2))

        def loop(w: mpmath.mpf) -> mpmath.mpc:
            jw = mpmath.mpc(0, w)
            return k * jw**b * w2 / (jw**a + w2)

        def level(w: mpmath.mpf) -> mpmath.mpf:
            return mpmath.log(abs(loop(w)))

        peak = w2 ** (1 / a)
        low = mpmath.findroot(level, (peak / 100, peak), solver="anderson", tol=1e-50)
        high = mpmath.findroot(level, (peak, peak * 100), solver="anderson", tol=1e-50)
        return [float(low), float(high)], [
            float(mpmath.arg(-loop(w))) for w in (low, high)
        ]


@pytest.mark.parametrize("order", [1.5, 1.7, 1.92, 1.99, 1.999, 1.999999])
@pytest.mark.parametrize("as_callable", [False, True])
def test_both_crossings_of_the_link_loop(order: float, as_callable: bool) -> None:
    loop = link_loop(order)
    found = margins((lambda z: loop(z)) if as_callable else loop)
    frequency, phase = exact_crossings(order)
    assert len(found.gain_crossings) == 2
    for crossing, w, p in zip(found.gain_crossings, frequency, phase, strict=True):
        assert crossing.frequency == pytest.approx(w, rel=1e-12)
        assert crossing.phase_margin == pytest.approx(p, abs=1e-11)
        assert crossing.delay_margin == pytest.approx(
            (p % (2 * math.pi)) / w, rel=1e-11
        )


@pytest.mark.parametrize("as_callable", [False, True])
def test_undamped_link_has_a_pole_on_the_axis(as_callable: bool) -> None:
    """k ω^β ω₀² = |ω₀² − ω²| on both sides of the pole."""
    loop = link_loop(2.0)
    found = margins((lambda z: loop(z)) if as_callable else loop, unstable_poles=0)
    with mpmath.workdps(30):
        k, b, w2 = mpmath.mpf(K), mpmath.mpf(BETA), mpmath.mpf(W**2)
        low = mpmath.findroot(
            lambda w: k * w**b * w2 - (w2 - w**2),
            (1, 9.9),
            solver="anderson",
            tol=1e-50,
        )
        high = mpmath.findroot(
            lambda w: k * w**b * w2 - (w**2 - w2),
            (10.1, 40),
            solver="anderson",
            tol=1e-50,
        )
    assert [c.frequency for c in found.gain_crossings] == pytest.approx(
        [float(low), float(high)], rel=1e-12
    )
    lead = 0.5 * math.pi * BETA
    assert [c.phase_margin for c in found.gain_crossings] == pytest.approx(
        [lead - math.pi, lead], abs=1e-12
    )
    assert found.stable is True


def test_the_papers_printed_loop_is_unstable() -> None:
    """Eq. (58) at 30 g: −7.34° at the upper crossing (ECOSYSTEM, checked here in 30
    digits), unstable.
    """
    w = 10.31
    loop = 0.148 * s**0.65 / (1 + 0.16 * s) ** 2 * w**2 / (s**1.92 + w**2)
    found = margins(loop)
    assert len(found.gain_crossings) == 2
    assert math.degrees(found.phase_margin) == pytest.approx(-7.3439, abs=1e-3)
    assert found.stable is False
    assert not is_stable(loop.feedback())


@pytest.mark.parametrize("gain", [4.0, 6.0 - 1e-9, 6.0 + 1e-9, 7.0, 0.01])
@pytest.mark.parametrize("as_callable", [False, True])
def test_a_textbook_loop(gain: float, as_callable: bool) -> None:
    """k/(s(s+1)(s+2)): phase crossing √2, gain margin 6/k, unstable above 6."""
    loop = gain / (s * (s + 1) * (s + 2))
    found = margins((lambda z: loop(z)) if as_callable else loop, unstable_poles=0)
    (phase,) = found.phase_crossings
    assert phase.frequency == pytest.approx(math.sqrt(2), rel=1e-13)
    assert phase.gain_margin == found.gain_margin == pytest.approx(6 / gain, rel=1e-13)
    roots = np.roots([1, 0, 5, 0, 4, 0, -(gain**2)])  # ω²(ω²+1)(ω²+4) = k²
    (crossing,) = found.gain_crossings
    assert crossing.frequency == pytest.approx(
        roots[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)].real[0]
    )
    assert found.stable is (gain < 6)


def test_delay_crossings_are_complete() -> None:
    """10 e^(−0.1s)/(s+1): arg = −0.1ω − atan ω = −π(2m+1)."""
    loop = (10 / (s + 1)).delayed(0.1)
    for given_loop in (loop, lambda z: loop(z)):
        found = margins(given_loop, unstable_poles=0)
        seen = [c for c in found.phase_crossings if c.gain_margin < 900]
        for m, crossing in enumerate(seen):
            w = crossing.frequency
            assert 0.1 * w + math.atan(w) == pytest.approx(
                math.pi * (2 * m + 1), rel=1e-12
            )
        assert len(seen) > 100
        assert found.stable is True
        assert found.gain_crossings[0].frequency == pytest.approx(
            math.sqrt(99), rel=1e-13
        )
        assert found.delay_margin == pytest.approx(
            (math.pi - math.atan(math.sqrt(99))) / math.sqrt(99) - 0.1
        )


def test_a_delay_in_a_loop_that_rolls_off_slowly() -> None:
    """10/√s with a delay is above −60 dB up to 1e8 rad/s: crossings are listed as far
    as they are relevant.
    """
    loop = (10 / s**0.5).delayed(0.1)
    found = margins(loop)
    assert found.gain_crossover == pytest.approx(100.0)
    for m, crossing in enumerate(found.phase_crossings):
        assert 0.1 * crossing.frequency + math.pi / 4 == pytest.approx(
            math.pi * (2 * m + 1), rel=1e-12
        )
    assert len(found.phase_crossings) > 10
    assert found.stable is False


def test_more_delay_than_the_delay_margin_destabilises() -> None:
    loop = link_loop(1.92)
    spare = min(c.delay_margin for c in margins(loop).gain_crossings)
    assert margins(loop.delayed(spare * 0.999)).stable is True
    assert margins(loop.delayed(spare * 1.001)).stable is False


@pytest.mark.slow
def test_a_peak_just_above_one_is_not_missed() -> None:
    """The two crossovers next to a peak of 1 + 1e-9 are 1e-5 apart, far less than the
    spacing of any grid.
    """
    plain = link_loop(1.7, gain=1.0)
    x = np.linspace(math.log(5), math.log(30), 400_001)
    peak = np.abs(plain(1j * np.exp(x))).max()
    for factor, count in ((1 + 1e-9, 2), (1 - 1e-9, 0)):
        found = margins(link_loop(1.7, gain=factor / peak))
        assert len(found.gain_crossings) == count
        (seen,) = {len(margins(lambda z, g=factor / peak: g * plain(z)).gain_crossings)}
        assert seen == count


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(25))
def test_modulus_margin_against_a_dense_grid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0.3, 2.2), rng.uniform(0.1, 0.9)
    gain, zero, middle = rng.uniform([0.1, 0.1, 0.1], [30, 3, 3])
    loop = gain * (s**b + zero) / (s ** (a + b) + middle * s**b + 1)
    found = margins(loop)
    w = np.geomspace(1e-4, 1e5, 400_001)
    value = loop(1j * w)
    distance = np.abs(1 + value)
    i = int(distance.argmin())
    assert found.modulus_margin <= distance[i] * (1 + 1e-12)
    if 0 < i < len(w) - 1:
        assert found.modulus_margin == pytest.approx(distance[i], rel=1e-6, abs=1e-7)
        assert found.modulus_frequency == pytest.approx(w[i], rel=1e-3)
    else:  # 1 + L(∞) = 1 is approached from above
        assert (found.modulus_margin, found.modulus_frequency) == (1.0, math.inf)
    assert found.sensitivity_peak == pytest.approx(1 / found.modulus_margin)
    assert len(found.gain_crossings) == np.count_nonzero(np.diff(np.abs(value) > 1))


@pytest.mark.slow
@given(
    st.lists(st.floats(0.1, 5), min_size=1, max_size=3),
    st.lists(st.floats(0.1, 5) | st.floats(-3, -0.1), min_size=2, max_size=4),
    st.floats(-20, 20).filter(lambda k: abs(k) > 0.05),
)
@settings(max_examples=200, deadline=None)
def test_stability_agrees_with_closed_loop_roots(
    zeros: list[float], poles: list[float], gain: float
) -> None:
    top, bottom = gain * np.poly(-np.array(zeros)), np.poly(-np.array(poles))
    if len(top) > len(bottom):
        top = gain * np.poly(-np.array(zeros[: len(poles)]))
    closed = np.roots(np.polyadd(top, bottom))
    if len(closed) < len(bottom) - 1 or np.min(np.abs(closed.real)) < 1e-4:
        return
    if len(top) == len(bottom) and abs(top[0] + bottom[0]) < 1e-2:
        return  # L(∞) = −1: the closed loop is not proper

    def polynomial(c: np.ndarray) -> FractionalTransferFunction:
        total = 0 * s
        for k, value in enumerate(c):
            total = total + float(value) * s ** (len(c) - 1 - k)
        return total

    loop = polynomial(top) / polynomial(bottom)
    expected = bool(np.all(closed.real < 0))
    unstable = int(np.sum(np.array(poles) < 0))
    assert margins(loop).stable is expected
    assert margins(lambda z: loop(z), unstable_poles=unstable).stable is expected


@pytest.mark.parametrize(
    ("loop", "stable"),
    [
        (1 / s**2, False),
        ((s + 1) / s**2, True),
        (1 / s**0.5, True),
        (1 / s**1.9, True),
        (1 / s**2.1, False),
        ((s + 1) ** 2 / s**3, True),
        (0.4 * (s + 1) ** 2 / s**3, False),
        (2 / (s - 1), True),
        (0.5 / (s - 1), False),
        (s**0.65, True),
        (-2 / (s + 1), False),
        (-0.5 / (s + 1), True),
        (0.148 * s**0.65 * 100 / (s**2 + 100), True),
        (-0.148 * s**0.65 * 100 / (s**2 + 100), False),
    ],
)
def test_stability_with_integrators_and_poles_on_the_axis(
    loop: FractionalTransferFunction, stable: bool
) -> None:
    assert margins(loop).stable is stable
    assert bool(is_stable(loop.feedback())) is stable


def test_limit_cuts_the_range() -> None:
    assert len(margins(link_loop(1.92), limit=10.0).gain_crossings) == 1
    assert len(margins(lambda z: link_loop(1.92)(z), limit=10.0).gain_crossings) == 1


def test_a_sampled_python_control_system_stops_at_nyquist() -> None:
    plant = control.c2d(control.tf([2.0], [1.0, 1.0]), 0.1)
    found = margins(plant, unstable_poles=0)
    pole, level = math.exp(-0.1), 2 * (1 - math.exp(-0.1))
    cosine = (1 + pole**2 - level**2) / (2 * pole)  # |e^(jθ) − p| = level
    assert found.gain_crossings[0].frequency == pytest.approx(
        math.acos(cosine) / 0.1, rel=1e-12
    )
    assert found.stable is True
    assert found.modulus_frequency <= math.pi / 0.1 * (1 + 1e-12)


def test_an_integer_python_control_system() -> None:
    found = margins(control.tf([4.0], [1.0, 3.0, 2.0, 0.0]), unstable_poles=0)
    assert found.gain_margin == pytest.approx(1.5, rel=1e-9)


def test_nothing_to_find() -> None:
    empty = margins(0.1 / (s + 1))
    assert empty.gain_crossings == () and empty.critical is None
    assert math.isnan(empty.gain_crossover)
    assert empty.phase_margin == empty.delay_margin == empty.gain_margin == math.inf
    assert empty.stable is True
    zero = margins(0 * s)
    assert zero.modulus_margin == 1.0
    assert isinstance(zero, Margins)


@pytest.mark.parametrize(
    ("loop", "options", "field"),
    [
        (3.0, {}, "loop"),
        (link_loop(1.9), {"limit": -1.0}, "limit"),
        (link_loop(1.9), {"limit": math.nan}, "limit"),
        (link_loop(1.9), {"limit": 10**400}, "limit"),
        (link_loop(1.9), {"limit": "785"}, "limit"),
        (lambda z: 1.0, {}, "loop"),
        (lambda z: z * math.nan, {}, "loop"),
        (lambda z: 10 * np.exp(-z), {}, "limit"),
    ],
)
def test_bad_input(loop: object, options: dict[str, float], field: str) -> None:
    with pytest.raises(FieldError) as caught:
        margins(loop, **options)  # type: ignore[arg-type]
    assert caught.value.field == field


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_encirclements_agree_with_the_certified_count(seed: int) -> None:
    """Two methods: arg(1 + L) along the sweep, and the argument principle on the
    closed-loop denominator.
    """
    rng = np.random.default_rng(1000 + seed)
    orders = np.sort(rng.uniform(0.1, 3.0, 3))
    a, b, c = orders
    shift, middle = rng.uniform([-1.0, 0.1], [3.0, 3.0])
    loop = (
        rng.uniform(-5, 30)
        * (s ** (0.5 * a) + rng.uniform(0.1, 2))
        / (s**c + middle * s**b + shift)
    )
    if seed % 3 == 0:
        loop = loop / s ** rng.uniform(0.2, 1.2)
    if seed % 2:
        loop = loop.delayed(rng.uniform(0.01, 0.5))
    found = margins(loop)
    assert found.stable is not None
    if found.modulus_margin > 1e-6:
        assert found.stable is bool(is_stable(loop.feedback()))


def test_a_negative_phase_margin_needs_the_long_way_round_to_the_point() -> None:
    found = margins(9 / (s * (s + 1) * (s + 2)))
    (crossing,) = found.gain_crossings
    assert crossing.phase_margin < 0
    assert crossing.delay_margin == pytest.approx(
        (crossing.phase_margin + 2 * math.pi) / crossing.frequency
    )
    assert found.critical == crossing
    assert found.phase_margin == crossing.phase_margin


@pytest.mark.parametrize(
    ("gain", "poles", "verdict"),
    [(4.0, 0, "stable"), (7.0, 0, "not stable"), (4.0, None, "not decided")],
)
def test_printed_margins_end_with_their_verdict(
    gain: float, poles: int | None, verdict: str
) -> None:
    found = margins(lambda s: gain / (s * (s + 1) * (s + 2)), unstable_poles=poles)
    table, _, last = str(found).rpartition("closed loop")
    assert last.strip().startswith(verdict)
    assert len(table.splitlines()) == 3  # a crossing of either kind, and the distance


def test_a_callable_that_gives_no_number_says_where() -> None:
    with pytest.raises(FieldError, match="not a number at") as refused:
        margins(lambda z: np.where(z.imag > 10.0, np.nan, 1 / (z + 1)))
    place = float(re.search(r"not a number at (\S+) rad/s", str(refused.value))[1])  # type: ignore[index]
    assert 10.0 < place < 12.5
    with pytest.raises(FieldError, match="another shape"):
        margins(lambda z: z[:-1])
