"""Compute the missing parts of a campaign in processes on this machine.

A part is done if its file exists and reads back as one of this campaign; everything
else is computed again. An interruption therefore only costs the parts in progress, and
the same command continues from there.
"""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import Executor, as_completed
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fraclink._files import checked_path, document, load, save
from fraclink.errors import FieldError, FileFormatError
from fraclink.trials._arms import simulate_part
from fraclink.trials._campaign import (
    FILE,
    Campaign,
    is_campaign,
    load_campaign,
)
from fracsys.checks import FilePath, Real, Workers, checked

__all__ = [
    "Progress",
    "compute",
    "part_path",
    "process_pool",
    "read_part",
    "run_campaign",
]


PARTS = "part-*.npz"


@dataclass(frozen=True)
class Progress:
    """How far a campaign is: runs finished before this call, finished by now, and
    wanted.

    failed: of those that this call finished.
    """

    before: int
    done: int
    runs: int
    failed: int = 0


@checked
def run_campaign(
    campaign: Campaign,
    folder: FilePath,
    *,
    workers: Workers = 1,
    watch: Callable[[Progress], None] | None = None,
) -> Progress:
    """Compute what is missing of a campaign into `folder`; return how far it is, which
    is: done.

    Parameters
    ----------
    campaign
        what to run; a folder of another campaign is refused, a longer one of the same
        continues.
    folder
        where campaign.json and part-*.npz are kept.
    workers
        processes on this machine. The result does not depend on their number. One is
        this process. More import the script that runs: it calls this below ``if
        __name__ == "__main__":``.
    watch
        called after every part.

    Raises
    ------
    FieldError
        the folder belongs to another campaign, or cannot be written; a worker process
        died (finished parts are kept); the script has no such line.
    """
    place = checked_path("folder", folder)
    try:
        _claim(campaign, place)
        # Read in full and compared with its digests instead of only checked for
        # existence: a file damaged by an interruption or an editor would otherwise be
        # used.
        missing = [
            part
            for part in range(campaign.parts)
            if read_part(campaign, place, part) is None
        ]
        before = campaign.runs - sum(campaign.part_runs(part) for part in missing)
        progress = Progress(before, before, campaign.runs)
        # Closed in any case: an exception in `watch` must not leave processes behind.
        with closing(_computed(place, missing, workers)) as finished:
            for part, failures in finished:
                progress = replace(
                    progress,
                    done=progress.done + campaign.part_runs(part),
                    failed=progress.failed + failures,
                )
                if watch is not None:
                    watch(progress)
    except OSError as error:
        raise FieldError(
            "out",
            str(place),
            f"not writable ({error.strerror or error})",
            allowed="a folder that can be written, with space left",
            remedy="finished parts are kept: make room and give the same command again, or choose another folder",
        ) from error
    return progress


def _claim(campaign: Campaign, place: Path) -> None:
    """Claim the folder for this campaign, or raise an error if it belongs to another
    one.
    """
    if is_campaign(place):
        owner = load_campaign(place)
        if owner.fingerprint != campaign.fingerprint:
            raise FieldError(
                "out",
                str(place),
                "the folder of another campaign",
                allowed="a new folder, or one of the same rig, law, draws and seed",
                remedy="choose another folder",
            )
        # A shorter request for the same campaign is done already if the longer one is;
        # the file keeps the longer one.
        if owner.runs >= campaign.runs:
            return
    save(campaign, place / FILE, force=True)


def _computed(
    place: Path, missing: list[int], workers: int
) -> Generator[tuple[int, int], None, None]:
    """Yield the result of `compute` for every missing part, in the order of completion."""
    folder = str(place.resolve())
    if workers == 1:
        # A single worker needs no separate process, which would take a second to start
        # and execute the script again.
        yield from (compute(folder, part) for part in missing)
        return
    with process_pool(workers) as executor:
        tasks = [executor.submit(compute, folder, part) for part in missing]
        yield from (task.result() for task in as_completed(tasks))


# --- processes ------------------------------------------------------------------------


@contextmanager
def process_pool(workers: int) -> Iterator[Executor]:
    """Provide a pool of `workers` processes; at the end waiting tasks are cancelled and
    running ones are awaited.

    Raises FieldError if a worker dies, because it executes the user's script again or
    because the system ends it.
    """
    # spawn: a forked child could inherit threads of numerical libraries that hold a
    # lock
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield pool
    except BrokenProcessPool as error:
        script = _unguarded_script()
        if script is None:
            raise FieldError(
                "workers",
                workers,
                "ended by the system while they worked",
                allowed="as many as the machine has memory for",
                remedy="finished parts are kept: give fewer, and the same command again",
            ) from error
        raise FieldError(
            "script",
            script.name,
            "run again by every worker process, and so starts workers itself",
            allowed='a script whose work stands below `if __name__ == "__main__":`',
            remedy="put that line above the call, and indent what follows",
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _unguarded_script() -> Path | None:
    """The running script, if it has no `__main__` guard; a spawned process executes it
    again.
    """
    file = getattr(sys.modules["__main__"], "__file__", None)
    # a package's __main__.py (`python -m fraclink`) is not executed again
    if file is None or Path(file).name == "__main__.py" or not Path(file).is_file():
        return None
    text = Path(file).read_text(encoding="utf-8", errors="replace")
    return None if "__main__" in text or "parent_process" in text else Path(file)


# --- files ----------------------------------------------------------------------------


def part_path(folder: Path, part: int) -> Path:
    """Return the file of a part; its number has seven digits, so that names sort like
    numbers.
    """
    return folder / PARTS.replace("*", f"{part:07d}")


@document("campaign-part", container="npz")
@dataclass(frozen=True, eq=False)
class CampaignPart:
    """A finished part: its campaign and number, and its columns by name, one value per
    run; booleans are 1 or 0.
    """

    fingerprint: str
    number: int
    columns: Mapping[str, Real]


def compute(folder: str, part: int) -> tuple[int, int]:
    """Compute one part of the campaign kept in `folder` and write its file in one step;
    return its number and how many of its runs failed: plain values, as a worker process
    receives and sends them.
    """
    campaign = load_campaign(folder)
    place = part_path(Path(folder), part)
    # An interrupted write leaves a temporary file; its part is missing and is computed
    # here again.
    for stray in place.parent.glob(f".{place.name}.*.tmp"):
        stray.unlink(missing_ok=True)
    columns = {
        name: np.asarray(values, dtype=np.float64)
        for name, values in simulate_part(campaign, part).items()
    }
    save(CampaignPart(campaign.fingerprint, part, columns), place, force=True)
    return part, int(np.count_nonzero(columns["passed"] == 0.0))


def read_part(campaign: Campaign, folder: Path, part: int) -> Mapping[str, Real] | None:
    """Return the columns of a finished part; None if the file is missing, damaged,
    edited or of another campaign.
    """
    try:
        content = load(part_path(folder, part), CampaignPart)
    except FileFormatError:
        return None
    # The last part of a shorter campaign has fewer runs under the same number and
    # fingerprint: it is computed again.
    own = (
        content.fingerprint,
        content.number,
        len(content.columns["run"]),
    )
    expected = (campaign.fingerprint, part, campaign.part_runs(part))
    return content.columns if own == expected else None
