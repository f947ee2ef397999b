"""Discretisation of the designed controller as a law at its period."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.motor import DiscretePid
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._arm.rig_parts import Moves
from fraclink._law.block import (
    FORWARD_MODES,
    PAIR_MODES,
    REAL_MODES,
    DiscreteMotorLoop,
    Modes,
    Precision,
)
from fraclink._law.law import Law
from fraclink._law.limits import derive_limits
from fraclink._law.tracking import following, forward_fit, tracking_for
from fraclink.errors import FieldError, required
from fracsys._discrete import DiscreteFits, DiscreteRational, Order
from fracsys.checks import Payload, Real, above, checked

if TYPE_CHECKING:
    from fraclink._law.design import Design

__all__ = [
    "TOLERANCE_DEG",
    "check_rigs_period",
    "correction_fits",
    "discrete_motor_loop",
    "discretize",
    "discretize_controller",
    "equip",
    "modes_from",
]


# A slow pole must not round to 1, an integrator.
BELOW_ONE = float(np.nextafter(np.float32(1.0), np.float32(0.0)))
# [rad/s]: below it Ĉ is less than 3 % of its value at the crossover for β > 0.65
LOWEST = 0.05
# largest multiple of the Coulomb friction: a motor that sticks beyond it has a fault
STICTION = 3.0
# Weight of an error of C around the crossover, relative to |1 + Ĉ|/|Ĉ|: an error of 0.5° of C
# changes the margin by 1.2° where |Ĉ| is 0.4; a third of 0.5° of Ĉ changes it by 0.2°.
# The largest weight that keeps C within 0.1 dB is used.
EMPHASES = (3.0, 2.0, 1.0)
# factor on either side of the nominal crossover: a range of 6 in ω_c is one of 15 or
# more in payload
REACH = 2.5
# weight of the relative error of Ĉ inside its notch, relative to 0.1 dB and 0.5°: 1 dB
# is enough there
_NOTCHED = 0.1
STATES = (
    6  # most states for the sake of the margin; more only where C itself needs them
)
TOLERANCE_DB, TOLERANCE_DEG = 0.1, 0.5
# Fits of Ĉ with a zero at z = 1, as its DC gain is 0, until 1 + Ĉ meets the tolerance.
correction_fits = partial(
    DiscreteFits,
    zeros_at_one=1,
    offset=1.0,
    tolerance_db=TOLERANCE_DB,
    tolerance_deg=TOLERANCE_DEG,
)


@checked
def discretize_controller(
    controller: Controller,
    period: float,
    *,
    order: Order | None = None,
    precision: Precision = "single",
    link: LinkModel | None = None,
    rig: Rig | None = None,
) -> Law:
    """Return the law that runs the controller at `period` [s].

    Ĉ(s) = k_d s^β/(1 + δs)^n becomes (1 − z⁻¹)(d + Σ g/(z − p)) by a minimax fit of C =
    1 + Ĉ on a band of frequencies, closest about the gain crossover (`fit_correction`), and
    the feed-forward s^λ θt*/ω₀² becomes a fit of s^(λ−2)/ω₀² that is applied to
    the reference's known acceleration.

    Without a filter Ĉ is improper: no sampled controller can follow it to the Nyquist
    frequency, and the band ends at 300 rad/s (600 with a filter). The errors reached
    are in `Law.correction_error`.

    Parameters
    ----------
    order
        states of Ĉ, 0 to 8; without it the fewest that meet 0.1 dB and 0.5°, else the
        best of 8.
    precision
        "single" or "double".
    link
        nominal model; the controller's own where it is left out.
    rig
        adds the motor loop, the sensors' limits and the motor's compensations (see
        `equip`).

    Raises
    ------
    FieldError
        a period or order out of range, and a missing link.

    >>> from fraclink._arm.controller import Controller
    >>> from fraclink._arm.link import LinkModel
    >>> link = LinkModel(stiffness=1.56, natural_frequency=11.094, order=1.92)
    >>> controller = Controller(0.148, 0.65, filter_time=0.16, filter_order=2, link=link)
    >>> law = discretize_controller(controller, 0.004)
    >>> law.order, law.correction_error[0] < 0.1, law.correction_error[1] < 0.5
    (4, True, True)
    """
    model = required(
        "link",
        link or controller.link,
        "a LinkModel",
        "give the nominal link model: tip estimate and feed-forward need it",
    )
    _check_period(controller, period)
    reach = _band(controller, period)
    correction = fit_correction(controller, model, period, reach, order)
    forward = forward_fit(model, period)
    # A controller without a motor loop gets the paper's, with one period of
    # computation.
    settings = controller.motor_loop or MotorLoop()
    modes = modes_from("link.order", forward, FORWARD_MODES, 0)
    loop = following(
        model.resonance, period, settings.pole, settings.delay_samples, None, None
    )
    law = Law(
        period=period,
        precision=precision,
        stiffness=model.stiffness,
        correction=modes_from("order", correction, REAL_MODES, PAIR_MODES),
        feedforward=modes,
        motor_loop_pole=settings.pole,
        motor_model=loop.model,
        limits=derive_limits(
            model,
            period,
            Moves(),
            loop=loop,
            kick=abs(correction.feedthrough),
        ),
        correction_error=(correction.error_db, correction.error_deg),
        feedforward_error=(forward.error_db, forward.error_deg),
        band=reach,
        tracking=tracking_for(model, modes, period, rig=None),
    )
    return law if rig is None else equip(law, rig, model)


def discretize(
    design: Design | Controller,
    period: float | None = None,
    *,
    order: int | None = None,
    precision: Precision = "single",
) -> Law:
    """Return the law that runs a design: the same coefficients are simulated and
    exported.

    For a design it is the whole law, with the motor loop, the sensors' limits and the
    compensations of its rig; for a controller alone it is Ĉ and the feed-forward, and
    the drive closes the motor loop.

    Parameters
    ----------
    design
        a design, or a controller.
    period
        control period [s], > 0; the design's own when it is left out.
    order
        states of Ĉ, 0 to 8; chosen to meet 0.1 dB and 0.5° when it is left out.
    precision
        "single" or "double".

    Raises
    ------
    FieldError
        a value out of its range, or a controller without a period where none is given.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
    >>> fl.discretize(controller, rig.period, order=4).order
    4
    """
    controller = (
        design
        if isinstance(design, Controller)
        else getattr(design, "controller", None)
    )
    if not isinstance(controller, Controller):
        raise FieldError(
            "design",
            repr(design),
            "not a Design",
            "a Design or a Controller",
            "fl.design makes one",
        )
    usual = controller.period if isinstance(design, Controller) else design.rig.period
    step = required(
        "period",
        usual if period is None else period,
        "> 0 s",
        "give the control period in seconds",
    )
    law = discretize_controller(controller, step, order=order, precision=precision)
    if isinstance(design, Controller):
        return law
    return equip(
        law,
        design.rig,
        design.model,
        motor_loop=design.motor_loop,
        heaviest=design.payloads[1],
    )


@checked
def equip(
    law: Law,
    rig: Rig,
    link: LinkModel,
    *,
    moves: Moves | None = None,
    motor_loop: MotorLoop | None = None,
    heaviest: Payload | None = None,
) -> Law:
    """Return the law with the rig's motor loop, compensations and sensor limits.

    `motor_loop` defaults to the rig's with the pole that the law was made for, `moves`
    and the `heaviest` payload [kg] to the rig's. The guards are derived again from
    these, the gauge's range, noise and quantum, and the encoder's resolution.
    Raises FieldError where the periods differ.
    """
    check_rigs_period(law, rig)
    settings = motor_loop or replace(rig.motor_loop, pole=law.motor_loop_pole)
    pid = settings.pid(rig.motor, rig.period)
    closed = discrete_motor_loop(rig, pid, link)
    loop = following(
        link.resonance,
        law.period,
        settings.pole,
        settings.delay_samples,
        rig.motor,
        pid,
    )
    return replace(
        law,
        motor_loop=closed,
        motor_model=loop.model,
        limits=derive_limits(
            link,
            law.period,
            moves or rig.moves,
            loop=loop,
            gauge_limit=rig.gauge.limit,
            gauge_noise=rig.gauge.noise,
            gauge_quantum=rig.gauge.quantum,
            encoder_resolution=rig.encoder.resolution,
            sticking=STICTION * closed.coulomb_voltage / closed.pid.stiffness,
            kick=abs(law.correction.direct),
            heaviest=(heaviest or rig.payloads.high)
            / (link.payload or rig.payloads.nominal),
        ),
        tracking=tracking_for(link, law.feedforward, law.period, rig=rig),
    )


def check_rigs_period(law: Law, rig: Rig) -> None:
    """FieldError if the law was made for a period other than the rig's."""
    if not math.isclose(law.period, rig.period, rel_tol=1e-9):
        raise FieldError(
            "period",
            law.period,
            "not the rig's",
            f"{rig.period} s",
            "discretise the controller at the rig's period",
        )


