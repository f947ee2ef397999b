"""The process of a studio job: it reads a folder and adds its result to it.

    python -m fraclink.studio._worker FOLDER VERB OPTIONS

Progress goes to standard output, one JSON object per line. An error is reported on the
last line of standard error with the exit code 2.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fraclink.errors import FraclinkError
from fraclink.trials._fault_trial import Bench
from fraclink.trials._faults import Outcome, cases, run_faults
from fraclink.trials._stages import identified, proved, tried
from fraclink.trials._study import Study, load_study, save_study

__all__ = ["cell_of", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one job and return the exit code."""
    folder, verb, options = sys.argv[1:] if arguments is None else arguments
    place = Path(folder)
    try:
        save_study(_worked(load_study(place), verb, json.loads(options)), place)
    except FraclinkError as error:
        # A single line: the page shows the last one.
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def _worked(study: Study, verb: str, options: Mapping[str, Any]) -> Study:
    if verb == "identify":
        _tell({"said": "fitting four structures"})
        return identified(study, heldout=options["heldout"])
    if verb == "prove":
        _tell({"said": "proving every payload and delay"})
        return proved(study)
    if verb == "arms":
        _tell({"said": f"simulating {options['runs']:g} varied arms"})
        return tried(study, int(options["runs"]))
    return _with_faults(study)


def cell_of(outcome: Outcome) -> dict[str, Any]:
    """Return the mark of a fault's run in the page, whose cells show the worst run."""
    case = outcome.case
    return {
        "fault": case.fault,
        "severity": case.severity,
        "payload": case.payload,
        "phase": case.phase,
        "passed": outcome.passed,
    }


def _with_faults(study: Study) -> Study:
    """Every fault at three severities and three payloads, in every phase of a move,
    with one seed.
    """
    assert study.design is not None  # noqa: S101
    bench = Bench.of(study.design)
    # A third of the command's campaign, which uses three seeds: a user is waiting at
    # the page.
    plan = cases(bench, seeds=(1,))
    done = 0

    def watch(outcome: Outcome) -> None:
        nonlocal done
        done += 1
        _tell(
            {
                "said": f"{done} of {len(plan)} runs, {outcome.case.fault}",
                "done": done,
                "all": len(plan),
                **cell_of(outcome),
            }
        )

    _tell(
        {
            "said": f"0 of {len(plan)} runs",
            "done": 0,
            "all": len(plan),
            "payloads": bench.payloads,
        }
    )
    return replace(study, faults=run_faults(bench, plan, watch=watch))


def _tell(progress: Mapping[str, Any]) -> None:
    sys.stdout.write(json.dumps(progress) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
