"""A study: everything that came out of one log, together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment
    from fraclink._arm.rig import Rig
    from fraclink._campaign.faults import FaultTable
    from fraclink._certify import Certificate
    from fraclink._design import Design
    from fraclink._identify import Comparison, Fit
    from fraclink._law import Law
    from fraclink._simulate import Run
    from fraclink.findings import Finding

__all__ = ["Move", "Study"]


@dataclass(frozen=True)
class Move:
    """A move of the tip that a simulation makes.

    Arguments:
        amplitude: angle to go [rad].
        move_time: time to go it in [s], > 0.
        duration: time that is simulated [s].
        gauge_offset: constant error of the gauge [N·m]; None takes the rig's.
        noise: standard deviation of the gauge's noise [N·m]; None takes the rig's.
        inner: the motor loop, ``"ideal"`` (M(s)) or ``"sampled"`` (motor, friction, saturation).
        seed: seed of the noise.

    >>> Move(amplitude=0.5).duration
    4.0
    """

    amplitude: float = 1.0
    move_time: float = 0.5
    duration: float = 4.0
    gauge_offset: float | None = None
    noise: float | None = None
    inner: Literal["ideal", "sampled"] = "sampled"
    seed: int = 0


@dataclass(frozen=True)
class Study:
    """What one log led to. Every part may be missing: a folder may hold some stages only.

    Arguments:
        rig: the rig.
        experiment: the log.
        findings: what its examination noticed.
        comparison: the fits of all structures.
        fit: the fit whose model the design used.
        design: the design.
        law: the discrete law of the design.
        infeasible: why there is no design, where there is none.
        certificate: the proof of the design, where one was asked for and found.
        uncertified: why there is none, where one was asked for.
        runs: simulated moves, one for each payload.
        assumptions: sentences on everything that nobody stated.
        faults: a fault campaign on the design; it has a verdict of its own.

    >>> Study().passed
    False
    """

    rig: Rig | None = None
    experiment: Experiment | None = None
    findings: tuple[Finding, ...] = ()
    comparison: Comparison | None = None
    fit: Fit | None = None
    design: Design | None = None
    law: Law | None = None
    infeasible: str | None = None
    certificate: Certificate | None = None
    uncertified: str | None = None
    runs: tuple[Run, ...] = ()
    assumptions: tuple[str, ...] = ()
    faults: FaultTable | None = None

    @property
    def fits(self) -> Mapping[str, Fit]:
        """The fits by structure: all that were compared, or the one that there is."""
        if self.comparison is not None:
            return self.comparison.fits
        return {} if self.fit is None else {self.fit.structure: self.fit}

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the study does not hold; empty where it does."""
        # A design may be good and the log behind it wrong: a reversed gauge fits as well as a right one.
        wrong = tuple(f"the log: {f.message}; {f.remedy}" for f in self.findings if f.severity == "error")
        if self.design is None:
            return (*wrong, self.infeasible or "there is no design")
        missed = (
            f"{requirement.name}: wanted {requirement.wanted:.4g}, achieved {requirement.achieved:.4g}"
            for requirement in self.design.requirements
            if not requirement.passed
        )
        moves = (
            f"move at {1e3 * run.payload:g} g: {run.verdict.reason}"
            for run in self.runs
            if not run.verdict.passed
        )
        unproved = () if self.uncertified is None else (f"not certified: {self.uncertified}",)
        return (*wrong, *missed, *unproved, *moves, *(() if self.runs else ("no move was simulated",)))

    @property
    def passed(self) -> bool:
        """True where the log is sound and every requirement of the design and every simulated move holds."""
        return not self.reasons
