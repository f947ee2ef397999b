"""From a log to a verdict: examine, identify, design, discretize, simulate, and try a thousand arms.

A study keeps whatever was computed before a step failed, as one folder with one file for each part:

    rig.toml  log.npz  model.json  model-UD-IOM.json …  design.json  law.json  certificate.json
    run-20g.npz …  arms/  faults.json  study.json
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import STRUCTURES, LinkModel
from fraclink._arm.reference import smooth_step
from fraclink._arm.rig import Rig
from fraclink._campaign import Campaign, Summary, load_campaign, run_campaign, summarise
from fraclink._campaign.faults import FaultTable
from fraclink._certify import Certificate, certify
from fraclink._design import Design, design
from fraclink._files import checked_path, kind_of, load, read_json, save, write_json
from fraclink._identify import Comparison, Contest, Fit, identify_all
from fraclink._law import Law
from fraclink._logs import diagnose
from fraclink._simulate import Run, simulate
from fraclink._validate import Between, Seed, checked
from fraclink.errors import FieldError, FileFormatError, FraclinkError, InfeasibleError
from fraclink.findings import Finding

__all__ = ["Scope", "Study", "Verdict", "design_for", "load_study", "run", "save_study", "simulate_move"]

# The source paper's own proportions on its rig: a crossover of 12 rad/s where the heaviest payload's
# torque resonates at 10.4 rad/s. Below 1 there is no crossing right of the peak; each further step costs
# phase margin at the light end.
_CROSSOVER_RATIO = 1.15
# 50° where it is feasible; an arm with a slow control period cannot have them.
_MARGINS_DEG = (50.0, 45.0, 40.0, 35.0, 30.0)
# Each of a thousand arms draws payload, stiffness, order, motor, friction, delay, offset and noise anew: half
# a second of work, and a share of failures of 0.3 % is seen with 95 % certainty.
_ARMS = 1000

# A loop gain of 0.7 at a mode that nobody asked about leaves 3 dB before its phase matters.
_MODE_GAIN = 0.7

State = Literal["passed", "failed", "not shown", "not run"]
_WORST_FIRST: tuple[State, ...] = ("failed", "not shown", "not run", "passed")


@dataclass(frozen=True)
class Scope:
    """One part of a verdict: its state, and the reasons for anything but "passed"."""

    state: State
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """What was shown, in three scopes; the whole is never better than its worst part.

    promise: the requirements of the design, and their proof where one was asked for. model: simulated moves
    of the identified model. reality: arms that differ from the model, and faults if they were injected.
    remarks stand beside the verdict and do not change it.

    >>> Verdict(Scope("passed"), Scope("passed"), Scope("not run")).state
    'not run'
    """

    promise: Scope
    model: Scope
    reality: Scope
    remarks: tuple[str, ...] = ()

    @property
    def scopes(self) -> Mapping[str, Scope]:
        """The three scopes by name."""
        return {"promise": self.promise, "model": self.model, "reality": self.reality}

    @property
    def state(self) -> State:
        """The worst state of the three."""
        states = {scope.state for scope in self.scopes.values()}
        return next(state for state in _WORST_FIRST if state in states)

    @property
    def passed(self) -> bool:
        """Whether all three scopes passed."""
        return self.state == "passed"

    @property
    def refuted(self) -> bool:
        """Whether a scope failed or could not be shown; what was not run refutes nothing."""
        return self.state in ("failed", "not shown")

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons of all scopes, each once."""
        return tuple(dict.fromkeys(reason for scope in self.scopes.values() for reason in scope.reasons))


