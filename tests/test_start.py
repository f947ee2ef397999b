"""`start` on logs of many shapes: how it interprets each, what it asks, and how it
refuses.
"""

from __future__ import annotations

import dataclasses
import io
import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink import main
from fraclink._arm.draft import load_rig_or_draft
from fraclink.errors import FieldError, LogError
from fraclink.extend import read_columns
from fraclink.logs import Match, Question, match
from made_logs import made_motion, made_output
from shared_data import shared_data

Array = NDArray[np.float64]

COUNT = 1500
TIME, MOTOR = made_motion(COUNT)
NOISE = np.random.default_rng(8).normal(0, 0.004, COUNT)
TORQUE = made_output(MOTOR) + NOISE  # c = 1.5 N·m/rad, 10 rad/s
DEFLECTION = made_output(MOTOR, stiffness=1.0) + NOISE
VOLTAGE = 3 * np.gradient(MOTOR, 0.004) + 0.02 * np.sin(7 * TIME)
REFERENCE = np.repeat(MOTOR[::125], 125)[:COUNT]
DEG = 180 / math.pi


@dataclasses.dataclass(frozen=True)
class Shape:
    """A log as a file: columns by header, the separator of the cells, and the lines
    before them.
    """

    columns: Mapping[str, Array]
    separator: str = ","
    before: str = ""
    header: bool = True
    comma: bool = False
    digits: str = ".7g"

    def write(self, path: Path) -> Path:
        """Write the file."""
        rows = zip(*(values.tolist() for values in self.columns.values()), strict=True)
        cells = [[format(value, self.digits) for value in row] for row in rows]
        lines = [self.separator.join(row) for row in cells]
        if self.comma:
            lines = [line.replace(".", ",") for line in lines]
        head = [self.separator.join(self.columns)] if self.header else []
        path.write_text(self.before + "\n".join([*head, *lines]) + "\n", "utf-8")
        return path


