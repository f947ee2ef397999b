"""All figures of the time responses, measured next to their goals.

R is one `scipy.fft.rfft` of length 2N in the same run; timings are medians of
interleaved calls in CPU time (everything here runs on one thread; a busy machine's
other work does not count), next to half their interquartile range. Errors are relative
to the peak of the signal.
"""

from __future__ import annotations

import json
import resource
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.fft import rfft

from fracsys import (
    DiscreteModes,
    FractionalTransferFunction,
    discrete_modes,
    s,
    step_response,
    time_response,
)
from fracsys._response import held_quotient
from grunwald import grunwald_letnikov
from harness import interleaved, line, median, sizes

PERIOD = 0.004
REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / "step_responses.json"
LINK = 10.02**2 / (s**1.92 + 10.02**2)


def transfer(case: list[str]) -> FractionalTransferFunction:
    if len(case) == 2:
        order, frequency = map(float, case)
        return frequency**2 / (s**order + frequency**2)
    order, damping, damping_order, frequency = map(float, case)
    return frequency**2 / (s**order + damping * s**damping_order + frequency**2)


def accuracy() -> None:
    """Step responses over 100 s at 4 ms, from the recursion that simulates, against
    40-digit values.
    """
    by_case: dict[tuple[str, ...], list[tuple[int, float]]] = {}
    for entry in json.loads(REFERENCE.read_text(encoding="utf-8"))["values"]:
        index = round(float(entry["time"]) / PERIOD)
        by_case.setdefault(tuple(entry["case"]), []).append(
            (index, float.fromhex(entry["hex"]))
        )
    u, worst = np.ones(25_001), {"UD-FOM": 0.0, "D-FOM": 0.0}
    for case, values in by_case.items():
        output = time_response(transfer(list(case)), u, PERIOD).output
        peak = float(np.max(np.abs(output)))
        error = max(abs(output[index] - value) for index, value in values) / peak
        name = "UD-FOM" if len(case) == 2 else "D-FOM"
        worst[name] = max(worst[name], error)
    for name, error in worst.items():
        count = sum((len(case) == 2) == (name == "UD-FOM") for case in by_case)
        line(
            f"{name}, {count} systems, λ 1.01 … 2, 100 s at 4 ms",
            f"error {error:.1e}",
            "<= 1e-10",
            error <= 1e-10,
        )


def cost(samples: int, rounds: int) -> None:
    generator = np.random.default_rng(0)
    signal, u = (
        generator.standard_normal(2 * samples),
        generator.standard_normal(samples),
    )
    modes = discrete_modes(LINK, PERIOD, span=samples * PERIOD, tolerance=1e-11)
    fine = discrete_modes(LINK, PERIOD, span=samples * PERIOD)
    calls: dict[str, Callable[[], object]] = {
        "R": lambda: rfft(signal),
        "modes": lambda: modes.respond(u),
        "fine": lambda: fine.respond(u),
        "all": lambda: time_response(LINK, u, PERIOD),
    }
    spent = interleaved(calls, rounds)
    error = _step_error(modes, samples)
    for name, title in (
        (
            "modes",
            f"recursion, N = {samples:.0e}, {modes.count} states, step error {error:.0e}",
        ),
        (
            "fine",
            f"recursion, N = {samples:.0e}, {fine.count} states, step error {_step_error(fine, samples):.0e}",
        ),
        (
            "all",
            f"time_response, N = {samples:.0e}, set-up, checks and copies included",
        ),
    ):
        value, spread = median(spent[name] / spent["R"])
        line(title, f"{value:.2f} ± {spread:.2f} R", "<= 0.35 R", value <= 0.35)


def _step_error(modes: DiscreteModes, samples: int) -> float:
    """Error of the recursion's step response at 12 times, compared with one contour
    integral each.
    """
    index = np.unique(np.geomspace(1, samples - 1, 12).astype(int))
    output = modes.respond(np.ones(samples))
    exact = np.array([step_response(LINK, [k * PERIOD]).output[0] for k in index])
    return float(np.max(np.abs(output[index] - exact)) / np.max(np.abs(output)))


def linearity(decades: int) -> None:
    """CPU time per sample and state, beyond that of 16 samples (tables and call)."""
    spent = []
    for size in [10**k for k in range(3, 3 + decades)]:
        u = np.random.default_rng(1).standard_normal(size)
        modes = discrete_modes(LINK, PERIOD, span=size * PERIOD)
        calls: dict[str, Callable[[], object]] = {
            "y": lambda u=u, modes=modes: modes.respond(u),
            "start": lambda u=u[:16], modes=modes: modes.respond(u),
        }
        times = interleaved(calls, 5 if size > 1e6 else 25)
        beyond = float(np.median(times["y"]) - np.median(times["start"]))
        spent.append(beyond / (size - 16) * 1e9 / modes.count)
    text = ", ".join(f"{value:.2f}" for value in spent)
    line(
        "ns per sample and state at N = 1e3, 1e4 …",
        text,
        "flat within 2",
        max(spent) <= 2 * min(spent),
    )


