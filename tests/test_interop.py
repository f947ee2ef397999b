"""python-control on fractional systems: supported operations are exact, the others fail
instead of misleading.
"""

from __future__ import annotations

import copy
import math
import sys
import warnings
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import control
import matplotlib as mpl
import numpy as np
import pytest

import fracsys
from fraclink.errors import FieldError, MissingExtraError
from fracsys import FractionalTransferFunction, from_control, margins, s, to_control

mpl.use("Agg")
W = 10.31
# Eq. (58) on the link of 30 g: unstable, with two gain crossovers, one of them at
# −7.34°.
LOOP = 0.148 * s**0.65 / (1 + 0.16 * s) ** 2 * W**2 / (s**1.92 + W**2)
OMEGA = np.geomspace(0.1, 100.0, 60)


@pytest.fixture
def loop() -> Iterator[Any]:
    from matplotlib import pyplot as plt

    yield to_control(LOOP)
    plt.close("all")


def test_values_are_exact(loop: Any) -> None:
    np.testing.assert_array_equal(loop.frdata[0, 0], LOOP(1j * loop.omega))
    stated = LOOP.to_control(OMEGA, name="stated")
    np.testing.assert_array_equal(stated.omega, OMEGA)
    np.testing.assert_array_equal(stated(1j * OMEGA), LOOP(1j * OMEGA))
    assert stated.name == "stated"


def test_nothing_is_made_up_between_the_frequencies(loop: Any) -> None:
    with pytest.raises(ValueError, match="not all frequencies"):
        loop(0.123j)


def test_margins_of_python_control(loop: Any) -> None:
    own = margins(LOOP)
    gain, phase, at_phase, at_gain = control.margin(loop)
    assert phase == pytest.approx(math.degrees(own.phase_margin), abs=2e-3)
    assert at_gain == pytest.approx(own.gain_crossover, rel=1e-6)
    assert gain == pytest.approx(own.gain_margin, rel=1e-5)
    assert at_phase == pytest.approx(own.phase_crossings[0].frequency, rel=1e-5)
    modulus = control.stability_margins(loop)[2]
    assert modulus == pytest.approx(own.modulus_margin, rel=1e-3)


def test_nyquist_counts_the_encirclements(loop: Any) -> None:
    assert control.nyquist_response(loop).count == 2
    assert control.nyquist_response(to_control(LOOP * 0.1)).count == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "draw",
    [
        lambda g: control.bode_plot(g),
        lambda g: control.bode_plot(g, initial_phase=0),
        lambda g: control.bode_plot([g, control.tf([1], [1, 1])]),
        lambda g: control.bode_plot(LOOP.to_control(OMEGA)),
        lambda g: control.nyquist_plot(g),
        lambda g: control.nichols_plot(g),
    ],
)
def test_plots_draw_the_loop(loop: Any, draw: object) -> None:
    shown = draw(loop)  # type: ignore[operator]
    lines = [line for axis in np.ravel(shown.axes) for line in axis.get_lines()]
    assert max(len(line.get_xdata()) for line in lines) >= len(OMEGA)


@pytest.mark.slow
def test_bode_plot_shows_the_peak(loop: Any) -> None:
    axis = np.ravel(control.bode_plot(loop, dB=True).axes)[0]
    peak = max(np.max(line.get_ydata()) for line in axis.get_lines())
    exact = np.max(20 * np.log10(np.abs(LOOP(1j * np.geomspace(5, 20, 20_001)))))
    assert peak == pytest.approx(exact, abs=0.01)


@pytest.mark.parametrize(
    "other",
    [control.tf([1.0], [0.01, 1.0]), control.ss(control.tf([2.0], [0.1, 1.0])), 3.0],
)
def test_products_and_feedback_keep_the_frequencies(loop: Any, other: Any) -> None:
    here, points = LOOP(1j * loop.omega), 1j * loop.omega
    value = other(points) if callable(other) else np.full(points.shape, other)
    for system, expected in (
        (loop * other, here * value),
        (other * loop, here * value),
        (loop + other, here + value),
        (control.series(other, loop), here * value),
        (control.feedback(loop, other), here / (1 + here * value)),
    ):
        np.testing.assert_array_equal(system.omega, loop.omega)
        np.testing.assert_allclose(system.frdata[0, 0], expected, rtol=1e-9)


