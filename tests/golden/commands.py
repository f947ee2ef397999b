"""The output of the command line: both streams, exit code and files written, as one
text per command.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import tempfile
from pathlib import Path

import fraclink as fl
from fraclink import main
from made_logs import example_motor_log

HERE = Path(__file__).resolve().parent
TEXTS = HERE / "commands"
WIDTH = "100"  # columns: the width of help pages must not depend on the terminal

RIG = "--rig paper-2023"
# No link is bent by the motor of motor.csv: its deflection is left out.
DRIVE = "--column time=time_s[s] --column motor_angle=motor_angle_rad[rad] --column voltage=voltage_V[V]"
BUNDLED = ("prbs_20g", "prbs_30g", "prbs_40g", "pulse_30g")
THREE = "prbs_20g.csv prbs_30g.csv prbs_40g.csv"

# Name of the text: the command. All run in one folder; `NEEDS` lists the commands that
# must run before. Commands that take long or print times are left out: run-realtime,
# serve-arm, export c --prove.
COMMANDS: dict[str, str] = {
    "version": "--version",
    "help": "--help",
    "help-export": "export --help",
    "help-campaign": "campaign --help",
    "help-identify": "identify --help",
    "help-design": "design --help",
    "start": "start demo --out mine",
    "inspect": "inspect demo",
    "inspect-json": "inspect demo --json",
    "diagnose": f"diagnose demo {RIG}",
    "diagnose-json": f"diagnose demo {RIG} --json",
    "diagnose-pulse": f"diagnose pulse_30g.csv {RIG}",
    "identify": f"identify demo {RIG} --out model.json",
    "identify-json": f"identify demo {RIG} --out model.json --force --json",
    "identify-damped": f"identify demo {RIG} --structure D-FOM --out damped.json",
    "identify-payloads": f"identify {THREE} {RIG}",
    "identify-payloads-tied": f"identify {THREE} {RIG} --tied",
    "identify-motor": f"identify motor.csv --structure motor {RIG} {DRIVE}",
    # With both orders given there is no search, whose last digit would depend on the
    # machine.
    "tune-pid": "tune-pid 1/(0.8*s**2.2+0.5*s**0.9+1) --gain-crossover 2 --integral-order 1.2 "
    "--derivative-order 0.95 --out pid.json",
    "identify-structure": "identify response.csv --structure k*s**a/(s**a+w) --out structure.json",
    "design": f"design {RIG}",
    "design-json": f"design {RIG} --force --json",
    "design-geared": f"design {RIG} --model model.json --link-mass 0.00735 --out massive.json",
    "design-massive": "design --rig paper-2023-geared --out geared.json",
    "design-bounds": f"design {RIG} --max-sensitivity 1.6 --gain-crossover 11.4 --noise-gain 2 --out b.json",
    "design-infeasible": f"design {RIG} --gain-crossover 30 --phase-margin-deg 80 --out no.json",
    "design-infeasible-json": f"design {RIG} --gain-crossover 30 --phase-margin-deg 80 --out no.json --json",
    "design-there": f"design {RIG}",
    "design-bad-rig": "design --rig paper-2032 --out no.json",
    "design-bad-rig-json": "design --rig paper-2032 --out no.json --json",
    "design-bad-margin": f"design {RIG} --phase-margin-deg 200 --out no.json",
    "design-no-rig": "design",
    "no-such-command": "desing",
    "simulate": "simulate design.json --payload 0.02",
    "simulate-heavy": "simulate design.json --payload 0.2 --out heavy.npz",
    "simulate-no-design": "simulate nothing.json --payload 0.02",
    "simulate-twin": "simulate geared.json --on twin --seed 1",
    "certify": "certify design.json --modulus-margin 0.35",
    "certify-fails": "certify design.json --modulus-margin 0.9 --out no.json",
    "assess": "assess geared.json",
    "assess-json": "assess geared.json --json",
    "export-c": "export c design.json",
    "export-fmu": "export fmu design.json --source",
    "export-arm-firmware": "export arm-firmware",
    "replay-of-nothing": "replay nothing --run 1 --out nothing.npz",
    "run": f"run {RIG} --log demo --out results",
    "report": "report results --out page.html",
    "compare": "compare geared.json --only ZV",
    "campaign-montecarlo": "campaign montecarlo --design design.json --runs 200 --seed 7 --out carlo.npz",
    "replay-of-a-campaign": "replay carlo.npz --run 65 --out replayed.npz",
    "campaign-faults": "campaign faults --design geared.json --only F02 --severity 2 --payload 0.03 "
    "--phase mid --seed 1 --out faults",
    "campaign-faults-open": "campaign faults --design geared.json --only F07 --severity 3 "
    "--payload 0.03 --phase mid --seed 3 --out open",
    "run-realtime-no-arm": "run-realtime design.json --io nowhere",
}


# The commands whose output a command reads.
NEEDS: dict[str, str] = {
    "design-geared": "identify",
    "design-there": "design",
    "simulate-no-design": "simulate",
    "export-c": "design",
    "export-fmu": "design",
    "campaign-montecarlo": "design",
    "replay-of-a-campaign": "campaign-montecarlo",
    "report": "run",
} | dict.fromkeys(
    (
        "simulate",
        "simulate-heavy",
        "certify",
        "certify-fails",
    ),
    "design",
)
NEEDS |= dict.fromkeys(
    (
        "simulate-twin",
        "assess",
        "assess-json",
        "compare",
        "campaign-faults",
        "campaign-faults-open",
    ),
    "design-massive",
)


def _inputs() -> None:
    """The bundled logs, a log with voltages, and a table of gain and phase, as a user
    has them.
    """
    for name in BUNDLED:
        Path(f"{name}.csv").write_bytes(fl.bundled_log(name).read_bytes())
    voltage, angle = example_motor_log(samples=2500)
    rows = ["time_s,motor_angle_rad,deflection_rad,voltage_V"]
    for k, (a, v) in enumerate(zip(angle.tolist(), voltage.tolist(), strict=True)):
        rows.append(f"{0.004 * k:.4f},{a:.9f},{0.01 * a:.9f},{v:.9f}")
    Path("motor.csv").write_text("\n".join(rows) + "\n", "utf-8")
    rows = ["frequency_Hz,gain_dB,phase_deg"]
    for k in range(80):
        x = (1j * (1 + 0.5 * k)) ** 1.92
        h = 1.56 * x / (x + 100)
        phase = math.degrees(math.atan2(h.imag, h.real))
        rows.append(
            f"{(1 + 0.5 * k) / 2 / math.pi:.9f},{20 * math.log10(abs(h)):.9f},{phase:.9f}"
        )
    Path("response.csv").write_text("\n".join(rows) + "\n", "utf-8")


def _rounded(match: re.Match[str]) -> str:
    value = float(match[0])
    return "~0" if abs(value) < 1e-12 else f"{value:.7g}"


def normalised(text: str, folder: Path) -> str:
    """`text` without machine-dependent parts: paths, the release, the last digits of
    long numbers.
    """
    for place, word in (
        (str(fl.bundled_log("prbs_30g").parent), "LOGS"),
        (str(folder), "HERE"),
    ):
        text = text.replace(place, word)
    text = text.replace(fl.__version__, "VERSION")
    # Only JSON prints this many digits; a rounding error in the last ones is no change
    # of behaviour.
    return re.sub(r"-?\d+\.\d{9,}(?:e[-+]?\d+)?|-?\d\.\d+e-\d+", _rounded, text)


def answer(line: str, folder: Path) -> str:
    """Run one command in the current folder and return everything it did as one text."""
    before = {
        path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()
    }
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(line.split())
    now = {
        path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()
    }
    written = sorted(
        path.relative_to(folder).as_posix()
        for path in now
        if now[path] != before.get(path)
    )
    parts = [f"$ fraclink {line}\n", out.getvalue()]
    parts += ["--- standard error\n", err.getvalue()] if err.getvalue() else []
    parts += [f"--- exit code {code}\n"]
    parts += ["--- files\n", *(f"{name}\n" for name in written)] if written else []
    return normalised("".join(parts), folder)


class Desk:
    """A folder with the inputs, in which each command runs once, after the commands it
    needs.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._texts: dict[str, str] = {}
        with contextlib.chdir(folder):
            _inputs()

    def text(self, name: str) -> str:
        """Everything the command did."""
        if name in NEEDS:
            self.text(NEEDS[name])
        if name not in self._texts:
            kept = os.environ.get("COLUMNS")
            os.environ["COLUMNS"] = WIDTH
            with contextlib.chdir(self._folder):
                self._texts[name] = answer(COMMANDS[name], self._folder)
            if kept is None:
                del os.environ["COLUMNS"]
            else:
                os.environ["COLUMNS"] = kept
        return self._texts[name]


def record_commands() -> None:
    """Write the texts again."""
    TEXTS.mkdir(exist_ok=True)
    for old in TEXTS.glob("*.txt"):
        old.unlink()
    with tempfile.TemporaryDirectory() as temporary:
        desk = Desk(Path(temporary))
        for name in COMMANDS:
            (TEXTS / f"{name}.txt").write_text(desk.text(name), "utf-8")
