"""Identify the motor from its voltage and angle: K/J, ν/J, Coulomb torque, dead zone,
delay.

    θm'' = A·z(V(t − τ)) − B θm' − C sign(θm') − Γ/J,    A = K/J, B = ν/J, C = Γc/J

z is the amplifier's dead zone. The equation is multiplied by smooth bumps and
integrated by parts, so that nothing is differentiated: the encoder's steps average out,
and (A, B, C, 1/J) follow from linear equations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.polynomial import Polynomial
from scipy.optimize import minimize

from fraclink._display import Overview, Row, displayed, number, rows_of
from fraclink._identify.fitting import check_motion
from fraclink._identify.problem import CERTAIN, LEAST_EACH, MOST
from fraclink._identify.residual import long_run_covariance
from fraclink.errors import LogError
from fraclink.findings import Finding, Judged
from fracsys.checks import Array, Between, Real, above, checked

# (1 − x²)⁵: its first four derivatives vanish at the ends
_BUMP = Polynomial([1.0, 0.0, -1.0]) ** 5


@displayed
@dataclass(frozen=True)
class MotorFit(Judged):
    """The motor as its log shows it.

    Parameters
    ----------
    gain
        A = K/J [rad/(V·s²)].
    decay
        B = ν/J [1/s].
    coulomb_voltage
        friction as the voltage that overcomes it, Γc/K [V].
    coulomb_torque
        Γc [N·m], None where neither the inertia nor the link's torque was given.
    dead_zone
        voltage below which the amplifier does nothing [V].
    delay
        of the voltage's effect [s].
    inertia
        J [kg·m²], given or identified from the torque, else None.
    standard_errors
        of gain, decay, coulomb_voltage (and inertia, spring); they allow for
        autocorrelation.
    nmse
        unexplained share of the accelerations' mean square [1].
    windows
        number of stretches of motion in one direction on which the fit is based.
    findings
        codes W33x; one of severity "error" means that the motor must not be used.
    spring
        k/J of a spring that pulls the motor to one angle, e.g. a cable [1/s²]; None
        where none was sought.
    """

    gain: float
    decay: float
    coulomb_voltage: float
    coulomb_torque: float | None
    dead_zone: float
    delay: float
    inertia: float | None
    standard_errors: dict[str, float]
    nmse: float
    windows: int
    findings: tuple[Finding, ...] = ()
    spring: float | None = None

    @property
    def rows(self) -> tuple[Row, ...]:
        """The motor's figures, each with its standard error."""
        errors = self.standard_errors
        return rows_of(
            self,
            Row("gain", "K/J", self.gain, "rad/(V·s²)", errors["gain"]),
            Row("decay", "ν/J", self.decay, "1/s", errors["decay"]),
            Row(
                "coulomb_voltage",
                "Coulomb friction",
                self.coulomb_voltage,
                "V",
                errors["coulomb_voltage"],
            ),
            ("coulomb_torque", "Coulomb torque", "N·m"),
            ("dead_zone", "dead zone", "V"),
            ("delay", "delay", "ms", 3),
            Row("inertia", "inertia J", self.inertia, "kg·m²", errors.get("inertia")),
            Row("spring", "spring k/J", self.spring, "1/s²", errors.get("spring")),
            ("nmse", "error (NMSE)", "%", 3),
            "windows",
        )

    def overview(self) -> Overview:
        """The motor in words, and its figures."""
        return Overview(
            f"motor K/J = {number(self.gain)} rad/(V·s²), ν/J = {number(self.decay)} 1/s",
            "passed" if self.passed else "not shown",
            self.rows,
            findings=self.findings,
        )


Channel = Annotated[Real, Array(1, min_size=200)]