def against_full_memory(samples: int) -> None:
    u = np.sign(np.sin(0.3 * np.arange(samples) * PERIOD))
    exact = time_response(LINK, u, PERIOD).output
    begin = time.thread_time()
    full = grunwald_letnikov(LINK, u, PERIOD)
    long = time.thread_time() - begin
    short = float(
        np.median(interleaved({"y": lambda: time_response(LINK, u, PERIOD)}, 15)["y"])
    )
    error = float(np.max(np.abs(full - exact)) / np.max(np.abs(exact)))
    ours = _square_wave_error(exact, samples)
    line(
        f"against Grünwald-Letnikov O(N²) by SciPy's lfilter, N = {samples:.0e}",
        f"{long / short:.0f} x faster",
        ">= 1000",
        long >= 1e3 * short,
    )
    line(
        "the same, error",
        f"{error:.1e} / {ours:.1e} = {error / ours:.1e}",
        ">= 1e8",
        error >= 1e8 * ours,
    )


def full_memory_errors() -> None:
    """The errors of Grünwald-Letnikov on this link at 4 ms that the docs state."""
    generator = np.random.default_rng(0)
    inputs = {
        "step": np.ones(5000),
        "random binary": np.repeat(generator.choice([-1.0, 1.0], 200), 25),
    }
    for name, u in inputs.items():
        exact = time_response(LINK, u, PERIOD).output
        error = np.max(np.abs(grunwald_letnikov(LINK, u, PERIOD) - exact)) / np.max(
            np.abs(exact)
        )
        line(
            f"Grünwald-Letnikov at 4 ms, 20 s, {name}",
            f"{error:.1%} of full scale",
            "(for the docs)",
            True,
        )


def _square_wave_error(output: np.ndarray, samples: int) -> float:
    """Error at 20 samples compared with the sum of the step responses to the jumps,
    each from a contour integral.
    """
    u = np.sign(np.sin(0.3 * np.arange(samples) * PERIOD))
    jumps = np.flatnonzero(np.diff(u, prepend=0.0))
    gaps = []
    for k in np.linspace(100, samples - 1, 20).astype(int):
        past = jumps[jumps < k]
        steps = step_response(LINK, (k - past) * PERIOD).output
        gaps.append(abs(output[k] - float(np.diff(u, prepend=0.0)[past] @ steps)))
    return max(gaps) / float(np.max(np.abs(output)))


def against_oustaloup(rounds: int) -> None:
    import control

    samples = 5000
    u = np.sign(np.sin(0.3 * np.arange(samples) * PERIOD))
    exact = time_response(LINK, u, PERIOD).output

    def system() -> control.StateSpace:
        """ω₀²/s^1.92 as ω₀²/s · (s^-0.92 by Oustaloup, 1e-3 … 1e5 rad/s) in modal form,
        closed, sampled.

        In modal form, because as a transfer function of order 16 its coefficients span
        40 decades.
        """
        low, high, order = 1e-3, 1e5, -0.92
        index = (np.arange(15)[:, None] + 0.5 * (1 + np.array([[-order, order]]))) / 15
        zeros, poles = (-low * (high / low) ** index).T
        residues = [
            high**order * np.prod(p - zeros) / np.prod(p - np.delete(poles, k))
            for k, p in enumerate(poles)
        ]
        power = control.ss(
            np.diag(poles), np.ones((15, 1)), np.array([residues]), [[high**order]]
        )
        integrator = control.ss([[0.0]], [[1.0]], [[10.02**2]], [[0.0]])
        return control.sample_system(
            control.feedback(power * integrator), PERIOD, method="zoh"
        )

    sampled, times = system(), np.arange(samples) * PERIOD
    modes = discrete_modes(LINK, PERIOD, span=samples * PERIOD)
    theirs = control.forced_response(sampled, times, u).outputs
    calls: dict[str, Callable[[], object]] = {
        "theirs": lambda: control.forced_response(sampled, times, u),
        "ours": lambda: modes.respond(u),
        "their all": lambda: control.forced_response(system(), times, u),
        "our all": lambda: (
            held_quotient.cache_clear(),
            time_response(LINK, u, PERIOD),
        ),
        "our next": lambda: time_response(LINK, u, PERIOD),
    }
    spent = interleaved(calls, rounds)
    for name, base, title in (
        ("theirs", "ours", "recursion alone"),
        ("their all", "our all", "with set-up"),
        ("their all", "our next", "with set-up, our poles known"),
    ):
        value, spread = median(spent[name] / spent[base])
        line(
            f"against python-control with Oustaloup, N = 5000, {title}",
            f"{value:.0f} ± {spread:.0f} x faster",
            ">= 20",
            value >= 20,
        )
    error = float(np.max(np.abs(theirs - exact)) / np.max(np.abs(exact)))
    ours = _square_wave_error(exact, samples)
    line(
        "the same, error",
        f"{error:.1e} / {ours:.1e} = {error / ours:.1e}",
        ">= 1e6",
        error >= 1e6 * ours,
    )


def memory(samples: int) -> None:
    u = np.zeros(samples)
    modes = discrete_modes(LINK, PERIOD, span=samples * PERIOD)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tracemalloc.start()
    modes.respond(u)
    python = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    line(
        f"memory of the recursion, N = {samples:.0e}, {modes.count} states",
        f"{max(grown, python) / samples:.1f} B a sample",
        "<= 8.5 (the output)",
        grown <= 8.5 * samples,
    )


def main() -> None:
    given = sizes(
        __doc__,
        samples=(1_000_000, 10_000),
        memory=(100_000, 5000),
        rounds=(15, 1),
        decades=(5, 2),
    )
    memory(10 * given.samples)  # first, because a later peak would mask it
    accuracy()
    cost(given.samples, given.rounds)
    linearity(given.decades)
    against_full_memory(given.memory)
    full_memory_errors()
    against_oustaloup(given.rounds)


if __name__ == "__main__":
    main()
