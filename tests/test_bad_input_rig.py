"""Bad rig files: every fault has a test named after it, with its number in the
catalogue of bad inputs.
"""

from __future__ import annotations

import json
import re
import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink import MotorLoop, Rig
from fraclink.errors import FieldError, FileFormatError
from fraclink.extend import Encoder, Link, Motor, Payloads
from junk import CHARACTERS
from processor_limit import processor_limit

PAPER = (
    Path(__file__).parents[1] / "src" / "fraclink" / "data" / "rigs" / "paper-2023.toml"
)


def paper() -> dict[str, Any]:
    return tomllib.loads(PAPER.read_text(encoding="utf-8"))


def load(text: str, folder: Path) -> Rig:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return Rig.load(path)


def changed(line: str, folder: Path) -> str:
    """The paper's file with one `key = value` replaced."""
    key = line.partition("=")[0].strip()
    text, count = re.subn(
        rf"^{re.escape(key)} = .*$",
        line,
        PAPER.read_text(encoding="utf-8"),
        count=1,
        flags=re.M,
    )
    assert count == 1, f"{key} is not in the paper's file"
    return text


@pytest.mark.parametrize(
    ("number", "line", "field", "problem"),
    [
        ("b25", "nominal_kg = 0", "payloads.nominal_kg", "out of range"),
        ("b26", "low_kg = -0.02", "payloads.low_kg", "out of range"),
        ("b28", "low_kg = nan", "payloads.low_kg", "not finite"),
        ("b28", "inertia_kg_m2 = inf", "motor.inertia_kg_m2", "not finite"),
        ("b28", "voltage_limit_V = nan", "motor.voltage_limit_V", "not finite"),
        ("b29", "length_m = 0", "link.length_m", "out of range"),
        (
            "b29",
            "flexural_rigidity_Nm2 = -0.26",
            "link.flexural_rigidity_Nm2",
            "out of range",
        ),
        (
            "b29",
            "stiffness_Nm_per_rad = 0.0",
            "link.stiffness_Nm_per_rad",
            "out of range",
        ),
        ("b31", "order = 0.9", "model.order", "out of range"),
        ("b31", "order = 2.1", "model.order", "out of range"),
        ("b41", "period_ms = 0", "period_ms", "out of range"),
        ("b41", "period_ms = -4.0", "period_ms", "out of range"),
        ("b43", "voltage_limit_V = 0", "motor.voltage_limit_V", "out of range"),
        ("b44", f"inertia_kg_m2 = 1{'0' * 400}", "motor.inertia_kg_m2", "not finite"),
        (
            "b44",
            "torque_constant_Nm_per_V = 1e200",
            "motor.torque_constant_Nm_per_V",
            "out of range",
        ),
        ("b45", 'length_m = "0.65"', "link.length_m", "not a number"),
        ("b45", "length_m = true", "link.length_m", "not a number"),
        ("b45", "length_m = [0.65]", "link.length_m", "not a number"),
        ("b45", "name = 7", "name", "not a string"),
        (
            "b48",
            "delay_samples = 1.0",
            "motor_loop.delay_samples",
            "not a whole number",
        ),
        (
            "b48",
            "counts_per_revolution = 1e5",
            "encoder.counts_per_revolution",
            "not a whole number",
        ),
    ],
)
def test_a_value_out_of_range_is_named(
    number: str, line: str, field: str, problem: str, tmp_path: Path
) -> None:
    with pytest.raises(FieldError) as caught:
        load(changed(line, tmp_path), tmp_path)
    error = caught.value
    assert error.field == field
    assert problem in error.problem
    assert error.allowed and error.remedy
    assert str(error).count("\n") == 0


def test_b27_payloads_in_the_wrong_order(tmp_path: Path) -> None:
    with pytest.raises(FieldError) as caught:
        load(changed("low_kg = 0.05", tmp_path), tmp_path)
    assert caught.value.field == "payloads.low"
    assert "0.04" in caught.value.problem and "exchange" in caught.value.remedy
    with pytest.raises(FieldError, match="outside the payload range"):
        Payloads(low=0.02, high=0.04, nominal=0.05)


def test_b42_delay_out_of_range() -> None:
    with pytest.raises(FieldError, match="range") as caught:
        MotorLoop(delay_samples=101)
    assert caught.value.field == "delay_samples"


