"""A rig: everything that is known about one flexible arm before a log is read."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from fraclink._arm.link import LinkModel
from fraclink._arm.rig.columns import LogColumns
from fraclink._arm.rig.parts import DesignRequest, Encoder, Gauge, Inner, Link, Motor, Payloads
from fraclink._arm.rig.quantities import NAME, SENTENCE, SOURCE, Quantity, check_fields
from fraclink.errors import FieldError
from fraclink.findings import Finding

__all__ = ["Rig"]

_FOLDER = Path(__file__).resolve().parents[2] / "rigs"
_TOLERANCE = 0.02  # 2 %: two measurements of one stiffness agree to about that; the paper's differ by 30 %


@dataclass(frozen=True)
class Rig:
    """One flexible-link robot: motor, link, payloads, sensors, sampling period, and what was assumed.

    Arguments:
        name: how reports call it.
        motor, link, payloads, encoder, gauge, inner: its parts.
        period: sampling period Ts [s], > 0 and <= 10.
        model: link model that the file carries, or None.
        log: which column of a log is what, or None.
        design: what a design should reach where nobody says otherwise, or None.
        assumptions: sentences on values that nobody measured, shown in every report.
        source: where the values come from.

    `warnings` lists contradictions between the values (codes W101 …). Raises FieldError.
    Source: Benftima, Gharab, Feliu-Batlle (2023), section 2 and Table 1.

    >>> rig = Rig.named("paper-2023")
    >>> rig.link.stiffness, rig.period
    (1.56, 0.004)
    """

    name: Annotated[str, NAME]
    motor: Motor
    link: Link
    payloads: Payloads
    period: Annotated[float, Quantity("period_s", "s", above=0, at_most=10)]
    encoder: Encoder = field(default_factory=Encoder)
    gauge: Gauge = field(default_factory=Gauge)
    inner: Inner = field(default_factory=Inner)
    model: LinkModel | None = None
    log: LogColumns | None = None
    design: DesignRequest | None = None
    assumptions: tuple[str, ...] = ()
    source: Annotated[str, SOURCE] = ""

    def __post_init__(self) -> None:
        check_fields(self, "")
        object.__setattr__(self, "assumptions", tuple(self.assumptions))
        for number, sentence in enumerate(self.assumptions):
            SENTENCE.check(f"assumptions[{number}]", sentence)

    @staticmethod
    def named(name: str) -> Rig:
        """Return a rig that comes with the package; `Rig.names()` lists them.

        >>> Rig.named("paper")
        Traceback (most recent call last):
        fraclink.errors.FieldError: rig: unknown (got paper); expected paper-2023. Did you mean 'paper-2023'?
        """
        from fraclink._arm.rig.reading import suggestion

        names = Rig.names()
        if name not in names:
            remedy = suggestion(str(name), names) or "give one of these, or the path of your own file"
            raise FieldError("rig", name, "unknown", allowed=", ".join(names), remedy=remedy)
        return Rig.load(_FOLDER / f"{name}.toml")

    @staticmethod
    def names() -> tuple[str, ...]:
        """The names of the rigs that come with the package.

        >>> Rig.names()
        ('paper-2023',)
        """
        return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))

    @staticmethod
    def load(path: Path | str) -> Rig:
        """Read a rig file; every fault of it is listed at once.

        Raises FileFormatError (not TOML, or over its limits), FieldError (a value) or RigError (several).
        """
        from fraclink._arm.rig.reading import load_arguments

        return Rig(**load_arguments(Path(path), Rig.names()))

    def save(self, path: Path | str) -> None:
        """Write the rig to one TOML file that `Rig.load` reads back equal."""
        from fraclink._arm.rig.writing import rig_text
        from fraclink._files import write_text

        write_text(path, rig_text(self))

    def natural_frequency(self, payload: float) -> float:
        """ω₀ = √(c/(m L²)) of a payload m [kg], eq. (5), in s^(−λ/2): rad/s for λ = 2 only.

        Raises FieldError where the payload is not a positive number.

        >>> round(Rig.named("paper-2023").natural_frequency(0.030), 4)
        11.094
        """
        mass = Quantity("payload", "kg", above=0, remedy="give the mass in kg").check("payload", payload)
        return math.sqrt(self.link.stiffness / (mass * self.link.length**2))

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Contradictions between the rig's own values, each with both of them."""
        checks = (self._stiffness_finding(), *self._model_findings(), self._mass_finding())
        return tuple(finding for finding in checks if finding is not None)

    def _stiffness_finding(self) -> Finding | None:
        stated, computed = self.link.stiffness, self.link.beam_stiffness
        if abs(stated - computed) <= _TOLERANCE * computed:
            return None
        return Finding(
            "W101",
            "warning",
            f"link.stiffness = {stated:.6g} N·m/rad contradicts 3EI/L = {computed:.6g} N·m/rad",
            {"stiffness": stated, "beam_stiffness": computed},
            "fraclink uses the stated stiffness; measure it, or correct EI or L",
        )

    def _model_findings(self) -> list[Finding | None]:
        model = self.model
        if model is None:
            return []
        findings: list[Finding | None] = [
            _contradiction("W102", "model.stiffness", model.stiffness, "link.stiffness", self.link.stiffness)
        ]
        if model.payload is not None:
            lumped = self.natural_frequency(model.payload)
            name = f"eq. (5) at {model.payload:g} kg"
            findings.append(
                _contradiction("W103", "model.natural_frequency", model.natural_frequency, name, lumped)
            )
        return findings

    def _mass_finding(self) -> Finding | None:
        if self.link.mass <= self.payloads.low:
            return None
        return Finding(
            "W104",
            "info",
            f"the link ({self.link.mass:g} kg) outweighs the lightest payload ({self.payloads.low:g} kg): "
            "one vibration mode may not be enough",
            {"link_mass": self.link.mass, "lightest_payload": self.payloads.low},
            "look at the residual of the fit above the first resonance",
        )


def _contradiction(code: str, first: str, value: float, second: str, other: float) -> Finding | None:
    if abs(value - other) <= _TOLERANCE * other:
        return None
    return Finding(
        code,
        "warning",
        f"{first} = {value:.6g} contradicts {second} = {other:.6g}",
        {"stated": value, "expected": other},
        f"fraclink uses {first}; correct the one that is wrong",
    )
