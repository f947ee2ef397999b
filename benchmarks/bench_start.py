"""From a log without a description to a first model: logs of many forms in `start`.

Every generated log is of one motion of one arm (λ = 1.93, ω₀ = 10.02, c = 1.56 N·m/rad,
0.32 m), so that the script knows the role of each column: it compares the period, motor
angle, output, voltage, units, signs, delay, frequency and order that `start` ends with.
Where `start` refuses, its message must name the option, the line or the command that
helps; the script fills in the number known only to the laboratory and follows the
message, so that each answer is a decision. Bundled and recorded logs are compared with
what their rig files state.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is loaded

import numpy as np

import fraclink as fl
from fraclink import main as command
from fraclink.logs import Question
from harness import line, sizes
from start_shapes import DELAY, FREQUENCY, ORDER, PERIOD, Shape, forms, motion, signals

MOST_DECISIONS, MOST_SECONDS, FEWEST_SHAPES, MOST_ANSWERS = 7, 3.0, 20, 3


@dataclass
class Outcome:
    """The outcome of one log."""

    fitted: bool = False
    mended: bool = False
    decisions: int = 0
    faults: list[str] = field(default_factory=list)
    physical: int = 0


def compared(shape: Shape, found: fl.logs.Start) -> Iterator[str]:
    """What `start` got wrong."""
    log, true = found.experiment, motion()
    if abs(log.period / PERIOD - 1) > 1e-6:
        yield f"period {1e3 * log.period:.6g} ms"
    if log.output_kind != shape.kind:
        yield f"output taken for a {log.output_kind}"
    of = shape.of
    output = (
        "late" if shape.late else "torque" if shape.kind == "torque" else "deflection"
    )
    pairs = [("motor angle", log.motor_angle, true[of + "angle"], shape.any_radius)]
    pairs.append(("output", log.output, true[of + output], shape.raw))
    if shape.voltage != (log.voltage is not None):
        yield (
            "voltage not found"
            if shape.voltage
            else "voltage found where there is none"
        )
    elif log.voltage is not None:
        pairs.append(("voltage", log.voltage, true["voltage"], False))
    for name, taken, known, scaled in pairs:
        x, y = taken - taken.mean(), known[: taken.size] - known[: taken.size].mean()
        factor = float(x @ y / (y @ y))
        rest = float(np.std(x - factor * y) / np.std(x))
        if (
            rest > 0.1
            or factor <= 0
            or not (scaled or abs(factor / shape.times - 1) < 0.03)
        ):
            yield f"{name}: {factor:.3g} of the true one, {100 * rest:.2g} % besides"
    model = found.fit.model
    if (
        abs(model.natural_frequency ** (2 / model.order) / FREQUENCY ** (2 / ORDER) - 1)
        > 0.01
    ):
        yield f"resonance {model.natural_frequency ** (2 / model.order):.4g} rad/s"
    if found.fit.structure == "UD-FOM" and abs(model.order - ORDER) > 0.02:
        yield f"λ {model.order:.4g}"
    if abs(found.fit.delay - shape.late * DELAY) > 2e-3:
        yield f"delay {1e3 * found.fit.delay:.3g} ms"


def gone_on(said: str, answer: str, path: Path) -> list[str]:
    """Run the command that a refusal names; return what it did wrong."""
    named = re.search(
        re.escape(answer.strip()) + r"[^;]*?(?=, fraclink|[ .]*$| where )", said
    )
    if named is None:
        return [f"names no command: {said}"]
    words = shlex.split(named[0].replace("RIG", "paper-2023"))
    with (
        contextlib.redirect_stdout(io.StringIO()) as output,
        contextlib.redirect_stderr(output),
    ):
        code = command(
            [
                *words[1:],
                *(("--out", str(path) + ".json") if "s**a" in named[0] else ()),
            ]
        )
    text = output.getvalue()
    if code:
        return [f"{named[0]}: exit code {code}: {text[-300:]}"]
    if "k*s" in named[0] or "k/(s" in named[0]:
        found = fl.extend.StructureFit.load(str(path) + ".json").parameters
        if (
            abs(found["a"] - ORDER) > 0.03
            or abs(found["w"] ** (1 / found["a"]) / FREQUENCY ** (2 / ORDER) - 1) > 0.02
        ):
            return [f"{found}"]
    return []


def pasted(said: str, answer: str, path: Path) -> None:
    """Run the shell command that a refusal prints after `answer`."""
    text = said[
        said.index(answer) + (0 if answer == "python" else len(answer)) :
    ].rstrip(".")
    if "$d'" in text:
        text += f" {shlex.quote(path.name)}"
    subprocess.run(  # noqa: S602
        text.replace("python ", f"{sys.executable} ", 1),
        shell=True,
        check=True,
        cwd=path.parent,
    )


def tried(shape: Shape, folder: Path) -> Outcome:
    """Take one log through `start` as a person would who reads what it says."""
    outcome, path = Outcome(), shape.write(folder)
    column, options = list(shape.stated), {}
    outcome.decisions = len(column)
    for told, answer in (*shape.steps, ("", None)):
        try:
            found = fl.logs.start(path, column=column, **options)
        except ValueError as error:
            said = " ".join(str(error).split())
            if answer is None or told.lower() not in said.lower():
                outcome.faults.append(f"refused: {said}")
                return outcome
            outcome.decisions += 1
            outcome.physical += bool(re.match(r"(payload|rig|motor\.|link\.)", answer))
            if answer.startswith("fraclink") or not answer:
                outcome.faults += gone_on(said, answer, path) if answer else []
                outcome.mended = True
                return outcome
            if answer.startswith("$ "):
                pasted(said, answer[2:], path)
            elif re.fullmatch(r"(period|resample|interpolate)=.*", answer):
                name, value = answer.split("=")
                options[name] = True if value == "True" else float(value)
            else:
                column.append(answer)
        else:
            outcome.fitted = True
            outcome.faults += compared(shape, found)
            if answer is not None:
                outcome.faults.append(f"not asked: {told}")
            return outcome
    return outcome


def made(count: int) -> tuple[dict[str, Outcome], int]:
    """Every made shape, and how many tracebacks there were."""
    found, broken = {}, 0
    for name, shape in list((forms() | signals()).items())[:count]:
        with tempfile.TemporaryDirectory() as folder:
            try:
                found[name] = tried(shape, Path(folder))
            except ImportError as error:
                print(f"     {name}: needs {error.name}")
                continue
            except Exception as error:  # noqa: BLE001
                broken += 1
                found[name] = Outcome(faults=[f"{type(error).__name__}: {error}"])
        outcome = found[name]
        way = (
            "fitted"
            if outcome.fitted
            else "command or remedy named"
            if outcome.mended
            else "STUCK"
        )
        print(
            f"     {name:<44} {outcome.decisions} decisions, {way}",
            *outcome.faults,
            sep="\n         ",
            flush=True,
        )
    return found, broken


def recorded_data() -> Path:
    """The folder of the recorded logs next to the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("FRACLINK_SHARED", str(beside)))


