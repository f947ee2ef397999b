"""From a log to the kernel: increments of the input, grid of rates, hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._kernels import FitProblem
from fraclink._validate import checked_choice
from fraclink.errors import NotConvergedError

__all__ = ["Hold", "Window", "chosen_hold", "columns_of"]

Hold = Literal["auto", "zero", "first"]
Vector = NDArray[np.float64]

# The trapezoid rule in ln(rate) errs like exp(−π²/step): 3e-9 at 0.5, enough to find parameters to 1e-8.
_STEP = 0.5
_SCAN_STEP = 1.0  # 5e-5, for the scan only
_DEPTH = 12.2  # rates down to Ω·e^−12.2: what lies below weighs less than 1e-9
_REACH = 16.0  # rates above 16/Ts are gone within a sample (e^−16)
_TAIL = 6.0  # and above 16/Ts·e^6 nothing is left of them
_MODES_MAX = 64


def chosen_hold(motor_angle: Vector, hold: Hold) -> Literal["zero", "first"]:
    """What the input does between samples.

    A motor moves smoothly, so "auto" joins the samples by straight lines; a simulated command that jumps
    between two samples and rests before and after is held instead. Read as a ramp it would delay the link
    by half a sample, and λ pays for that.
    """
    checked_choice("hold", hold, ("auto", "zero", "first"))
    if hold != "auto":
        return hold
    steps = np.abs(np.diff(motor_angle, prepend=motor_angle[:1], append=motor_angle[-1:]))
    calm = np.maximum(steps[:-2], steps[2:]) <= 1e-3 * steps[1:-1]
    jumps = calm & (steps[1:-1] > 0.05 * np.ptp(motor_angle))
    return "zero" if steps[1:-1][jumps].sum() > 0.5 * steps.sum() > 0 else "first"


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of a log from its start, in the kernel's terms."""

    angle: Vector
    output: Vector
    period: float
    hold: Literal["zero", "first"]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.output.size

    @property
    def frequency_limits(self) -> tuple[float, float]:
        """Resonances [rad/s] that the log can show: a period and a half in it, six samples in a period."""
        return 3 * math.pi / (self.samples * self.period), math.pi / (3 * self.period)

    @property
    def is_rough(self) -> bool:
        """Whether noise (such as an encoder's steps) shows in the angle's increments.

        Noise of the samples makes neighbouring increments opposed, so that they resemble each other less
        than the next but one do; a motion's resemblance falls with every sample.
        """
        steps = np.diff(self.angle)
        return bool(steps[1:] @ steps[:-1] < steps[2:] @ steps[:-2])

    def increments(self) -> Vector:
        """Jump at each sample (held input) or slope after it; the link is at rest before the first one."""
        if self.hold == "zero":
            return np.diff(self.angle, prepend=self.angle[:1])
        return np.diff(self.angle, append=self.angle[-1:]) / self.period

    def kernel(self, resonance: float, *, longest_delay: float, coarse: bool = False) -> FitProblem:
        """The kernel with a grid of rates that serves resonances from `resonance` [rad/s] up."""
        step = _SCAN_STEP if coarse else _STEP
        start = math.log(resonance) - (_DEPTH if not coarse else 8.0)
        modes = math.ceil((math.log(_REACH / self.period) - start) / step)
        modes = min(max(modes, 4), _MODES_MAX - 4)
        pad = math.ceil(longest_delay / self.period) + 32
        return FitProblem(
            self.increments(),
            self.output,
            self.period,
            int(self.hold == "first"),
            start,
            step,
            modes,
            math.ceil(_TAIL / step),
            pad,
        )


def columns_of(kernel: FitProblem, shape: Vector, mask: int = 0) -> NDArray[np.float64]:
    """Output for unit gain and its derivatives for the coordinates in `mask`, shape (1 + k, N)."""
    columns = kernel.columns(shape, mask)
    if columns is None:
        raise NotConvergedError(
            "the vibration pole",
            reached=math.nan,
            wanted=0.0,
            remedy="give a model with a damping ratio below 0.9",
        )
    return columns
