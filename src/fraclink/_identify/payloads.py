"""Identify several payloads together: what is common to them, and may it be?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import structure as structure_row
from fraclink._identify.joint import Coordinates
from fraclink._identify.jointfit import JointFit, LikelihoodRatio
from fraclink._identify.jointsolve import make_coordinates, minimise, start_of, weight_of
from fraclink._identify.problem import Hold, columns_of
from fraclink._identify.search import Search
from fraclink._identify.shape import model_of
from fraclink._identify.single import make_search
from fraclink._identify.solution import Solution
from fraclink._identify.statistics import aic
from fraclink._validate import checked_between, checked_choice, checked_noun
from fraclink.errors import FieldError, LogError

__all__ = ["JointFit", "LikelihoodRatio", "identify_payloads"]

_COMMON = {"order": "λ", "damping": "μ", "damping_order": "α", "delay": "the delay"}


def identify_payloads(
    logs: Sequence[Experiment],
    structure: str = "UD-FOM",
    *,
    common: Sequence[str] | None = None,
    tied: bool = False,
    length: float | None = None,
    stiffness: float | None = None,
    delay: float | None = None,
    hold: Hold = "auto",
) -> JointFit:
    """Fit one structure to several payloads with common parameters, and test whether they may be common.

        minimise Σ_i Σ_k (y_ik − gain_i·ŷ_ik − offset_i)² / (σ_i² k_i)

    Arguments:
        logs: two or more experiments, each at another payload; sampling periods may differ.
        structure: "UD-IOM", "D-IOM", "UD-FOM" or "D-FOM".
        common: of "order", "damping", "damping_order", "delay"; all of the structure's own by default.
        tied: ω₀_i = sqrt(c/(m_i L²)), eq. (5), through one stiffness instead of an own ω₀ for each.
        length: L [m], only to report c from c/L² where tied.
        stiffness: gain [N·m/rad] where it is known.
        delay: [s] where it is known; otherwise every log has its own.
        hold: as in `identify`.

    Raises LogError for fewer than two logs, a missing or repeated payload where tied, and FieldError for
    unknown names. Source: the paper, Tables 2 and 3 and equation (5).

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
    names = _names(structure, common)
    _check(logs, tied)
    if length is not None:
        length = checked_between("length", length, 0.0, 1e3, "m", open_low=True)
    fixed = {} if delay is None else {"delay": delay}
    searches = [
        make_search(log, heldout=0.0, stiffness=stiffness, fixed=fixed, guess=None, hold=hold) for log in logs
    ]
    alone = [search.solve(structure) for search in searches]
    weights = [weight_of(search, solution) for search, solution in zip(searches, alone, strict=True)]
    payloads = tuple(float(log.payload or 0.0) for log in logs) if tied else None
    coordinates = make_coordinates(structure, names, tied, len(logs), delay, payloads)
    start = start_of(coordinates, alone, structure)
    theta, normal = minimise(coordinates, searches, weights, start)
    return _assembled(logs, structure, names, coordinates, searches, alone, weights, theta, normal, length)


def _names(structure: str, common: Sequence[str] | None) -> tuple[str, ...]:
    own = [name for name in structure_row(structure).free if name != "natural_frequency"]
    if common is None:
        return tuple(own)
    return tuple(
        checked_choice("common", name, (*own, "delay"), remedy=f"{structure} has these")
        for name in (common if isinstance(common, list | tuple) else (common,))
    )


def _check(logs: Sequence[Experiment], tied: bool) -> None:
    if not isinstance(logs, list | tuple):
        raise FieldError("logs", logs, "no list", allowed=">= 2 experiments", remedy="give [first, second]")
    for i, log in enumerate(logs):
        checked_noun(f"logs[{i}]", log, Experiment, remedy="read the file with read_log first")
    if len(logs) < 2:
        raise LogError("logs", len(logs), "too few", allowed=">= 2", remedy="use identify for a single log")
    payloads = [log.payload for log in logs]
    if tied and (None in payloads or len(set(payloads)) < 2):
        raise LogError(
            "payload",
            str(payloads),
            "missing or all the same",
            allowed="a mass for every log, two of them different",
            remedy="state payload= when reading the logs",
        )