@pytest.mark.parametrize(
    ("line", "place", "meant"),
    [
        ("inertia = 6.87e-5", "motor.inertia", "inertia_kg_m2"),
        (
            "viscous_friction_Nm = 1e-3",
            "motor.viscous_friction_Nm",
            "viscous_friction_Nm_s",
        ),
    ],
)
def test_b46_an_unknown_key_is_answered_by_the_nearest(
    line: str, place: str, meant: str, tmp_path: Path
) -> None:
    text = PAPER.read_text(encoding="utf-8").replace("[motor]", f"[motor]\n{line}")
    with pytest.raises(FieldError) as caught:
        load(text, tmp_path)
    assert caught.value.field == place
    assert caught.value.problem == "an unknown key"
    assert caught.value.remedy == f"did you mean '{meant}'?"


@pytest.mark.parametrize(
    ("table", "line", "remedy"),
    [
        ("link", "length_mm = 650", "give it in m: length_m = 0.65"),
        ("payloads", "low_g = 20", "give it in kg: low_kg = 0.02"),
        ("motor_loop", "pole_Hz = 12.5", "rad/s: pole_rad_per_s = 78.53981634"),
        ("motor", "inertia_g_cm2 = 687", "kg·m²: inertia_kg_m2 = 6.87e-05"),
        ("motor", "inertia_kg_cm2 = 0.687", "kg·m²: inertia_kg_m2 = 6.87e-05"),
    ],
)
def test_a_value_in_another_unit_is_converted(
    table: str, line: str, remedy: str, tmp_path: Path
) -> None:
    text = PAPER.read_text(encoding="utf-8").replace(f"[{table}]", f"[{table}]\n{line}")
    with pytest.raises(FieldError) as caught:
        load(text, tmp_path)
    assert caught.value.remedy.endswith(remedy)


def test_b46_an_unknown_table_is_answered_by_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="Did you mean 'motor_loop'"):
        load(
            PAPER.read_text(encoding="utf-8").replace("[motor_loop]", "[motor_lop]"),
            tmp_path,
        )


def test_b47_a_key_given_twice(tmp_path: Path) -> None:
    text = PAPER.read_text(encoding="utf-8").replace("[link]", "[link]\nlength_m = 0.5")
    with pytest.raises(FileFormatError, match="not valid TOML"):
        load(text, tmp_path)


def test_every_fault_is_listed_at_once(tmp_path: Path) -> None:
    text = PAPER.read_text(encoding="utf-8")
    text = text.replace("inertia_kg_m2 = 6.87e-5", "inertia = 6.87e-5").replace(
        "length_m = 0.65", "length_m = -1"
    )
    text = text.replace("low_kg = 0.020", "low_kg = 0.9").replace("period_ms = 4.0", "")
    with pytest.raises(FieldError) as caught:
        load(text, tmp_path)
    faults = vars(caught.value)["faults"]
    fields = {fault.field for fault in faults}
    assert fields >= {
        "motor.inertia",
        "motor.inertia_kg_m2",
        "link.length_m",
        "payloads.low",
    }
    assert len(str(caught.value).splitlines()) == len(faults)
    missing = next(fault for fault in faults if fault.field == "motor.inertia_kg_m2")
    assert "kg·m²" in missing.allowed and "add inertia_kg_m2" in missing.remedy


LOG = """
[log]
time = { column = "t", unit = "s" }
motor_angle = { column = "theta", unit = "deg" }
torque = { column = "gamma", unit = "Nm" }
"""


@pytest.mark.parametrize(
    ("old", "new", "field", "hint"),
    [
        ('unit = "deg"', 'unit = "degree"', "log.motor_angle.unit", "deg"),
        ('unit = "Nm"', 'unit = "V"', "log.torque.unit", "Nm"),
        (', unit = "Nm" }', " }", "log.torque.unit", "never guessed"),
        ('column = "t", ', "", "log.time.column", "column"),
        ("torque = ", "torqe = ", "log.torqe", "torque"),
        ('unit = "Nm" }', 'unit = "Nm", sign = 2 }', "log.torque.sign", "1 or -1"),
        ('unit = "Nm" }', 'unit = "Nm", sign = 0 }', "log.torque.sign", "1 or -1"),
        ('unit = "Nm" }', 'unit = "Nm", scale = 0.0 }', "log.torque.scale", "1 or -1"),
        (
            'unit = "Nm" }',
            'unit = "Nm", offset = "last" }',
            "log.torque.offset",
            "first",
        ),
    ],
)
def test_b20_the_columns_state_unit_and_sign(
    old: str, new: str, field: str, hint: str, tmp_path: Path
) -> None:
    assert old in LOG
    with pytest.raises(FieldError) as caught:
        load(PAPER.read_text(encoding="utf-8") + LOG.replace(old, new), tmp_path)
    faults = getattr(caught.value, "faults", (caught.value,))
    chosen = next((fault for fault in faults if fault.field == field), None)
    assert chosen is not None, [fault.field for fault in faults]
    assert hint in chosen.remedy + chosen.allowed