# The interpretation of each shape: time, unit; motor angle, unit; kind, column, unit,
# sign; the certainty is below.
Taken = tuple[str, str, str, str, str, str, str, int]
RAW = "rad"
THROUGH: dict[str, tuple[Shape, tuple[str, ...], Taken]] = {
    "milliseconds, degrees, a turned sign in mN·m": (
        Shape(
            {"t_ms": 1e3 * TIME, "theta_deg": DEG * MOTOR, "bridge_mNm": -1e3 * TORQUE}
        ),
        (),
        ("t_ms", "ms", "theta_deg", "deg", "torque", "bridge_mNm", "mNm", -1),
    ),
    "decimal commas": (
        Shape(
            {"t_s": TIME, "theta_deg": DEG * MOTOR, "torque_Nm": TORQUE},
            separator=";",
            comma=True,
        ),
        (),
        ("t_s", "s", "theta_deg", "deg", "torque", "torque_Nm", "Nm", 1),
    ),
    "German names": (
        Shape(
            {
                "Zeit (s)": TIME,
                "Motorwinkel (Grad)": DEG * MOTOR,
                "Drehmoment (Nm)": TORQUE,
            },
            separator=";",
        ),
        (),
        (
            "Zeit (s)",
            "s",
            "Motorwinkel (Grad)",
            "deg",
            "torque",
            "Drehmoment (Nm)",
            "Nm",
            1,
        ),
    ),
    "no unit, milliseconds and degrees": (
        Shape({"t": 1e3 * TIME, "enc": DEG * MOTOR, "torque": TORQUE}),
        ("motor_angle=[deg]", "torque=[Nm]"),
        ("t", "ms", "enc", "deg", "torque", "torque", "Nm", 1),
    ),
    "a deflection without a unit": (
        Shape({"t": TIME, "theta_deg": DEG * MOTOR, "alpha": DEG * DEFLECTION}),
        (),
        ("t", "s", "theta_deg", "deg", "deflection", "alpha", RAW, 1),
    ),
    "strain in volts": (
        Shape({"t": TIME, "theta_rad": MOTOR, "strain_V": -0.4 * DEFLECTION + 0.05}),
        (),
        ("t", "s", "theta_rad", "rad", "deflection", "strain_V", RAW, -1),
    ),
    "a bridge that the call calibrates": (
        Shape({"t": TIME, "enc": DEG * MOTOR, "bridge": -1e3 * TORQUE}),
        ("torque=bridge [mNm]", "motor_angle=[deg]"),
        ("t", "s", "enc", "deg", "torque", "bridge", "mNm", -1),
    ),
    "extra columns: reference, speed, tip, current, voltage": (
        Shape(
            {
                "t": TIME,
                "theta_ref": REFERENCE,
                "theta_m": MOTOR,
                "omega": np.gradient(MOTOR, 0.004),
                "tip_angle": MOTOR - DEFLECTION,
                "current_A": VOLTAGE / 3,
                "u_V": -VOLTAGE,
                "gamma_Nm": TORQUE,
            }
        ),
        ("motor_angle=[rad]",),
        ("t", "s", "theta_m", "rad", "torque", "gamma_Nm", "Nm", 1),
    ),
    "a sample number beside the time": (
        Shape(
            {
                "index": np.arange(COUNT, dtype=np.float64),
                "time_s": TIME,
                "theta_deg": DEG * MOTOR,
                "torque_Nm": TORQUE,
            }
        ),
        (),
        ("time_s", "s", "theta_deg", "deg", "torque", "torque_Nm", "Nm", 1),
    ),
    "a LabVIEW header as comments": (
        Shape(
            {"# X_Value": TIME, "Theta_deg": DEG * MOTOR, "Torque_Nm": TORQUE},
            separator="\t",
            before="# LabVIEW Measurement\n# Separator: Tab\n# Multi_Headings: No\n",
        ),
        (),
        ("X_Value", "s", "Theta_deg", "deg", "torque", "Torque_Nm", "Nm", 1),
    ),
    "no header": (
        Shape({"a": TIME, "b": MOTOR, "c": TORQUE}, header=False),
        ("torque=#3 [Nm]", "motor_angle=#2 [rad]"),
        ("#1", "s", "#2", "rad", "torque", "#3", "Nm", 1),
    ),
    "encoder counts with the counts of a turn": (
        Shape(
            {"t": TIME, "enc": np.round(MOTOR * 4096 / 2 / math.pi), "torque": TORQUE}
        ),
        ("motor_angle=enc * 1/4096 [rev]", "torque=[Nm]"),
        ("t", "s", "enc", "rev", "torque", "torque", "Nm", 1),
    ),
    "a tip angle": (
        Shape({"t": TIME, "theta": MOTOR, "tip_rad": MOTOR - DEFLECTION}),
        ("motor_angle=[rad]",),
        ("t", "s", "theta", "rad", "deflection", "theta - tip_rad", RAW, 1),
    ),
    "a tip angle that is called a deflection": (
        Shape({"t_s": TIME, "theta_rad": MOTOR, "alpha_rad": MOTOR - DEFLECTION}),
        (),
        (
            "t_s",
            "s",
            "theta_rad",
            "rad",
            "deflection",
            "theta_rad - alpha_rad",
            "rad",
            1,
        ),
    ),
    "stamps of each channel, as in TDMS": (
        Shape(
            {
                "Arm/Theta": MOTOR,
                "Arm/Theta.time": TIME,
                "Arm/Torque": TORQUE,
                "Arm/Torque.time": TIME,
            }
        ),
        ("time=Arm/Theta.time [s]", "motor_angle=[rad]", "torque=[Nm]"),
        ("Arm/Theta.time", "s", "Arm/Theta", "rad", "torque", "Arm/Torque", "Nm", 1),
    ),
    "a potentiometer in volts with its factor": (
        Shape({"t": TIME, "pot_V": DEG * MOTOR / 36.8 + 2.5, "torque_Nm": TORQUE}),
        ("motor_angle=pot_V * 36.8 [deg]",),
        ("t", "s", "pot_V", "deg", "torque", "torque_Nm", "Nm", 1),
    ),
    "a period instead of stamps": (
        Shape({"theta_deg": DEG * MOTOR, "torque_Nm": TORQUE}),
        ("time=#row * 4 [ms]",),
        ("#row", "ms", "theta_deg", "deg", "torque", "torque_Nm", "Nm", 1),
    ),
    "names for all but one column, commented, beside a date": (
        Shape(
            {
                "a": 343393 + 1e3 * TIME,
                "b": MOTOR,
                "c": -0.45 * DEFLECTION,
                "d": np.gradient(MOTOR, 0.004),
                "e": NOISE,
                "f": 0 * NOISE,
            },
            separator="\t",
            before="%Time (s)\tHub(Theta in rad)\tTip Deflection(m)\tHub Velocity (rads/s)\t%3/4/2026 11:23 AM\n",
            header=False,
        ),
        ("time=[ms]",),
        ("#1", "ms", "#2", "rad", "deflection", "#3", "rad", -1),
    ),
    "what was asked for beside what was measured": (
        Shape(
            {
                "t": TIME,
                "theta_d (deg)": DEG * REFERENCE,
                "theta (deg)": DEG * MOTOR,
                "gamma_Nm": TORQUE,
            }
        ),
        (),
        ("t", "s", "theta (deg)", "deg", "torque", "gamma_Nm", "Nm", 1),
    ),
    "a sign that the call keeps": (
        Shape({"t": TIME, "theta": MOTOR, "torque_Nm": -TORQUE}),
        ("torque=+torque_Nm", "motor_angle=[rad]"),
        ("t", "s", "theta", "rad", "torque", "torque_Nm", "Nm", 1),
    ),
}

