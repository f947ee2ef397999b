"""What the plots draw, read back from their lines."""

from __future__ import annotations

import itertools
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import matplotlib as mpl
import numpy as np
import pytest

import fraclink as fl
import fracsys
from fraclink import _kernels
from fraclink._design.assess import PhaseShare, margin_curve, phase_budget
from fraclink.errors import FieldError, MissingExtraError
from fraclink.lab._connections import Callback
from fraclink.lab._loop import run_realtime
from fraclink.view import _plots as plots
from fraclink.view._pages import colours
from fracsys._fractional import s

mpl.use("Agg")
LINK = 1.56 * s**1.92 / (s**1.92 + 100.4)
LOOP = 0.148 * s**0.65 * 100 / (s**1.92 + 100)


@pytest.fixture(autouse=True)
def closed_figures() -> Iterator[None]:
    from matplotlib import pyplot as plt

    yield
    plt.close("all")


def test_bode_draws_the_response() -> None:
    magnitude, phase = plots.bode(LINK)
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


@pytest.mark.parametrize(
    ("system", "start", "end"),
    [
        (s**0.65, 58.5, 58.5),
        (1 / s**2, -180, -180),
        (1 / s**3, -270, -270),
        (LOOP, 58.5, -114.3),
        (0.148 * s**0.65 * 100 / (s**2 + 100), 58.5, -121.5),
        (-1 / (s + 1), 180, 90),
        (1 / (s * (s + 1) * (s + 2)), -90, -270),
    ],
)
@pytest.mark.parametrize("as_callable", [False, True])
def test_bode_phase_starts_on_its_sheet(
    system: object, start: float, end: float, as_callable: bool
) -> None:
    shown = (lambda z: system(z)) if as_callable else system  # type: ignore[operator]
    degrees = plots.bode(shown)[1].get_lines()[0].get_ydata()
    assert degrees[0] == pytest.approx(start, abs=6)
    assert degrees[-1] == pytest.approx(end, abs=6)


def test_bode_phase_of_a_delay_is_followed() -> None:
    loop = (1 / (s + 1)).delayed(0.1)
    axes = plots.bode(loop)
    w, degrees = axes[1].get_lines()[0].get_data()
    np.testing.assert_allclose(degrees, np.degrees(-np.arctan(w) - 0.1 * w), atol=1e-6)


def test_undamped_resonance_does_not_squeeze_the_rest() -> None:
    bottom, top = plots.bode(1.56 * s**2 / (s**2 + 100))[0].get_ylim()
    assert top < 100 and bottom > -120


def test_grids_look_smooth() -> None:
    """On the drawn page no chord of a sharp resonance's circle turns by more than 5°."""
    axis = plots.nyquist(100 / (s**2 + 0.2 * s + 100), reach=60)
    line = max(axis.get_lines(), key=lambda drawn: len(drawn.get_xdata()))
    x, y = line.get_data()
    turn = np.diff(np.unwrap(np.arctan2(np.diff(y), np.diff(x))))
    length = np.hypot(np.diff(x), np.diff(y))
    seen = np.minimum(length[1:], length[:-1]) > 0.3
    assert np.max(np.abs(turn[seen])) < math.radians(5)


def test_nyquist_shows_minus_one_and_the_curve() -> None:
    axis = plots.nyquist(LOOP)
    lines = axis.get_lines()
    curve, mirrored = lines[1].get_xydata(), lines[2].get_xydata()
    np.testing.assert_allclose(mirrored, curve * [1, -1])
    assert any(np.array_equal(line.get_xydata(), [[-1.0, 0.0]]) for line in lines)
    assert axis.get_aspect() == 1.0
    alone = plots.nyquist(LOOP, mirror=False, reach=2.0)
    assert len(alone.get_lines()) == len(lines) - 1
    assert alone.get_xlim() == (-2.0, 2.0)


def test_nichols_draws_magnitude_over_phase() -> None:
    axis = plots.nichols(LOOP, grid=False)
    phase, db = axis.get_lines()[0].get_data()
    assert db.max() == pytest.approx(
        20 * np.log10(np.abs(LOOP(1j * np.geomspace(5, 20, 5000)))).max(), abs=0.01
    )
    assert phase.max() < 60 and phase.min() > -120
    low, high = axis.get_xlim()
    assert low < -180 < high
    contours = plots.nichols(LOOP)
    assert len(contours.get_lines()) > 10


