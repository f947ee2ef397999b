"""How sure a structure's parameters are, each finding at its threshold, and what a user
states of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
import fracsys
from fraclink._identify.expression import parse_expression
from fraclink._identify.least_squares import (
    QUANTILE,
    Interval,
)
from fraclink._identify.structure_certainty import (
    Certainty,
    _blind,
    _corners,
    _is_at_bound,
    _is_known,
    _of_rivals,
    _of_the_band,
    _of_the_error,
    _of_the_parameters,
    _straight_interval,
    in_order,
    structure_findings,
)
from fraclink._identify.structure_problem import (
    Lines,
    StructureCoordinates,
)
from fraclink._identify.structure_search import Place
from fraclink.errors import FieldError, LogError
from fraclink.findings import Finding
from fracsys._terms import Term

Array = NDArray[np.float64]
LIMITS = {"order": (0.02, 4.0), "delay": (0.0, 10.0), "coefficient": (1e-12, 1e12)}
LINK = "k*s**a/(s**a + w)*exp(-T*s)"


def coordinates(
    text: str, fixed: dict[str, float] | None = None, **limits: Any
) -> StructureCoordinates:
    structure = parse_expression(text)
    return StructureCoordinates(
        structure,
        {n: limits.get(n, LIMITS[r]) for n, r in structure.roles.items()},
        fixed or {},
    )


# --- how sure -----------------------------------------------------------------------------------------------


def test_a_bound_is_met_within_a_ten_millionth_of_the_range() -> None:
    own = coordinates("k/(s**a + w)", w=(-1.0, 1.0))
    for value, told in (
        (0.02, True),
        (0.02 + 3e-7, True),
        (0.02 + 6e-7, False),
        (4.0, True),
        (1.0, False),
    ):
        assert _is_at_bound(own, "a", value) is told
    assert _is_at_bound(own, "k", 1e-12) and _is_at_bound(own, "k", 0.0)
    assert not _is_at_bound(own, "k", 1e-11)
    assert _is_at_bound(own, "w", -1.0) and not _is_at_bound(own, "w", 0.0)


def test_directions_that_are_not_seen() -> None:
    rng = np.random.default_rng(0)
    a, b, c = rng.normal(size=(3, 50))
    for unit in (1.0, 1e-8, 1e8):  # in whichever unit it was measured
        assert _blind(unit * np.stack([a, b, c]), ("a", "b", "c")) == ()
    assert _blind(np.stack([a, 2 * a, c]), ("a", "b", "c")) == ("a", "b")
    assert _blind(np.stack([a, b, np.zeros(50)]), ("a", "b", "c")) == ("c",)
    assert _blind(np.stack([a, b, a + b]), ("a", "b", "c")) == ("a", "b", "c")
    # A row behind the names is a constant output: it has no name, and may hide a
    # parameter.
    assert _blind(np.stack([a, np.ones(50), 3 * np.ones(50)]), ("a", "b")) == ("b",)


def test_what_an_interval_determines() -> None:
    own = coordinates(LINK)

    def known(
        name: str,
        value: float,
        low: float,
        high: float,
        *,
        below: bool = False,
        above: bool = False,
    ) -> bool:
        return _is_known(own, name, value, Interval(low, high, below, above))

    assert known("a", 1.0, 0.76, 1.25) and not known("a", 1.0, 0.74, 1.25)
    assert known("k", 10.0, 6.0, 15.9) and not known("k", 10.0, 6.0, 16.1)
    assert known("T", 0.1, 0.0, 9.0, below=True) and not known(
        "T", 0.1, 0.0, 9.0, above=True
    )
    assert not known("a", 1.0, 0.9, 1.1, below=True) and not known(
        "k", 1.0, 0.9, 1.1, above=True
    )


def test_the_interval_of_a_parabola() -> None:
    own = coordinates("k/(s**a + w)")
    straight = _straight_interval(own, "a", 1.5, 0.2)
    assert (straight.low, straight.high) == (pytest.approx(1.3), pytest.approx(1.7))
    assert not straight.low_open and not straight.high_open
    cut = _straight_interval(own, "a", 3.9, 0.2)
    assert (cut.high, cut.low_open, cut.high_open) == (4.0, False, True)
    logarithmic = _straight_interval(own, "k", 10.0, 0.1)
    assert logarithmic.low == pytest.approx(10.0 * math.exp(-0.1))
    assert logarithmic.high == pytest.approx(10.0 * math.exp(0.1))


def test_terms_that_may_change_names() -> None:
    own = coordinates("1/(a2*s**n2 + a1*s**n1 + a0)")
    values = {"a2": 0.5, "n2": 0.9, "a1": 0.8, "n1": 2.2, "a0": 1.0}
    found = in_order(own, Place(values, 0.0, 1.0, True)).values
    assert dict(found) == {"a2": 0.8, "n2": 2.2, "a1": 0.5, "n1": 0.9, "a0": 1.0}
    assert in_order(own, Place(found, 0.0, 1.0, True)).values == found
    # With limits of their own they are not the same: nothing is exchanged.
    other = coordinates("1/(a2*s**n2 + a1*s**n1 + a0)", n2=(0.02, 3.0))
    assert dict(in_order(other, Place(values, 0.0, 1.0, True)).values) == values
    apart = coordinates("s**m/(s**n + w)")
    rising = {"m": 0.5, "n": 0.9, "w": 1.0}
    assert dict(in_order(apart, Place(rising, 0.0, 1.0, True)).values) == rising


def test_corners_of_asymptotes() -> None:
    """s² + 10 s + 1: the terms are equal at 0.1 and at 10 rad/s; a small middle term
    leaves one corner.
    """
    terms = [Term(1.0, 2.0), Term(10.0, 1.0), Term(1.0, 0.0)]
    assert sorted(_corners(terms)) == pytest.approx([0.1, 10.0])
    assert _corners([Term(1.0, 2.0), Term(0.1, 1.0), Term(9.0, 0.0)]) == pytest.approx(
        [3.0]
    )
    assert _corners([Term(4.0, 1.0)]) == []
    assert _corners([Term(1.0, 1.0), Term(1e300, 0.999)]) == [math.exp(200.0)]


# --- findings of a structure's fit --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fit() -> fl.extend.StructureFit:
    """A good fit to lines, to be changed."""
    w = np.geomspace(0.1, 100.0, 60)
    noise = 1 + 0.01 * np.random.default_rng(0).normal(size=60)
    data = fl.FrequencyResponse(w, (2 / (fracsys.s**0.8 + 3))(1j * w) * noise)
    return fl.identify_structure(data, "k/(s**a + b)")


def certain(**changes: Any) -> Certainty:
    return replace(Certainty({}, {}, (), (), (), {}), **changes)


def one(findings: Iterable[Finding]) -> Finding:
    (found,) = list(findings)
    return found


def codes(findings: Iterable[Finding]) -> list[str]:
    return [finding.code for finding in findings]


def test_a_parameter_at_a_bound_or_not_seen(fit: fl.extend.StructureFit) -> None:
    assert list(_of_the_parameters(fit, certain())) == []
    stuck = one(_of_the_parameters(replace(fit, at_bound=("a",)), certain()))
    assert (stuck.code, stuck.severity) == ("W351", "error")
    assert stuck.evidence == {"value": fit.parameters["a"], "low": 0.02, "high": 4.0}
    delay = replace(fit, at_bound=("a",), limits={**fit.limits, "a": (0.0, 1e7)})
    assert (
        one(_of_the_parameters(delay, certain())).severity == "warning"
    )  # a delay of zero is no fault
    blind = one(
        _of_the_parameters(
            replace(fit, undetermined=("k", "b")), certain(blind=("k", "b"))
        )
    )
    assert (blind.code, blind.severity) == ("W352", "error")
    assert "k, b only in combination" in blind.message
    assert blind.evidence == {name: fit.parameters[name] for name in ("k", "b")}
    vague = one(_of_the_parameters(replace(fit, undetermined=("a",)), certain()))
    assert (vague.code, vague.severity) == ("W353", "error")
    interval = fit.intervals["a"]
    assert vague.evidence == {
        "value": fit.parameters["a"],
        "low": interval.low,
        "high": interval.high,
    }
    for related, told in ((0.991, True), (-0.991, True), (0.989, False)):
        found = list(_of_the_parameters(fit, certain(pairs={("k", "a"): related})))
        assert codes(found) == ["W354"] * told
        assert not told or found[0].evidence == {"correlation": related}
    assert not list(
        _of_the_parameters(fit, certain(pairs={("k", "a"): 1.0}, blind=("a",)))
    )[1:]
    early = one(
        _of_the_parameters(replace(fit, converged=False, evaluations=99), certain())
    )
    assert (early.code, early.severity, early.evidence) == (
        "W359",
        "error",
        {"evaluations": 99.0},
    )


@pytest.mark.parametrize(
    ("nmse", "held", "told"),
    [
        (0.249, None, []),
        (0.251, None, [("W355", "error")]),
        (0.01, 0.0399, []),
        (0.01, 0.0401, [("W356", "warning")]),
        (0.06, 0.249, [("W356", "warning")]),
        (0.06, 0.251, [("W356", "error")]),
        (1e-14, 9e-13, []),
        (1e-14, 1.1e-12, [("W356", "warning")]),
    ],
)
def test_the_error_seen_and_held_out(
    fit: fl.extend.StructureFit,
    nmse: float,
    held: float | None,
    told: list[tuple[str, str]],
) -> None:
    found = list(_of_the_error(replace(fit, nmse=nmse, heldout_nmse=held)))
    assert [(finding.code, finding.severity) for finding in found] == told
    if told and told[0][0] == "W356":
        assert found[0].evidence == {"heldout_nmse": held, "nmse": nmse}
    elif told:
        assert found[0].evidence == {"nmse": nmse, "most": 0.25}


def test_another_valley_that_fits_as_well_is_told(fit: fl.extend.StructureFit) -> None:
    weight = 1 / np.abs(fit.measured[:60] + 1j * fit.measured[60:])
    # A power of 9 and not of 1: costs are those of the data, whatever their scale.
    data = Lines.of(
        fit.place, fit.measured[:60] + 1j * fit.measured[60:], 3 * weight / np.sqrt(60)
    )
    cost = fit.nmse * float(data.measured @ data.measured)
    far = {name: 2.0 * value for name, value in fit.parameters.items()}

    def said(
        ratio: float, values: dict[str, float], inflation: float = 1.0
    ) -> list[Finding]:
        rival = Place(values, 0.0, cost * ratio, True)
        return list(_of_rivals(fit, certain(inflation=inflation), [rival], data))

    edge = math.exp(QUANTILE**2 / 120)  # 120 numbers: n ln(ratio) at the quantile
    found = one(said(1.0 + 0.99 * (edge - 1.0), far))
    assert (found.code, found.severity, found.evidence) == ("W357", "error", far)
    assert said(1.0 + 1.01 * (edge - 1.0), far) == []
    assert codes(said(1.0 + 1.01 * (edge - 1.0), far, inflation=2.0)) == ["W357"]
    assert said(1.0, dict(fit.parameters)) == []
    only = {**fit.parameters, "a": 3.0}
    assert one(said(1.0, only)).evidence == {"a": 3.0}


def test_a_corner_outside_of_the_band_is_told(fit: fl.extend.StructureFit) -> None:
    corner = fit.parameters["b"] ** (1 / fit.parameters["a"])
    h = np.ones(2, complex)

    def said(low: float, high: float) -> list[Finding]:
        return list(_of_the_band(fit, Lines.of(np.array([low, high]), h, np.ones(2))))

    assert said(corner / 9, corner / 2.9) == said(2.9 * corner, 9 * corner) == []
    below = one(said(corner / 9, corner / 3.1))
    assert (below.code, below.severity) == ("W358", "warning")
    assert below.evidence == {
        "corner": pytest.approx(corner, rel=1e-5),
        "low": pytest.approx(corner / 9),
        "high": pytest.approx(corner / 3.1),
    }
    assert codes(said(3.1 * corner, 9 * corner)) == ["W358"]
    stuck = replace(fit, at_bound=("b",))
    assert (
        list(_of_the_band(stuck, Lines.of(np.array([1e3, 1e4]), h, np.ones(2)))) == []
    )


def test_findings_are_listed_worst_first(fit: fl.extend.StructureFit) -> None:
    data = Lines.of(
        np.array([1e3, 1e4]), np.ones(2, complex), np.ones(2)
    )  # the corner lies far below
    changed = replace(fit, undetermined=("a",), nmse=0.3)
    found = structure_findings(changed, certain(pairs={("k", "b"): 0.999}), [], data)
    assert [(finding.code, finding.severity) for finding in found] == [
        ("W353", "error"), ("W355", "error"), ("W354", "warning"), ("W358", "warning"),
    ]  # fmt: skip


def test_a_fit_in_words(fit: fl.extend.StructureFit) -> None:
    intervals = {
        "k": Interval(1.9, 2.1, False, False),
        "b": Interval(1.0, 9.0, False, False),
    }
    shown = replace(
        fit, parameters={"k": 2.0, "a": 0.8, "b": 3.0}, fixed=(), at_bound=("a",), undetermined=("b",),
        intervals=intervals, nmse=0.0123, heldout_nmse=None, findings=(),
    )  # fmt: skip
    assert str(shown).split("\n") == [
        "k/(s**a + b)",
        "k = 2, 95 % 1.9 to 2.1",
        "a = 0.8 (at its bound)",
        "b = 3 (not determined)",
        "error 1.23 % (NMSE), nothing held out",
    ]
    assert repr(shown) == "StructureFit(k/(s**a + b): k = 2, a = 0.8, b = 3)"
    given = str(replace(shown, fixed=("a",), heldout_nmse=0.0456))
    assert "a = 0.8 (given)" in given
    assert "held-out error 4.56 %" in given
    assert not replace(shown, findings=(Finding("W351", "error", "m", {}, "r"),)).passed
    assert replace(shown, findings=(Finding("W351", "warning", "m", {}, "r"),)).passed


# --- what a user states -------------------------------------------------------------------------------------

LAG = "k/(s**a + w)"


def swept(count: int = 40) -> fl.FrequencyResponse:
    w = np.geomspace(0.1, 30.0, count)
    return fl.FrequencyResponse(w, (2 / (fracsys.s**1.2 + 1))(1j * w))


@pytest.mark.parametrize(
    ("options", "field", "value", "allowed"),
    [
        ({"fixed": {"q": 1.0}}, "fixed", "q", "k, a, w"),
        ({"start": {"a": 1.0}}, "start", "w", "a, w"),
        ({"start": {"a": 5.0, "w": 1.0}}, "start['a']", 5.0, "0.02 to 4"),
        ({"bounds": {"a": (1.0, 1.0)}}, "bounds['a']", (1.0, 1.0), "low < high"),
        ({"bounds": {"a": (-21.0, 1.0)}}, "bounds['a']", -21.0, "-20 to 20"),
        ({"bounds": {"a": (0.0, 20.1)}}, "bounds['a']", 20.1, "-20 to 20"),
        ({"bounds": {"w": (0.0, 1.1e15)}}, "bounds['w']", 1.1e15, "-1e15 to 1e15"),
        ({"fixed": {"w": -1.1e15}}, "fixed['w']", -1.1e15, "-1e15 to 1e15"),
        (
            {"fixed": {"k": 1.0, "a": 1.0, "w": 1.0}},
            "expression",
            LAG,
            ">= 1 free parameter",
        ),
        (
            {"weighting": "coherence"},
            "weighting",
            "coherence",
            "a response with coherence",
        ),
    ],
)
def test_what_is_stated_of_parameters(
    options: Any, field: str, value: Any, allowed: str
) -> None:
    with pytest.raises(FieldError) as caught:
        fl.identify_structure(swept(), LAG, **options)
    assert (caught.value.field, caught.value.value, caught.value.allowed) == (
        field,
        value,
        allowed,
    )


def test_what_is_stated_of_delays() -> None:
    late = "k/(s + w)*exp(-T*s)"
    for options, field, allowed in (
        ({"bounds": {"T": (-0.1, 1.0)}}, "bounds['T']", "0 to 1e6"),
        ({"fixed": {"T": -0.1}}, "fixed['T']", "0 to 1e15"),
    ):
        with pytest.raises(FieldError) as caught:
            fl.identify_structure(swept(), late, **options)  # type: ignore[arg-type]
        assert (caught.value.field, caught.value.allowed) == (field, allowed)
    fit = fl.identify_structure(swept(), late, details=False)
    assert fit.limits["T"] == (
        0.0,
        pytest.approx(20.0 / 30.0),
    )  # 20 rad at the highest line
    assert fit.limits["k"] == (1e-12, 1e12)


def test_five_numbers_for_each_parameter() -> None:
    assert (
        fl.identify_structure(swept(8), LAG, details=False).fitted == 8
    )  # 16 numbers for three parameters
    with pytest.raises(FieldError) as caught:
        fl.identify_structure(swept(7), LAG)
    assert (caught.value.field, caught.value.value) == ("data", 14)
    assert caught.value.allowed == ">= 15 numbers for 3 parameters"
    assert (
        fl.identify_structure(swept(7), LAG, fixed={"a": 1.2}, details=False).fitted
        == 7
    )


def test_weights_of_lines_and_what_was_held_out() -> None:
    data = swept()
    noisy_part = data.response * (1 + 0.01 * np.random.default_rng(0).normal(size=40))
    data = fl.FrequencyResponse(data.frequency, noisy_part)
    relative, absolute = (
        fl.identify_structure(data, LAG, weighting=kind, details=False)  # type: ignore[arg-type]
        for kind in ("relative", "absolute")
    )
    for fit, weight in ((relative, 1 / np.abs(data.response)), (absolute, np.ones(40))):
        h = fit.transfer_function(1j * data.frequency)
        wanted = np.sum(np.abs(weight * (data.response - h)) ** 2) / np.sum(
            np.abs(weight * data.response) ** 2
        )
        assert fit.nmse == pytest.approx(wanted, rel=1e-6)
        assert fit.predicted == pytest.approx(
            np.concatenate([h.real, h.imag]), rel=1e-9
        )
        assert fit.measured == pytest.approx(
            np.concatenate([data.response.real, data.response.imag])
        )
        assert fit.place == pytest.approx(data.frequency)
        assert (fit.domain, fit.period, fit.hold, fit.fitted, fit.offset) == (
            "frequency",
            None,
            None,
            40,
            0.0,
        )
    # Every fourth line from the third on, predicted by a fit to the others.
    held = np.arange(40) % 4 == 2
    rest = fl.FrequencyResponse(data.frequency[~held], data.response[~held])
    G = fl.identify_structure(rest, LAG, details=False).transfer_function
    error = (data.response[held] - G(1j * data.frequency[held])) / np.abs(
        data.response[held]
    )
    assert relative.heldout_nmse == pytest.approx(
        float(np.mean(np.abs(error) ** 2)), rel=1e-3
    )


@pytest.mark.slow
def test_figures_of_a_fit_to_a_recording() -> None:
    u = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 40), 25)
    noise = 0.01 * np.random.default_rng(2).normal(size=1000)
    y = (
        0.4
        + fracsys.time_response(2 / (fracsys.s**1.2 + 1), u, 0.02, hold="zero").output
        + noise
    )
    fit = fl.identify_structure(fl.extend.Recording(0.02, u, y), LAG, details=False)
    count = fit.fitted
    predicted = (
        fit.offset
        + fracsys.time_response(fit.transfer_function, u, 0.02, hold="zero").output
    )
    assert fit.predicted == pytest.approx(predicted, abs=1e-9)
    assert fit.measured == pytest.approx(y)
    assert fit.place == pytest.approx(0.02 * np.arange(1000))
    assert (fit.domain, fit.period, fit.hold, count) == ("time", 0.02, "zero", 600)
    error, power = (y - predicted) ** 2, (y - fit.offset) ** 2
    assert fit.nmse == pytest.approx(error[:600].sum() / power[:600].sum(), rel=1e-6)
    assert fit.heldout_nmse == pytest.approx(
        error[600:].sum() / power[600:].sum(), rel=1e-6
    )
    assert (
        fl.identify_structure(
            fl.extend.Recording(0.02, u, y), LAG, heldout=0.25, details=False
        ).fitted
        == 750
    )
    step = fl.extend.Recording(0.02, np.ones(1000), y)
    with pytest.raises(
        LogError
    ) as caught:  # a step is fitted as a whole; a constant output is none
        fl.identify_structure(replace(step, output=np.ones(1000)), LAG)
    assert (caught.value.field, caught.value.allowed) == ("output", "a motion")
    still = fl.extend.Recording(0.02, np.zeros(1000), y)
    with pytest.raises(LogError) as caught:
        fl.identify_structure(still, LAG)
    assert (caught.value.field, caught.value.value) == ("input", 0.0)