# Shapes that are refused, with the remedy in the error message.
REFUSED: dict[str, tuple[Shape, str]] = {
    "decimal commas between commas": (
        Shape({"t_s": TIME, "theta_deg": DEG * MOTOR, "torque_Nm": TORQUE}, comma=True),
        "export with decimal points",
    ),
    "encoder counts": (
        Shape(
            {"t": TIME, "enc": np.round(MOTOR * 4096 / 2 / math.pi), "torque": TORQUE}
        ),
        '--column "motor_angle=enc * 1/N [rev]"',
    ),
    "no stamps": (
        Shape({"theta_deg": DEG * MOTOR, "torque_Nm": TORQUE}),
        "--period-ms 4",
    ),
    "a counter as the only clock": (
        Shape(
            {
                "n": np.arange(COUNT, dtype=np.float64),
                "theta_deg": DEG * MOTOR,
                "torque_Nm": TORQUE,
            }
        ),
        '--column "time=n * 0.004 [s]"',
    ),
    "two encoders": (
        Shape(
            {"t": TIME, "enc1": MOTOR, "enc2": MOTOR - DEFLECTION, "torque_Nm": TORQUE}
        ),
        '--column "motor_angle=enc1 [deg]"',
    ),
    "no output": (Shape({"t": TIME, "theta": MOTOR}), "Record both signals together"),
    "a table that is too short": (
        Shape({"t_s": TIME[:2], "theta_rad": MOTOR[:2]}),
        "too short",
    ),
    "an acceleration": (
        Shape(
            {
                "t": TIME,
                "theta_rad": MOTOR,
                "acc": np.gradient(np.gradient(MOTOR - DEFLECTION)),
            }
        ),
        'log.csv --structure "k*s**2/(s**a + w)/(0.001*s + 1)*exp(-L*s)" --input theta_rad --output acc --period-ms 4',
    ),
    "a ring-down": (
        Shape({"t": TIME, "theta_rad": np.full(COUNT, 0.1), "strain_V": DEFLECTION}),
        'log.csv --structure "k/(s**a + w)*exp(-L*s)" --ring-down --output strain_V --period-ms 4',
    ),
    "a frequency response": (
        Shape({"f_Hz": 1 + TIME, "gain": 1 / (1 + TIME), "phase_deg": -TIME}),
        '--structure "k*s**a/(s**a + w)"',
    ),
    "a camera that sees the tip in space": (
        Shape({"t": TIME, "theta_rad": MOTOR, "camera_m": 0.32 * (MOTOR - DEFLECTION)}),
        '--column "deflection=theta_rad - K * camera_m [rad]"',
    ),
}


def guessed(shape: Shape, path: Path, column: tuple[str, ...] = ()) -> Match:
    """The interpretation of a shape."""
    return match(shape.write(path), column=column)


