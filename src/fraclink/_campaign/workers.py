"""Worker processes of this machine, and the script that cannot have them."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from fraclink.errors import FieldError

__all__ = ["process_pool"]


@contextmanager
def process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of `workers` processes; at the end what waits is cancelled and what runs is awaited.

    Raises FieldError where the workers die because each runs the user's script again, BrokenProcessPool
    where they die of anything else.
    """
    # spawn: a forked child would inherit threads of numerical libraries in the middle of a lock
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield pool
    except BrokenProcessPool as error:
        script = _unguarded_script()
        if script is None:
            raise
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
    """The script that runs, if it never asks whether it is the main one; a spawned process runs it again."""
    file = getattr(sys.modules["__main__"], "__file__", None)
    # a package's __main__.py (`python -m fraclink`) is not run again
    if file is None or Path(file).name == "__main__.py" or not Path(file).is_file():
        return None
    text = Path(file).read_text(encoding="utf-8", errors="replace")
    return None if "__main__" in text or "parent_process" in text else Path(file)
