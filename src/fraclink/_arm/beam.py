"""The link of the twin: an Euler–Bernoulli beam clamped at a turning hub, with a
payload at its tip.

In the frame that turns with the hub the deflection w(x, t) obeys

    ρA (ẅ + x θ̈m) + EI D(s) w'''' = 0,    w(0) = w'(0) = 0,
    m (ẅ(L) + L θ̈m) = EI D(s) w'''(L),     J (ẅ'(L) + θ̈m) = −EI D(s) w''(L),

where D(s) is the damping law of the material (``damping.py``; D = 1 is the undamped
link). Damping proportional to the stiffness leaves the mode shapes real: with w = Σ
φi(x) qi(t) every mode obeys

    q̈i + ωi² D(s) qi = −Γi θ̈m.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import numpy as np
from scipy.linalg import eigh

from fraclink._arm.link import LinkModel, SecondMode
from fraclink._arm.rig import Rig
from fraclink._arm.rig_parts import at_least_zero, positive
from fraclink.errors import FieldError
from fracsys.checks import Between, Complex, Real, checked

__all__ = [
    "DEFAULT_MASS",
    "Beam",
    "BeamModes",
    "assumed_ratio",
    "mass_matrix",
    "material_law",
    "modal_shares",
    "model_at",
    "modes_of",
    "residual_inertia",
    "unmodelled_modes",
]


# 48 cubic elements: with the paper's lightest payload the third mode is exact to 4e-7
# and the fifth to 5e-6, far better than any beam is known.
ELEMENTS = 48

# [kg] mass of the link where the rig states none: a carbon rod, 3 mm thick and 0.65 m
# long
DEFAULT_MASS = 0.00735


@checked
@dataclass(frozen=True)
class Beam:
    """A uniform slender link with a payload: what bends, and what it carries.

    The stiffness of the lumped model follows as c = 3 EI/L [N·m/rad], and for a
    massless link the only mode is ω = √(c/(m L²)), equation (5) of the paper.

    Parameters
    ----------
    length
        length L of the link [m], > 0
    flexural_rigidity
        EI [N·m²], > 0
    link_mass
        mass ρA·L of the whole link [kg], >= 0
    payload
        mass m at the tip [kg], >= 0; link and payload must not both be massless
    payload_inertia
        moment of inertia of the payload about the tip [kg·m²], >= 0. The default 0 is
        the paper's rig: the disk turns freely, so no moment acts at the tip.

    Raises
    ------
    FieldError
        a value is negative or not finite, or link and payload are both massless.

    >>> rod = Beam(length=0.65, flexural_rigidity=0.26, link_mass=0.00735, payload=0.030)
    >>> [round(w, 2) for w in rod.modes(3).frequencies.tolist()]
    [9.46, 177.53, 569.81]
    >>> round(rod.stiffness, 3)
    1.2
    """

    length: Annotated[
        float, positive("m", remedy="give the length of the link in metres")
    ]
    flexural_rigidity: Annotated[
        float, positive("N·m²", remedy="give EI, or c·L/3 from a measured stiffness")
    ]
    link_mass: Annotated[
        float, at_least_zero("kg", remedy="give the mass of the link in kg")
    ]
    payload: Annotated[
        float, at_least_zero("kg", remedy="give the mass at the tip in kg")
    ]
    payload_inertia: Annotated[
        float,
        at_least_zero("kg·m²", remedy="give 0 for a disk that turns freely on its pin"),
    ] = 0.0

    def __post_init__(self) -> None:
        if (
            self.link_mass == 0.0
            and self.payload == 0.0
            and self.payload_inertia == 0.0
        ):
            raise FieldError(
                "payload",
                self.payload,
                "zero on a massless link",
                "link_mass + payload > 0 kg",
                "give the mass of the link or of the payload",
            )

    @property
    def stiffness(self) -> float:
        """Torque per angle between hub and tip, c = 3 EI/L [N·m/rad]."""
        return 3.0 * self.flexural_rigidity / self.length

    @property
    def inertia(self) -> float:
        """Moment of inertia of the straight link and its payload about the hub [kg·m²]."""
        return (
            self.link_mass / 3.0 + self.payload
        ) * self.length**2 + self.payload_inertia

    def with_payload(self, payload: float) -> Beam:
        """Return the same link with another mass [kg] at its tip.

        >>> Beam(0.65, 0.26, 0.00735, 0.030).with_payload(0.020).payload
        0.02
        """
        return replace(self, payload=payload)

    @staticmethod
    @checked
    def from_rig(
        rig: Rig,
        *,
        payload: float | None = None,
        link_mass: float | None = None,
    ) -> Beam:
        """Return the beam of a rig.

        A rig may state EI and a measured stiffness that contradict each other (the
        paper's does: 3 EI/L = 1.20, measured c = 1.56 N·m/rad). The beam's EI is c L/3,
        so that the twin and the lumped model agree at low frequency.

        Parameters
        ----------
        payload
            mass at the tip [kg]; default the rig's nominal payload
        link_mass
            mass of the link [kg]; default the rig's
        """
        link = rig.link
        return Beam(
            length=link.length,
            flexural_rigidity=link.stiffness * link.length / 3.0,
            link_mass=link.mass if link_mass is None else link_mass,
            payload=rig.payloads.nominal if payload is None else payload,
        )

    @checked
    def modes(self, count: Annotated[int, Between(1, 12, "modes")]) -> BeamModes:
        """Return the first `count` clamped modes, 1 to 12, fewer where the beam has
        fewer.

        A massless link has one mode (two with tip inertia); asking for more returns
        those.
        """
        return _modes(self, count)


@dataclass(frozen=True)
class BeamModes:
    """Clamped modes of a beam, normalised to unit modal mass.

    frequencies: ωi [rad/s]; participation: Γi [√kg·m], the modal load of a unit hub
    acceleration; tip: φi(L)/L [1/(√kg·m)], the tip's angle per modal coordinate;
    shapes: nodal values of the finite elements (2·ELEMENTS × modes:
    deflection and slope of each node but the clamped one).
    """

    frequencies: Real
    participation: Real
    tip: Real
    shapes: Real


# Mass and stiffness matrices of one cubic (Hermite) element, with the degrees of
# freedom (w, h·w') at both ends.
_MASS = (
    np.array(
        [[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]
    )
    / 420.0
)
_STIFFNESS = np.array(
    [[12.0, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]
)


def mass_matrix(beam: Beam) -> Real:
    """Mass matrix [kg] of the clamped beam; its slope coordinates are h·w′, with h the
    length of an element.
    """
    mass = _unloaded(beam.with_payload(1.0))[0].copy()
    mass[-2, -2] += beam.payload
    return mass


@lru_cache(maxsize=16)  # called with a payload of 1 kg only: one entry per link
def _unloaded(beam: Beam) -> tuple[Real, Real, Real]:
    """(M, L⁻¹, L⁻¹ M L⁻ᵀ) of a clamped beam without its payload: its mass matrix [kg]
    and the factor of its stiffness matrix K = L Lᵀ [N/m].
    """
    size = beam.length / ELEMENTS
    mass = np.zeros((2 * ELEMENTS + 2,) * 2)
    stiffness = np.zeros_like(mass)
    for i in range(ELEMENTS):
        block = slice(2 * i, 2 * i + 4)
        # Neighbouring elements share a node, so their blocks overlap in a 2 by 2
        # corner.
        mass[block, block] += _MASS * (beam.link_mass / ELEMENTS)
        stiffness[block, block] += _STIFFNESS * (beam.flexural_rigidity / size**3)
    # The last coordinate is h·w′ rather than w′: its inertia is that about the tip,
    # divided by h².
    mass[-1, -1] += beam.payload_inertia / size**2
    # The clamp removes the deflection and slope of the first node.
    mass, inverse = mass[2:, 2:], np.linalg.inv(np.linalg.cholesky(stiffness[2:, 2:]))
    return mass, inverse, inverse @ mass @ inverse.T


def residual_inertia(beam: Beam, modes: BeamModes) -> float:
    """Return the part of the beam's inertia about the hub that the modes do not carry
    [kg·m²], I − Σ Γi².
    """
    return max(beam.inertia - float(np.sum(modes.participation**2)), 0.0)


@lru_cache(
    maxsize=256
)  # uncached, the modes for the vibration period would be half of a twin's run time
def _modes(beam: Beam, count: int) -> BeamModes:
    # The eigenvalues of L⁻¹ M L⁻ᵀ are 1/ω², so the wanted modes are the largest. A
    # massless link (singular M) needs no special case, while K φ = ω² M φ would require
    # M to be invertible.
    _, inverse, flexibility = _unloaded(beam.with_payload(1.0))
    tip, last = inverse[:, -2], 2 * ELEMENTS - 1
    flexibility = flexibility + beam.payload * np.outer(tip, tip)
    values, vectors = eigh(flexibility, subset_by_index=[last + 1 - count, last])
    # A massless link has one eigenvalue; the others are rounding errors of 1e-17
    # relative to it.
    order = np.flatnonzero(values > 1e-13 * values[-1])[::-1]
    frequencies = 1.0 / np.sqrt(values[order])
    shapes = inverse.T @ vectors[:, order] * frequencies  # unit modal mass
    # The sign of an eigenvector is arbitrary. With the tip moving forward, the modes of
    # two payloads can be compared and the state of one projected onto the other.
    shapes = shapes * np.where(shapes[-2] < 0.0, -1.0, 1.0)
    # Nodal values of w = x, the straight link rotated by one radian; its slope is 1,
    # which is h in the coordinate h·w′.
    nodes = np.column_stack([np.arange(1, ELEMENTS + 1), np.ones(ELEMENTS)]).ravel()
    participation = beam.length / ELEMENTS * nodes @ (mass_matrix(beam) @ shapes)
    result = BeamModes(frequencies, participation, shapes[-2] / beam.length, shapes)
    # Results are shared through caches; a change in place would affect all users.
    for array in vars(result).values():
        array.flags.writeable = False
    return result


# ---- the modes that a model of the link does not have -----------------------------------------------------

# The fourth mode of the paper's arm lies beyond the Nyquist frequency, where the hold
# suppresses it.
_MODES = 3


@lru_cache(maxsize=64)
def modal_shares(beam: Beam) -> tuple[Real, Real]:
    """(ω_i [rad/s], Γi² ω_i² [N·m]) of the first three modes; cached, since every
    request for a rig needs them.
    """
    modes = beam.modes(_MODES)
    # EI φ''(0), the part of a mode in the gauge's torque, is ω² Γ: the moment of the
    # inertia load. It is as accurate as the eigenvalue; differentiating the cubic twice
    # would lose two orders.
    return modes.frequencies, (modes.frequencies * modes.participation) ** 2


def modes_of(model: LinkModel) -> int:
    """Number of modes of the link in a model."""
    return 1 if model.second_mode is None else 2


def model_at(model: LinkModel, rig: Rig, payload: float) -> LinkModel:
    """Return the model at another `payload` [kg], with its modes shifted like those of
    the rig's beam; by eq. (5) if the link has no mass.

    >>> rig = Rig.named("paper-2023")
    >>> model = replace(rig.model, natural_frequency=11.0, payload=0.03)
    >>> round(model_at(model, rig, 0.12).natural_frequency, 3)
    5.5
    >>> heavy = replace(rig, link=replace(rig.link, mass=0.045))
    >>> round(model_at(model, heavy, 0.12).natural_frequency, 3)
    6.139
    """
    if rig.link.mass <= 0.0 or model.payload is None:
        return model.at_payload(payload)
    here, there = (
        modal_shares(Beam.from_rig(rig, payload=mass))[0]
        for mass in (model.payload, payload)
    )
    first, second, *_ = there / here
    mode = model.second_mode
    if mode is not None:
        mode = replace(mode, frequency=mode.frequency * float(second))
    return model.with_mass(float(first) ** -2, payload=payload, second_mode=mode)


def assumed_ratio(model: LinkModel) -> float | None:
    """The damping ratio of the modes that a model does not include: that of its second
    mode if the model's fractional order gives less, an assumed one if the model has no
    damping, or else None: the model's damping law applies.
    """
    mode = model.second_mode
    if mode is not None and mode.damping_ratio > -math.cos(math.pi / model.order) > 0.0:
        return mode.damping_ratio
    # Without damping the higher modes would have infinite peaks.
    undamped = model.order == 2.0 and model.damping == 0.0
    return SecondMode.damping_ratio if undamped else None


def material_law(
    model: LinkModel, s: Complex, frequency: float, ratio: float | None
) -> Complex:
    """D_i(s) of the mode at `frequency` [rad/s]: the model's damping law, or a damping
    ratio.
    """
    if ratio is not None:
        return np.asarray(1.0 + 2.0 * ratio * s / frequency)
    if model.order < 2.0:
        return np.exp((2.0 - model.order) * np.log(s))
    power = np.exp(model.damping_order * np.log(s))
    return np.asarray(1.0 + model.loss * power)


def unmodelled_modes(
    model: LinkModel, rig: Rig, payload: float, damping_ratio: float | None = None
) -> Callable[[Complex], Complex] | None:
    """Return the part of Γ/(c θm) in the beam's modes 2 and 3 that the model does not
    include, at complex s.

    None for a link without mass. `payload` [kg] > 0 is at its tip; the damping is the
    model's law, unless a ratio is given.

    >>> rig = Rig.named("paper-2023")
    >>> heavy = replace(rig, link=replace(rig.link, mass=0.00735))
    >>> unmodelled_modes(rig.model, rig, 0.03)
    >>> bool(abs(unmodelled_modes(rig.model, heavy, 0.03)(220j)) > 3.0)
    True
    """
    if rig.link.mass <= 0.0:
        return None
    ratio = damping_ratio or assumed_ratio(model)
    frequencies, sizes = (
        part[modes_of(model) :]
        for part in modal_shares(Beam.from_rig(rig, payload=payload))
    )

    def torque(s: Complex) -> Complex:
        square, total = s**2, np.zeros(np.shape(s), np.complex128)
        law = (
            material_law(model, s, 1.0, None) if ratio is None else None
        )  # the same for every mode
        for frequency, share in zip(
            map(float, frequencies), sizes / model.stiffness, strict=True
        ):
            stiff = material_law(model, s, frequency, ratio) if law is None else law
            total += share * square / (square + frequency**2 * stiff)
        return total

    return torque
