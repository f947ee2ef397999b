"""Joint identification of several payloads, and the test whether their common
parameters may be common.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.special import gammaincc

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES, LinkModel
from fraclink._arm.link import structure as structure_row
from fraclink._display import Overview, Row, Table, displayed, rows_of
from fraclink._identify.compare import preferred_structure
from fraclink._identify.fit import SYMBOLS
from fraclink._identify.fitting import Stiffness, make_search
from fraclink._identify.joint import JointProblem, weight_of
from fraclink._identify.problem import RESOLUTION, descend, inverted
from fraclink._identify.search import Search
from fraclink._identify.shape import Hold, columns_of, model_of
from fraclink._identify.uncertainty import structure_criteria
from fraclink.errors import LogError, NotConvergedError
from fracsys.checks import Real, above, checked, checked_choice
from fracsys.checks.equality import compared

Length = Annotated[float, above(0.0, 1e3, "m")]


@dataclass(frozen=True)
class LikelihoodRatio:
    """Test of the common parameters against separate ones for every payload.

    Parameters
    ----------
    statistic
        Σ (n/k) ln(MSE joint / MSE alone), k the inflation by the residual's colour; it
        follows a χ² distribution where the parameters are common.
    degrees
        of freedom of that distribution.
    p_value
        the chance of a larger statistic.
    """

    statistic: float
    degrees: int
    p_value: float

    @property
    def common(self) -> bool:
        """Whether the logs let the parameters be common (p ≥ 0.05)."""
        # Of logs with truly common parameters one in twenty is rejected, the usual
        # type I error.
        return self.p_value >= 0.05


@displayed
@compared
@dataclass(frozen=True, eq=False, repr=False)
class JointFit:
    """One structure fitted to several payloads at once.

    Parameters
    ----------
    structure
        the structure.
    common
        names of the parameters that all payloads share.
    models, gains
        one for each log, in their order; a model's gauge delay is that of its log.
    mse
        for each log.
    alone_mse
        of the separate fits of the logs.
    standard_errors
        of the common parameters, and of each log's own ones ("resonance 1" …).
    stiffness
        c [N·m/rad] where ω₀ was tied by eq. (5) and the length was given, else None.
    stiffness_over_square
        c/L² [N/(m·rad)] where ω₀ was tied.
    test
        whether the parameters may be common.
    verdict
        the same in words.
    predicted
        one array for each log [unit of its output].
    """

    structure: str
    common: tuple[str, ...]
    models: tuple[LinkModel, ...]
    gains: tuple[float, ...]
    mse: tuple[float, ...]
    alone_mse: tuple[float, ...]
    standard_errors: dict[str, float]
    stiffness: float | None
    stiffness_over_square: float | None
    test: LikelihoodRatio
    verdict: str
    predicted: tuple[Real, ...]

    def overview(self) -> Overview:
        """The link of every payload, and how much the common parameters cost."""
        free = structure_row(self.structure).free
        records = (
            (
                Row("payload", "payload", model.payload, "g"),
                *(
                    Row(name, SYMBOLS[name][0], getattr(model, name), digits=6)
                    for name in free
                ),
                Row("mse", "MSE together", together),
                Row("alone_mse", "MSE alone", alone),
            )
            for model, together, alone in zip(
                self.models, self.mse, self.alone_mse, strict=True
            )
        )
        rows = rows_of(
            self,
            "structure",
            "common",
            "standard_errors",
            ("stiffness", "stiffness c", "N·m/rad"),
            Row("p_value", "chance of a larger difference", self.test.p_value),
            "verdict",
        )
        return Overview(self.verdict, rows=rows, tables=(Table.of("logs", records),))


@checked
def identify_payloads(
    logs: Sequence[Experiment],
    structure: str | None = None,
    *,
    common: Sequence[str] | None = None,
    tied: bool = False,
    length: Length | None = None,
    stiffness: Stiffness | None = None,
    delay: float | None = None,
    hold: Hold = "auto",
) -> JointFit:
    """Fit one structure to several payloads with common parameters, and test whether
    they may be common.

        minimise Σ_i Σ_k (y_ik − gain_i·ŷ_ik − offset_i)² / (σ_i² k_i)

    Parameters
    ----------
    logs
        two or more experiments, each at another payload; sampling periods may differ.
    structure
        a key of the table of structures; without it, the one that all logs together
        support.
    common
        of "order", "damping", "damping_order", "delay"; all of the structure's own by
        default. A common "damping" is the paper's common μ; for one material
        μ/ω₀² is common instead (`LinkModel.at_payload`).
    tied
        whether one stiffness gives every ω₀_i = sqrt(c/(m_i L²)), eq. (5), instead of a
        separate ω₀ for each log.
    length
        L [m], only to report c from c/L² where tied.
    stiffness
        gain where it is known [N·m/rad].
    delay
        where it is known [s]; otherwise every log has its own.
    hold
        as in `identify`.

    Raises
    ------
    LogError
        fewer than two logs; where tied, a missing payload or the same one in all logs.
    FieldError
        unknown names.
    NotConvergedError
        the logs have no joint fit.

    References
    ----------
    Benftima et al. (2023), Tables 2 and 3 and equation (5).

    Examples
    --------
    >>> from fraclink._arm.experiment import Experiment
    >>> from fraclink._identify import simulated_torque
    >>> from fraclink._arm.link import LinkModel
    >>> angle = np.clip((0.004 * np.arange(2500) - 0.5) / 0.3, 0, 1)
    >>> link = LinkModel(1.56, 10.0, order=1.92, payload=0.03)
    >>> logs = [
    ...     Experiment(period=0.004, motor_angle=angle, payload=m,
    ...                output=simulated_torque(link.at_payload(m), angle, 0.004))
    ...     for m in (0.02, 0.03, 0.04)
    ... ]
    >>> fit = identify_payloads(logs, tied=True, length=0.65)
    >>> round(fit.models[0].order, 6), round(fit.stiffness_over_square, 5), fit.test.common
    (1.92, 3.0, True)
    """
    _check(logs, tied)
    fixed = {} if delay is None else {"delay": delay}
    searches = [
        # Nothing is held out: the likelihood ratio compares fits over the same samples.
        make_search(
            log, heldout=0.0, stiffness=stiffness, fixed=fixed, guess=None, hold=hold
        )
        for log in logs
    ]
    structure = _supported(searches) if structure is None else structure
    # ω₀ is separate for each payload, or given by eq. (5): the common parameters are
    # those of the link's material.
    own = tuple(
        name for name in structure_row(structure).free if name != "natural_frequency"
    )
    names = (
        own
        if common is None
        else tuple(
            checked_choice(
                "common", name, (*own, "delay"), remedy=f"{structure} has these"
            )
            for name in common
        )
    )
    # The separate fits of the logs give the start and the weights of the joint fit, and
    # the reference of the test.
    alone = [search.solve(structure) for search in searches]
    weights = [
        weight_of(search, solution)
        for search, solution in zip(searches, alone, strict=True)
    ]
    free = ("natural_frequency", *own, *(() if delay is not None else ("delay",)))
    shared = (("natural_frequency",) if tied else ()) + names
    joint = JointProblem(
        searches,
        weights,
        free,
        tuple(name for name in shared if name in free),
        delay or 0.0,
        np.array([log.payload for log in logs]) if tied else None,
    )
    descent = descend(joint, joint.start(alone)[None, :])
    if not math.isfinite(descent.costs[0]):
        raise NotConvergedError(
            "the joint fit",
            reached=math.inf,
            wanted=0.0,
            remedy="fit each log alone first, they may not belong together",
        )
    theta, covariance = descent.places[0], inverted(descent.normal[0])[0]
    # Errors over all samples and unweighted, so that a user can compare the figures of
    # different logs.
    models, gains, mse, predicted = (
        tuple(column)
        for column in zip(
            *(_of_one(log, i, joint, theta) for i, log in enumerate(logs)), strict=True
        )
    )
    alone_mse = tuple(
        solution.cost / log.output.size
        for solution, log in zip(alone, logs, strict=True)
    )
    # θ begins with ln(ω₀² m) where it is common.
    over = math.exp(theta[0]) if tied else None
    test = _test(joint, logs, mse, alone_mse)
    return JointFit(
        structure,
        names,
        models,
        gains,
        mse,
        alone_mse,
        _errors(joint, theta, covariance, tied),
        stiffness=over * length**2 if over is not None and length is not None else None,
        stiffness_over_square=over,
        test=test,
        verdict=_verdict(names, tied, len(logs), test),
        predicted=predicted,
    )


def _supported(searches: Sequence[Search]) -> str:
    """The structure supported by all logs together: their log-likelihoods, and thus the
    criteria, are added.
    """
    criteria = [structure_criteria(search) for search in searches]
    return preferred_structure(
        {
            name: (
                sum(log[name][0] for log in criteria),
                sum(log[name][1] for log in criteria),
            )
            for name in STRUCTURES
        }
    )


def _check(logs: Sequence[Experiment], tied: bool) -> None:
    if len(logs) < 2:
        raise LogError(
            "logs",
            len(logs),
            "too few",
            ">= 2",
            "use identify for a single log",
        )
    payloads = [log.payload for log in logs]
    if tied and (None in payloads or len(set(payloads)) < 2):
        raise LogError(
            "payload",
            str(payloads),
            "missing or all the same",
            "a mass for every log, two of them different",
            "state payload= when reading the logs",
        )


# --- the result -------------------------------------------------------------------------------------------


def _of_one(
    log: Experiment, i: int, joint: JointProblem, theta: Real
) -> tuple[LinkModel, float, float, Real]:
    """Model, gain, mean square error and prediction of one log."""
    search = joint.searches[i]
    shapes, _ = joint.shapes(theta[None, :], i)
    held = shapes[0]
    _, _, gain, offset, cost, _ = search.kernel.solve(
        held, 0, held, held, *search.known, 0
    )
    # The damping as it is in θ: its conversion by the resonance of each log rounds.
    model = replace(
        model_of(held, max(abs(gain), 1e-12), log.payload),
        damping=float(joint.rows(theta[None, :], i)[0, 2]),
    )
    predicted = gain * columns_of(search.kernel, held)[0] + offset
    return model, gain, cost / log.output.size, predicted


def _errors(
    joint: JointProblem, theta: Real, covariance: Real, tied: bool
) -> dict[str, float]:
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    frequency = "stiffness_over_square" if tied else "resonance"
    result: dict[str, float] = {}
    for i, places in enumerate(joint.index):
        for name, k in zip(joint.names, places.tolist(), strict=True):
            label = frequency if name == "natural_frequency" else name
            # These two are logarithms: d e^x = e^x dx.
            scale = (
                math.exp(theta[k]) if name in ("natural_frequency", "damping") else 1.0
            )
            key = label if name in joint.common else f"{label} {i + 1}"
            result[key] = float(errors[k] * scale)
    return result


def _test(
    joint: JointProblem,
    logs: Sequence[Experiment],
    mse: Sequence[float],
    alone_mse: Sequence[float],
) -> LikelihoodRatio:
    # Below what 16 bits resolve, errors are rounding.
    least = [RESOLUTION * float(np.var(log.output)) for log in logs]
    together, own = np.maximum([mse, alone_mse], least)
    # A coloured residual has fewer independent samples than samples: k divides their
    # number, and weight · own is 1/k.
    samples = [log.output.size for log in logs] * np.array(joint.weights) * own
    statistic = float(samples @ np.log(np.maximum(together / own, 1.0)))
    # The difference in the number of parameters between the separate fits and the joint
    # fit.
    degrees = joint.index.size - joint.box[0].size
    # The upper tail of χ², which keeps the digits of small values: 1 − P would round to
    # zero below 1e-16.
    p_value = float(gammaincc(degrees / 2, statistic / 2)) if degrees > 0 else 1.0
    return LikelihoodRatio(statistic, degrees, p_value)


def _verdict(
    common: Sequence[str], tied: bool, logs: int, test: LikelihoodRatio
) -> str:
    if test.degrees == 0:
        return "Nothing is common: every log was fitted separately."
    symbols = [SYMBOLS.get(name, ("the delay",))[0] for name in common]
    if tied:
        symbols.append("the stiffness of eq. (5)")
    # Below 1e-9 the tail of the χ² distribution means nothing for a real log.
    chance = f"p = {test.p_value:.2g}" if test.p_value >= 1e-9 else "p < 1e-9"
    may = "may" if test.common else "cannot"
    return f"{' and '.join(symbols)} {may} be common to these {logs} logs ({chance})."
