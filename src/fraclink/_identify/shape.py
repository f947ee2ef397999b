"""The coordinates of a fit, their conversion to the parameters of a link, and the log
in the form of the kernel.

A shape is (λ, ln Ω, ζ, α, τ): order of inertia, logarithm of the resonance [rad/s],
damping ratio there, order of the damping, delay [s]. With S = sin(απ/2), C = cos(απ/2)

    μ = 2ζ Ω^(λ−α) / S,    ω₀² = Ω^λ (1 − 2ζ C/S).

In (ω₀, μ, α) a fit of fractional damping moves along a valley, since these three
numbers describe one resonance and one width; in (Ω, ζ, α) the valley is the α axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import FRACTIONAL, STRUCTURES, LinkModel
from fraclink._kernels import FitProblem
from fraclink.errors import NotConvergedError
from fracsys.checks import Real

Hold = Literal["auto", "zero", "first"]

# The coordinate that belongs to each parameter; the row of a structure in
# fraclink._arm.link states which are free.
COORDINATE = {
    name: place
    for place, name in enumerate(
        ("order", "natural_frequency", "damping", "damping_order", "delay")
    )
}
NAMES = ("natural_frequency", "order", "damping", "damping_order", "delay")
# At λ = 1 the vibration pole lies on the branch cut, and there is no vibration to
# identify.
ORDER_LIMITS = (1.01, 2.0)
# Beyond these limits s^α is a stiffness (0) or an inertia (2). The lower limit is so
# small that a fractional link with λ = 2 − α is included up to λ = 1.9999.
ALPHA_LIMITS = (1e-4, 1.9)

# Samples before a cut that are simulated, or three lengths of the log if that is more.
# The limit bounds the cost, since physics gives none that is short enough: for a link
# of ζ = 0.02 cut to its last 2 s of 32 s, the delay is 15 ms off with a history of
# three lengths.
HISTORY = 200_000

LEAST_SAMPLES = 50  # of a fit

DIGITS = 8.0  # of the response, for parameters to 1e-8
_TAIL = 6.0  # rates e^6 above those that decay within a sample are negligible
_MODES_MAX = 64


def mask_of(free: Sequence[int]) -> int:
    """Bit mask of the free coordinates for the kernel."""
    return sum(1 << i for i in free)


def special_cases(name: str) -> list[str]:
    """Structures that are special cases of this one, in the order of the table.

    The undamped link of order λ is a special case of every link with a free α: see
    `embedded`.
    """
    free = set(STRUCTURES[name].free)
    return [
        row.name
        for row in STRUCTURES.values()
        if set(row.free) < free or ("damping_order" in free and row.name == FRACTIONAL)
    ]


def embedded(shape: Real, name: str) -> Real:
    """The shape of a special case in the coordinates of the structure `name`.

    The undamped link of order λ is a link with fractional damping, ω₀ = 0: times s^α with
    α = 2 − λ its denominator s^λ + ω₀² is s² + μ s^α, where μ is the old ω₀².
    """
    order, place, *_, delay = shape.tolist()
    if order >= 2 or "order" in STRUCTURES[name].free:
        return shape
    other = min(max(2 - order, ALPHA_LIMITS[0]), ALPHA_LIMITS[1])
    place += math.log(math.cos(other * math.pi / 2)) / order
    return np.array([2.0, place, largest_ratio(other), other, delay])


def lowest_valleys(costs: Real, count: int) -> NDArray[np.int_]:
    """Indices of the lowest local minima, the lowest first; a plateau next to a minimum
    does not count separately.
    """
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    valleys = np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]))
    return valleys[np.argsort(costs[valleys])][:count]


def link_parameters(shapes: Real) -> tuple[Real, Real]:
    """(ω₀², λ, μ, α, τ) of shapes (M, 5) and their derivatives with respect to the
    coordinates, shape (M, 5, 5).
    """
    # At s = jΩ and λ = 2 the denominator s² + μ s^α + ω₀² has the imaginary part μ Ω^α
    # S, where a viscous link has 2ζΩ², and no real part: ω₀² = Ω² − μ Ω^α C. For
    # another λ, Ω^λ takes the place of Ω².
    order, log_resonance, ratio, other, _ = shapes.T
    sine, cosine = np.sin(other * math.pi / 2), np.cos(other * math.pi / 2)
    whole = np.exp(order * log_resonance)
    unit = 2 * np.exp((order - other) * log_resonance) / sine
    damping, square = ratio * unit, whole * (1 - 2 * ratio * cosine / sine)
    values, slopes = shapes.copy(), np.zeros((len(shapes), 5, 5))
    values[:, 0], values[:, 1], values[:, 2] = np.maximum(square, 0.0), order, damping
    slopes[:, 1, 0] = slopes[:, 3, 3] = slopes[:, 4, 4] = 1.0
    slopes[:, 0, 0], slopes[:, 0, 1] = log_resonance * square, order * square
    slopes[:, 0, 2] = -2 * whole * cosine / sine
    slopes[:, 0, 3] = whole * ratio * math.pi / sine**2
    slopes[:, 2, 0], slopes[:, 2, 1] = (
        log_resonance * damping,
        (order - other) * damping,
    )
    slopes[:, 2, 2] = unit
    slopes[:, 2, 3] = -damping * (log_resonance + math.pi / 2 * cosine / sine)
    return values, slopes


def model_of(
    shape: Real, stiffness: float, payload: float | None, **others: Any
) -> LinkModel:
    """The link model of a shape, with its delay and `others` of its fields."""
    square, order, damping, other, _ = link_parameters(shape[None, :])[0][0].tolist()
    # 1e-9 of the stiffness is below the resolution of any double-precision fit: then
    # only damping is left.
    square = (
        0.0 if damping > 0 and square < 1e-9 * math.exp(order * shape[1]) else square
    )
    return LinkModel(
        stiffness,
        math.sqrt(square),
        order,
        damping,
        other if damping > 0 else 1.0,
        payload,
        gauge_delay=float(shape[4]),
        **others,
    )


def shape_of(model: LinkModel, delay: float = 0.0) -> Real:
    """The shape of a link model."""
    square = model.natural_frequency**2
    parameters = [square, model.order, model.damping, model.damping_order, delay]
    return shapes_of(np.array([parameters]))[0]


def shapes_of(parameters: Real) -> Real:
    """Shapes (M, 5) of links with (ω₀², λ, μ, α, τ), the inverse of `link_parameters`:
    ln Ω of Ω^λ = ω₀² + μ Ω^α C by Newton's method.
    """
    square, order, damping, other, _ = parameters.T
    cosine = np.cos(other * math.pi / 2)
    # Ω of the undamped link is within a few per cent of the root, because the damping
    # of an arm is weak; without ω₀ the damping alone gives Ω.
    place = np.log(np.maximum(np.maximum(square, damping * cosine), 1e-12)) / order
    for _ in range(40):
        moving, friction = np.exp(order * place), damping * np.exp(other * place)
        slope = order * moving - other * friction * cosine
        step = (moving - square - friction * cosine) / slope
        # For a sum of exponentials a step from the left overshoots; a limit of half an
        # e-fold keeps it within range.
        place -= np.clip(step, -0.5, 0.5)
        if np.all(np.abs(step) < 1e-14):
            break
    return shapes_at(place, parameters)


def shapes_at(place: Real, parameters: Real) -> Real:
    """Shapes (M, 5) at ln Ω (M,), with ζ = μ S Ω^(α−λ)/2; ω₀ follows from them."""
    _, order, damping, other, delay = parameters.T
    sine = np.sin(other * math.pi / 2)
    ratio = damping * sine * np.exp((other - order) * place) / 2
    return np.column_stack([order, place, ratio, other, delay])


def largest_ratio(other: float) -> float:
    """The damping ratio ζ beyond which ω₀² is negative (α < 1), or the link no longer
    vibrates.
    """
    return math.tan(other * math.pi / 2) / 2 if other < 1 else 0.9


def moving_angle(log: Experiment) -> Real:
    """The motor angle that moves the link of a log: its own, preceded by the part known
    before a cut that still affects the log.
    """
    samples = log.output.size
    return log.whole_angle[-(samples + max(3 * samples, HISTORY)) :]


def chosen_hold(motor_angle: Real, hold: Hold) -> Literal["zero", "first"]:
    """The course of the input between samples.

    A motor moves smoothly, so "auto" interpolates linearly; a simulated command that
    jumps between two samples and rests before and after is held instead. Taken as a
    ramp it would delay the link by half a sample, which biases λ.
    """
    if hold != "auto":
        return hold
    steps = np.abs(np.ediff1d(motor_angle, to_begin=0.0, to_end=0.0))
    calm = np.maximum(steps[:-2], steps[2:]) <= 1e-3 * steps[1:-1]
    # A jump exceeds a twentieth of the whole range: a step of a coarse encoder also has
    # rest on both sides.
    jumps = calm & (steps[1:-1] > 0.05 * np.ptp(motor_angle))
    return "zero" if steps[1:-1][jumps].sum() > 0.5 * steps.sum() > 0 else "first"


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of a log from its start, in the kernel's terms.

    The last N samples of `input` (H + N,) belong to those of `output` (N,). The H samples
    before them move the link, but are not compared: without them a log cut in
    mid-motion begins with a vibration that no link at rest has, and the fit takes it
    for delay and damping (8 ms on the bundled log, see
    ``benchmarks/bench_identify.py``).
    """

    input: Real
    output: Real
    period: float
    hold: Literal["zero", "first"]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.output.size

    @property
    def frequency_limits(self) -> tuple[float, float]:
        """Resonances [rad/s] that the log can show: at least 1.5 periods within it and
        the motion known before it, and six samples per period.
        """
        # Motion from before a cut continues after it, and shows slower resonances.
        return 3 * math.pi / (self.input.size * self.period), math.pi / (
            3 * self.period
        )

    @property
    def is_rough(self) -> bool:
        """Whether noise (such as an encoder's steps) shows in the input's increments.

        Sample noise makes neighbouring increments opposed, so that their correlation is
        lower than that of the second neighbours; the correlation of a motion falls with
        every sample.
        """
        steps = np.diff(self.input)
        return bool(steps[1:] @ steps[:-1] < steps[2:] @ steps[:-2])

    def widths(self, highest: Real) -> NDArray[np.int_]:
        """Numbers of samples, powers of two, whose averages show vibrations up to
        `highest` [rad/s].
        """
        finer = np.minimum(
            self.frequency_limits[1] / highest, self.samples / LEAST_SAMPLES
        )
        return 2 ** np.log2(np.maximum(finer, 1.0)).astype(int)

    @cached_property
    def halved(self) -> Window:
        """Averages of pairs of samples: the averaged output is the response of the linear
        link to the averaged input, which is taken as linear between samples.
        """
        earlier, count = self.input.size - self.samples, self.samples // 2 * 2
        angle = self.input[earlier % 2 : earlier + count]
        angle, output = (
            0.5 * (signal[::2] + signal[1::2])
            for signal in (angle, self.output[:count])
        )
        return Window(angle, output, 2 * self.period, "first")

    def kernel(
        self, resonance: float, *, longest_delay: float, digits: float = DIGITS
    ) -> FitProblem:
        """The kernel with a grid of rates for resonances from `resonance` [rad/s]
        upwards, whose sum gives the response to this many `digits`.
        """
        exponent = digits * math.log(10)
        # The error of the trapezoidal rule in ln(rate) is exp(−π²/step), and a rate of
        # exponent/Ts decays within a sample. Below the resonance a rate r has the
        # weight (r/Ω)^λ; λ = 1.5 is low enough: with its ζ = 0.5, a link hardly
        # vibrates.
        step = math.pi**2 / exponent
        start = math.log(resonance) - exponent / 1.5
        modes = math.ceil((math.log(exponent / self.period) - start) / step)
        # Sixty rates cover e^32 above the slowest; only a period of a hundred million
        # samples would need more.
        modes, tail = min(max(modes, 4), _MODES_MAX - 4), math.ceil(_TAIL / step)
        # Two of the kernel's blocks of eight beyond the longest delay, and as much
        # again for an overshoot.
        pad = math.ceil(longest_delay / self.period) + 32
        ramps = int(self.hold == "first")
        return FitProblem(
            self.input,
            self.output,
            self.period,
            ramps,
            start,
            step,
            modes,
            tail,
            pad,
        )


def columns_of(kernel: FitProblem, shape: Real, mask: int = 0) -> Real:
    """Output for unit gain and its derivatives with respect to the coordinates in
    `mask`, shape (1 + k, N).
    """
    columns = kernel.columns(shape, mask)
    if columns is None:
        raise NotConvergedError(
            "the vibration pole",
            reached=math.nan,
            wanted=0.0,
            remedy="give a model with a damping ratio below 0.9",
        )
    return columns
