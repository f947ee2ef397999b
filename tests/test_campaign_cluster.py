"""A campaign on a real local cluster: scheduler and workers are separate processes, and
one of them is killed.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from campaigns import computed, parts_of, small
from fraclink.errors import FieldError, MissingExtraError
from fraclink.trials import run_campaign
from needed_tools import missing


def spawn(module: str, *arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", module, *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@contextlib.contextmanager
def cluster(
    folder: Path, workers: int
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler on a free port of this machine and its workers; all ended afterwards."""
    about = folder / "scheduler.json"
    free = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-jupyter"]
    scheduler = spawn(
        "distributed.cli.dask_scheduler", *free, "--scheduler-file", str(about)
    )
    started: list[subprocess.Popen[bytes]] = []
    try:
        address = ""
        while not address:
            assert scheduler.poll() is None, "the scheduler does not start"
            time.sleep(0.05)
            # while the file is being written it is not valid JSON
            with contextlib.suppress(OSError, json.JSONDecodeError):
                address = json.loads(about.read_text())["address"]
        one = [
            "--scheduler-file",
            str(about),
            "--nthreads",
            "1",
            "--no-nanny",
            "--no-dashboard",
        ]
        place = ["--local-directory", str(folder), "--host", "127.0.0.1"]
        started = [
            spawn("distributed.cli.dask_worker", *one, *place) for _ in range(workers)
        ]
        yield address, started
    finally:
        for process in (*started, scheduler):
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes_though_a_worker_dies(tmp_path):
    try:
        import distributed  # noqa: F401
    except ImportError:
        missing("distributed is not installed (extra cluster)")
    killed = []
    with cluster(tmp_path, 2) as (address, workers):

        def kill_one(_: object) -> None:
            if not killed:
                workers[0].kill()
                killed.append(workers[0].pid)

        done = run_campaign(
            small(3500), tmp_path / "cluster", scheduler=address, watch=kill_one
        )
    assert killed and done.done == 3500
    assert parts_of(tmp_path / "cluster") == parts_of(
        computed(small(3500), tmp_path / "here")
    )


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_told(tmp_path):
    try:
        import dask
        import distributed  # noqa: F401
    except ImportError:
        missing("distributed is not installed (extra cluster)")
    timeout = {"distributed.comm.timeouts.connect": "1s"}
    with (
        dask.config.set(timeout),
        pytest.raises(FieldError, match="scheduler"),
    ):
        run_campaign(small(10), tmp_path, scheduler="tcp://127.0.0.1:9")


def test_without_the_extra_the_remedy_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match="cluster"):
        run_campaign(small(), tmp_path, scheduler="tcp://127.0.0.1:8786")
