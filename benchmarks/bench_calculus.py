"""A half derivative of a sampled signal: its error against mpmath, and its time next to
the Grünwald-Letnikov sum on the same samples, and next to both methods of differint if
that is installed.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import partial
from importlib import import_module

import mpmath
import numpy as np

import fracsys
from grunwald import grunwald_letnikov
from harness import interleaved, line, median, sizes

SAMPLES = 1001


def exact(t: float) -> float:
    """The half derivative of t² + sin 3t, by quadrature of Caputo's integral."""
    with mpmath.workdps(30):
        # τ = t − x² removes the singularity.
        end = mpmath.sqrt(t)
        whole = mpmath.quad(
            lambda x: 2 * (t - x**2) + 3 * mpmath.cos(3 * (t - x**2)), [0, end]
        )
        return float(2 * whole / mpmath.gamma(0.5))


def peers(y: np.ndarray) -> dict[str, Callable[[], object]]:
    """Differint's ways to the same derivative at every sample: Grünwald and Letnikov's
    improved sum, and the trapezoidal rule for Riemann and Liouville's. (Its plain sum
    is a circular convolution, and wrong at both ends.)
    """
    if not importlib.util.find_spec("differint"):
        return {}
    differint = import_module("differint.differint")
    return {
        name: partial(getattr(differint, name), 0.5, y, 0.0, 1.0, SAMPLES)
        for name in ("GLI", "RL")
    }


def main() -> None:
    given = sizes(__doc__, rounds=(50, 2), places=(40, 2))
    t = np.linspace(0.0, 1.0, SAMPLES)
    y = t**2 + np.sin(3 * t)
    places = np.unique(np.linspace(1, SAMPLES - 1, given.places).round().astype(int))
    truth = np.array([exact(float(t[k])) for k in places])

    def sums() -> np.ndarray:
        return grunwald_letnikov(fracsys.s**0.5, y, 1 / (SAMPLES - 1))

    error = float(np.max(np.abs(fracsys.derivative(t, y, 0.5)[places] / truth - 1)))
    line(
        f"half derivative of t² + sin 3t, N = {SAMPLES}, largest relative error",
        f"{error:.1e}",
        "<= 1e-6",
        error <= 1e-6,
        f"Grünwald–Letnikov {np.max(np.abs(sums()[places] / truth - 1)):.1e}",
    )
    others = peers(y)
    for name, call in others.items():
        found = np.asarray(call(), dtype=float)
        # GLI has no value at its first samples.
        away = np.abs(found[places] / truth - 1)[len(places) // 10 :]
        line(
            f"largest relative error of differint.{name}", f"{away.max():.1e}", "(none)"
        )
    spent = interleaved(
        {"ours": lambda: fracsys.derivative(t, y, 0.5), "sum": sums}, given.rounds
    )
    value, _ = median(spent["ours"])
    ratio, _ = median(spent["ours"] / spent["sum"])
    line("its time", f"{1e3 * value:.2f} ms, {ratio:.2g} × the sum's", "(none)")
    ours = partial(fracsys.derivative, t, y, 0.5)
    for name, call in others.items():
        spent = interleaved({"ours": ours, "peer": call}, min(given.rounds, 5))
        faster, _ = median(spent["peer"] / spent["ours"])
        wanted = faster >= 100 if name == "RL" else None
        line(f"faster than differint.{name}", f"{faster:.3g} ×", ">= 100", wanted)


if __name__ == "__main__":
    main()
