"""Structures as text: equivalent notations, roles, and meaningless pieces or numbers."""

from __future__ import annotations

import numpy as np
import pytest

from fraclink._identify.expression import parse_expression
from fraclink.errors import FieldError


@pytest.mark.parametrize(
    "text",
    [
        "k*s**a/(s**b + w)*exp(-T*s)",
        "1/(a2*s**n2 + a1*s**n1 + a0)",
        "(T*s)**a/(1 + (T*s)**a)**2",
        "kp + ki*s**-l + kd*s**m",
        "exp(-(T1 + 2*T2)*s)/s**-a",
        "k*w**2/(s**2 + 2*z*w*s + w**2)",
        "1/(s + k*exp(-T*s))",
        "+s/(2 - -s)",
        "k*(s + 1)**-1",
        "k*(s + 1)**(1 + 1)/(s + w)**-2",
        "(-s)**2*k",
        "1 + T/s",
        "kp + ki/s + kd*s",
        "(T*s/w)**a + (2/s)**0.5 + (s**a)**2",
    ],
)
def test_the_readings_of_a_tree_agree(text: str) -> None:
    """Arrays and the exact function."""
    structure = parse_expression(text)
    values = {name: 0.5 + 0.1 * k for k, name in enumerate(structure.names)}
    points = 0.2 + 1j * np.array([0.3, 2.0, 40.0])
    exact = structure.function(values)(points)
    assert structure.response(values, points) == pytest.approx(exact, rel=1e-12)
    many = {name: np.array([[value], [1.1 * value]]) for name, value in values.items()}
    rows = np.broadcast_to(structure.response(many, points), (2, 3))
    assert rows[0] == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "value", "problem"),
    [
        ("k*0**-1*s", "0**-1", "a division by zero"),
        ("k*s/(1 - 1)", "k*s/(1 - 1)", "a division by zero"),
        ("k*10**(10**9)*s", "10**(10**9)", "no finite real number"),
        ("k*1e200**(1 + 1)*s", "1e200**(1 + 1)", "no finite real number"),
        ("(-2*s)**0.5*k", "(-2*s)**0.5", "a real power of a negative term"),
        ("(-1)**0.5*s*k", "(-1)**0.5", "no finite real number"),
        (
            "k*(s + 1)**-65",
            "(s + 1)**-65",
            "a real power of a sum",
        ),
        (
            "k*(s + 1)**(1/3)",
            "(s + 1)**(1/3)",
            "a real power of a sum",
        ),
        ("k*s+" + "1+" * 400 + "1", "k*s+" + "1+" * 339 + "1", "nested too deeply"),
        ("1+" * 400 + "1", "1+" * 400 + "1", "without s"),
        ("k*exp(-T*s/(2 - 2))", "-T*s/(2 - 2)", "a division by zero"),
        ("k*exp(-(0 - T)**0.5*s)", "(0 - T)**0.5", "no finite real number"),
    ],
)
def test_arithmetic_that_has_no_value_is_named(
    text: str, value: str, problem: str
) -> None:
    with pytest.raises(FieldError) as caught:
        parse_expression(text)
    assert (caught.value.field, caught.value.value, caught.value.problem) == (
        "expression",
        value,
        problem,
    )
    assert caught.value.remedy


@pytest.mark.parametrize("text", ["s/(k - 2)", "(1 - k)**0.5*s", "(k + 8)**(1000*k)*s"])
def test_values_without_a_function_are_named(text: str) -> None:
    structure = parse_expression(text)
    with pytest.raises(FieldError):
        structure.function({"k": 2.0})
    assert not np.isfinite(structure.response({"k": 2.0}, np.array([1j]))).all()


def test_roles() -> None:
    roles = parse_expression("k*s**(a - b)/(w**c + s**b)*exp(-2*T*s)").roles
    assert dict(roles) == {
        "k": "coefficient",
        "a": "order",
        "b": "order",
        "w": "coefficient",
        "c": "coefficient",
        "T": "delay",
    }


@pytest.mark.parametrize(
    ("text", "piece"),
    [
        ("1/(s**0.5 + sin(s))", "sin(s)"),
        ("k/(s + 1)**a", "(s + 1)**a"),
        ("k/(s + 1)**0.5", "(s + 1)**0.5"),
        ("exp(T*s)", "exp(T*s)"),
        ("exp(-T*s**2)", "exp(-T*s**2)"),
        ("s*exp(-T)", "exp(-T)"),
        ("2**s", "2**s"),
        ("k/(T*s^0.5)", "T*s^0.5"),
        ("s[0]", "s[0]"),
        ("s.__class__", "s.__class__"),
        ("(lambda: s)()", "(lambda: s)()"),
        ("s if s else k", "s if s else k"),
        ("'a'*s", "'a'"),
        ("True*s", "True"),
        ("1j*s", "1j"),
        ("k*(s**3)**0.5/(s**1.5 + w)", "(s**3)**0.5"),
        ("((T*s/w)**a)**b", "((T*s/w)**a)**b"),
        ("exp*s", "exp"),
        ("offset*s", "offset"),
        ("k", "k"),
        ("k s", "k s"),
        ("", ""),
        ("s" + "+s" * 1000, "s+s+s"),
        ("-" * 100 + "s", "----"),
    ],
)
def test_a_piece_without_meaning_is_named(text: str, piece: str) -> None:
    with pytest.raises(FieldError) as caught:
        parse_expression(text)
    assert caught.value.field == "expression"
    assert piece in str(caught.value.value)