def known_logs() -> Iterator[tuple[str, Path, tuple[str, ...], fl.Experiment]]:
    """Bundled and recorded logs: the file, what only its laboratory knows, the log as
    its rig states it.
    """
    for name in fl.extend.bundled_logs():
        path = fl.bundled_log(name)
        yield name, path, (), fl.read_log(path)
    tests = Path(__file__).resolve().parents[1] / "tests"
    data = recorded_data()
    recorded = {
        "ist_flexbar/2_lab_a05_f04.csv": ("ist", ("motor_angle=* 36.79 [deg]",)),
        "ist_flexbar/2_lab_a10_f04.csv": ("ist", ("motor_angle=* 36.79 [deg]",)),
        "ist_flexbar/2_lab_a15_f10.csv": ("ist", ("motor_angle=* 36.79 [deg]",)),
        "quanser_rfl_merced/merced_rfl.csv": ("merced", ()),
    }
    for name, (rig, stated) in recorded.items():
        if (data / name).exists():
            known = fl.read_log(
                data / name, rig=fl.Rig.load(tests / "rigs" / f"{rig}.toml")
            )
            yield name, data / name, stated, known


def compared_with(found: fl.logs.Start, known: fl.Experiment) -> Iterator[str]:
    """Where `start` read a log differently from its rig file; a gauge that is not
    calibrated may have any factor.
    """
    log = found.experiment
    pairs = [
        ("motor angle", log.motor_angle, known.motor_angle),
        ("output", log.output, known.output),
    ]
    if known.voltage is not None and log.voltage is not None:
        pairs.append(("voltage", log.voltage, known.voltage))
    if log.period != known.period or log.output_kind != known.output_kind:
        yield f"period {log.period}, {log.output_kind}"
    for name, taken, true in pairs:
        x, y = taken - taken.mean(), true - true.mean()
        factor = float(x @ y / (y @ y))
        raw = name == "output" and any(
            g.certainty == "assumed" and g.part == "output measures"
            for g in found.guesses
        )
        if (
            np.std(x - factor * y) > 1e-6 * np.std(x)
            or factor <= 0
            or not (raw or abs(factor - 1) < 1e-6)
        ):
            yield f"{name}: {factor:.3g} of the known one"


