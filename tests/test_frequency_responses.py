"""Frequency responses as data: tables in any orientation, link and motor, bands with
missing parts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
import fracsys
from fraclink import main as run
from fraclink.errors import FieldError, LogError

LINES = np.geomspace(2.0, 60.0, 120)


def arm(output: str = "motor_angle") -> fracsys.FractionalTransferFunction:
    s = fracsys.s
    link = s**1.92 / (s**1.92 + 100)
    driven = (60 / (s**2 + 15 * s + 9 * link)).delayed(0.002)
    return driven if output == "motor_angle" else 1.5 * link * driven


def noisy(output: str = "motor_angle", seed: int = 0) -> fl.FrequencyResponse:
    rng = np.random.default_rng(seed)
    noise = 0.02 * (
        rng.standard_normal(LINES.size) + 1j * rng.standard_normal(LINES.size)
    )
    return fl.FrequencyResponse(LINES, arm(output)(1j * LINES) * (1 + noise))


# --- tables -------------------------------------------------------------------------------------------------

WANTED = np.array([1.0, 0.1j])


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("frequency_Hz,gain_dB,phase_deg\n1,0,0\n2,-20,90\n", None),
        ("omega;re;im\n6.283185307179586;1;0\n12.566370614359172;0;0.1\n", None),
        (
            "Frequency (Hz)\tMagnitude\tPhase (rad)\n1\t1\t0\n2\t0.1\t1.5707963267948966\n",
            None,
        ),
        (
            "1,0,0\n2,-20,90\n",
            {"frequency": "#1 [Hz]", "gain": "#2 [dB]", "phase": "#3 [deg]"},
        ),
        (
            "a,b,c\n1,1,0\n2,0.1,90\n",
            {"frequency": "a [Hz]", "gain": "b", "phase": "c [deg]"},
        ),
    ],
)
def test_tables(tmp_path: Path, text: str, columns: object) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    found = fl.read_frequency_response(path, columns)  # type: ignore[arg-type]
    assert found.frequency == pytest.approx(2 * np.pi * np.array([1.0, 2.0]))
    assert found.response == pytest.approx(WANTED, abs=1e-12)
    assert (found.source, len(found.sha256)) == ("table.csv", 64)


def test_no_cell_of_a_table_is_made_up(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    rows = [f"{k},{1 / k:.6f},-90" for k in range(1, 301)]
    rows[100] = "101,,-90"
    path.write_text("\n".join(["omega,gain,phase_deg", *rows]))
    with pytest.raises(LogError, match="line 102, column gain: missing"):
        fl.read_frequency_response(path)


@pytest.mark.parametrize(
    ("header", "refused"),
    [
        ("freq [mHz],gain,phase_rad", ("frequency", "mHz", "rad/s or Hz or kHz")),
        ("freq [MHz],gain,phase_rad", ("frequency", "MHz", "rad/s or Hz or kHz")),
        ("f_GHz,gain,phase_rad", ("frequency", "GHz", "rad/s or Hz or kHz")),
        ("freq [krad/s],gain,phase_rad", ("frequency", "krad/s", "rad/s or Hz or kHz")),
        (
            "omega_krad_per_s,gain,phase_rad",
            ("frequency", "krad/s", "rad/s or Hz or kHz"),
        ),
        ("w [rpm],gain,phase_rad", ("frequency", "rpm", "rad/s or Hz or kHz")),
        ("f_Hz,gain,phase_mdeg", ("phase", "mdeg", "rad or deg or mrad")),
        ("f_Hz,gain,phase [Hz]", ("phase", "Hz", "rad or deg or mrad")),
        ("f_Hz,amplitude [mm],phase_rad", ("gain", "mm", "1 or dB")),
        ("f_Hz,amplitude_mm,phase_rad", ("gain", "mm", "1 or dB")),
        ("f_Hz,gain (Nm/rad),phase_rad", ("gain", "Nm/rad", "1 or dB")),
        ("f_Hz,real [dB],imag", ("real", "dB", "no unit")),
        ("f_Hz,real,imag_mV", ("imaginary", "mV", "no unit")),
        ("f_Hz,real,imag,coherence [%]", ("coherence", "%", "no unit")),
    ],
)
def test_a_unit_that_is_not_converted_is_refused(
    tmp_path: Path, header: str, refused: tuple[str, str, str]
) -> None:
    path = tmp_path / "table.csv"
    width = 2 * header.count(",") + 1
    path.write_text(f"{header}\n{'1,1,0,1'[:width]}\n{'2,3,1,1'[:width]}\n")
    with pytest.raises(LogError) as caught:
        fl.read_frequency_response(path)
    role, unit, allowed = refused
    assert caught.value.field == f"column of {role}"
    assert caught.value.problem == f"in {unit}, a unit that is not converted"
    assert caught.value.allowed == allowed


@pytest.mark.parametrize(
    ("name", "period"),
    [
        *(
            ("time_ms", 0.01),
            ("t [ms]", 0.01),
            ("Time (us)", 1e-5),
            ("time-ns", 1e-8),
            ("timeMs", 0.01),
        ),
        ("millis", 0.01),
        *(
            ("ms_since_start", 0.01),
            ("t", 10.0),
            ("time_stamp", 10.0),
            ("t_s", 10.0),
            ("Time (Sekunden)", 10.0),
        ),
    ],
)
def test_stamps_are_in_the_unit_of_their_name(
    tmp_path: Path, name: str, period: float
) -> None:
    path = tmp_path / "record.csv"
    path.write_text(f"{name},u,y\n0,0,0\n10,1,1\n20,0,2\n")
    assert fl.extend.read_recording(path, "u", "y").period == pytest.approx(
        period, rel=1e-12
    )
    assert fl.extend.read_recording(path, "u", "y", time="#1").period == pytest.approx(
        period, rel=1e-12
    )


@pytest.mark.parametrize(
    ("given", "field", "words"),
    [
        ({"period": 0.1, "time": "nonsense"}, "period", "given beside a time column"),
        (
            {"input": "#0"},
            "column of input",
            'name it as the header does, or by its number: "#1" is the first',
        ),
        (
            {"time": "#9"},
            "column of time",
            'name it as the header does, or by its number: "#1" is the first',
        ),
        ({"time": "t"}, "time", "too few rows for a step"),
    ],
)
def test_columns_of_a_recording(
    tmp_path: Path, given: dict[str, str], field: str, words: str
) -> None:
    path = tmp_path / "record.csv"
    path.write_text(
        "t,u,y\n0,1,2\n" if given == {"time": "t"} else "t,u,y\n0,1,2\n1,1,2\n2,1,2\n"
    )
    with pytest.raises(FieldError) as caught:
        fl.extend.read_recording(path, **{"input": "u", "output": "y", **given})  # type: ignore[arg-type]
    assert caught.value.field == field
    assert words in (caught.value.problem, caught.value.remedy)


def test_coherence_is_read(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("w,real,imag,coh\n1,1,0,0.9\n2,0,1,0.5\n")
    coherence = fl.read_frequency_response(path).coherence
    assert coherence is not None
    assert coherence.tolist() == [0.9, 0.5]


def test_recordings(tmp_path: Path) -> None:
    path = tmp_path / "furnace.csv"
    path.write_text("t_s,power,temp\n0,1,0\n60,1,2\n120,0,3\n")
    found = fl.extend.read_recording(path, "power", "temp")
    assert (found.period, found.output.tolist()) == (60.0, [0.0, 2.0, 3.0])
    assert fl.extend.read_recording(path, "power", "#3", period=2.0).period == 2.0
    path.write_text("a,power,temp\n0,1,0\n1,1,2\n2,0,3\n")
    with pytest.raises(LogError, match="not clear"):
        fl.extend.read_recording(path, "power", "temp")
    path.write_text("time,power,temp\n0,1,0\n1,1,2\n3,0,3\n")
    with pytest.raises(LogError, match="not uniform"):
        fl.extend.read_recording(path, "power", "temp")


# --- link and motor -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("output", ["motor_angle", "torque"])
def test_link_and_motor(output: str, tmp_path: Path) -> None:
    found = fl.extend.identify_driven_link(noisy(output), output=output, details=False)  # type: ignore[arg-type]
    assert found.passed, found.findings
    assert found.order == pytest.approx(1.92, abs=0.02)
    assert found.anti_resonance == pytest.approx(100 ** (1 / 1.92), rel=0.02)
    w = np.geomspace(11.1 if output == "motor_angle" else 2.0, 60.0, 100_000)
    assert found.peak == pytest.approx(
        w[np.argmax(np.abs(arm(output)(1j * w)))], rel=0.02
    )
    assert found.parameters["B"] == pytest.approx(15.0, rel=0.1)
    assert found.parameters["m"] == pytest.approx(9.0, rel=0.2)
    link = found.model(1.5 / 9.0)
    assert link.natural_frequency**2 == pytest.approx(100.0, rel=0.1)
    assert link.stiffness == pytest.approx(1.5, rel=0.2)
    for name, truth in (
        ("order", 1.92),
        ("natural_frequency", 10.0),
        ("stiffness", 1.5),
    ):
        low, high = link.interval(name)
        assert low < truth < high
    fl.save(found, tmp_path / "link.json")
    assert fl.load(tmp_path / "link.json") == found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("low", "high", "code"),
    [
        (2.0, 10.5, "W315"),
        (11.6, 60.0, "W315"),
        (2.0, 11.5, "W315"),
        (12.6, 60.0, "W315"),
    ],
)
def test_a_band_that_misses_one(low: float, high: float, code: str) -> None:
    for seed in range(3):
        found = fl.extend.identify_driven_link(
            noisy(seed=seed).between(low, high), details=False
        )
        assert code in {finding.code for finding in found.findings}
        assert not found.passed
        # a design with it would pass
        with pytest.raises(FieldError, match=f"fit: not passed .*{code}"):
            found.model(1.5 / 9.0)


@pytest.mark.slow
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured, table = noisy(), tmp_path / "response.csv"
    rows = [
        f"{w},{h.real},{h.imag}" for w, h in zip(LINES, measured.response, strict=True)
    ]
    table.write_text("\n".join(["omega,real,imag", *rows]))
    out = tmp_path / "model.json"
    command = [
        "identify",
        str(table),
        "--structure",
        "driven",
        "--rig",
        "paper-2023-geared",
        "--out",
        str(out),
    ]
    assert run(command) == 0
    shown = capsys.readouterr().out
    assert "anti-resonance" in shown
    assert fl.load(out).order == pytest.approx(1.92, abs=0.02)
    table.write_text("\n".join(["omega,real,imag", *rows[:40]]))
    assert run([*command, "--force"]) == 1


def swept() -> fl.FrequencyResponse:
    """The response of the arm up to a second mode at 150 rad/s and down to its noise."""
    rng, w = np.random.default_rng(3), np.geomspace(2.0, 500.0, 240)
    p = 1j * w
    mode = 1 + 0.5 * p**2 / (p**2 + 6 * p + 150**2)
    noise = rng.standard_normal((2, w.size)) + 1j * rng.standard_normal((2, w.size))
    h = arm()(p) * mode * (1 + 0.02 * noise[0]) + 2e-3 * noise[1]
    return fl.FrequencyResponse(w, h)


@pytest.mark.slow
def test_a_link_of_one_mode_is_fitted_where_it_holds() -> None:
    found = fl.extend.identify_driven_link(swept(), details=False)
    assert found.passed
    assert found.order == pytest.approx(1.92, abs=0.03)
    assert found.anti_resonance == pytest.approx(100 ** (1 / 1.92), rel=0.02)
    (said,) = (finding for finding in found.findings if finding.code == "W349")
    assert said.evidence["low"] == pytest.approx(2.0)
    assert 20.0 < said.evidence["high"] < 150.0
    # A stated band is taken as it is.
    stated = fl.extend.identify_driven_link(swept(), band=(2.0, 500.0), details=False)
    assert not stated.passed


@pytest.mark.slow
def test_as_few_octaves_as_possible_are_left_out_at_either_end() -> None:
    w = np.geomspace(0.5, 64.0, 160)
    friction = np.where(w < 1.5, 0.2 * np.exp(1j), 1.0)
    above = np.where(w > 40.0, 3.0 * np.exp(2j), 1.0)
    measured = fl.FrequencyResponse(w, arm()(1j * w) * friction * above)
    found = fl.extend.identify_driven_link(measured, details=False)
    (said,) = (finding for finding in found.findings if finding.code == "W349")
    assert said.evidence == {"low": 2.0, "high": 32.0, "lowest": 0.5, "highest": 64.0}


@pytest.mark.slow
def test_a_table_without_header_ends_in_a_design(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured, table = noisy(), tmp_path / "bare.csv"
    h = measured.response
    columns = (LINES / (2 * np.pi), 20 * np.log10(np.abs(h)), np.degrees(np.angle(h)))
    np.savetxt(table, np.column_stack(columns), delimiter=",")
    model, rig = tmp_path / "model.json", ["--rig", "paper-2023-geared"]
    stated = [
        word
        for name in ("frequency=#1 [Hz]", "gain=#2 [dB]", "phase=#3 [deg]")
        for word in ("--column", name)
    ]
    kind = ["identify", str(table), "--structure"]
    command = [*kind, "driven", *rig, "--out", str(model)]
    assert run([*command, *stated, "--payload", "0.03", "--band", "2", "50"]) == 0
    assert fl.load(model).payload == 0.03
    out = tmp_path / "design.json"
    asked = ["--gain-crossover", "9", "--phase-margin-deg", "40", "--filter-time", "0"]
    assert run(["design", *rig, "--model", str(model), "--out", str(out), *asked]) == 0
    text, made = "A*(s**l + w)/(s**2 + B*s)", str(tmp_path / "structure.json")
    assert run([*kind, text, *stated, "--band", "9", "50", "--out", made]) in (0, 1)
    capsys.readouterr()


@pytest.fixture(scope="module")
def driven() -> Any:
    """A fit of the motor angle, to be modified."""
    clean = fl.FrequencyResponse(LINES, arm()(1j * LINES))
    return fl.extend.identify_driven_link(clean, details=False)


@pytest.mark.slow
def test_the_peak_lies_between_the_points_of_its_grid(driven: Any) -> None:
    w = np.geomspace(11.1, 14.0, 400_001)
    exact = w[np.argmax(np.abs(driven.transfer_function(1j * w)))]
    # the step of the grid itself is 2e-3
    assert driven.peak == pytest.approx(exact, rel=2e-5)
    assert driven.order == pytest.approx(1.92, abs=1e-6)
    assert driven.anti_resonance == pytest.approx(100 ** (1 / 1.92), rel=1e-6)
    assert driven.passed and driven.findings == ()


@pytest.mark.slow
@pytest.mark.parametrize("band", [(11.2, 60.0), (2.0, 11.8)])
def test_a_place_without_lines_on_both_sides_is_not_shown(
    band: tuple[float, float],
) -> None:
    clean = fl.FrequencyResponse(LINES, arm()(1j * LINES))
    found = fl.extend.identify_driven_link(clean, band=band, details=False)
    assert "W315" in [finding.code for finding in found.findings]
    assert not found.passed
