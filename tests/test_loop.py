"""The loop and its sampled twin, against the explicit formula and sums of aliases."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink import Controller, LinkModel, MotorLoop, ParameterBox, SecondMode
from fraclink._arm.box import Arm
from fraclink.errors import FieldError
from fraclink.extend import Loop

RIG = fl.Rig.named("paper-2023")
MODE = SecondMode(frequency=150.0, gain=0.03, damping_ratio=0.02)
PLAIN = LinkModel(1.56, 11.0, order=1.92, payload=0.03)
LINKS = {
    "exact": PLAIN,
    "damped": replace(PLAIN, order=2.0, damping=1.5, damping_order=0.9),
    "late": replace(PLAIN, gauge_delay=0.02, gauge_gain=1.1),
    "damped and late": replace(PLAIN, damping=0.8, gauge_delay=0.01),
    "second mode": replace(PLAIN, gauge_delay=0.005, gauge_gain=0.95, second_mode=MODE),
}
CONTROLLER = Controller(
    derivative_gain=0.07, derivative_order=0.61, filter_time=0.004, filter_order=2
)


def link_response(link: LinkModel, s: complex) -> complex:
    """B of the link and its gauge, from its definition."""
    drag = link.damping * s**link.damping_order
    torque = s**link.order / (s**link.order + drag + link.natural_frequency**2)
    if link.second_mode is not None:
        m = link.second_mode
        torque += (
            m.gain
            * s**2
            / (s**2 + 2 * m.damping_ratio * m.frequency * s + m.frequency**2)
        )
    return 1 - link.gauge_gain * cmath.exp(-link.gauge_delay * s) * torque


def written_out(link: LinkModel, s: complex) -> complex:
    outer = (
        CONTROLLER.derivative_gain
        * s**CONTROLLER.derivative_order
        / (1 + CONTROLLER.filter_time * s) ** 2
    )
    return (
        outer
        * cmath.exp(-1.5 * 0.004 * s)
        / (1 + s / 80.0) ** 2
        * link_response(link, s)
    )


@pytest.mark.parametrize("name", LINKS)
def test_the_loop_is_its_formula_on_the_axis_and_beside_it(name: str) -> None:
    link = LINKS[name]
    loop = Loop.of(CONTROLLER, link, RIG)
    for w in (0.5, 8.0, 12.5, 40.0, 149.0, 600.0):
        wanted = written_out(link, 1j * w)
        assert complex(loop(w, 11.0)) == pytest.approx(wanted, rel=1e-10)
        log = complex(loop.log(w, 11.0))
        assert cmath.exp(log) == pytest.approx(wanted, rel=1e-10)
        assert float(loop.level(w, 11.0)) == pytest.approx(
            math.log(abs(wanted)), abs=1e-10
        )
        beside = w * (1 + 0.2j)  # s = jω with Re s < 0
        assert complex(loop(beside, 11.0)) == pytest.approx(
            written_out(link, 1j * beside), rel=1e-9
        )


@pytest.mark.slow
def test_the_phase_is_unwrapped_from_low_frequencies_on() -> None:
    for link in LINKS.values():
        loop = Loop.of(CONTROLLER, link, RIG)
        w = np.geomspace(0.01, 785.0, 20_000)
        phase, value = loop.log(w, 11.0).imag, dense(loop, w, 11.0)
        assert np.diff(phase) == pytest.approx(
            np.angle(value[1:] / value[:-1]), abs=1e-9
        )
        assert phase[0] == pytest.approx(0.5 * math.pi * 0.61, abs=0.01)


def test_a_loop_is_made_of_the_controllers_own_motor_loop_and_period() -> None:
    own = replace(CONTROLLER, motor_loop=MotorLoop(50.0, 3), period=0.002)
    loop = Loop.of(own, PLAIN, RIG)
    assert (loop.lag, loop.delay, loop.highest) == (
        1 / 50.0,
        pytest.approx(0.007),
        pytest.approx(math.pi / 0.002),
    )
    rigs = Loop.of(CONTROLLER, PLAIN, RIG)
    assert (rigs.lag, rigs.delay, rigs.highest) == (
        1 / 80.0,
        pytest.approx(0.006),
        pytest.approx(math.pi / 0.004),
    )
    ideal = Loop.ideal(LINKS["late"])
    assert (ideal.lag, ideal.delay, ideal.gauge_delay, ideal.highest) == (
        0.0,
        0.0,
        0.0,
        math.inf,
    )
    assert rigs.correction is None


def designed(link: LinkModel) -> fl.Design:
    wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.0}
    return fl.design(link, RIG, payloads=(0.02, 0.04), law=False, **wanted)


def test_a_model_without_a_payload_gets_the_rigs_nominal_one() -> None:
    bare = replace(PLAIN, payload=None)
    known = designed(bare).model
    assert known.payload == 0.03 and known.natural_frequency == pytest.approx(
        11.094, abs=1e-4
    )
    assert designed(PLAIN).model == PLAIN
    rows = (("natural_frequency", 8.9, 9.1), ("order", 1.9, 1.94))
    assert designed(replace(bare, intervals=rows)).model.intervals == rows[1:]


def dense(loop: Loop, w: NDArray[np.float64], w0: float) -> NDArray[np.complex128]:
    """L on a dense grid, one part at a time, which saves 100 MB."""
    return np.concatenate([loop(part, w0) for part in np.array_split(w, 20)])


# --- crossings and margins ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", LINKS)
def test_crossings_are_all_of_a_dense_scan(name: str) -> None:
    loop = Loop.of(CONTROLLER, LINKS[name], RIG)
    for w0 in (9.6, 13.6):
        w = np.geomspace(1e-3, math.pi / 0.004, 400_000)
        level = np.log(np.abs(dense(loop, w, w0)))
        at = np.flatnonzero((level[:-1] > 0) != (level[1:] > 0))
        found = loop.crossings(w0)
        assert found.frequency == pytest.approx(w[at], rel=1e-4)
        assert np.abs(loop(found.frequency, w0)) == pytest.approx(
            np.ones(at.size), rel=1e-9
        )
        assert (found.slope < 0).tolist() == (level[at + 1] < 0).tolist()
        angles = np.angle(-loop(found.frequency, w0))
        assert found.phase_margin == pytest.approx(angles, abs=1e-9)
        crossover, margin = loop.margins(w0)
        assert crossover[0] == found.frequency.max()
        assert abs(margin[0]) == pytest.approx(np.abs(angles).min())


@pytest.mark.parametrize("delay", [0.0, 0.03])
def test_crossings_about_a_sharp_second_mode_are_not_lost(delay: float) -> None:
    """ζ = 0.001: |L| is above one over a thousandth of the frequency, much less than
    the spacing of G's grid.
    """
    link = replace(PLAIN, gauge_delay=delay, second_mode=SecondMode(150.0, 0.01, 0.001))
    loop = Loop.of(CONTROLLER, link, RIG)
    w = np.linspace(149.0, 151.0, 40_001)
    level = np.abs(loop(w, 11.0)) > 1.0
    edges = w[np.flatnonzero(level[:-1] != level[1:])]
    assert edges.size == 2 and np.ptp(edges) < 1.0
    found = loop.crossings(11.0).frequency
    assert found[(found > 149.0) & (found < 151.0)] == pytest.approx(edges, abs=1e-4)


def test_the_sign_of_the_margin_is_that_of_the_encirclements() -> None:
    """With 21 and 22 times the gain: the closest approach to −1 is between them, on a
    dense Nyquist curve.
    """
    loop = Loop.of(CONTROLLER, PLAIN, RIG)
    w = np.geomspace(1e-3, math.pi / 0.004, 200_000)
    value = loop(w, 11.0)
    at = np.flatnonzero((value.imag[:-1] < 0) != (value.imag[1:] < 0))
    critical = 1 / max(-value.real[k] for k in at if value.real[k] < 0)
    for factor, stable in ((0.999, True), (1.001, False)):
        changed = replace(loop, gain=loop.gain * critical * factor)
        assert bool(changed.margins(11.0)[1][0] > 0) is stable
        assert changed.margins_at(11.0).stable is stable
    quiet = replace(loop, gain=1e-6)
    crossover, margin = quiet.margins([9.0, 11.0])
    assert crossover.tolist() == [0.0, 0.0] and margin.tolist() == [math.pi, math.pi]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("link", "error"),
    [
        (PLAIN, 1e-4),
        (replace(PLAIN, gauge_delay=0.005), 1e-4),
        (replace(PLAIN, gauge_delay=0.02), 1e-2),
        (
            replace(PLAIN, gauge_delay=0.01, second_mode=SecondMode(180.0, 0.05, 0.02)),
            1e-4,
        ),
    ],
)
def test_peak_and_noise_are_those_of_a_dense_grid(
    link: LinkModel, error: float
) -> None:
    loop = Loop.of(CONTROLLER, link, RIG)
    w = np.linspace(0.002, math.pi / 0.004, 400_001)
    for w0 in (9.6, 13.6):
        distance = np.abs(1 + dense(loop, w, w0))
        assert loop.margins_at(w0).modulus_margin == pytest.approx(
            distance.min(), rel=1e-5
        )
        c = CONTROLLER
        outer = (
            c.derivative_gain
            * w**c.derivative_order
            / (1 + (c.filter_time * w) ** 2) ** (0.5 * c.filter_order)
        )
        noise = math.sqrt(np.mean((outer / distance) ** 2))
        assert loop.noise_gain(w0, 0.004)[0] == pytest.approx(noise, rel=error)


# --- sampled ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize(
    ("kind", "delay"), [("ideal", 1), ("ideal", 0), ("sampled", 2)]
)
def test_the_sampled_plant_is_the_sum_of_its_aliases(
    name: str, kind: str, delay: int
) -> None:
    link, period = LINKS[name], 0.004
    motor_loop = MotorLoop(80.0, delay, kind)
    made = designed(PLAIN)
    controller = replace(made.controller, motor_loop=motor_loop)
    plant = replace(made, model=link, controller=controller).sampled_plant(11.0)
    w = np.array([2.0, 12.0, 100.0, 700.0])
    s = 1j * (w[:, None] + 2 * math.pi / period * np.arange(-3000, 3001))
    if kind == "ideal":
        drive = np.exp(-delay * period * s) / (1 + s / 80.0) ** 2
        before = np.ones(w.size, dtype=complex)
    else:
        drive = RIG.motor.gain / (s * (s + RIG.motor.decay))
        before = motor_loop.sampled(RIG.motor, period).voltage(w)
    bracket = np.vectorize(lambda x: link_response(link, x))(s)
    wanted = (
        before
        * (1 - np.exp(-1j * w * period))
        / period
        * np.sum(drive * bracket / s, axis=1)
    )
    assert plant(w) == pytest.approx(wanted, rel=2e-6, abs=1e-9)


# --- arms of a box ------------------------------------------------------------------------------------------


def test_an_arms_motor_is_faster_or_slower_than_its_loop_assumes() -> None:
    fast = Arm(PLAIN, 1.25)
    assert fast.loop(CONTROLLER, RIG).lag == pytest.approx(1 / 100.0)
    settings = MotorLoop(80.0, 1, "sampled")
    w = np.array([5.0, 40.0, 300.0])
    j, nu = RIG.motor.inertia / 1.25, RIG.motor.viscous_friction / 1.25
    # A is 1.25 times as large, B is unchanged
    true = replace(RIG.motor, inertia=j, viscous_friction=nu)
    pid = settings.pid(RIG.motor, 0.004)
    inner = replace(settings.sampled(RIG.motor, 0.004), motor=true)
    assert inner.pid == pid and true.gain == pytest.approx(1.25 * RIG.motor.gain)
    own = replace(CONTROLLER, motor_loop=settings)
    ratio = np.exp(
        fast.loop(own, RIG).motor_log(w) - Arm(PLAIN).loop(own, RIG).motor_log(w)
    )
    nominal = settings.sampled(RIG.motor, 0.004)
    wanted = inner.voltage(w) * 1.25 / nominal.voltage(w)
    assert ratio == pytest.approx(wanted, rel=1e-9)
    plants = [Arm(PLAIN, share).plant(settings, RIG, 0.004)(w) for share in (1.0, 1.25)]
    assert plants[1] / plants[0] == pytest.approx(wanted, rel=1e-6)
    ideal = [
        Arm(PLAIN, share).plant(MotorLoop(80.0, 1), RIG, 0.004)(w[:1])
        for share in (1.0, 1.25)
    ]
    slower = (1 + 5j / 80.0) ** 2 / (1 + 5j / 100.0) ** 2
    assert complex((ideal[1] / ideal[0])[0]) == pytest.approx(slower, rel=1e-3)
    other = replace(CONTROLLER, motor_loop=settings, period=0.002)
    assert Arm(PLAIN).loop(other, RIG).highest == pytest.approx(math.pi / 0.002)


def test_a_box_is_at_least_as_wide_as_the_rigs_tolerances() -> None:
    link = replace(LINKS["second mode"], damping=0.5, order=1.9)
    box = ParameterBox.of(link, RIG)
    assert box.natural_frequency == pytest.approx((11.0 * 0.985, 11.0 * 1.015))
    assert box.order == pytest.approx((1.87, 1.93))
    assert box.damping == pytest.approx((0.45, 0.55))
    assert box.gauge_gain == pytest.approx((0.95 * 0.95, 0.95 * 1.05))
    assert box.gauge_delay == pytest.approx((0.005, 0.007))
    assert box.motor_ratio == pytest.approx((0.9, 1.1))
    assert box.mode_frequency == pytest.approx((142.5, 157.5))
    assert box.mode_gain == pytest.approx((0.024, 0.036))
    known = (
        ("order", 1.8, 1.91),
        ("gauge_delay", 0.001, 0.006),
        ("stiffness", 1.3, 1.6),
    )
    wide = replace(link, intervals=known)
    fitted = ParameterBox.of(wide, RIG)
    assert fitted.order == pytest.approx(
        (1.8, 1.93)
    ) and fitted.gauge_delay == pytest.approx((0.001, 0.007))
    # the uncertainty of c left by a torque log becomes one of the gauge
    assert fitted.gauge_gain == pytest.approx((0.95 * 1.3 / 1.56, 0.95 * 1.05))
    assert ParameterBox.of(PLAIN, RIG).mode_gain == (0.0, 0.0)


def test_a_box_ends_where_a_link_would_be_none() -> None:
    """Without damping λ = 2 never comes to rest, and λ <= 1 has no vibration: the box
    extends at most half way to either.
    """
    stiff = ParameterBox.of(replace(PLAIN, order=1.98), RIG)
    assert stiff.order == pytest.approx((1.95, 1.99))
    damped = ParameterBox.of(replace(PLAIN, order=1.98, damping=0.5), RIG)
    assert damped.order == pytest.approx((1.95, 2.0))
    soft = replace(RIG, tolerances=replace(RIG.tolerances, order=0.4))
    assert ParameterBox.of(replace(PLAIN, order=1.3), soft).order == pytest.approx(
        (1.15, 1.65)
    )


def test_a_gauge_that_leads_is_believed_within_the_tolerance() -> None:
    early = ParameterBox.of(replace(PLAIN, gauge_delay=-0.0015), RIG)
    assert early.gauge_delay == pytest.approx((0.0, 0.0005))
    with pytest.raises(FieldError, match="negative"):
        ParameterBox.of(replace(PLAIN, gauge_delay=-0.0021), RIG)
    exact = replace(RIG, tolerances=replace(RIG.tolerances, gauge_delay=0.0))
    assert ParameterBox.of(replace(PLAIN, gauge_delay=-5e-5), exact).gauge_delay == (
        0.0,
        0.0,
    )
