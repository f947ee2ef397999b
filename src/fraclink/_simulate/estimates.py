"""The output of the payload estimator during a run: its signals and the findings about
them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._law import Law
from fraclink._law.design import Design
from fraclink._law.estimator import Estimates, PayloadEstimator
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks import Mask, Real

__all__ = [
    "ESTIMATED",
    "estimate_findings",
    "estimate_signals",
    "estimated_over",
    "estimator_for",
]


# value of `told` and of a run's "payload_given" if the law was given the estimate
ESTIMATED = "estimated"
_NAMES = (
    "payload_given",
    "payload_estimate",
    "payload_low",
    "payload_high",
    "payload_flags",
)


def estimated_over(
    estimator: PayloadEstimator,
    state: bytes,
    motor_angle: Real,
    torque: Real,
    ticks: NDArray[np.integer[Any]],
    called: Mask,
) -> Estimates:
    """Run the estimator over the sensors of a run, with the same bits as in the loop.

    `called` is False in periods that the control missed, which keep the previous
    values.
    """
    _, columns = estimator.run(
        state, motor_angle[called], torque[called], ticks=ticks[called]
    )
    # Number of the latest call at each period; before the first call the first one is
    # used.
    row = np.maximum(np.cumsum(called) - 1, 0)
    return Estimates(*(column[row] for column in columns))


def estimate_signals(estimates: Estimates) -> dict[str, Real]:
    """Return the signals in the form of a run: given, estimate, low and high [kg],
    flags.
    """
    return {
        name: np.asarray(values, np.float64)
        for name, values in zip(_NAMES, estimates, strict=True)
    }


def estimator_for(
    design: Design | Law,
    told: bool | float | str | PayloadEstimator,
) -> PayloadEstimator | None:
    """Return the payload estimator in the law's precision; None if the payload is
    given, or not used.

    FieldError for the estimate of a law alone, which does not state link and payloads,
    and for an estimator that was made for another period.
    """
    if isinstance(told, PayloadEstimator):
        law = design.law() if isinstance(design, Design) else design
        # The models are recursions at one period: at another one all frequencies would
        # be scaled.
        if not math.isclose(told.period, law.period, rel_tol=1e-9):
            raise FieldError(
                "estimator.period",
                told.period,
                "not the law's",
                f"{law.period} s",
                "make it for this law: design.estimator()",
            )
        # On a board, law.c and the estimator share the same type of reals.
        return told.in_precision(law.precision)
    if told != ESTIMATED:
        return None
    if not isinstance(design, Design):
        raise FieldError(
            "told",
            told,
            "not possible with a law alone, which does not state its payloads",
            "a design, or an estimator",
            "give the design in place of its law, or "
            "told=fraclink.extend.payload_estimator(model, rig, law, payloads)",
        )
    return design.estimator()


def estimate_findings(
    estimator: PayloadEstimator, estimates: Estimates, period: float
) -> tuple[Finding, ...]:
    """Return W604 if the estimate left the payloads of the certificate, W605 if it
    detected a contact.
    """
    findings = []
    outside = (estimates.flags & _kernels.PAYLOAD_OUTSIDE) != 0
    if outside.any():
        low, high = estimator.certified
        # The last time outside: early in a move the estimate is less accurate.
        last = np.flatnonzero(outside)[-1]
        share = f"{1e3 * estimates.low[last]:.3g} to {1e3 * estimates.high[last]:.3g} g"
        findings.append(
            Finding(
                "W604",
                "warning",
                f"the estimated payload ({share} the last time) left the {1e3 * low:g} to {1e3 * high:g} g that "
                f"the design covers, in {np.count_nonzero(outside)} of {outside.size} periods",
                {
                    "low": float(estimates.low[last]),
                    "high": float(estimates.high[last]),
                },
                "design for a range that holds this payload: the certificate says nothing about it",
            )
        )
    contact = (estimates.flags & _kernels.PAYLOAD_CONTACT) != 0
    if contact.any():
        # The first contact; later ones are due to the arm swinging from it.
        first = float(period * np.flatnonzero(contact)[0])
        findings.append(
            Finding(
                "W605",
                "warning",
                f"the gauge showed a torque at {first:.3g} s that no payload explains: the arm touched "
                "something",
                {"time": first},
                "see what stands in its way; a program on the board can stop at this flag",
            )
        )
    return tuple(findings)