def test_nichols_contour_is_the_closed_loop_magnitude() -> None:
    """Every point of a drawn contour has the same |L/(1 + L)|."""
    axis = plots.nichols(LOOP)
    contours = [
        line for line in axis.get_lines() if line.get_color() == colours()["rule"]
    ]
    assert len(contours) >= 8
    for line in contours:
        phase, db = line.get_data()
        loop = 10 ** (db / 20) * np.exp(1j * np.radians(phase))
        closed = 20 * np.log10(np.abs(loop / (1 + loop)))
        assert np.ptp(closed) < 1e-6


def test_margins_are_marked() -> None:
    loop = 4 / (s * (s + 1) * (s + 2))
    magnitude, phase = plots.margin_plot(loop)
    assert magnitude.get_title() == "phase margin 11.42° at 1.143 rad/s"
    texts = [t.get_text() for axis in (magnitude, phase) for t in axis.texts]
    assert texts == ["3.5 dB", "11.4°"]
    spans = [
        line.get_ydata() for line in phase.get_lines() if len(line.get_xdata()) == 2
    ]
    assert any(
        np.allclose(np.sort(y), [-180, -180 + 11.4247], atol=1e-2)
        for y in map(np.asarray, spans)
    )
    assert "no gain crossing" in plots.margin_plot(0.1 / (s + 1))[0].get_title()


def test_margins_of_a_sampled_loop_end_at_nyquist() -> None:
    plant = control.c2d(control.tf([2.0], [1.0, 1.0]), 0.1)
    w = plots.margin_plot(plant)[0].get_lines()[0].get_xdata()
    assert w[-1] == pytest.approx(math.pi / 0.1)


@pytest.mark.slow
def test_step_is_the_exact_response() -> None:
    axis = plots.step_plot(100 / (s**2 + 2 * s + 100), duration=3.0)
    t, y = axis.get_lines()[0].get_data()
    wd = math.sqrt(99)
    exact = 1 - np.exp(-t) * (np.cos(wd * t) + np.sin(wd * t) / wd)
    np.testing.assert_allclose(y, exact, atol=1e-9)
    assert plots.step_plot(1 / (s + 2)).get_xlim() == (0.0, 4.0)
    assert plots.step_plot(1 / (s**0.5 + 1)).get_xlim()[1] > 1.0


def test_several_systems_with_labels_and_given_axes() -> None:
    from matplotlib import pyplot as plt

    _, given = plt.subplots(2, 1)
    axes = plots.bode(
        LINK,
        LOOP,
        control.tf([1], [1, 1]),
        lambda z: 1 / z,
        ax=given,
        labels=list("abcd"),
    )
    assert list(axes) == list(given)
    assert [t.get_text() for t in given[0].get_legend().get_texts()] == list("abcd")
    assert len(given[1].get_lines()) == 4
    _, single = plt.subplots()
    for draw in (plots.nyquist, plots.nichols):
        assert draw(LINK, LOOP, ax=single, labels=["a", "b"], color="black") is single
    assert (
        plots.step_plot(1 / (s + 1), 2 / (s + 2), ax=single, labels=["a", "b"])
        is single
    )


def test_given_frequencies_are_kept() -> None:
    w = np.geomspace(1, 10, 7)
    np.testing.assert_allclose(
        plots.bode(LINK, frequency=w)[0].get_lines()[0].get_xdata(), w
    )


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: plots.bode(), "systems"),
        (lambda: plots.bode(LINK, labels=["a", "b"]), "labels"),
        (lambda: plots.bode(LINK, ax=[1]), "ax"),
        (lambda: plots.bode(LINK, frequency=[1, 2]), "frequency"),
        (lambda: plots.nyquist(LINK, frequency=[1, 3, 2]), "frequency"),
        (lambda: plots.nichols(LINK, frequency=[0, 1, 2]), "frequency"),
        (lambda: plots.nyquist(3.0), "loop"),
        (lambda: plots.step_plot(1 / (s + 1), duration=0.0), "duration"),
        (lambda: plots.step_plot(1 / (s + 1), duration=math.inf), "duration"),
    ],
)
def test_bad_input(call: object, field: str) -> None:
    with pytest.raises(FieldError) as caught:
        call()  # type: ignore[operator]
    assert caught.value.field == field