@pytest.mark.slow
@pytest.mark.parametrize("name", THROUGH)
def test_a_log_is_taken_for_what_it_is(name: str, tmp_path: Path) -> None:
    shape, column, taken = THROUGH[name]
    found = guessed(shape, tmp_path / "log.csv", column)
    assert found.columns is not None, found.questions
    columns = found.columns
    assert taken == (
        columns.time.column,
        columns.time.unit,
        columns.motor_angle.column,
        columns.motor_angle.unit,
        columns.output_kind,
        columns.output.column,
        columns.output.unit,
        columns.output.sign,
    )
    assert all(guess.evidence and guess.value for guess in found.guesses)


@pytest.mark.parametrize("name", REFUSED)
def test_a_log_that_is_not_clear_is_refused_with_what_mends_it(
    name: str, tmp_path: Path
) -> None:
    shape, words = REFUSED[name]
    with pytest.raises(LogError) as caught:
        fl.logs.start(shape.write(tmp_path / "log.csv"))
    assert words in str(caught.value)


# --- certainty: what data cannot decide is said to be assumed, or asked -------------------------------------


def certainty(found: Match, part: str) -> str:
    """The certainty of one part of the interpretation."""
    return next(guess.certainty for guess in found.guesses if guess.part == part)


def test_an_assumption_is_called_one_and_not_asked(tmp_path: Path) -> None:
    found = guessed(THROUGH["strain in volts"][0], tmp_path / "log.csv")
    assert certainty(found, "output measures") == "assumed"
    assert certainty(found, "sign of the output") == "certain"


def test_a_gauge_without_a_unit_is_scaled_to_a_gain_of_one(tmp_path: Path) -> None:
    found = guessed(THROUGH["strain in volts"][0], tmp_path / "log.csv")
    assert found.columns is not None
    # The gauge was generated with 0.4 V per radian of deflection; the scan is accurate
    # to a few percent.
    assert found.columns.output.scale == pytest.approx(1 / 0.4, rel=0.1)


def test_a_gauge_that_answers_late_does_not_settle_its_sign(tmp_path: Path) -> None:
    # 88 ms, a seventh of the vibration period
    late = np.concatenate((np.zeros(22), TORQUE[:-22]))
    shape = Shape({"t_s": TIME, "theta_rad": MOTOR, "torque_Nm": late})
    found = guessed(shape, tmp_path / "log.csv")
    assert certainty(found, "sign of the output") == "assumed"


def test_a_deflection_whose_unit_contradicts_the_angle_is_a_question(
    tmp_path: Path,
) -> None:
    # Both columns are labelled rad, but one of them is in degrees: the gain is 57.
    shape = Shape({"t_s": TIME, "theta_rad": MOTOR, "alpha_rad": DEG * DEFLECTION})
    found = guessed(shape, tmp_path / "log.csv")
    assert [(question.role, question.part) for question in found.questions] == [
        ("output", "unit")
    ]


def test_the_voltage_turns_its_sign_to_the_motor(tmp_path: Path) -> None:
    shape, stated, _ = THROUGH["extra columns: reference, speed, tip, current, voltage"]
    found = guessed(shape, tmp_path / "log.csv", stated)
    assert found.columns is not None and found.columns.voltage is not None
    assert (found.columns.voltage.column, found.columns.voltage.sign) == ("u_V", -1)


def test_a_clock_in_milliseconds_that_is_called_seconds_is_a_question(
    tmp_path: Path,
) -> None:
    shape = Shape({"time_s": 1e3 * TIME, "theta_rad": MOTOR, "torque_Nm": TORQUE})
    found = guessed(shape, tmp_path / "log.csv")
    assert [(question.role, question.part) for question in found.questions] == [
        ("time", "unit")
    ]


