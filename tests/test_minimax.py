"""The kernel of the minimax fractions: where it stops, no parameter lowers the norm;
what it refuses.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fracsys._minimax import (
    PartialFractions,
    Target,
    best_residues,
    improve,
    log_spaced_start,
    score,
)

OMEGA = np.geomspace(0.01, 100.0, 90)


def _target() -> Target:
    """A half-order slope through a resonance: real poles and a pair are both of use."""
    wanted = np.sqrt(1j * OMEGA) / (1.0 + (1j * OMEGA) ** 1.8 / 9.0)
    factor, one = 1j * OMEGA / (1.0 + 1j * OMEGA), np.ones(OMEGA.size)
    return Target(OMEGA, factor, wanted, 1.0 / (1.0 + wanted), 80.0 * one, 60.0 * one)


def _norm(fit: PartialFractions, target: Target, power: int) -> float:
    """(Σ |e|^p)^(1/p), formed from the fractions' own definition."""
    x, r = 1j * OMEGA, np.full(OMEGA.size, fit.direct, dtype=complex)
    for log, gain in zip(fit.real_logs, fit.real_gains, strict=True):
        r += gain * np.exp(log) / (x + np.exp(log))
    for log, eta, gain in zip(
        fit.pair_logs, fit.pair_angles, fit.pair_gains, strict=True
    ):
        q = np.exp(log + 0.5j * np.pi * np.tanh(eta))
        r += 0.5 * (gain * q / (x + q) + np.conj(gain) * np.conj(q) / (x + np.conj(q)))
    error = (target.factor * r - target.wanted) * target.turn
    rows = np.abs(
        np.concatenate(
            [error.real * target.weight_real, error.imag * target.weight_imag]
        )
    )
    return float(rows.max() * np.sum((rows / rows.max()) ** power) ** (1.0 / power))


def _moved(fit: PartialFractions, step: float) -> list[PartialFractions]:
    """The fractions with one parameter moved by `step` (relative to the residues for
    these), each in turn.
    """
    scale = step * max(1.0, float(np.max(np.abs(fit.linear()))))
    made = [replace(fit, direct=fit.direct + scale)]
    for name, by in (
        ("real_logs", step),
        ("pair_logs", step),
        ("pair_angles", step),
        ("real_gains", scale),
    ):
        for i in range(len(getattr(fit, name))):
            values = getattr(fit, name).copy()
            values[i] += by
            made.append(replace(fit, **{name: values}))
    for turned in (scale, 1j * scale):
        made += [
            replace(
                fit, pair_gains=fit.pair_gains + turned * np.eye(len(fit.pair_gains))[i]
            )
            for i in range(len(fit.pair_gains))
        ]
    return made


@pytest.mark.parametrize(("reals", "pairs"), [(3, 0), (2, 1), (1, 1), (0, 1)])
@pytest.mark.parametrize("power", [2, 8, 64])
def test_no_parameter_lowers_the_norm_where_newton_stops(
    reals: int, pairs: int, power: int
) -> None:
    target = _target()
    ladder = tuple(p for p in (2, 4, 8, 16, 32, 64) if p <= power)
    fit = log_spaced_start(OMEGA[0], OMEGA[-1], reals, pairs)
    for _ in range(
        4
    ):  # a ladder ends within 1e-4; again from there, so that the slopes vanish
        fit = best_residues(fit, target).improved(target, ladder)
    for _ in range(12):
        fit = fit.improved(target, (power,))
    reached = _norm(fit, target, power)
    for step in (1e-3, -1e-3):
        # What is left of a slope lowers the norm by less than the kernel's own end,
        # 1e-4 of it.
        assert min(
            _norm(there, target, power) for there in _moved(fit, step)
        ) > reached * (1.0 - 1e-4)


def test_the_ladder_lowers_the_worst_error() -> None:
    target = _target()
    start = best_residues(log_spaced_start(OMEGA[0], OMEGA[-1], 2, 1), target)
    worst = [score(start, target), score(improve(start, target, (2,)), target)]
    worst += [score(improve(start, target, (2, 4, 8, 16, 32, 64, 128)), target)]
    assert worst[2] < worst[1] < worst[0]


def test_an_exact_fraction_is_kept() -> None:
    exact = PartialFractions(
        0.5,
        np.log([0.3, 4.0]),
        np.array([1.0, -2.0]),
        np.log([12.0]),
        np.array([0.6]),
        np.array([0.7 - 0.2j]),
    )
    target = _target()
    target = replace(
        target, wanted=target.factor * (exact.columns(target.x) @ exact.linear())
    )
    start = best_residues(
        replace(exact, real_logs=exact.real_logs + np.array([0.1, -0.2])), target
    )
    found = start.improved(target, (2, 4, 8, 16))
    assert score(found, target) < 1e-6
    assert found.real_logs == pytest.approx(exact.real_logs, abs=1e-6)
