"""Text tables in different formats: each is read like the plain table, with a remark on
what was done, or is shown and refused.
"""

from __future__ import annotations

import datetime
import re
from pathlib import Path

import numpy as np
import pytest

from fraclink import inspect_log, read_log
from fraclink.errors import FileFormatError, LogError
from fraclink.extend import read_columns
from made_logs import HEADER, made_rows, write_log

ROWS = made_rows(300)
NUMBERS = np.array(ROWS, dtype=float)
PLAIN = ",".join(HEADER) + "\n" + "\n".join(map(",".join, ROWS)) + "\n"
BODY = PLAIN.split("\n", 1)[1]


def stamped(date: str, point: str = ".") -> str:
    """The rows with times of day instead of seconds, which pass midnight."""
    start = datetime.datetime(2026, 3, 31, 23, 59, 59, 500_000)
    lines = []
    for row in ROWS:
        moment = start + datetime.timedelta(milliseconds=round(1e3 * float(row[0])))
        stamp = moment.strftime(date) + f"{moment.microsecond // 1000:03d}"
        lines.append(";".join((stamp.replace("#", point), row[1], row[2])))
    return "clock;motor_angle_rad;torque_Nm\n" + "\n".join(lines) + "\n"


# The content of the file, the names and units it is read with, and a word of the
# remark.
FORMS: dict[str, tuple[bytes, tuple[str, ...], tuple[str, ...], str]] = {
    "plain": (PLAIN.encode(), (*HEADER,), (), ""),
    "UTF-16": (PLAIN.encode("utf-16"), (*HEADER,), (), ""),
    "Windows-1252": (
        "t [µs],a [°],g\n".encode("cp1252") + BODY.encode(),
        ("t [µs]", "a [°]", "g"),
        (),
        "",
    ),
    "decimal commas": (
        PLAIN.replace(",", ";").replace(".", ",").encode(),
        (*HEADER,),
        (),
        "decimal commas",
    ),
    "quotes": (
        (",".join(HEADER) + "\n" + re.sub(r"[^,\n]+", r'"\g<0>"', BODY)).encode(),
        (*HEADER,),
        (),
        "quotes",
    ),
    "a title": (
        ("Experiment 5, beam A\nDate: 1 March\n\n" + PLAIN).encode(),
        (*HEADER,),
        (),
        "2 lines of title",
    ),
    "units below the names": (
        ("time,angle,torque\n(s),(deg),(mNm)\n" + BODY).encode(),
        ("time", "angle", "torque"),
        ("s", "deg", "mNm"),
        "line 2 holds the units",
    ),
    "separators at the end of every row": (
        (",".join(HEADER) + "\n" + BODY.replace("\n", ",\n")).encode(),
        (*HEADER,),
        (),
        "at the end of every row",
    ),
    "ISO stamps": (
        stamped("%Y-%m-%dT%H:%M:%S#").encode(),
        ("clock", "motor_angle_rad", "torque_Nm"),
        ("s", "", ""),
        "seconds since 2026-03-31T23:59:59.500",
    ),
    "a clock over midnight": (
        stamped("%H:%M:%S#").encode(),
        ("clock", "motor_angle_rad", "torque_Nm"),
        ("s", "", ""),
        "seconds since 23:59:59.500",
    ),
    "a clock with decimal commas": (
        stamped("%Y-%m-%d %H:%M:%S#").replace(".", ",").encode(),
        ("clock", "motor_angle_rad", "torque_Nm"),
        ("s", "", ""),
        "decimal commas",
    ),
}


FORMS["points between thousands"] = (
    PLAIN.replace(",", ";")
    .replace(".", ",")
    .replace("\n0,000;0;0\n", "\n0,000;0,0;0,0\n")
    .encode(),
    (*HEADER,),
    (),
    "decimal commas",
)
FORMS["a record that begins in the middle of a row"] = (
    (",".join(HEADER) + "\n0.3,0.17\n" + BODY).encode(),
    (*HEADER,),
    (),
    "line 2 is part of a row",
)


@pytest.mark.parametrize("name", FORMS)
def test_a_form_is_read_as_the_plain_table_is(name: str, tmp_path: Path) -> None:
    content, names, units, words = FORMS[name]
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    listing, columns = inspect_log(path), read_columns(path)
    assert tuple(columns) == names
    if units:
        assert tuple(channel.unit for channel in listing.channels) == units
    np.testing.assert_allclose(
        np.column_stack([*columns.values()]), NUMBERS, rtol=0, atol=1e-9
    )
    remarks = listing.remarks
    assert any(words in remark for remark in remarks) if words else not remarks


