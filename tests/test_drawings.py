"""Drawings read back: the position of every mark, tick, label and name, compared with
values computed by hand.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import fraclink as fl
from fraclink.view import _figures as figures
from fraclink.view import _loops as loops
from fraclink.view import _marks as marks
from fraclink.view import _runs as runs
from fraclink.view._drawing import Panel

# --- drawings of loops ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def design() -> fl.Design:
    rig = fl.Rig.named("paper-2023")
    return fl.design(
        rig.model, rig, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0
    )


@pytest.mark.slow
def test_the_bode_plot_is_the_loop_at_three_payloads_with_a_dot_at_each_crossing(
    design: fl.Design,
) -> None:
    drawn = loops.bode_figure(design)
    gain, phase = drawn.panels
    curves = [mark for mark in gain.marks if isinstance(mark, marks.Curve)]
    assert [(curve.line, curve.name) for curve in curves] == [
        (1, "20 g"),
        (2, "30 g"),
        (3, "40 g"),
    ]
    for curve, below, payload in zip(
        curves,
        (m for m in phase.marks if isinstance(m, marks.Curve)),
        (0.02, 0.03, 0.04),
        strict=True,
    ):
        w = np.asarray(curve.x)
        value = design.loop(w, design.natural_frequency(payload))
        np.testing.assert_allclose(curve.y, 20 * np.log10(np.abs(value)), atol=1e-9)
        turned = np.exp(1j * np.radians(np.asarray(below.y)))
        np.testing.assert_allclose(turned, value / np.abs(value), atol=1e-9)
    dots = [mark for mark in gain.marks if isinstance(mark, marks.Point)]
    wanted = [
        c.frequency for m in (0.02, 0.03, 0.04) for c in design.at(m).gain_crossings
    ]
    assert [dot.x for dot in dots] == wanted and all(dot.y == 0.0 for dot in dots)
    margins = [mark.y + 180.0 for mark in phase.marks if isinstance(mark, marks.Point)]
    told = [
        math.degrees(c.phase_margin)
        for m in (0.02, 0.03, 0.04)
        for c in design.at(m).gain_crossings
    ]
    assert np.cos(np.radians(margins)) == pytest.approx(
        np.cos(np.radians(told)), abs=1e-9
    )
    assert drawn.x.log and drawn.x.low < min(wanted) < max(wanted) < drawn.x.high


@pytest.mark.slow
def test_the_nyquist_plot_shades_the_disk_that_the_curves_keep_out_of(
    design: fl.Design,
) -> None:
    drawn = loops.nyquist_figure(design)
    disk = next(
        mark
        for mark in drawn.panels[0].marks
        if isinstance(mark, marks.Curve) and mark.weight == "fill"
    )
    radius = np.hypot(np.asarray(disk.x) + 1.0, np.asarray(disk.y))
    least = min(design.at(m).modulus_margin for m in (0.02, 0.03, 0.04))
    assert radius == pytest.approx(np.full(radius.size, least))
    for curve in drawn.panels[0].marks:
        if isinstance(curve, marks.Curve) and curve.name:
            near = np.hypot(np.asarray(curve.x) + 1.0, np.asarray(curve.y))
            assert (
                np.nanmin(near) >= least - 1e-9
                and np.nanmax(np.hypot(curve.x, curve.y)) <= 6.0
            )
    assert drawn.description == f"Nyquist curve around −1; worst distance {least:.3g}"
    proved = loops.nyquist_figure(design, 0.25)
    disk = next(
        mark
        for mark in proved.panels[0].marks
        if isinstance(mark, marks.Curve) and mark.weight == "fill"
    )
    assert np.hypot(np.asarray(disk.x) + 1.0, np.asarray(disk.y)) == pytest.approx(0.25)
    assert proved.description.endswith("proved distance 0.25") and proved.rigid
    dots = [m for m in drawn.panels[0].marks if isinstance(m, marks.Point)]
    assert all(math.hypot(dot.x, dot.y) == pytest.approx(1.0, abs=1e-6) for dot in dots)
    assert (dots[-1].x, dots[-1].y, dots[-1].sign) == (-1.0, 0.0, "cross")


# --- records, fits and moves ------------------------------------------------------------------------------


def curves(panel: Panel) -> list[marks.Curve]:
    """The curves of a panel."""
    return [mark for mark in panel.marks if isinstance(mark, marks.Curve)]


def test_a_log_is_drawn_as_it_was_recorded() -> None:
    time = 0.004 * np.arange(500)
    log = fl.Experiment(
        period=0.004,
        motor_angle=np.sin(time),
        output=np.cos(time),
        output_kind="deflection",
    )
    drawn = figures.log_figure(log)
    angle, output = drawn.panels
    assert (angle.label, output.label) == (
        "motor angle θm [rad]",
        "deflection θm − θt [rad]",
    )
    assert [(c.line, c.weight) for c in (*curves(angle), *curves(output))] == [
        (0, ""),
        (1, ""),
    ]
    assert np.array_equal(curves(angle)[0].y, log.motor_angle) and np.array_equal(
        curves(output)[0].x, log.time
    )
    assert (drawn.x.low, drawn.x.high) == pytest.approx((0.0, 499 * 0.004))
    long = fl.Experiment(
        period=0.001, motor_angle=np.zeros(2001), output=np.zeros(2001)
    )
    assert [c.weight for c in curves(figures.log_figure(long).panels[0])] == ["thin"]
    edge = fl.Experiment(
        period=0.001, motor_angle=np.zeros(2000), output=np.zeros(2000)
    )
    assert [c.weight for c in curves(figures.log_figure(edge).panels[0])] == [""]


def test_each_of_many_runs_has_its_curve(design: fl.Design) -> None:
    """More runs than the palette has lines: the lines are used again."""
    move = fl.smooth_step(0.5, 0.3)
    run = fl.simulate(
        design.law(), move, rig=design.rig, model=design.model, duration=1.0
    )
    for panel in runs.moves_figure([run] * 6).panels[1:]:
        assert len(curves(panel)) == 6