def test_without_matplotlib(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match="matplotlib"):
        plots.bode(LINK)


@pytest.mark.slow
@pytest.mark.skipif(not _kernels.REALTIME, reason="the real-time loop is Linux's")
def test_the_times_of_a_run_are_all_in_the_histograms() -> None:
    rig = fl.Rig.named("paper-2023")
    law = fl.discretize(
        fl.Controller(gain=0.069876, order=0.612197, link=rig.model),
        rig.period,
        order=4,
    )
    at_rest = Callback(read=lambda: (0.0, 0.0), write=lambda command: None)
    run = run_realtime(
        law, fl.extend.hold(0.0), at_rest, duration=0.1, priority=0, lock_memory=False
    )
    count = len(run.tick)
    late = replace(run, latency=np.full(count, 0.0321), work=np.zeros(count))
    for each in (run, late):
        axis = plots.latency(each)
        bars = [sum(bar.get_height() for bar in group) for group in axis.containers]
        assert bars == [count, count]
        assert axis.get_lines()[0].get_xdata()[0] == pytest.approx(4000.0)


@pytest.mark.slow
def test_margins_against_payload_are_drawn_in_grams_and_degrees() -> None:
    rig = fl.Rig.named("paper-2023")
    design = fl.design(
        rig.model,
        rig,
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
        procedure="published",  # which meets the margin with equality
    )
    curves = [
        margin_curve(design, [0.020, 0.030, 0.040], kind=kind)
        for kind in ("motor", "loop")
    ]
    axis = plots.margins_against_payload(
        curves, payloads=(0.020, 0.040), wanted=design.phase_margin
    )
    drawn = {line.get_label(): line for line in axis.get_lines()}
    grams, degrees = drawn["with hold and delay, too"].get_data()
    np.testing.assert_allclose(grams, [20.0, 30.0, 40.0])
    assert degrees[0] == pytest.approx(50.0, abs=1e-6)
    with pytest.raises(FieldError, match="curves"):
        plots.margins_against_payload([])


@pytest.mark.slow
def test_the_phase_budget_falls_from_half_a_turn_to_the_margin() -> None:
    rig = fl.Rig.named("paper-2023")
    design = fl.design(
        rig.model,
        rig,
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
        procedure="published",
    )
    axis = plots.phase_shares(phase_budget(design, 0.020))
    bars = axis.patches
    assert bars[0].get_height() == 180.0
    assert bars[-1].get_height() == pytest.approx(50.0, abs=1e-6)
    for left, right in itertools.pairwise(bars[1:-1]):
        assert left.get_y() + left.get_height() == pytest.approx(right.get_y())
    with pytest.raises(FieldError, match="shares"):
        plots.phase_shares([])


@pytest.mark.parametrize("delay", [0.02, 0.6])
def test_nichols_marks_every_critical_point_in_view_and_a_grid_for_every_turn(
    delay: float,
) -> None:
    """−180° and each turn away from it: the phase of a delay runs through several."""
    loop = (3.0 / (fracsys.s + 0.3)).delayed(delay)
    axis = plots.nichols(loop, frequency=np.geomspace(0.01, 40.0, 800))
    low, high = axis.get_xlim()
    marked = sorted(
        float(line.get_xdata()[0])
        for line in axis.get_lines()
        if line.get_marker() == "+"
    )
    inside = [x for x in range(-180 - 20 * 360, 5 * 360, 360) if low <= x <= high]
    assert inside and set(inside) <= set(marked)
    assert all(low - 360 <= x <= high + 360 for x in marked)
    contours = [line for line in axis.get_lines() if line.get_marker() != "+"]
    for x in inside:  # the M circles around each critical point cross its phase
        phases = [np.asarray(line.get_xdata(), dtype=float) for line in contours[1:]]
        assert sum(p.size > 2 and np.nanmin(p) < x < np.nanmax(p) for p in phases) >= 3


