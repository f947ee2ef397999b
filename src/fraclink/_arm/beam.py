"""The link of the twin: an Euler–Bernoulli beam clamped at a turning hub, with a payload at its tip.

In the frame that turns with the hub the deflection w(x, t) obeys

    ρA (ẅ + x θ̈m) + EI D(s) w'''' = 0,    w(0) = w'(0) = 0,
    m (ẅ(L) + L θ̈m) = EI D(s) w'''(L),     J (ẅ'(L) + θ̈m) = −EI D(s) w''(L),

where D(s) is the damping law of the material (``damping.py``; D = 1 is the undamped link). Damping
proportional to the stiffness leaves the mode shapes real: with w = Σ φi(x) qi(t) every mode obeys

    q̈i + ωi² D(s) qi = −Γi θ̈m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from fraclink._validate import checked_between, checked_choice
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._arm.rig import Rig

__all__ = ["Beam", "Modes", "matrices", "rigid_rotation"]

Vector = NDArray[np.float64]

# 48 cubic elements: the third mode of the lightest payload is exact to 2e-7 and the fifth to 1e-5;
# doubling the number gains nothing once the eigenvalues are at 1e-8, where rounding takes over.
ELEMENTS = 48


def _check(field: str, value: float, *, zero: bool, unit: str, remedy: str) -> None:
    checked_between(field, value, 0.0, 1e9, unit, open_low=not zero, remedy=remedy)


@dataclass(frozen=True)
class Beam:
    """A uniform slender link with a payload: what bends, and what it carries.

    The stiffness of the lumped model follows as c = 3 EI/L [N·m/rad], and for a massless link the only
    mode is ω = √(c/(m L²)), equation (5) of the paper.

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
        moment of inertia of the payload about the tip [kg·m²], >= 0. The default 0 is the
        paper's rig: the disk turns freely, so no moment acts at the tip.

    Raises
    ------
    FieldError
        a value is negative, not finite, or there is nothing that could move.

    >>> rod = Beam(length=0.65, flexural_rigidity=0.26, link_mass=0.00735, payload=0.030)
    >>> [round(w, 2) for w in rod.modes(3).frequencies.tolist()]
    [9.46, 177.53, 569.81]
    >>> round(rod.stiffness, 3)
    1.2
    """

    length: float
    flexural_rigidity: float
    link_mass: float
    payload: float
    payload_inertia: float = 0.0

    def __post_init__(self) -> None:
        _check("length", self.length, zero=False, unit="m", remedy="give the length of the link in metres")
        _check(
            "flexural_rigidity",
            self.flexural_rigidity,
            zero=False,
            unit="N·m²",
            remedy="give EI, or c·L/3 from a measured stiffness",
        )
        _check("link_mass", self.link_mass, zero=True, unit="kg", remedy="give the mass of the link in kg")
        _check("payload", self.payload, zero=True, unit="kg", remedy="give the mass at the tip in kg")
        _check(
            "payload_inertia",
            self.payload_inertia,
            zero=True,
            unit="kg·m²",
            remedy="give the inertia about the tip, 0 for a disk that turns freely",
        )
        if self.link_mass == 0.0 and self.payload == 0.0 and self.payload_inertia == 0.0:
            raise FieldError(
                "payload",
                self.payload,
                "zero on a massless link",
                allowed="link_mass + payload > 0 kg",
                remedy="give the mass of the link or of the payload",
            )

    @property
    def stiffness(self) -> float:
        """Torque per angle between hub and tip, c = 3 EI/L [N·m/rad]."""
        return 3.0 * self.flexural_rigidity / self.length

    @property
    def inertia(self) -> float:
        """Moment of inertia of the straight link and its payload about the hub [kg·m²]."""
        return (self.link_mass / 3.0 + self.payload) * self.length**2 + self.payload_inertia

    @property
    def lumped_frequency(self) -> float:
        """Frequency of the massless link, √(c/(m L²)) of equation (5) [rad/s]; infinite without payload."""
        inertia = self.payload * self.length**2 + self.payload_inertia
        return math.sqrt(self.stiffness / inertia) if inertia > 0.0 else math.inf

    def with_payload(self, payload: float) -> Beam:
        """Return the same link with another mass [kg] at its tip.

        >>> Beam(0.65, 0.26, 0.00735, 0.030).with_payload(0.020).payload
        0.02
        """
        return replace(self, payload=payload)

    @staticmethod
    def from_rig(
        rig: Rig,
        *,
        payload: float | None = None,
        link_mass: float | None = None,
        rigidity: Literal["stiffness", "tabulated"] = "stiffness",
    ) -> Beam:
        """Return the beam of a rig.

        A rig may state EI and a measured stiffness that contradict each other (the paper's does:
        3 EI/L = 1.20, measured c = 1.56 N·m/rad). ``rigidity="stiffness"`` takes EI = c L/3, so that the
        twin and the lumped model agree at low frequency; ``"tabulated"`` takes the rig's EI.

        Parameters
        ----------
        payload
            mass at the tip [kg]; default the rig's nominal payload
        link_mass
            mass of the link [kg]; default the rig's
        """
        checked_choice(
            "rigidity",
            rigidity,
            ("stiffness", "tabulated"),
            remedy="say whether the measured stiffness or the tabulated EI holds",
        )
        link = rig.link
        tabulated = link.flexural_rigidity
        from_stiffness = link.stiffness * link.length / 3.0
        chosen = from_stiffness if rigidity == "stiffness" or tabulated is None else tabulated
        return Beam(
            length=link.length,
            flexural_rigidity=chosen,
            link_mass=link.mass if link_mass is None else link_mass,
            payload=rig.payloads.nominal if payload is None else payload,
        )

    def modes(self, count: int) -> Modes:
        """Return the first `count` clamped modes, fewer where the beam has fewer.

        A massless link has one mode (two with tip inertia); asking for more returns those.
        """
        if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= 12:
            raise FieldError(
                "modes", count, "out of range", allowed="1 to 12", remedy="three modes are the usual choice"
            )
        return _modes(self, count)


@dataclass(frozen=True)
class Modes:
    """Clamped modes of a beam, normalised to unit modal mass.

    frequencies: ωi [rad/s]; participation: Γi [√kg·m], the modal load of a unit hub acceleration;
    tip: φi(L)/L [1/(√kg·m)], the tip's angle per modal coordinate; curvature: EI φi''(0) [N·m/(√kg·m)],
    what a strain gauge at the base reads per modal coordinate; shapes: nodal values of the finite elements
    (2·ELEMENTS × modes: deflection and slope of each node but the clamped one).
    """

    frequencies: Vector
    participation: Vector
    tip: Vector
    curvature: Vector
    shapes: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Number of modes."""
        return int(self.frequencies.size)