# The table of docs/how-to/python-control.md: if one of these begins to work, the page
# must say so.
IMPOSSIBLE = {
    "other frequencies": (
        ValueError,
        lambda g: control.frequency_response(g, OMEGA),
    ),
    "omega of bode_plot": (UserWarning, lambda g: control.bode_plot(g, OMEGA)),
    "feedback(tf, data)": (
        TypeError,
        lambda g: control.feedback(control.tf([1], [1, 1]), g),
    ),
    "tf / data": (TypeError, lambda g: control.tf([1], [1, 1]) / g),
    "bandwidth": (NotImplementedError, control.bandwidth),
    "step_response": (AttributeError, control.step_response),
    "ss": (TypeError, control.ss),
    "tf": (TypeError, control.tf),
    "pzmap": (TypeError, control.pole_zero_plot),
    "root_locus": (TypeError, control.root_locus_plot),
    "interconnect": (
        TypeError,
        lambda g: control.interconnect([g], inputs="u", outputs="y"),
    ),
    "disk_margins": (ValueError, lambda g: control.disk_margins(g, OMEGA)),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_what_cannot_work_says_so(loop: Any, name: str) -> None:
    error, call = IMPOSSIBLE[name]
    with warnings.catch_warnings(), pytest.raises(error):
        warnings.simplefilter("error")
        call(loop)


@pytest.mark.parametrize(
    ("system", "expected"),
    [
        (control.tf([10], [1, 2, 10]), 10 / (s**2 + 2 * s + 10)),
        (control.tf([1, 0], [2, 4]), 0.5 * s / (s + 2)),
        (control.ss([[-3.0]], [[1.0]], [[2.0]], [[0.0]]), 2 / (s + 3)),
        (control.tf([5], [1]), 0 * s + 5),
        (4, 0 * s + 4),
        (LOOP, LOOP),
    ],
)
def test_from_control(system: object, expected: FractionalTransferFunction) -> None:
    points = 1j * OMEGA
    np.testing.assert_allclose(
        from_control(system)(points), expected(points), rtol=1e-12
    )


@pytest.mark.parametrize(
    ("system", "field"),
    [
        (control.tf([1], [1, 0.5], 0.1), "system.dt"),
        (control.tf([1], [1, 0.5], True), "system.dt"),
        (control.ss(np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), "system"),
        (control.frd([1, 2], [1, 2]), "system"),
        ("1/(s+1)", "system"),
    ],
)
def test_from_control_refuses(system: object, field: str) -> None:
    with pytest.raises(FieldError) as caught:
        from_control(system)
    assert caught.value.field == field


@pytest.mark.parametrize("system", [0 * s, 3.0, None])
def test_to_control_refuses(system: object) -> None:
    with pytest.raises(FieldError):
        to_control(system)  # type: ignore[arg-type]


def test_without_python_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(MissingExtraError, match=r"fraclink\[control\]"):
        to_control(LOOP)


def test_systems_of_python_control_in_the_algebra() -> None:
    lag, held = control.tf([1], [1, 1]), 2 / (s**0.5 + 3)
    assert lag * held == held / (s + 1)
    assert held * lag == held / (s + 1)
    assert control.ss(lag) * held == held / (s + 1)
    assert lag + held == held + 1 / (s + 1)
    assert held / lag == held * (s + 1)
    assert control.feedback(held, 1) == held.feedback()
    assert control.feedback(held, 2, 1) == held.feedback(2, sign=1)


def test_an_operator_does_not_guess_the_hold_of_a_sampled_system() -> None:
    sampled = control.tf([1.0], [1.0, -0.5], 0.1)
    for operation in (
        lambda: s * sampled,
        lambda: s + sampled,
    ):
        with pytest.raises(FieldError, match="sampling period"):
            operation()


def test_what_python_controls_users_ask_of_a_function() -> None:
    G = (s + 2) / (s**1.92 + 0.3 * s**0.5 + 100)
    assert G.dcgain() == control.dcgain(G) == 0.02
    assert (1 / s).dcgain() == math.inf
    np.testing.assert_array_equal(G.poles(), fracsys.poles(G))
    np.testing.assert_array_equal(control.zeros(G), [-2.0])
    assert Fraction(1, 2) * G == 0.5 * G
    assert copy.deepcopy(G) == G
