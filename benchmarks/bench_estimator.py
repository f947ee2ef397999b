"""The payload estimated during a run: its values and times, the effect on moves,
contacts.

Twin of the geared rig: link 7.35 g, friction, 0.05 N·m gauge offset, 10 mN·m noise; 1
rad in 0.5 s; law for 20 to 40 g. Figures are the worst of 20 seeds unless stated
otherwise.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import Final

import numpy as np
from numpy.typing import NDArray

import fraclink as fl
from fraclink import Design, Run, Twin, _kernels
from fraclink.extend import Obstacle, PayloadChange, PayloadEstimator, payload_estimator
from harness import line, sizes

PAYLOADS: Final = (0.008, 0.012, 0.016, 0.020, 0.030, 0.040, 0.060, 0.080)
RIG: Final = fl.Rig.named("paper-2023-geared")
MOVE: Final = fl.smooth_step(1.0, duration=0.5)
REST: Final = 3.0  # [s] between two moves
Real = NDArray[np.float64]


def designed() -> Design:
    assert RIG.model is not None
    request = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.02}
    return fl.design(RIG.model, RIG, payloads=(0.020, 0.040), **request)


def on_twin(
    design: Design,
    payload: float,
    told: object,
    seed: int,
    *,
    gauge_gain: float = 1.0,
    **options: object,
) -> Run:
    arm = replace(Twin.from_rig(RIG, payload=payload), gauge_gain=gauge_gain)
    given = {"gauge_offset": 0.05, "duration": 3.0} | options
    return fl.simulate(design, MOVE, arm=arm, seed=seed, told=told, **given)  # type: ignore[arg-type]


def found_at(run: Run, payload: float) -> float:
    """Time [s] from which on the estimate is within 10 %."""
    off = np.flatnonzero(np.abs(run.extras["payload_estimate"] / payload - 1) > 0.1)
    return float(run.time[min(off[-1] + 1, len(run.time) - 1)])


def first_moves(
    design: Design, bank: PayloadEstimator, payloads: tuple[float, ...], seeds: int
) -> None:
    print(
        "first move: settling not told, told, estimated; within 10 % after; error at the end; 95 % covers"
    )
    covered = []
    for payload in payloads:
        runs = [on_twin(design, payload, bank, seed) for seed in range(seeds)]
        settled = [
            max(
                on_twin(design, payload, told, seed).metrics.settling_time
                for seed in range(seeds)
            )
            for told in (False, True)
        ]
        settled.append(max(run.metrics.settling_time for run in runs))
        when = max(found_at(run, payload) for run in runs)
        error = max(
            abs(float(run.extras["payload_estimate"][-1]) / payload - 1) for run in runs
        )
        inside = np.concatenate([covers(run, payload) for run in runs])
        covered.append(inside.mean())
        print(
            f"  {1e3 * payload:2.0f} g  "
            f"{settled[0]:.2f} s, {settled[1]:.2f} s, {settled[2]:.2f} s;  {1e3 * when:3.0f} ms;  "
            f"{100 * error:.1f} %;  {100 * inside.mean():.1f} %",
            flush=True,
        )
    share = 100 * float(np.mean(covered))
    line("95 % interval, periods covered", f"{share:.1f} %", ">= 95 %", share >= 95)


def covers(run: Run, payload: float) -> NDArray[np.bool_]:
    """Whether the interval holds the payload, in every period with an estimate for the
    law.
    """
    x = run.extras
    shown = x["payload_given"] > 0
    return np.asarray((x["payload_low"] <= payload) & (payload <= x["payload_high"]))[
        shown
    ]


def intervals(design: Design, payloads: tuple[float, ...], seeds: int) -> None:
    """How often the 95 % interval holds the payload at three instants of a first move,
    with gains of the gauge that are off by 3 % (one standard deviation).
    """
    assert RIG.model is not None
    bank = payload_estimator(RIG.model, RIG, design.law(), design.payloads)
    random = np.random.default_rng(39)
    runs = []
    for payload in payloads:
        for seed in range(seeds):
            gain = float(random.normal(1.0, 0.03))
            # until the last of the three instants
            run = on_twin(design, payload, bank, seed, gauge_gain=gain, duration=1.6)
            runs.append((run, payload))
    for instant in (0.3, 0.6, 1.5):
        row = round(instant / RIG.period)
        held = [
            run.extras["payload_low"][row] <= payload <= run.extras["payload_high"][row]
            for run, payload in runs
        ]
        share = 100.0 * float(np.mean(held))
        line(
            f"95 % interval at {instant:g} s, gauge gain known to 3 %",
            f"{sum(held)} of {len(held)}",
            "93 to 97 %",
            93.0 <= share <= 97.0,
        )


def settling(run: Run, start: float, target: float) -> float:
    """Time [s] from `start` after which the tip stays within 2 % of `target` until the
    next move.
    """
    part = (run.time >= start - 1e-9) & (run.time < start + REST + 0.5 - 1e-9)
    off = np.flatnonzero(np.abs(run.tip_angle[part] - target) > 0.02)
    return 0.004 * (off[-1] + 1) if off.size else 0.0


def changes(
    design: Design, bank: PayloadEstimator, payloads: tuple[float, ...], seeds: int
) -> None:
    """Two moves, another payload while the arm stands, three more: every pair of the
    eight payloads.
    """
    path = MOVE
    for i in range(1, 5):
        path = path.then(fl.smooth_step((-1.0) ** i, 0.5, REST))
    starts = [i * (REST + 0.5) for i in range(5)]
    print(
        f"payload changed at rest, all {len(payloads) * (len(payloads) - 1)} pairs, {seeds} seeds each"
    )
    worst: dict[tuple[float, float], Real] = {}
    for before, after in permutations(payloads, 2):
        event = PayloadChange(starts[2] - 0.3, after)
        arm = Twin.from_rig(RIG, payload=before)
        times = []
        for seed in range(seeds):
            run = fl.simulate(
                design,
                path,
                arm=arm,
                gauge_offset=0.05,
                seed=seed,
                told=bank,
                events=[event],
                duration=17.4,
            )
            times.append(
                [settling(run, at, 1.0 - i % 2) for i, at in enumerate(starts)]
            )
        worst[before, after] = np.max(times, axis=0)
    table = np.array(list(worst.values()))
    names = (
        "first of all",
        "second",
        "with the surprise",
        "second after it",
        "third after it",
    )
    for name, times in zip(names, table.T, strict=True):
        pair = list(worst)[int(np.argmax(times))]
        print(
            f"  {name:18}: {times.max():.2f} s, {1e3 * pair[0]:.0f} to {1e3 * pair[1]:.0f} g",
            flush=True,
        )


def contacts(
    design: Design, bank: PayloadEstimator, payloads: tuple[float, ...], seeds: int
) -> None:
    """A stop of 2 kN/m in the way at 0.3, 0.6 and 0.9 rad; healthy moves of 0.4, 0.5
    and 1 s.
    """
    seconds, missed, false = [], 0, 0
    for payload, angle in ((p, a) for p in payloads for a in (0.3, 0.6, 0.9)):
        run = on_twin(
            design,
            payload,
            bank,
            0,
            events=[Obstacle(0.0, 9.0, angle=angle, stiffness=2000.0)],
        )
        touched = run.time[np.argmax(np.abs(run.extras["contact_force"]) > 0)]
        flagged = run.time[flags(run, _kernels.PAYLOAD_CONTACT)]
        missed += flagged.size == 0
        seconds += list(flagged[:1] - touched)
    for payload, time in ((p, t) for p in payloads for t in (0.4, 0.5, 1.0)):
        arm = Twin.from_rig(RIG, payload=payload)
        for seed in range(min(seeds, 5)):
            run = fl.simulate(
                design,
                fl.smooth_step(1.0, time),
                arm=arm,
                gauge_offset=0.05,
                seed=seed,
                told=bank,
                duration=3.0,
            )
            false += bool(flags(run, _kernels.PAYLOAD_CONTACT).any())
    line(
        "contact: time from the touch to the flag, median",
        f"{1e3 * np.median(seconds):.0f} ms, {missed} of {3 * len(payloads)} missed",
        "printed",
        note=f"{1e3 * min(seconds):.0f} to {1e3 * max(seconds):.0f} ms",
    )
    line("healthy moves flagged as contact", str(false), "0", false == 0)


def flags(run: Run, bit: int) -> NDArray[np.bool_]:
    return np.asarray(run.extras["payload_flags"].astype(int) & bit != 0)


def main() -> None:
    given = sizes(__doc__, seeds=(20, 1), payloads=(len(PAYLOADS), 2))
    design, payloads = designed(), PAYLOADS[: given.payloads]
    bank = design.estimator()
    # a share of 95 % of 160 moves would be uncertain by 1.7 %
    intervals(design, payloads, 5 * given.seeds)
    for figures in (first_moves, contacts, changes):
        figures(design, bank, payloads, given.seeds)


if __name__ == "__main__":
    main()
