"""Bad logs: every entry of the catalogue that concerns a reader, by its number."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fraclink import Channel, LogColumns, Rig, read_log
from fraclink.errors import FieldError, FileFormatError, LogError, SizeError
from fraclink.extend import read_columns
from made_logs import HEADER, made_rows, write_log

Rows = list[list[str]]


def refused(path: Path, **options: object) -> FieldError:
    """The error raised by reading `path`; it must be one of ours and complete."""
    with pytest.raises(FieldError) as caught:
        read_log(path, **options)  # type: ignore[arg-type]
    error = caught.value
    assert error.field and error.problem and error.allowed and error.remedy
    return error


def spoilt(
    folder: Path, change: Callable[[Rows], object], **options: object
) -> FieldError:
    """The error of a good log after `change` has been made to its rows."""
    rows = made_rows()
    change(rows)
    return refused(write_log(folder / "log.csv", rows), **options)


def put(row: int, column: int, text: str) -> Callable[[Rows], object]:
    return lambda rows: rows[row].__setitem__(column, text)


@pytest.mark.parametrize(
    "cell", ["nan", "NaN", "inf", "-Inf", "", "NA", "#N/A", "null"]
)
def test_b01_a_missing_cell_names_line_column_and_count(
    cell: str, tmp_path: Path
) -> None:
    error = spoilt(tmp_path, put(100, 2, cell))
    assert isinstance(error, LogError)
    assert error.field == "line 102, column torque_Nm"
    assert error.value == (cell or "(empty)")
    assert "1 of 400" in error.problem
    assert "--interpolate" in error.remedy


def test_b01_interpolation_is_not_offered_for_many(tmp_path: Path) -> None:
    def change(rows: Rows) -> None:
        for row in rows[100:110]:
            row[2] = "nan"

    error = spoilt(tmp_path, change, interpolate=True)
    assert "10 of 400" in error.problem
    assert error.remedy == "record again"


def test_b02_a_motor_that_does_not_move(tmp_path: Path) -> None:
    error = spoilt(tmp_path, lambda rows: [row.__setitem__(1, "0.7") for row in rows])
    assert error.field == "motor_angle"
    assert "0.7" in str(error.value) and error.problem == "constant"
    assert "excite" in error.remedy


def test_b03_a_dead_gauge(tmp_path: Path) -> None:
    error = spoilt(tmp_path, lambda rows: [row.__setitem__(2, "0.02") for row in rows])
    assert error.field == "torque"
    assert "gauge" in error.remedy


def test_b04_too_few_samples(tmp_path: Path) -> None:
    error = refused(write_log(tmp_path / "log.csv", made_rows(199)))
    assert (error.field, error.value) == ("log", "199 samples")
    assert "200" in error.allowed


def test_b05_gaps_are_counted_and_measured(tmp_path: Path) -> None:
    def change(rows: Rows) -> None:
        del rows[200:207], rows[50]

    error = spoilt(tmp_path, change)
    assert error.field == "time"
    assert "32 ms" in str(error.value)
    assert "2 gaps, about 8 samples lost" in error.problem
    assert "--resample" in error.remedy


def test_b06_repeated_stamps_are_numbered(tmp_path: Path) -> None:
    def change(rows: Rows) -> None:
        rows[10][0] = rows[9][0]
        rows[20][0] = rows[19][0]

    error = spoilt(tmp_path, change)
    assert error.field == "time"
    assert "sample 10, 20 (2 such)" in error.problem


def test_b07_decreasing_time(tmp_path: Path) -> None:
    error = spoilt(tmp_path, put(300, 0, "0.5"), resample=True)
    assert error.field == "time"
    assert "sample 300" in str(error.value) and "0.5 s" in str(error.value)
    assert "decreasing" in error.problem and "sort" in error.remedy


def test_b08_milliseconds_called_seconds(tmp_path: Path) -> None:
    error = spoilt(
        tmp_path,
        lambda rows: [row.__setitem__(0, str(4 * k)) for k, row in enumerate(rows)],
    )
    assert error.field == "time"
    assert "4 s between samples" in str(error.value)
    assert "milliseconds" in error.problem and '"ms"' in error.remedy


@pytest.mark.parametrize("label", ["thirty", "-0.03", "nan", "1_0"])
def test_b16_a_payload_label_that_is_no_mass(label: str, tmp_path: Path) -> None:
    error = refused(
        write_log(tmp_path / "log.csv", made_rows(), before=f"# payload_kg: {label}\n")
    )
    assert error.field == "payload_kg"


@pytest.mark.parametrize("payload", [0.0, -0.03, float("nan"), float("inf"), True])
def test_b25_b26_b28_a_payload_that_is_no_mass(payload: float, tmp_path: Path) -> None:
    error = refused(write_log(tmp_path / "log.csv", made_rows()), payload=payload)
    assert error.field == "payload"
    assert "kg" in error.allowed


def stated(motor: str = "theta", time_unit: str = "s") -> LogColumns:
    return LogColumns(
        Channel("t", time_unit), Channel(motor, "rad"), torque=Channel("gamma", "Nm")
    )


def test_b19_a_misspelt_column_is_answered_by_the_nearest(tmp_path: Path) -> None:
    path = write_log(
        tmp_path / "log.csv", made_rows(), header=["t", "theta_m", "gamma"]
    )
    error = refused(path, columns=stated())
    assert (error.field, error.value) == ("column of motor_angle", "theta")
    assert error.remedy == "did you mean 'theta_m'?"
    assert error.allowed == "t, theta_m, gamma"


def test_b20_a_log_without_units_is_refused_with_the_way_to_state_them(
    tmp_path: Path,
) -> None:
    path = write_log(tmp_path / "log.csv", made_rows(), header=["t", "theta", "gamma"])
    error = refused(path, rig=Rig.named("paper-2023"))
    assert error.field == "columns"
    assert error.value == "t, theta, gamma"
    assert "never guessed" in error.problem
    assert "fraclink start" in error.remedy


def test_b20_a_role_stated_twice(tmp_path: Path) -> None:
    path = write_log(
        tmp_path / "log.csv",
        made_rows(),
        header=["time_s", "motor_angle_rad", "motor_angle_deg"],
    )
    assert "stated twice" in refused(path).problem


def test_b21_an_input_of_zeros(tmp_path: Path) -> None:
    error = spoilt(tmp_path, lambda rows: [row.__setitem__(1, "0") for row in rows])
    assert error.field == "motor_angle"


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "empty"),
        (b"\n\n", "without samples"),
        (b"# only this\n", "without samples"),
        (b"time_s,a,b\n", "header only"),
    ],
)
def test_b22_nothing_in_the_file(content: bytes, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    error = refused(path)
    assert error.field == "log"
    assert problem in error.problem


def test_b23_one_column(tmp_path: Path) -> None:
    path = write_log(
        tmp_path / "log.csv", [[row[2]] for row in made_rows()], header=["torque_Nm"]
    )
    assert refused(path).field == "columns"


def test_b51_b55_a_gigabyte_is_refused_without_being_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.csv"
    with path.open("wb") as stream:
        stream.write(b"time_s,motor_angle_rad,torque_Nm\n")
        stream.truncate(1_000_000_000)  # a sparse file, which takes no space on disk

    def opened(*_: object, **__: object) -> None:
        raise AssertionError("the file was opened")

    monkeypatch.setattr(Path, "open", opened)
    monkeypatch.setattr("builtins.open", opened)
    error = refused(path)
    assert isinstance(error, SizeError)
    assert error.value == "1000 MB" and "256 MB" in error.allowed


@pytest.mark.slow
def test_b55_too_many_rows(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(b"a,b\n" + b"1,2\n" * 4_000_300)
    error = refused(path)
    assert isinstance(error, SizeError)
    assert "rows" in str(error.value) and "4000000 rows" in error.allowed


@pytest.mark.parametrize("where", ["header", "body"])
def test_b56_a_line_of_ten_megabytes(where: str, tmp_path: Path) -> None:
    rows = made_rows()
    header = list(HEADER)
    if where == "header":
        header[1] = "x" * 10_000_000
    else:
        rows[5][1] = "1" * 10_000_000
    error = refused(write_log(tmp_path / "log.csv", rows, header=header))
    assert isinstance(error, SizeError)
    assert error.field == ("line 1" if where == "header" else "line 7")
    assert len(str(error)) < 500


@pytest.mark.parametrize(
    ("cell", "hint"),
    [
        ("1_000", "underscores"),
        ("١٢٣", "digits 0 to 9"),
        ("infinit", "repair"),
        ("1.2.3", "repair"),
        ("0x10", "repair"),
        ("1e", "repair"),
        ("1e9999", "repair"),
        ("1e400", "repair"),
        ("--1", "repair"),
        (".", "repair"),
        ("x", "repair"),
        ("=1+1", "repair"),
        ("1 2", "repair"),
        ("12:30:01.5", "seconds"),
        ("2026-11-21T12:30:01Z", "seconds"),
        ("2026-11-21", "seconds"),
    ],
)
def test_b57_what_is_no_number(cell: str, hint: str, tmp_path: Path) -> None:
    error = spoilt(tmp_path, put(100, 1, cell))
    assert error.field == "line 102, column motor_angle_rad"
    assert error.value == cell
    assert "not a number (1 such" in error.problem
    assert hint in error.remedy


def test_b58_commas_that_may_group_thousands(tmp_path: Path) -> None:
    rows = [[f"{1 + k},000", f"{1 + k},{k:03d}", "2"] for k in range(400)]
    error = refused(write_log(tmp_path / "log.csv", rows, separator=";"))
    assert error.field == "line 2, column time_s"
    assert "decimal comma" in error.remedy


def test_b58_decimal_commas_between_commas(tmp_path: Path) -> None:
    rows = [
        [f"{float(cell):.4f}".replace(".", ",") for cell in row] for row in made_rows()
    ]
    error = refused(write_log(tmp_path / "log.csv", rows))
    assert error.field == "line 2"
    assert "decimal commas" in error.remedy


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_b59_wide_encodings(encoding: str, tmp_path: Path) -> None:
    path = write_log(tmp_path / "log.csv", made_rows())
    path.write_bytes(path.read_text().encode(encoding))
    error = refused(path)
    assert isinstance(error, FileFormatError)
    assert "UTF" in error.problem or "NUL" in error.problem
    assert "UTF-8" in error.remedy


def test_b59_a_wide_encoding_that_is_cut_off(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log.csv", made_rows())
    path.write_bytes(path.read_text().encode("utf-16")[:-1])
    error = refused(path)
    assert isinstance(error, FileFormatError)
    assert error.problem.startswith("not UTF-16 (at byte ")


def test_b59_a_nul_byte(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log.csv", made_rows())
    path.write_bytes(path.read_bytes()[:500] + b"\x00" + path.read_bytes()[500:])
    assert "NUL at byte 500" in refused(path).problem


def test_b59_names_between_other_separators_are_names(tmp_path: Path) -> None:
    path = write_log(tmp_path / "log.csv", made_rows())
    lines = path.read_bytes().split(b"\n")
    path.write_bytes(
        b"\n".join([lines[0], *(line.replace(b",", b";") for line in lines[1:])])
    )
    assert read_log(path).motor_angle.size == len(made_rows())


@pytest.mark.parametrize("separator", [",", " "])
def test_b60_ragged_rows_are_numbered(separator: str, tmp_path: Path) -> None:
    rows = made_rows()
    rows[40].append("1")
    rows[60].pop()
    error = refused(write_log(tmp_path / "log.csv", rows, separator=separator))
    assert error.field == "line 42"
    assert "4 cells" in error.problem and error.allowed == "3 cells"


@pytest.mark.parametrize("separator", [",", " "])
def test_b60_a_blank_line_inside(separator: str, tmp_path: Path) -> None:
    path = write_log(tmp_path / "log.csv", made_rows(), separator=separator)
    lines = path.read_bytes().split(b"\n")
    path.write_bytes(b"\n".join([*lines[:50], b"", *lines[50:]]))
    error = refused(path)
    assert error.field == "line 51"
    assert "blank line" in error.remedy


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("log.mat", b"time_s,a\n1,2\n", "text by its content"),
        ("log.csv", b"PAR1" + b"x" * 100, "Parquet by its content"),
        ("log.csv", b"MATLAB 5.0 MAT-file" + b" " * 200, "MAT v5 by its content"),
        ("log.csv", b"PK\x03\x04" + b"x" * 100, "a zip or spreadsheet by its content"),
        ("log.csv", b"\x1f\x8b" + b"x" * 100, "gzip by its content"),
        ("log.tdms", b"\x89HDF\r\n\x1a\n" + b"x" * 100, "HDF5 by its content"),
    ],
)
def test_b68_a_name_that_promises_another_format(
    name: str, content: bytes, problem: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    error = refused(path)
    assert isinstance(error, FileFormatError)
    assert error.problem == problem


def test_b73_a_path_that_is_no_file(tmp_path: Path) -> None:
    assert "not there" in refused(tmp_path / "none.csv").problem
    assert "not a file" in refused(tmp_path).problem


def test_b74_b75_what_a_file_says_cannot_command_a_terminal(tmp_path: Path) -> None:
    error = spoilt(tmp_path, put(100, 1, "\x1b[31mred"))
    assert "\x1b" not in str(error)
    path = write_log(tmp_path / "a\x1b[31m.csv", made_rows(10))
    assert "\x1b" not in str(refused(path))


def test_read_columns_refuses_what_it_cannot_name(tmp_path: Path) -> None:
    rows = made_rows(5)
    rows[2][1] = "x"
    with pytest.raises(LogError, match="line 4"):
        read_columns(write_log(tmp_path / "a.csv", rows))
    with pytest.raises(LogError, match="the name of 2 columns"):
        read_columns(
            write_log(tmp_path / "b.csv", made_rows(5), header=["a", "a", "b"])
        )


def test_resampling_cannot_blow_up_the_memory(tmp_path: Path) -> None:
    def change(rows: Rows) -> None:
        rows[-1][0] = "1e9"

    error = spoilt(tmp_path, change, resample=True)
    assert isinstance(error, SizeError)


def test_the_command_line_states_columns_and_repairs(tmp_path: Path) -> None:
    from fraclink import main

    rows = made_rows(600)
    rows[100][1], rows[200][0] = "nan", rows[199][0]
    path = write_log(tmp_path / "log.csv", rows, header=["t", "theta", "gamma"])
    words = [
        text
        for column in ("time=t [s]", "motor_angle=theta [rad]", "torque=gamma [Nm]")
        for text in ("--column", column)
    ]
    call = ["diagnose", str(path), "--rig", "paper-2023", "--payload", "0.03"]
    assert main([*call]) == 2
    assert main([*call, *words]) == 2
    assert main([*call, *words, "--interpolate"]) == 2
    assert main([*call, *words, "--interpolate", "--resample"]) == 0
