"""The link model: structures, resonances, poles, bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink import LinkModel
from fraclink.errors import FieldError
from fraclink.extend import STRUCTURES


def denominator(link: LinkModel, s: complex) -> complex:
    return (
        s**link.order + link.damping * s**link.damping_order + link.natural_frequency**2
    )


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({}, "UD-IOM"),
        ({"damping": 1.3}, "D-IOM"),
        ({"order": 1.92}, "UD-FOM"),
        ({"damping": 1.37, "damping_order": 0.9}, "D-FOM"),
        ({"order": 1.95, "damping": 0.4}, "general"),
    ],
)
def test_structure_names(options: dict[str, float], name: str) -> None:
    assert LinkModel(1.56, 10.0, **options).structure == name


def test_free_parameters_are_those_of_table_2() -> None:
    assert [len(row.free) for row in STRUCTURES.values()] == [1, 2, 2, 3]


def test_the_damping_ratio_of_a_fractional_link() -> None:
    link = LinkModel(1.56, 10.02, order=1.92)
    assert link.damping_ratio == pytest.approx(0.0654, abs=5e-5)


@settings(max_examples=60, deadline=None)
@given(
    frequency=st.floats(0.5, 200),
    order=st.floats(1.2, 2.0),
    ratio=st.floats(0.0, 0.3),
    other=st.floats(0.2, 1.6),
)
def test_pole_is_a_zero_of_the_denominator(
    frequency: float, order: float, ratio: float, other: float
) -> None:
    scale = frequency ** (2 / order)
    link = LinkModel(1.56, frequency, order, ratio * scale ** (order - other), other)
    assert abs(denominator(link, link.pole)) < 1e-9 * frequency**2
    assert link.pole.imag > 0


def test_torque_and_tip_add_up() -> None:
    link = LinkModel(1.56, 10.5, damping=1.37, damping_order=0.9)
    s = 1j * np.array([0.1, 3.0, 10.0, 80.0])
    assert np.allclose(
        link.tip()(s) + link.torque()(s) / link.stiffness, 1.0, rtol=1e-14
    )


def test_undamped_fractional_link_is_a_fractionally_damped_one() -> None:
    # ERRATA: UD-FOM is D-FOM with ω₀ = 0, μ = ω₀², α = 2 − λ.
    link = LinkModel(1.56, 10.02, order=1.92)
    same = LinkModel(1.56, 0.0, damping=10.02**2, damping_order=0.08)
    s = 1j * np.geomspace(0.1, 100, 50)
    assert np.allclose(link.torque()(s), same.torque()(s), rtol=1e-12)
    assert same.pole == pytest.approx(link.pole, rel=1e-12)


def test_payload_moves_the_frequency_by_equation_5() -> None:
    link = LinkModel(1.56, 11.094, order=1.92, payload=0.030)
    assert link.at_payload(0.040).natural_frequency == pytest.approx(9.6077, abs=1e-4)
    assert link.at_payload(0.020).damping_ratio == pytest.approx(
        link.damping_ratio, rel=1e-12
    )
    with pytest.raises(FieldError, match="payload"):
        LinkModel(1.56, 11.094).at_payload(0.02)


@pytest.mark.parametrize(
    ("field", "options"),
    [
        ("stiffness", {"stiffness": 0.0}),
        ("stiffness", {"stiffness": -1.0}),
        ("stiffness", {"stiffness": math.nan}),
        ("natural_frequency", {"natural_frequency": 0.0}),
        ("natural_frequency", {"natural_frequency": 1e200}),
        ("natural_frequency", {"natural_frequency": True}),
        ("order", {"order": 0.99}),
        ("order", {"order": 2.01}),
        ("order", {"order": "1.9"}),
        ("damping", {"damping": -0.1}),
        ("damping", {"damping": math.inf}),
        ("damping_order", {"damping_order": 2.0}),
        ("damping_order", {"damping_order": 0.0}),
        (
            "natural_frequency",
            {
                "natural_frequency": 0.0,
                "order": 1.5,
                "damping": 1.0,
                "damping_order": 1.5,
            },
        ),
        ("payload", {"payload": 0.0}),
        ("payload", {"payload": -0.03}),
    ],
)
def test_bad_values_name_their_field(field: str, options: dict[str, object]) -> None:
    values: dict[str, object] = {"stiffness": 1.56, "natural_frequency": 10.0} | options
    with pytest.raises(FieldError) as caught:
        LinkModel(**values)  # type: ignore[arg-type]
    assert caught.value.field == field
    assert caught.value.allowed
