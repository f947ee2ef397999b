"""Compute a campaign's missing parts on processes of this machine, or on a Dask cluster.

A part is done when its file is there and reads back as this campaign's; everything else is computed
again. So a kill costs the parts in flight and nothing more, and the same command continues where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from fraclink._campaign.campaign import Campaign, load_campaign, save_campaign
from fraclink._campaign.part import part_path, read_part, write_part
from fraclink._files import checked_path
from fraclink._validate import checked_noun, checked_whole
from fraclink.errors import FieldError, MissingExtraError, NotConvergedError

__all__ = ["Progress", "conduct"]

PATIENCE = (
    5  # pools that die one after the other without a single part done: something kills every one of them
)
CONNECT = 10  # [s] to reach a scheduler
IN_FLIGHT = 2  # parts handed out per worker: one computed, one waiting, so that a worker never idles


@dataclass(frozen=True)
class Progress:
    """How far a campaign is: runs finished before this call, finished by now, and wanted."""

    before: int
    done: int
    runs: int


def conduct(
    campaign: Campaign,
    folder: Path | str,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    watch: Callable[[Progress], None] | None = None,
) -> Progress:
    """Compute what is missing of a campaign into `folder`; return how far it is, which is: done.

    Parameters
    ----------
    campaign
        what to run; a folder of another campaign is refused, a longer one of the same continues.
    folder
        where rig.toml, law.json, campaign.json and part-*.parquet are kept.
    workers
        processes on this machine, 1 … 1024; the result does not depend on it. One is this process. More
        import the script that runs: it calls this below ``if __name__ == "__main__":``.
    scheduler
        address of a Dask scheduler, e.g. "tcp://127.0.0.1:8786"; its workers must see `folder`.
    watch
        called after every part.

    Raises
    ------
    FieldError
        the folder belongs to another campaign, or cannot be written (finished parts are kept); the script
        has no such line.
    NotConvergedError
        worker processes die without finishing anything.
    """
    checked_noun("campaign", campaign, Campaign, remedy="Campaign.of makes one, load_campaign reads one")
    place = checked_path("folder", folder)
    checked_whole("workers", workers, 1, 1024)
    _claim(campaign, place)
    missing = [part for part in range(campaign.parts) if not _is_done(campaign, place, part)]
    before = campaign.runs - sum(campaign.part_runs(part) for part in missing)
    progress = Progress(before, before, campaign.runs)
    try:
        if scheduler:
            source = _on_cluster(place, missing, scheduler)
        else:
            source = _on_pool(place, missing, workers) if workers > 1 else _here(place, missing)
        with closing(source) as finished:
            for part in finished:
                progress = Progress(before, progress.done + campaign.part_runs(part), campaign.runs)
                if watch is not None:
                    watch(progress)
    except OSError as error:
        raise FieldError(
            "out",
            str(place),
            f"not writable ({error.strerror or error})",
            allowed="a folder with space left",
            remedy="finished parts are kept: make room and give the same command again",
        ) from error
    return progress


def _claim(campaign: Campaign, place: Path) -> None:
    """Make the folder this campaign's, or refuse it."""
    if (place / "campaign.json").exists():
        known = load_campaign(place)
        if known.fingerprint != campaign.fingerprint:
            raise FieldError(
                "out",
                str(place),
                "the folder of another campaign",
                allowed="a new folder, or one of the same rig, law, draws and seed",
                remedy="choose another folder",
            )
        if known.runs >= campaign.runs:
            return
    try:
        save_campaign(campaign, place)
    except OSError as error:
        raise FieldError(
            "out",
            str(place),
            f"not writable ({error.strerror or error})",
            allowed="a folder that can be written",
            remedy="choose another folder",
        ) from error


def _is_done(campaign: Campaign, place: Path, part: int) -> bool:
    return part_path(place, part).exists() and read_part(campaign, place, part) is not None


def compute(folder: str, part: int) -> int:
    """Compute one part of the campaign kept in `folder`; what a worker process is told, as plain values."""
    write_part(load_campaign(folder), Path(folder), part)
    return part


def _here(place: Path, missing: list[int]) -> Generator[int, None, None]:
    """One worker needs no process of its own: a second to start it, and no script that is run again."""
    for part in missing:
        yield compute(str(place), part)


def _on_pool(place: Path, missing: list[int], workers: int) -> Generator[int, None, None]:
    from concurrent.futures.process import BrokenProcessPool

    left, deaths = list(missing), 0
    while left:
        done: list[int] = []
        try:
            for part in _one_pool(place, left, workers):
                done.append(part)
                deaths = 0
                yield part
        except BrokenProcessPool as error:
            deaths += 1
            if deaths >= PATIENCE:
                raise NotConvergedError(
                    "campaign workers",
                    reached=0,
                    wanted=len(left),
                    remedy="the system kills every worker: give fewer workers, or look for lack of memory",
                ) from error
        left = [part for part in left if part not in set(done)]


def _one_pool(place: Path, parts: list[int], workers: int) -> Generator[int, None, None]:
    from concurrent.futures import FIRST_COMPLETED, Future, wait

    from fraclink._campaign.workers import process_pool

    waiting, running = list(reversed(parts)), set[Future[int]]()
    with process_pool(workers) as pool:
        while waiting or running:
            while waiting and len(running) < IN_FLIGHT * workers:
                running.add(pool.submit(compute, str(place), waiting.pop()))
            finished, running = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                yield future.result()


def _on_cluster(place: Path, missing: list[int], scheduler: str | None) -> Generator[int, None, None]:
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise MissingExtraError("distributed", "cluster") from error
    try:
        client = Client(scheduler, timeout=CONNECT)
    except (OSError, ValueError) as error:
        raise FieldError(
            "scheduler",
            scheduler,
            "not answering",
            allowed="the address of a running Dask scheduler, e.g. tcp://127.0.0.1:8786",
            remedy="start one: dask scheduler; dask worker ADDRESS",
        ) from error
    with client:
        # retries: Dask gives the parts of a worker that died to another one
        futures = client.map(compute, [str(place.resolve())] * len(missing), missing, pure=False, retries=3)
        for future in as_completed(futures):
            yield future.result()
