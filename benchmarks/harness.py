"""Shared by all benchmarks: printing of figures, timing of calls, and the sizes of the
two forms.

The short form (`--short`) uses the smallest sizes with which every line of a benchmark
still runs; its times are meaningless.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np


def line(
    figure: str, measured: str, wanted: str, holds: bool | None = None, note: str = ""
) -> None:
    """Print one figure; without `holds` it is not judged."""
    mark = "    " if holds is None else "ok  " if holds else "MISS"
    told = f"  ({note})" if note else ""
    print(f"{mark} {figure:<66} {measured:<34} wanted {wanted}{told}", flush=True)


def sizes(doc: str | None, **both: tuple[int, int]) -> argparse.Namespace:
    """The sizes of this run: each is given by its option, or is the first (full form)
    or second (short form) of its two values.
    """
    parser = argparse.ArgumentParser(description=(doc or "").split("\n\n")[0])
    parser.add_argument("--short", action="store_true", help="the smallest sizes")
    for name, (full, short) in both.items():
        note = f"{full}; {short} in the short form"
        parser.add_argument(f"--{name}", type=int, help=note)
    given = parser.parse_args()
    for name, values in both.items():
        if getattr(given, name) is None:
            setattr(given, name, values[given.short])
    return given


def interleaved(
    calls: dict[str, Callable[[], object]], rounds: int
) -> dict[str, np.ndarray]:
    """Processor seconds of this thread for every call, taken in turns: other work on
    the machine does not count.
    """
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            begin = time.thread_time()
            call()
            spent[name].append(time.thread_time() - begin)
    return {name: np.array(values) for name, values in spent.items()}


def median(values: np.ndarray) -> tuple[float, float]:
    """Median and half the interquartile range."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return float(middle), float(high - low) / 2


def timed(figure: str, call: Callable[[], object], rounds: int, limit: float) -> None:
    """Print the median processor time of a call [ms] next to its limit [s]."""
    times = interleaved({"call": call}, rounds)["call"]
    value, spread = median(times)
    shown = f"{1e3 * value:.3g} ± {1e3 * spread:.2g} ms"
    line(figure, shown, f"<= {1e3 * limit:g} ms", value <= limit)
