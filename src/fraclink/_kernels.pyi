"""Types of the compiled kernels; each kernel's owner writes its own part, the rest is untyped."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

class Loops:
    """The loops of a table beside Ĉ; see csrc/kernels/figures.h."""

    def __init__(
        self,
        table: object,
        mode_points: int,
        doubt: float,
        radius: float,
        region: float,
        /,
    ) -> None: ...
    def figures(
        self, x: NDArray[np.float64], reference: float, order: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...

class FitProblem:
    """A log on its grid of rates; see csrc/kernels/fit.h."""

    def __init__(
        self,
        motion: NDArray[np.float64],
        measured: NDArray[np.float64],
        period: float,
        hold: int,
        grid_start: float,
        grid_step: float,
        modes: int,
        tail: int,
        pad: int,
        /,
    ) -> None: ...
    def columns(
        self, shape: NDArray[np.float64], mask: int, /
    ) -> NDArray[np.float64] | None: ...
    def grams(
        self, shapes: NDArray[np.float64], mask: int, /
    ) -> NDArray[np.float64]: ...
    def costs(
        self, shapes: NDArray[np.float64], gain: float, offset: float, /
    ) -> NDArray[np.float64]: ...
    def solve(
        self,
        start: NDArray[np.float64],
        mask: int,
        lower: NDArray[np.float64],
        upper: NDArray[np.float64],
        gain: float,
        offset: float,
        iterations: int,
        /,
    ) -> tuple[bool, NDArray[np.float64], float, float, float, NDArray[np.float64]]: ...

def __getattr__(name: str) -> Any: ...