@checked(error=LogError)
def identify_motor(
    voltage: Channel,
    motor_angle: Channel,
    *,
    period: Annotated[float, Between(1e-6, 10.0, "s")],
    torque: Channel | None = None,
    inertia: Annotated[float, above(0.0, 1e6, "kg·m²")] | None = None,
    delay: float | None = None,
    dead_zone: float | None = None,
    starts: Sequence[int] = (),
    spring: bool = False,
) -> MotorFit:
    """Identify the motor of eq. (1) with friction from voltage and angle; no guess is
    needed.

        θm'' = A·z(V(t − τ)) − B θm' − C sign(θm') − Γ/J,    A = K/J, B = ν/J, C = Γc/J

    Motion near rest is left out: there the friction takes any value up to Γc.

    Parameters
    ----------
    voltage
        V, shape (N,), held between samples [V].
    motor_angle
        θm, shape (N,) [rad].
    period
        sampling period [s].
    torque
        base torque Γ of the link, shape (N,) [N·m]: it loads the motor and, if
        known, gives J itself, in the torque's units. With a gauge that reads curvature,
        on a link of order λ, J is too small by the factor ω^(2−λ) at the vibration's
        frequency ω: the moment on the hub exceeds the reading by it.
    inertia
        J where it is known and no torque was recorded, for the Coulomb torque [kg·m²].
    delay, dead_zone
        where they are known [s], [V]; searched for otherwise.
    starts
        samples at which the later parts of a joined recording begin: no bump extends
        across one.
    spring
        whether a spring may pull the motor to some angle, −(k/J)(θm − θ₀) on the
        right: a cable, or an arm whose plane is tilted.

    Raises
    ------
    LogError
        signals without motion, or that give a motor with an impossible sign: K/J ≤ 0
        (the voltage brakes), ν/J or Coulomb friction clearly below zero (friction that
        drives), J below zero (a link that drives).
    FieldError
        arguments out of range.

    References
    ----------
    Benftima et al. (2023), equation (1).

    Examples
    --------
    >>> from fracsys._fractional import s
    >>> from fracsys._response import time_response
    >>> voltage = np.repeat(np.random.default_rng(1).uniform(-2.0, 2.0, 60), 50)
    >>> angle = time_response(100 / (s * (s + 5)), voltage, 0.004, hold="zero").output
    >>> fit = identify_motor(voltage, angle, period=0.004)
    >>> round(fit.gain), round(fit.decay, 1), fit.nmse < 1e-3
    (100, 5.0, True)
    """
    channels = {"voltage": voltage, "motor_angle": motor_angle}
    if torque is not None:
        channels["torque"] = torque
    for name, values in channels.items():
        if values.size != motor_angle.size:
            raise LogError(
                name,
                values.size,
                "of another length",
                f"{motor_angle.size} samples, as of motor_angle",
                "cut them to their common span",
            )
    check_motion(**channels)
    longest = period * motor_angle.size
    if delay is not None:
        delay = Between(0.0, longest, "s").check("delay", delay)
    if dead_zone is not None:
        dead_zone = Between(0.0, 0.99 * float(np.max(np.abs(voltage))), "V").check(
            "dead_zone", dead_zone
        )
    # 80 ms: friction, backlash and the encoder average out, and a move of a tenth of a
    # second still contains a bump. Fewer than 30 samples would not resolve the second
    # derivative of the bump.
    half = max(15, round(0.04 / period))
    bumps = _Bumps(motor_angle, torque, period, half, starts, spring)
    least = LEAST_EACH * (3 + (torque is not None) + 2 * spring)
    if bumps.places.size < least:
        raise LogError(
            "motor_angle",
            int(bumps.places.size),
            "too little motion in one direction",
            f">= {least} stretches of {2 * half * period:.3g} s",
            "drive further, with voltages of both signs",
        )
    best_delay, best_zone = _search(bumps, voltage, period, delay, dead_zone)
    return _judged(_result(bumps, voltage, best_delay, best_zone, inertia))


