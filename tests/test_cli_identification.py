"""The commands of identification."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fraclink import Rig, bundled_log
from fraclink import main as run
from fraclink.extend import StructureFit


def told(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    assert run([*arguments, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert isinstance(result, dict)
    return result


def test_identify_motor_needs_a_voltage(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["identify", "demo", "--structure", "motor", "--rig", "paper-2023"]) == 2
    assert "voltage" in capsys.readouterr().err


@pytest.mark.parametrize("sign", [1, -1])
def test_identify_motor_makes_the_load_of_a_deflection(
    sign: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A motor with J = 0.05 kg·m² that bends a link: without the load, K/J is wrong by
    a tenth.
    """
    from made_logs import made_output

    time = 0.004 * np.arange(3000)
    angle = 0.4 * np.sin(3 * time) - 0.15 * np.sin(8 * time)
    bent = made_output(angle, stiffness=1.0)
    stiffness = Rig.named("paper-2023").link.stiffness
    # an amplifier holds its voltage: the one in the middle of each sample
    held = time + 0.002
    speed = 1.2 * np.cos(3 * held) - 1.2 * np.cos(8 * held)
    driven = -3.6 * np.sin(3 * held) + 9.6 * np.sin(8 * held) + 15.15 * speed
    voltage = (driven + stiffness / 0.05 * np.interp(held, time, bent)) / 61.1
    log = tmp_path / "motor.csv"
    table = np.column_stack((time, angle, sign * bent, voltage))
    names = "time_s,motor_angle_rad,deflection_rad,voltage_V"
    np.savetxt(log, table, delimiter=",", header=names, comments="")
    words = ["identify", str(log), "--structure", "motor", "--rig", "paper-2023"]
    if sign < 0:
        assert run(words) == 2
        assert "J of an impossible sign" in capsys.readouterr().err
        return
    result = told(words, capsys)
    assert result["gain"] == pytest.approx(61.1, rel=1e-3)
    assert result["inertia"] == pytest.approx(0.05, rel=2e-3)
    stated = [
        w for n in ("time_s [s]", "motor_angle_rad [rad]") for w in ("--column", n)
    ]
    assert (
        run(["identify", str(log), "--structure", "motor", *stated]) == 2
    )  # neither role= nor a rig for the load
    capsys.readouterr()


@pytest.mark.slow
def test_a_ring_down_is_fitted_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = 0.004 * np.arange(2000)
    # Released at rest: with any other start the smooth rest would be an error (W310).
    swing = np.cos(10 * time) + 0.03 * np.sin(10 * time)
    ring = 0.3 + 0.1 * swing * np.exp(-0.3 * time)
    held = np.concatenate((np.full(80, 0.4), ring))[:2000]
    for name, values in (("held", held), ("begun", ring)):
        log = tmp_path / f"{name}.csv"
        np.savetxt(
            log,
            np.column_stack((time, values)),
            delimiter=",",
            header="t,strain",
            comments="",
        )
        words = [
            "identify",
            str(log),
            "--structure",
            "k/(s**2 + d*s + w)*exp(-L*s)",
            "--output",
            "strain",
        ]
        out = ["--out", str(tmp_path / "fit.json"), "--force"]
        assert run([*words, "--ring-down", *out]) == 0
        found = StructureFit.load(tmp_path / "fit.json").parameters
        assert found["w"] == pytest.approx(100.1, rel=0.01)
        assert found["d"] == pytest.approx(0.6, rel=0.05)
        assert found["L"] == pytest.approx(0.32 if name == "held" else 0.0, abs=0.003)
        capsys.readouterr()
    assert run([*words, "--ring-down", "--input", "strain"]) == 2
    assert "Leave out --input or --ring-down" in capsys.readouterr().err


@pytest.mark.slow
def test_a_log_with_a_reversed_gauge_is_fitted_and_does_not_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The fit is as good as with the right sign; the diagnosis decides the exit code."""
    log = tmp_path / "reversed.csv"
    lines = bundled_log("pulse_30g").read_text("utf-8").splitlines()
    names = next(line for line in lines if not line.startswith("#")).split(",")
    turned = names.index("torque_Nm")
    first = lines.index(",".join(names)) + 1
    for number in range(first, len(lines)):
        cells = lines[number].split(",")
        cells[turned] = str(-float(cells[turned]))
        lines[number] = ",".join(cells)
    log.write_text("\n".join(lines) + "\n", "utf-8")
    out = ["--out", str(tmp_path / "model.json")]
    asked = ["identify", str(log), "--rig", "paper-2023", *out]
    assert run(asked) == 1
    assert "opposite sign" in " ".join(capsys.readouterr().out.split())
    assert run([*asked, "--json", "--force"]) == 1
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert findings[0]["severity"] == "error"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("demo", "rig is required"),
        ("demo --rig paper-2023 --structure UD-IMO", "UD-IOM"),
        ("demo --rig paper-2023 --ring-down", "given beside the fit of one log"),
        ("a.csv b.csv --rig paper-2023 --heldout 0.4", "the fit of several logs"),
        ("a.csv b.csv --structure motor", "several files"),
        ("demo --structure motor --band 1 2", "expected --column"),
    ],
)
def test_an_option_of_another_kind_of_fit_is_refused(
    words: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["identify", *words.split()]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
