"""The same three problems in fraclink and in other tools, with their errors side by
side.

Problems of the paper: the step response of the link 100/(s^1.92 + 100), the phase
margin of the loop 0.148 s^0.65 around it, the dominant pole of the loop that the
default design closes. True values come from mpmath at 50 digits: the power series of
the step response, roots of |L| = 1 and of the characteristic sum.

MATLAB is not run. The methods of FOMCON and the CRONE toolbox are taken from their
published sources and computed here; they are labelled as methods, not as the programs.
Octave (Debian: octave, octave-control) and numfracpy (PyPI) run where they are
installed.

    python benchmarks/bench_peers.py            print
    python benchmarks/bench_peers.py --write    write the table of docs/explanation/how-we-differ.md
"""

from __future__ import annotations

import argparse
import functools
import importlib.util
import math
import shutil
import subprocess
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import control
import mpmath
import numpy as np
from numpy.typing import NDArray

import fraclink as fl
import fracsys
from fraclink._files import write_text
from grunwald import grunwald_letnikov
from harness import line

PAGE = Path(__file__).parents[1] / "docs" / "explanation" / "_peers.md"
Real = NDArray[np.float64]

ORDER, SQUARE = 1.92, 100.0
LINK = SQUARE / (fracsys.s**ORDER + SQUARE)
LOOP = 0.148 * fracsys.s**0.65 * LINK
PERIOD, DURATION = 0.004, 2.0
TIME = np.arange(round(DURATION / PERIOD) + 1) * PERIOD
# Defaults of FOMCON: Oustaloup's filter of order 5 over 0.001 … 1000 rad/s is 2·5 + 1
# pairs; a frequency response of 1000 points over ten decades; orders rounded to 0.01.
BAND, PAIRS = (0.001, 1000.0), 11
GRID = np.logspace(-5, 5, 1000)
COMMENSURATE = 0.01


@dataclass(frozen=True)
class Row:
    """One tool on one problem: the words of the table and the measured error."""

    problem: str
    tool: str
    error: str

    def __str__(self) -> str:
        return f"{self.problem} | {self.tool} | {self.error} | error"


def digit(error: float, unit: str = "") -> str:
    """One digit; below a billionth it is rounding, which differs between machines."""
    return f"< 1e-9{unit}" if error < 1e-9 else f"{error:.1g}{unit}"


def true_step() -> Real:
    """y(t) = −Σ (−100 t^1.92)^k/Γ(1.92 k + 1), k ≥ 1, with enough digits for terms of
    10^120.
    """
    with mpmath.workdps(200):
        order, square = mpmath.mpf(ORDER), mpmath.mpf(SQUARE)
        gammas = [mpmath.gamma(order * k + 1) for k in range(1, 400)]
        values = []
        for instant in TIME:
            x = -square * mpmath.mpf(float(instant)) ** order
            values.append(
                float(-sum(x ** (k + 1) / gamma for k, gamma in enumerate(gammas)))
            )
    return np.array(values)


def true_margin() -> float:
    """The phase margin [°] at the one gain crossing of the loop right of its peak."""
    with mpmath.workdps(50):

        def loop(w: mpmath.mpf) -> mpmath.mpc:
            s = mpmath.mpc(0, w)
            return (
                mpmath.mpf(0.148)
                * s ** mpmath.mpf(0.65)
                * SQUARE
                / (s ** mpmath.mpf(ORDER) + SQUARE)
            )

        crossing = mpmath.findroot(
            lambda w: abs(loop(w)) - 1, (10.5, 14.0), solver="anderson"
        )
        return float(180 + mpmath.degrees(mpmath.arg(loop(crossing))))


def default_loop() -> fracsys.FractionalTransferFunction:
    """1/(1 + ĈG) of the design for 20 g … 40 g, 12 rad/s and 50°, at 30 g."""
    rig = fl.Rig.named("paper-2023")
    design = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
        procedure="published",
    )
    return 1 / (1 + design.controller.correction() * rig.model.tip())


