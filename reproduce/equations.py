"""Each numbered equation evaluated at random points: as printed, by the code that
implements it, and independently.

    right     print and code agree with the independent expression at every point
    misprint  only the code agrees with the independent expression

The independent expression shares no algebra with the other two: it solves the physical
equations as a linear system, differentiates numerically, finds a crossover by
bisection, or maximises a modulus. The code of a row is the function named in
equations.toml; it is looked up by name and called, so a row with the wrong function or
the wrong verdict fails.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from reproduce.equations_control import CONTROL
from reproduce.equations_design import DESIGN
from reproduce.equations_model import MODEL
from reproduce.points import Check
from reproduce.published import Equation

__all__ = ["CHECKS", "TOLERANCE", "Found", "code_of", "measured"]

# numerical derivatives of a crossing found by bisection are accurate to 1e-9
TOLERANCE = 1e-7
_SEED = 60
CHECKS: Mapping[str, Check] = {**MODEL, **CONTROL, **DESIGN}


@dataclass(frozen=True)
class Found:
    """The largest relative difference of the print and of the code from the independent
    expression.
    """

    printed: float
    code: float

    @property
    def verdict(self) -> str:
        """Right, a misprint, or "wrong" if the code does not implement the equation."""
        if not self.code <= TOLERANCE:
            return "wrong"
        return "right" if self.printed <= TOLERANCE else "misprint"


def code_of(name: str) -> Any:
    """The object with a dotted name; AttributeError or ModuleNotFoundError if there is
    none.
    """
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            found = getattr(found, part)
        return found.fget if isinstance(found, property) else found
    raise ModuleNotFoundError(name)


def measured(equation: Equation) -> Found:
    """Evaluate the three sides of an equation at its random points, which are the same
    on every run.
    """
    check, code = CHECKS[equation.number], code_of(equation.code)
    draw = np.random.default_rng([_SEED, int(equation.number.strip("()"))])
    printed, own = 0.0, 0.0
    for _ in range(check.points):
        first, second, true = (
            np.atleast_1d(np.asarray(side, dtype=complex)).ravel()
            for side in check.sides(code, draw)
        )
        # An element equal to zero is compared with the largest element.
        size = np.maximum(np.abs(true), 1e-9 * float(np.max(np.abs(true))))
        size[size == 0.0] = 1.0
        printed = max(printed, float(np.max(np.abs(first - true) / size)))
        own = max(own, float(np.max(np.abs(second - true) / size)))
    return Found(printed, own)