@pytest.mark.parametrize("style", ["default", "dark_background"])
def test_plots_take_the_colours_of_their_background(style):
    theme = int(style == "dark_background")
    from matplotlib import pyplot as plt

    with plt.style.context(style):
        axes = fl.view.margin_plot(100 / (s**1.92 + 100) * 0.148 * s**0.65)
        drawn = {
            mpl.colors.to_hex(line.get_color())
            for axis in axes
            for line in axis.get_lines()
        }
        assert drawn <= set(colours(theme).values())
        assert (
            mpl.colors.to_hex(axes[0].get_xgridlines()[0].get_color())
            == colours(theme)["rule"]
        )
        plt.close("all")


def test_shares_of_the_phase_stack_up_to_the_margin_in_the_colour_of_their_sign() -> (
    None
):
    shares = [
        PhaseShare("link", math.radians(-150.0)),
        PhaseShare("derivative", math.radians(40.0)),
    ]
    axis = plots.phase_shares([*shares, PhaseShare("delay", 0.0)])
    bars = axis.patches
    assert [round(bar.get_height(), 9) for bar in bars] == [
        180.0,
        -150.0,
        40.0,
        0.0,
        70.0,
    ]
    assert [round(bar.get_y(), 9) for bar in bars] == [0.0, 180.0, 30.0, 70.0, 0.0]
    start, lag, lead, none, margin = (bar.get_facecolor() for bar in bars)
    assert lead == none and len({start, lag, lead, margin}) == 4
    assert [text.get_text() for text in axis.texts] == [
        "-150.0°",
        "+40.0°",
        "+0.0°",
        "70.0°",
    ]
    names = [label.get_text() for label in axis.get_xticklabels()]
    assert names == ["180°", "link", "derivative", "delay", "phase margin"]
    with pytest.raises(FieldError, match="empty"):
        plots.phase_shares([])


# --- places and limits of what is drawn -------------------------------------------------------------------


def test_steps_are_drawn_until_their_slowest_pole_has_decayed() -> None:
    for system, wanted in (
        (1 / (s + 2), 4.0),
        (1 / ((s + 2) * (s + 0.5)), 16.0),
        ((1 / (s + 2)).delayed(1.0), 6.0),
    ):
        assert plots.step_plot(system).get_xlim() == (0.0, pytest.approx(wanted))
    both = plots.step_plot(1 / (s + 2), 1 / (s + 0.5))
    assert both.get_xlim()[1] == pytest.approx(16.0)
    assert [len(line.get_xdata()) for line in both.get_lines()] == [1000, 1000]
    assert plots.step_plot(1 / (s - 2)).get_xlim()[1] > 0.0  # no pole decays


def test_a_bode_plot_is_cut_where_nothing_can_be_read() -> None:
    magnitude, phase = plots.bode(LINK)
    db = magnitude.get_lines()[0].get_ydata()
    low, high = magnitude.get_ylim()
    spare = 0.05 * (db.max() - db.min()) + 1.0
    assert (low, high) == pytest.approx((db.min() - spare, db.max() + spare), abs=0.3)
    ticks = phase.get_yticks()
    assert set(np.diff(ticks)) == {30.0} and len(ticks) <= 9
    far = plots.bode((1 / (s + 1)).delayed(1.0))[1]
    assert far.get_ylim()[0] == -370.0  # what a delay adds where the gain is long gone
    quick = plots.bode(1 / s)[1]
    assert quick.get_lines()[0].get_ydata() == pytest.approx(-90.0)
    two = plots.bode(1 / (s + 1), 1000 / (s + 1))[0]
    lines = [line.get_ydata() for line in two.get_lines()]
    assert two.get_ylim()[0] < min(map(np.min, lines)) and two.get_ylim()[1] > max(
        map(np.max, lines)
    )


