"""Figures of the FMU: periods that FMPy simulates to the bit, what a step costs, what a
file weighs.

    python benchmarks/bench_fmu.py [--periods 50000]

The sensors are those of a run of the twin with noise, friction, saturation and a gauge
that is lost at last. Every line: what was measured | value | wanted | error beside it.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from pathlib import Path

import fmpy
import numpy as np
from numpy.typing import NDArray

import fraclink as fl
from fraclink._export import export_fmu
from fraclink._law import Law, discretize_controller
from fraclink._simulate import Run, SensorFault, Twin, geared

INPUTS = ("reference", "reference_acceleration", "motor_angle", "torque")


def line(what: str, value: str, wanted: str, error: str = "") -> None:
    """Print one figure."""
    print(f"{what} | {value} | {wanted} | {error}", flush=True)


def recorded(law: Law, twin: Twin, periods: int) -> tuple[Run, NDArray[np.void]]:
    """Return a run of the twin and the inputs of its law as FMPy takes them."""
    end = periods * law.period
    moves = fl.smooth_step(1.0, duration=0.5, start=0.5)
    for k in range(1, math.ceil(end / 1.25)):
        # every tenth one saturates the motor
        moves = moves.then(
            fl.smooth_step(
                (-1.0) ** k, duration=0.25 if k % 10 == 5 else 0.5, start=0.75
            )
        )
    # 9 N·m is not credible: the law rides through short losses, the last one degrades
    # it
    losses = [(k * end / 10, 3 * law.period) for k in range(1, 9)] + [(0.9 * end, end)]
    events = [
        SensorFault(begin, begin + lasting, "gauge value", 9.0)
        for begin, lasting in losses
    ]
    run = fl.simulate(law, moves, arm=twin, duration=end, events=events)
    # FMPy's own instants: between samples it would interpolate
    columns = [
        law.period * np.arange(len(run.time)),
        run.reference,
        moves.acceleration(run.time),
    ]
    columns += [run.motor_angle_measured, run.torque_measured]
    return run, np.rec.fromarrays(columns, names=", ".join(("time", *INPUTS)))


def main() -> None:
    """Print the figures of both versions in both precisions."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--periods", type=int, default=50_000)
    periods = parser.parse_args().periods
    rig = geared(fl.Rig.named("paper-2023"))
    design = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    twin = Twin.from_rig(rig, link_mass=0.00735)
    folder = Path(tempfile.mkdtemp())
    for precision in ("double", "single"):
        law = discretize_controller(
            design.controller, rig.period, rig=rig
        ).in_precision(precision)
        run, inputs = recorded(law, twin, periods)
        began = time.process_time()
        law.run(law.initial_state(), *(inputs[name] for name in INPUTS), first_tick=0)
        alone = (time.process_time() - began) / len(inputs)
        for fmi in (2, 3):
            file = export_fmu(law, folder / f"arm_{precision}_{fmi}.fmu", fmi=fmi)
            began = time.process_time()
            result = fmpy.simulate_fmu(
                str(file),
                input=inputs,
                stop_time=inputs["time"][-1],
                output_interval=law.period,
            )
            each = (time.process_time() - began) / len(inputs)
            # the twin tells what the law answers in a period, and the voltage that acts
            # in it; an importer sees both at the period's end
            same = np.array_equal(result["voltage"], run.voltage) and all(
                np.array_equal(result[name][1:], getattr(run, name)[:-1])
                for name in ("motor_reference", "mode", "reason", "flags")
            )
            saturated = int(np.sum((run.flags & 64) != 0))
            line(
                f"FMI {fmi}, {precision}: periods equal to the twin's, to the bit",
                f"{len(result)} {'equal' if same else 'DIFFERENT'}",
                "50000 equal",
                f"modes {sorted(map(int, np.unique(run.mode)))}, {saturated} saturated",
            )
            line(
                f"FMI {fmi}, {precision}: a step in FMPy, in steps of the law in one batch call",
                f"{each / alone:.0f}",
                "-",
                f"{1e6 * each:.1f} us of processor time, FMPy's own Python; file of {file.stat().st_size} B",
            )


if __name__ == "__main__":
    main()
