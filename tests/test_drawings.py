"""Drawings read back: where every mark, tick, label and name lies, in hand-computed
dots and shares.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import fraclink as fl
from fraclink.trials._faults import GROUPS, Case, Check, FaultTable, Outcome
from fraclink.view import _figures as figures
from fraclink.view import _fleets as fleets
from fraclink.view import _loops as loops
from fraclink.view import _marks as marks
from fraclink.view._drawing import Figure, Panel
from fraclink.view._marks import Frame
from fraclink.view._scales import Scale, envelope, nice_ticks

FRAME = Frame(Scale(0.0, 10.0), Scale(0.0, 100.0), top=24.0, height=150.0)


def tree(text: str) -> ElementTree.Element:
    """The elements of a drawing; what is not well-formed fails."""
    return ElementTree.fromstring(re.sub(r' xmlns="[^"]*"', "", text))  # our own  # noqa: S314


def points(path: str) -> list[list[tuple[int, int]]]:
    """The lines of a path in steps of the box, each between two gaps."""
    found = []
    for part in path.rstrip("z").split("M")[1:]:
        start, _, rest = part.partition("l")
        at = tuple(map(int, re.findall(r"-?\d+", start)))
        line = [at]
        numbers = list(map(int, re.findall(r"-?\d+", rest)))
        for dx, dy in zip(numbers[::2], numbers[1::2], strict=True):
            at = (at[0] + dx, at[1] + dy)
            line.append(at)
        found.append(line)
    return found  # type: ignore[return-value]


# --- scales -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("low", "high", "most", "wanted"),
    [
        (0.0, 10.0, 5, "0 2 4 6 8 10"),
        (-0.07, 0.11, 4, "−0.05 0 0.05 0.1"),
        (0.0, 4.0, 4, "0 1 2 3 4"),
        (0.0, 30.0, 3, "0 10 20 30"),
        (0.0, 100.0, 4, "0 25 50 75 100"),
        (0.5, 0.9, 9, "0.5 0.55 0.6 0.65 0.7 0.75 0.8 0.85 0.9"),
        (-3e6, 3e6, 3, "−2×10⁶ 0 2×10⁶"),
        (0.0, 3e-5, 3, "0 1×10⁻⁵ 2×10⁻⁵ 3×10⁻⁵"),
        (5.0, 5.00002, 2, "5 5.00001 5.00002"),
        (0.0, 1e-13, 2, "0 5×10⁻¹⁴ 1×10⁻¹³"),
    ],
)
def test_ticks_are_places_that_people_count_in(
    low: float, high: float, most: int, wanted: str
) -> None:
    found = nice_ticks(low, high, most)
    assert [text for _, text in found] == wanted.split()
    assert all(low <= value <= high for value, _ in found)


def test_a_record_is_thinned_to_the_extremes_of_its_stretches_in_their_order() -> None:
    time, values = np.arange(400.0), np.zeros(400)
    values[137], values[152] = -3.0, 5.0
    kept_time, kept = envelope(time, values, 4)
    assert kept_time.tolist() == [0, 50, 100, 150, 200, 250, 300, 350]
    assert kept.tolist() == [0, 0, 5.0, -3.0, 0, 0, 0, 0] or kept.tolist() == [
        0,
        0,
        -3.0,
        5.0,
        0,
        0,
        0,
        0,
    ]
    rising = envelope(time, time, 4)[1]
    assert rising.tolist() == [0, 99, 100, 199, 200, 299, 300, 399]
    assert envelope(time, -time, 4)[1].tolist() == [
        0,
        -99,
        -100,
        -199,
        -200,
        -299,
        -300,
        -399,
    ]
    whole = envelope(time, values, 200)
    assert (
        whole[0] is time and whole[1] is values
    )  # no more than twice the points: as it is


# --- marks ------------------------------------------------------------------------------------------------


def test_a_path_has_gaps_where_values_are_missing_and_is_clipped_far_outside() -> None:
    nan = math.nan
    assert points(FRAME.path([0, 5, 10], [0, 50, 100])) == [
        [(0, 2000), (2000, 1000), (4000, 0)]
    ]
    assert points(FRAME.path([0, 1, 2, 3, 4], [0, 50, nan, 50, 0])) == [
        [(0, 2000), (400, 1000)],
        [(1200, 1000), (1600, 2000)],
    ]
    far = points(FRAME.path([-100, 0, 100], [1e6, 0, -1e6]))
    assert far == [[(-4000, -2000), (0, 2000), (8000, 4000)]]
    assert points(FRAME.path([1, 1, 1], [50, 50, 50])) == [
        [(400, 1000)]
    ]  # no step is no point
    assert FRAME.path([0, 5], [0, nan], dots=True) == "M0 2000h0"
    assert FRAME.path([nan], [1.0]) == ""


# --- panels and figures -----------------------------------------------------------------------------------


def figure(**more: Any) -> Figure:
    """Two panels over ten seconds."""
    upper = Panel(
        "upper [V]",
        Scale(0.0, 100.0),
        [marks.Curve([0, 10], [0, 100], 1, "line")],
        150.0,
    )
    lower = Panel(
        "lower",
        Scale(-1.0, 1.0),
        [marks.Zone(2.0, 4.0), marks.Across(0.0, "zero")],
        100.0,
    )
    given = {"panels": (upper, lower), "xlabel": "time [s]", "link": "time", **more}
    return Figure("try", "what <it> is", Scale(0.0, 10.0), **given)


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ([50.0], [99.0]),
        ([100.0], [29.0]),  # five dots below the upper edge
        ([0.0], [172.0]),  # two above the lower
        ([50.0, 50.0], [91.5, 106.5]),  # fifteen apart, around their place
        ([100.0, 100.0, 100.0], [29.0, 44.0, 59.0]),
        ([0.0, 0.0], [157.0, 172.0]),
        ([80.0, 20.0], [54.0, 144.0]),
    ],
)
def test_names_of_lines_are_pushed_apart_until_each_can_be_read(
    values: list[float], wanted: list[float]
) -> None:
    curves = [
        marks.Curve([0, 10], [value, value], 1, f"n{k}")
        for k, value in enumerate(values)
    ]
    panel = Panel("", Scale(0.0, 100.0), curves, 150.0)
    root = tree(Figure("n", "", Scale(0.0, 10.0), (panel,)).inline())
    ends = [found for found in root.iter("svg") if found.get("x") == "100%"]
    keys = [float(line.get("y1", "nan")) for line in ends[0].iter("line")]
    assert keys == pytest.approx(wanted, abs=0.11)
    assert [float(t.get("y", "nan")) for t in ends[0].iter("text")] == pytest.approx(
        [w + 4 for w in wanted], abs=0.11
    )
    assert [t.text for t in ends[0].iter("text")] == [
        f"n{k}" for k in range(len(values))
    ]


def test_only_svg_files_are_written(tmp_path: Path) -> None:
    for name in ("a.svg", "b", "c.SVG"):
        figure().save(tmp_path / name)
        assert (tmp_path / name).read_text("utf-8") == figure().alone() + "\n"
    with pytest.raises(fl.errors.FieldError, match="of another kind"):
        figure().save(tmp_path / "a.pdf")


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
        mode = float(design.loop.peak(design.natural_frequency(payload)))
        assert w[0] == pytest.approx(0.03 * mode) and w[-1] == pytest.approx(
            math.pi / 0.004
        )
        assert (
            np.diff(np.log(w)).max() < 0.07
            and np.diff(np.log(w[np.abs(np.log(w / mode)) < 0.02])).max() < 0.004
        )
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
    assert (gain.y.low, gain.y.high, phase.y.low, phase.y.high) == (
        -45.0,
        30.0,
        -360.0,
        90.0,
    )
    assert [text for _, text in phase.y.marks(4)] == [
        "−360",
        "−270",
        "−180",
        "−90",
        "0",
        "90",
    ]
    assert (drawn.x.low, drawn.x.log) == (1.0, True) and drawn.x.high == pytest.approx(
        math.pi / 0.004
    )


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


def test_the_waterfall_of_the_phase_ends_at_the_margin() -> None:
    from fraclink._design.assess import PhaseShare

    drawn = loops.budget_figure(
        [PhaseShare("link", -2.0), PhaseShare("lead", 1.0)], 0.02
    )
    root = tree(drawn.inline())
    bars = [r for r in root.iter("rect") if r.get("height") == "18"]
    link, lead = math.degrees(2.0), math.degrees(1.0)
    high = 1.12 * 180.0
    spans = [
        (0.0, 180.0),
        (180.0 - link, 180.0),
        (180.0 - link, 180.0 - link + lead),
        (0.0, 180.0 - link + lead),
    ]
    for bar, (start, end), row, style in zip(
        bars, spans, range(4), ("f0", "f2", "f1", "f3"), strict=True
    ):
        assert float(bar.get("x", "")[:-1]) == pytest.approx(
            100 * start / high, abs=0.01
        )
        assert float(bar.get("width", "")[:-1]) == pytest.approx(
            100 * (end - start) / high, abs=0.01
        )
        assert (float(bar.get("y", "")), bar.get("class")) == (
            24.0 + 26 * row + 4,
            style,
        )
    named = [t for t in root.iter("text") if t.get("class") == "name"]
    assert [t.text for t in named] == [
        "feedback",
        "180°",
        "link",
        f"−{link:.1f}°",
        "lead",
        f"+{lead:.1f}°",
        "phase margin",
        f"{180 - link + lead:.1f}°",
    ]
    assert [float(t.get("y", "")) for t in named[::2]] == [41.0, 67.0, 93.0, 119.0]
    assert (
        'x="50%"' in drawn.inline()
        and drawn.xlabel == "phase at the gain crossover at 20 g"
    )


# --- faults as a map --------------------------------------------------------------------------------------


def outcome(
    fault: str,
    severity: int,
    payload: float,
    seed: int,
    *failed: str,
    mode: str = "run",
) -> Outcome:
    checks = tuple(Check(name, 1.3, 1.1, passed=False) for name in failed)
    return Outcome(
        Case(fault, severity, payload, "mid", seed),
        checks,
        0.1,
        0.1,
        0.0,
        mode,
        "none",
        0,
    )


def test_the_map_of_faults_has_a_cell_for_every_severity_and_payload() -> None:
    table = FaultTable(
        (
            outcome("F09", 1, 0.02, 1),
            outcome("F09", 1, 0.02, 2),
            outcome("F11", 1, 0.02, 1, "G1 finite"),
            outcome("F11", 1, 0.02, 2),
            outcome("F11", 2, 0.04, 1, "peak over clean"),
        ),
        {"command": "c"},
    )
    assert fleets.fault_columns(table) == ("severity 1, 20 g", "severity 2, 40 g")
    assert fleets.fault_counts(table) == [
        (GROUPS[3], 3, 1),
        (GROUPS[2], 2, 0),
        (GROUPS[1], 1, 0),
        (GROUPS[0], 0, 1),
    ]
    worst, fine = fleets.fault_rows(table)
    assert (worst.number, worst.group, worst.level, worst.runs, worst.failed) == (
        "F11",
        "unsafe",
        3,
        3,
        2,
    )
    assert [(cell.level, cell.sign, cell.words) for cell in worst.cells] == [
        (3, "✗", "severity 1, 20 g: unsafe, 1 of 2 runs"),
        (1, "!", "severity 2, 40 g: slower than promised, 1 of 1 runs"),
    ]
    assert [(cell.level, cell.sign, cell.words) for cell in fine.cells] == [
        (0, "✓", "severity 1, 20 g: met"),
        (-1, "", "severity 2, 40 g: not run"),
    ]
    assert (fine.number, fine.command, fine.cause) == (
        "F09",
        "",
        "",
    ) and "≤" in worst.required
    assert worst.command.startswith(
        "c --only F11 --severity 1 --payload 0.02 --phase mid --seed 1 --out"
    )


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