def test_b29_python_values_are_checked_too() -> None:
    with pytest.raises(FieldError, match=r"link\.stiffness: out of range \(got 0\.0\)"):
        Link(length=0.65, flexural_rigidity=0.26, stiffness=0.0)
    with pytest.raises(FieldError, match="not a number"):
        Motor(inertia=True, viscous_friction=0.1, torque_constant=1)
    with pytest.raises(FieldError, match="not a whole number"):
        Encoder(counts_per_revolution=1000.5)  # type: ignore[arg-type]


def test_a_link_without_any_stiffness_names_both_ways_to_state_one() -> None:
    with pytest.raises(FieldError, match=r"link\.stiffness is required.*EI"):
        Link(length=0.65)
    assert Link(length=0.65, stiffness=1.2).flexural_rigidity == pytest.approx(0.26)


def test_b61_long_files_lines_and_keys_are_refused_fast(tmp_path: Path) -> None:
    # A rejection by size takes milliseconds; tomllib alone would take seconds for the
    # keys.
    with processor_limit(2.0):
        with pytest.raises(FileFormatError, match="too large"):
            load("a" * 70_000, tmp_path)
        with pytest.raises(FileFormatError, match="too long in line 1"):
            load(".".join(["a"] * 20_000) + " = 1", tmp_path)
        with pytest.raises(FileFormatError, match="not valid"):
            load("x = " + "[\n" * 20_000, tmp_path)
        with pytest.raises(FileFormatError, match="not valid"):
            load(
                "\n".join(f"x{i} = {'9' * 900}" for i in range(60))
                + "\ny = {'9' * 5000}",
                tmp_path,
            )


def test_b72_hostile_texts_cannot_leave_their_string(tmp_path: Path) -> None:
    import dataclasses

    name = 'x"\n[motor]\ninertia_kg_m2 = 1\n#\\'
    rig = dataclasses.replace(Rig.named("paper-2023"), name=name)
    rig.save(tmp_path / "rig.toml")
    assert Rig.load(tmp_path / "rig.toml") == rig


junk = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**30), 10**30),
    st.floats(),
    st.text(CHARACTERS, max_size=10),
    st.lists(st.integers(), max_size=3),
    st.dictionaries(st.text(CHARACTERS, max_size=5), st.integers(), max_size=2),
)


def _places(
    data: dict[str, Any], prefix: tuple[str, ...] = ()
) -> list[tuple[str, ...]]:
    found = []
    for key, value in data.items():
        found.append((*prefix, key))
        if isinstance(value, dict):
            found += _places(value, (*prefix, key))
    return found


FULL = paper() | {"log": tomllib.loads(LOG)["log"]}
PLACES = _places(FULL)


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(PLACES), junk, st.booleans()), min_size=1, max_size=4
    )
)
def test_any_junk_in_any_field_is_a_rig_or_a_field_error(
    faults: list[tuple[tuple[str, ...], Any, bool]],
) -> None:
    data = deepcopy(FULL)
    for place, value, rename in faults:
        table: Any = data
        for key in place[:-1]:
            table = table.get(key) if isinstance(table, dict) else None
        if isinstance(table, dict):
            table[place[-1] + ("x" if rename else "")] = value
    try:
        rig = Rig.from_tables(data)
    except FieldError as error:
        assert error.field and error.allowed and error.remedy
    else:
        assert rig.natural_frequency(0.03) > 0


@pytest.mark.slow
def test_the_command_line_prints_a_line_for_each_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from fraclink import main

    text = (
        PAPER.read_text(encoding="utf-8")
        .replace("inertia_kg_m2", "inertia")
        .replace("length_m = 0.65", "length_m = -1")
    )
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    assert main(["design", "--rig", str(tmp_path / "rig.toml"), "--json"]) == 2
    answer = capsys.readouterr()
    assert [line.split(":")[1].split()[0] for line in answer.err.splitlines()] == [
        "motor.inertia",
        "motor.inertia_kg_m2",
        "link.length_m",
    ]
    assert [fault["field"] for fault in json.loads(answer.out)["error"]["faults"]][
        2
    ] == "link.length_m"
    # a folder of results has a rig file that nobody named
    assert main(["report", str(tmp_path)]) == 2
    assert all("rig.toml" in line for line in capsys.readouterr().err.splitlines())


def test_the_command_line_keeps_one_line_for_one_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from fraclink import main

    path = tmp_path / "rig.toml"
    path.write_text(changed('name = "a"\nnombre = "b\\nc"', tmp_path), encoding="utf-8")
    assert main(["design", "--rig", str(path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