@dataclass(frozen=True)
class Study:
    """What one log led to. Every part may be missing: a folder may hold some of the files only.

    rig, experiment, findings (of their examination); comparison of the structures; the fit that the design
    used; design, law and certificate; stopped and uncertified: why there is none of them; runs: simulated
    moves, one for each payload; arms: the summary of many arms that differ; faults: a fault campaign;
    assumptions: sentences on everything that nobody stated.

    >>> Study().verdict.state
    'not run'
    """

    rig: Rig | None = None
    experiment: Experiment | None = None
    findings: tuple[Finding, ...] = ()
    comparison: Comparison | None = None
    fit: Fit | None = None
    design: Design | None = None
    law: Law | None = None
    stopped: str | None = None
    certificate: Certificate | None = None
    uncertified: str | None = None
    runs: tuple[Run, ...] = ()
    arms: Summary | None = None
    faults: FaultTable | None = None
    assumptions: tuple[str, ...] = ()

    @property
    def fits(self) -> Mapping[str, Fit]:
        """The fits by structure: all that were compared, or the one that there is."""
        if self.comparison is not None:
            return self.comparison.fits
        return {} if self.fit is None else {self.fit.structure: self.fit}

    @property
    def verdict(self) -> Verdict:
        """The verdict in three scopes."""
        # A design may be good and the log behind it wrong: a reversed gauge fits as well as a right one.
        wrong = [("the log", finding) for finding in self.findings]
        wrong += [("the model", finding) for finding in (self.fit.findings if self.fit else ())]
        doubts = [f"{what}: {f.message}. {f.remedy}" for what, f in wrong if f.severity == "error"]
        return Verdict(
            _scope(self._broken_promises(), doubts, self.design is not None),
            _scope(
                [_failed_move(run) for run in self.runs if not run.verdict.passed], doubts, bool(self.runs)
            ),
            _scope(self._failures(), doubts, self.arms is not None or self.faults is not None),
            ("the log is simulated, not measured",) if self.simulated else (),
        )

    @property
    def simulated(self) -> bool:
        """Whether the log's own header says that it was simulated."""
        return self.experiment is not None and any(name == "simulated" for name, _ in self.experiment.notes)

    def _broken_promises(self) -> list[str]:
        missed = [
            f"{item.name}: {_stated(item.achieved, item.unit)} instead of {_stated(item.wanted, item.unit)}"
            for item in (self.design.requirements if self.design else ())
            if not item.passed
        ]
        unproved = [] if self.uncertified is None else [f"not certified: {self.uncertified}"]
        return ([] if self.stopped is None else [self.stopped]) + missed + unproved

    def _failures(self) -> list[str]:
        failed = []
        if self.arms is not None and self.arms.failure.count:
            count, runs = self.arms.failure.count, self.arms.failure.runs
            settling = next(metric for metric in self.arms.metrics if metric.name == "settling_time")
            causes = " and ".join(name.replace("_", " ") for name, _ in settling.drivers[:2])
            failed.append(
                f"{count} of {runs} arms fail ({100 * count / runs:.1f} %); most depends on {causes}"
            )
        if self.faults is not None and not self.faults.passed:
            rows = self.faults.rows()
            failed.append(
                f"{sum(not row.passed for row in rows)} of {len(rows)} faults miss their requirement"
            )
        return failed


def _scope(failures: list[str], doubts: list[str], ran: bool) -> Scope:
    if failures:
        return Scope("failed", tuple(failures + doubts))
    if doubts:
        return Scope("not shown", tuple(doubts))
    return Scope("passed" if ran else "not run")


def _stated(value: float, unit: str) -> str:
    return f"{math.degrees(value):.1f}°" if unit == "rad" else f"{value:.4g} {unit}".strip()


def _failed_move(run: Run) -> str:
    return f"move at {1e3 * run.payload:g} g: {run.verdict.reason}"


# --- from the log to the verdict ------------------------------------------------------------------------


