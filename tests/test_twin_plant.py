"""The assembled twin: limits, energy, and the exactness of its steps."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fraclink._kernels import twin_exponential
from fraclink._simulate import assemble
from fraclink.errors import FieldError
from fraclink.extend import Beam, FractionalKelvinVoigt, KelvinVoigt, PowerLaw
from reproduce.twin_logs import marched, on_servo
from state_space import energy_matrix

ROD = Beam(0.65, 1.56 * 0.65 / 3, 0.00735, 0.030)
MASSLESS = Beam(0.65, 1.56 * 0.65 / 3, 0.0, 0.030)
DAMPINGS = [
    KelvinVoigt(0.0),
    KelvinVoigt(0.0118),
    FractionalKelvinVoigt(0.012, 0.7),
    PowerLaw(1.92),
]
STIFFNESS, OMEGA = MASSLESS.stiffness, math.sqrt(1.56 / (0.030 * 0.65**2))


@pytest.mark.parametrize("size", [1e-9, 0.3, 40.0, 3e3])
def test_the_exponential_of_a_matrix_against_mpmath(size):
    """For a vibration whose norm is its squared frequency, as in an arm, and for a
    growing chain of integrators.
    """
    vibration = [[0.0, 1e-3, 0.0], [-size, -1e-4, 1e-3], [0.0, 0.0, 0.0]]
    chain = [[0.0, size, 0.0], [0.0, 0.0, size], [0.0, 0.0, 0.0]]
    for matrix in (vibration, chain):
        with mpmath.workdps(60):
            exact = np.array(mpmath.expm(mpmath.matrix(matrix)).tolist(), dtype=float)
        found = twin_exponential(np.array(matrix))
        assert np.max(np.abs(found - exact)) < 1e-14 * np.max(np.abs(exact))


def response(plant, s):
    """Outputs per unit of hub torque at the complex frequency s, shape (6,)."""
    matrix = s * np.eye(plant.order) - plant.dynamics
    return plant.outputs @ np.linalg.solve(matrix, plant.inputs[:, 0])


def _lumped(damping, s):
    """Tip angle and gauge torque of the lumped model (4)-(16) per hub angle."""
    if isinstance(damping, PowerLaw):
        d = s ** (2 - damping.order)
    elif isinstance(damping, FractionalKelvinVoigt):
        d = 1 + damping.coefficient * s**damping.order
    else:
        d = 1 + damping.time * s
    lag = s**2 / (s**2 + OMEGA**2 * d)
    return 1 - lag, STIFFNESS * lag


@pytest.mark.parametrize("damping", DAMPINGS, ids=lambda d: d.label)
@pytest.mark.parametrize("frequency", [0.1, 1.0, 8.0, 12.0, 13.0, 40.0, 200.0])
def test_massless_limit_is_the_lumped_model(damping, frequency):
    s = 1j * frequency
    tip, torque = _lumped(damping, s)
    y = response(assemble(MASSLESS, damping, hub_inertia=0.01), s)
    assert y[2] == pytest.approx(tip * y[0], rel=1e-6, abs=1e-7 * abs(y[0]))
    assert y[3] == pytest.approx(torque * y[0], rel=1e-6, abs=1e-6 * abs(y[0]))


def test_power_law_step_response_against_mittag_leffler():
    """θt for a hub step in the massless limit is 1 − E_λ(−ω₀² t^λ), here to 30 digits;
    a fast servo has a delay of twice its time constant.
    """
    order, period, fast = 1.92, 1e-3, 1e5
    plant = on_servo(assemble(MASSLESS, PowerLaw(order), hub_inertia=1.0), fast)
    ours = marched(plant, np.ones(2000), period)[:, 2]
    with mpmath.workdps(60):
        w2, lam = mpmath.mpf(OMEGA) ** 2, mpmath.mpf(order)
        for k in (9, 249, 999, 1999):
            z = -w2 * (mpmath.mpf(period) * (k + 1) - 2 / mpmath.mpf(fast)) ** lam
            terms = (z**n / mpmath.gamma(lam * n + 1) for n in range(400))
            assert ours[k] == pytest.approx(float(1 - mpmath.fsum(terms)), abs=2e-6)


@pytest.mark.parametrize("damping", DAMPINGS, ids=lambda d: d.label)
@pytest.mark.parametrize(
    "beam", [ROD, MASSLESS, ROD.with_payload(0.0)], ids=["rod", "massless", "bare"]
)
def test_energy_never_grows_on_the_discretised_twin(damping, beam):
    """In the energy norm the step matrix is a contraction, which holds for every state,
    not just for one move.
    """
    plant = assemble(beam, damping, hub_inertia=6.87e-5, hub_friction=1.041e-3)
    matrix = plant.discretise(1e-3).transition[:, : plant.order].T
    energy = energy_matrix(plant, 6.87e-5)
    # The angle of the hub alone stores no energy; directions with next to no energy are
    # excluded from the norm.
    scale, vectors = np.linalg.eigh(energy)
    kept = scale > 1e-9 * scale.max()
    root = vectors[:, kept] * np.sqrt(scale[kept])
    inverse = vectors[:, kept] / np.sqrt(scale[kept])
    rest = vectors[:, ~kept]
    assert np.linalg.norm(root.T @ matrix @ rest) < 1e-6 * np.linalg.norm(matrix)
    assert np.linalg.norm(root.T @ matrix @ inverse, 2) <= 1 + 1e-6


@pytest.mark.slow
@settings(deadline=None, max_examples=30)
@given(
    link_mass=st.floats(1e-4, 0.1),
    payload=st.floats(0.0, 0.1),
    order=st.floats(1.05, 1.99),
    seed=st.integers(0, 2**32 - 1),
)
def test_energy_rate_is_never_positive(link_mass, payload, order, seed):
    """dE/dt = 2 xᵀ E A x <= 0 for random states of random twins."""
    beam = Beam(0.65, 0.338, link_mass, payload)
    plant = assemble(beam, PowerLaw(order), hub_inertia=1e-4, hub_friction=1e-3)
    x = np.random.default_rng(seed).standard_normal(plant.order)
    energy, change = energy_matrix(plant, 1e-4), plant.dynamics @ x
    size = np.abs(energy @ np.abs(change)).sum() * np.abs(x).max()
    assert 2 * x @ energy @ change <= 1e-9 * size


@pytest.mark.parametrize("higher", [2e-5, 2e-3])
def test_modes_beyond_the_first_may_have_their_own_damping(higher):
    """ζ = ηω/2 of the second mode, and the first one as before; the hub is too heavy to
    move.
    """

    def vibrations(damping):
        plant = assemble(ROD, damping, hub_inertia=1e9)
        poles = np.linalg.eigvals(plant.dynamics)
        return sorted(poles[poles.imag > 1.0], key=abs)

    own = vibrations(PowerLaw(1.95, higher=higher))
    material = vibrations(PowerLaw(1.95))
    assert own[0] == pytest.approx(material[0], rel=1e-6)
    size = abs(own[1])
    assert -own[1].real / size == pytest.approx(0.5 * higher * size, rel=1e-6)
    assert size == pytest.approx(abs(material[1]), rel=0.05)


@pytest.mark.slow
def test_steps_compose():
    """Four steps of 1 ms equal one of 4 ms for a held input: the steps are exact, with
    no error of a scheme.
    """
    plant = on_servo(assemble(ROD, PowerLaw(1.92), hub_inertia=1.0))
    reference = np.sin(np.arange(500.0))
    slow = marched(plant, reference, 1e-3)
    fast = marched(plant, np.repeat(reference, 4), 2.5e-4)[3::4]
    assert np.max(np.abs(slow - fast) / (1e-3 + np.abs(slow).max(axis=0))) < 1e-9


def test_gauge_is_curvature_and_not_the_total_moment():
    """In the total base moment the signal is multiplied by D of the material: another
    phase, another order.
    """
    s = 12j
    plant = assemble(MASSLESS, PowerLaw(1.92), hub_inertia=0.01)
    gauge, total = response(plant, s)[[3, 5]]
    assert total / -gauge == pytest.approx(s**0.08, rel=1e-6)


@pytest.mark.parametrize("step", [0.0, -1e-3, 2e-3, float("nan"), True])
def test_bad_steps(step):
    with pytest.raises(FieldError, match="step"):
        assemble(ROD, PowerLaw(1.92), hub_inertia=0.01, step=step)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: KelvinVoigt(-1e-3), "time"),
        (lambda: KelvinVoigt(float("nan")), "time"),
        (lambda: FractionalKelvinVoigt(-0.1, 0.5), "coefficient"),
        (lambda: FractionalKelvinVoigt(0.1, 0.0), "order"),
        (lambda: FractionalKelvinVoigt(0.1, 1.0), "order"),
        (lambda: FractionalKelvinVoigt(0.1, "0.5"), "order"),
        (lambda: PowerLaw(2.0), "order"),
        (lambda: PowerLaw(2.1), "order"),
        (lambda: PowerLaw(1.0), "order"),
        (lambda: PowerLaw(float("inf")), "order"),
    ],
)
def test_damping_that_is_not_passive_is_refused(make, field):
    with pytest.raises(FieldError) as caught:
        make()
    assert caught.value.field == field


@settings(deadline=None, max_examples=60)
@given(order=st.floats(0.01, 0.99), frequency=st.floats(1.0, 1e3))
def test_chains_are_positive_and_accurate(order, frequency):
    chain = FractionalKelvinVoigt(1.0, order).chain(1e-8)
    assert np.all(chain.weights > 0) and np.all(chain.rates > 0)
    exact = 1 + (1j * frequency) ** order
    assert abs(chain(1j * frequency) - exact) < 2e-5 * abs(exact)


def test_the_modes_beyond_the_first_have_a_damping_of_their_own() -> None:
    rod = Beam(length=0.6, flexural_rigidity=0.34, link_mass=0.02, payload=0.03)
    frequencies = rod.modes(2).frequencies
    times = 2.0 * np.array([0.03, 0.002]) / frequencies
    material = KelvinVoigt(*times.tolist())
    plant = on_servo(assemble(rod, material, hub_inertia=1.0, modes=2))
    poles = np.linalg.eigvals(plant.dynamics)
    upper = poles[poles.imag > 0]
    for frequency, ratio in zip(frequencies, (0.03, 0.002), strict=True):
        (pole,) = upper[np.isclose(np.abs(upper), frequency, rtol=1e-6)]
        assert -pole.real / abs(pole) == pytest.approx(ratio)
