"""One run of the closed loop with any arm: the model, the twin, or a real one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._display import Overview, Row, displayed, quantity, rows_of, state_of
from fraclink._files import Saved, document
from fraclink._simulate.metrics import Metrics, MoveVerdict, Signals, judge, measure
from fraclink.findings import Finding
from fracsys.checks import Real
from fracsys.checks.equality import compared

__all__ = ["Run", "judged_run", "payload_rejected"]

Bits = NDArray[np.uint32]


@displayed
@document(
    "run",
    version=2,
    container="npz",
    sources=lambda run: (
        {"law": run.about["law_sha256"]} if "law_sha256" in run.about else {}
    ),
)
@compared
@dataclass(frozen=True, eq=False)
class Run(Saved):
    """A run of the closed loop, one value per control period, each at the period's
    beginning; shape (N,).

    A signal that this arm does not have is NaN: the tip of a real arm is not measured.

    Parameters
    ----------
    time
        [s].
    reference
        θt* of the tip [rad].
    tip_angle
        θt [rad].
    motor_angle
        θm at the gear's output [rad].
    motor_reference
        θm*, the law's output [rad].
    torque
        Γ at the root of the link [N·m].
    motor_angle_measured
        reading of the encoder [rad].
    torque_measured
        reading of the gauge [N·m].
    tip_estimate
        θm − Γ/c as the law saw it [rad].
    voltage
        of the motor [V]; with an ideal motor loop the one that the motion needs,
        without compensations.
    mode, reason, flags
        of the law, see law.h.
    payload
        mass at the tip when the run began [kg]; NaN where only the natural frequency
        was known.
    metrics
        figures of the run.
    verdict
        whether it passed, and why.
    about
        what was run: plain values by name, among them "arm": "model", "twin" or "real".
    findings
        what a reader should know about the run.
    extras
        signals that only some arms have, by name, e.g. the twin's "contact_force" [N].
    finished
        False if the arm diverged and the run was cut short.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
    >>> law = fl.discretize(controller, rig.period, order=4)
    >>> run = fl.simulate(law, fl.smooth_step(1.0, 0.5), rig=rig, model=rig.model, duration=2.0)
    >>> len(run.time), run.payload, run.about["motor_loop"]
    (501, 0.03, 'ideal')
    """

    time: Real
    reference: Real
    tip_angle: Real
    motor_angle: Real
    motor_reference: Real
    torque: Real
    motor_angle_measured: Real
    torque_measured: Real
    tip_estimate: Real
    voltage: Real
    mode: Bits
    reason: Bits
    flags: Bits
    payload: float
    metrics: Metrics
    verdict: MoveVerdict
    about: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    extras: Mapping[str, Real] = field(default_factory=dict)
    finished: bool = True

    def __post_init__(self) -> None:
        # Plots, reports and comparisons share a run: to change a signal, take a copy.
        for values in (*vars(self).values(), *self.extras.values()):
            if isinstance(values, np.ndarray):
                values.flags.writeable = False

    @property
    def period(self) -> float:
        """Control period [s]."""
        # Computed from the samples: a stored period could differ from them.
        return float(self.time[1] - self.time[0])

    @property
    def error(self) -> Real:
        """Reference minus tip angle [rad]."""
        return self.reference - self.tip_angle

    @property
    def carried(self) -> str:
        """The payload at the tip, and the one that the law was given."""
        law_payload, payload = (
            self.about.get("payload_given", 0.0),
            quantity(self.payload, "g"),
        )
        if not law_payload:
            return payload
        if law_payload == "estimated":
            estimate = float(self.extras["payload_estimate"][-1])
            return f"{payload}, estimated {quantity(estimate, 'g') if estimate else 'not yet'}"
        # Any number other than the payload is a wrong one given to the law, and both are
        # shown.
        if isinstance(law_payload, str) or law_payload == self.payload:
            return f"{payload}, given"
        return f"{payload}, given {quantity(law_payload, 'g')}"

    @property
    def rows(self) -> tuple[Row, ...]:
        """Payload, figures of the move, and whether it passed."""
        figures = (replace(r, key=f"metrics.{r.key}") for r in self.metrics.rows)
        return rows_of(
            self,
            "payload",
            Row("", "payload", self.carried),
            *figures,
            *rows_of(self.verdict, "reason", ("passed", "verdict")),
        )

    def overview(self) -> Overview:
        """The result of the move."""
        return Overview(
            # The reason already names the missed requirement of the move with its
            # value.
            f"move with {self.carried}: {self.verdict.reason}",
            state_of(self.verdict.passed),
            self.rows,
            findings=self.findings,
        )


def judged_run(
    signals: Mapping[str, NDArray[Any]],
    *,
    payload: float,
    period: float,
    ended: float,
    vibration_period: float,
    about: Mapping[str, Any],
    findings: tuple[Finding, ...] = (),
    extras: Mapping[str, NDArray[Any]] | None = None,
    finished: bool = True,
    growth: float | None = None,
) -> Run:
    """Return the run with the named signals (without `time`), measured and judged.

    Parameters
    ----------
    payload
        [kg].
    period
        [s].
    ended
        when the reference came to rest [s].
    vibration_period
        of the link [s].
    growth
        of the vibration [1/s], where a longer run than this one measured it.
    """
    block = Signals.of(signals, period, ended, vibration_period)
    # A campaign follows a growing vibration for twice as long; a replay of the shorter
    # run must reach the same verdict.
    metrics = (
        measure(block) if growth is None else replace(measure(block), growth=growth)
    )
    return Run(
        time=period * np.arange(len(signals["reference"]), dtype=np.float64),
        **signals,
        payload=payload,
        metrics=metrics,
        verdict=judge(block, metrics),
        about=about,
        findings=(*findings, *payload_rejected(signals["flags"])),
        extras=extras or {},
        finished=finished,
    )


def payload_rejected(flags: NDArray[Any]) -> tuple[Finding, ...]:
    """Return W603 if the law was given a payload that it cannot use: it ran as if none
    had been given.
    """
    # A flag, not an error: the law goes on controlling with the inputs that it can use.
    periods = int(np.count_nonzero(flags & _kernels.LAW_FLAG_PAYLOAD))
    if not periods:
        return ()
    return (
        Finding(
            "W603",
            "warning",
            f"the law rejected the payload that it was given in {periods} of {len(flags)} periods, "
            "and ran there as if none were given",
            {"periods": periods},
            "give a payload within the law's limit, and design with a link model that knows its payload",
        ),
    )
