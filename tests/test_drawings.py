"""Drawings read back: where every mark, tick, label and name lies, in hand-computed
dots and shares.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import SimpleNamespace
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
from fraclink.view._drawing import Figure, Panel, beside
from fraclink.view._marks import Frame
from fraclink.view._notebook import drawing, page_part, short
from fraclink.view._scales import Scale, envelope, nice_ticks

FRAME = Frame(Scale(0.0, 10.0), Scale(0.0, 100.0), top=24.0, height=150.0)


def tree(text: str) -> ElementTree.Element:
    """The elements of a drawing; what is not well-formed fails."""
    return ElementTree.fromstring(re.sub(r' xmlns="[^"]*"', "", text))  # our own  # noqa: S314


def texts(text: str) -> list[str]:
    """The texts of a drawing in their order."""
    return [found.text or "" for found in tree(text).iter("text")]


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


def test_a_scale_shows_all_that_is_finite_with_some_room() -> None:
    scale = Scale.around([0.0, 10.0, math.nan], [math.inf])
    assert (scale.low, scale.high) == pytest.approx((-0.6, 10.6))
    assert Scale.around([5.0, 5.2], least=1.0).low == pytest.approx(4.6)
    assert Scale.around([5.0, 5.2], least=1.0).high == pytest.approx(5.6)
    nothing = Scale.around([math.nan])
    assert (nothing.low, nothing.high) == pytest.approx((-0.06, 1.06))
    for level in (
        0.0,
        5.0,
        -2e-9,
        3e7,
    ):  # a record that stands still is drawn at half height
        flat = Scale.around([level, level])
        assert flat.low < level < flat.high and float(
            flat.share(level)
        ) == pytest.approx(0.5)
        shown = [text for _, text in flat.marks(5)]
        assert len(shown) == len(set(shown)) >= 2


def test_shares_of_a_scale_are_linear_or_logarithmic() -> None:
    assert Scale(-1.0, 3.0).share([-1.0, 0.0, 4.0]).tolist() == [0.0, 0.25, 1.25]
    assert Scale(1.0, 1000.0, log=True).share(
        [1.0, 10.0, 1000.0]
    ).tolist() == pytest.approx([0, 1 / 3, 1])


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


@pytest.mark.parametrize(
    ("low", "high", "most", "wanted"),
    [
        (1.0, 1000.0, 7, "1 10 100 1000"),
        (1.0, 50.0, 9, "1 2 5 10 20 50"),
        (0.5, 3.0, 5, "0.5 1 2"),
        (1e-6, 1e6, 3, "1×10⁻⁶ 0.001 1 1000 1×10⁶"),
    ],
)
def test_ticks_of_a_logarithmic_scale_are_powers_of_ten(
    low: float, high: float, most: int, wanted: str
) -> None:
    found = Scale(low, high, log=True).marks(most)
    assert [text for _, text in found] == wanted.split()
    assert [math.log10(value) % 1 for value, _ in found] == pytest.approx(
        [
            math.log10(float(text[0] if text[0] != "0" else text[-1]))
            for _, text in found
        ]
    )


def test_stated_ticks_are_kept() -> None:
    assert Scale(0.0, 1.0, ticks=((0.5, "half"),)).marks(9) == ((0.5, "half"),)
    assert Scale(0.0, 1.0, ticks=()).marks(9) == ()


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


def test_places_across_are_shares_and_places_down_are_dots() -> None:
    assert [FRAME.across(value) for value in (0.0, 2.5, 3.3333)] == [
        "0%",
        "25%",
        "33.33%",
    ]
    assert [FRAME.down(value) for value in (0.0, 25.0, 100.0)] == [174.0, 136.5, 24.0]
    assert [FRAME.down(value) for value in (-1.0, 200.0, math.nan)] == [
        174.0,
        24.0,
        174.0,
    ]


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


@pytest.mark.parametrize(
    ("mark", "style"),
    [
        (marks.Curve([0, 10], [0, 100], 2), "c2 d2"),
        (marks.Curve([0, 10], [0, 100], 3, dashed=False), "c3"),
        (marks.Curve([0, 10], [0, 100], 0, dashed=True), "c0 w"),
        (marks.Curve([0, 10], [0, 100], 4, weight="thin"), "c4 d4 thin"),
        (marks.Curve([0, 10], [0, 100]), "c1 d1"),
        (marks.Dots([0, 10], [0, 100]), "c0 dots"),
        (marks.Dots([0, 10], [0, 100], 2, large=True), "c2 dots large"),
    ],
)
def test_a_line_has_the_style_of_its_number(mark: Any, style: str) -> None:
    found = tree(mark.drawn(FRAME).curves)
    assert (found.tag, found.get("class"), found.get("data-name")) == (
        "path",
        style,
        None,
    )
    assert mark.drawn(FRAME).ends == ()


def test_a_curve_is_named_where_it_leaves_the_panel() -> None:
    named = marks.Curve(
        [0.0, 5.0, 10.0, 12.0], [0.0, 50.0, 75.0, 100.0], 2, "a < b"
    ).drawn(FRAME)
    assert named.ends == (
        (FRAME.down(75.0), "a < b", "c2 d2"),
    )  # the value behind the edge is not seen
    assert tree(named.curves).get("data-name") == "a < b"
    assert marks.Curve(5.0, [0.0, 20.0], name="upright").drawn(FRAME).ends[0][
        0
    ] == FRAME.down(20.0)
    filled = marks.Curve([0, 10, 10], [0, 0, 100], 3, weight="fill", name="none").drawn(
        FRAME
    )
    assert filled.ends == () and filled.curves == ""
    assert filled.below == '<path class="b3" d="M0 2000l4000 0 0-2000z"/>'


def test_a_band_runs_there_on_its_upper_edge_and_back_on_the_lower() -> None:
    band = marks.Band([0, 10], [25, 50], 75.0, 2).drawn(FRAME)
    assert band.below == '<path class="b2" d="M0 500l4000 0L4000 1000l-4000 500z"/>'
    assert marks.Band([0, 10], [1, 1], [math.nan, math.nan]).drawn(FRAME).below == ""


def test_bars_stand_on_zero_between_their_edges() -> None:
    text = marks.Bars([0, 5, 10], [50, 100]).drawn(FRAME).below
    outline = points(re.findall(r'd="([^"]*)"', text)[0])[0]
    assert outline == [
        (0, 2000),
        (0, 1000),
        (2000, 1000),
        (2000, 0),
        (4000, 0),
        (4000, 2000),
    ]
    assert 'class="b1 full"' in text


def test_cells_are_runs_of_one_level_in_each_row() -> None:
    levels = np.array([[0, 0, 1], [-1, 2, 2]])
    cells = marks.Cells(
        np.array([0.0, 2.5, 5.0, 10.0]), np.array([0.0, 50.0, 100.0]), levels
    )
    assert cells.drawn(FRAME).below == (
        '<path class="l0" d="M0 2000H2000V1000H0z"/>'
        '<path class="l1" d="M2000 2000H4000V1000H2000z"/>'
        '<path class="l2" d="M1000 1000H4000V0H1000z"/>'
    )


def test_zones_levels_and_places_span_the_panel() -> None:
    assert marks.Zone(2.5, 20.0).drawn(FRAME).below == (
        '<rect class="zone" x="25%" width="75%" y="24.0" height="150.0"/>'
    )
    assert marks.Zone(25.0, 50.0, lying=True).drawn(FRAME).below == (
        '<rect class="zone" x="0" width="100%" y="99.0" height="37.5"/>'
    )
    assert marks.Across(50.0, "limit").drawn(FRAME).above == (
        '<line class="limit" x2="100%" y1="99.0" y2="99.0"/><text class="halo" x="4" y="95.0">limit</text>'
    )
    assert marks.Across(0.0, limit=False).drawn(FRAME).above == (
        '<line class="zero" x2="100%" y1="174.0" y2="174.0"/>'
    )
    line = '<line class="limit" x1="55%" x2="55%" y1="24.0" y2="174.0"/>'
    right = line + '<text class="halo" x="55%" y="35.0" dx="4">here</text>'
    left = (
        line
        + '<text class="halo" x="55%" y="35.0" text-anchor="end" dx="-4">here</text>'
    )
    assert marks.Upright(5.5, "here").drawn(FRAME).above == right
    assert marks.Upright(5.5, "here", left=True).drawn(FRAME).above == left
    assert marks.Upright(5.5).drawn(FRAME).above == line
    assert 'text-anchor="end"' in marks.Upright(5.6, "x").drawn(FRAME).above
    assert (
        'text-anchor="end"'
        not in marks.Upright(5.6, "x", left=False).drawn(FRAME).above
    )


@pytest.mark.parametrize(
    ("sign", "shape"),
    [
        ("dot", '<circle class="f2" r="4"/>'),
        ("ring", '<circle class="c2 ring" r="6"/>'),
        ("cross", '<path class="c2 cross" d="M-6-6l12 12m0-12l-12 12"/>'),
    ],
)
def test_a_point_keeps_its_shape_and_its_text_stays_inside(
    sign: str, shape: str
) -> None:
    at = marks.Point(2.5, 50.0, "a", 2, sign).drawn(FRAME).above
    text = '<text class="halo name" x="9" y="-5">a</text>'
    assert at == f'<svg x="25%" y="99.0" overflow="visible">{shape}{text}</svg>'
    assert (
        'text-anchor="end" x="-9"'
        in marks.Point(8.0, 50.0, "a", 2, sign).drawn(FRAME).above
    )
    assert "<text" not in marks.Point(8.0, 50.0).drawn(FRAME).above


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


def test_panels_stand_over_one_another_on_one_scale() -> None:
    """24 above the first, 34 below each, the ticks 17 and the title 36 below the last."""
    root = tree(figure().inline())
    assert (root.get("id"), root.get("role"), root.get("aria-label")) == (
        "fig-try",
        "img",
        "what <it> is",
    )
    assert (root.get("data-x"), root.get("data-link")) == ("0 10", "time")
    right = 38 + 6.7 * len("line")
    assert root.get("style") == f"height:352px;padding:0 {right:g}px 0 46px"
    boxes = [found for found in root.iter("svg") if found.get("class") == "box"]
    assert [(b.get("y"), b.get("height"), b.get("data-y")) for b in boxes] == [
        ("24.0", "150.0", "0 100"),
        ("208.0", "100.0", "-1 1"),
    ]
    assert all(
        b.get("viewBox") == "0 0 4000 2000" and b.get("width") == "100%" for b in boxes
    )
    labels = [
        (t.text, t.get("x"), t.get("y"))
        for t in root.iter("text")
        if t.get("class") == "label"
    ]
    assert labels == [("upper [V]", "-42", "16.0"), ("lower", "-42", "200.0")]
    bases = [t.get("y1") for t in root.iter("line") if t.get("class") == "base"]
    assert bases == ["174.0", "308.0"]
    below = [
        (t.text, t.get("x"), t.get("y"), t.get("class"))
        for t in root.iter("text")
        if t.get("y") == "325.0"
    ]
    assert [entry[0] for entry in below] == [
        "0",
        "2",
        "4",
        "6",
        "8",
        "10",
    ]  # of the last panel alone
    assert [entry[1] for entry in below] == ["0%", "20%", "40%", "60%", "80%", "100%"]
    assert [entry[3] for entry in below] == 3 * [
        None,
        "alt",
    ]  # every second goes where there is no room
    title = next(t for t in root.iter("text") if t.get("class") == "axis")
    assert (title.text, title.get("x"), title.get("y")) == ("time [s]", "50%", "344")
    up = [(t.text, t.get("y")) for t in root.iter("text") if t.get("x") == "-6"]
    assert up[:5] == [
        ("0", "178.0"),
        ("25", "140.5"),
        ("50", "103.0"),
        ("75", "65.5"),
        ("100", "28.0"),
    ]
    grid = [
        t
        for t in root.iter("line")
        if t.get("class") == "grid" and t.get("x1") == "20%"
    ]
    assert [(t.get("y1"), t.get("y2")) for t in grid] == [
        ("24.0", "174.0"),
        ("208.0", "308.0"),
    ]


def test_a_figure_without_names_titles_and_with_a_key_takes_the_room_it_needs() -> None:
    plain = figure(panels=(figure().panels[1],), xlabel="", link="", left=66.0)
    root = tree(plain.inline())
    assert (
        root.get("style") == "height:148px;padding:0 14px 0 66px"
        and root.get("data-link") == "try"
    )
    assert (
        next(t for t in root.iter("text") if t.get("class") == "label").get("x")
        == "-42"
    )
    keyed = tree(
        figure(panels=(figure().panels[1],), key=("share", "low", "high")).inline()
    )
    assert keyed.get("style", "").startswith("height:208px")
    squares = [
        (r.get("class"), r.get("x"), r.get("y"))
        for r in keyed.iter("rect")
        if r.get("width") == "14"
    ]
    assert squares == [("l0", "0%", "190"), ("l1", "25%", "190")]
    named = [
        (t.text, t.get("x"), t.get("y"))
        for t in keyed.iter("text")
        if t.get("class") == "name"
    ]
    assert named == [
        ("share", None, "182"),
        ("low", "0%", "201"),
        ("high", "25%", "201"),
    ]
    logs = Figure(
        "l",
        "",
        Scale(1.0, 100.0, log=True),
        (Panel("", Scale(1.0, 10.0, log=True), ()),),
    )
    assert tree(logs.inline()).get("data-x") == "1 100 log"
    assert 'data-y="1 10 log"' in logs.inline() and 'class="label"' not in logs.inline()


def test_a_file_is_as_large_as_its_panels_and_has_its_own_style() -> None:
    root = tree(figure().alone())
    assert (root.get("width"), root.get("height"), root.get("viewBox")) == (
        "860",
        "372",
        "0 0 860 372",
    )
    nested = next(found for found in root if found.tag == "svg")
    right = 38 + 6.7 * len("line")
    assert [nested.get(name) for name in ("x", "y", "width", "height")] == [
        "46",
        "10",
        f"{814 - right:g}",
        "352",
    ]
    assert root.find("style") is not None and "var(" not in (
        root.find("style").text or ""
    )
    square = figure(panels=(figure().panels[1],), rigid=True)
    root = tree(square.alone())
    assert (
        next(found for found in root if found.tag == "svg").get("width") == "100"
    )  # as wide as high
    inline = square.inline()
    assert (
        "<style>" not in inline
        and "ground" not in inline
        and ' id="fig-try" role="img"' in inline
    )


def test_figures_beside_one_another_are_as_wide_as_they_say() -> None:
    one = figure(width=280.0, left=12.0, panels=(figure().panels[1],))
    text = beside([one, one], "two")
    root = tree(text)
    assert (root.get("width"), root.get("height"), root.get("aria-label")) == (
        "560",
        "188",
        "two",
    )
    places = [(b.get("x"), b.get("width")) for b in root if b.tag == "svg"]
    assert places == [("12", "254"), ("292", "254")]


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


def test_a_line_without_a_name_has_no_end_and_dots_have_a_dot_for_a_key() -> None:
    panel = Panel(
        "", Scale(0.0, 100.0), [marks.Dots([0, 10], [50, 50], 2, "dots")], 150.0
    )
    root = tree(Figure("n", "", Scale(0.0, 10.0), (panel,)).inline())
    key = next(line for line in root.iter("line") if line.get("class") == "c2 dots")
    assert (key.get("x1"), key.get("x2")) == ("14.4", "14.5")
    bare = Panel("", Scale(0.0, 100.0), [marks.Curve([0, 10], [50, 50])], 150.0)
    root = tree(Figure("n", "", Scale(0.0, 10.0), (bare,)).inline())
    assert all(found.get("x") != "100%" for found in root.iter("svg"))


def test_what_is_below_is_drawn_first() -> None:
    mixed = [
        marks.Curve([0, 10], [0, 1]),
        marks.Band([0, 10], 0.0, 1.0),
        marks.Zone(0.0, 1.0),
        marks.Across(0.5),
    ]
    text = Figure(
        "o", "", Scale(0.0, 10.0), (Panel("", Scale(0.0, 1.0), mixed),)
    ).inline()
    order = [
        text.index(part)
        for part in (
            'class="zone"',
            'class="grid"',
            'class="b1"',
            'class="c1 d1"',
            'class="base"',
            'class="limit"',
        )
    ]
    assert order == sorted(order)
    raw = Panel(
        "",
        Scale(0.0, 1.0),
        (),
        raw=lambda frame: f"<g id='{frame.top:g} {frame.height:g}'/>",
    )
    assert "<g id='24 150'/>" in Figure("r", "", Scale(0.0, 1.0), (raw,)).inline()


@pytest.mark.parametrize(
    ("width", "ticks", "most"),
    [(860.0, 9, 9), (160.0, 9, 3), (400.0, 9, 5), (860.0, 4, 4)],
)
def test_a_narrow_figure_has_fewer_ticks(width: float, ticks: int, most: int) -> None:
    panel = Panel("", Scale(0.0, 1.0, ticks=()), (), 60.0)
    found = texts(
        Figure("t", "", Scale(0.0, 1.0), (panel,), width=width, ticks=ticks).inline()
    )
    assert found == [text for _, text in nice_ticks(0.0, 1.0, most)]


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


def test_payloads_are_told_with_the_nominal_one_where_it_lies_inside(
    design: fl.Design,
) -> None:
    from dataclasses import replace

    assert loops.payloads_of(design) == [0.02, 0.03, 0.04]
    for nominal in (0.02, 0.04):
        rig = replace(
            design.rig, payloads=replace(design.rig.payloads, nominal=nominal)
        )
        assert loops.payloads_of(replace(design, rig=rig)) == [0.02, 0.04]


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


# --- drawings of many runs --------------------------------------------------------------------------------


def test_a_histogram_has_a_bar_of_its_own_for_never() -> None:
    values = {name: np.linspace(0.5, 1.5, 101) for name in fleets.SHOWN}
    values["settling_time"] = np.append(np.linspace(0.5, 1.5, 96), np.full(4, np.inf))
    figures = {drawn.name: drawn for drawn in fleets.spread_figures(values)}
    drawn = figures["spread-settling_time"]
    bars, never, *rest = drawn.panels[0].marks
    assert sum(np.asarray(bars.heights)) == 96 and len(bars.heights) == 40
    assert (never.edges[0], never.edges[1]) == pytest.approx(
        (1.5 + (1.5 - 0.5) / 12, 1.5 + 2 * (1.5 - 0.5) / 12), abs=2e-3
    )
    assert (never.heights, never.line) == ([4], 2)
    assert [mark.text for mark in rest] == ["never: 4 %", "median", ""]
    assert rest[1].value == pytest.approx(1.0) and rest[2].value == pytest.approx(1.45)
    assert drawn.panels[
        0
    ].label == "settling time [s]" and drawn.description.startswith(
        "Histogram of the settling time of 100 runs; 4 never"
    )
    assert drawn.panels[0].y.high == pytest.approx(1.15 * max(np.max(bars.heights), 4))
    plain = figures["spread-overshoot"]
    assert [mark.text for mark in plain.panels[0].marks[1:]] == ["median", "95 %"]
    assert plain.panels[0].label == "overshoot [%]" and plain.panels[0].marks[
        1
    ].value == pytest.approx(100.0)
    assert plain.x.low == pytest.approx(50.0) and plain.x.high == pytest.approx(
        150.0, abs=0.2
    )


def test_cells_of_too_few_runs_are_empty_and_the_others_show_their_share() -> None:
    across = np.repeat([0.5, 1.5, 2.5], 300)
    up = np.tile(np.repeat([0.5, 1.5, 2.5], 100), 3)
    failed = np.zeros(900, dtype=bool)
    failed[:9] = True  # 9 % of the first cell
    failed[100:110] = True  # 10 %
    failed[200:230] = True  # 30 %
    failed[300:329] = True  # 29 %
    keep = np.ones(900, dtype=bool)
    keep[829:900] = False  # 29 runs in the last cell
    drawn = fleets.failures_figure(
        across[keep], up[keep], failed[keep], ("payload", "delay")
    )
    cells = drawn.panels[0].marks[0]
    assert cells.levels.shape == (3, 3)
    assert cells.levels.tolist() == [
        [1, 2, 0],
        [2, 0, 0],
        [3, 0, -1],
    ]  # a limit belongs to the cells above
    assert drawn.key == (
        "runs that fail [%]",
        "below 1",
        "1 to 10",
        "10 to 30",
        "above 30",
    )
    assert (
        drawn.xlabel == "payload; cells of fewer than 30 runs are empty"
        and drawn.panels[0].label == "delay"
    )


# --- what a prompt and a cell show ------------------------------------------------------------------------


def test_a_long_result_is_one_line_of_a_prompt() -> None:
    log = fl.Experiment(
        period=0.004, motor_angle=[0, 0.1], output=[0, 0.01], source=150 * "x" + ".csv"
    )
    text = short(log)
    assert text == f"Experiment({109 * 'x'}…)"
    assert short(
        fl.Experiment(
            period=0.004, motor_angle=[0, 0.1], output=[0, 0.01], source=110 * "x"
        )
    ) == (f"Experiment({110 * 'x'})")


@pytest.mark.slow
def test_a_cell_has_the_drawing_below_the_table(design: fl.Design) -> None:
    from fraclink.view._views import view

    assert page_part(design) == view(design)._repr_html_() + "\n" + str(drawing(design))
    law = design.law()
    assert drawing(law) is None and page_part(law) == view(law)._repr_html_()
    assert "follows within 50 ms" in str(drawing(design.rig))


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


# --- can the model be trusted -----------------------------------------------------------------------------


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


def fit(
    name: str = "UD-FOM", size: float = 0.1, samples: int = 100, fitted: int = 60
) -> Any:
    """A fit of so many samples whose residual has this size."""
    residual = size * np.cos(np.arange(samples))
    return SimpleNamespace(
        structure=name, period=0.01, samples=samples, fitted_samples=fitted, output_kind="torque",
        predicted=np.sin(0.1 * np.arange(samples)), residual=residual,
    )  # fmt: skip


def test_the_sketch_of_the_arm_bends_against_its_turn() -> None:
    from fraclink.view._sketches import arm_sketch, loop_sketch

    root = tree(arm_sketch(("one", "two", "three")))
    assert (root.get("width"), root.get("height")) == ("425", "214")
    beam = next(path for path in root.iter("path") if path.get("class") == "beam").get(
        "d", ""
    )
    bent = np.array([[float(n) for n in pair.split()] for pair in beam[1:].split("L")])
    assert bent[0] == pytest.approx([70.0, 158.0]) and len(bent) == 25
    along = np.array([math.cos(math.radians(26)), -math.sin(math.radians(26))])
    out, aside = (
        (bent - bent[0]) @ along,
        (bent - bent[0]) @ np.array([along[1], -along[0]]),
    )
    share = out / 300.0
    assert share[-1] == pytest.approx(1.0, abs=1e-3)
    assert np.abs(aside) == pytest.approx(
        300 * 0.16 * share**2 * (3 - share) / 2, abs=0.1
    )
    load = next(c for c in root.iter("circle") if c.get("class") == "f2")
    assert (float(load.get("cx", "")), float(load.get("cy", ""))) == pytest.approx(
        tuple(bent[-1]), abs=0.1
    )
    assert load.get("r") == "12" and float(load.get("cy", "")) > 158.0 - 300 * math.sin(
        math.radians(26)
    )
    said = texts(arm_sketch(("one", "two", "three")))
    assert said == [
        "θm",
        "θt",
        "motor and encoder: one",
        "strain gauge: torque Γ, two",
        "payload m: three",
    ]
    assert texts(arm_sketch())[2:] == [
        "motor and encoder: voltage u in, angle θm out",
        "strain gauge: torque Γ",
        "payload m",
    ]
    loop = tree(loop_sketch())
    boxes = [
        (r.get("x"), r.get("y"), r.get("width"))
        for r in loop.iter("rect")
        if r.get("class") == "card"
    ]
    assert boxes == [
        ("100", "44", "126"),
        ("300", "44", "126"),
        ("462", "44", "126"),
        ("296", "156", "296"),
    ]
    heads = [p.get("d") for p in loop.iter("path") if p.get("class") == "f0 head"]
    assert (
        heads[0] == "M64 70L57 66L57 74z" and "M500 155L496 148L504 148z" in heads
    )  # to the right, and down
    assert heads[-1] == "M74 80L78 87L70 87z" and len(heads) == 10  # up, into the sum
    assert texts(loop_sketch()) == [
        *(
            "θt*",
            "reference",
            "−",
            "+",
            "correction",
            "k_d s^β, filtered",
            "motor loop",
            "hold and delay",
            "arm",
        ),
        *("link and payload", "θm*", "u", "θt", "estimate of the tip: θm − Γ/c"),
        *("sampled every Ts; the gauge is late and noisy", "θm", "Γ"),
    ]
