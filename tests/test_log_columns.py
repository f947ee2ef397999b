"""Statements about the columns of a log: units, signs, factors, answers to wrong units,
the time base.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fraclink import Channel, LogColumns
from fraclink._arm.log_columns import ColumnStatement, parse_columns
from fraclink._arm.timebase import time_base
from fraclink.errors import FieldError, LogError
from fraclink.findings import Finding

RAW = np.array([2.0, 4.0, 7.0])


def test_sign_scale_and_offset_of_a_channel() -> None:
    assert Channel("x", "mNm", sign=-1, scale=5.0, offset=2.0).in_si(
        RAW, "torque"
    ) == pytest.approx([0.0, -0.01, -0.025])
    first = Channel("x", "s", scale=0.5, offset="first")
    assert first.in_si(RAW, "time").tolist() == [0.0, 1.0, 2.5]
    # a log in SI units is read bit for bit, including negative zero
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
        ),  # a name with an asterisk
        ("torque=* -3 [Nm]", ("torque", None, "Nm", -1, 3.0)),
        # As a laboratory states its calibration: alpha_deg = -1.301 * strain_V.
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
        deflection=Channel("d", "mrad", sign=-1),
        voltage=Channel("u", "V"),
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


# --- stamps -------------------------------------------------------------------------------------------------


def found(stamps: object, *, resample: bool = False) -> tuple[Any, Finding | None]:
    base = time_base(np.asarray(stamps, dtype=float), resample=resample)
    assert len(base.findings) <= 1
    return base, base.findings[0] if base.findings else None


GRID = 5.0 + 0.01 * np.arange(101)


def test_a_second_between_samples_is_milliseconds_called_seconds() -> None:
    stamps = np.arange(200.0)
    assert time_base(0.999 * stamps).period == pytest.approx(0.999)
    with pytest.raises(LogError, match='unit = "ms"'):
        time_base(stamps)


def test_the_output_is_the_torque_or_else_the_deflection() -> None:
    angle, output = Channel("theta", "rad"), Channel("gauge", "Nm")
    torque = LogColumns(time=Channel("t", "s"), motor_angle=angle, torque=output)
    assert (torque.output_kind, torque.output) == ("torque", output)
    output = Channel("gauge", "rad")
    deflection = LogColumns(
        time=Channel("t", "s"), motor_angle=angle, deflection=output
    )
    assert (deflection.output_kind, deflection.output) == ("deflection", output)


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