def _judged(fit: MotorFit) -> MotorFit:
    """The fit with its findings; LogError if its signs are impossible for a motor.

    Estimates for a motor with little friction scatter around zero, so a negative value
    is impossible only if its standard error cannot explain it.
    """
    for name, symbol in (
        ("gain", "K/J"),
        ("decay", "ν/J"),
        ("coulomb_voltage", "Coulomb friction"),
        ("inertia", "J"),
    ):
        value, error = getattr(fit, name), fit.standard_errors.get(name, math.inf)
        # A gain of zero or below is impossible, whatever its uncertainty: nothing can
        # be controlled with it.
        if (name == "gain" and value <= 0) or (value or 0.0) < -CERTAIN * error:
            raise LogError(
                name,
                value,
                f"{symbol} of an impossible sign, with a standard error of {error:.3g}",
                ">= 0",
                "check the sign of voltage and angle, the period, and the sign and unit of the link's torque",
            )
    findings = []
    error = fit.standard_errors.get("inertia", 0.0)
    if fit.inertia is not None and fit.inertia < CERTAIN * error:
        findings.append(
            Finding(
                "W303",
                "warning",
                "the link's torque does not show in the motion, and so neither does the inertia",
                {"inertia": fit.inertia, "standard_error": error},
                "state the inertia, or bend the link more",
            )
        )
        fit = replace(fit, inertia=None, coulomb_torque=None)
    if fit.nmse > MOST:
        findings.append(
            Finding(
                "W313",
                "error",
                "the motor model leaves most of the acceleration unexplained",
                {"nmse": fit.nmse, "most": MOST},
                "check that voltage and angle are of one recording, and give the link's torque",
            )
        )
    return replace(fit, findings=tuple(findings))


