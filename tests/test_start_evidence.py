"""What `start` says of each guess and question, and where a guess becomes likely,
certain, or a question.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.log_columns import ColumnStatement
from fraclink._reading.text import LogTable
from fraclink.errors import FieldError, LogError
from fraclink.logs import _calibration as calibration
from fraclink.logs._channels import Mode
from fraclink.logs._tips import tip_difference
from fraclink.logs._weighing import (
    Guess,
    Question,
    Weighing,
    answered,
    guess_time,
    statements,
)
from test_start import (
    COUNT,
    DEFLECTION,
    DEG,
    MOTOR,
    NOISE,
    REFUSED,
    THROUGH,
    TIME,
    TORQUE,
    Array,
    Shape,
    guessed,
)

MODE = Mode(
    frequency=10.0, damping_ratio=0.02, gain=1.5, delay=0.0, share=0.9, residual=0.01
)


def weigh(columns: dict[str, Array], *column: str, assume: bool = False) -> Weighing:
    table = LogTable(tuple(columns), tuple(columns.values()), "text")
    return Weighing(table, statements(column, None), assume, False)


def said(weighing: Weighing, part: str) -> Guess | None:
    return next((guess for guess in weighing.guesses if guess.part == part), None)


# --- whole logs ---------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        (
            "names that state all",
            {
                "time": ("time_s", "certain", "it rises by 0.004 a sample, and is named so"),
                "unit of time": ("s", "stated", "by its name: a sample every 0.004 s"),
                "motor angle": ("motor_angle_rad", "stated", "its name says 'angle'"),
                "output": ("torque_Nm", "stated", "its name says 'Nm'"),
                "unit of the motor angle": ("rad", "stated", "by its name; it moves by 0.4762 rad"),
                "output measures": ("torque [Nm]", "stated", "by its name"),
                "sign of the output": ("+", "certain", "it goes with the motor's acceleration"),
            },
        ),
        (
            "no unit, microseconds and mN·m",
            {
                "time": ("t", "certain", "it rises by 4000 a sample, and is named so"),
                "unit of time": ("us", "likely", "a sample every 4000: in s no arm is sampled so"),
                "motor angle": ("enc", "likely", "its name says 'enc'"),
                "unit of the motor angle": (
                    "rad", "likely", "it moves by 0.4762: as degrees, under one degree",
                ),
                "output measures": ("torque [mNm]", "likely", "a stiffness of 1.51 N·m/rad, as links have"),
            },
        ),
        (
            "no unit, milliseconds and degrees",
            {
                "unit of the motor angle": (
                    "deg", "likely", "it moves by 27.29: as radians, more than a full turn",
                ),
                "sign of the output": ("+", "certain", "it goes with the motor's acceleration"),
            },
        ),
        (
            "a bridge that the call calibrates",
            {
                "output": ("bridge", "stated", "as stated"),
                "output measures": ("torque [mNm]", "stated", "as stated"),
                "sign of the output": ("-", "certain", "it goes against the motor's acceleration"),
            },
        ),
        (
            "encoder counts with the counts of a turn",
            {
                "motor angle": ("enc", "stated", "as stated"),
                "unit of the motor angle": ("rev", "stated", "as stated; it moves by 0.07568 rev"),
            },
        ),
        ("decimal commas", {"form of the file": ("decimal commas", "certain", "the whole file agrees")}),
        (
            "a linear axis",
            {
                "unit of the motor angle": (
                    "1 rad for 1 m of cart_mm",
                    "assumed",
                    "a linear axis: frequency, order and delay do not depend on the lever",
                ),
            },
        ),
        (
            "a period instead of stamps",
            {"time": ("one sample every 4 ms", "stated", "the log has no stamps")},
        ),
        (
            "stamps of each channel, as in TDMS",
            {
                "time": ("Arm/Theta.time", "stated", "as stated"),
                "unit of time": ("s", "stated", "a sample every 0.004 s"),
            },
        ),
        (
            "extra columns: reference, speed, tip, current, voltage",
            {
                "motor angle": (
                    "theta_m",
                    "likely",
                    "its name says 'theta'; not used: theta_ref, omega, tip_angle, current_A",
                ),
                "voltage": ("-u_V [V]", "stated", "correlation -1 with the motor's speed"),
            },
        ),
        (
            "two gauges together",
            {"output": ("strain1 + strain2", "likely", "both move together (correlation 1)")},
        ),
    ],
)  # fmt: skip
def test_each_guess_says_why_and_how_sure(
    name: str, wanted: dict[str, tuple[str, str, str]], tmp_path: Path
) -> None:
    shape, column, _ = THROUGH[name]
    found = {
        g.part: (g.value, g.certainty, g.evidence)
        for g in guessed(shape, tmp_path / "log.csv", column).guesses
    }
    assert {part: found[part] for part in wanted} == wanted


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scale"),
    [
        ("strain in volts", 2.5),
        ("a bridge without a unit", 1 / 200),
        ("a laser in millimetres", 1 / 320),
    ],
)
def test_what_is_not_calibrated_is_scaled_to_a_gain_of_one(
    name: str, scale: float, tmp_path: Path
) -> None:
    shape, column, _ = THROUGH[name]
    found = guessed(shape, tmp_path / "log.csv", column)
    assert found.columns is not None and found.columns.output.scale == pytest.approx(
        scale, rel=0.02
    )
    measures = next(guess for guess in found.guesses if guess.part == "output measures")
    assert measures.value == f"deflection, {found.columns.output.scale:g} rad each"
    assert measures.certainty == "assumed"
    assert measures.evidence.endswith("frequency, order and delay do not depend on it")
    length = name == "a laser in millimetres"
    assert measures.evidence.startswith(
        "a link of 32" if length else f"{found.columns.output.column} is not"
    )


@pytest.mark.slow
def test_questions_are_asked_in_words_with_choices_and_an_option(
    tmp_path: Path,
) -> None:
    def asked(shape: Shape) -> Question:
        return guessed(shape, tmp_path / "log.csv", assume=False).questions[0]

    assert asked(THROUGH["strain in volts"][0]) == Question(
        "output",
        "unit",
        "What does strain_V measure, and in which unit? (raw: not calibrated, scaled by the fit)",
        ("Nm", "mNm", "deg", "rad", "raw"),
        "raw",
        '--column "torque=strain_V [Nm]", --column "deflection=strain_V [deg]" '
        'or "deflection=strain_V [raw]"',
    )
    laser = asked(THROUGH["a laser in millimetres"][0])
    assert (
        laser.text
        == "laser_mm is a length: how long is the link? (raw: scaled by the fit)"
    )
    # 1 mm at a link of 320 mm is 1/320 rad: number and unit of the option belong
    # together.
    assert (
        laser.option
        == '--column "deflection=laser_mm * 1/320 [rad]" for a link of 320 mm'
    )
    axis = asked(THROUGH["a linear axis"][0])
    assert (axis.choices, axis.default) == (("0.001 rad",), "0.001 rad")
    assert (
        axis.option
        == '--column "motor_angle=cart_mm * 0.01 [rad]" for a lever of 0.1 m'
    )
    counts = asked(REFUSED["encoder counts"][0])
    assert (counts.role, counts.part, counts.default) == ("motor_angle", "unit", "")
    assert counts.text == "enc counts: which angle is one count?"
    assert counts.choices == ("1/4096 rev", "0.09 deg")
    volts = asked(REFUSED["a potentiometer in volts"][0])
    assert volts.text == "pot_V is in volts: which angle is one volt?"
    assert volts.choices == ("36.8 deg", "0.64 rad")
    counter = asked(REFUSED["a counter as the only clock"][0])
    assert counter.text == "n counts samples: how long is one?"
    stamps = asked(REFUSED["no stamps"][0])
    assert (stamps.role, stamps.part, stamps.choices) == ("time", "period", ("4 ms",))
    two = asked(REFUSED["two encoders"][0])
    assert (two.text, two.choices) == (
        "Which column is the motor angle?",
        ("enc1", "enc2"),
    )


@pytest.mark.slow
def test_a_tip_in_metres_tells_the_length_of_the_link(tmp_path: Path) -> None:
    shape = Shape({"t": TIME, "theta_rad": MOTOR, "tip_m": 0.32 * (MOTOR - DEFLECTION)})
    found = guessed(shape, tmp_path / "log.csv")
    output = next(guess for guess in found.guesses if guess.part == "output")
    assert output.value.startswith("theta_rad - 3.1") and output.value.endswith(
        " * tip_m"
    )
    words = output.evidence.split("; ")[1].split()
    assert words[:4] == ["the", "link", "would", "be"] and words[5:] == ["m", "long"]
    assert float(words[4]) == pytest.approx(0.32, rel=0.01)
    turned = Shape(
        {"t": TIME, "theta_rad": MOTOR, "tip_m": -0.32 * (MOTOR - DEFLECTION)}
    )
    output = next(
        g for g in guessed(turned, tmp_path / "log.csv").guesses if g.part == "output"
    )
    assert output.value.startswith("theta_rad + 3.1")


# --- bounds of the output -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("share", "vibration", "sign"),
    [
        (0.81, "certain", "certain"),
        (0.8, "certain", "likely"),
        (0.61, "certain", "likely"),
        (0.6, "likely", "likely"),
        (0.3, "likely", "likely"),
        (0.29, None, "assumed"),
    ],
)
def test_how_sure_vibration_and_sign_are(
    share: float, vibration: str | None, sign: str
) -> None:
    weighing = weigh({"torque_Nm": TORQUE}, assume=True)
    found = calibration.guess_output(
        weighing, 0, dataclasses.replace(MODE, share=share)
    )
    assert found is not None and found[0] == "torque"
    told = said(weighing, "vibration")
    assert (told and told.certainty) == vibration
    if told:
        assert (told.value, told.evidence) == (
            "10 rad/s",
            f"explains {100 * share:.3g} % of the output",
        )
    turned = said(weighing, "sign of the output")
    assert turned is not None and (turned.value, turned.certainty) == ("+", sign)


def test_a_sign_that_the_log_does_not_show_is_asked() -> None:
    for mode in (
        None,
        dataclasses.replace(MODE, gain=-1.5, delay=0.13 * 2 * math.pi / 10),
    ):
        weighing = weigh({"torque_Nm": TORQUE})
        found = calibration.guess_output(weighing, 0, mode)
        (question,) = weighing.questions
        assert (question.part, question.choices) == ("sign", ("+", "-"))
        assert question.default == ("+" if mode is None else "-")
        assert (
            question.option == '--column "torque=-torque_Nm [unit]", or + for as it is'
        )
        assert found is not None and found[1].sign == (1 if mode is None else -1)
    early = dataclasses.replace(MODE, gain=-1.5, delay=0.11 * 2 * math.pi / 10)
    weighing = weigh({"torque_Nm": TORQUE})
    found = calibration.guess_output(weighing, 0, early)
    assert found is not None and found[1].sign == -1 and not weighing.questions
    assert (
        calibration.guess_output(weigh({"g": TORQUE}, "torque=+g [Nm]"), 0, early)[
            1
        ].sign
        == 1
    )


@pytest.mark.parametrize(
    ("gain", "sure"),
    [(0.0199, "likely"), (0.0201, "stated"), (19.9, "stated"), (20.1, "likely")],
)
def test_a_stiffness_that_few_links_have_is_said(gain: float, sure: str) -> None:
    for factor, unit in ((1.0, "Nm"), (1e3, "mNm")):
        weighing = weigh({f"torque_{unit}": TORQUE})
        calibration.guess_output(
            weighing, 0, dataclasses.replace(MODE, gain=gain * factor)
        )
        told = said(weighing, "output measures")
        assert told is not None and (told.value, told.certainty) == (
            f"torque [{unit}]",
            sure,
        )
        odd = f"; {gain:.3g} N·m/rad, which few links have" if sure == "likely" else ""
        assert told.evidence == f"by its name{odd}"


@pytest.mark.parametrize(
    ("name", "gain", "taken"),
    [
        ("torque", 0.021, ("torque", "Nm")),
        ("torque", 19.9, ("torque", "Nm")),
        ("torque", 20.1, ("torque", "mNm")),
        ("torque", 0.019, None),
        ("torque", 20_100.0, None),
        ("alpha", 0.34, ("deflection", "rad")),
        ("alpha", 2.9, ("deflection", "rad")),
        ("alpha", 57.3, ("deflection", "deg")),
        ("alpha", 19.2, ("deflection", "deg")),
        ("alpha", 0.33, None),
        ("alpha", 172.0, None),
        ("strain", 1.0, None),
        ("x", 1.0, None),
    ],
)
def test_a_gain_makes_a_unit_likely(
    name: str, gain: float, taken: tuple[str, str] | None
) -> None:
    weighing = weigh({name: TORQUE})
    found = calibration.guess_output(weighing, 0, dataclasses.replace(MODE, gain=-gain))
    if taken is None:
        assert found is None and weighing.questions[0].part == "unit"
    else:
        assert found is not None and (found[0], found[1].unit) == taken
        told = said(weighing, "output measures")
        assert told is not None and told.certainty == "likely"


@pytest.mark.parametrize(
    ("gain", "taken"),
    [(1.01 / 20, True), (0.99 / 20, False), (19.9, True), (20.1, False)],
)
def test_a_deflection_whose_gain_is_far_from_one_is_asked(
    gain: float, taken: bool
) -> None:
    for unit, size in (("rad", 1.0), ("deg", math.pi / 180)):
        weighing = weigh({f"alpha_{unit}": DEFLECTION})
        found = calibration.guess_output(
            weighing, 0, dataclasses.replace(MODE, gain=gain / size)
        )
        assert (found is not None) == taken
        if not taken:
            (question,) = weighing.questions
            start = f"alpha_{unit} is in {unit} by its name, but {gain:.3g} times what the motor turns"
            assert question.text == f"{start}: in which unit?"
        stated = weigh(
            {"alpha": DEFLECTION}, f"deflection=alpha [{unit}]"
        )  # a person's word stands
        assert (
            calibration.guess_output(
                stated, 0, dataclasses.replace(MODE, gain=gain / size)
            )
            is not None
        )


# --- bounds of angle, voltage and time ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("reach", "unit"),
    [
        (0.9, "rad"),
        (0.91, None),
        (6.28, None),
        (6.29, "deg"),
        (400.0, "deg"),
        (400.1, None),
    ],
)
def test_how_far_an_angle_turns_makes_its_unit_likely(
    reach: float, unit: str | None
) -> None:
    raw = 3.0 - reach * np.linspace(0, 1, 300)
    weighing = weigh({"theta": raw})
    channel = calibration.guess_angle(weighing, 0, raw)
    assert (channel and channel.unit) == unit
    if unit is None:
        assert (
            weighing.questions[0].text == f"theta moves by {reach:.4g}: in which unit?"
        )


@pytest.mark.parametrize(("reach", "counts"), [(49.0, False), (50.0, True)])
def test_whole_numbers_are_counts_from_fifty_on(reach: float, counts: bool) -> None:
    raw = np.round(reach * np.linspace(0, 1, 300))
    weighing = weigh({"theta": raw})
    assert (calibration.guess_angle(weighing, 0, raw) is None) == counts
    assert (
        not counts
        or weighing.questions[0].text == "theta counts: which angle is one count?"
    )


@pytest.mark.parametrize(
    ("stiffness", "bend", "unit"),
    [(1.5, 0.1, "rad"), (0.3, 0.1, None), (30.0, 0.1, None)],
)
def test_a_torque_tells_the_unit_of_the_angle(
    stiffness: float, bend: float, unit: str | None
) -> None:
    """1.5 N·m/rad is a link, 86 would be none; of 0.3 both are links, of 30 neither is."""
    raw = 0.5 * np.linspace(0, 1, 300)
    weighing = weigh({"theta": raw})
    channel = calibration.guess_angle(weighing, 0, raw, stiffness, bend)
    assert (channel and channel.unit) == unit
    if unit is None:
        text = f"the link would have {stiffness:.3g} N·m/rad if these are radians, {stiffness * DEG:.3g} if they"
        assert text in weighing.questions[0].text


def test_a_voltage_drives_the_motor_s_speed() -> None:
    speed = np.gradient(MOTOR)
    drive = 3.0 * speed / np.abs(speed).max()
    noise = np.random.default_rng(3).normal(0, 1, COUNT)
    for raw, sign in ((drive, 1), (-drive, -1), (noise, 1)):
        weighing = weigh({"u": raw})
        channel = calibration.guess_voltage(weighing, MOTOR)
        assert channel is not None and (channel.unit, channel.sign) == ("V", sign)
        relation = np.corrcoef(raw, speed)[0, 1]
        told = said(weighing, "voltage")
        assert (
            told is not None
            and told.evidence == f"correlation {relation:.2g} with the motor's speed"
        )
        assert told.certainty == "likely"
    assert (
        calibration.guess_voltage(weigh({"u": 20 * drive}), MOTOR) is not None
    )  # 60 V
    assert calibration.guess_voltage(weigh({"u": 20.1 * drive}), MOTOR) is None
    assert calibration.guess_voltage(weigh({"u_mV": 2000 * drive}), MOTOR).unit == "mV"
    assert calibration.guess_voltage(weigh({"u": drive[1:]}), MOTOR) is None
    assert calibration.guess_voltage(weigh({"u": drive, "volt": drive}), MOTOR) is None
    broken = drive.copy()
    broken[3] = np.nan
    assert calibration.guess_voltage(weigh({"u": broken}), MOTOR) is None


@pytest.mark.slow
def test_a_column_that_is_the_angle_is_no_voltage_as_well(tmp_path: Path) -> None:
    log = fl.read_log(fl.bundled_log("prbs_30g"))
    table = np.column_stack([log.time, log.motor_angle, log.output])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,u,y", comments="")
    found = fl.logs.start(
        tmp_path / "log.csv", column=["motor_angle=u [rad]", "torque=y [Nm]"]
    )
    assert "voltage" not in {guess.part for guess in found.guesses}
    assert found.experiment.voltage is None and "voltage" not in found.rig_file


@pytest.mark.parametrize(
    ("step", "unit"),
    [
        (0.1, "s"),
        (0.11, None),
        (0.19, None),
        (0.21, "ms"),
        (2.1e-4, "s"),
        (1.9e-4, None),
        (100.0, "ms"),
        (199.0, None),
        (210.0, "us"),
        (1e5, "us"),
        (1.01e5, None),
        (2e5, "ns"),
    ],
)
def test_a_clock_s_step_tells_its_unit(step: float, unit: str | None) -> None:
    """Arms are sampled every 0.2 ms to 0.1 s: at most one unit puts a step there."""
    weighing = weigh({"t": step * np.arange(300.0), "theta": MOTOR[:300]})
    channel = guess_time(weighing)
    assert (channel and channel.unit) == unit
    if unit is None:
        assert weighing.questions[0].text == f"t rises by {step:.6g}: what is its unit?"


def test_a_step_of_a_second_contradicts_the_name() -> None:
    assert guess_time(weigh({"t_s": 0.99 * np.arange(300.0)})) is not None
    assert guess_time(weigh({"t_s": 1.0 * np.arange(300.0)})) is None


# --- a tip --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [1.0, DEG, 1 / DEG])
def test_a_tip_s_angle_becomes_a_deflection(factor: float) -> None:
    tip = factor * (MOTOR - DEFLECTION)
    unit = {1.0: "rad", DEG: "deg"}.get(factor, "")
    columns = {
        "t_s": TIME,
        "theta_rad" if unit else "theta_deg": MOTOR,
        f"tip_{unit or 'rad'}": tip,
    }
    weighing = weigh(columns)
    place = tip_difference(weighing, 1, 2, guess_time(weighing))
    assert place == 3
    np.testing.assert_allclose(weighing.cells(3), DEFLECTION, atol=1e-5)
    assert weighing.unit(3) == ("rad" if unit else "deg")


def test_what_is_measured_from_the_hub_stays_and_noise_is_neither() -> None:
    weighing = weigh({"t_s": TIME, "theta_rad": MOTOR, "tip_rad": DEFLECTION})
    assert tip_difference(weighing, 1, 2, guess_time(weighing)) == 2
    noise = weigh({"t_s": TIME, "theta_rad": MOTOR, "tip_rad": NOISE})
    assert tip_difference(noise, 1, 2, guess_time(noise)) is None
    assert tip_difference(noise, 1, 2, None) is None


def test_a_tip_s_angle_as_the_stated_output_is_refused() -> None:
    weighing = weigh({"theta": MOTOR, "alpha": MOTOR - DEFLECTION})
    with pytest.raises(LogError, match="the angle of the tip"):
        calibration.check_no_tip_angle(weighing, 1, MOTOR, MOTOR - DEFLECTION, 0.004)
    calibration.check_no_tip_angle(weighing, 1, MOTOR, DEFLECTION, 0.004)
    torque = weigh({"theta": MOTOR, "g_Nm": MOTOR - DEFLECTION})  # a torque by its unit
    calibration.check_no_tip_angle(torque, 1, MOTOR, MOTOR - DEFLECTION, 0.004)


# --- statements ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_statements_of_the_call_share_one_output() -> None:
    stated = statements(["torque=g [Nm]", "motor_angle=a"], 0.004)
    assert sorted(stated) == ["motor_angle", "output", "time"]
    assert (stated["time"].column, stated["time"].unit, stated["time"].scale) == (
        "#row",
        "s",
        0.004,
    )
    for column in (["torque=g", "deflection=h"], ["time=t", "time=u"]):
        with pytest.raises(FieldError, match="column: stated twice"):
            statements(column, None)


@pytest.mark.parametrize(
    ("text", "sign"), [("-1", -1), (" - ", -1), ("1", 1), ("+1", 1)]
)
def test_the_answer_to_a_sign_is_a_sign(text: str, sign: int) -> None:
    asked = Question("torque", "sign", "Which way?", ("1", "-1"), "", "")
    assert answered(ColumnStatement("torque"), asked, text).sign == sign
