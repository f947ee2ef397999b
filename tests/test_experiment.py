"""The experiment: read-only arrays, and errors that name the channel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fraclink import Experiment, read_log
from fraclink.errors import FieldError, LogError

STATED = {"time": "t [s]", "motor_angle": "theta [rad]", "torque": "gamma [Nm]"}


def test_arrays_are_copies_that_cannot_be_written() -> None:
    mine = np.arange(5.0)
    log = Experiment(period=0.004, motor_angle=mine, output=mine, voltage=mine)
    mine[0] = 9
    assert log.motor_angle[0] == 0
    for values in (log.motor_angle, log.output, log.voltage):
        assert values is not None
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1


def test_time_starts_at_the_first_stamp() -> None:
    log = Experiment(
        period=0.5, motor_angle=[0, 1, 2], output=[0, 1, 2], start_time=10.0
    )
    assert log.time.tolist() == [10.0, 10.5, 11.0]
    assert log.duration == 1.0


@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.6, 0.99])
def test_a_split_covers_every_sample_once(fraction: float) -> None:
    log = Experiment(
        period=0.004, motor_angle=np.arange(100.0), output=np.arange(100.0)
    )
    first, rest = log.split(fraction)
    assert (
        np.concatenate((log.output[first], log.output[rest])).tolist()
        == log.output.tolist()
    )
    assert log.output[first].size == round(100 * fraction)


@pytest.mark.parametrize(
    ("changes", "error", "field"),
    [
        ({"period": 0.0}, FieldError, "period"),
        ({"period": float("nan")}, FieldError, "period"),
        ({"period": True}, FieldError, "period"),
        ({"payload": -0.03}, FieldError, "payload"),
        ({"start_time": float("inf")}, FieldError, "start_time"),
        ({"output_kind": "force"}, FieldError, "output_kind"),
        ({"motor_angle": [1.0]}, LogError, "motor_angle"),
        ({"output": [[1.0, 2.0], [3.0, 4.0]]}, LogError, "output"),
    ],
)
def test_values_that_make_no_sense_are_refused(
    changes: dict[str, object], error: type[FieldError], field: str
) -> None:
    good: dict[str, object] = {
        "period": 0.004,
        "motor_angle": [0.0, 1.0],
        "output": [0.0, 1.0],
    }
    with pytest.raises(error) as caught:
        Experiment(**(good | changes))  # type: ignore[arg-type]
    assert caught.value.field == field
    assert caught.value.allowed and caught.value.remedy


def test_stamps_of_another_length_are_refused() -> None:
    samples = np.sin(np.arange(9.0))
    with pytest.raises(LogError, match="8 stamps"):
        frame = {"t": 0.004 * np.arange(8), "theta": samples, "gamma": samples}
        Experiment.from_frame(frame, STATED)


@pytest.mark.parametrize("angle", [np.ones((9, 2)), np.ones((1, 9)), np.ones(1)])
def test_a_column_of_a_frame_is_one_array_of_samples(angle: NDArray[Any]) -> None:
    frame = {"t": 0.004 * np.arange(9), "theta": angle, "gamma": np.ones(9)}
    with pytest.raises(LogError, match="one-dimensional arrays") as caught:
        Experiment.from_frame(frame, STATED)
    assert caught.value.value == STATED["motor_angle"].split()[0]


def test_b18_lengths_differ() -> None:
    with pytest.raises(LogError, match="not as long as motor_angle") as caught:
        Experiment(period=0.004, motor_angle=[0, 1, 2], output=[0, 1])
    assert (caught.value.field, caught.value.value) == ("output", 2)


def test_b01_a_value_that_is_not_finite() -> None:
    with pytest.raises(LogError, match="not finite") as caught:
        Experiment(period=0.004, motor_angle=[0, 1, 2], output=[0, float("nan"), 3])
    assert caught.value.field == "output" and "entry 1" in str(caught.value)


@pytest.mark.parametrize("kind", ["torque", "deflection"])
@pytest.mark.parametrize("voltage", [False, True])
def test_a_saved_log_comes_back_with_the_same_bits(
    kind: str, voltage: bool, tmp_path: Path
) -> None:
    rng = np.random.default_rng(1)
    log = Experiment(
        period=0.004,
        motor_angle=rng.standard_normal(300),
        output=rng.standard_normal(300),
        output_kind=kind,  # type: ignore[arg-type]
        payload=0.0304,
        voltage=rng.standard_normal(300) if voltage else None,
        start_time=1.5,
        notes=(("simulated", "true"), ("operator", "Anna")),
    )
    log.save(tmp_path / "log.csv")
    again = read_log(tmp_path / "log.csv")
    same = ("period", "start_time", "output_kind", "payload")
    assert [getattr(again, name) for name in same] == [
        getattr(log, name) for name in same
    ]
    assert np.array_equal(again.motor_angle, log.motor_angle)
    assert np.array_equal(again.output, log.output)
    assert (again.voltage is None) == (log.voltage is None)
    assert again.simulated
    assert dict(again.notes)["operator"] == "Anna"
    again.save(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "log.csv").read_bytes()


def test_logs_are_equal_where_every_sample_is() -> None:
    one = Experiment(period=0.004, motor_angle=[0, 1, 2], output=[0, 1, 2])
    assert one == Experiment(period=0.004, motor_angle=[0, 1, 2], output=[0, 1, 2])
    assert one != Experiment(period=0.004, motor_angle=[0, 1, 2], output=[0, 1, 3])
    assert one != Experiment(
        period=0.004, motor_angle=[0, 1, 2], output=[0, 1, 2], voltage=[0, 0, 0]
    )
    assert one != "log"
    assert (
        len({one, Experiment(period=0.004, motor_angle=[0, 1, 2], output=[0, 1, 2])})
        == 1
    )


def test_notes_cannot_break_out_of_their_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    log = Experiment(
        period=0.004,
        motor_angle=rng.standard_normal(300),
        output=rng.standard_normal(300),
        notes=(("a", "b\ntime_s,x"),),
    )
    log.save(tmp_path / "log.csv")
    assert read_log(tmp_path / "log.csv").output.size == 300


# --- at home in Python ------------------------------------------------------------------------------------

TIME = 0.004 * np.arange(500)
ANGLE, TORQUE = np.sin(TIME), 0.3 * np.cos(3 * TIME)


def test_arrays_in_other_units_are_the_same_experiment() -> None:
    frame = {"t": TIME, "theta": ANGLE, "gamma": TORQUE, "u": ANGLE}
    log = Experiment.from_frame(frame, STATED, payload=0.03)
    assert (log.period, log.payload, log.output_kind) == (0.004, 0.03, "torque")
    frame |= {"t": 1e3 * TIME, "theta": np.degrees(ANGLE), "gamma": 1e3 * TORQUE}
    units = {"time": "t [ms]", "motor_angle": "theta [deg]", "torque": "gamma [mNm]"}
    other = Experiment.from_frame(frame, units | {"voltage": "u [V]"})
    assert other.period == 0.004
    assert np.allclose(other.motor_angle, log.motor_angle, rtol=1e-14, atol=1e-15)
    assert np.allclose(other.output, log.output, rtol=1e-14, atol=1e-15)
    assert np.array_equal(other.voltage, ANGLE)  # type: ignore[arg-type]
    kinds = {"time": "t [ms]", "motor_angle": "theta [deg]", "deflection": "u [rad]"}
    bent = Experiment.from_frame(frame, kinds)
    assert bent.output_unit == "rad"


@pytest.mark.slow
def test_a_frame_reads_like_the_file_with_the_same_columns() -> None:
    pa = pytest.importorskip("pyarrow")
    columns = {"t": TIME, "pot": np.degrees(ANGLE), "gauge": -TORQUE, "u": ANGLE}
    stated = {
        "time": "t [s]",
        "motor_angle": "pot [deg]",
        "torque": "- gauge [Nm]",
        "voltage": "u [V]",
    }
    for frame in (
        columns,
        pa.table(columns),
        np.rec.fromarrays(list(columns.values()), names=list(columns)),
    ):
        log = Experiment.from_frame(frame, stated, payload=0.02)
        assert np.allclose(log.motor_angle, ANGLE) and np.array_equal(
            log.output, TORQUE
        )
        assert log.voltage is not None and log.payload == 0.02