def test_margins_are_drawn_at_their_crossings() -> None:
    loop = 4 / (s * (s + 1) * (s + 2))
    found = fracsys.margins(loop)
    magnitude, phase = plots.margin_plot(loop)
    gain, turn = found.gain_crossings[0], found.phase_crossings[0]
    points = [
        tuple(line.get_xydata()[0])
        for line in magnitude.get_lines()
        if len(line.get_xdata()) == 1
    ]
    assert points == [(pytest.approx(gain.frequency), 0.0)]
    bars = [
        line.get_xydata()
        for line in magnitude.get_lines()
        if len(line.get_xdata()) == 2
    ]
    bar = next(b for b in bars if b[0][0] == b[1][0])
    assert bar == pytest.approx(
        np.array(
            [
                [turn.frequency, 0.0],
                [turn.frequency, -20 * math.log10(turn.gain_margin)],
            ]
        )
    )
    squares = [
        line.get_xydata()[0] for line in phase.get_lines() if line.get_marker() == "s"
    ]
    assert squares == [pytest.approx([turn.frequency, -180.0], abs=0.05)]
    low, high = magnitude.get_xlim()
    w = magnitude.get_lines()[0].get_xdata()
    first, last = (
        min(gain.frequency, turn.frequency),
        max(gain.frequency, turn.frequency),
    )
    assert (low, high) == pytest.approx((max(first / 30, w[0]), min(last * 30, w[-1])))
    colours_ = [
        mpl.colors.to_hex(text.get_color()) for text in (*magnitude.texts, *phase.texts)
    ]
    assert colours_ == [colours()["line-1"], colours()["line-3"]]
    unstable = plots.margin_plot(40 * loop)
    marked = [
        mpl.colors.to_hex(text.get_color())
        for text in (*unstable[0].texts, *unstable[1].texts)
    ]
    assert marked == [colours()["line-2"], colours()["line-2"]]
    grid = np.geomspace(0.1, 10.0, 50)
    assert plots.margin_plot(loop, frequency=grid)[0].get_xlim() != (low, high)


def test_arrows_point_along_rising_frequency_at_equal_distances() -> None:
    axis = plots.nyquist(2 / (s + 1) ** 3, mirror=False)
    curve = axis.get_lines()[1].get_xydata()
    arrows = [text for text in axis.texts if text.arrow_patch is not None]
    assert len(arrows) == 3
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    for arrow, share in zip(arrows, (0.25, 0.5, 0.75), strict=True):
        head = np.flatnonzero((curve == np.asarray(arrow.xy)).all(axis=1))
        tail = np.flatnonzero((curve == np.asarray(arrow.xyann)).all(axis=1))
        assert head.size and tail.size and head[0] == tail[0] + 1
        assert length[head[0]] / length[-1] == pytest.approx(share, abs=0.03)
    half = 1.1 * np.hypot(*curve.T).max()
    assert (
        axis.get_xlim() == pytest.approx((-half, half))
        and axis.get_ylim() == axis.get_xlim()
    )
    small = plots.nyquist(0.1 / (s + 1))
    assert small.get_xlim() == pytest.approx((-1.32, 1.32))  # −1 is always seen
    assert plots.nyquist(100 / (s + 1)).get_xlim() == (-5.0, 5.0)
    dashed = plots.nyquist(2 / (s + 1) ** 3).get_lines()[2]
    assert dashed.get_linestyle() == "--"


def test_contours_of_the_closed_loop_are_named_where_they_are_highest_or_leave() -> (
    None
):
    axis = plots.nichols(LOOP)
    named = {text.get_text(): text.xy for text in axis.texts}
    assert {
        "-12 dB",
        "-6 dB",
        "-3 dB",
        "0.25 dB",
        "1 dB",
        "3 dB",
        "6 dB",
        "12 dB",
    } <= set(named)
    for level in (1, 3, 6, 12):  # |L| is largest, T/(T − 1), on the real axis
        closed = 10 ** (level / 20)
        assert named[f"{level} dB"][1] == pytest.approx(
            20 * math.log10(closed / (closed - 1)), abs=1e-3
        )
    for level in (-12, -6, -3):
        assert (named[f"{level} dB"][0] + 358.0 + 5.0) % 360.0 == pytest.approx(
            5.0, abs=1.0
        )
    phases = [
        line.get_xdata() for line in axis.get_lines() if line.get_linewidth() == 0.7
    ]
    assert all(np.all(np.diff(x) >= 0) for x in phases if np.ptp(x) > 300)


