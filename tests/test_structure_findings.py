"""How sure a structure's parameters are, each finding at its threshold, and what a user
states of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
import fracsys
from fraclink._identify.expression import parse_expression
from fraclink._identify.problem import (
    Interval,
)
from fraclink._identify.structure_certainty import (
    Certainty,
    in_order,
    structure_findings,
)
from fraclink._identify.structure_data import Lines
from fraclink._identify.structure_problem import StructureCoordinates
from fraclink._identify.structure_search import Place
from fraclink.errors import FieldError, LogError
from fraclink.findings import Finding

LIMITS = {"order": (0.02, 4.0), "delay": (0.0, 10.0), "coefficient": (1e-12, 1e12)}


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
    assert fit.limits["k"] == (-1e12, 1e12)  # of either sign


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