def discrete_motor_loop(
    rig: Rig, pid: DiscretePid, link: LinkModel
) -> DiscreteMotorLoop:
    """Return the motor loop of `rig` with this PID, and the compensations its motor
    needs.

    The coupling torque is compensated from the gauge's reading, divided by the gauge's
    gain. It is not compensated where the reading, with hold and computation, comes so
    late that the remainder ``|1 − e^(−jφ)|`` exceeds the torque itself at the resonance
    (φ > 60°).
    """
    motor = rig.motor
    late = link.gauge_lag + 1.5 * rig.period
    helps = link.gauge_gain > 0 and link.resonance * late < math.pi / 3
    return DiscreteMotorLoop(
        pid=pid,
        voltage_limit=min(
            motor.voltage_limit, 1e4
        ),  # a block holds finite numbers; 10 kV never limits anything
        torque_voltage=1 / (motor.torque_constant * motor.gear_ratio * link.gauge_gain)
        if helps
        else 0.0,
        coulomb_voltage=motor.coulomb_torque / motor.torque_constant,
    )


def _check_period(controller: Controller, period: float) -> None:
    above(0.0, unit="s", remedy="give seconds").check("period", period)
    designed = controller.period
    if designed is not None and not math.isclose(designed, period, rel_tol=1e-9):
        raise FieldError(
            "period",
            period,
            "not the one the controller was designed for",
            f"{designed} s",
            "design again for this period, or use controller.period",
        )
    # The band of the fit begins at LOWEST; five times that frequency must lie below the
    # Nyquist frequency.
    if period > 0.2 * math.pi / LOWEST:
        raise FieldError(
            "period",
            period,
            "too long",
            "<= 12 s",
            "give the period in seconds",
        )


