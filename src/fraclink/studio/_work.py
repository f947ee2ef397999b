"""Long computations (fits, proof, arms, faults) in a separate process that Cancel
kills; and step 6.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from fraclink._design import Design
from fraclink._law import Law
from fraclink._law.requirement import margins_of
from fraclink.errors import FieldError, FraclinkError, required
from fraclink.studio._logs import fit_answer
from fraclink.studio._messages import Reply
from fraclink.studio._session import Session, Verb
from fraclink.studio._worker import cell_of
from fraclink.trials._arms import replay_run
from fraclink.trials._campaign import Campaign
from fraclink.trials._study import Study, load_study, save_study
from fraclink.view._loops import payloads_about
from fraclink.view._text import grams, grid_of, sentence
from fracsys.checks import Between, Real

__all__ = ["JOBS", "WORK_VERBS", "Job", "moves_of_arms", "proof_of", "swept"]


# Verb -> part of the study it needs.
JOBS = {"identify": "experiment", "prove": "law", "arms": "law", "faults": "law"}
# Verb -> the parts that it makes of a design.
_MADE = {
    "prove": ("certificate", "missing"),
    "arms": ("arms",),
    "faults": ("faults",),
}
# Option of a job -> its range, and its value if the page leaves it out.
_OPTIONS: dict[str, tuple[Between, float | None]] = {
    "heldout": (Between(0.05, 0.9), None),
    "runs": (Between(1, 20_000), 1000),
}
_NEEDS = {
    "experiment": "read a log first (steps 1 and 2)",
    "law": "make a design first (step 4)",
}


class Job:
    """One job of the page, on a copy of the study in a folder of its own."""

    def __init__(self, session: Session, verb: str, given: Mapping[str, Any]) -> None:
        self.session, self.verb, self.given = session, verb, given
        self.study = session.study
        self._process: subprocess.Popen[str] | None = None
        self._lock, self._cancelled = Lock(), False

    def cancel(self) -> None:
        """Kill the process; only its unfinished work is lost."""
        with self._lock:
            self._cancelled = True
            if self._process is not None:
                self._process.kill()

    def done(self, tell: Callable[[Mapping[str, Any]], None]) -> Reply:
        """Run to the end, passing all progress to `tell`, and return the answer about
        the study.
        """
        part = JOBS[self.verb]
        required(
            part,
            getattr(self.study, part),
            "a study with it",
            _NEEDS[part],
        )
        values = {
            name: usual
            if self.given.get(name) is None
            else bounds.check(name, self.given[name])
            for name, (bounds, usual) in _OPTIONS.items()
        }
        place = Path(tempfile.mkdtemp(dir=self.session.draft))
        try:
            # Without the runs of varied arms, which no job reads.
            save_study(replace(self.study, arms=None), place)
            self._run(place, values, tell)
            return self._taken(place, values)
        finally:
            shutil.rmtree(place, ignore_errors=True)

    def _run(
        self,
        place: Path,
        asked: Mapping[str, Any],
        tell: Callable[[Mapping[str, Any]], None],
    ) -> None:
        # A separate process: it can be killed in the middle of a proof, and takes no
        # time from the thread that answers drags.
        command = [
            sys.executable,
            "-m",
            "fraclink.studio._worker",
            str(place),
            self.verb,
            json.dumps(asked),
        ]
        with self._lock:
            if self._cancelled:
                raise FraclinkError("Cancelled; nothing was changed.")
            # this interpreter and this package
            self._process = subprocess.Popen(  # noqa: S603
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        with self._process as process:
            for line in process.stdout or ():
                tell(json.loads(line))
            # Read at the end: a job writes at most one line of error, which fits into
            # the pipe without a reader.
            code, output = (
                process.wait(),
                (process.stderr.read() if process.stderr else ""),
            )
        if self._cancelled:
            raise FraclinkError("Cancelled; nothing was changed.")
        if code:
            why = (
                output.strip().splitlines()[-1][:400]
                if output.strip()
                else f"ended with code {code}"
            )
            raise FieldError(
                self.verb,
                code,
                f"failed: {why}",
                "a job that ends",
                "see the message; the study is as it was",
            )

    def _taken(self, place: Path, asked: Mapping[str, Any]) -> Reply:
        """Take over the result of the job, if the study is still the one with which it
        began.
        """
        result, session = load_study(place), self.session
        with session.lock:
            now = session.study
            # A fit depends on the log alone; everything else belongs to one design, and
            # would be wrong for another.
            another = self.verb != "identify" and now.design != self.study.design
            if another or now.experiment is not self.study.experiment:
                raise FieldError(
                    self.verb, "another design", "the study has changed in the meantime",
                    "the study it began with", "start it again",
                )  # fmt: skip
            if self.verb == "identify":
                session.heldout = asked["heldout"]
                session.become(replace(result, experiment=now.experiment, rig=now.rig))
            else:
                made = {name: getattr(result, name) for name in _MADE[self.verb]}
                session.become(replace(now, **made))
        if self.verb == "identify":
            return fit_answer(session)
        return Reply({**session.overview(), **proof_of(session.study)})


# --- step 6: what was proved and tried, the loop about −1 over payload and delay, moves of arms -------------

_PAYLOADS, _DELAYS = 11, 8  # points of the map: about 10 ms each
_POINTS = 1200  # of a curve: twenty within the resonance of the least damped link drawn
_ARMS, _FAILED = 24, 12  # moves that are drawn, and how many of failing arms: 4 ms each
_SEEN, _EVERY = 2.4, 3  # [s] of a move, and periods per point: one pixel


def swept(design: Design, law: Law) -> tuple[dict[str, Any], dict[str, Real]]:
    """Return the map of the distance from −1 over payload [g] and delay [ms], negative
    where the loop is stable; and curves.

    The curves are L at both ends of the payload range and in its middle, without added
    delay and with half of the map's largest, each as one row of real and one of
    imaginary parts.
    """
    low, high = design.payloads
    payloads = payloads_about(low, high, _PAYLOADS)
    own = _plant(design, low, 0.0).delay
    # Total delays of 0, 1, 2, … periods, less the delay that the plant contains already.
    more = law.period * np.arange(_DELAYS) - own
    rows = [
        [_distance(design, law, float(mass), float(late)) for mass in payloads]
        for late in more
    ]
    nyquist = np.pi / law.period
    w = np.geomspace(2e-3 * nyquist, 0.999 * nyquist, _POINTS)
    three = (low, 0.5 * (low + high), high)
    values = np.array(
        [
            law.frequency_response(w) * _plant(design, mass, late)(w)
            for mass in three
            for late in (0.0, 0.5 * float(more[-1]))
        ]
    )
    # Projected onto a circle of radius 10 instead of being cut off: the page draws a
    # single line, and beyond 10 only the direction matters.
    values = np.where(np.abs(values) > 10.0, 10.0 * values / np.abs(values), values)
    head = {
        "names": [grams(mass) for mass in three],
        "payloads": 1e3 * payloads,
        "delays": 1e3 * (own + more),
        "near": rows,
    }
    return head, {"sweep_x": values.real, "sweep_y": values.imag}


def _plant(design: Design, payload: float, late: float) -> Any:
    plant = design.sampled_plant(design.natural_frequency(payload))
    return replace(plant, delay=plant.delay + late)


def _distance(design: Design, law: Law, payload: float, late: float) -> float:
    margins = margins_of(law.frequency_response, _plant(design, payload, late))
    # A single scale for the shades of the map: from far (−1) through critical (0) to
    # unstable.
    return -margins.modulus_margin if margins.stable else margins.modulus_margin


def moves_of_arms(campaign: Campaign, failures: tuple[int, ...]) -> dict[str, Real]:
    """Return moves of arms of a campaign in percent of their goal, one row each, over
    `fan_t` [s].

    `fan_passed` are the first arms that pass, `fan_failed` the first that fail; a curve
    without rows is omitted.
    """
    law = campaign.law
    # Enough runs to contain _ARMS that pass, even if all failing ones are among them.
    successes = [
        run
        for run in range(min(campaign.runs, _ARMS + len(failures)))
        if run not in failures
    ]
    count = round(_SEEN / law.period)
    curves: dict[str, Real] = {
        "fan_t": np.asarray(law.period * np.arange(0, count, _EVERY), np.float64)
    }
    for name, runs in (
        ("fan_passed", successes[:_ARMS]),
        ("fan_failed", failures[:_FAILED]),
    ):
        moves = [replay_run(campaign, run) for run in runs]
        rows = [
            100.0 * move.tip_angle[:count:_EVERY] / move.reference[-1] for move in moves
        ]
        if rows:
            # A run that diverged is drawn to the edge of the picture, ten times the
            # goal.
            curves[name] = np.clip(np.nan_to_num(np.array(rows), nan=1e3), -1e3, 1e3)
    return curves


def proof_of(study: Study) -> dict[str, Any]:
    """Return the content of step 6: the proved statement, the spread of the arms, the
    faults.
    """
    content: dict[str, Any] = {}
    if study.certificate is not None:
        statement = study.certificate.statement
        content["proved"] = {
            "modulus": statement.modulus,
            "payloads": [
                1e3 * statement.payload_low,
                1e3 * statement.payload_high,
            ],  # [g], [ms]: the box of the certificate on the map
            "delays": [1e3 * statement.delay_low, 1e3 * statement.delay_high],
            "text": sentence(study.certificate.sentence),
        }
    if study.arms is not None:
        arms = study.arms.summary
        content["spread"], failure = grid_of(arms.overview().tables[0]), arms.failure
        content["failures"] = {
            "count": failure.count,
            "runs": failure.runs,
            "failed": arms.failed[:12],
        }
    if study.faults is not None:
        content["faults"] = grid_of(study.faults.overview().tables[0])
        content["faults_said"] = study.faults.sentence
        content["cells"] = [cell_of(outcome) for outcome in study.faults.outcomes]
    return content


def _proof(session: Session, given: Mapping[str, Any]) -> Reply:
    """The content of step 6 for the present study."""
    study = session.study
    head = proof_of(study)
    if study.design is None or study.law is None:
        return Reply(head)
    near, curves = swept(study.design, study.law)
    if study.arms is not None:
        curves |= moves_of_arms(study.arms.campaign, study.arms.summary.failed)
    return Reply(head | {"swept": near}, curves)


WORK_VERBS: dict[str, Verb] = {"proof": _proof}
