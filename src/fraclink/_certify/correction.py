"""The correction as the law's block has it: its modes, and the errors up to which its limits let it act."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fraclink.errors import FieldError

__all__ = ["LEAST_RANGE", "inside_circle", "linear_range", "modes_of"]

LEAST_RANGE = 1e-5  # [rad]: a law whose limits act on smaller errors than 10 µrad never corrects anything


def modes_of(coefficients: Mapping[str, Any]) -> list[tuple[complex, complex]]:
    """(pole, gain) of every mode of the correction, conjugates included."""
    real, pair = coefficients["real"], coefficients["pair"]
    found = [(complex(p), complex(g)) for p, g in zip(real[::2], real[1::2], strict=True) if g]
    for re, im, g, x in zip(*(pair[k::4] for k in range(4)), strict=True):
        if g or x:
            pole, gain = complex(re, im), complex(g, x) / 2
            found += [(pole, gain), (pole.conjugate(), gain.conjugate())]
    return found


def linear_range(coefficients: Mapping[str, Any]) -> float:
    """Return the tip error [rad] up to which no limit of the command acts, rounded down to two digits.

    For |e| ≤ X a state of mode p stays within X (1 + |1 − p|/(1 − |p|)) and the correction within X times
    2|d| + Σ|g| (1 + |1 − p|/(1 − |p|)): l1 norms, term by term. FieldError where a limit leaves less than
    `LEAST_RANGE`: such a law is not the filter that its modes describe.
    """
    c = coefficients
    norms = [(1 + abs(1 - p) / (1 - abs(p)) if abs(p) < 1 else math.inf, abs(g)) for p, g in modes_of(c)]
    gain = 2 * abs(c["direct"]) + sum(norm * g for norm, g in norms)
    command = min(c["sum_limit"], c["motor_limit"], c["motor_step"] / 2) / max(gain, 1e-300)
    reach = min(command, c["correction_limit"] / max([norm for norm, _ in norms] + [1.0])) * (1 - 1e-9)
    if not (math.isfinite(reach) and reach >= LEAST_RANGE):
        allowed = f"limits that errors of {LEAST_RANGE:g} rad do not meet"
        raise FieldError(
            "law.limits",
            reach,
            "too narrow for the correction",
            allowed=allowed,
            remedy="use the derived limits",
        )
    digit = 10.0 ** (math.floor(math.log10(reach)) - 1)
    return float(f"{math.floor(reach / digit) * digit:.2g}")


def inside_circle(coefficients: list[float]) -> bool:
    """Schur–Cohn: every reflection coefficient of a real polynomial below one in modulus, with room."""
    a = coefficients
    while len(a) > 1:
        if not abs(a[0]) * (1 - 1e-9) > abs(a[-1]):
            return False
        k = a[-1] / a[0]
        a = [a[i] - k * a[-1 - i] for i in range(len(a) - 1)]
    return True
