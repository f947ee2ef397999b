"""Signals that laboratories have: two channels, lengths, raw gauges; each from a file
to a model.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
import fracsys
from fraclink import Channel, LogColumns, main
from fraclink.errors import FieldError, LogError
from fracsys import s

PERIOD, COUNT, LENGTH = 0.004, 3000, 0.32
ORDER, FREQUENCY = 1.93, 10.02
Signals = dict[str, NDArray[np.float64]]


@pytest.fixture(scope="module")
def motion() -> Signals:
    """Motor angle and deflection of a link that does not belong to a bundled rig."""
    time = np.asarray(PERIOD * np.arange(COUNT), dtype=np.float64)
    angle = fl.prbs(0.4, 0.24, bits=45, register=9, start=0.3).angle(time)
    angle = np.convolve(angle, np.ones(20) / 20, "same")
    bent = s**ORDER / (s**ORDER + FREQUENCY**2)
    deflection = fracsys.time_response(bent, angle, PERIOD, hold="first").output
    return {"t_s": time, "angle": angle, "deflection": deflection}


def written(place: Path, **columns: NDArray[np.float64]) -> Path:
    table = np.column_stack(list(columns.values()))
    np.savetxt(
        place, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g"
    )
    return place


def columns_of(stated: Iterable[str]) -> dict[str, str]:
    return dict(text.split("=", 1) for text in stated)


def model_of(path: Path, *stated: str) -> fl.Fit:
    log = fl.read_log(path, columns=columns_of(stated))
    return fl.identify(log, "UD-FOM", details=False)


NOISE = np.random.default_rng(3).standard_normal((2, COUNT))


def cases(m: Signals) -> dict[str, tuple[Signals, tuple[str, ...], float]]:
    """Columns of the file, the statements about them, and the gain of a correct
    reading.
    """
    angle, bent = m["angle"], m["deflection"]
    degrees = np.degrees(angle)
    time, motor = "time=t_s [s]", "motor_angle=enc [deg]"
    common = {"t_s": m["t_s"], "enc": degrees}
    tip = np.degrees(angle - bent + 3e-4 * NOISE[0])
    gauges = {
        "g1": 0.9 * bent + 1.2 + 2e-3 * NOISE[0],
        "g2": -0.9 * bent + 0.7 + 2e-3 * NOISE[1],
    }
    return {
        "tip encoder": (
            {**common, "tip": tip},
            (time, motor, "deflection=enc - tip [deg]"),
            1.0,
        ),
        "half bridge": (
            {**common, **gauges},
            (time, motor, "deflection=g1 - g2 [rad]"),
            1.8,
        ),
        "sum": (
            {**common, "a": 0.25 * bent + 1e-3 * NOISE[0], "b": 0.75 * bent},
            (time, motor, "deflection=a + b * 1/2 [rad]"),
            0.5,
        ),
        "metres": (
            {**common, "laser": LENGTH * bent + 1e-4 * NOISE[0]},
            (time, motor, "deflection=laser * 1/0.32 [rad]"),
            1.0,
        ),
        "volts": (
            {**common, "bridge": 1.83 * bent + 0.2},
            (time, motor, "deflection=bridge [rad]"),
            1.83,
        ),
        "no stamps": (
            {"enc": degrees, "bridge": bent},
            ("time=#row * 4 [ms]", motor, "deflection=bridge [rad]"),
            1.0,
        ),
        "linear axis": (
            {"t_s": m["t_s"], "cart_m": 0.1 * angle, "bridge": bent},
            (time, "motor_angle=cart_m * 1/0.1 [rad]", "deflection=bridge [rad]"),
            1.0,
        ),
    }


NAMES = (
    "tip encoder",
    "half bridge",
    "sum",
    "metres",
    "volts",
    "no stamps",
    "linear axis",
)


@pytest.mark.parametrize("name", NAMES)
def test_a_signal_gives_the_link(name: str, motion: Signals, tmp_path: Path) -> None:
    columns, stated, gain = cases(motion)[name]
    fit = model_of(written(tmp_path / "log.csv", **columns), *stated)
    assert fit.model.natural_frequency == pytest.approx(FREQUENCY, rel=5e-3)
    assert fit.model.order == pytest.approx(ORDER, abs=0.01)
    assert fit.gain == pytest.approx(gain, rel=0.01)


def test_every_case_is_tried(motion: Signals) -> None:
    assert tuple(cases(motion)) == NAMES


@pytest.mark.slow
def test_start_takes_a_difference(
    motion: Signals, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    columns, _, _ = cases(motion)["tip encoder"]
    named = {
        "t_s": columns["t_s"],
        "enc_deg": columns["enc"],
        "tip_deg": columns["tip"],
    }
    path = written(tmp_path / "log.csv", **named)
    out = tmp_path / "out"
    assert (
        main(
            [
                "start",
                str(path),
                "--column",
                "deflection=enc_deg - tip_deg [deg]",
                "--out",
                str(out),
            ]
        )
        == 0
    )
    assert "UD-FOM" in capsys.readouterr().out
    assert "enc_deg - tip_deg" in (out / "rig.toml").read_text()


@pytest.mark.parametrize(
    "stated", ["deflection=enc - nothing [deg]", "deflection=nothing + tip [deg]"]
)
def test_a_part_that_is_not_there(stated: str, motion: Signals, tmp_path: Path) -> None:
    columns, _, _ = cases(motion)["tip encoder"]
    path = written(tmp_path / "log.csv", **columns)
    with pytest.raises(LogError, match="nothing"):
        model_of(path, "time=t_s [s]", "motor_angle=enc [deg]", stated)


def test_a_column_of_that_name_comes_first(motion: Signals, tmp_path: Path) -> None:
    columns = {
        "t_s": motion["t_s"],
        "enc": motion["angle"],
        "enc - x": motion["deflection"],
    }
    path = written(tmp_path / "log.csv", **columns, x=motion["angle"])
    log = fl.read_log(
        path,
        columns={
            "time": "t_s [s]",
            "motor_angle": "enc [rad]",
            "deflection": "enc - x [rad]",
        },
    )
    np.testing.assert_allclose(log.output, motion["deflection"], rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "unit", "words"),
    [
        ("deflection", "m", "a length over the link's length"),
        ("deflection", "mm", "a length over the link's length"),
        ("deflection", "V", "not calibrated"),
        ("torque", "counts", "not calibrated"),
        ("deflection", "m/s2", "identify --structure"),
        ("torque", "m", "another quantity"),
        ("torque", "rad", "another quantity"),
        ("deflection", "Nm", "another quantity"),
        ("deflection", "degree", "did you mean 'deg'"),
        ("torque", "nm", "did you mean 'Nm'"),
    ],
)
def test_no_suggestion_crosses_quantities(kind: str, unit: str, words: str) -> None:
    """Metres led to "did you mean 'mrad'?", which is wrong by a factor of 1000 over the
    length of the link.
    """
    with pytest.raises(FieldError) as caught:
        LogColumns(
            Channel("t", "s"), Channel("enc", "deg"), **{kind: Channel("x", unit)}
        )
    assert words in caught.value.remedy
    assert ("did you mean" in caught.value.remedy) is ("did you mean" in words)
