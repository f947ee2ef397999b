"""What is said of a log's columns: units, signs, factors, answers to wrong units, the
time base.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from fraclink._arm.log_columns import (
    Channel,
    ColumnStatement,
    LogColumns,
    drive_columns,
    parse_columns,
)
from fraclink._arm.timebase import TimeBase, resampled, time_base
from fraclink.errors import FieldError, LogError
from fraclink.findings import Finding

RAW = np.array([2.0, 4.0, 7.0])


@pytest.mark.parametrize(
    ("unit", "role", "factor"),
    [
        ("s", "time", 1.0),
        ("ms", "time", 1e-3),
        ("us", "time", 1e-6),
        ("ns", "time", 1e-9),
        ("rad", "motor_angle", 1.0),
        ("mrad", "deflection", 1e-3),
        ("deg", "motor_angle", math.pi / 180),
        ("rev", "motor_angle", 2 * math.pi),
        ("mNm", "torque", 1e-3),
        ("N·m", "torque", 1.0),
        ("N*m", "torque", 1.0),
        ("mV", "voltage", 1e-3),
    ],
)
def test_units_in_si(unit: str, role: str, factor: float) -> None:
    assert Channel("x", unit).in_si(RAW, role) == pytest.approx(factor * RAW)


def test_sign_scale_and_offset_of_a_channel() -> None:
    assert Channel("x", "mNm", sign=-1, scale=5.0, offset=2.0).in_si(
        RAW, "torque"
    ) == pytest.approx([0.0, -0.01, -0.025])
    first = Channel("x", "s", scale=0.5, offset="first")
    assert first.in_si(RAW, "time").tolist() == [0.0, 1.0, 2.5]
    # a log in SI units is read bit for bit, negative zero included
    assert np.signbit(Channel("x", "s").in_si(np.array([-0.0, 1.0]), "time")[0])
    with pytest.raises(FieldError, match="which erases the signal"):
        Channel("x", "s", scale=0.0)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("time=t [s]", ("time", "t", "s", None, None)),
        ("motor_angle=-pot * 36.79 [deg]", ("motor_angle", "pot", "deg", -1, 36.79)),
        ("torque = + gauge ch [mNm]", ("torque", "gauge ch", "mNm", 1, None)),
        (
            "motor_angle=counts * 360/4096 [deg]",
            ("motor_angle", "counts", "deg", None, 360 / 4096),
        ),
        (
            "deflection=a*b [rad]",
            ("deflection", "a*b", "rad", None, None),
        ),  # a name with a star
        ("torque=* -3 [Nm]", ("torque", None, "Nm", -1, 3.0)),
        # As a laboratory writes its calibration: alpha_deg = -1.301 * strain_V.
        (
            "deflection=strain * -1.301 [deg]",
            ("deflection", "strain", "deg", -1, 1.301),
        ),
        ("deflection=-strain * -1/4 [deg]", ("deflection", "strain", "deg", 1, 0.25)),
        ("deflection=strain * +2 [deg]", ("deflection", "strain", "deg", None, 2.0)),
        ("deflection=a - 2 * b [deg]", ("deflection", "a - 2 * b", "deg", None, None)),
        ("voltage=* 2e-3 [V]", ("voltage", None, "V", None, 2e-3)),
        ("time=#row * 0.004 [s]", ("time", "#row", "s", None, 0.004)),
        ("torque", None),
        ("force=f [Nm]", None),
        ("torque=g * 1/0 [Nm]", None),
        ("torque=g * 1.2.3 [Nm]", None),
    ],
)
def test_a_statement_is_read_or_refused(
    text: str, wanted: tuple[object, ...] | None
) -> None:
    if wanted is None:
        with pytest.raises(FieldError) as caught:
            ColumnStatement.of(text)
        assert (caught.value.field, caught.value.value) == ("column", text)
        assert (
            "role=name [unit], each of time, motor_angle, torque"
            in caught.value.allowed
        )
        return
    found = ColumnStatement.of(text)
    assert (found.role, found.column, found.unit, found.sign, found.scale) == wanted


def test_columns_are_stated_once_each() -> None:
    good = [
        "time=t [ms]",
        "motor_angle=m * 2 [deg]",
        "deflection=-d [mrad]",
        "voltage=u [V]",
    ]
    assert parse_columns(good) == LogColumns(
        Channel("t", "ms"),
        Channel("m", "deg", scale=2.0),
        Channel("d", "mrad", sign=-1),
        "deflection",
        Channel("u", "V"),
    )
    for texts, words in (
        (good[:2], "not one time, one motor_angle and one output"),
        (good[1:], "not one time, one motor_angle and one output"),
        ([*good, "torque=g [Nm]"], "not one time, one motor_angle and one output"),
        ([*good, "time=x [s]"], "stated twice"),
        ([*good[:2], "torque=[Nm]"], "not understood"),
        ([*good[:2], "torque=g"], "not understood"),
        ([], "(nothing)"),
    ):
        with pytest.raises(FieldError) as caught:
            parse_columns(texts)
        assert words in str(caught.value)


def test_a_motors_log_needs_no_output() -> None:
    stated = ["time=t [s]", "motor_angle=enc * 2 [deg]", "voltage=u [V]"]
    assert drive_columns(stated).output == Channel("enc", "deg", scale=2.0)
    assert drive_columns(stated).output_kind == "deflection"
    with_torque = drive_columns([*stated, "torque=g [Nm]"])
    assert (with_torque.output_kind, with_torque.output.column) == ("torque", "g")
    with pytest.raises(FieldError, match="not one time"):
        drive_columns(["time=t [s]", "voltage=u [V]"])


@pytest.mark.parametrize(
    ("role", "unit", "words"),
    [
        (
            "deflection",
            "mm",
            'for a link of 0.32 m write "deflection=x * 1/0.32 [rad]"',
        ),
        (
            "motor_angle",
            "m/s2",
            "an accelerometer is no angle: fit it by identify-structure",
        ),
        (
            "torque",
            "counts",
            'a gauge that is not calibrated: write "deflection=x [rad]"',
        ),
        ("torque", "V", 'a gauge that is not calibrated: write "deflection=x [rad]"'),
        (
            "deflection",
            "LSB",
            'a gauge that is not calibrated: write "deflection=x [rad]"',
        ),
        (
            "motor_angle",
            "counts",
            "it measures another quantity; give one of rad, mrad, deg, rev",
        ),
        (
            "motor_angle",
            "V",
            "it measures another quantity; give one of rad, mrad, deg, rev",
        ),
        ("time", "mm", "it measures another quantity; give one of s, ms, us, ns"),
        ("torque", "g", "it measures another quantity; give one of Nm, mNm, N·m, N*m"),
        ("voltage", "mv", "did you mean 'mV'?"),
        ("time", "msec", "did you mean 'ms'?"),
        ("time", "hour", "give one of s, ms, us, ns"),
        ("time", "minutes", "give one of s, ms, us, ns"),
    ],
)
def test_a_unit_that_a_role_has_not_is_answered_with_a_way(
    role: str, unit: str, words: str
) -> None:
    channels = {"time": "s", "motor_angle": "rad", "torque": "Nm", "voltage": "V"}
    if role == "deflection":
        del channels["torque"]
    stated = channels | {role: unit}
    kind = "deflection" if role == "deflection" else "torque"
    with pytest.raises(FieldError) as caught:
        LogColumns(
            Channel("x", stated["time"]),
            Channel("x", stated["motor_angle"]),
            Channel("x", stated[kind]),
            kind,  # type: ignore[arg-type]
            Channel("x", stated["voltage"]),
        )
    assert (caught.value.field, caught.value.value) == (f"log.{role}.unit", unit)
    assert words in caught.value.remedy


# --- stamps -------------------------------------------------------------------------------------------------


def found(stamps: object, *, resample: bool = False) -> tuple[TimeBase, Finding | None]:
    base = time_base(np.asarray(stamps, dtype=float), resample=resample)
    assert len(base.findings) <= 1
    return base, base.findings[0] if base.findings else None


GRID = 5.0 + 0.01 * np.arange(101)


def test_uniform_stamps_are_the_line_through_their_ends() -> None:
    base, finding = found(GRID)
    assert (base.start, base.period, finding) == (5.0, 0.01, None)
    printed, finding = found(
        np.round(GRID + 3e-5, 4)
    )  # four digits: within a hundredth of a period
    assert finding is None and printed.period == pytest.approx(0.01, rel=1e-4)


def test_jitter_is_told_and_beyond_a_quarter_refused() -> None:
    shaken = GRID.copy()
    shaken[30] += 0.002
    base, finding = found(shaken)
    assert finding is not None and (finding.code, finding.severity) == ("W205", "info")
    assert finding.evidence["jitter_share"] == pytest.approx(0.2, abs=0.01)
    assert (
        "leave the uniform grid by up to" in finding.message
        and "taken as uniform" in finding.remedy
    )
    assert base.period == pytest.approx(0.01, rel=1e-4) and base.start == pytest.approx(
        5.0, abs=1e-4
    )
    shaken[30] += 0.001
    with pytest.raises(LogError, match="not uniform") as caught:
        found(shaken)
    assert "<= 25 % of" in caught.value.allowed
    _, finding = found(shaken, resample=True)
    assert (
        finding is not None
        and finding.severity == "warning"
        and "interpolated" in finding.remedy
    )


def test_jitter_of_the_ends_does_not_tilt_the_grid() -> None:
    late = GRID.copy()
    late[-1] += 0.002
    base, _ = found(late)
    assert base.period == pytest.approx(
        0.01, rel=2e-4
    )  # by the ends alone it would be 2e-3


def test_gaps_are_counted_in_lost_samples() -> None:
    holes = np.delete(GRID, [20, 21, 60])
    with pytest.raises(
        LogError, match="not uniform: 2 gaps, about 3 samples lost at 10 ms"
    ) as caught:
        found(holes)
    assert caught.value.value == "30 ms between samples, first after 5.19 s"
    assert caught.value.allowed == "gaps below 15 ms"
    base, finding = found(holes, resample=True)
    assert (
        finding is not None
        and finding.severity == "warning"
        and (base.start, base.period) == (5.0, 0.01)
    )
    assert finding.evidence == pytest.approx(
        {
            "gaps": 2,
            "lost_samples": 3,
            "longest_s": 0.03,
            "period_s": 0.01,
            "time_s": 0.19,
        }
    )
    tight = GRID.copy()
    tight[50:] += 0.0049  # a step of 14.9 ms is no gap, but jitter
    assert found(tight)[1].severity == "info"  # type: ignore[union-attr]
    tight[50:] += 0.0002
    with pytest.raises(LogError, match="1 gaps, about 1 samples lost"):
        found(tight)


def test_repeated_and_turning_stamps_are_named_by_their_sample() -> None:
    twice = np.insert(GRID, 10, GRID[10])
    with pytest.raises(LogError, match=r"repeated at sample 11 \(1 such\)") as caught:
        found(twice)
    assert caught.value.value == "5.1 s" or "5.1 s" in str(caught.value)
    base, finding = found(twice, resample=True)
    assert (base.start, base.period) == (5.0, 0.01)
    assert finding is not None and finding.evidence["jitter_share"] == pytest.approx(
        1.0
    )
    many = np.repeat(GRID, 2)
    with pytest.raises(
        LogError, match=r"repeated at sample 1, 3, 5, 7, 9 … \(101 such\)"
    ):
        found(many)
    back = GRID.copy()
    back[[4, 5]] = back[[5, 4]]
    with pytest.raises(
        LogError, match=r"decreasing \(after 5\.05 s; 1 such\)"
    ) as caught:
        found(back)
    assert caught.value.value == "5.04 s at sample 5"
    with pytest.raises(LogError, match="constant"):
        found(np.full(5, 3.0))


def test_milliseconds_that_are_called_seconds_are_suspected() -> None:
    with pytest.raises(LogError, match="it looks like milliseconds called seconds"):
        found([0.0, 1.0, 2.0])
    assert found([0.0, 0.99, 1.98])[0].period == 0.99


def test_values_are_interpolated_onto_the_grid() -> None:
    holes = np.delete(GRID, [20, 21, 60])
    base = time_base(holes, resample=True)
    values = resampled(holes, base, 3.0 * holes)
    assert values == pytest.approx(3.0 * GRID) and values.size == 101
    twice = np.insert(GRID, 10, GRID[10])
    signal = np.insert(GRID, 10, 99.0)  # the first of the two counts
    signal[10], signal[11] = GRID[10], 99.0
    assert resampled(twice, time_base(twice, resample=True), signal) == pytest.approx(
        GRID
    )
