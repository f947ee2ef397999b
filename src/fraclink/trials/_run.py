"""Compute the missing parts of a campaign in threads of this machine.

A part is done if its file exists and reads back as one of this campaign; everything
else is computed again. An interruption therefore only costs the parts in progress, and
the same command continues from there.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

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
from fracsys.checks import Between, FilePath, Real, checked

__all__ = [
    "Progress",
    "compute",
    "part_path",
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
    workers: Annotated[int, Between(1, 1024)] = 1,
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
        threads. The result does not depend on their number.
    watch
        called after every part.

    Raises
    ------
    FieldError
        the folder belongs to another campaign, or cannot be written.
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
        # Closed in any case: an exception in `watch` must not leave work behind.
        with closing(_computed(campaign, place, missing, workers)) as finished:
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
    campaign: Campaign, place: Path, missing: list[int], workers: int
) -> Generator[tuple[int, int], None, None]:
    """Yield the result of `compute` for every missing part, in the order of completion."""
    pool = ThreadPoolExecutor(workers)
    try:
        tasks = [pool.submit(compute, campaign, place, part) for part in missing]
        yield from (task.result() for task in as_completed(tasks))
    finally:
        # What waits is dropped: an interruption only costs the parts in progress.
        pool.shutdown(cancel_futures=True)


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


def compute(campaign: Campaign, folder: Path, part: int) -> tuple[int, int]:
    """Compute one part of a campaign and write its file into `folder` in one step;
    return its number and how many of its runs failed.
    """
    place = part_path(folder, part)
    # An interrupted write leaves a temporary file; its part is missing and is computed
    # here again.
    for stray in folder.glob(f".{place.name}.*.tmp"):
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