def test_whole_seconds_beside_nanoseconds_are_one_time(tmp_path: Path) -> None:
    stamps = [1_764_000_000_250_000_000 + round(1e9 * float(row[0])) for row in ROWS]
    rows = [
        [str(n // 10**9), str(n % 10**9), "arm_joint", row[1], row[2]]
        for n, row in zip(stamps, ROWS, strict=True)
    ]
    path = tmp_path / "echo.csv"  # of `ros2 topic echo --csv`: without a header
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    log = read_log(
        path,
        columns={
            "time": "#1 + 1e-9 * #2 [s]",
            "motor_angle": "#4 [rad]",
            "torque": "#5 [Nm]",
        },
    )
    assert log.period == pytest.approx(0.004, rel=1e-6)


def test_dates_of_a_country_serve_within_a_day(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(
        stamped("%d.%m.%Y %H:%M:%S#")
    )  # over midnight: a day later, or a month
    with pytest.raises(LogError, match="write the time as seconds".capitalize()):
        read_columns(path)
    path.write_text(stamped("03.04.2026 12:%M:%S#").replace(" 12:00", " 13:00"))
    np.testing.assert_allclose(read_columns(path)["clock"], NUMBERS[:, 0], atol=1e-9)


# --- names that do not fit the rows -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "names",
    ["time_s,motor_angle_rad", "time_s,motor_angle_rad,torque_Nm,spare"],
)
def test_columns_whose_names_do_not_fit_are_called_by_number(
    names: str, tmp_path: Path
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(names + "\n" + BODY)
    listing = inspect_log(path)
    assert [channel.name for channel in listing.channels] == ["#1", "#2", "#3"]
    assert any("names above rows of 3 cells" in item for item in listing.remarks)
    numbered = {"time": "#1 [s]", "motor_angle": "#2 [rad]", "torque": "#3 [Nm]"}
    assert np.array_equal(read_log(path, columns=numbered).output, NUMBERS[:, 2])
    with pytest.raises(LogError, match='by its number, "#2"'):
        read_log(path, columns={**numbered, "motor_angle": "motor_angle_rad [rad]"})
    with pytest.raises(LogError, match="not stated"):
        read_log(path)


def test_what_follows_a_table_is_cut_off_by_the_line_that_is_told(
    tmp_path: Path,
) -> None:
    path = write_log(tmp_path / "log.csv", ROWS)
    path.write_text(path.read_text() + "\nEnd of recording\n")
    with pytest.raises(LogError, match=re.escape("sed -i '302,$d'")):
        read_columns(path)


# --- arrays of NumPy, raw numbers --------------------------------------------------------------------------


def test_an_array_of_numpy_is_refused_with_the_way_to_a_csv(tmp_path: Path) -> None:
    np.save(tmp_path / "log.npy", NUMBERS)
    with pytest.raises(FileFormatError, match="savetxt"):
        read_columns(tmp_path / "log.npy")
    np.savetxt(tmp_path / "log.csv", np.load(tmp_path / "log.npy"), delimiter=",")
    columns = read_columns(tmp_path / "log.csv")
    assert list(columns) == ["#1", "#2", "#3"]
    np.testing.assert_array_equal(np.column_stack([*columns.values()]), NUMBERS)


def test_raw_numbers_are_refused_with_the_way_to_read_them(tmp_path: Path) -> None:
    NUMBERS.tofile(tmp_path / "log.bin")
    with pytest.raises(FileFormatError, match=r"np\.fromfile\('log\.bin'\)"):
        read_columns(tmp_path / "log.bin")


@pytest.mark.parametrize(
    ("cells", "value"),
    [
        (("0,125", "1,500"), 0.125),
        (("0,5", "1,25"), 0.5),
        (("1,125", "2,500"), None),
        (("1250,125", "1,5"), 1250.125),
    ],
)
def test_three_digits_behind_a_comma_may_be_thousands(
    cells: tuple[str, str], value: float | None, tmp_path: Path
) -> None:
    """1,125 is either one and an eighth or more than a thousand; 0,125 cannot have a
    thousands separator.
    """
    path = tmp_path / "log.csv"
    path.write_text("a;b\n" + f"{cells[0]};{cells[1]}\n" * 5, "utf-8")
    if value is None:
        with pytest.raises(LogError, match="export with decimal points"):
            read_columns(path)
    else:
        assert read_columns(path)["a"].tolist() == [value] * 5
        assert inspect_log(path).remarks == ("decimal commas",)
