"""Any fractional structure: ten documented examples with noise and no start value, next
to difference schemes.

A parameter is recovered where it is within 1 % of the truth or the truth lies in its 95
% interval. A source stands for the function; where it leaves parameters free, their
values are chosen here.

The peer is what FOMCON does: least squares on the Grünwald–Letnikov scheme with full
memory, here the compiled one of this package, begun 20 % off the truth (it has no start
of its own), with the same parameters. Its error is of first order in the step, so two
figures are printed: its time on the same samples, whatever its answer is worth; and its
time where every sample of a shorter recording is split into eight steps, which brings
it nearer to the truth. It knows neither a delay nor an improper function: those two
examples have no such column. Seconds are processor time of one thread, so that other
work on the machine does not count.

`--samples N` is the length of the recordings, `--seeds S` draws S noises for every
example, `--examples K` runs the first K of the ten, `--starts N` compares, for N noises
of every example, where a fit ends with where a fit begun at the truth ends.
"""

from __future__ import annotations

import os

# before numpy is loaded: both sides use one core, whatever else runs
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import time
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

import fraclink as fl
import fracsys
from fraclink._identify.expression import parse_expression
from grunwald import grunwald_letnikov
from harness import line, sizes

SPLIT = 8  # steps per sample
# relative to the output's standard deviation; for a frequency response to each line
NOISE = 0.02


@dataclass(frozen=True)
class Example:
    """A function from the literature, the structure that is given, and how it is
    excited.
    """

    source: str
    expression: str
    truth: dict[str, float]
    period: float  # [s]; 0: a frequency response
    # [s] of the random binary input; or the lowest frequency [rad/s] of the response
    bit: float = 0.0
    noise: float = NOISE
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)


TWO_TERMS = "1/(a2*s**n2 + a1*s**n1 + a0)"
EXAMPLES = (
    Example(
        "Podlubny, IEEE TAC 44 (1999) 208; shipped with FOMCON",
        TWO_TERMS,
        {"a2": 0.8, "n2": 2.2, "a1": 0.5, "n1": 0.9, "a0": 1.0},
        0.01,
        0.8,
    ),
    Example(
        "heating furnace, Podlubny, Dorčák, Koštial (1997); shipped with FOMCON",
        TWO_TERMS,
        {"a2": 14994.0, "n2": 1.31, "a1": 6009.5, "n1": 0.97, "a0": 1.69},
        0.25,
        20.0,
    ),
    Example(
        "shipped with FOMCON (pyfomcon's test), orders given",
        "(b1*s**0.63 + b0)/(a4*s**3.501 + a3*s**2.42 + a2*s**1.798 + a1*s**1.31 + 1.5)",
        {"b1": -2.0, "b0": 4.0, "a4": 2.0, "a3": 3.8, "a2": 2.6, "a1": 2.5},
        0.02,
        1.6,
        bounds={"b1": (-100.0, 100.0)},
    ),
    Example(
        "Xue and Chen (2007), orders given",
        "(b1*s**0.6 + b0)/(s**3.3 + a3*s**2.6 + a2*s**1.9 + a1*s**1.4 + a0)",
        {"b1": 5.0, "b0": 2.0, "a3": 3.1, "a2": 2.89, "a1": 2.5, "a0": 1.2},
        0.02,
        1.6,
    ),
    Example(
        "flexible link, Benftima et al. (2023), shared order, delayed",
        "k*s**a/(s**a + w)*exp(-T*s)",
        {"k": 1.56, "a": 1.92, "w": 10.02**2, "T": 0.0123},
        0.004,
        0.24,
    ),
    Example(
        "immersed plate of Bagley and Torvik; Podlubny (1999), section 8.3",
        "1/(A*s**2 + B*s**b + C)",
        {"A": 1.0, "B": 0.5, "b": 1.5, "C": 0.5},
        0.02,
        1.6,
    ),
    Example(
        "fractional oscillator, Gorenflo and Mainardi (1997)",
        "k/(s**a + w)",
        {"k": 1.0, "a": 1.5, "w": 1.0},
        0.02,
        1.6,
    ),
    Example(
        "Basset's problem, Gorenflo and Mainardi (1997)",
        "1/(a1*s + b*s**n + a0)",
        {"a1": 1.0, "b": 1.0, "n": 0.5, "a0": 1.0},
        0.01,
        0.4,
    ),
    Example(
        "relaxation of Cole and Cole, J. Chem. Phys. 9 (1941) 341",
        "k/((T*s)**a + 1)",
        {"k": 2.0, "T": 3.0, "a": 0.7},
        0.02,
        2.0,
    ),
    Example(
        "PD^μ controller, Podlubny, IEEE TAC 44 (1999) 208; improper: 120 lines of a frequency response",
        "K + D*s**m",
        {"K": 20.5, "D": 3.7343, "m": 1.15},
        0.0,
        0.1,
    ),
)


