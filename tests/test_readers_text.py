"""Text logs: what is read, in which units, and how it becomes an Experiment."""

from __future__ import annotations

import math
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fraclink import (
    Channel,
    Experiment,
    LogColumns,
    Rig,
    bundled_log,
    inspect_log,
    load,
    read_log,
    save,
)
from fraclink.errors import FieldError, LogError
from fraclink.extend import bundled_logs, read_columns
from fraclink.logs import diagnose
from junk import CHARACTERS
from made_logs import made_rows, write_log
from shared_data import shared_data

RIGS = Path(__file__).parent / "rigs"
SI = LogColumns(
    Channel("t", "s"), Channel("theta", "rad"), torque=Channel("gamma", "Nm")
)


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "   ", ", "])
@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_every_separator_and_line_end_gives_the_same_numbers(
    separator: str, ending: str, tmp_path: Path
) -> None:
    rows = made_rows(250)
    path = write_log(tmp_path / "a.txt", rows, separator=separator)
    path.write_bytes(path.read_bytes().replace(b"\n", ending.encode()))
    log = read_log(path)
    assert log.motor_angle.tolist() == [float(row[1]) for row in rows]
    assert log.output.tolist() == [float(row[2]) for row in rows]
    assert (log.period, log.start_time, log.output_kind) == (0.004, 0.0, "torque")


def test_a_column_s_number_is_the_whole_number(tmp_path: Path) -> None:
    """ "#12" is the twelfth column, and "#123" is none of twelve."""
    rows = [[*row, *["0"] * 9] for row in made_rows()]
    names = [f"c{k}" for k in range(1, 12)]
    path = write_log(tmp_path / "a.csv", rows, header=[*names, "#1"])
    stated = {"time": "c1 [s]", "motor_angle": "#2 [rad]", "torque": "#3 [Nm]"}
    assert read_log(path, columns=stated).motor_angle[300] == float(rows[300][1])
    for name in ("#0", "#13", "#123", "#9999999999", "#1.5", "#²"):
        with pytest.raises(FieldError, match="not in the log"):
            read_log(path, columns={**stated, "motor_angle": f"{name} [rad]"})
    # A column with the name of the quantity takes precedence.
    with pytest.raises(LogError, match="motor_angle: constant"):
        read_log(path, columns={**stated, "motor_angle": "#1 [rad]"})