def step_rows() -> list[Row]:
    """Largest error of the step response, in per cent of its peak."""
    exact = true_step()
    problem = "step response"

    def row(tool: str, output: Real) -> Row:
        return Row(
            problem,
            tool,
            digit(100 * np.abs(output - exact).max() / np.abs(exact).max(), " %"),
        )

    ones = np.ones(len(TIME))
    rows = [
        row("fraclink, `step_response`", fracsys.step_response(LINK, TIME).output),
        row(
            "Grünwald–Letnikov sums (FOMCON's `lsim`, CRONE's \"Grunwald\"; our code)",
            grunwald(1),
        ),
        row(
            "the same of second order (FOMCON's `GL_Order = 2`; our code)", grunwald(2)
        ),
    ]
    assert np.allclose(
        grunwald(1)[1:], grunwald_letnikov(LINK, ones, PERIOD)[1:], rtol=0, atol=1e-9
    )
    for pairs in (5, PAIRS):
        system = stand_in(LINK, pairs)
        rows.append(
            row(
                f"python-control, Oustaloup's filter, {system.nstates} states",
                control.step_response(system, TIME).outputs,
            )
        )
    if octave_control():
        output = in_octave(
            "printf('%.17g ', step(G, 0:0.004:2))", stand_in(LINK, PAIRS)
        )
        rows.append(
            row(
                f"Octave {octave_version()}, the same filter of {PAIRS} pairs",
                np.array(output),
            )
        )
    if importlib.util.find_spec("numfracpy"):
        from numfracpy import FODE

        _, output = FODE(
            lambda t, y: SQUARE * (1 - y), [0.0, 0.0], [0.0, DURATION], PERIOD, ORDER
        )
        rows.append(
            row(
                f"numfracpy {version('numfracpy')}, predictor and corrector",
                np.array(output),
            )
        )
    return rows


def grunwald(order: int) -> Real:
    """The sums by a generating function of the given order, (3/2 − 2z + z²/2)^a for the
    second.
    """
    step = {1: [1.0, -1.0], 2: [1.5, -2.0, 0.5]}[order]
    weights = power_series(step, ORDER, len(TIME)) * PERIOD**-ORDER
    weights[0] += SQUARE
    output = np.zeros(len(TIME))
    for k in range(len(TIME)):
        output[k] = (SQUARE - weights[1 : k + 1] @ output[k - 1 :: -1][:k]) / weights[0]
    return output


def power_series(base: list[float], exponent: float, count: int) -> Real:
    """Coefficients of (Σ base_j z^j)^exponent by the recurrence of its logarithmic
    derivative.
    """
    series = np.zeros(count)
    series[0] = base[0] ** exponent
    for k in range(1, count):
        reach = range(1, min(k, len(base) - 1) + 1)
        total = sum((exponent * j - (k - j)) * base[j] * series[k - j] for j in reach)
        series[k] = total / (k * base[0])
    return series


def margin_rows() -> list[Row]:
    """Error of the phase margin in degrees."""
    exact = true_margin()
    problem = f"phase margin, {exact:.3f}°"

    def row(tool: str, value: float) -> Row:
        return Row(problem, tool, digit(abs(value - exact), "°"))

    rows = [
        row("fraclink, `margins`", math.degrees(fracsys.margins(LOOP).phase_margin))
    ]
    for name, grid in (
        ("50 points over two decades", np.geomspace(1, 100, 50)),
        ("FOMCON's default", GRID),
    ):
        data = control.frd(LOOP(1j * grid), grid)
        rows.append(
            row(f"python-control, `margin` of data, {name}", control.margin(data)[1])
        )
    for pairs in (5, PAIRS):
        rows.append(
            row(
                f"python-control, Oustaloup's filter, {pairs} pairs",
                control.margin(stand_in(LOOP, pairs))[1],
            )
        )
    if octave_control():
        value = in_octave(
            "[g, p] = margin(G); printf('%.17g ', p)", stand_in(LOOP, PAIRS)
        )[0]
        rows.append(
            row(f"Octave {octave_version()}, the same filter of {PAIRS} pairs", value)
        )
    return rows


