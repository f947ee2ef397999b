"""Identification of a log: all structures, the choice among them, and the certainty of
that choice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES, LinkModel
from fraclink._arm.link import structure as structure_row
from fraclink._display import Overview, Row, Table, displayed, rows_of
from fraclink._files import document
from fraclink._identify.fit import Fit, coincidence
from fraclink._identify.fitting import (
    HeldOut,
    Stiffness,
    fit_from,
    make_search,
    predicted_output,
)
from fraclink._identify.problem import CERTAIN
from fraclink._identify.residual import regressed
from fraclink._identify.search import Search
from fraclink._identify.shape import Hold, special_cases
from fraclink._identify.uncertainty import structure_criteria
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks import checked
from fracsys.checks.equality import compared

Criteria = Mapping[str, tuple[float, float]]


@displayed
@document(
    "comparison",
    summary=lambda found: {"preferred": found.preferred, "verdict": found.verdict},
)
@compared
@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Every structure fitted to one log.

    Parameters
    ----------
    fits
        structure → fit, in the order of the table of structures.
    preferred
        the structure to use: of those whose criterion (the AIC where the residual is
        white) is within 8.8 of the lowest, the one with the fewest parameters, then
        with the lowest criterion. A structure without damping is not preferred if a
        damped one within this range predicts the held-out part better (Diebold and
        Mariano's test).
    verdict
        what may be concluded, in words.
    undecided
        structures that the log cannot tell from the one to use.
    vetoed
        structures that the criteria admit and the held-out part does not.
    """

    fits: Mapping[str, Fit]
    preferred: str
    verdict: str
    undecided: tuple[str, ...] = ()
    vetoed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "fits", MappingProxyType(dict(self.fits)))

    @property
    def table(self) -> Table:
        """The fits side by side: the resonance, the parameters with their errors, then
        the criteria.
        """
        rates = {
            name: abs(fit.model.pole.imag) if fit.model.oscillates else None
            for name, fit in self.fits.items()
        }
        return Table.of(
            "",
            (
                (
                    fit.rows[0],
                    Row("", "resonance", rates[name], "rad/s"),
                    Row("", "resonance", rates[name], "Hz", digits=3),
                    *(row for row in fit.rows[1:] if row.key not in ("gain", "offset")),
                )
                for name, fit in self.fits.items()
            ),
        )

    def overview(self) -> Overview:
        """The fits side by side, and which of them to use."""
        rows = rows_of(self, "preferred", "verdict", "fits")
        findings = dict.fromkeys(f for fit in self.fits.values() for f in fit.findings)
        return Overview(
            self.verdict,
            rows=rows,
            tables=(self.table,),
            findings=tuple(findings),
            notes=coincidence(self.fits),
        )

    @property
    def best(self) -> Fit:
        """The fit of the structure to use."""
        return self.fits[self.preferred]