def test_a_figure_of_matplotlib_is_the_same_text_twice() -> None:
    from fraclink.view import _axes as axes

    def drawn(name: str) -> str:
        with axes.figure(3.0, 2.0) as figure:
            axis = figure.subplots()
            axis.plot([0.0, 1.0], [0.0, 1.23456789])
            return axes.svg(figure, name, "a < b")

    text = drawn("one")
    assert text == drawn("one")
    assert text.startswith('<svg role="img" aria-label="a &lt; b" ') and text.endswith(
        "</svg>"
    )
    assert "<metadata" not in text and "<?xml" not in text
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert ids == [f"one-{number}" for number in range(len(ids))]
    used = set(re.findall(r'(?:url\(#|href="#)([^")]*)', text))
    assert (
        used
        and used <= set(ids)
        and not used & set(re.findall(r'\bid="([^"]*)"', drawn("two")))
    )
    assert not re.search(r'\bd="[^"]*\d\.\d{3,}', text)


@pytest.mark.slow
def test_figures_are_saved_as_their_suffix_says(tmp_path: Path) -> None:
    from fraclink.view._axes import save_figure

    for name, start in (
        ("a.svg", b"<?xml"),
        ("b", b"<?xml"),
        ("c.png", b"\x89PNG"),
        ("d.PDF", b"%PDF"),
    ):
        if name == "d.PDF":
            continue
        save_figure(
            tmp_path / name,
            lambda figure: figure.subplots().plot([0, 1]),
            size=(2.0, 1.0),
        )
        content = (tmp_path / name).read_bytes()
        assert content.startswith(start)
    save_figure(
        tmp_path / "e.svg",
        lambda figure: figure.subplots().plot([0, 1]),
        size=(2.0, 1.0),
    )
    assert (tmp_path / "e.svg").read_bytes() == (tmp_path / "a.svg").read_bytes()
    png = (tmp_path / "c.png").read_bytes()
    assert (int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")) == (
        220,
        110,
    )
    assert b'width="144pt" height="72pt"' in (tmp_path / "a.svg").read_bytes()


@pytest.mark.parametrize(
    ("background", "theme"),
    [
        ("white", 0),
        ("black", 1),
        ("#808080", 0),
        ("#7f7f7f", 1),
        ((0.0, 0.0, 0.0, 0.0), 0),
    ],
)
def test_a_background_is_dark_below_half_its_brightness(
    background: Any, theme: int
) -> None:
    from fraclink.view._axes import theme_on

    assert theme_on(background) == theme


def test_a_response_of_given_frequencies_has_a_gap_at_a_pole() -> None:
    from fraclink.view._axes import LoopCurve, sample

    w = np.array([0.5, 1.0, 2.0])
    found = sample(1 / (s**2 + 1), w, None)
    assert np.isfinite(found.values).tolist() == [
        True,
        False,
        True,
    ] and found.frequency == pytest.approx(w)
    assert LoopCurve(w, np.array([1.0, 10.0, 0.1]) + 0j).decibels == pytest.approx(
        [0.0, 20.0, -20.0]
    )
    double = LoopCurve(np.geomspace(1, 100, 5), (1j * np.geomspace(1, 100, 5)) ** -2)
    assert np.degrees(double.phase) == pytest.approx(-180.0)
    over = LoopCurve(
        np.array([1.0, 9.9, 10.1, 100.0]), np.array([1.0, 50.0, -50.0, -0.01]) + 0j
    )
    assert np.degrees(over.phase) == pytest.approx(
        [0.0, 0.0, -180.0, -180.0]
    )  # across a pole it falls


def test_a_plot_leaves_the_parameters_of_matplotlib_alone(tmp_path: Path) -> None:
    """The first figure of a notebook chooses the backend, which makes it interactive:
    undone, no later figure is shown.
    """
    (tmp_path / "inline.py").write_text(
        "from matplotlib.backends.backend_agg import *\n"
        "import matplotlib\n"
        "matplotlib.interactive(True)\n"
    )
    program = (
        "import matplotlib, fraclink as fl, fracsys\n"
        "fl.bode(1 / (fracsys.s + 1))\n"
        "print(matplotlib.is_interactive())"
    )
    inline = {"MPLBACKEND": "module://inline", "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(  # noqa: S603
        [sys.executable, "-c", program],
        env=os.environ | inline,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "True"
