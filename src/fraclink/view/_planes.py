"""Nyquist and Nichols plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink.view._axes import LoopCurve, finish, labelled, new_axes, sample, tint

__all__ = ["nichols", "nyquist"]

Real = NDArray[np.float64]


def nyquist(
    *systems: Any,
    ax: Any = None,
    labels: Sequence[str] | None = None,
    frequency: ArrayLike | None = None,
    limit: float | None = None,
    reach: float | None = None,
    mirror: bool = True,
    **style: Any,
) -> Any:
    """Draw L(jω) in the complex plane with the unit circle and the point −1.

    Parameters
    ----------
    *systems, labels, frequency, limit, **style
        As in `bode`.
    ax
        axes to draw into; new ones without.
    reach
        Half the side of the square that is shown; without it all of the curve, or 5 if
        it goes beyond 8.
    mirror
        Draw negative frequencies too, dashed.

    Examples
    --------
    >>> axis = nyquist(lambda s: 2 / (s + 1) ** 3)
    >>> axis.get_aspect()
    1.0
    """
    named = labelled(systems, labels)
    ax = new_axes() if ax is None else ax
    angle = np.linspace(0, 2 * math.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), ":", color=tint(ax, "quiet"), linewidth=0.9)
    # An undamped resonance is refined as far as it is seen.
    shown = reach or 8.0

    def drawn(curve: LoopCurve) -> tuple[Real, Real]:
        # What runs beyond is refined as if it stayed on a circle just outside: the
        # chords that cross the edge still point the right way, and a pole costs no
        # points.
        far = np.abs(curve.values) > 1.5 * shown
        values = np.where(
            far, 1.5 * shown * np.exp(1j * np.angle(curve.values)), curve.values
        )
        values = np.nan_to_num(values, nan=0.0)
        return values.real / (2 * shown), values.imag / (2 * shown)

    largest = 1.2
    for system, label in named:
        curve = sample(system, frequency, limit, drawn)
        values = curve.values
        (line,) = ax.plot(values.real, values.imag, label=label, **style)
        if mirror:
            shade = {
                **style,
                "color": line.get_color(),
                "linestyle": "--",
                "linewidth": 0.7,
            }
            ax.plot(values.real, -values.imag, **shade)
        _arrows(
            ax, values, line.get_color(), min(shown, float(np.nanmax(np.abs(values))))
        )
        largest = max(largest, float(np.nanmax(np.abs(values))))
    ax.plot([-1], [0], "+", color=tint(ax, "line-2"), markersize=11, markeredgewidth=2)
    # Beyond 8 the point −1, which decides, would lie within a few dots of the origin: 5
    # shows it and cuts the rest.
    half = reach or (1.1 * largest if largest <= 8 else 5.0)
    ax.set(xlim=(-half, half), ylim=(-half, half), xlabel="Re L", ylabel="Im L")
    ax.set_aspect("equal")
    return finish(ax, labels)


def _arrows(ax: Any, values: NDArray[np.complex128], color: str, size: float) -> None:
    """Three arrows in the direction of rising frequency, at equal distances along what
    is seen.
    """
    # Arrows by the length of the curve and not by its points, which crowd where it
    # bends.
    seen = np.flatnonzero(np.abs(values) < size)
    if seen.size < 4:
        return
    path = values[seen]
    length = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path)))])
    for share in (0.25, 0.5, 0.75):
        i = int(np.searchsorted(length, share * length[-1]))
        i = min(max(i, 1), len(path) - 1)
        # Between two stretches that are seen the curve was outside: an arrow across the
        # gap would point nowhere.
        if seen[i] - seen[i - 1] == 1 and abs(path[i] - path[i - 1]) > 0:
            ax.annotate(
                "",
                xy=(path[i].real, path[i].imag),
                xytext=(path[i - 1].real, path[i - 1].imag),
                arrowprops={
                    "arrowstyle": "-|>",
                    "color": color,
                    "linewidth": 0,
                    "mutation_scale": 12,
                },
            )


def nichols(
    *systems: Any,
    ax: Any = None,
    labels: Sequence[str] | None = None,
    frequency: ArrayLike | None = None,
    limit: float | None = None,
    grid: bool = True,
    **style: Any,
) -> Any:
    """Draw magnitude [dB] over phase [°], with contours of the closed loop's magnitude.

    Parameters
    ----------
    *systems, labels, frequency, limit, **style
        As in `bode`.
    ax
        axes to draw into; new ones without.
    grid
        Draw |L/(1 + L)| = −12 … 12 dB around each critical point that is seen.

    Examples
    --------
    >>> axis = nichols(lambda s: 2 / (s + 1) ** 3)
    >>> axis.get_xlabel()
    'phase [°]'
    """
    named = labelled(systems, labels)
    ax = new_axes() if ax is None else ax

    def drawn(curve: LoopCurve) -> tuple[Real, Real]:
        decibels = np.clip(np.nan_to_num(curve.decibels, nan=0.0), -60, 60)
        return np.nan_to_num(curve.phase, nan=0.0) / (2 * math.pi), decibels / 80

    for system, label in named:
        curve = sample(system, frequency, limit, drawn)
        ax.plot(np.degrees(curve.phase), curve.decibels, label=label, **style)
    # No margin is read below −40 dB nor above 60 dB; an integrator or a mode would take
    # the axis.
    bottom, top = max(ax.get_ylim()[0], -40.0), min(ax.get_ylim()[1], 60.0)
    low, high = _seen(ax, bottom, top)
    if grid:
        for turn in range(math.floor(low / 360), math.ceil(high / 360) + 1):
            _contours(ax, 360.0 * turn)
    for critical in range(
        math.floor((low + 180) / 360), math.ceil((high + 180) / 360) + 1
    ):
        ax.plot(
            [360 * critical - 180],
            [0],
            "+",
            color=tint(ax, "line-2"),
            markersize=11,
            markeredgewidth=2,
        )
    ax.set(
        xlim=(low, high),
        ylim=(bottom, top),
        xlabel="phase [°]",
        ylabel="magnitude [dB]",
    )
    return finish(ax, labels)


def _seen(ax: Any, bottom: float, top: float) -> tuple[float, float]:
    """Phases [°] of the curves inside the magnitudes that are shown, and −180° in any
    case.
    """
    phases = [np.array([-200.0, -100.0])]
    for line in ax.get_lines():
        across, up = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
        phases.append(across[(up > bottom) & (up < top)])
    every = np.concatenate(phases)
    return float(every.min()) - 10.0, float(every.max()) + 10.0


def _contours(ax: Any, shift: float) -> None:
    """Contours of |L/(1 + L)| between shift − 360° and shift."""
    angle = np.linspace(1e-3, 2 * math.pi - 1e-3, 721)
    # |L/(1 + L)| in dB; 3 dB is about the largest that a design would accept, 0.25 dB
    # shows how contours close around −1.
    for level in (-12, -6, -3, 0.25, 1, 3, 6, 12):
        closed = 10 ** (level / 20) * np.exp(1j * angle)
        loop = closed / (1 - closed)
        phase = np.degrees(np.mod(np.angle(loop), 2 * math.pi)) - 360 + shift
        # Contours below 0 dB run through all phases and are drawn from left to right;
        # those above are closed around −1 and keep their order.
        order = np.argsort(phase) if level < 0 else np.arange(phase.size)
        decibels = 20 * np.log10(np.abs(loop))
        ax.plot(
            phase[order],
            decibels[order],
            color=tint(ax, "rule"),
            linewidth=0.7,
            zorder=0,
        )
        i = (
            int(np.argmin(np.abs(phase - (shift - 358))))
            if level < 0
            else int(np.argmax(decibels))
        )
        ax.annotate(
            f"{level:g} dB",
            (phase[i], decibels[i]),
            fontsize=7,
            color=tint(ax, "quiet"),
            ha="center",
            annotation_clip=True,
        )
