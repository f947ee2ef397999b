"""Moves on the twin: with the payload given to the law and not, and shaped moves.

Twin of the geared rig: link 7.35 g, friction, 0.05 N·m gauge offset, 10 mN·m noise; 1
rad; the worst of all seeds (and of nine payloads of a range). Settling counts from the
start of the move. Computing time is that of one thread: threads of OpenBLAS that wait for
a core which others have make it three times as long.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is loaded

import fraclink as fl
from harness import line, sizes

RIG = fl.Rig.named("paper-2023-geared")
PAYLOADS = (0.008, 0.012, 0.016, 0.020, 0.030, 0.040, 0.060, 0.080)


def given(design: fl.Design, seeds: int, payloads: int) -> None:
    """Settling and residual vibration of a move of 0.5 s: payload not given, given, 5 %
    off.
    """
    law, move = design.law(), fl.smooth_step(1.0, duration=0.5)
    for payload in PAYLOADS[:payloads]:
        words = []
        for factor in (0.0, 1.0, 0.95, 1.05):
            arm = fl.Twin.from_rig(RIG, payload=payload)
            told = factor * payload
            runs = [
                fl.simulate(law, move, arm=arm, gauge_offset=0.05, seed=k, told=told)
                for k in range(seeds)
            ]
            settling = max(run.metrics.settling_time for run in runs)
            rest = max(run.metrics.residual_vibration for run in runs)
            words.append(f"{settling:.2f} s {1e3 * rest:.0f} mrad")
        line(
            f"{1e3 * payload:g} g: not given, given, 5 % too little, 5 % too much",
            ", ".join(words),
            "printed",
        )


def shaped(design: fl.Design, seeds: int, everything: bool) -> None:
    """Shaped moves for 20 to 40 g, one for all and one for each."""
    options = {"gauge_offset": 0.05, "seeds": seeds}
    known = (0.020, 0.030, 0.040) if everything else ()
    one = fl.shape(design, 1.0, voltage=8.0, **options)
    each = [
        fl.shape(design, 1.0, payloads=(kg, kg), told=True, **options) for kg in known
    ]
    for made in (one, *each):
        for move in made.measured:
            print(
                f"  {move.name:45} promised {move.predicted:.3f} s, settles in "
                f"{move.settling_time:.3f} s, {1e3 * move.residual_vibration:4.1f} mrad, "
                f"{move.peak_voltage:5.2f} V, found in {move.computing_time:.2f} s"
            )
    longest = max((made.settling_time for made in each), default=0.0)
    for name, value, unit, wanted in (
        ("unknown 20 to 40 g: settling", one.settling_time, "s", 0.62),
        ("its largest voltage", one.shaped.peak_voltage, "V", 8.0),
        ("its computing time", one.shaped.computing_time, "s", 2.0),
        ("known payload, 10 V: settling", longest, "s", 0.35),
    ):
        line(name, f"{value:.3g} {unit}", f"<= {wanted:g} {unit}", value <= wanted)


def main() -> None:
    sized = sizes(__doc__, seeds=(20, 1), payloads=(len(PAYLOADS), 1))
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.02}
    design = fl.design(RIG.model, RIG, payloads=(0.020, 0.040), **request)
    given(design, sized.seeds, sized.payloads)
    shaped(design, sized.seeds, not sized.short)


if __name__ == "__main__":
    main()