def _band(controller: Controller, period: float) -> tuple[float, float]:
    nyquist = math.pi / period
    # 600 rad/s is 0.764 of the Nyquist frequency at the paper's 4 ms. With a band up to
    # 0.95 of it, the error of eight states is four times as large. Without a filter |Ĉ|
    # keeps growing: with six to eight states a band up to 600 rad/s leaves 0.3 to 0.7
    # dB, one up to 300 less than 0.15 dB.
    high = (
        min(600.0, 0.764 * nyquist)
        if controller.is_strictly_proper
        else min(300.0, 0.382 * nyquist)
    )
    return min(LOWEST, 1e-3 * nyquist), high


def modes_from(field: str, fit: DiscreteRational, reals: int, pairs: int) -> Modes:
    """Return a fit as the modes of a block; FieldError if it has more than law.c can
    hold.
    """
    if len(fit.decays) > reals or len(fit.pole_decays) > pairs:
        raise FieldError(
            field,
            f"{len(fit.decays)} real modes and {len(fit.pole_decays)} pairs",
            "more than law.c holds",
            f"{reals} real modes and {pairs} pairs",
            "ask for a lower order",
        )
    # Sorted, so that a controller gives the same block, and the same digest, in whatever
    # sequence the fit returns its modes.
    slowest_last = np.argsort(fit.decays)
    return Modes(
        _single(fit.feedthrough),
        tuple(min(_single(x), BELOW_ONE) for x in fit.decays[slowest_last]),
        tuple(_single(x) for x in fit.gains[slowest_last]),
        tuple(complex(_single(x.real), _single(x.imag)) for x in fit.pole_decays),
        tuple(complex(_single(x.real), _single(x.imag)) for x in fit.pole_gains),
    )


def _single(value: float) -> float:
    """The nearest single-precision number: both precisions then run the same filter,
    and a double-precision simulation differs from the board by rounding alone.
    """
    return float(np.float32(value))