class _Bumps:
    """Bumps over stretches in which the motor moves in one direction, and their
    integrals with the known signals.
    """

    def __init__(
        self,
        angle: Real,
        load: Real | None,
        period: float,
        half: int,
        starts: Sequence[int] = (),
        spring: bool = False,
    ) -> None:
        self.period, self.half = period, half
        width = half * period
        x = np.arange(-half, half + 1) / half
        # By parts: ∫ φ θ'' = ∫ φ'' θ and ∫ φ θ' = −∫ φ' θ, since φ and its slope vanish
        # at both ends. The angle itself is never differentiated: the second difference
        # of an encoder's steps is noise only.
        first, second = _BUMP.deriv(1)(x) / width, _BUMP.deriv(2)(x) / width**2
        # As a sum over samples the second derivative neither vanishes for a constant
        # (2e-4 at 31 samples: 8 % of an angle in rad, whatever the zero of the encoder,
        # would count as an acceleration in rad/s²) nor is exact for a parabola (1.4e-4
        # too large, several standard errors of the gain). Both are corrected here.
        second -= second.mean()
        second *= np.sum(_BUMP(x)) / (0.5 * second @ (x * width) ** 2)
        slope = -np.correlate(angle, first, "valid") * period  # ∫ φ θ'
        mean = slope / (np.sum(_BUMP(x)) * period)
        # a velocity of zero marks samples that no bump may include
        for start in starts:
            mean[max(start - 2 * half, 0) : start] = 0.0
        wide = np.lib.stride_tricks.sliding_window_view(mean, 2 * half + 1)
        # A fraction of the fastest motion: closer to rest, friction takes any value up
        # to Γc.
        least = 0.03 * float(np.max(np.abs(mean)))
        steady = (np.min(wide, axis=1) > least) | (np.max(wide, axis=1) < -least)
        # A bump at k includes velocities half a bump to each side, which must all have
        # the same sign. Eight bumps per length of a bump: more give nearly the same
        # equations, fewer lose information.
        self.places = (np.flatnonzero(steady) + half)[:: max(1, half // 4)]
        self.centres = self.places + half

        def integral(weights: Real, signal: Real) -> Real:
            return (np.correlate(signal, weights, "valid") * period)[self.places]

        self.acceleration = integral(second, angle)
        area = integral(_BUMP(x), np.ones(angle.size))
        self.columns = {
            "decay": -slope[self.places],
            "coulomb_voltage": -np.sign(mean[self.places]) * area,
        }
        if load is not None:
            self.columns["inertia"] = -integral(_BUMP(x), load)
        if spring:
            self.columns |= {"spring": -integral(_BUMP(x), angle), "rest": area}

    def driven(self, u: Real, delay: float) -> Real:
        """∫ φ(t) u(t − τ) dt of a held voltage, exact for every τ."""
        shift = delay / self.period
        whole, reach = math.floor(shift), self.half + 1
        edges = np.arange(-reach, reach + 2) + (shift - whole)
        # A held voltage is a staircase: its integral with the bump is a sum of
        # differences of the antiderivative, also for delays of a fraction of a sample.
        integral = _BUMP.integ()(np.clip(edges / self.half, -1, 1))
        weights = np.diff(integral) * (self.half * self.period)
        # Before and after the log the voltage is assumed constant, since bumps near the
        # ends extend there.
        padded = np.pad(u, reach + abs(whole) + 1, mode="edge")
        products = np.correlate(padded, weights, "valid")
        # products[k] has the sample k − (abs(whole) + 1) of u, shifted by `whole`, at
        # the centre of its bump.
        return products[self.centres + abs(whole) + 1 - whole]

    def solved(self, u: Real, delay: float, zone: float) -> tuple[Real, Real, Real]:
        """The matrix with the columns of A, B, C (and 1/J) (and k/J, and k θ₀/J), their
        least-squares values, and the error.
        """
        driven = self.driven(np.sign(u) * np.maximum(np.abs(u) - zone, 0), delay)
        matrix = np.column_stack([driven, *self.columns.values()])
        values = np.linalg.lstsq(matrix, self.acceleration, rcond=None)[0]
        return matrix, np.asarray(values), self.acceleration - matrix @ values


def _search(
    bumps: _Bumps, u: Real, period: float, delay: float | None, dead_zone: float | None
) -> tuple[float, float]:
    """Delay and dead zone with the least cost: on a grid, then by descent from its best
    point.
    """
    # Up to eight samples for computation, filter and bus; in steps of half a sample,
    # because the cost has a kink at every whole one.
    delays = np.arange(0, 8.01, 0.5) * period if delay is None else np.array([delay])
    # Half of the usual voltage: with a larger dead zone the motor would have stayed at
    # rest.
    top = 0.5 * float(np.median(np.abs(u[u != 0]))) if np.any(u) else 0.0
    zones = np.linspace(0, top, 9) if dead_zone is None else np.array([dead_zone])
    steps = np.array([0.5 * period, top / 8 or 1.0])

    def cost(place: Real) -> float:
        return float(np.sum(bumps.solved(u, *(place * steps).tolist())[2] ** 2))

    grid = np.array([[d, z] for d in delays for z in zones]) / steps
    best = grid[np.argmin([cost(place) for place in grid])]
    free = np.array([delays.size > 1, zones.size > 1])
    # The bounds are the neighbours on the grid; its edges (no delay, no dead zone) are
    # included.
    bounds = np.stack([np.where(best > 0, best - free, best), best + free], axis=1)
    minimum = minimize(
        cost,
        best,
        method="Nelder-Mead",
        bounds=bounds,
        options={
            "xatol": 1e-4,
            "fatol": math.inf,
            "initial_simplex": best + np.array([[0, 0], [0.5, 0], [0, 0.5]]) * free,
        },
    )
    delay, zone = (minimum.x * steps).tolist()
    return delay, zone


def _result(
    bumps: _Bumps, u: Real, delay: float, zone: float, inertia: float | None
) -> MotorFit:
    matrix, values, error = bumps.solved(u, delay, zone)
    # If the log hardly excites a column, such as the link's torque, its standard error
    # shows it. The pseudo-inverse exists for a column of zeros, too.
    inverse = np.linalg.pinv(matrix.T @ matrix)
    # the bumps overlap eightfold
    meat = long_run_covariance((matrix * error[:, None]).T, min(16, error.size // 4))
    names = ("gain", *bumps.columns)
    found = dict(zip(names, values.tolist(), strict=True))
    gain, coulomb = found["gain"], found["coulomb_voltage"]
    # Γc/K is a quotient and J a reciprocal of the estimates: rows of their gradients.
    slopes = np.eye(values.size)
    slopes[2, [0, 2]] = -coulomb / gain**2, 1 / gain
    if "inertia" in found:
        inertia = 1 / found["inertia"]
        slopes[3, 3] = inertia**2
    variances = np.maximum(np.diag(slopes @ inverse @ meat @ inverse @ slopes.T), 0.0)
    errors = {
        name: math.sqrt(variance)
        for name, variance in zip(names, variances.tolist(), strict=True)
        if name != "rest"
    }
    return MotorFit(
        gain=gain,
        decay=found["decay"],
        coulomb_voltage=coulomb / gain,
        coulomb_torque=None if inertia is None else coulomb * inertia,
        dead_zone=zone,
        delay=delay,
        inertia=inertia,
        standard_errors=errors,
        nmse=float(np.sum(error**2) / np.sum(bumps.acceleration**2)),
        windows=int(bumps.places.size),
        spring=found.get("spring"),
    )