@checked
def identify(
    log: Experiment,
    structure: str | None = None,
    *,
    heldout: HeldOut | None = None,
    stiffness: Stiffness | None = None,
    fixed: Mapping[str, float] | None = None,
    guess: LinkModel | None = None,
    hold: Hold = "auto",
    details: bool = True,
) -> Fit:
    """Fit a link structure to a log; gain, offset and gauge delay are fitted, too; no
    guess is needed.

        minimise Σ (output − gain·y(t − delay) − offset)²,    Y = s^λ/(s^λ + μ s^α + ω₀²) Θm

    Parameters
    ----------
    log
        the recorded motion, at rest before its first sample.
    structure
        a key of the table of structures; without it, the one that the log supports: the
        simplest that no other beats clearly (see `compare_structures`), with finding
        W322 where the log cannot tell.
    heldout
        share of the samples at the end that the fit does not see [1]. Without it, the
        last 40 %, or more where these contain no motion: an arm at rest tests no model.
    stiffness
        c where it is known [N·m/rad]: the gain of a torque log is fixed to it; for a
        deflection log, which cannot show it, it becomes the model's stiffness.
    fixed
        values of "gain", "offset", "delay" [s], "order", "damping_order" that are not
        to be fitted.
    guess
        a start to try in addition to the scan over all frequencies of the log.
    hold
        what the motor angle does between samples: "first" (a measured motion), "zero"
        (a held command) or "auto" (zero only for angles that jump and rest).
    details
        False leaves out intervals, tests, the second mode and the allowance for
        coloured residuals (up to four times faster, for loops over many logs).

    Raises
    ------
    LogError
        a log without motion, or too short.
    FieldError
        an option out of its range.
    NotConvergedError
        no start has a fit.

    References
    ----------
    Benftima et al. (2023), Algorithm 1 and section 3.3.

    Examples
    --------
    >>> import numpy as np
    >>> from fraclink._arm.experiment import Experiment
    >>> from fraclink._arm.link import LinkModel
    >>> from fraclink._identify import simulated_torque
    >>> time = 0.004 * np.arange(3000)
    >>> angle = np.clip((time - 0.5) / 0.3, 0, 1)
    >>> swing = LinkModel(1.56, 10.02, order=1.92)
    >>> log = Experiment(period=0.004, motor_angle=angle, output=simulated_torque(swing, angle, 0.004))
    >>> fit = identify(log)
    >>> fit.structure, round(fit.model.order, 6), round(fit.model.natural_frequency, 5), round(fit.gain, 6)
    ('UD-FOM', 1.92, 10.02, 1.56)
    """
    if structure is not None and structure not in STRUCTURES and "/" in structure:
        raise FieldError(
            "structure",
            structure,
            "a formula",
            ", ".join(STRUCTURES),
            "identify_structure(log, formula) fits any other",
        )
    rows = STRUCTURES.values() if structure is None else [structure_row(structure)]
    # A structure without the fixed parameter, such as λ, would ignore the given value.
    fixed_names = {"order", "damping_order"} & set(fixed or {})
    names = [row.name for row in rows if fixed_names <= set(row.free)]
    if not names:
        raise FieldError(
            "fixed",
            sorted(fixed_names),
            f"not free in {structure or 'any one structure'}",
            "order for UD-FOM, damping_order for D-FOM",
            "fix one of them, or fit a formula with identify_structure(log, formula)",
        )
    search = make_search(
        log, heldout=heldout, stiffness=stiffness, fixed=fixed, guess=guess, hold=hold
    )
    if len(names) < len(STRUCTURES):
        # With a structure that is given, or the only one with the fixed parameter, the
        # pair of criteria, which needs the whole table, does not apply.
        fits = [
            fit_from(search, name, log, stiffness=stiffness, details=details)
            for name in names
        ]
        return min(fits, key=lambda fit: fit.aic)
    choice = Choice.of(search, log)
    best = fit_from(search, choice.preferred, log, stiffness=stiffness, details=details)
    return replace(best, findings=(*best.findings, *_of_the_choice(choice, best)))


def _of_the_choice(choice: Choice, best: Fit) -> Iterator[Finding]:
    if choice.undecided:
        yield Finding(
            "W322",
            "info",
            f"this log cannot tell {best.structure} from {' and '.join(choice.undecided)}: the simplest is used",
            {f"AIC of {name} above": choice.gap(name) for name in choice.undecided},
            "record a longer log, or with more motion, if the structure matters",
        )
    if choice.vetoed:
        yield Finding(
            "W327",
            "info",
            f"{' and '.join(choice.vetoed)} fits the fitted part as well, but "
            f"{best.structure} predicts the held-out part better",
            {"heldout_nmse": best.heldout_nmse or 0.0},
            "nothing; record a longer log if the structure matters",
        )


@checked
def compare_structures(
    log: Experiment,
    *,
    heldout: HeldOut | None = None,
    stiffness: Stiffness | None = None,
    fixed: Mapping[str, float] | None = None,
    hold: Hold = "auto",
    details: bool = True,
) -> Comparison:
    """Fit every structure to a log and say which of them it distinguishes.

    Parameters
    ----------
    log, heldout, fixed, hold, details
        as in `identify`.
    stiffness
        c where it is known [N·m/rad].

    Raises
    ------
    LogError, FieldError, NotConvergedError
        as `identify` does.

    References
    ----------
    Benftima et al. (2023), section 3.3 and Table 2.

    Examples
    --------
    >>> import numpy as np
    >>> from fraclink._arm.experiment import Experiment
    >>> from fraclink._identify import simulated_torque
    >>> from fraclink._arm.link import LinkModel
    >>> angle = np.clip((0.004 * np.arange(3000) - 0.5) / 0.3, 0, 1)
    >>> torque = simulated_torque(LinkModel(1.56, 10.02, order=1.92), angle, 0.004)
    >>> noise = np.random.default_rng(0).normal(0, 0.02, torque.size)
    >>> log = Experiment(period=0.004, motor_angle=angle, output=torque + noise)
    >>> compare_structures(log, details=False).preferred
    'UD-FOM'
    """
    search = make_search(
        log, heldout=heldout, stiffness=stiffness, fixed=fixed, guess=None, hold=hold
    )
    choice = Choice.of(search, log)

    # The second mode belongs to the log and not to the structure: it is searched for
    # once.
    fit = partial(fit_from, search, log=log, stiffness=stiffness, details=details)
    best = fit(choice.preferred)
    fits = {
        name: best if name == choice.preferred else fit(name, like=best)
        for name in STRUCTURES
    }
    verdict = _verdict(fits, choice)
    return Comparison(fits, choice.preferred, verdict, choice.undecided, choice.vetoed)