def pole_rows() -> list[Row]:
    """Relative error of the dominant pole of the closed loop."""
    closed = default_loop()
    found = fracsys.poles(closed)[0]
    terms = [(term.coefficient, term.order) for term in closed.denominator]
    with mpmath.workdps(50):
        exact = complex(
            mpmath.findroot(
                lambda s: mpmath.fsum(c * s ** mpmath.mpf(order) for c, order in terms),
                mpmath.mpc(found),
            )
        )
    problem = f"dominant pole, {exact.real:.3f} + {exact.imag:.3f}j"

    def row(tool: str, value: complex) -> Row:
        return Row(problem, tool, digit(abs(value - exact) / abs(exact)))

    def nearest(values: NDArray[np.complex128]) -> complex:
        return complex(values[np.argmin(np.abs(values - exact))])

    whole = {round(order / COMMENSURATE): c for c, order in terms}
    polynomial = np.array([whole.get(k, 0.0) for k in range(max(whole), -1, -1)])
    roots = np.roots(polynomial)
    principal = roots[np.abs(np.angle(roots)) < np.pi * COMMENSURATE]
    rational = np.asarray(stand_in(closed, PAIRS).poles())
    return [
        row("fraclink, `poles`, their number proved", found),
        row(
            f"orders rounded to {COMMENSURATE}, roots of degree {max(whole)} (FOMCON's `isstable`; our code)",
            nearest(principal ** (1 / COMMENSURATE)),
        ),
        row(
            f"python-control, Oustaloup's filter, {len(rational)} poles",
            nearest(rational),
        ),
    ]


def stand_in(
    system: fracsys.FractionalTransferFunction, pairs: int
) -> control.StateSpace:
    """A rational system for a tool that accepts no other."""
    return control.ss(
        *fracsys.approximate(
            system, band=BAND, order=pairs, method="oustaloup"
        ).state_space()
    )


def in_octave(command: str, system: control.StateSpace) -> list[float]:
    """The numbers that Octave's control package prints for a command on the system G."""
    matrices = ", ".join(
        f"[{'; '.join(' '.join(map(repr, row)) for row in part.tolist())}]"
        for part in (system.A, system.B, system.C, system.D)
    )
    script = f"pkg load control; G = ss({matrices}); {command}"
    return [float(word) for word in octave("--eval", script).split()]


@functools.cache
def octave_control() -> bool:
    """Whether Octave and its control package are installed."""
    try:
        octave("--eval", "pkg load control")
    except (OSError, subprocess.CalledProcessError):
        return False
    return True


def octave_version() -> str:
    """As Octave prints it."""
    return octave("--version").split("version ")[1].split()[0]


def octave(*arguments: str) -> str:
    """What Octave prints."""
    program = shutil.which("octave") or "octave"
    command = [program, "--no-gui", "--quiet", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout  # noqa: S603


def table(rows: list[Row]) -> str:
    """Markdown."""
    lines = ["| problem | tool or method | error |", "|---|---|---|"]
    previous = ""
    for row in rows:
        lines.append(
            f"| {row.problem if row.problem != previous else ''} | {row.tool} | {row.error} |"
        )
        previous = row.problem
    return "\n".join(lines) + "\n"


def cost() -> Row:
    """Processor time of the sums over that of our recursion, for 10 001 samples in the
    same run.
    """
    ones = np.ones(10_001)

    def spent(call: Callable[[], object]) -> float:
        begin = time.thread_time()
        call()
        return time.thread_time() - begin

    ratios = [
        spent(lambda: grunwald_letnikov(LINK, ones, PERIOD))
        / spent(lambda: fracsys.time_response(LINK, ones, PERIOD))
        for _ in range(5)
    ]
    return Row(
        "10 001 samples",
        "Grünwald–Letnikov sums (SciPy's `lfilter`) over `time_response`",
        f"{np.median(ratios):.0f}×",
    )


def rows() -> list[Row]:
    """Every row that the installed tools can make."""
    with warnings.catch_warnings():
        # python-control's warnings about improper approximations
        warnings.simplefilter("ignore")
        return [*step_rows(), *margin_rows(), *pole_rows()]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--write", action="store_true", help=f"write {PAGE.name}; needs every tool"
    )
    parser.add_argument("--short", action="store_true", help="one problem of three")
    wanted = parser.parse_args()
    # The test of the page that shows the rows measures all of them.
    found = step_rows() if wanted.short else rows()
    for row in (*found, cost()):
        line(f"{row.problem}: {row.tool}", row.error, "printed")
    if wanted.write:
        absent = [] if octave_control() else ["octave with octave-control"]
        absent += [
            tool for tool in ("numfracpy",) if not importlib.util.find_spec(tool)
        ]
        if absent:
            raise SystemExit(
                f"not installed: {', '.join(absent)}; the table would lose its rows"
            )
        write_text(PAGE, table(found))


if __name__ == "__main__":
    main()
