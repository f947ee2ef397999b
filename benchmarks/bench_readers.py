"""Readers and diagnosis: cost against numpy's parser, and what faults of the time base
do to a fit.

Timings are ratios against a peer in the same run, interleaved; the faults are what the
limits of `fraclink._arm.timebase` stand on: jitter is harmless, lost samples taken as
uniform are not.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._arm.reference import prbs
from fraclink._arm.timebase import resampled, time_base
from fraclink._identify import identify, simulated_torque
from fraclink._logs import bundled_log, diagnose, read_columns, read_log

PERIOD = 0.004


def seconds(*jobs: Callable[[], object], rounds: int = 5) -> list[float]:
    """Median time of each job, all of them interleaved."""
    taken: list[list[float]] = [[] for _ in jobs]
    for _ in range(rounds):
        for place, job in enumerate(jobs):
            started = time.perf_counter()
            job()
            taken[place].append(time.perf_counter() - started)
    return [statistics.median(times) for times in taken]


def line(
    figure: str, measured: float, unit: str, limit: float | None, error: str = ""
) -> bool:
    """Print one figure; return whether it keeps its limit."""
    holds = limit is None or abs(measured) <= limit
    wanted = "" if limit is None else f"wanted <= {limit:g} {unit}"
    print(
        f"{'ok  ' if holds else 'MISS'} {figure:<62} {measured:+9.3f} {unit:<3} {wanted:<20} {error}",
        flush=True,
    )
    return holds


def costs(folder: Path) -> None:
    """Cost of reading 150 000 rows of four columns, and of a diagnosis."""
    from scipy.io import savemat

    rng = np.random.default_rng(0)
    table = np.column_stack(
        (1e-3 * np.arange(150_000), rng.standard_normal((150_000, 3)))
    )
    text, mat = folder / "a.csv", folder / "a.mat"
    np.savetxt(text, table, delimiter=",", header="a,b,c,d", comments="", fmt="%.17g")
    savemat(mat, {"a": table})
    peer, ours, child = seconds(
        lambda: np.loadtxt(text, delimiter=",", skiprows=1),
        lambda: read_columns(text),
        lambda: read_columns(mat),
    )
    same = float(np.abs(read_columns(text)["b"] - table[:, 1]).max())
    line("CSV, 150 000 × 4, against np.loadtxt", ours / peer, "×", 3, f"error {same:g}")
    same = float(np.abs(read_columns(mat)["a(:,2)"] - table[:, 1]).max())
    line(
        "MAT, the same, child process included", child / peer, "×", 4, f"error {same:g}"
    )
    log = read_log(bundled_log("prbs_30g"))
    padded = np.random.default_rng(0).standard_normal(2 * log.output.size)
    peer, ours = seconds(
        lambda: [np.fft.rfft(padded) for _ in range(100)], lambda: diagnose(log)
    )
    line("diagnose, 5001 samples, against rfft of 2N", 100 * ours / peer, "×", 400)


def faults() -> None:
    """What jitter, lost samples and a late gauge do to ω₀, in percent."""
    count, rng = 5000, np.random.default_rng(6)
    # the truth is sampled four times as often as the log, so that stamps may lie
    # anywhere
    fine = 4
    model = LinkModel(stiffness=1.56, natural_frequency=10.31, order=1.92)
    reference = prbs(0.2, 0.1, bits=200, register=9)
    dense_time = PERIOD / fine * np.arange(fine * count)
    dense_angle = smooth(reference.angle(dense_time), PERIOD / fine)
    dense_torque = simulated_torque(model, dense_angle, PERIOD / fine)
    noise = rng.normal(0, 0.02, count)

    def sampled(stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.interp(stamps, dense_time, dense_angle), np.interp(
            stamps, dense_time, dense_torque
        ) + noise[: stamps.size]

    def frequency(angle: np.ndarray, torque: np.ndarray) -> float:
        return identify(
            Experiment(period=PERIOD, motor_angle=angle, output=torque), "UD-FOM"
        ).model.natural_frequency

    grid = PERIOD * np.arange(count)
    clean = frequency(*sampled(grid))
    jittered = np.clip(grid + rng.normal(0, 0.0005, count), 0, dense_time[-1])
    kept = np.sort(rng.permutation(count)[: count - count // 100])
    angle, torque = (values[kept] for values in sampled(grid))
    base = time_base(grid[kept], resample=True)
    bridged = (resampled(grid[kept], base, angle), resampled(grid[kept], base, torque))

    def shift(value: float) -> float:
        return 100 * (value / clean - 1)

    line(
        "jitter of 0.5 ms rms taken as uniform: shift of ω₀",
        shift(frequency(*sampled(jittered))),
        "%",
        0.05,
    )
    line(
        "1 % of samples lost, taken as uniform (refused): shift of ω₀",
        shift(frequency(angle, torque)),
        "%",
        None,
    )
    line(
        "the same, resampled on its stamps: shift of ω₀",
        shift(frequency(*bridged)),
        "%",
        0.05,
    )


def smooth(angle: np.ndarray, period: float) -> np.ndarray:
    """A servo with two poles at 80 rad/s."""
    decay = np.exp(-80 * period)
    result = np.zeros(angle.size)
    first = second = 0.0
    for k, wanted in enumerate(angle):
        result[k] = second
        second += (1 - decay) * (first - second)
        first += (1 - decay) * (wanted - first)
    return result


def main() -> None:
    """Print every figure."""
    with tempfile.TemporaryDirectory() as folder:
        costs(Path(folder))
    faults()


if __name__ == "__main__":
    main()