# More noise than a recording should have, with known orders.
NOISY = Example(
    "time-domain demo of the CRONE toolbox, orders given",
    "b/(a*s**3 + c*s**1.5 + 1)",
    {"b": 1.0, "a": 1.0, "c": 1.5},
    0.05,
    0.75,
    noise=0.6,
)


def binary(rng: np.random.Generator, samples: int, hold: int) -> np.ndarray:
    return np.repeat(rng.choice([-1.0, 1.0], samples // hold + 1), hold)[:samples]


def measured(
    example: Example, samples: int, seed: int
) -> fl.extend.Recording | fl.FrequencyResponse:
    """What a laboratory would have: the exact response with noise."""
    rng = np.random.default_rng(seed)
    G = parse_expression(example.expression).function(example.truth)
    if example.period == 0.0:
        w = np.geomspace(example.bit, 1000 * example.bit, 120)
        noise = rng.standard_normal((2, w.size))
        return fl.FrequencyResponse(
            w, G(1j * w) * (1 + example.noise * (noise[0] + 1j * noise[1]) / np.sqrt(2))
        )
    u = binary(rng, samples, round(example.bit / example.period))
    y = fracsys.time_response(G, u, example.period).output
    return fl.extend.Recording(
        example.period, u, y + example.noise * y.std() * rng.standard_normal(samples)
    )


def difference_fit(
    example: Example, record: fl.extend.Recording, split: int = 1
) -> tuple[float, float, int]:
    """Seconds, worst relative error and simulations of a Grünwald–Letnikov fit, begun
    20 % off.
    """
    structure = parse_expression(example.expression)
    names = list(example.truth)
    truth = np.array([example.truth[name] for name in names])
    begin = 1 + 0.2 * np.random.default_rng(1).choice([-1.0, 1.0], truth.size)
    finer, count = np.repeat(record.input, split), 0

    def residual(x: np.ndarray) -> np.ndarray:
        nonlocal count
        count += 1
        G = structure.function(dict(zip(names, (x * truth).tolist(), strict=True)))
        output = grunwald_letnikov(G, finer, record.period / split)
        # A held input jumps after its sample, the scheme's input at the sample: the
        # sample before the jump is compared.
        return np.asarray(output[split - 1 :: split][:-1] - record.output[1:])

    start = time.process_time()
    found = least_squares(
        residual, begin, x_scale="jac", ftol=1e-8, xtol=1e-8, max_nfev=40
    )
    return time.process_time() - start, float(np.max(np.abs(found.x - 1))), count


def seconds_of(
    example: Example, data: fl.extend.Recording | fl.FrequencyResponse, *, details: bool
) -> tuple[float, fl.extend.StructureFit]:
    # a response has no part to hold out
    heldout = 0.0 if isinstance(data, fl.extend.Recording) else None
    start = time.process_time()
    fit = fl.identify_structure(
        data,
        example.expression,
        bounds=example.bounds,
        heldout=heldout,
        details=details,
    )
    return time.process_time() - start, fit


def recovered(example: Example, samples: int, seeds: int) -> tuple[bool, float]:
    """Whether all parameters of all seeds are recovered, and the seconds without
    profile intervals.
    """
    good, worst, known, spent, whole = True, 0.0, True, [], []
    for seed in range(seeds):
        data = measured(example, samples, seed)
        spent.append(seconds_of(example, data, details=False)[0])
        seconds, fit = seconds_of(example, data, details=True)
        whole.append(seconds)
        known = known and fit.passed
        for name, value in example.truth.items():
            error = abs(fit.parameters[name] / value - 1)
            interval = fit.intervals.get(name)
            worst = max(worst, error)
            if error > 0.01 and not (interval is not None and interval.contains(value)):
                good = False
                print(
                    f"     {name}: {fit.parameters[name]:.6g} for {value:g}, seed {seed}, {interval}"
                )
    told = "all determined" if known else "some not determined"
    print(f"{'ok  ' if good else 'MISS'} {example.source}: {example.expression}")
    times = f"{np.median(spent):.3f} s, {np.median(whole):.2f} s with profiles"
    print(f"     worst error {100 * worst:.2g} %, {told}; {times}")
    return good, float(np.median(spent))


def peers(example: Example, samples: int, seconds: float) -> tuple[float, float]:
    """How much longer the difference scheme takes: on the same samples, and split into
    eight steps each.
    """
    took, error, count = difference_fit(example, measured(example, samples, 0))
    told = f"error {100 * error:.2g} %, ratio {took / seconds:.0f}"
    print(f"     differences: {took:.1f} s, {count} simulations, {told}")
    short = measured(example, samples // SPLIT, 0)
    own, fit = seconds_of(example, short, details=False)
    split, error, count = difference_fit(example, short, SPLIT)
    ours = max(
        abs(fit.parameters[name] / value - 1) for name, value in example.truth.items()
    )
    print(
        f"     N = {samples // SPLIT}: {own:.3f} s, error {100 * ours:.2g} %; each step split into {SPLIT}:"
    )
    told = f"error {100 * error:.2g} %, ratio {split / own:.0f}"
    print(f"     differences: {split:.1f} s, {count} simulations, {told}", flush=True)
    return took / seconds, split / own


def at_the_optimum(example: Example, samples: int, count: int) -> int:
    """Of so many noises, how often a fit without a start ends as low as one that is
    begun at the truth.
    """
    good = 0
    for seed in range(count):
        data = measured(example, samples, seed)
        costs = [
            fl.identify_structure(
                data,
                example.expression,
                bounds=example.bounds,
                start=start,
                details=False,
            ).nmse
            for start in (None, example.truth)
        ]
        good += costs[0] <= costs[1] * (1 + 1e-4)
    return good


def main() -> None:
    given = sizes(
        __doc__,
        samples=(20_000, 400),
        seeds=(3, 1),
        examples=(10, 1),
        peers=(1, 0),
        starts=(20, 1),
    )
    good, ratios = 0, []
    chosen = EXAMPLES[6:7] if given.short else EXAMPLES[: given.examples]
    for example in chosen:
        found, seconds = recovered(example, given.samples, given.seeds)
        good += found
        if given.peers and example.period and "exp" not in example.expression:
            ratios.append(peers(example, given.samples, seconds))
    line(
        "examples recovered, no start value",
        f"{good} of {len(chosen)}",
        "all",
        good == len(chosen),
    )
    names = (
        f"N = {given.samples}",
        f"N = {given.samples // SPLIT}, each step split into {SPLIT}",
    )
    for name, column in zip(names, np.array(ratios).reshape(-1, 2).T, strict=True):
        if not column.size:
            continue
        value = float(np.median(column))
        spread = f"{value:.0f} × ({min(column):.0f} to {max(column):.0f})"
        line(f"Grünwald–Letnikov fit, {name}", spread, ">= 100 ×", value >= 100)
    for example in (*chosen, NOISY):
        found = at_the_optimum(example, 1600, given.starts)
        line(
            f"no start, at the optimum: {example.expression[:40]}",
            f"{found} of {given.starts}",
            ">= 95 %",
            found >= 0.95 * given.starts,
        )


if __name__ == "__main__":
    main()
