"""The contents of the plots, read back from their lines."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator

import control
import matplotlib as mpl
import numpy as np
import pytest

import fraclink as fl
from fraclink.errors import FieldError, MissingExtraError
from fracsys import s

mpl.use("Agg")
LINK = 1.56 * s**1.92 / (s**1.92 + 100.4)
LOOP = 0.148 * s**0.65 * 100 / (s**1.92 + 100)


@pytest.fixture(autouse=True)
def closed_figures() -> Iterator[None]:
    from matplotlib import pyplot as plt

    yield
    plt.close("all")


def test_bode_draws_the_response() -> None:
    magnitude, phase = fl.bode(LINK)
    w, db = magnitude.get_lines()[0].get_data()
    np.testing.assert_allclose(db, 20 * np.log10(np.abs(LINK(1j * w))), atol=1e-9)
    degrees = phase.get_lines()[0].get_ydata()
    np.testing.assert_allclose(degrees, np.degrees(np.angle(LINK(1j * w))), atol=1e-9)
    peak = 1.56 / math.sin(0.96 * math.pi)
    assert db.max() == pytest.approx(
        20 * math.log10(peak), abs=0.03
    )  # a thousandth of the axis
    assert w[0] < 1.0 and w[-1] > 100.0
    assert magnitude.get_xscale() == "log"
    labels = (magnitude.get_ylabel(), phase.get_ylabel(), phase.get_xlabel())
    assert labels == ("magnitude [dB]", "phase [°]", "frequency [rad/s]")


def test_bode_phase_of_a_delay_is_followed() -> None:
    loop = (1 / (s + 1)).delayed(0.1)
    axes = fl.bode(loop)
    w, degrees = axes[1].get_lines()[0].get_data()
    np.testing.assert_allclose(degrees, np.degrees(-np.arctan(w) - 0.1 * w), atol=1e-6)


def test_the_bode_plot_of_a_sampled_loop_ends_at_nyquist() -> None:
    plant = control.c2d(control.tf([2.0], [1.0, 1.0]), 0.1)
    (line,) = fl.bode(plant)[0].get_lines()
    assert line.get_xdata()[-1] == pytest.approx(math.pi / 0.1)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: fl.bode(), "systems"),
        (lambda: fl.bode(LINK, labels=["a", "b"]), "labels"),
        (lambda: fl.bode(LINK, ax=[1]), "ax"),
        (lambda: fl.bode(LINK, frequency=[1, 2]), "frequency"),
        (lambda: fl.bode(LINK, frequency=[1, 3, 2]), "frequency"),
        (lambda: fl.bode(LINK, frequency=[0, 1, 2]), "frequency"),
        (lambda: fl.bode(3.0), "loop"),
    ],
)
def test_bad_input(call: object, field: str) -> None:
    with pytest.raises(FieldError) as caught:
        call()  # type: ignore[operator]
    assert caught.value.field == field


def test_without_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match="matplotlib"):
        fl.bode(LINK)