@checked
def run(
    rig: Rig,
    log: Experiment,
    *,
    structure: str | None = None,
    certified: bool = False,
    arms: Annotated[int, Between(0, 10**6)] = _ARMS,
    seed: Seed = 0,
    out: Path | str | None = None,
    begin: Callable[[str], None] = lambda part: None,
    **wanted: Any,
) -> Study:
    """Examine a log, fit the four structures, design, and try the law on the model and on arms that differ.

    Moves are simulated at both ends of the payload range, and at the nominal payload where it lies within.

    Parameters
    ----------
    rig, log
        the rig and what it recorded.
    structure
        the model that the design uses; the one that the log supports where it is left out.
    certified
        whether a proof is asked for.
    arms
        how many arms that differ from the model are tried; 0 leaves them out.
    out
        folder to write the study to, with the arms below it.
    begin
        called with the name of each step as it begins.
    wanted
        what `design` is asked for, such as ``gain_crossover`` [rad/s]; the rig completes it.

    A step that fails ends the study and is named in its verdict; what was computed before it is kept.
    Raises FieldError where an argument is out of its range.

    >>> from fraclink._logs import bundled_log, read_log
    >>> rig = Rig.named("paper-2023")
    >>> log = read_log(bundled_log("prbs_30g"), rig=rig)
    >>> study = run(rig, log, payloads=(0.020, 0.045), arms=0)
    >>> [f"{1e3 * move.payload:g} g" for move in study.runs], study.verdict.model.state, study.verdict.state
    (['20 g', '30 g', '45 g'], 'passed', 'not run')
    """
    if structure is not None and structure not in STRUCTURES:
        allowed = ", ".join(STRUCTURES)
        raise FieldError("structure", structure, "unknown", allowed=allowed, remedy="choose one of these")
    begin("examining the log")
    study = Study(rig, log, (*rig.warnings, *diagnose(log, rig)), assumptions=rig.assumptions)

    def identify(study: Study) -> Study:
        # A deflection log cannot show the stiffness; a torque log measures it.
        known = rig.link.stiffness if log.output_kind == "deflection" else None
        comparison = identify_all(log, stiffness=known)
        chosen = structure or comparison.preferred
        return replace(study, comparison=comparison, fit=comparison.fits[chosen])

    def controller(study: Study) -> Study:
        assert study.fit is not None  # noqa: S101
        model, assumed = _with_payload(study.fit.model, rig)
        made, more = design_for(rig, model, **wanted)
        made = made.with_law()
        assumptions = (*study.assumptions, *assumed, *more)
        return replace(study, design=made, law=made.law(), assumptions=assumptions)

    def moves(study: Study) -> Study:
        assert study.design is not None  # noqa: S101
        payloads = _moved(study.design)
        return replace(study, runs=tuple(simulate_move(study.design, m, law=study.law) for m in payloads))

    def proof(study: Study) -> Study:
        assert study.design is not None  # noqa: S101
        found = certify(study.design, law=study.law)
        if found.passed:
            return replace(study, certificate=found)
        return replace(study, uncertified=found.verdict.removeprefix("Not certified: "))

    def fleet(study: Study) -> Study:
        assert study.design is not None  # noqa: S101
        assert study.law is not None  # noqa: S101
        campaign = Campaign.of(rig, study.design.model, study.law, runs=arms, seed=seed)
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) if out is None else Path(out) / "arms"
            run_campaign(campaign, folder)
            return replace(study, arms=summarise(campaign, folder))

    steps = {"identifying": identify, "designing": controller, "simulating": moves}
    steps |= {"proving": proof} if certified else {}
    steps |= {f"trying {arms} arms": fleet} if arms else {}
    for name, step in steps.items():
        begin(name)
        try:
            study = step(study)
        except FraclinkError as error:
            # A value that the caller gave is bad input; everything else is an answer.
            if isinstance(error, FieldError) and error.field.partition(".")[0].partition("[")[0] in wanted:
                raise
            why = str(error) if isinstance(error, InfeasibleError) else f"{name} failed: {error}"
            study = replace(study, uncertified=why) if name == "proving" else replace(study, stopped=why)
            if study.design is None:
                break
    if out is not None:
        save_study(study, out)
    return study


def _moved(made: Design) -> tuple[float, ...]:
    """The payloads to move [kg]: both ends of the range designed for, and the nominal one within it."""
    low, high = made.payloads
    nominal = made.rig.payloads.nominal
    return tuple(sorted({low, high} | ({nominal} if low < nominal < high else set())))


def _with_payload(model: LinkModel, rig: Rig) -> tuple[LinkModel, tuple[str, ...]]:
    """The model with the payload it holds for: ω₀ can be carried to other payloads from there only."""
    if model.payload is not None:
        return model, ()
    nominal = rig.payloads.nominal
    return replace(model, payload=nominal), (
        f"the log was made with the nominal payload, {1e3 * nominal:g} g, as nobody stated it",
    )


@checked
def simulate_move(
    made: Design,
    payload: float,
    *,
    law: Law | None = None,
    amplitude: float = 1.0,
    move_time: float = 0.5,
    duration: float = 4.0,
    inner: Literal["ideal", "sampled"] = "sampled",
    **options: Any,
) -> Run:
    """Simulate one move of the tip of `amplitude` [rad] in `move_time` [s] at `payload` [kg].

    `law` is the design's own where it is left out; making it takes a second. `options` are those of
    `simulate`, such as ``gauge_offset`` [N·m], ``noise`` [N·m] and ``seed``.

    >>> made, _ = design_for(Rig.named("paper-2023"), filter_time=0.0)
    >>> simulate_move(made, 0.020, amplitude=0.2).payload
    0.02
    """
    reference = smooth_step(amplitude, duration=move_time)
    return simulate(
        law if law is not None else made.law(),
        reference,
        rig=made.rig,
        model=made.model,
        payload=payload,
        duration=duration,
        motor_loop=inner,
        **options,
    )


# --- what a design is asked for where nobody said --------------------------------------------------------