def test_units_sign_scale_and_offset_are_applied(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.csv", made_rows(), header=["t", "theta", "gamma"])
    plain = read_log(path, columns=SI)
    turned = LogColumns(
        Channel("t", "ms", scale=1000.0),
        Channel("theta", "deg", sign=-1, scale=2.0, offset="first"),
        torque=Channel("gamma", "mNm", offset=0.5),
    )
    log = read_log(path, columns=turned)
    assert log.period == plain.period
    np.testing.assert_allclose(
        log.motor_angle,
        -2 * np.radians(plain.motor_angle - plain.motor_angle[0]),
        rtol=1e-14,
    )
    np.testing.assert_allclose(log.output, (plain.output - 0.5) / 1000, rtol=1e-14)


@pytest.mark.parametrize(
    "names",
    [
        ["time_ms", "motor_angle_deg", "torque_mNm"],
        ["time [ms]", "motor_angle [deg]", "torque [mNm]"],
        ["time (ms)", "motor_angle (deg)", "torque (mNm)"],
    ],
)
def test_names_that_state_role_and_unit_are_enough(
    names: list[str], tmp_path: Path
) -> None:
    rows = [[str(4 * k), cells[1], cells[2]] for k, cells in enumerate(made_rows())]
    log = read_log(write_log(tmp_path / "a.csv", rows, header=names))
    assert log.period == 0.004
    assert log.motor_angle[300] == pytest.approx(
        math.radians(float(rows[300][1])), rel=1e-15
    )
    assert log.output[300] == pytest.approx(float(rows[300][2]) / 1000, rel=1e-15)


def test_si_numbers_are_read_bit_for_bit(tmp_path: Path) -> None:
    values = np.random.default_rng(1).standard_normal((300, 2))
    rows = [
        [repr(0.004 * k), repr(float(a)), repr(float(b))]
        for k, (a, b) in enumerate(values)
    ]
    log = read_log(write_log(tmp_path / "a.csv", rows))
    assert np.array_equal(log.motor_angle, values[:, 0])
    assert np.array_equal(log.output, values[:, 1])


@pytest.mark.parametrize("name", bundled_logs())
def test_every_bundled_log_is_read_and_says_that_it_is_simulated(name: str) -> None:
    log = read_log(bundled_log(name), rig=Rig.named("paper-2023"))
    assert log.simulated
    assert log.payload is not None
    assert log.period == 0.004


def test_an_unknown_bundled_log_lists_the_known_ones() -> None:
    with pytest.raises(FieldError, match="prbs_30g"):
        bundled_log("prbs_300g")


def test_the_merced_log() -> None:
    log = read_log(
        shared_data("quanser_rfl_merced", "merced_rfl.csv"),
        rig=Rig.load(RIGS / "merced.toml"),
        payload=0.0158,
    )
    assert (log.period, log.motor_angle.size, log.output_kind) == (
        0.002,
        2500,
        "deflection",
    )
    assert log.start_time == 0.002
    # alpha_deg has the opposite sign
    assert np.degrees(log.output).max() == pytest.approx(10.0971)
    assert log.voltage is not None
    assert log.voltage.max() == pytest.approx(5.95488)


@pytest.mark.parametrize("name", ["2_lab_a15_f10.csv", "2_lab_a10_f04.csv"])
def test_the_ist_logs(name: str) -> None:
    log = read_log(shared_data("ist_flexbar", name), rig=Rig.load(RIGS / "ist.toml"))
    assert (log.period, log.motor_angle.size, log.output_kind) == (
        0.001,
        10001,
        "deflection",
    )
    assert log.motor_angle[0] == 0.0
    # The gauge reads about −0.09 V at rest, as its authors state.
    assert np.degrees(log.output).mean() / 1.301 == pytest.approx(-0.095, abs=0.01)


def test_inspect_lists_rates_ranges_and_steps() -> None:
    listing = inspect_log(shared_data("ist_flexbar", "2_lab_a15_f10.csv"))
    found = {channel.name: channel for channel in listing.channels}
    assert found["t_s"].period == pytest.approx(0.001)
    assert found["u_V"].maximum == 1.5
    assert found["strain_V"].quantum == pytest.approx(
        4.88e-3, rel=1e-2
    )  # 12 bits over 20 V
    assert "strain_V" in str(listing)
    assert listing.kind == "text"


def test_inspect_shows_hostile_names_without_their_control_characters(
    tmp_path: Path,
) -> None:
    path = write_log(
        tmp_path / "a.csv", made_rows(), header=["time_s", "a\x1b[31m", "b"]
    )
    listing = inspect_log(path)
    assert "\x1b" not in str(listing)


@pytest.mark.slow
@given(
    st.one_of(
        st.floats(allow_nan=False, allow_infinity=False).map(repr),
        st.text(CHARACTERS, max_size=8),
    )
)
@settings(max_examples=300, deadline=None)
def test_a_cell_is_a_number_exactly_where_its_form_is_one(cell: str) -> None:
    assume(not set(cell) & set('\t\r\n;,"#%') and "\x00" not in cell)
    plain = re.fullmatch(
        r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", cell.strip(" "), re.A
    )
    with tempfile.TemporaryDirectory() as folder:
        rows = [["1", "2"], ["2", "3"], ["3", cell], ["4", "5"]]
        path = write_log(Path(folder, "a.csv"), rows, header=["a", "b"])
        if plain and math.isfinite(float(cell)):
            assert read_columns(path)["b"][2] == float(cell)
        else:
            with pytest.raises(LogError, match=r"line 4, column b|line 4"):
                read_columns(path)


def test_resampling_uses_the_stamps(tmp_path: Path) -> None:
    rows = made_rows(800)
    # about 1 % of the samples are lost
    kept = [row for k, row in enumerate(rows) if k % 97 != 50]
    log = read_log(write_log(tmp_path / "a.csv", kept), resample=True)
    whole = read_log(write_log(tmp_path / "b.csv", rows))
    assert log.motor_angle.size == 800
    # Linear interpolation over one lost sample is wrong by at most h²/8·|θ''|, where h
    # is two periods.
    bend = float(np.abs(np.diff(whole.output, 2)).max())
    assert float(np.abs(log.output - whole.output).max()) <= bend
    (finding,) = log.findings
    assert finding.code == "W205"
    assert finding.evidence["lost_samples"] == 8
    assert finding.evidence["time_s"] == pytest.approx(
        0.004 * 49
    )  # of the last sample before the first gap


def test_a_stretch_is_read_and_the_rest_may_have_gaps(tmp_path: Path) -> None:
    rows = made_rows(800)
    whole = read_log(write_log(tmp_path / "whole.csv", rows))
    cut = read_log(
        write_log(tmp_path / "gap.csv", rows[:600] + rows[650:]), keep=(0.4, 2.0)
    )
    assert np.array_equal(cut.output, whole.output[100:501])
    assert (cut.start_time, cut.duration) == (pytest.approx(0.4), pytest.approx(1.6))
    (finding,) = cut.findings
    assert finding.code == "W237" and dict(finding.evidence) == pytest.approx(
        {"from_s": 0.4, "until_s": 2.0}
    )
    (finding,) = read_log(
        write_log(tmp_path / "ends.csv", rows), keep=(1.0, 40.0)
    ).findings
    # the available names, not the requested one
    assert "from 1 to 3.196 s was read" in finding.message
    late = [[repr(100.0 + 0.004 * k), *row[1:]] for k, row in enumerate(rows)]
    assert np.array_equal(
        read_log(write_log(tmp_path / "late.csv", late), keep=(0.4, 2.0)).output,
        cut.output,
    )


def test_the_angle_before_a_cut_is_kept_as_far_back_as_it_is_uniform(
    tmp_path: Path,
) -> None:
    rows = made_rows(800)
    whole = read_log(write_log(tmp_path / "whole.csv", rows))
    assert whole.earlier_angle is None and whole.whole_angle is whole.motor_angle
    cut = read_log(write_log(tmp_path / "cut.csv", rows), keep=(0.4, 2.0))
    assert cut.earlier_angle is not None and np.array_equal(
        cut.earlier_angle, whole.motor_angle[:100]
    )
    assert np.array_equal(cut.whole_angle, whole.motor_angle[:501])
    # A gap after sample 29, and a repeated time stamp: the samples before it moved the
    # link at an unknown time.
    gap = read_log(
        write_log(tmp_path / "gap.csv", rows[:30] + rows[35:]), keep=(0.4, 2.0)
    )
    assert gap.earlier_angle is not None and np.array_equal(
        gap.earlier_angle, whole.motor_angle[35:100]
    )
    twice = read_log(
        write_log(tmp_path / "twice.csv", [*rows[:41], *rows[40:]]), keep=(0.4, 2.0)
    )
    assert twice.earlier_angle is not None and np.array_equal(
        twice.earlier_angle, whole.motor_angle[40:100]
    )
    just = read_log(
        write_log(tmp_path / "just.csv", rows[:95] + rows[100:]), keep=(0.4, 2.0)
    )
    assert just.earlier_angle is None
    assert (
        load(save(cut, tmp_path / "cut.npz")) == cut != replace(cut, earlier_angle=None)
    )


@pytest.mark.slow
def test_a_cut_in_mid_motion_is_no_warning_where_the_motion_before_is_known() -> None:
    def begins(log: Experiment) -> tuple[str, str]:
        (found,) = (item for item in diagnose(log) if item.code == "W231")
        return found.severity, found.remedy

    cut = read_log(bundled_log("prbs_30g"), keep=(3.8, 12.0))
    assert cut.earlier_angle is not None
    severity, remedy = begins(cut)
    assert severity == "info" and remedy.startswith(
        "identify starts from what the motor did before the cut; other"
    )
    moving = int(np.argmax(np.abs(np.diff(cut.earlier_angle))))
    late = cut.earlier_angle[moving - 1 :]
    assert late.size > 100
    rest = np.full(2_000, cut.earlier_angle[0])
    rested = replace(cut, earlier_angle=np.concatenate([rest, cut.earlier_angle]))
    assert begins(rested)[0] == "info"
    # No earlier samples, too few for a rest, and samples that are themselves in motion.
    for earlier in (None, cut.earlier_angle[-5:], late):
        severity, remedy = begins(replace(cut, earlier_angle=earlier))
        assert severity == "warning" and remedy.endswith("models assume rest")


@pytest.mark.parametrize(
    "keep", [(2.0, 1.0), (-0.1, 1.0), (1.0, 1.001), (50.0, 60.0), (math.nan, 1.0)]
)
def test_no_stretch_is_refused_by_its_name(
    tmp_path: Path, keep: tuple[float, float]
) -> None:
    with pytest.raises(
        FieldError, match=r"^keep: no stretch of the log .*within 3\.196 s"
    ):
        read_log(write_log(tmp_path / "a.csv", made_rows(800)), keep=keep)


def test_the_stated_payload_wins_and_the_contradiction_is_named(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.csv", made_rows(), before="# payload_kg: 0.030\n")
    log = read_log(path, payload=0.04)
    assert log.payload == 0.04
    assert [finding.code for finding in log.findings] == ["W216"]
    assert "0.03 kg" in log.findings[0].message


@pytest.mark.parametrize(("unit", "told"), [("deg", True), ("rad", False)])
def test_a_header_that_contradicts_the_stated_unit_is_a_gate(
    tmp_path: Path, unit: str, told: bool
) -> None:
    path = write_log(tmp_path / "log.csv", made_rows(600))
    time, angle, torque = (
        Channel("time_s", "s"),
        Channel("motor_angle_rad", unit),
        Channel("torque_Nm", "Nm"),
    )
    log = read_log(path, columns=LogColumns(time, angle, torque=torque))
    found = [finding for finding in log.findings if finding.code == "W220"]
    assert bool(found) is told
    for finding in found:
        assert finding.severity == "error"
        assert finding.evidence["header_unit"] == 1.0
        assert finding.evidence["stated_unit"] == pytest.approx(np.pi / 180)


def test_a_column_that_is_missing_is_told_with_those_that_are_there(
    tmp_path: Path,
) -> None:
    rows = [[*row, *["0"] * 10] for row in made_rows()]
    names = ["Time", "Theta_deg", *(f"c{k}" for k in range(3, 14))]
    path = write_log(tmp_path / "a.csv", rows, header=names)
    stated = {"time": "Time [s]", "motor_angle": "q [rad]", "torque": "c3 [Nm]"}
    with pytest.raises(FieldError) as caught:
        read_log(path, columns=stated)
    assert caught.value.field == "column of motor_angle"
    assert caught.value.allowed.startswith("Time, Theta_deg, c3")
    assert caught.value.allowed.endswith("c12, …")
    with pytest.raises(FieldError, match=r"Did you mean 'Theta_deg'\?"):
        read_log(path, columns={**stated, "motor_angle": "theta_deg [deg]"})
