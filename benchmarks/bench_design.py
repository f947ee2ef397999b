"""Design and certificates: margins against mpmath, and the time of every answer.

The sampled loop is computed independently in mpmath with 30 digits, with its aliases
summed one by one. Every timed request is a new one: a repeated one is answered from a
cache.
"""

from __future__ import annotations

import math
import tempfile
from functools import partial
from itertools import count
from pathlib import Path

import fraclink as fl
from bench_box import load_checker
from fraclink import certify
from fraclink.errors import InfeasibleError
from harness import line, sizes, timed

RIG = fl.Rig.named("paper-2023")
WANTED = {"payloads": (0.020, 0.040), "phase_margin": fl.deg(50)}


def independent_margin(design: fl.Design, payload: float, aliases: int) -> float:
    """Phase margin [deg] of the sampled loop with Ĉ(jω), aliases summed one by one."""
    from mpmath import mp

    mp.dps = 30
    period, pole, order = mp.mpf(RIG.period), mp.mpf(80), mp.mpf(design.model.order)
    spring = mp.mpf(design.natural_frequency(payload)) ** 2
    c = design.controller

    def loop(w: object) -> object:
        total = mp.mpc(0)
        for k in range(-aliases, aliases + 1):
            s = mp.mpc(0, w + 2 * mp.pi * k / period)
            total += spring / (s**order + spring) / (1 + s / pole) ** 2 / s
        x = mp.expj(-w * period)
        outer = (
            c.derivative_gain
            * mp.mpc(0, w) ** c.derivative_order
            / (1 + c.filter_time * mp.mpc(0, w)) ** c.filter_order
        )
        return outer * (1 - x) / period * x * total

    guess = design.at(payload).gain_crossover
    w = mp.findroot(lambda v: mp.log(abs(loop(v))), (guess, guess * 1.001))
    return float(mp.degrees(mp.arg(-loop(w))))


def margins(aliases: int) -> None:
    """The margins that a design states, against an independent computation."""
    # With M(s), which the independent computation uses: bench_box repeats it for the
    # loop with the PID that runs.
    options = {"gain_crossover": 12.0, "filter_time": 0.0, "motor_loop": "ideal"}
    design = fl.design(RIG.model, RIG, **WANTED, **options)
    for payload in WANTED["payloads"]:
        exact = independent_margin(design, payload, aliases)
        error = abs(math.degrees(design.at(payload).phase_margin) - exact)
        line(
            f"margin that the design states, {payload * 1e3:g} g, error",
            f"{error:.1e}°",
            "<= 0.01°",
            error <= 0.01,
        )


def speed(rounds: int) -> None:
    """A design, with its law and without; a refusal with what it offers."""
    step = count(1)

    def call(crossover: float = 12.0, **options: object) -> object:
        asked = crossover + 1e-3 * next(step)
        try:
            return fl.design(RIG.model, RIG, gain_crossover=asked, **(WANTED | options))
        except InfeasibleError as error:
            return error.nearest

    timed("design", call, rounds, 0.1)
    timed("design, law=False", partial(call, law=False), rounds, 0.01)
    refused = partial(call, 30.0, phase_margin=fl.deg(75), law=False)
    timed("a refusal with its offer", refused, rounds, 0.3)
    timed("a refusal without one", partial(refused, nearest=False), rounds, 0.02)


def certificates(rounds: int) -> None:
    """The proof, and its check by tools/check_certificate.py."""
    design = fl.design(RIG.model, RIG, gain_crossover=12.0, **WANTED)
    law = design.law()
    prove = partial(certify, design, law=law, modulus_margin=0.35)
    timed("certificate |1+L| > 0.35: make", prove, rounds, 5.0)
    made = prove()
    line("certificate: leaves", str(made.leaves), "proved", made.passed)
    with tempfile.TemporaryDirectory() as folder:
        place = str(Path(folder) / "certificate.json")
        made.save(place)
        check = partial(load_checker().check, place, law.digest)
        timed("certificate: check", check, rounds, 5.0)


def main() -> None:
    given = sizes(__doc__, rounds=(21, 1), proofs=(5, 1), aliases=(400, 50))
    margins(given.aliases)
    speed(given.rounds)
    certificates(given.proofs)


if __name__ == "__main__":
    main()