@checked
def design_for(rig: Rig, model: LinkModel | None = None, **wanted: Any) -> tuple[Design, tuple[str, ...]]:
    """Design what is wanted, completed from the rig; also return what had to be assumed, in sentences.

    `wanted` are the options of `design`; None leaves one to the rig's ``[design]`` table. Where that is
    silent, too, the gain crossover is 1.15 times the torque resonance of the heaviest payload [rad/s] and
    the phase margin 50°, or the largest of 45, 40, 35 and 30° that is feasible.

    Raises InfeasibleError where this cannot be met, FieldError where a value is out of its range.

    >>> made, assumed = design_for(Rig.named("paper-2023"), filter_time=0.0)
    >>> round(made.controller.gain, 4), assumed
    (0.0699, ())
    """
    link = model or rig.model
    if link is None:
        allowed, remedy = "a model file", "identify a log first, then give --model model.json"
        raise FieldError("model", None, "missing", allowed=allowed, remedy=remedy)
    asked = {name: value for name, value in wanted.items() if value is not None}
    asked.setdefault("payloads", (rig.payloads.low, rig.payloads.high))
    for name, instead in _COMPLETED.items():
        stated = None if rig.design is None else getattr(rig.design, name)
        if stated is not None and not {name, *instead} & set(asked):
            asked[name] = stated
    assumed: tuple[str, ...] = ()
    if not {"gain_crossover", "settling_time"} & set(asked):
        heaviest = max(asked["payloads"]) if len(asked["payloads"]) == 2 else rig.payloads.high
        asked["gain_crossover"], sentence = _usual_crossover(link, heaviest)
        assumed = (sentence,)
    if {"phase_margin", "max_sensitivity"} & set(asked):
        made, sentences = _least_mode_gain(link, rig, asked)
        assumed = (*assumed, *sentences)
    else:
        made, sentence = _largest_margin(lambda margin: design(link, rig, **asked, phase_margin=margin))
        assumed = (*assumed, sentence)
    doubts = filter(None, map(rig.payloads.doubt, made.payloads))
    return replace(made, findings=(*made.findings, *doubts)), assumed


# What the rig's [design] table completes, and what else in the request takes its place.
_COMPLETED = {
    "gain_crossover": ("settling_time",),
    "phase_margin": ("max_sensitivity",),
    "filter_time": ("noise_gain", "mode_gain"),
}


def _usual_crossover(link: LinkModel, heaviest: float) -> tuple[float, str]:
    heavy = link.at_payload(heaviest)
    resonance = heavy.torque_resonance or heavy.natural_frequency ** (2.0 / heavy.order)
    crossover = _CROSSOVER_RATIO * resonance
    return crossover, (
        f"gain crossover {crossover:.3g} rad/s: {_CROSSOVER_RATIO:g} times the torque resonance of the "
        f"heaviest payload ({resonance:.3g} rad/s), as neither the rig nor the request states one"
    )


def _least_mode_gain(link: LinkModel, rig: Rig, asked: Mapping[str, Any]) -> tuple[Design, tuple[str, ...]]:
    """The design with the usual bound on the gain at the second mode, or the least that is feasible."""
    try:
        return design(link, rig, **asked), ()
    except InfeasibleError as error:
        least = error.nearest.get("mode_gain", math.inf)
        if "mode_gain" in asked or set(error.nearest) != {"mode_gain"} or least > _MODE_GAIN:
            raise
    # The nearest feasible bound is met exactly: a hundredth more leaves room for rounding.
    bound = math.ceil(100 * least) / 100
    sentence = f"gain of {bound:g} at the second mode, as 0.5 is not feasible with this crossover and margin"
    return design(link, rig, **asked, mode_gain=bound), (sentence,)


def _largest_margin(ask: Callable[[float], Design]) -> tuple[Design, str]:
    """The design with the largest of the usual phase margins that is feasible."""
    *usual, last = _MARGINS_DEG
    for degrees in usual:
        try:
            return ask(math.radians(degrees)), _margin_sentence(degrees)
        except InfeasibleError:
            continue
    return ask(math.radians(last)), _margin_sentence(last)


def _margin_sentence(degrees: float) -> str:
    less = "" if degrees == _MARGINS_DEG[0] else f"; {_MARGINS_DEG[0]:g}° is not feasible at this crossover"
    return f"phase margin {degrees:g}°, as neither the rig nor the request states one{less}"


# --- a study as a folder --------------------------------------------------------------------------------


