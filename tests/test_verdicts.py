"""All verdicts about one closed loop agree: poles, stability, margins,
response.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from fraclink import errors
from fracsys import (
    FractionalTransferFunction,
    is_stable,
    margins,
    poles,
    s,
    step_response,
)


def random_loop(generator: np.random.Generator) -> FractionalTransferFunction:
    """Lags of any order, some unstable; half of them delayed, some biproper (then the
    loop is neutral).
    """
    loop = 10.0 ** generator.uniform(-1.5, 1.5) + 0 * s
    for _ in range(int(generator.integers(1, 4))):
        constant = 10.0 ** generator.uniform(-1, 1)
        sign = 1.0 if generator.random() < 0.85 else -1.0
        loop = (
            loop
            * constant
            / (s ** float(generator.uniform(0.1, 1.9)) + sign * constant)
        )
    shape = generator.random()
    if shape < 0.3:
        loop = loop / s ** float(generator.uniform(0.1, 1.5))
    elif shape < 0.5:
        loop = loop * (1 + float(generator.uniform(0.01, 2)) * s**loop.relative_degree)
    return (
        loop.delayed(10.0 ** generator.uniform(-2, 0.5))
        if generator.random() < 0.5
        else loop
    )


def verdicts(loop: FractionalTransferFunction) -> dict[str, bool]:
    """The statement of each function about the closed loop; a refusal counts as no
    verdict.
    """
    closed, said = loop.feedback(), {}
    try:
        said["is_stable"] = is_stable(closed).stable
    except errors.FieldError:
        return {}
    for name, options in (("margins", {}), ("margins with limit", {"limit": 50.0})):
        try:
            stable = margins(loop, **options).stable  # type: ignore[arg-type]
        except errors.FieldError:
            continue
        if stable is not None:
            said[name] = stable
    if not any(t.delay for t in closed.denominator):
        grows = closed.denominator[-1].order > closed.numerator[-1].order
        said["poles"] = bool(np.all(poles(closed).real < 0.0)) and not grows
    return said


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_all_verdicts_about_a_random_loop_agree(seed: int) -> None:
    said = verdicts(random_loop(np.random.default_rng(seed)))
    assert len(set(said.values())) <= 1, said


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.5, 0.99, 1.01, 3.0])
def test_all_verdicts_about_a_neutral_loop_agree(gain: float) -> None:
    """Its chain of poles is to the left of the axis if the delayed direct path has a
    gain below 1.
    """
    loop = (gain * (s + 2) / (s + 10)).delayed(1.0)
    said = verdicts(loop)
    assert said["is_stable"] is said["margins with limit"] is (gain < 1.0)
    assert said.get("norm", gain < 1.0) is (gain < 1.0)
    with pytest.raises(errors.FieldError, match="jumps anew"):
        step_response(loop.feedback(), 4.0, 0.01)


@pytest.mark.parametrize("seed", range(12))
def test_the_step_response_of_a_stable_loop_settles_and_of_an_unstable_one_grows(
    seed: int,
) -> None:
    closed = random_loop(np.random.default_rng(700 + seed)).feedback()
    if (
        any(t.delay for t in closed.denominator)
        or closed.denominator[-1].order > closed.numerator[-1].order
    ):
        closed = (2.0 / (s ** (1.0 + 0.15 * seed) + 1.0)).feedback()
    dominant = poles(closed)
    slowest = float(np.abs(dominant.real).min()) if dominant.size else 1.0
    late = step_response(closed, [30.0 / slowest, 60.0 / slowest]).output
    settled = abs(late[1] - late[0]) < 0.5 * max(1.0, abs(late[0]))
    assert settled == is_stable(closed).stable


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_all_verdicts_about_a_sampled_loop_agree(seed: int) -> None:
    """L(z) with poles inside the unit circle, or one on or outside it, against the
    poles of the closed loop.
    """
    generator = np.random.default_rng(seed)
    period, size = 10.0 ** generator.uniform(-3, 0), int(generator.integers(1, 5))
    open_poles = generator.uniform(-0.5, 0.97, size)
    open_poles[0] = {0: 1.0, 1: 1.2}.get(seed % 4, open_poles[0])
    zeros = generator.uniform(-0.8, 0.9, int(generator.integers(0, size)))
    gain = 10.0 ** generator.uniform(-2, 0.7)
    top, bottom = gain * np.atleast_1d(np.poly(zeros)), np.poly(open_poles)
    closed = np.roots(np.polyadd(bottom, top))
    if np.abs(np.abs(closed) - 1.0).min() < 1e-6:
        return
    stable = bool(np.abs(closed).max() < 1.0)

    def loop(at: np.ndarray) -> np.ndarray:
        z = np.exp(at * period)
        return np.asarray(np.polyval(top, z) / np.polyval(bottom, z))

    outside = int((np.abs(open_poles) > 1.0).sum())
    known: dict[str, Any] = {"limit": math.pi / period, "unstable_poles": outside}
    # A pole on the unit circle is a pole at s = 0 of the callable, which does not state
    # it.
    if seed % 4:
        assert margins(loop, **known).stable is stable