def _element() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mass and stiffness of one cubic element, degrees of freedom (w, h·w') at both ends."""
    mass = (
        np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]], dtype=float)
        / 420.0
    )
    stiffness = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]], dtype=float)
    return mass, stiffness


def matrices(beam: Beam) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mass matrix [kg] and stiffness matrix [N/m] of the clamped beam; slopes times element length."""
    size = beam.length / ELEMENTS
    mass_unit, stiffness_unit = _element()
    mass = np.zeros((2 * ELEMENTS + 2,) * 2)
    stiffness = np.zeros_like(mass)
    for i in range(ELEMENTS):
        block = slice(2 * i, 2 * i + 4)
        mass[block, block] += mass_unit * (beam.link_mass / ELEMENTS)
        stiffness[block, block] += stiffness_unit * (beam.flexural_rigidity / size**3)
    mass[-2, -2] += beam.payload
    mass[-1, -1] += beam.payload_inertia / size**2
    return mass[2:, 2:], stiffness[2:, 2:]


def rigid_rotation(beam: Beam) -> Vector:
    """Return the nodal values of w = x, the straight link that turns by one radian."""
    size = beam.length / ELEMENTS
    rigid = np.full(2 * ELEMENTS, size)
    rigid[0::2] = size * np.arange(1, ELEMENTS + 1)
    return rigid


def _modes(beam: Beam, count: int) -> Modes:
    mass, stiffness = matrices(beam)
    factor = np.linalg.cholesky(stiffness)
    # The eigenvalues of L⁻¹ M L⁻ᵀ are 1/ω²: the wanted modes are the largest ones, and a massless link
    # (singular M) is an ordinary case; the usual K φ = ω² M φ would need M to be invertible.
    half = np.linalg.solve(factor, mass)
    flexibility = np.linalg.solve(factor, half.T)
    values, vectors = np.linalg.eigh(0.5 * (flexibility + flexibility.T))
    order = np.argsort(values)[::-1][:count]
    # A massless link has one eigenvalue, the others are rounding at 1e-17 of it.
    order = order[values[order] > 1e-13 * values[order[0]]]
    frequencies = 1.0 / np.sqrt(values[order])
    shapes = np.linalg.solve(factor.T, vectors[:, order]) * frequencies  # unit modal mass
    shapes = shapes * np.where(shapes[-2] < 0.0, -1.0, 1.0)
    rigid = rigid_rotation(beam)
    # EI φ''(0) from the base moment under the inertia load: exact to the order of the eigenvalue, where
    # differentiating the cubic twice would lose two orders. It is the moment K φ leaves at the clamp.
    curvature = frequencies**2 * (rigid @ (mass @ shapes))
    result = Modes(frequencies, rigid @ (mass @ shapes), shapes[-2] / beam.length, curvature, shapes)
    for array in (
        result.frequencies,
        result.participation,
        result.tip,
        result.curvature,
        result.shapes,
    ):
        array.flags.writeable = False
    return result
