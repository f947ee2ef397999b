"""Rejected requests: every message names field, value, range and remedy, and nothing is
allocated.
"""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest

from fraclink.errors import FieldError, SizeError
from fracsys import (
    approximate,
    discrete_modes,
    impulse_response,
    s,
    step_response,
    time_response,
)

LINK = 100 / (s**1.92 + 100)
RECYCLED = (1 / s).feedback((1 + 0 * s).delayed(1.0))


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: time_response(s**0.1, [1.0], 0.1), "relative_degree"),
        (lambda: step_response(s, 1.0, 0.1), "relative_degree"),
        (lambda: discrete_modes(s, 0.1, span=1.0), "relative_degree"),
        (lambda: time_response(LINK, [[1.0]], 0.1), "u"),
        (lambda: time_response(LINK, ["1"], 0.1), "u"),
        (lambda: time_response(LINK, [1j], 0.1), "u"),
        (lambda: time_response(LINK, [1.0, math.nan], 0.1), "u"),
        (lambda: time_response(LINK, [1.0, -math.inf], 0.1), "u"),
        (lambda: time_response(LINK, [1.0], 0.0), "period"),
        (lambda: time_response(LINK, [1.0], -0.1), "period"),
        (lambda: time_response(LINK, [1.0], 10**400), "period"),
        (lambda: approximate(s**0.5, (0.1, 10.0), 2.5), "order"),
        (lambda: time_response(LINK, [1.0], math.nan), "period"),
        (lambda: time_response(LINK, [1.0], "4 ms"), "period"),  # type: ignore[arg-type]
        (lambda: time_response(LINK, [1.0], 1e-13), "period"),
        (lambda: time_response(LINK, [1.0], 0.1, hold="linear"), "hold"),
        (lambda: step_response(LINK, 1.0), "period"),
        (lambda: step_response(LINK, [0.0, 1.0], 0.1), "period"),
        (lambda: step_response(LINK, -1.0, 0.1), "time"),
        (lambda: step_response(LINK, [-1.0]), "time"),
        (lambda: step_response(LINK, [math.nan]), "time"),
        (lambda: step_response(LINK, []), "time"),
        (lambda: impulse_response(RECYCLED, 1.0, 0.1), "time"),
        (lambda: step_response(RECYCLED, [0.0, 0.5]), "time"),
        (lambda: discrete_modes(LINK, 0.1, span=0.05), "span"),
        (lambda: discrete_modes(LINK, 0.1, span=math.inf), "span"),
        (lambda: discrete_modes(LINK, 0.1, span=1.0, tolerance=1e-20), "tolerance"),
        (lambda: discrete_modes(LINK / s**1.5, 0.1, span=1.0), "order"),
        (lambda: discrete_modes(LINK + LINK.delayed(0.1), 0.1, span=1.0), "delay"),
        (lambda: time_response(1 / (s - 5), np.ones(1000), 1.0), "span"),
        (lambda: step_response(1 / (s**1.5 - 5), [1e4]), "span"),
        (lambda: time_response(1 / (s**3.002 - 596 * s**3), [1.0], 1.0), "denominator"),
        (lambda: discrete_modes(RECYCLED, 0.1, span=1.0), "delay"),
        (lambda: time_response(1 / (s.delayed(1.0) + 1), [1.0], 0.1), "delay"),
    ],
)
def test_refused(call, field: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(FieldError) as caught:
        call()
    error = caught.value
    assert error.field == field
    assert error.allowed
    assert error.remedy


@pytest.mark.parametrize("duration", [1e9, 1e300])
def test_b51_beyond_memory_is_refused_before_anything_is_allocated(
    duration: float,
) -> None:
    tracemalloc.start()
    with pytest.raises(SizeError, match="too many samples"):
        step_response(LINK, duration, 1e-6)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6


def test_b51_beyond_memory_of_the_inversion(monkeypatch: pytest.MonkeyPatch) -> None:
    small = {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": 100}
    monkeypatch.setattr("os.sysconf", small.__getitem__)
    with pytest.raises(SizeError):
        time_response(RECYCLED, np.ones(1000), 0.1)
    assert time_response(LINK, np.ones(1000), 0.1).method == "modes"