# --- from the file to the model -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a log in ms, degrees and mN·m with reversed sign, and the result of
    `start` for it.
    """
    folder = tmp_path_factory.mktemp("start")
    THROUGH["milliseconds, degrees, a turned sign in mN·m"][0].write(folder / "log.csv")
    assert main(["start", str(folder / "log.csv"), "--out", str(folder)]) == 0
    return folder


@pytest.mark.slow
def test_the_command_writes_a_rig_file_a_model_and_a_picture(turned: Path) -> None:
    fit = fl.Fit.load(turned / "model.json")
    assert fit.passed
    # With one period of vibration in ten, gain and damping are correlated; a wrong unit
    # is a factor of 57.
    assert fit.gain == pytest.approx(1.5, rel=0.03)
    assert (turned / "fit.svg").read_text("utf-8").startswith("<svg")
    # Without --force nothing is overwritten.
    assert main(["start", str(turned / "log.csv"), "--out", str(turned)]) == 2


@pytest.mark.slow
def test_other_commands_read_the_rig_file_as_it_is(turned: Path) -> None:
    rig, log = str(turned / "rig.toml"), str(turned / "log.csv")
    assert main(["diagnose", log, "--rig", rig]) == 0
    assert (
        main(["identify", log, "--rig", rig, "--out", str(turned / "again.json")]) == 0
    )
    again, first = (
        fl.Fit.load(turned / "again.json"),
        fl.Fit.load(turned / "model.json"),
    )
    assert again.model == first.model


@pytest.mark.slow
def test_design_names_every_blank_and_takes_the_file_once_they_are_filled(
    turned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    draft = load_rig_or_draft(turned / "rig.toml")
    # the stiffness comes from the log, ν is set to 0, nominal is the mean
    assert len(draft.blanks) == 5
    model = str(turned / "model.json")
    assert main(["design", "--rig", str(turned / "rig.toml"), "--model", model]) == 2
    shown = capsys.readouterr().err
    assert [blank for blank in draft.blanks if blank not in shown] == []
    text = (turned / "rig.toml").read_text("utf-8")
    values = (6.87e-5, 0.21, 0.65, 0.02, 0.04)
    for blank, value in zip(draft.blanks, values, strict=True):
        key = blank.partition(".")[2]
        text = text.replace(f"# {key} = ", f"{key} = {value} ")
    rig = fl.Rig.from_tables(tomllib.loads(text))
    assert (rig.link.length, rig.payloads.high, rig.period) == (0.65, 0.04, 0.004)
    assert rig.payloads.nominal == pytest.approx(0.03)
    assert rig.link.stiffness == pytest.approx(
        fl.Fit.load(turned / "model.json").model.stiffness, rel=1e-4
    )
    assert rig.log == draft.log


@pytest.mark.slow
def test_a_rig_file_with_another_fault_is_no_draft(
    turned: Path, tmp_path: Path
) -> None:
    text = (turned / "rig.toml").read_text("utf-8")
    for wrong in (
        text.replace('unit = "deg"', 'unit = "furlong"'),
        text.replace("[motor]", "[motor]\nmass = 1"),
    ):
        (tmp_path / "rig.toml").write_text(wrong, "utf-8")
        with pytest.raises(FieldError):
            load_rig_or_draft(tmp_path / "rig.toml")


@pytest.mark.slow
def test_names_from_a_log_cannot_break_the_rig_file(tmp_path: Path) -> None:
    shape = Shape({"t_s": TIME, 'theta\x1b"]#_rad': MOTOR, "torque_Nm": TORQUE})
    found = fl.logs.start(
        shape.write(tmp_path / "log.csv"), column=['motor_angle=theta\x1b"]#_rad']
    )
    assert (
        tomllib.loads(found.rig_file)["log"]["motor_angle"]["column"]
        == 'theta\x1b"]#_rad'
    )


@pytest.mark.slow
def test_questions_are_put_to_whoever_answers_them(tmp_path: Path) -> None:
    shape = Shape(
        {
            "t": TIME,
            "enc1": DEG * MOTOR,
            "enc2": DEG * (MOTOR - DEFLECTION),
            "bridge": -1e3 * TORQUE,
        }
    )
    seen: list[Question] = []

    def answer(question: Question) -> str:
        seen.append(question)
        return "deg"

    found = fl.logs.start(shape.write(tmp_path / "log.csv"), ask=answer, payload=0.03)
    # The bridge is recognised by its name, and its unit is assumed; the encoder is the
    # one behind which the bridge vibrates.
    assert [(each.role, each.part) for each in seen] == [("motor_angle", "unit")]
    assert (found.columns.motor_angle.column, found.columns.motor_angle.unit) == (
        "enc1",
        "deg",
    )
    assert (found.columns.output.column, found.columns.output.sign) == ("bridge", -1)
    assert found.fit.passed


UNNAMED = {
    "x1": REFERENCE,
    "x2": DEG * MOTOR,
    "x3": DEG * MOTOR,
    "x4": -1e3 * TORQUE,
    "x5": TIME * 0 + 3,
}


@pytest.mark.slow
def test_three_answers_are_enough_where_nothing_is_named(tmp_path: Path) -> None:
    answers = {"time": "4 ms", "motor_angle": "x2 [deg]", "output": "x4 [mNm]"}
    seen: list[Question] = []

    def answer(question: Question) -> str:
        seen.append(question)
        return answers[question.role]

    found = fl.logs.start(Shape(UNNAMED).write(tmp_path / "log.csv"), ask=answer)
    assert [question.role for question in seen] == ["time", "motor_angle", "output"]
    # One of two identical columns, no constant one, none taken twice; no steps for the
    # angle of a motor, and the signal that vibrates behind it first.
    assert [question.choices for question in seen[1:]] == [("x2", "x4"), ("x4", "x1")]
    assert found.fit.passed
    assert found.fit.gain == pytest.approx(1.5, rel=0.03)


@pytest.mark.slow
def test_an_answer_may_be_a_sum_of_columns(tmp_path: Path) -> None:
    shape = Shape(
        {"a": TIME, "b": MOTOR, "c": DEFLECTION - MOTOR}, header=False, digits=".9g"
    )
    answers = {"motor_angle": "#2 [rad]", "output": "#2 + #3 [rad]"}
    found = fl.logs.start(
        shape.write(tmp_path / "log.csv"), ask=lambda question: answers[question.role]
    )
    assert found.columns.output.column == "#2 + #3"
    assert found.fit.gain == pytest.approx(1.0, rel=0.03)


@pytest.mark.slow
def test_a_tip_that_moves_otherwise_does_not_pass(tmp_path: Path) -> None:
    shape = Shape({"t": TIME, "theta_rad": MOTOR, "tip_rad": np.roll(MOTOR, 400)})
    assert not fl.logs.start(shape.write(tmp_path / "log.csv")).passed


@pytest.mark.slow
def test_a_speed_that_is_stated_to_be_the_deflection_does_not_pass(
    tmp_path: Path,
) -> None:
    speed = np.gradient(MOTOR, 0.004)
    shape = Shape({"a": TIME, "b": MOTOR, "c": speed}, header=False)
    stated = ["motor_angle=#2 [rad]", "deflection=#3 [rad]"]
    found = fl.logs.start(shape.write(tmp_path / "log.csv"), column=stated)
    assert not found.passed


@pytest.mark.slow
def test_the_terminal_asks_again_until_it_understands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Shape({"t": TIME, "a": DEG * MOTOR, "b": TORQUE}).write(tmp_path / "log.csv")

    def start_with(lines: str) -> tuple[int, str]:
        terminal = io.StringIO(lines)
        monkeypatch.setattr(terminal, "isatty", lambda: True)
        monkeypatch.setattr("sys.stdin", terminal)
        monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
        code = main(["start", str(path), "--out", str(tmp_path), "--force"])
        return code, capsys.readouterr().err

    code, shown = start_with("c\n\na\na [deg]\nb [Nm]\n")
    assert code == 0
    assert "none of these columns" in shown and "without a unit" in shown
    assert "1  a" not in shown  # examples are not choices
    code, shown = start_with("a [deg]\n")
    assert code == 2 and "--column" in shown


def test_a_period_stands_for_stamps(tmp_path: Path) -> None:
    path = Shape({"theta_deg": DEG * MOTOR, "torque_Nm": TORQUE}).write(
        tmp_path / "log.csv"
    )
    found = fl.logs.start(path, period=0.004)
    assert found.columns.time.column == "#row"
    assert found.experiment.period == 0.004
    again = fl.read_log(path, columns=found.columns)
    assert np.array_equal(again.output, found.experiment.output)
    with pytest.raises(FieldError, match="period"):
        fl.logs.start(path, period=0.004, column=["time=theta_deg [s]"])


# --- recorded logs ------------------------------------------------------------------------------------------


def test_a_recorded_log_with_a_turned_gauge_is_found_out() -> None:
    place = shared_data("quanser_rfl_merced", "merced_rfl.csv")
    found = match(place)
    assert found.columns is not None and found.columns.voltage is not None
    assert (found.columns.motor_angle.column, found.columns.motor_angle.unit) == (
        "theta_deg",
        "deg",
    )
    assert (found.columns.output.column, found.columns.output.sign) == ("alpha_deg", -1)
    assert found.columns.voltage.column == "motor_V"


@pytest.mark.slow
def test_recorded_names_serve_though_they_do_not_fit_the_columns() -> None:
    place = shared_data("rig_a_late_gauge", "unit7.csv")
    (question,) = match(place).questions
    assert (question.role, question.part) == ("time", "unit")  # "s", in steps of 1
    found = match(place, column=["time=[ms]"])
    assert found.columns is not None
    assert (found.columns.motor_angle.column, found.columns.motor_angle.unit) == (
        "#2",
        "rad",
    )
    assert (found.columns.output.column, found.columns.output.sign) == ("#3", -1)


@pytest.mark.slow
def test_recorded_structures_offer_no_reference_and_no_column_twice() -> None:
    place = shared_data("rig_b_two_stage", "lqg30.mat")
    columns, (angle, output) = read_columns(place), match(place).questions
    names = set(angle.choices) | set(output.choices)
    assert {"theta11", "theta12"} <= names
    assert not any(word in name for name in names for word in ("ref", "sim", "dot"))
    values = [columns[name].tobytes() for name in names]
    assert len(set(values)) == len(values)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["2_lab_a05_f04", "2_lab_a10_f04", "2_lab_a15_f10"])
def test_a_recorded_log_in_volts_takes_one_decision(name: str) -> None:
    place = shared_data("ist_flexbar", f"{name}.csv")
    assert [q.role for q in match(place).questions] == ["motor_angle"]
    found = match(place, column=["motor_angle=* 36.79 [deg]"])
    assert found.columns is not None and found.columns.voltage is not None
    assert found.columns.motor_angle.column == "pot_V"
    assert (found.columns.output_kind, found.columns.output.column) == (
        "deflection",
        "strain_V",
    )
    assert found.columns.voltage.column == "u_V"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "answers", "remedy"),
    [
        (
            "daisy_robot_arm/robot-arm.csv",
            {"time": "4 ms", "motor_angle": "none"},
            "--input u --output y",
        ),
        (
            "ist_flexbar/1_test_deflection_model_2_final.mat",
            {"motor_angle": "none"},
            "--structure",
        ),
        (
            "quanser_rfl_merced/data_theta.mat",
            {"motor_angle": "data_theta(:,3) [deg]", "output": "none"},
            "both signals together",
        ),
    ],
)
def test_a_recorded_log_without_a_signal_ends_in_what_goes_on(
    name: str, answers: dict[str, str], remedy: str
) -> None:
    asked = []

    def answer(question: Question) -> str:
        asked.append(question.role)
        return answers[question.role]

    with pytest.raises(LogError, match=re.escape(remedy)):
        fl.logs.start(shared_data(*name.split("/")), ask=answer)
    assert len(asked) <= 3


@pytest.mark.parametrize(
    ("motor", "link"), [("q_m [deg]", "q_l [deg]"), ("th_m", "th_l")]
)
def test_an_index_is_no_quantity(motor: str, link: str, tmp_path: Path) -> None:
    # Not a moment: its index says that the first is the motor's angle.
    columns = {"t": TIME, motor: DEG * MOTOR, link: DEG * (MOTOR - DEFLECTION)}
    stated = ["motor_angle=[deg]"]
    path = Shape(columns).write(tmp_path / "log.csv")
    (question,) = match(path, column=stated).questions
    option = re.fullmatch('--column "(.*)"', question.option)[1]
    found = match(path, column=[*stated, option]).columns
    assert found.motor_angle.column == motor
    assert found.output.column == f"{motor} - {link}"


def test_a_column_is_no_answer_to_a_question_of_a_unit(tmp_path: Path) -> None:
    path = Shape({"t": TIME, "theta_rad": MOTOR, "gamma": TORQUE})
    (question,) = match(path.write(tmp_path / "log.csv")).questions
    assert question.part == "unit"
    with pytest.raises(FieldError, match="theta_rad"):
        question.statement("theta_rad [deg]")


def test_no_column_is_suggested_for_two_roles(tmp_path: Path) -> None:
    path = Shape({"t": TIME, "a": MOTOR, "b": TORQUE}).write(tmp_path / "log.csv")
    angle, output = match(path).questions
    assert angle.choices[0] != output.choices[0]
