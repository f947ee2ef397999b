"""What a column is by its motion, where names do not tell: `start` on files made here."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink.errors import LogError
from fraclink.logs import Question, Start
from made_logs import made_motion, made_output

Array = NDArray[np.float64]

TIME, MOTOR = made_motion(1500)
NOISE = np.random.default_rng(8).normal(0, 0.003, TIME.size)
DEFLECTION = made_output(MOTOR, stiffness=1.0) + NOISE  # 10 rad/s
TIP = MOTOR - DEFLECTION
DEG = 180 / math.pi
SPEED = np.gradient(MOTOR, 0.004)
ACCELERATION = np.gradient(SPEED, 0.004)
# The set-point of a loop with a bandwidth of 12 rad/s.
COMMAND = MOTOR + 1.4 / 12 * SPEED + ACCELERATION / 144
# Torque of the motor: what accelerates its inertia, and bends the link.
DRIVE = 0.02 * ACCELERATION + 1.5 * DEFLECTION


def written(path: Path, columns: dict[str, Array], separator: str = ",") -> Path:
    rows = np.column_stack([*columns.values()])
    lines = [separator.join(f"{value:.6f}" for value in row) for row in rows]
    path.write_text("\n".join([separator.join(columns), *lines]) + "\n", "utf-8")
    return path


def started(path: Path, **answers: str) -> tuple[Start, list[Question]]:
    asked: list[Question] = []

    def answer(question: Question) -> str:
        asked.append(question)
        return answers[question.role]

    return fl.logs.start(path, ask=answer), asked


def finds_the_link(result: Start) -> bool:
    model, output = result.fit.model, result.experiment.output
    frequency = model.natural_frequency ** (2 / model.order)
    alike = float(np.corrcoef(output, DEFLECTION[-output.size :])[0, 1])
    # The structures share the damping out between ω₀ and the order otherwise.
    return abs(frequency - 10) < 0.6 and alike > 0.98 and result.passed


def test_of_two_angles_the_output_vibrates_behind_the_measured_one(
    tmp_path: Path,
) -> None:
    columns = {"Zeit [s]": TIME, "Sollwinkel [deg]": DEG * COMMAND}
    columns |= {"Istwinkel [deg]": DEG * MOTOR, "DMS": 300 * DEFLECTION}
    result, asked = started(written(tmp_path / "log.csv", columns))
    assert not asked
    assert result.columns.motor_angle.column == "Istwinkel [deg]"
    assert finds_the_link(result)


def test_a_column_repeated_in_another_unit_is_no_question(tmp_path: Path) -> None:
    columns = {"t_s": TIME, "theta_rad": MOTOR, "theta_deg": DEG * MOTOR}
    columns |= {"alpha_deg": DEG * DEFLECTION, "alpha_mrad": 1e3 * DEFLECTION}
    result, asked = started(written(tmp_path / "log.csv", columns))
    assert not asked
    assert finds_the_link(result)


def test_the_torque_of_the_motor_is_not_taken_beside_the_vibration_of_the_link(
    tmp_path: Path,
) -> None:
    columns = {"t": TIME, "q1": TIP, "q2": MOTOR, "tau": DRIVE}
    path = written(tmp_path / "log.csv", columns)
    result, asked = started(path, motor_angle="q2 [rad]", output="q2 - q1 [rad]")
    assert [question.role for question in asked] == ["motor_angle", "output"]
    assert asked[1].choices[0] == "q2 - q1"
    assert finds_the_link(result)


def test_of_several_inputs_in_volts_the_gauge_is_named_first(tmp_path: Path) -> None:
    voltage = 0.3 * SPEED + 0.05 * ACCELERATION
    columns = {"t": TIME, "AI0 (V)": SPEED + 0.1 * NOISE, "AI1 (V)": 2 - 3 * DEFLECTION}
    columns |= {"AO0 (V)": voltage, "CTR0 (deg)": DEG * MOTOR}
    path = written(tmp_path / "log.csv", columns)
    result, asked = started(path, motor_angle="CTR0 (deg) [deg]", output="AI1 (V)")
    assert asked[-1].choices[0] == "AI1 (V)"
    assert finds_the_link(result)


def test_the_rate_of_a_deflection_is_refused(tmp_path: Path) -> None:
    rate = np.gradient(made_output(MOTOR, stiffness=1.0), 0.004)
    columns = {"t": TIME, "theta_rad": MOTOR, "gauge": rate}
    with pytest.raises(LogError, match="a speed"):
        started(written(tmp_path / "log.csv", columns))


def test_a_command_that_steps_is_no_motor_angle(tmp_path: Path) -> None:
    command = np.where(TIME > 2, 90.0, 0.0)
    path = written(tmp_path / "log.csv", {"t": TIME, "u": command, "y": DEFLECTION})
    with pytest.raises(LogError, match=r"u: .* a command"):
        started(path, motor_angle="none")


def test_an_answer_may_be_a_column_that_was_not_suggested(tmp_path: Path) -> None:
    columns = {"t": TIME, "theta_rad": MOTOR, "x": np.sin(3 * TIME), "temp": DEFLECTION}
    path = written(tmp_path / "log.csv", columns)
    result, asked = started(path, output="temp [rad]")
    assert "temp" not in asked[0].choices
    assert finds_the_link(result)


# --- forms of files ---------------------------------------------------------------------


def test_a_motor_angle_that_begins_again_after_a_turn_is_refused(
    tmp_path: Path,
) -> None:
    angle = (DEG * MOTOR + 350) % 360
    columns = {"t": TIME, "theta_deg": angle, "alpha_rad": DEFLECTION}
    with pytest.raises(LogError, match="an angle to unwrap"):
        started(written(tmp_path / "log.csv", columns), motor_angle="none")


def test_a_dump_of_words_is_refused_by_its_cells(tmp_path: Path) -> None:
    path = tmp_path / "can.log"
    words = [
        f"({t:.6f}) can0 181#{int(1e6 + 1e5 * a):08X}\n"
        for t, a in zip(TIME, MOTOR, strict=True)
    ]
    path.write_text("".join(words))
    with pytest.raises(LogError, match="not two columns of numbers"):
        started(path)


def test_a_row_of_units_may_hold_an_unknown_one_and_comments_may_follow_the_rows(
    tmp_path: Path,
) -> None:
    columns = {"Time": TIME, "HubAngle": DEG * MOTOR, "Gauge": DEFLECTION, "Load": TIP}
    path = written(tmp_path / "log.csv", columns)
    head, rows = path.read_text().split("\n", 1)
    path.write_text(f"{head}\nsec,deg,counts,deg\n{rows}# end: 1500 samples\n")
    result, _ = started(path)
    assert result.columns.motor_angle.unit == "deg"
    assert result.experiment.motor_angle.size == TIME.size
    assert finds_the_link(result)
