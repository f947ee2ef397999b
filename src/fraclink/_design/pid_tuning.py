"""The result of `tune_pid`: a fractional PID with its plant, margins, law and step
response.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from fraclink._arm.fractional_pid import FractionalPid
from fraclink._design.pid_search import REACH
from fraclink._display import (
    Overview,
    Table,
    displayed,
    quantity,
    rows_of,
    state_of,
)
from fraclink._files import Saved, document
from fraclink._law.fractional_pid import discretize_pid, pid_response
from fraclink._law.law import Law, LawInputs
from fraclink._law.requirement import Requirement
from fraclink.errors import FieldError
from fraclink.findings import Finding, errors_of
from fracsys._fractional import FractionalTransferFunction
from fracsys._loops import as_loop
from fracsys._margins import Margins, margins
from fracsys._precision import DIFFERENCE_STEP
from fracsys._response import discrete_modes, time_response
from fracsys.checks import Complex, Real, above

__all__ = ["PERIODS", "PidStep", "PidTuning"]


# periods of delay: half of one for the hold, and one until the output takes effect
PERIODS = 1.5
# factors below and above ω_c that bound the band of the law's fit; the figures of a
# loop depend on this band
LAW_BAND = (200.0, 50.0)


class PidStep(NamedTuple):
    """Response to a step of the reference: time [s], measurement and controller's
    output, shape (N,).
    """

    time: Real
    measurement: Real
    output: Real


@displayed
@document(
    "pid-tuning",
    summary=lambda made: {"passed": made.passed, "controller": made.controller.formula},
)
@dataclass(frozen=True)
class PidTuning(Saved):
    """A fractional PID and the plant it was tuned for: the result of `tune_pid`.

    Attributes
    ----------
    plant
        P(s), without the delay of the sampling.
    controller
        C(s).
    gain_crossover, phase_margin, gain_margin, max_sensitivity
        what was asked for: [rad/s], [rad], factor, and bound on Ms; None where nothing
        was.
    itae
        ∫ t |e| dt [s²] over `horizon` [s] after a unit step of the reference.
    period
        of the law [s]; None for a controller without sampling. The tuning includes
        1.5 periods of delay.
    output_limit, measurement_limit
        of the law; None where they were not given.
    findings
        codes W4xx.

    Examples
    --------
    >>> import fraclink as fl
    >>> import fracsys
    >>> plant = 1 / (0.8 * fracsys.s**2.2 + 0.5 * fracsys.s**0.9 + 1)
    >>> tuning = fl.tune_pid(plant, gain_crossover=2.0, phase_margin=fl.deg(60))
    >>> tuning.passed, round(tuning.margins.gain_crossover, 6), round(tuning.itae, 2)
    (True, 2.0, 1.12)
    """

    __made_by__ = "fraclink.tune_pid(plant, ...)"

    plant: FractionalTransferFunction
    controller: FractionalPid
    phase_margin: float
    itae: float
    horizon: float
    gain_crossover: float | None = None
    gain_margin: float | None = None
    max_sensitivity: float | None = None
    flat_phase: bool = True
    period: float | None = None
    output_limit: float | None = None
    measurement_limit: float | None = None
    findings: tuple[Finding, ...] = ()

    @property
    def delay(self) -> float:
        """Delay of the sampling that the tuning includes [s]."""
        return PERIODS * (self.period or 0.0)

    @property
    def open_loop(self) -> FractionalTransferFunction:
        """L = C P e^(−1.5 T s)."""
        return (self.controller.transfer() * self.plant).delayed(self.delay)

    @cached_property
    def margins(self) -> Margins:
        """Every margin of the open loop, by root finding."""
        # neither the controller nor a plant that `tune_pid` takes is unstable
        return margins(self.open_loop, unstable_poles=0)

    @property
    def stable(self) -> bool:
        """Whether the closed loop is stable."""
        return bool(self.margins.stable)

    @property
    def phase_slope(self) -> float:
        """d arg L/d ln ω at the gain crossover [rad]: 0 where the phase is flat."""
        x = np.log([self.margins.gain_crossover])
        return float(as_loop(self.open_loop, None).slope(x).imag[0])

    @property
    def requirements(self) -> tuple[Requirement, ...]:
        """Each requirement with what was achieved."""
        loop_margins, gain = self.margins, self.margins.gain_margin
        at_least = {
            "phase margin": ("rad", self.phase_margin, loop_margins.phase_margin),
            "gain crossover": (
                "rad/s",
                self.gain_crossover,
                loop_margins.gain_crossover,
            ),
            # A loop that becomes unstable with less gain has a gain margin below 1; the
            # requirement is a factor in either direction.
            "gain margin": ("", self.gain_margin, max(gain, 1.0 / gain)),
        }
        # the slope is a difference over this step
        slope = DIFFERENCE_STEP if self.flat_phase else None
        at_most = {
            "sensitivity peak": (
                "",
                self.max_sensitivity,
                loop_margins.sensitivity_peak,
            ),
            "slope of the phase": ("rad", slope, abs(self.phase_slope)),
        }
        return tuple(
            Requirement(
                name,
                limit,
                achieved,
                unit,
                math.nan,
                "at least" if name in at_least else "at most",
            )
            for name, (unit, limit, achieved) in (at_least | at_most).items()
            if limit is not None
        )

    @property
    def passed(self) -> bool:
        """Whether the closed loop is stable and every requirement is kept, and no
        finding is an error.
        """
        all_kept = all(requirement.passed for requirement in self.requirements)
        return self.stable and all_kept and not errors_of(self.findings)

    def overview(self) -> Overview:
        """The controller, its margins and ITAE, and every requirement."""
        c = self.controller
        rows = rows_of(
            self,
            "controller",
            "stable",
            *rows_of(
                self.margins,
                "gain_crossover",
                "phase_margin",
                ("gain_margin", "gain margin"),
                ("sensitivity_peak", "sensitivity peak Ms"),
            ),
            ("itae", "ITAE", "s²"),
            ("horizon", "over", "s"),
        )
        # Without the column of the worst payload, which only a design for an arm has.
        requirements = Table.of("requirements", self.requirements).columns(
            "requirement", "", "required", "achieved", "verdict"
        )
        notes = [] if self.stable else ["the closed loop is not stable"]
        if self.delay:
            notes.append(
                f"{quantity(self.delay, 'ms')} of the delay in the loop are due to the sampling"
            )
        # This verdict must not be mistaken for a certificate of an arm.
        notes.append("computed, not proved: certificates cover the loop of an arm only")
        return Overview(
            c.formula,
            state_of(self.passed),
            rows,
            (requirements,),
            self.findings,
            tuple(notes),
        )

    def law(
        self,
        *,
        period: float | None = None,
        output_limit: float | None = None,
        measurement_limit: float | None = None,
        order: int | None = None,
        precision: Literal["single", "double"] = "single",
    ) -> Law:
        """Return the law that runs the controller, by `fraclink.extend.discretize_pid`.

        An argument that is left out takes the value given to the tuning; the law's
        filter is fitted from 1/200 of the crossover to fifty times it, if the period
        allows.
        """
        values = {
            "period": self.period if period is None else period,
            "output_limit": self.output_limit if output_limit is None else output_limit,
            "measurement_limit": self.measurement_limit
            if measurement_limit is None
            else measurement_limit,
        }
        for name, value in values.items():
            if value is None:
                option = "period-ms" if name == "period" else name.replace("_", "-")
                raise FieldError(
                    name,
                    None,
                    "missing",
                    "a number > 0",
                    f"give {name}= here or to tune_pid (--{option})",
                )
        step = above(0.0, 1e3, "s").check("period", values["period"])
        crossover, high = self.margins.gain_crossover, 0.5 * math.pi / step
        band = None
        # With the crossover above a fifth of the highest frequency hardly any band is
        # left above it, and the default band is used.
        if math.isfinite(crossover) and crossover < 0.2 * high:
            band = (
                max(crossover / LAW_BAND[0], 1e-5 * high),
                min(LAW_BAND[1] * crossover, high),
            )
        return discretize_pid(
            self.controller,
            step,
            output_limit=values["output_limit"],  # type: ignore[arg-type]
            measurement_limit=values["measurement_limit"],  # type: ignore[arg-type]
            order=order,
            precision=precision,
            band=band,
        )

    def sampled_margins(self, law: Law) -> Margins:
        """Return every margin of the sampled loop that `law` closes, one period of
        computation included.

        The plant after its zero-order hold is exact (`discrete_modes`), and the law is
        computed from its coefficients.
        """
        # exact from ω_c/1000 upwards
        modes = discrete_modes(
            self.plant, law.period, span=REACH / self.margins.gain_crossover
        )

        def loop(s: Complex) -> Complex:
            w = np.imag(s)
            # A whole period, although `open_loop` uses one and a half: the other half
            # is the hold, which `modes` contains exactly.
            late = np.exp(-1j * w * law.period)
            return pid_response(law, w) * modes.frequency_response(w) * late

        return margins(loop, limit=math.pi / law.period, unstable_poles=0)

    def step(
        self,
        *,
        law: Law | None = None,
        size: float = 1.0,
        duration: float | None = None,
    ) -> PidStep:
        """Return the response to a step of the reference by `size`, over `duration` [s]
        (default `horizon`).

        Without `law` it is that of C(s) in continuous time, with the sampling as a delay.
        With it law.c runs, period by period, on the plant after its hold: with its limit, its anti-windup and a
        period of computation. A plant with a delay in a loop without sampling is
        inverted numerically.
        """
        length = self.horizon if duration is None else duration
        if law is not None:
            return _run(self.plant, law, size, max(2, round(length / law.period) + 1))
        # A thousand points are more than a plot shows; for a loop without delay each of
        # them is exact.
        time = np.linspace(0.0, length, 1001)
        loop, setpoint = self.open_loop, np.full(time.size, size)
        feedback, outer = (
            loop.feedback(),
            self.controller.transfer().feedback(self.plant.delayed(self.delay)),
        )
        answers = [
            time_response(system, setpoint, time[1]).output
            for system in (feedback, outer)
        ]
        return PidStep(time, *answers)


def _run(
    plant: FractionalTransferFunction, law: Law, size: float, count: int
) -> PidStep:
    """law.c with the plant discretised exactly with its hold; the output takes effect
    one period later.
    """
    modes = discrete_modes(plant, law.period, span=count * law.period)
    # Convolution with the plant's response to a pulse of one period, O(N²): carrying a
    # state along would require another implementation of the modes of a delayed plant,
    # and N is a few thousand.
    weights = modes.respond(np.eye(1, count)[0])
    state, outputs = law.initial_state(), np.zeros(count)
    measured = np.zeros(count)
    for k in range(count):
        measured[k] = outputs[: k + 1] @ weights[k::-1]
        state, answer = law.step(
            state, LawInputs(size, 0.0, measured[k], 0.0), tick=k + 1
        )
        if k + 1 < count:
            outputs[k + 1] = answer.voltage
    return PidStep(
        law.period * np.arange(count, dtype=np.float64),
        measured,
        np.append(outputs[1:], outputs[-1]),
    )
