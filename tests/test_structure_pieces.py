"""The pieces of a structure's search against closed forms: coordinates, transforms,
starts, descents.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
import fracsys
from fraclink._identify.expression import parse_expression
from fraclink._identify.least_squares import (
    blocks_of,
)
from fraclink._identify.structure_problem import (
    RecordStart,
    Spectrum,
    StructureCoordinates,
)
from fraclink._identify.structure_slopes import Coarse, Rows
from fraclink.errors import FieldError
from identify_cases import late_cut

Array = NDArray[np.float64]
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


# --- limits of a text ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fits", "too_much", "problem"),
    [
        ("k*s" + " " * 996 + "+", None, "not a formula"),
        ("s+" * 60 + "s*k", "s+" * 61 + "s*k", "nested too deeply"),
        (
            "+".join(f"p{i}*s" for i in range(12)),
            "+".join(f"p{i}*s" for i in range(13)),
            "too many parameters",
        ),
        (
            "k*(s + 1)**8",
            "k*(s + 1)**9",
            "a power of a sum that is not a whole number up to 8",
        ),
        (
            "k*(s + 1)**-8",
            "k*(s + 1)**-9",
            "a power of a sum that is not a whole number up to 8",
        ),
        ("s*k" + " " * 997, "s*k" + " " * 998, "too long"),
        ("s*k*9e299", "s*k*1e300", "not a number"),
    ],
)
def test_a_text_up_to_its_limits(fits: str, too_much: str | None, problem: str) -> None:
    if too_much is not None:
        assert "s" not in parse_expression(fits).names
    with pytest.raises(FieldError) as caught:
        parse_expression(too_much or fits)
    assert caught.value.problem.startswith(problem)


def test_what_is_no_text_and_where_it_breaks() -> None:
    for value, problem in ((3, "no text"), ("  ", "empty")):
        with pytest.raises(FieldError) as caught:
            parse_expression(value)  # type: ignore[arg-type]
        assert (caught.value.value, caught.value.problem) == (value, problem)
        assert caught.value.allowed == "a text of 1 to 1000 characters"
    with pytest.raises(FieldError) as caught:
        parse_expression("k s")
    assert caught.value.problem.startswith("not a formula at character")
    with pytest.raises(FieldError, match="too many") as caught:
        parse_expression("+".join(f"p{i}*s" for i in range(13)))
    assert (caught.value.value, caught.value.allowed) == (13, "<= 12 parameters")


# --- steps --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("timed", [True, False])
def test_evaluations_are_the_candidates_that_were_simulated(
    timed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted = []
    for kind in (RecordStart, Spectrum, Coarse):

        def simulated(
            self: Any,
            structure: Any,
            values: Any,
            count: int,
            own: Any = kind.simulated,
        ) -> Any:
            counted.append(count)
            return own(self, structure, values, count)

        monkeypatch.setattr(kind, "simulated", simulated)
    w = np.geomspace(0.05, 50.0, 60)
    data: Any = fl.FrequencyResponse(w, (2 / (fracsys.s**1.5 + 3))(1j * w))
    if timed:
        u = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 40), 25)
        data = fl.extend.Recording(
            0.02,
            u,
            fracsys.time_response(
                2 / (fracsys.s**1.5 + 3), u, 0.02, hold="zero"
            ).output,
        )
    fit = fl.identify_structure(data, "k/(s**a + w)", details=False)
    # Less those of the results: predictions, gain and offset at the ends, the held-out
    # lines.
    assert 0.9 * sum(counted) <= fit.evaluations <= sum(counted)


# --- a transform back ---------------------------------------------------------------------------------------


def slow_record(count: int = 8000, period: float = 0.02) -> RecordStart:
    time = period * np.arange(count)
    u = np.sin(0.5 * time) + 0.5 * np.sin(1.3 * time)
    y = fracsys.time_response(
        2 / (fracsys.s**1.3 + 0.4 * fracsys.s + 1), u, period, hold="first"
    ).output
    return RecordStart.of(fl.extend.Recording(period, u, y), "first", count)


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_a_structure_still_swings_by_what_was_long_before_the_cut(seed: int) -> None:
    """By three lengths of 2 s alone ζ of 0.02 is found 2 to 50 % off and ω₀² 100 by up
    to 4.
    """
    text = "k*s**2/(s**2 + d*s + w)"
    fit = fl.identify_structure(
        late_cut(seed), text, hold="first", heldout=0.0, details=False
    )
    for name, value in {"k": 1.56, "d": 0.4, "w": 100.0}.items():
        assert abs(fit.parameters[name] - value) < 4 * fit.standard_errors[name], name
    assert fit.parameters["d"] == pytest.approx(0.4, rel=0.01)


@pytest.mark.parametrize("cut", [1, 1003, 4000])
def test_of_a_cut_record_the_rows_are_the_end_of_the_whole_ones(cut: int) -> None:
    whole, own = slow_record(), coordinates("k/(s**a + c*s + w)")
    late = fl.extend.Recording(0.02, whole.input[cut:] + 5.0, whole.output[cut:])
    data = RecordStart.of(late, "first", 8000 - cut, whole.input[:cut] + 5.0)
    assert np.array_equal(data.whole_input, whole.input + 5.0 - 5.0)
    truth = {"k": 2.0, "a": 1.3, "c": 0.4, "w": 1.0}
    values = {name: np.array([[value]]) for name, value in truth.items()}
    assert data.simulated(own.structure, values, 1)[0] == pytest.approx(
        whole.output[cut:], abs=1e-12
    )
    coarse = Rows(data).coarse(own, truth)
    assert coarse is not None and coarse.sharp
    rows = coarse.rows(own, truth)
    assert rows is not None
    # By differences of the exact response to the whole input: another way than the
    # transform.
    at = np.array([[float(own.place(name, truth[name])) for name in own.names]])
    for k, row in enumerate(rows):
        ends = (
            own.values(at + sign * 1e-5 * np.eye(4)[k], projected=False)
            for sign in (1, -1)
        )
        above, below = (whole.simulated(own.structure, end, 1)[0] for end in ends)
        wanted = blocks_of((above - below)[cut:] / 2e-5, coarse.width)
        assert np.linalg.norm(row - wanted) < 5e-3 * np.linalg.norm(wanted)


# --- descents of a whole search -----------------------------------------------------------------------------


@pytest.mark.slow
def test_standard_errors_of_a_structure_written_out() -> None:
    """σ² (JᵀJ)⁻¹ of differences of the exact response, for lines with white noise."""
    w = np.geomspace(0.05, 50.0, 80)
    truth = (2 / (fracsys.s**1.4 + 3))(1j * w)
    rng = np.random.default_rng(3)
    noise = 0.02 * (rng.normal(size=80) + 1j * rng.normal(size=80)) / math.sqrt(2)
    data = fl.FrequencyResponse(w, truth * (1 + noise))
    fit = fl.identify_structure(data, "k/(s**a + w)")
    values = dict(fit.parameters)

    def scaled(values: dict[str, float]) -> Array:
        h = (values["k"] / (fracsys.s ** values["a"] + values["w"]))(1j * w) / np.abs(
            data.response
        )
        return np.concatenate([h.real, h.imag])

    J = np.stack(
        [
            (
                scaled({**values, n: v * (1 + 1e-5)})
                - scaled({**values, n: v * (1 - 1e-5)})
            )
            / (2e-5 * v)
            for n, v in values.items()
        ]
    )
    measured = np.concatenate([data.response.real, data.response.imag]) / np.tile(
        np.abs(data.response), 2
    )
    rest = measured - scaled(values)
    errors = np.sqrt(np.diag(np.linalg.inv(J @ J.T)) * (rest @ rest) / (160 - 3))
    for k, name in enumerate(values):
        assert fit.standard_errors[name] == pytest.approx(
            errors[k], rel=0.35
        )  # colour may widen them
        assert fit.standard_errors[name] >= 0.999 * errors[k]
        interval = fit.intervals[name]
        assert interval.high - interval.low == pytest.approx(
            2 * 1.96 * fit.standard_errors[name], rel=0.1
        )
    assert fit.undetermined == () and fit.at_bound == ()
