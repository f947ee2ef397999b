"""`tune_pid`: a PI^λD^μ controller for any plant, integer or fractional."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np

from fraclink._arm.fractional_pid import FractionalPid, PidOrder
from fraclink._design.pid_search import OFFER, REACH, PidProblem, best_of, itae
from fraclink._design.pid_tuning import PERIODS, PidTuning
from fraclink._design.rows import SENSITIVITY
from fraclink._identify.structure_fit import StructureFit
from fraclink._law.discretization import TOLERANCE_DEG
from fraclink.errors import FieldError, InfeasibleError
from fraclink.findings import Finding
from fracsys._control import from_control
from fracsys._fractional import FractionalTransferFunction
from fracsys._stability import is_stable
from fracsys.checks import Between, Duration, Frequency, PhaseMargin, above, checked

__all__ = ["tune_pid"]

# horizon of ITAE times ω_c: six periods of an oscillation at the crossover
HORIZON = 40.0
# With λ below one half an error decays like t^(−λ), beyond every horizon that ITAE
# covers.
_INTEGRAL_ORDERS, _DERIVATIVE_ORDERS = (0.5, 1.6), (0.1, 1.6)
_SLOPES = (-1.5, 0.25)  # slope of arg L over ln ω, where it is free

Form = Literal["PI", "PD", "PID"]


@checked
def tune_pid(
    plant: Any,
    *,
    phase_margin: PhaseMargin = math.pi / 3.0,
    gain_crossover: Frequency | None = None,
    gain_margin: Annotated[float, above(1.0, 1e3)] | None = None,
    max_sensitivity: Annotated[float, above(1.0, 100.0)] | None = None,
    flat_phase: bool = True,
    form: Form = "PID",
    integral_order: PidOrder | None = None,
    derivative_order: PidOrder | None = None,
    filter_time: Annotated[float, Between(0.0, 1e3, "s")] | None = None,
    period: Annotated[float, above(0.0, 1e3, "s")] | None = None,
    output_limit: Annotated[float, above(0.0, 1e6)] | None = None,
    measurement_limit: Annotated[float, above(0.0, 1e6)] | None = None,
    horizon: Duration | None = None,
) -> PidTuning:
    """Tune ``C(s) = k_p + k_i/s^λ + k_d s^μ/(1 + T_f s)^n`` for a plant, integer or
    fractional.

    |L| = 1 with the phase margin φ_m at ω_c, and d arg L/d ln ω = 0 there (flat phase: the margin then
    withstands a change of the plant's gain), are three linear equations in the gains for each (λ, μ). Of all
    pairs of orders, and of all ω_c if none is given, the result has the least ITAE = ∫ t |e| dt with no negative
    gain, a stable loop, and `gain_margin` and `max_sensitivity` kept.

    Parameters
    ----------
    plant
        P(s): a function of `fracsys.s`, the result of `identify_structure`, or a
        python-control system with one input and one output; of positive gain at low
        frequency, without poles in Re s > 0.
    phase_margin
        φ_m [rad], met at ω_c and kept at every other crossing.
    gain_crossover
        ω_c [rad/s]; chosen by ITAE when left out, which needs a plant with a delay, or
        `period`.
    gain_margin
        least factor, > 1, by which the gain may change before the loop is unstable.
    max_sensitivity
        bound on Ms = max |1/(1 + L)|; 2 where it is left out together with
        `gain_crossover`.
    flat_phase
        whether the phase is flat at the crossover, against changes of the gain; False
        leaves its slope to ITAE, too.
    form
        "PI", "PD" or "PID". With two gains, flat phase determines the order.
    integral_order, derivative_order
        orders λ and μ where they are given; 1 and 1 make an ordinary PID.
    filter_time
        T_f [s]; 1/(20 ω_c) when left out.
    period
        of the law [s]: 1.5 periods of delay (hold and computation) are then part of the
        loop.
    output_limit, measurement_limit
        largest |u|, and largest credible |r| and |y|, kept for `PidTuning.law`.
    horizon
        of ITAE [s]; 40/ω_c when left out (40 over the highest feasible ω_c where that
        is chosen). With λ < 1 and a plant without integrators ITAE grows without bound:
        e dies away as t^(−λ).

    Raises
    ------
    FieldError
        a plant that is unstable or of negative gain, and requests that leave nothing
        free.
    InfeasibleError
        no controller of this form meets them; `nearest` holds the nearest phase margin
        that can be met.

    Source: flat phase: Chen and Moore, Nonlinear Dynamics 38 (2005); the equations:
    Monje et al., Control Engineering Practice 16 (2008) 798–812, solved here in the
    gains.

    Examples
    --------
    >>> import fraclink as fl
    >>> import fracsys
    >>> tuning = fl.tune_pid(
    ...     (1 / (0.4 * fracsys.s**1.5 + 1)).delayed(0.05), gain_crossover=1.0, form="PI", phase_margin=fl.deg(70)
    ... )
    >>> tuning.passed, abs(tuning.phase_slope) < 1e-6
    (True, True)
    """
    if max_sensitivity is None and gain_crossover is None:
        max_sensitivity = SENSITIVITY  # ITAE alone leads to Ms of 3 to 6
    own = _plant_of(plant)
    # Hold and computation delay are part of the plant from the start: a margin obtained
    # without them would lose ω_c·1.5 T.
    problem = _problem(
        own.delayed(PERIODS * (period or 0.0)),
        form,
        phase_margin=phase_margin,
        gain_crossover=gain_crossover,
        gain_margin=gain_margin,
        max_sensitivity=max_sensitivity,
        flat_phase=flat_phase,
        integral_order=integral_order,
        derivative_order=derivative_order,
        filter_time=filter_time,
    )
    # One horizon for all candidates: with 40/ω_c of each candidate, a slow loop would
    # get more time to accumulate error, and its ITAE would not be comparable with that
    # of a fast loop.
    fastest = best_of(problem, lambda found: found.crossover)
    if fastest is None:
        raise _infeasible(problem)
    length = HORIZON / float(fastest.crossover[0]) if horizon is None else horizon
    best = best_of(problem, lambda found: 1.0 / itae(problem, found, length)) or fastest
    tuning = PidTuning(
        plant=own,
        controller=best.controller,
        phase_margin=phase_margin,
        # Eight times as many samples as in the search, since this value is reported. It
        # agrees to 1e-5 with the exact response on the plants of the tests.
        itae=float(itae(problem, best, length, 8192)[0]),
        horizon=length,
        gain_crossover=gain_crossover,
        gain_margin=gain_margin,
        max_sensitivity=max_sensitivity,
        flat_phase=flat_phase,
        period=period,
        output_limit=output_limit,
        measurement_limit=measurement_limit,
        findings=_lasting(problem, best.controller),
    )
    return (
        tuning
        if period is None
        else replace(tuning, findings=(*tuning.findings, *_of_law(tuning)))
    )


def _of_law(made: PidTuning) -> tuple[Finding, ...]:
    """The findings on the phase margin that the shipped law keeps with the sampled plant."""
    if any(term.delay for term in made.plant.denominator):
        return (
            Finding(
                "W423",
                "warning",
                "the shipped law was not checked: a plant with a delay inside its own loop has no modes",
                {"delay, s": max(term.delay for term in made.plant.denominator)},
                "keep a larger margin, or simulate the law with your own model of the plant",
            ),
        )
    # The limits do not affect the linear loop: any finite values will do, since the
    # caller need not have given them.
    margins = made.sampled_margins(made.law(output_limit=1.0, measurement_limit=1.0))
    # The nearest crossing of a stable loop may lie on either side of -1; its distance
    # counts.
    margin = abs(margins.phase_margin)
    evidence = {
        "asked, °": math.degrees(made.phase_margin),
        "kept, °": math.degrees(margin),
    }
    if not margins.stable:
        return (
            Finding(
                "W404",
                "error",
                "the loop of the shipped law is not stable",
                evidence,
                "ask for a slower gain crossover, or take a shorter period",
            ),
        )
    # the law's tolerance, and as much again because hold and computation are not
    # exactly a delay of 1.5 periods
    if made.phase_margin - margin <= math.radians(2.0 * TOLERANCE_DEG):
        return ()
    return (
        Finding(
            "W404",
            # Half of the margin lost is no rounding: it is another loop than the one
            # that was tuned.
            "error" if margin < 0.5 * made.phase_margin else "warning",
            "the shipped law keeps less phase margin than was asked for",
            evidence,
            "take a shorter period, or ask for a slower gain crossover",
        ),
    )


def _lasting(problem: PidProblem, controller: FractionalPid) -> tuple[Finding, ...]:
    """W421: the steady-state error if neither controller nor plant integrates."""
    # An integral of any order λ > 0 has infinite gain at ω = 0: the error then vanishes,
    # although only like t^(−λ).
    if controller.integral or problem.integrators > 0.0:
        return ()
    top, bottom = problem.plant.numerator[-1], problem.plant.denominator[-1]
    gain = top.coefficient / bottom.coefficient if top.order == bottom.order else 0.0
    error = 100.0 / (1.0 + controller.proportional * gain)
    return (
        Finding(
            "W421",
            "warning",
            "without an integral a step of the reference is never reached",
            {"lasting error, %": error},
            "ask for a PID, or raise the reference to compensate for it",
        ),
    )


def _words(problem: PidProblem) -> str:
    """The requested form in words."""
    form = "P" + "I" * problem.integral + "D" * problem.derivative
    return (
        f"{form} controller with a flat phase" if problem.flat else f"{form} controller"
    )


def _plant_of(plant: Any) -> FractionalTransferFunction:
    """The plant as a function; FieldError if the search cannot count the encirclements
    of its loop.
    """
    own = (
        plant.transfer_function
        if isinstance(plant, StructureFit)
        else from_control(plant)
    )
    if not own.numerator:
        raise FieldError(
            "plant",
            "0",
            "zero",
            "a plant that is not zero",
            "build it from s",
        )
    # |L| of a plant that does not fall at high frequency may stay above 1, and the 1.5
    # periods of delay then turn it around −1 without end, so that the count of turns,
    # which decides stability here, does not converge.
    if own.relative_degree <= 0.0:
        raise FieldError(
            "plant",
            str(own),
            "not strictly proper",
            "|P| -> 0 for high frequencies",
            "write down the lag of its sensor or actuator",
        )
    order = own.denominator[-1].order
    # A pole at the origin is allowed: the scan knows how far L turns there. It is
    # divided out, and the rest must be stable, because the Nyquist count assumes no
    # poles in the right half plane.
    free = own / FractionalTransferFunction.power(-order) if order else own
    if not is_stable(free):
        raise FieldError(
            "plant",
            str(own),
            "unstable: it has a pole with Re s >= 0 other than at the origin",
            "a stable plant, or one with integrators",
            "stabilise it first, and tune for the closed loop",
        )
    # The sign of the gain at low frequency: with gains of C >= 0, a plant of negative gain gives
    # positive feedback.
    lowest = own.numerator[-1].coefficient / own.denominator[-1].coefficient
    if lowest < 0.0:
        raise FieldError(
            "plant",
            str(own),
            "of negative gain at low frequency",
            "> 0",
            "tune for -plant, and negate the controller's output",
        )
    return own


def _problem(
    plant: FractionalTransferFunction,
    form: Form,
    *,
    phase_margin: float,
    gain_crossover: float | None,
    gain_margin: float | None,
    max_sensitivity: float | None,
    flat_phase: bool,
    integral_order: float | None,
    derivative_order: float | None,
    filter_time: float | None,
) -> PidProblem:
    integral, derivative = "I" in form, "D" in form
    orders = (
        ("integral_order", integral_order, integral),
        ("derivative_order", derivative_order, derivative),
    )
    for name, order, used in orders:
        if order is not None and not used:
            raise FieldError(
                name,
                order,
                f"given for a {form}",
                "none",
                f"leave it out, or ask for another form than {form}",
            )
    # ω_c and φ_m determine two gains; a PI or PD has only its order left to make the
    # phase flat.
    single = integral_order if integral else derivative_order
    if flat_phase and not (integral and derivative) and single is not None:
        raise FieldError(
            "flat_phase",
            True,
            f"asked of a {form} whose order is given: no parameter is left to make the phase flat",
            "False",
            "give flat_phase=False (--no-flat-phase), or leave the order free",
        )
    usual = (
        _INTEGRAL_ORDERS if integral else (1.0, 1.0),
        _DERIVATIVE_ORDERS if derivative else (1.0, 1.0),
    )
    ends = (
        span if order is None else (order, order)
        for span, (_, order, _) in zip(usual, orders, strict=True)
    )
    free = integral and derivative and not flat_phase
    return PidProblem(
        plant=plant,
        integral=integral,
        derivative=derivative,
        flat=flat_phase,
        gain_margin=gain_margin,
        max_sensitivity=max_sensitivity,
        spans=(
            *ends,
            _SLOPES if free else (0.0, 0.0),
            _crossovers(plant, gain_crossover),
            (phase_margin, phase_margin),
        ),
        filter_time=filter_time,
    )


def _crossovers(
    plant: FractionalTransferFunction, given: float | None
) -> tuple[float, float]:
    """Range of ln ω_c: the given one, or three decades below the frequency at which the
    delay alone turns the phase by 180°.
    """
    if given is not None:
        return math.log(given), math.log(given)
    delay = plant.delay
    if not delay:
        raise FieldError(
            "gain_crossover",
            None,
            "left out for a plant without a delay, where a faster loop is always better",
            "> 0 rad/s",
            "give gain_crossover=, or period= of the law, whose delay bounds it",
        )
    # Above π/τ the delay alone costs 180°. Three decades below, it no longer matters
    # for any plant.
    high = math.log(math.pi / delay)
    return high - math.log(REACH), high


def _infeasible(problem: PidProblem) -> InfeasibleError:
    """The error, with the nearest phase margin for which there is a controller."""
    margin = problem.spans[4][0]
    more = "another crossover, another form, or flat_phase=False (--no-flat-phase) leaves more room"
    free = replace(problem, spans=(*problem.spans[:4], (OFFER, math.pi - OFFER)))
    nearest = best_of(free, lambda found: math.pi - np.abs(found.places[:, 4] - margin))
    if nearest is not None:
        return InfeasibleError(
            "phase_margin",
            f"no {_words(problem)} with gains >= 0 meets it in a stable loop; {more}",
            {"phase_margin": float(nearest.places[0, 4])},
        )
    return InfeasibleError(
        "gain_crossover",
        f"no {_words(problem)} with gains >= 0 crosses there in a stable loop within "
        f"every bound; {more}",
    )