def _assembled(
    logs: Sequence[Experiment],
    structure: str,
    common: tuple[str, ...],
    coordinates: Coordinates,
    searches: Sequence[Search],
    alone: Sequence[Solution],
    weights: Sequence[float],
    theta: NDArray[np.float64],
    normal: NDArray[np.float64],
    length: float | None,
) -> JointFit:
    models, gains, offsets, delays, mse, criteria, predicted = [], [], [], [], [], [], []
    for i, (log, search) in enumerate(zip(logs, searches, strict=True)):
        shape, _ = coordinates.shape(theta, i)
        raw = columns_of(search.kernel, shape)[0]
        gain, offset = _linear(raw, log.output, search)
        model = model_of(shape, max(abs(gain), 1e-12), log.payload)
        if "damping" in coordinates.names and model.damping > 0:
            # The way through each log's own resonance rounds: the last digits would differ.
            model = replace(model, damping=math.exp(theta[coordinates.index("damping", i)]))
        models.append(model)
        error = log.output - gain * raw - offset
        gains.append(gain)
        offsets.append(offset)
        delays.append(float(shape[4]))
        mse.append(float(np.mean(error**2)))
        criteria.append(aic(mse[-1], log.output.size, len(structure_row(structure).free)))
        predicted.append(gain * raw + offset)
    alone_mse = [solution.cost / log.output.size for solution, log in zip(alone, logs, strict=True)]
    over = math.exp(theta[coordinates.index("frequency", 0)]) if coordinates.payloads else None
    test = _test(coordinates, logs, weights, mse, alone_mse, structure)
    return JointFit(
        structure=structure,
        common=common,
        models=tuple(models),
        gains=tuple(gains),
        offsets=tuple(offsets),
        delays=tuple(delays),
        mse=tuple(mse),
        aic=tuple(criteria),
        alone_mse=tuple(alone_mse),
        standard_errors=_errors(coordinates, theta, normal),
        stiffness=over * length**2 if over is not None and length is not None else None,
        stiffness_over_square=over,
        test=test,
        verdict=_verdict(coordinates, common, test),
        predicted=tuple(predicted),
    )


def _linear(raw: NDArray[np.float64], output: NDArray[np.float64], search: Search) -> tuple[float, float]:
    gain, offset = search.gain, search.offset
    if math.isnan(gain) and math.isnan(offset):
        gain = float(np.cov(raw, output, bias=True)[0, 1] / np.var(raw))
        return gain, float(np.mean(output) - gain * np.mean(raw))
    if math.isnan(gain):
        return float(raw @ (output - offset) / (raw @ raw)), offset
    return gain, float(np.mean(output - gain * raw)) if math.isnan(offset) else offset


def _errors(
    coordinates: Coordinates, theta: NDArray[np.float64], normal: NDArray[np.float64]
) -> dict[str, float]:
    covariance = np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
    errors = np.sqrt(np.maximum(np.diag(covariance), 0))
    result: dict[str, float] = {}
    for name in coordinates.names:
        for i in range(coordinates.logs):
            k = coordinates.index(name, i)
            scale = math.exp(theta[k]) if name in ("damping", "frequency") else 1.0
            label = (
                name
                if name != "frequency"
                else ("stiffness_over_square" if coordinates.payloads else "resonance")
            )
            result[label if name in coordinates.common else f"{label} {i + 1}"] = float(errors[k] * scale)
    return result


def _test(
    coordinates: Coordinates,
    logs: Sequence[Experiment],
    weights: Sequence[float],
    mse: Sequence[float],
    alone_mse: Sequence[float],
    structure: str,
) -> LikelihoodRatio:
    from scipy.special import gammaincc

    statistic = 0.0
    for log, weight, joint, own in zip(logs, weights, mse, alone_mse, strict=True):
        scale = weight * own  # 1/k
        statistic += log.output.size * scale * math.log(max(joint / own, 1.0)) if own > 0 else 0.0
    own_size = coordinates.logs * len(coordinates.names)
    degrees = own_size - coordinates.size
    p_value = float(gammaincc(degrees / 2, statistic / 2)) if degrees > 0 else 1.0
    return LikelihoodRatio(statistic, degrees, p_value)


def _verdict(coordinates: Coordinates, common: Sequence[str], test: LikelihoodRatio) -> str:
    if test.degrees == 0:
        return "Nothing is common: every log was fitted for itself."
    shared = [_COMMON[name] for name in common]
    if coordinates.payloads is not None:
        shared.append("the stiffness of eq. (5)")
    subject = " and ".join(shared)
    chance = f"p = {test.p_value:.2g}" if test.p_value >= 1e-9 else "p < 1e-9"
    may = "may" if test.common else "cannot"
    return f"{subject} {may} be common to these {coordinates.logs} logs ({chance})."
