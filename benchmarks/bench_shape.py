"""A shaped move beside the quintic, ZV, ZVD and EI: settling, residual vibration,
voltage and computing time.

Twin of the geared rig: link 7.35 g, friction, 0.05 N·m gauge offset, 10 mN·m noise; 1
rad; worst of 20 seeds and of the payloads of a range, nine from 20 to 40 g. Settling
counts from the start of the move. Every rival is the best of its kind on the linear
closed loop, within the same limits.

Computing time is that of the clock with one thread: threads of OpenBLAS that wait for a
core which others have make it three times as long.
"""

from __future__ import annotations

import os
from typing import Final

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is loaded

import fraclink as fl

SEEDS: Final = 20
RIG: Final = fl.Rig.named("paper-2023-geared")


def shown(made: fl.ShapedMove) -> None:
    """Print every reference of a shaped move."""
    for each in made.measured:
        print(
            f"  {each.name:45} promised {each.predicted:.3f} s, settles in {each.settling_time:.3f} s, "
            f"{1e3 * each.residual_vibration:4.1f} mrad, {each.peak_voltage:5.2f} V, "
            f"found in {each.computing_time:.2f} s",
            flush=True,
        )


def judged(name: str, value: float, unit: str, wanted: float) -> bool:
    """Print one figure with what is wanted."""
    passed = value <= wanted
    print(
        f"{'ok' if passed else 'MISS':5}{name:50}{value:.3g} {unit}   wanted <= {wanted:g} {unit}",
        flush=True,
    )
    return passed


def main() -> int:
    assert RIG.model is not None
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.02}
    design = fl.design(RIG.model, RIG, payloads=(0.020, 0.040), **request).with_law()
    given = {"gauge_offset": 0.05, "seeds": SEEDS}
    print("20 to 40 g, payload not given, 8 V")
    unknown = fl.shape(design, 1.0, voltage=8.0, **given)
    shown(unknown)
    known = []
    for payload in (0.020, 0.030, 0.040):
        print(f"{1e3 * payload:.0f} g, payload given, 10 V")
        known.append(
            fl.shape(design, 1.0, payloads=(payload, payload), told=True, **given)
        )
        shown(known[-1])
    print("20 to 40 g, each given its own, one reference, 10 V")
    shown(fl.shape(design, 1.0, told=True, **given))
    print("8 to 80 g, each given its own, one reference, 10 V")
    shown(fl.shape(design, 1.0, payloads=(0.008, 0.080), told=True, **given))
    passed = [
        judged(
            "unknown 20 to 40 g, one reference: settling",
            unknown.settling_time,
            "s",
            0.62,
        ),
        judged("its largest voltage", unknown.shaped.peak_voltage, "V", 8.0),
        judged("its computing time", unknown.shaped.computing_time, "s", 2.0),
        judged(
            "known payload, 10 V: settling",
            max(each.settling_time for each in known),
            "s",
            0.35,
        ),
    ]
    return 0 if all(passed) else 1


if __name__ == "__main__":
    raise SystemExit(main())
