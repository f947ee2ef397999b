"""The twin's beam: finite elements against the transcendental equation and its known
limits.
"""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_frequencies import exact_frequencies
from fraclink.errors import FieldError
from fraclink.extend import Beam

ROD = Beam(length=0.65, flexural_rigidity=0.26, link_mass=0.00735, payload=0.030)


def test_check_value_of_the_carbon_rod():
    frequencies = ROD.modes(3).frequencies
    assert frequencies[0] == pytest.approx(9.46, abs=0.005)
    assert frequencies[1] == pytest.approx(177.5, abs=0.05)
    assert frequencies[2] == pytest.approx(569.8, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.0, 0.001, 0.008, 0.020, 0.030, 0.040])
@pytest.mark.parametrize("link_mass", [1e-9, 1e-6, 1e-4, 0.00735, 0.0141, 0.05, 0.5])
def test_first_three_modes_against_exact_roots(payload, link_mass):
    beam = Beam(0.65, 0.26, link_mass, payload)
    ours = beam.modes(3).frequencies
    assert ours.size == 3
    # 1e-4 is required
    assert np.max(np.abs(ours / exact_frequencies(beam) - 1.0)) < 1e-5


@pytest.mark.parametrize("inertia", [1e-7, 1e-5, 1e-3])
def test_modes_with_tip_inertia(inertia):
    beam = Beam(0.65, 0.26, 0.00735, 0.030, payload_inertia=inertia)
    assert beam.modes(3).frequencies == pytest.approx(exact_frequencies(beam), rel=1e-6)


@pytest.mark.parametrize("payload", [0.008, 0.020, 0.030, 0.040])
def test_massless_limit_is_equation_5(payload):
    beam = Beam(0.65, 0.26, 0.0, payload)
    modes = beam.modes(3)
    assert modes.frequencies.size == 1
    exact = math.sqrt(3 * 0.26 / 0.65 / (payload * 0.65**2))
    assert modes.frequencies[0] == pytest.approx(exact, rel=1e-10)
    assert exact_frequencies(beam).tolist() == [exact]
    # For fast motion of the hub the tip stands still: φ(L) Γ = L for the only mode.
    assert modes.tip[0] * modes.participation[0] == pytest.approx(1.0, rel=1e-10)
    assert modes.participation[0] ** 2 == pytest.approx(beam.inertia, rel=1e-10)


def test_light_link_tends_to_the_massless_one():
    heavy, light = (
        Beam(0.65, 0.26, mass, 0.030).modes(1).frequencies[0] for mass in (1e-5, 1e-8)
    )
    limit = Beam(0.65, 0.26, 0.0, 0.030).modes(1).frequencies[0]
    assert abs(light / limit - 1) < 1e-6 < abs(heavy / limit - 1) < 1e-3


def test_free_cantilever_known_roots():
    beam = Beam(1.0, 1.0, 1.0, 0.0)
    roots = [
        mpmath.findroot(lambda b: 1 + mpmath.cos(b) * mpmath.cosh(b), guess)
        for guess in (1.87, 4.69, 7.85)
    ]
    assert beam.modes(3).frequencies == pytest.approx(
        [float(r) ** 2 for r in roots], rel=1e-6
    )


def test_modes_against_scikit_fem():
    skfem = pytest.importorskip(
        "skfem", reason="scikit-fem is the independent beam solver of this test"
    )
    from scipy.linalg import eigh
    from skfem.helpers import dd, ddot

    mesh = skfem.MeshLine(np.linspace(0, ROD.length, 41))
    basis = skfem.Basis(mesh, skfem.ElementLineHermite(), intorder=8)
    stiffness = skfem.BilinearForm(
        lambda u, v, _: ROD.flexural_rigidity * ddot(dd(u), dd(v))
    )
    density = ROD.link_mass / ROD.length
    mass = skfem.BilinearForm(lambda u, v, _: density * u * v)
    k, m = stiffness.assemble(basis).toarray(), mass.assemble(basis).toarray()
    tip = basis.nodal_dofs[0, -1]
    m[tip, tip] += ROD.payload
    free = np.setdiff1d(np.arange(k.shape[0]), basis.nodal_dofs[:, 0])
    values = eigh(k[np.ix_(free, free)], m[np.ix_(free, free)], eigvals_only=True)[:3]
    assert ROD.modes(3).frequencies == pytest.approx(np.sqrt(values), rel=1e-5)


def test_participation_sums_to_the_rigid_inertia():
    modes = ROD.modes(12)
    missing = ROD.inertia - np.cumsum(modes.participation**2)
    assert np.all(missing > 0) and np.all(np.diff(missing) < 0)
    assert missing[-1] < 1e-5 * ROD.inertia


@pytest.mark.slow
@settings(deadline=None, max_examples=40)
@given(
    length=st.floats(0.05, 5.0),
    rigidity=st.floats(1e-3, 1e4),
    link_mass=st.floats(0.0, 10.0),
    payload=st.floats(1e-4, 10.0),
    scale=st.floats(0.1, 10.0),
)
def test_frequencies_scale_like_root_of_rigidity(
    length, rigidity, link_mass, payload, scale
):
    one = Beam(length, rigidity, link_mass, payload).modes(1)
    other = Beam(length, rigidity * scale, link_mass, payload).modes(1)
    assert other.frequencies[0] == pytest.approx(
        one.frequencies[0] * math.sqrt(scale), rel=1e-6
    )
    assert other.participation[0] == pytest.approx(one.participation[0], rel=1e-6)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("length", 0.0),
        ("length", -0.65),
        ("flexural_rigidity", 0.0),
        ("flexural_rigidity", math.nan),
        ("link_mass", -1e-3),
        ("payload", -0.03),
        ("payload", math.inf),
        ("payload", True),
        ("payload", "30 g"),
        ("payload_inertia", -1.0),
    ],
)
def test_bad_fields_are_named(field, value):
    good = {
        "length": 0.65,
        "flexural_rigidity": 0.26,
        "link_mass": 0.00735,
        "payload": 0.03,
    }
    with pytest.raises(FieldError) as caught:
        Beam(**(good | {field: value}))
    assert caught.value.field == field and caught.value.remedy


def test_nothing_that_moves_is_refused():
    with pytest.raises(FieldError, match="massless"):
        Beam(0.65, 0.26, 0.0, 0.0)