def save_study(study: Study, folder: Path | str) -> None:
    """Write every part of `study` to its file in `folder`; `load_study` reads them back.

    >>> folder = Path(tempfile.mkdtemp())
    >>> save_study(Study(rig=Rig.named("paper-2023")), folder)
    >>> sorted(path.name for path in folder.iterdir()), load_study(folder).rig.name
    (['rig.toml', 'study.json'], 'paper-2023')
    """
    place = checked_path("folder", folder)
    parts: dict[str, Any] = {
        "rig.toml": study.rig,
        "design.json": study.design,
        "law.json": study.law,
        "certificate.json": study.certificate,
    }
    for name, fit in study.fits.items():
        chosen = study.fit is not None and fit.structure == study.fit.structure
        parts["model.json" if chosen else f"model-{name}.json"] = fit
    parts |= {f"run-{1e3 * move.payload:.6g}g.npz": move for move in study.runs}
    for name, part in parts.items():
        if part is not None:
            part.save(place / name)
    if study.experiment is not None:
        save(study.experiment, place / "log.npz", force=True)
    if study.faults is not None:
        save(study.faults, place / "faults.json", force=True)
    write_json(place / "study.json", "study", 1, _summary(study))


def _summary(study: Study) -> dict[str, Any]:
    comparison = study.comparison
    return {
        "structure": study.fit.structure if study.fit else None,
        "stopped": study.stopped,
        "uncertified": study.uncertified,
        "assumptions": list(study.assumptions),
        "findings": [
            {"code": f.code, "severity": f.severity, "message": f.message, "remedy": f.remedy}
            | {"evidence": dict(f.evidence)}
            for f in study.findings
        ],
        "comparison": None
        if comparison is None
        else {
            "preferred": comparison.preferred,
            "contest": asdict(comparison.contest),
            "verdict": comparison.verdict,
        },
        "verdict": asdict(study.verdict),
    }


def load_study(folder: Path | str) -> Study:
    """Read a folder that `fraclink run` or its single steps wrote, whatever its files are called.

    Raises FileFormatError where the folder holds nothing of fraclink, or a file in it is damaged.
    """
    place = checked_path("folder", folder)
    if not place.is_dir():
        allowed, remedy = "a folder of results", "check the path"
        raise FileFormatError("folder", str(place), "not a folder", allowed=allowed, remedy=remedy)
    by_kind: dict[str, list[Path]] = {}
    for path in sorted(place.iterdir()):
        by_kind.setdefault(_kind(path), []).append(path)
    if not set(by_kind) & {"rig", "fit", "design", "run", "log"}:
        allowed, remedy = "model, design or run files", "run `fraclink run` with --out in this folder"
        raise FileFormatError("folder", str(place), "without results", allowed=allowed, remedy=remedy)
    return _gathered(place, by_kind)


def _kind(path: Path) -> str:
    """What a file holds; an empty text for anything foreign."""
    if path.suffix == ".toml":
        return "rig"
    return kind_of(path) if path.suffix in (".json", ".npz") else ""


def _gathered(place: Path, by_kind: Mapping[str, list[Path]]) -> Study:
    def first(kind: str, read: Callable[[Path], Any]) -> Any:
        return read(by_kind[kind][0]) if kind in by_kind else None

    about = first("study", lambda path: read_json(path, "study")) or {}
    fits = {fit.structure: fit for fit in map(Fit.load, by_kind.get("fit", []))}
    made, proof = first("design", Design.load), first("certificate", Certificate.load)
    refuted = proof is not None and not proof.passed
    campaign = load_campaign(place / "arms") if (place / "arms").is_dir() else None
    return Study(
        rig=first("rig", Rig.load) or (made.rig if made else None),
        experiment=first("log", lambda path: load(path, Experiment)),
        findings=tuple(Finding(**item) for item in about.get("findings", [])),
        comparison=_comparison(fits, about.get("comparison")),
        fit=fits.get(str(about.get("structure") or next(iter(fits), None))),
        design=made,
        law=first("law", Law.load),
        stopped=about.get("stopped", about.get("infeasible")),  # infeasible: release 0.1
        certificate=None if refuted else proof,
        uncertified=proof.verdict if refuted else about.get("uncertified"),
        runs=tuple(sorted(map(Run.load, by_kind.get("run", [])), key=lambda move: move.payload)),
        arms=None if campaign is None else summarise(campaign, place / "arms"),
        faults=first("fault-campaign", lambda path: load(path, FaultTable)),
        assumptions=tuple(about.get("assumptions", ())),
    )


def _comparison(fits: dict[str, Fit], about: dict[str, Any] | None) -> Comparison | None:
    if about is None or set(fits) != set(STRUCTURES):
        return None
    ordered = {name: fits[name] for name in STRUCTURES}
    return Comparison(ordered, {}, about["preferred"], Contest(**about["contest"]), about["verdict"])