@dataclass(frozen=True)
class Choice:
    """The structure supported by a log, with the evidence."""

    criteria: Criteria
    preferred: str
    undecided: tuple[str, ...]
    vetoed: tuple[str, ...]

    @classmethod
    def of(cls, search: Search, log: Experiment) -> Choice:
        """The choice for the log of a search."""
        criteria = structure_criteria(search)
        vetoed = vetoed_structures(search, criteria, log)
        preferred = preferred_structure(criteria, vetoed)
        undecided = _undecided(search, criteria, preferred, vetoed)
        return cls(criteria, preferred, undecided, vetoed)

    def gap(self, name: str) -> float:
        """The amount by which both criteria of a structure lie above those of the one
        to use (negative: below); 0 if the criteria disagree.
        """
        # If the two criteria disagree, the log has not decided; otherwise the gap is
        # the smaller of the two.
        gaps = np.subtract(self.criteria[name], self.criteria[self.preferred]).tolist()
        return max(min(gaps), 0.0) + min(max(gaps), 0.0)


def _near(criteria: Criteria) -> list[str]:
    """Structures that at least one criterion does not decisively reject in favour of
    the best.
    """
    lowest = [min(column) for column in zip(*criteria.values(), strict=True)]
    # A superfluous parameter adds 2 to the AIC and takes off the square of a normal
    # deviate: by chance alone it lowers the AIC by this much in one log of a thousand.
    decisive = CERTAIN**2 - 2.0
    return [
        name
        for name, values in criteria.items()
        if min(value - least for value, least in zip(values, lowest, strict=True))
        < decisive
    ]


def vetoed_structures(
    search: Search, criteria: Criteria, log: Experiment
) -> tuple[str, ...]:
    """Undamped structures that the criteria admit beside damped ones, but that predict
    the held-out part worse.

    Diebold and Mariano, J. Business & Economic Statistics 13 (1995) 253: the mean of
    the difference of squared errors over its standard error, with the colour accounted
    for.
    """
    count, near = search.window.samples, _near(criteria)
    undamped = [name for name in near if len(STRUCTURES[name].free) == 1]
    damped = [name for name in near if name not in undamped]
    if not undamped or count == log.output.size:
        return ()
    squares = {
        name: (log.output - predicted_output(search, search.solve(name), log))[count:]
        ** 2
        for name in near
    }

    def predicts_worse(name: str, other: str) -> bool:
        difference = squares[name] - squares[other]
        mean, error = regressed(difference, np.ones(difference.size))
        # Two descents to the same model agree to within their tolerance.
        same = abs(mean) <= 1e-6 * float(squares[name].mean())
        # One standard error, Breiman's rule: no real link is undamped.
        return not same and mean > error

    return tuple(n for n in undamped if any(predicts_worse(n, o) for o in damped))


def preferred_structure(criteria: Criteria, vetoed: Sequence[str] = ()) -> str:
    """The structure with the fewest parameters among those that are neither decisively
    rejected nor vetoed.
    """
    return min(
        (name for name in _near(criteria) if name not in vetoed),
        key=lambda name: (len(STRUCTURES[name].free), criteria[name]),
    )


def _undecided(
    search: Search, criteria: Criteria, preferred: str, vetoed: Sequence[str]
) -> tuple[str, ...]:
    """Structures that the log does not rule out, in addition to the one to use.

    A structure that includes the one to use as a special case is no rival: with so
    small a gap, its additional parameter is not needed. A fit that ended at the same
    model is the same answer.
    """
    least = search.solve(preferred).cost
    return tuple(
        name
        for name in _near(criteria)
        if name not in (preferred, *vetoed)
        # Two descents to the same model agree only to within their tolerance.
        and abs(search.solve(name).cost - least) > 1e-9 * least
        and preferred not in special_cases(name)
    )


# --- the verdict in words ---------------------------------------------------------------------------------


def _verdict(fits: Mapping[str, Fit], choice: Choice) -> str:
    preferred, best = choice.preferred, fits[choice.preferred]
    sentences = [finding.message for finding in _of_the_choice(choice, best)]
    if not choice.undecided:
        sentences.insert(0, f"{preferred} is preferred: {_reason(fits, choice)}")
    return " ".join(f"{text[0].upper()}{text[1:]}." for text in sentences)


def _reason(fits: Mapping[str, Fit], choice: Choice) -> str:
    best = fits[choice.preferred]
    gap, other = min(
        (
            (choice.gap(name), name)
            for name, fit in fits.items()
            # Two descents to the same model agree only to within their tolerance.
            if abs(fit.mse - best.mse) > 1e-9 * best.mse
        ),
        default=(0.0, ""),
    )
    criterion = "AIC, corrected for the residual's colour,"
    if gap <= 0:
        return f"no other structure has a clearly lower {criterion}"
    return f"its {criterion} is {gap:.1f} below that of {other}"
