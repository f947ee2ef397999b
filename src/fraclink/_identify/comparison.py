"""Four structures on one log, and what may be concluded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from fraclink._arm.link import STRUCTURES, structure
from fraclink._identify.fit import Fit
from fraclink._identify.problem import Hold
from fraclink._identify.single import fit_from, make_search

if TYPE_CHECKING:
    from fraclink._arm.experiment import Experiment

__all__ = ["Comparison", "Contest", "identify_all"]

# Chance alone lowers the AIC by 2 or more with one superfluous parameter in one log of twenty-two (4: in one
# of seventy): a difference below 4 is no reason to carry another parameter.
_DECISIVE = 4.0


@dataclass(frozen=True)
class Contest:
    """Which of two structures with equally many parameters a log prefers.

    `advantage` of the second is n ln(MSE first / MSE second)/k: twice the difference of the
    log-likelihoods, with the n samples counted as n/k where the residual is not white (k is the fits'
    variance inflation). Below 4 the log cannot tell.
    """

    first: str
    second: str
    advantage: float

    @property
    def preferred(self) -> str | None:
        """The better one, None where they cannot be told apart."""
        if abs(self.advantage) < _DECISIVE:
            return None
        return self.second if self.advantage > 0 else self.first


@dataclass(frozen=True, eq=False)
class Comparison:
    """The four structures fitted to one log.

    Arguments:
        fits: structure → fit, in the order UD-IOM, D-IOM, UD-FOM, D-FOM.
        without_delay: the same with the delay held at zero (parameters and errors only, no details).
        preferred: of the structures whose `Fit.tic` (the AIC where the residual is white) is within 4 of the
            lowest, the one with the fewest parameters, then with the lowest `tic`.
        contest: UD-FOM against D-IOM, which have as many parameters.
        verdict: what may be concluded, in words.
    """

    fits: Mapping[str, Fit]
    without_delay: Mapping[str, Fit]
    preferred: str
    contest: Contest
    verdict: str

    def __post_init__(self) -> None:
        for name in ("fits", "without_delay"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __str__(self) -> str:
        from fraclink._identify.text import comparison_text

        return comparison_text(self)

    @property
    def best(self) -> Fit:
        """The preferred fit."""
        return self.fits[self.preferred]


def identify_all(
    log: Experiment,
    *,
    heldout: float = 0.4,
    stiffness: float | None = None,
    fixed: Mapping[str, float] | None = None,
    hold: Hold = "auto",
    details: bool = True,
) -> Comparison:
    """Fit all four structures to a log and say what it tells apart.

    Options as in `identify`; `stiffness` is c [N·m/rad] where it is known.

    Raises what `identify` raises. Source: the paper, section 3.3 and Table 2.

    >>> import numpy as np
    >>> from fraclink._arm.experiment import Experiment
    >>> from fraclink._identify import simulated_torque
    >>> from fraclink._arm.link import LinkModel
    >>> angle = np.clip((0.004 * np.arange(3000) - 0.5) / 0.3, 0, 1)
    >>> torque = simulated_torque(LinkModel(1.56, 10.02, order=1.92), angle, 0.004)
    >>> noise = np.random.default_rng(0).normal(0, 0.02, torque.size)
    >>> log = Experiment(period=0.004, motor_angle=angle, output=torque + noise)
    >>> identify_all(log, details=False).preferred
    'UD-FOM'
    """
    search = make_search(log, heldout=heldout, stiffness=stiffness, fixed=fixed, guess=None, hold=hold)
    search.reconcile()
    fits = {name: fit_from(search, name, log, stiffness=stiffness, details=details) for name in STRUCTURES}
    still = {}
    if "delay" not in search.fixed:
        at_once = {**(fixed or {}), "delay": 0.0}
        other = make_search(log, heldout=heldout, stiffness=stiffness, fixed=at_once, guess=None, hold=hold)
        still = {
            name: fit_from(other, name, log, stiffness=stiffness, details=False)
            for name in ("D-IOM", "UD-FOM")
        }
    contest = _contest(fits["UD-FOM"], fits["D-IOM"])
    preferred = _preferred(fits)
    return Comparison(fits, still, preferred, contest, _verdict(fits, still, preferred, contest))


def _preferred(fits: Mapping[str, Fit]) -> str:
    lowest = min(fit.tic for fit in fits.values())
    near = [name for name, fit in fits.items() if fit.tic - lowest < _DECISIVE]
    return min(near, key=lambda name: (len(structure(name).free), fits[name].tic))


def _contest(first: Fit, second: Fit) -> Contest:
    inflation = [max(f.effective_parameters / max(len(f.standard_errors), 1), 1.0) for f in (first, second)]
    counted = first.fitted_samples / (sum(inflation) / 2)
    ratio = math.log(first.mse / second.mse) if min(first.mse, second.mse) > 0 else 0.0
    return Contest(first.structure, second.structure, counted * ratio)


def _verdict(fits: Mapping[str, Fit], still: Mapping[str, Fit], preferred: str, contest: Contest) -> str:
    sentences = [_by_criterion(fits, preferred), _told_apart(fits, contest)]
    sentences += _of_the_delay(fits, still)
    sentences += _of_the_parameters(fits)
    return " ".join(sentence for sentence in sentences if sentence)


def _by_criterion(fits: Mapping[str, Fit], preferred: str) -> str:
    best = fits[preferred]
    # A D-FOM that ended as the UD-FOM (or a UD-FOM as the UD-IOM) is the same model, no competitor.
    rivals = [fit for fit in fits.values() if abs(fit.mse - best.mse) > 1e-9 * best.mse]
    if not rivals:
        return f"{preferred} is preferred: every other structure ended as the same model."
    other = min(rivals, key=lambda fit: fit.tic)
    gap = other.tic - best.tic
    criterion = "AIC, corrected for the residual's colour" if best.errors_allow_colour else "AIC"
    text = f"{preferred} is preferred: lowest {criterion}, {gap:.1f} below {other.structure}"
    if gap < 0:
        text = (
            f"{preferred} is preferred: {other.structure}'s {criterion} is only {-gap:.1f} lower, "
            "too little for one parameter more"
        )
    if best.heldout_nmse is not None:
        text += f"; held-out NMSE {best.heldout_nmse:.4g}"
    return text + "."


def _told_apart(fits: Mapping[str, Fit], contest: Contest) -> str:
    winner = contest.preferred
    if winner is None:
        return "UD-FOM and D-IOM cannot be told apart by this log."
    loser = contest.first if winner == contest.second else contest.second
    gap = f"{abs(contest.advantage) / 2:.1f}"
    return f"{winner} describes this log better than {loser} (log-likelihood higher by {gap})."


def _of_the_delay(fits: Mapping[str, Fit], still: Mapping[str, Fit]) -> list[str]:
    if not still:
        return []
    viscous, fractional = fits["D-IOM"], fits["UD-FOM"]
    at_once_wins = still["UD-FOM"].aic < still["D-IOM"].aic - 2
    # Less than a sample of delay may be the noise of the angle, averaged between two samples.
    shown = max(3 * viscous.standard_errors.get("delay", math.inf), viscous.period)
    if at_once_wins and viscous.aic <= fractional.aic + 2 and abs(viscous.delay) > shown:
        return [
            "λ is explained by the delay: without it UD-FOM wins "
            f"(λ = {still['UD-FOM'].model.order:.3f}), with the {1e3 * viscous.delay:.1f} ms that the log "
            "shows D-IOM is at least as good."
        ]
    return []


def _of_the_parameters(fits: Mapping[str, Fit]) -> list[str]:
    sentences = []
    order = fits["UD-FOM"]
    if "order" in order.at_bound:
        sentences.append("λ is at its bound 2: this log shows no fractional order.")
    interval = order.intervals.get("order")
    if interval is not None and interval.high_open and "order" not in order.at_bound:
        sentences.append("λ = 2 is not excluded by this log.")
    if any(finding.code == "W308" for finding in fits["D-FOM"].findings):
        sentences.append("α is not identifiable.")
    return sentences