def known() -> tuple[int, int, list[str]]:
    """How many known logs there are, how many are fitted, and what is wrong."""
    count, fitted, wrong = 0, 0, []
    for name, path, stated, log in known_logs():
        count += 1
        try:
            found = fl.logs.start(path, column=stated)
        except ValueError as error:
            wrong.append(f"{name}: {error}")
            continue
        fitted += 1
        faults = list(compared_with(found, log))
        wrong += [f"{name}: {fault}" for fault in faults]
        print(
            f"     {name:<44} {len(stated)} decisions, fitted",
            *faults,
            sep="\n         ",
            flush=True,
        )
    return count, fitted, wrong


# The answers of the person at each recorded rig, according to their READMEs.
_ANSWERS = {
    "daisy_robot_arm/robot-arm.csv": {"time": "4 ms", "motor_angle": "none"},
    "ist_flexbar/1_test_deflection_model_2_final.mat": {"motor_angle": "none"},
    "ist_flexbar/2_lab_a05_f04.csv": {"motor_angle": "36.79 deg"},
    "ist_flexbar/2_lab_a10_f04.csv": {"motor_angle": "36.79 deg"},
    "ist_flexbar/2_lab_a15_f10.csv": {"motor_angle": "36.79 deg"},
    "quanser_rfl_merced/data_alpha.mat": {},
    "quanser_rfl_merced/data_theta.mat": {
        "motor_angle": "data_theta(:,3) [deg]",
        "output": "none",
    },
    "quanser_rfl_merced/data_vm.mat": {},
    "quanser_rfl_merced/merced_rfl.csv": {},
    "rig_a_late_gauge/unit7.csv": {"time": "ms"},
    "rig_b_two_stage/lqg30.mat": {
        "motor_angle": "theta11 [rad]",
        "output": "theta12 [rad]",
    },
    "rig_d_servo/linkshield.mat": {
        "time": "4 ms",
        "motor_angle": "u [deg]",
        "output": "y",
    },
    "rig_e_cart/new_model.csv": {"motor_angle": "#3 [rad]", "output": "#4 [rad]"},
    "rig_e_cart/step_damping.csv": {
        "motor_angle": "#3 [rad]",
        "output": "#3 + #4 [rad]",
    },
}