# The margins, moves, arms and certificate of a design all need the same law: five fits
# of 0.05 to 0.2 s each.
@lru_cache(maxsize=64)
def fit_correction(
    controller: Controller,
    link: LinkModel,
    period: float,
    band: tuple[float, float],
    order: int | None,
) -> DiscreteRational:
    """Return Ĉ at `period` [s] as (1 − z⁻¹)(d + Σ g/(z − p)), fitted on `band` [rad/s].

    C = 1 + Ĉ is met to 0.1 dB and 0.5° with few states; the remaining freedom makes Ĉ
    accurate within a factor 2.5 about the gain crossover with the nominal `link`,
    because the loop is Ĉ times the plant, not C. If no such fit has 6 states or fewer
    (or `order`), C alone is fitted.
    """

    fits = partial(
        correction_fits,
        controller.response,
        period=period,
        band=band,
        inside=_about_notch(controller, band),
    )
    centre = _crossover(controller, link)
    inside = band[0] < centre < band[1]
    near = fits(weight=_weight(controller, centre, EMPHASES[0]))
    if inside and _is_met(first := near.fit(order, STATES)):
        return first
    plain = fits()
    least = plain.fit(order, REAL_MODES)
    # An emphasis is a weight of at least one, so it cannot succeed where C alone fails
    # clearly with as few states. "Clearly", because the search is not global: on the
    # paper's link at 16 rad/s and 50°, without a filter, it finds 0.13 dB with 5 states
    # and an emphasis of 1, and 0.14 dB with 7 states without one.
    few = least if least.order <= STATES else plain.fit(order or STATES)
    if inside and _is_met(few, slack=1.2):
        for emphasis in EMPHASES[1:]:
            milder = fits(weight=_weight(controller, centre, emphasis))
            if _is_met(candidate := milder.fit(order, STATES)):
                return candidate
    if _is_met(least):
        return least
    # No fit meets the tolerance of C everywhere: the crossover then counts more than
    # the end of the band.
    nearest = near.fit(order, REAL_MODES)
    return nearest if nearest.error_db <= 2.0 * least.error_db else least


def _is_met(fit: DiscreteRational, slack: float = 1.0) -> bool:
    return (
        fit.error_db <= slack * TOLERANCE_DB and fit.error_deg <= slack * TOLERANCE_DEG
    )


def _weight(
    controller: Controller, centre: float, emphasis: float
) -> Callable[[Real], Real]:
    def weight(frequency: Real) -> Real:
        correction = controller.response(frequency)
        near = np.abs(np.log(frequency / centre)) <= np.log(REACH)
        relative = np.abs(1.0 + correction) / np.abs(correction)
        value = np.where(near, np.maximum(1.0, emphasis * relative), 1.0)
        if controller.notch is not None:
            # C is close to 1 in the notch, whatever Ĉ is: the attenuation of the notch
            # would be lost within the tolerance of C.
            depth = np.exp(controller.notch.log(frequency).real)
            value = np.where(depth < 0.5, np.maximum(value, _NOTCHED * relative), value)
        return value

    return weight


def _about_notch(controller: Controller, band: tuple[float, float]) -> Real:
    """Frequencies about the notch of a controller, inside the band."""
    if controller.notch is None:
        return np.empty(0)
    widths = np.array([controller.notch.zeros, controller.notch.poles])
    near = np.exp(widths[:, None] * np.linspace(-1.5, 1.5, 7)).ravel()
    w = np.unique(controller.notch.frequency * near)
    return w[(w > band[0]) & (w < band[1])]


def _crossover(controller: Controller, link: LinkModel) -> float:
    """Highest frequency at which |Ĉ G| falls through 1 [rad/s]; the link's resonance if
    it never does.
    """
    resonance = link.resonance
    w = resonance * np.geomspace(0.2, 30.0, 500)
    # On a grid of 1 %: the crossover is the centre of a band of a factor of 2.5 either
    # way, so a few per cent do not affect the fit.
    above = np.abs(controller.response(w) * link.tip()(1j * w)) > 1.0
    falls = np.nonzero(above[:-1] & ~above[1:])[0]
    return float(w[falls[-1]]) if falls.size else resonance
