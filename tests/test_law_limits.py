"""The thresholds of the guards and the numbers of the block, each from its own formula,
ω₀ = 10.
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace

import numpy as np
import pytest

from fraclink._arm.link import LinkModel
from fraclink._arm.motor import DiscretePid
from fraclink._law import block
from fraclink._law.block import (
    Drive,
    Modes,
    Tracking,
    block_values,
    inside_circle,
    linear_range,
    modes_of,
)
from fraclink._law.limits import Limits, Moves, derive_limits
from fraclink.errors import FieldError
from law_bench import law

# 1/G − 1 = s²/100: the motor leads the tip by a hundredth of the acceleration, whatever
# the frequency.
LINK = LinkModel(stiffness=2.0, natural_frequency=10.0, payload=0.03)
T, MOVES = 0.004, Moves(angle=3.0, velocity=5.0, acceleration=50.0)
FLEXION, TORQUE = 0.5, 2.0  # [rad], [N·m] twice the torque of a move


def limits(**options: float) -> Limits:
    return derive_limits(LINK, T, MOVES, **options)


def test_thresholds_without_sensors_are_those_of_the_move() -> None:
    found = limits(pole=80.0, kick=3.0)
    step = 3 * 5.0 * T
    held = 1.5 * math.pi / 10.0
    wanted = {
        "sum_limit": 4 * FLEXION + 3.0 * (2 * step + 1.05 * 5.0 * T),
        "correction_limit": 1.5 * ((2 / 80.0 + 1.5 * T) * 5.0 + 0.15),
        "forward_limit": 3 * 5.0 / T,
        "angle_limit": 3.0 + 2 * FLEXION,
        "angle_step": 2 * step,
        "torque_limit": 4 * TORQUE,
        "torque_step": 2 * 2.0 * step,
        "torque_trip": 1.5 * TORQUE,
        "torque_block": 2 * 2.0 / 100.0 * min(50.0, 2 * 5.0 / held),
        "reference_step": 1.05 * 5.0 * T,
        "reference_rate": 1 - math.exp(-10.0 * T / 3.0),
        "acceleration_limit": 60.0,
        "payload_limit": 0.12,
        "scale_step": T / 0.1,
        "motor_limit": 4.0,
        "motor_step": step,
        "fade_step": T / 0.2,
        "residual_angle": step + 0.02,
        "frozen_angle": step + 0.02,
        "stuck_torque": 0.1 * TORQUE,
        "wiring_energy": 0.1**2 / 25,
        "bad_limit": 5,
        "missed_limit": 5,
        "residual_limit": 10,
        "stuck_limit": 12,
        "frozen_limit": 8,
        "block_limit": round(held / T),
    }
    assert {name: getattr(found, name) for name in wanted} == pytest.approx(
        wanted, rel=1e-12
    )
    assert set(wanted) == set(Limits.__dataclass_fields__)


def test_sensors_and_friction_move_the_thresholds_that_they_concern() -> None:
    plain = limits()
    noisy = limits(
        gauge_limit=4.0, gauge_noise=0.05, gauge_quantum=0.002, encoder_resolution=1e-3
    )
    assert noisy.torque_limit == pytest.approx(
        0.975 * 4.0
    )  # below the amplifier's rail
    assert noisy.torque_trip == pytest.approx(
        3.0
    ) and plain.torque_trip == pytest.approx(3.0)
    assert noisy.torque_step == pytest.approx(plain.torque_step + 8 * 0.05 + 2 * 0.002)
    assert noisy.angle_step == pytest.approx(plain.angle_step + 2e-3)
    assert (
        noisy.stuck_torque == 0.05
    )  # a gauge this noisy never reads the same twelve times
    assert noisy.wiring_energy == pytest.approx((6 * math.sqrt(2) * 0.05 / 2.0) ** 2)
    coarse = limits(gauge_noise=0.002, gauge_quantum=0.05)
    assert coarse.stuck_torque == pytest.approx(8 * 0.05 + 4 * 0.002)
    assert limits(gauge_noise=0.002, gauge_quantum=0.002).stuck_torque == pytest.approx(
        0.1 * TORQUE
    )
    # 4.5 periods² at the largest acceleration, or what friction holds back, if that is
    # more
    assert limits(sticking=0.0).frozen_angle == pytest.approx(4.5 * 50.0 * T**2)
    held = limits(sticking=0.01, encoder_resolution=1e-3).frozen_angle
    assert held == pytest.approx(2e-3 + 0.01)
    weak = limits(gauge_limit=1.0)
    assert weak.torque_trip == pytest.approx(0.9 * 0.975)
    assert limits(gauge_limit=0.5).torque_block == pytest.approx(0.9 * 0.975 * 0.5)
    assert derive_limits(replace(LINK, payload=None), T, MOVES).payload_limit == 0.0


def test_slow_periods_fade_within_one() -> None:
    slow = derive_limits(LINK, 0.5, MOVES)
    assert (slow.scale_step, slow.fade_step) == (1.0, 1.0)
    assert slow.block_limit == 5  # never fewer periods than a row of lost samples
    assert derive_limits(LINK, 0.05, MOVES).scale_step == pytest.approx(0.5)
    assert derive_limits(LINK, 0.05, MOVES).fade_step == pytest.approx(0.25)


def test_a_slow_move_blocks_by_its_acceleration() -> None:
    gentle = derive_limits(LINK, T, Moves(angle=3.0, velocity=5.0, acceleration=10.0))
    assert gentle.torque_block == pytest.approx(2 * 2.0 * 0.01 * 10.0)


def test_moves_name_the_value_that_is_none() -> None:
    assert (Moves().angle, Moves().velocity, Moves().acceleration) == (
        2 * math.pi,
        6.0,
        60.0,
    )
    assert type(Moves(angle=3).angle) is float
    for name in ("angle", "velocity", "acceleration"):
        for value in (0.0, -1.0, math.nan, 2e6):
            with pytest.raises(FieldError) as caught:
                Moves(**{name: value})
            assert caught.value.field == f"moves.{name}"


# --- the block --------------------------------------------------------------------------------------------

PID = DiscretePid(T, 2.0, 9.0, 40.0, -3.0, -2.0, 0.002, 0.001, 0.0013, 0.0007, 0.24)
PLAIN = Modes(1.5, (0.5, 0.9), (0.1, -0.2), (0.3 + 0.4j,), (0.7 - 0.2j,))


def values(**changes: object) -> dict[str, float]:
    given = {
        "period": T,
        "stiffness": 2.0,
        "inner_pole": 80.0,
        "correction": PLAIN,
        "feedforward": Modes(0.25, (0.8,), (0.05,)),
        "limits": limits(),
        "drive": Drive(
            PID, 10.0, torque_voltage=0.1, coulomb_voltage=0.3, coulomb_speed=0.02
        ),
    }
    return block_values(**(given | changes))  # type: ignore[arg-type]


def test_the_motor_loop_stands_in_the_block_by_its_products() -> None:
    found, bound = values(), limits()
    wanted = {
        "inner_direct": 2.0,
        "inner_angle": 9.0,
        "integral_now": 40.0 * 0.002,
        "integral_before": 40.0 * 0.001,
        "filter_now": -3.0 * 0.0013,
        "filter_before": -3.0 * 0.0007,
        "filter_angle_now": -2.0 * 0.0013,
        "filter_angle_before": -2.0 * 0.0007,
        "filter_decay": 0.24,
        "voltage_limit": 10.0,
        "torque_voltage": 0.1,
        "coulomb_voltage": 0.3,
        "coulomb_slope": 1 / (0.02 * T),
        # the motor's error at the largest speed, the compensated torque and the
        # friction, beside the limit
        "wanted_limit": 10.0
        + 2.0 * ((2 / (80.0 * T) + 1.5) * bound.motor_step + bound.residual_angle)
        + 0.1 * bound.torque_limit
        + 0.3,
        "residual_rate": 1 - math.exp(-80.0 * T),
        "compliance": 0.5,
        "stiffness": 2.0,
        "options": 1,
    }
    assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-12)


def test_a_law_without_friction_motor_or_gauge_has_zeros_there() -> None:
    smooth = values(
        drive=Drive(
            PID, 10.0, torque_voltage=0.1, coulomb_voltage=0.0, coulomb_speed=0.02
        )
    )
    assert smooth["coulomb_slope"] == 0.0
    bare = values(drive=None)
    assert bare["options"] == 0 and {bare[name] for name in block.INNER} == {0.0}
    blind = values(stiffness=math.inf)
    assert (blind["compliance"], blind["stiffness"]) == (0.0, 0.0)
    still = values(inner_pole=0.0)
    error = limits().motor_limit + limits().angle_limit
    assert still["residual_rate"] == 0.0
    assert still["wanted_limit"] == pytest.approx(
        10.0 + 2 * error * (2.0 + 2 * 40.0 * 0.002) + 0.1 * limits().torque_limit + 0.3
    )


def test_what_a_payload_needs_stands_in_the_block() -> None:
    track = Tracking(
        nominal=0.05,
        link=0.01,
        now=0.2,
        next=0.3,
        keep=0.4,
        gauge_delay=0.02,
        gauge_gain=0.9,
    )
    found, keep = values(tracking=track), math.exp(-T / 0.02)
    wanted = {
        "link_scale": 0.2,
        "payload_scale": 20.0,
        "track_now": 0.2,
        "track_next": 0.3,
        "track_keep": 0.4,
        "gauge_now": 0.9 * (1 - keep),
        "gauge_keep": keep,
        "options": 3,
    }
    assert {name: found[name] for name in wanted} == pytest.approx(wanted, rel=1e-12)
    exact = replace(track, gauge_delay=0.0, gauge_gain=1.0)
    assert (values(tracking=exact)["options"], values(tracking=exact)["gauge_now"]) == (
        1,
        1.0,
    )
    assert values(tracking=replace(exact, gauge_gain=1.1))["options"] == 3
    none = values()
    assert (
        none["link_scale"],
        none["payload_scale"],
        none["track_now"],
        none["gauge_keep"],
    ) == (0, 1, 1, 0)


def test_modes_are_listed_as_law_h_has_them() -> None:
    found = values()
    assert found["real"] == [0.5, 0.1, 0.9, -0.2] and found["real_modes"] == 2
    assert found["pair"] == [0.3, 0.4, 0.7, -0.2] and found["pair_modes"] == 1
    assert (found["forward"], found["forward_direct"], found["forward_modes"]) == (
        [0.8, 0.05],
        0.25,
        1,
    )
    z = np.exp(0.3j)
    total = found["direct"] + sum(gain / (z - pole) for pole, gain in modes_of(found))
    own = 1.5 + 0.1 / (z - 0.5) - 0.2 / (z - 0.9)
    c, q = 0.7 - 0.2j, 0.3 + 0.4j
    own += 0.5 * (c / (z - q) + c.conjugate() / (z - q.conjugate()))
    assert total == pytest.approx(own, rel=1e-13)
    padded = dict(found) | {
        "real": [0.5, 0.1, 0.0, 0.0],
        "pair": [0.3, 0.4, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0],
    }
    assert [gain for _, gain in modes_of(padded)] == [0.1, 0.1j, -0.1j]


@pytest.mark.parametrize("precision", ["single", "double"])
def test_a_block_reads_back_with_its_header(precision: block.Precision) -> None:
    made = block.pack(values(), precision)
    found = block.unpack(made, precision)
    width = 4 if precision == "single" else 8
    assert (found["version"], found["size"], found["precision"]) == (
        3,
        len(made),
        width,
    )
    assert (
        found["direct"] == 1.5
        and found["bad_limit"] == 5
        and found["block_limit"] == limits().block_limit
    )
    assert found["real"] == pytest.approx([0.5, 0.1, 0.9, -0.2, *[0.0] * 12], rel=1e-6)
    assert found["scale_step"] == pytest.approx(T / 0.1, rel=1e-6)
    old = block.pack(values(), precision, version=2)
    assert len(old) < len(made) and "payload_limit" not in block.unpack(old, precision)
    assert block.unpack(old, precision)["coulomb_slope"] == found["coulomb_slope"]
    # law.c compiled for one design has just the modes that it has: 6 of 8 real, 1 of 2
    # pairs, 7 of 8 go
    size, _ = block.exact_header(made, precision, {"real": 2, "pair": 1, "forward": 1})
    numbers = sum(length for _, length in block.REALS) - 12 - 4 - 14
    assert size == 16 + 40 + width * numbers


def test_what_no_block_holds_is_refused() -> None:
    with pytest.raises(FieldError, match="too many for the law"):
        block.pack(values() | {"real": [0.1] * 17}, "double")
    assert block.pack(values() | {"real": [0.1] * 16}, "double")
    with pytest.raises(FieldError, match="single precision"):
        block.pack(values() | {"direct": 1e300}, "single")
    with pytest.raises(FieldError) as caught:
        block.pack(values(), "half")  # type: ignore[arg-type]
    assert caught.value.field == "precision"
    assert struct.unpack("<I", block.pack(values(), "double")[:4]) == (3,)


# --- how far the command is the linear filter ---------------------------------------------------------------


def test_linear_range_is_the_largest_error_that_no_limit_meets() -> None:
    """One mode g/(z − p): a worst error of ±X drives its state to X (1 + |1 − p|/(1 −
    |p|)).
    """
    free = {"direct": 0.0, "real": [0.5, 2.0], "pair": [], "correction_limit": 1e9}
    free |= {"sum_limit": 1e9, "motor_limit": 1e9, "motor_step": 1e9}
    gain = 2.0 * 2.0  # the norm 1 + 0.5/0.5 times g
    assert linear_range(free | {"sum_limit": 1.0}) == pytest.approx(
        0.24
    )  # 1/4, rounded down to two digits
    assert linear_range(free | {"sum_limit": 1.001 * gain}) == 1.0
    assert linear_range(free | {"motor_limit": 2.0 * gain * 1.001}) == 2.0
    assert linear_range(free | {"motor_step": 6.0 * gain * 1.001}) == 3.0
    assert linear_range(free | {"correction_limit": 2.0 * 1.501}) == 1.5
    assert linear_range(free | {"real": [], "direct": 0.5, "sum_limit": 1.001}) == 1.0
    assert (
        linear_range(free | {"real": [], "direct": 0.5, "correction_limit": 0.7001})
        == 0.7
    )
    with pytest.raises(FieldError, match="too narrow"):
        linear_range(free | {"sum_limit": 3.9e-5})
    assert linear_range(free | {"sum_limit": 4.1e-5}) == 1e-5
    with pytest.raises(FieldError, match="too narrow"):
        linear_range(free | {"real": [1.0, 2.0]})


@pytest.mark.parametrize(
    ("roots", "inside"),
    [
        ([0.5, -0.9], True),
        ([0.99, 0.98, 0.97], True),
        ([1.01, 0.2], False),
        ([-1.0], False),
        ([0.6 + 0.79j, 0.6 - 0.79j, 0.1], True),
        ([0.6 + 0.81j, 0.6 - 0.81j, 0.1], False),
    ],
)
def test_reflection_coefficients_tell_where_the_roots_lie(
    roots: list[complex], inside: bool
) -> None:
    assert inside_circle(np.poly(roots).real.tolist()) is inside


def test_a_laws_guards_are_those_of_its_rig() -> None:
    """The paper's rig: 4 N·m in 12 bits, 10 mN·m of noise, 100 000 counts, 0.1 V of
    friction.
    """
    made = law()
    assert made.limits.torque_limit <= 0.975 * 4.0
    assert made.drive is not None
    assert made.drive.coulomb_voltage == pytest.approx(0.02 / 0.21)
    assert made.drive.torque_voltage == pytest.approx(1 / 0.21)
    assert (made.drive.voltage_limit, made.drive.coulomb_speed) == (10.0, 0.02)
    sticking = 3.0 * made.drive.coulomb_voltage / made.drive.loop.stiffness
    wanted = 2 * (2 * math.pi / 100_000) + max(sticking, 4.5 * 60.0 * made.period**2)
    assert made.limits.frozen_angle == pytest.approx(
        min(wanted, made.limits.residual_angle)
    )
