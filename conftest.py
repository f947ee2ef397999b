"""Release memory, so that `make test` fits into a gigabyte. Linear algebra has one
thread per worker: two workers share two cores, and with more threads the last bits
depend on the machine.

Cached results of one test file are not needed by any other, and free memory is returned
to the system only if the C library is told to. Without these two measures a worker
grows to twice its initial size.
"""

from __future__ import annotations

import ctypes
import gc
import linecache
import os
import sys
from types import ModuleType

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

# Read when numpy is loaded; no plugin loads it before this file.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# One worker runs all tests that start process pools, so that no two pools exist at the
# same time.
_POOLS = {f"tests/test_campaign{name}.py" for name in ("", "_resume", "_summary")}
_POOLS |= {"tests/test_integrity.py"}


class _Scheduling(LoadFileScheduling):
    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return "pools" if file in _POOLS else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(
    config: pytest.Config, log: Producer
) -> LoadFileScheduling | None:
    """Keep the tests of a file on one worker, and all of those that start pools."""
    return _Scheduling(config, log) if config.getvalue("dist") == "loadfile" else None


def _forget(module: ModuleType) -> None:
    """Empty the caches of the functions that a module defines or uses; the caches of
    the package are bounded.
    """
    for value in vars(module).values():
        if hasattr(value, "cache_clear") and not str(value.__module__).startswith(
            "fraclink."
        ):
            value.cache_clear()


_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None
_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of malloc.h
if hasattr(_LIBC, "mallopt"):
    # Arrays of several megabytes are returned when they are freed. By default the GNU C
    # library raises this limit to the largest block freed so far, up to 32 MB; smaller
    # blocks then stay in the worker, below memory in use.
    _LIBC.mallopt(_MMAP_THRESHOLD, 4 * 2**20)


def _give_back() -> None:
    gc.collect()
    if hasattr(_LIBC, "malloc_trim"):
        _LIBC.malloc_trim(0)


def pytest_collection_finish() -> None:
    """Leave modules and collected tests out of every later search for garbage: they
    stay.
    """
    linecache.clearcache()  # all sources that were searched for examples
    _give_back()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Behind the last test of a file, empty its caches and return what is free."""
    if nextitem is not None and nextitem.path == item.path:
        return
    module = getattr(item, "module", None)
    if module is not None:
        _forget(module)
    _give_back()


class _Lean:
    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Of what passed keep the name and the time: the words of thirty thousand
        reports are 40 MB.
        """
        if report.passed:
            report.keywords, report.sections, report.user_properties = {}, [], []


def pytest_configure(config: pytest.Config) -> None:
    """Let the process in which the workers' reports come together forget what nobody
    will read.
    """
    if config.getoption("numprocesses", None):
        config.pluginmanager.register(_Lean())