def nothing_stated(data: Path) -> None:
    """Every recorded file with nothing stated: fitted or refused with a reason, and the
    number of answers needed. Whether the reason is the true one is for a reader to
    judge.
    """
    ended, files = 0, [name for name in _ANSWERS if (data / name).exists()]
    for name in files:
        asked: list[str] = []

        def answer(
            question: Question, name: str = name, asked: list[str] = asked
        ) -> str:
            asked.append(question.role)
            return _ANSWERS[name][question.role]

        try:
            found = fl.logs.start(data / name, ask=answer)
        except ValueError as error:
            end = str(error)
        else:
            codes = [finding.code for finding in found.fit.findings]
            end = f"{'passed' if found.passed else 'not shown'} {' '.join(codes)}"
        ended += len(asked) <= MOST_ANSWERS
        print(f"     {name:<48} {len(asked)} answers: {end[:150]}", flush=True)
    line(
        f"recorded files, nothing stated: an end after <= {MOST_ANSWERS} answers",
        f"{ended} of {len(files)}",
        ">= 80 %",
        ended >= 0.8 * len(files),
    )


def speed(rounds: int) -> None:
    """`fraclink start` in a fresh process on 20 s at 250 Hz, to fit and picture: clock
    and processor.
    """
    folder = Path(tempfile.mkdtemp())
    words = [
        sys.executable,
        "-m",
        "fraclink",
        "start",
        str(fl.bundled_log("prbs_30g")),
        "--out",
        str(folder),
    ]
    clock, processor = [], []
    for _ in range(rounds):
        begin, before = time.perf_counter(), os.times()
        subprocess.run([*words, "--force"], check=True, capture_output=True)  # noqa: S603
        clock.append(time.perf_counter() - begin)
        processor.append(
            sum(b - a for a, b in zip(before[2:4], os.times()[2:4], strict=True))
        )
    shutil.rmtree(folder)
    line(
        "`fraclink start` on 20 s at 250 Hz, to fit and picture: clock [s]",
        f"{statistics.median(clock):.2f} ({min(clock):.2f} to {max(clock):.2f})",
        f"<= {MOST_SECONDS:g} s",
        statistics.median(clock) <= MOST_SECONDS,
    )
    median = statistics.median(processor)
    line(
        "the same, seconds of the processor",
        f"{median:.2f}",
        f"<= {MOST_SECONDS:g} s",
        median <= MOST_SECONDS,
    )


def main() -> None:
    """Print every figure."""
    given = sizes(__doc__, shapes=(100, 2), rounds=(5, 1))
    found, broken = made(given.shapes)
    through = sum(o.fitted for o in found.values())
    mended = sum(o.mended for o in found.values())
    wrong = [name for name, o in found.items() if o.faults]
    line(
        "made shapes: fitted, refused with the line or command that mends",
        f"{through} + {mended} of {len(found)}",
        f"all of >= {FEWEST_SHAPES}",
        through + mended == len(found) >= FEWEST_SHAPES,
    )
    line("tracebacks", str(broken), "0", not broken)
    line(
        "made shapes with a guess that is wrong",
        f"{len(wrong)} {', '.join(wrong)}",
        "0",
        not wrong,
    )
    counts = [o.decisions for o in found.values()]
    line(
        "decisions until the fit: most, median",
        f"{max(counts)}, {statistics.median(counts):g}",
        f"<= {MOST_DECISIONS}",
        max(counts) <= MOST_DECISIONS,
    )
    physical = sum(o.physical for o in found.values())
    line(
        "numbers of motor, link or payload among the answers",
        str(physical),
        "0",
        not physical,
    )
    if not given.short:
        count, fitted, faults = known()
        line(
            "bundled and recorded logs fitted",
            f"{fitted} of {count}",
            "all",
            fitted == count,
        )
        line(
            "of these taken otherwise than their rig files state",
            "; ".join(faults) or "0",
            "0",
            not faults,
        )
        nothing_stated(recorded_data())
    speed(given.rounds)


if __name__ == "__main__":
    main()
