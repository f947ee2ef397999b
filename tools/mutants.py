"""Whether the tests notice: random mutants of the Python sources, each run against the
tests that touch it.

    python tools/mutants.py record [TEST ...]   # the blocks each test runs, and its time
    python tools/mutants.py run --seed 1 --count 300 --minutes 9   # again until all are judged
    python tools/mutants.py report --seed 1
    python tools/mutants.py run --seed 1 --count 120 --only core   # without the satellites
    python tools/mutants.py run --seed 1 --count 40 --only logs    # of one room

Without arguments: all three. A mutant is drawn by room (fracsys, the packages of
src/fraclink, the modules beside them, and prove), at least `FEWEST` from each and the
rest by the number of places; then by operator, each equally likely; then by place. It
is killed when a test fails that passes alone without it, or when the tests need far
more than their time. A change inside a function replaces the function's code in a
process that has collected all the tests; a change of what runs at import is made in a
process that has not imported fraclink. The sources on the disk are never touched, and
child processes of a test run the mutant too. Left out: csrc (tests/law_mutants.py
mutates law.c), tests that read the sources rather than run them, and tests of more than
`LONGEST` seconds. All times are processor times.
"""

from __future__ import annotations

import argparse
import ast
import builtins
import collections
import contextlib
import functools
import gc
import hashlib
import json
import marshal
import mmap
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from check_core import AROUND
from mutation import HITS, Site, instrumented, mutated, sites

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / "results" / "mutants"
TREES = (ROOT / "src" / "fracsys", ROOT / "src" / "fraclink", ROOT / "prove" / "src")
SEED, COUNT, FEWEST = 1, 300, 8  # FEWEST of a package, and fewer for a small count
LONGEST = 20.0  # [s] processor time that a test may take to be included
COLD_FILES = 10
BUDGET = 15.0  # [s] processor time of the tests of one mutant that survives
# Tests of files, guards and pages: they read sources, or start programs that never run
# the mutant.
UNCONCERNED = (
    "test_docs", "test_guards", "test_architecture", "test_studio_browser", "test_benchmarks_run",
    "test_readme", "test_reproduce", "test_examples", "test_export_gates", "test_export_firmware",
    "test_export_fmu_sources", "test_palette", "test_readers_mutants",
)  # fmt: skip
# The code by which a new process runs the changed code of a module.
SITE = f"""
import builtins, json, marshal, mmap, os
from importlib.machinery import SourceFileLoader
place = os.environ["FRACLINK_MUTATION"]
codes = json.load(open(os.path.join(place, "codes.json")))
if os.path.exists(os.path.join(place, "hits")):
    setattr(builtins, "{HITS}", mmap.mmap(os.open(os.path.join(place, "hits"), os.O_RDWR), 0))
original = SourceFileLoader.get_code
def get_code(self, name):
    file = codes.get(self.path)
    return original(self, name) if file is None else marshal.loads(open(file, "rb").read())
SourceFileLoader.get_code = get_code
"""


def files() -> list[Path]:
    return sorted(
        path
        for tree in TREES
        for path in tree.rglob("*.py")
        if path.name != "__main__.py"
    )


def room(path: Path) -> str:
    if not path.is_relative_to(ROOT / "src"):
        return "prove"
    package, *inside = path.relative_to(ROOT / "src").parts
    if package == "fracsys":
        return package
    return inside[0] if len(inside) > 1 else "(top)"


def chosen(path: Path, only: str) -> bool:
    """Whether a file belongs to what is drawn from: all, the core, or one room."""
    if only == "core":
        return room(path) not in (*AROUND, "prove")
    return only in ("", room(path))


def digest() -> str:
    """Digest of the sources as the interpreter sees them: comments do not count."""
    trees = (ast.dump(ast.parse(path.read_bytes())) for path in files())
    return hashlib.sha256("".join(trees).encode()).hexdigest()[:16]


# --- recording ----------------------------------------------------------------------------------------


def processor_time() -> float:
    return sum(os.times()[:4])


class Recorder:
    """A pytest plugin that notes the blocks each passed test ran, fixtures and cached
    helpers included.
    """

    def __init__(self, hits: np.ndarray) -> None:
        self.hits, self.rows, self.costs = hits, {}, {}
        self.fixtures: dict[Any, tuple[np.ndarray, float]] = {}
        self.passed = True

    @contextlib.contextmanager
    def alone(self) -> Iterator[list[Any]]:
        """Hits and time of what runs inside, without those of the code around it."""
        before, begin, result = self.hits.copy(), processor_time(), []
        self.hits[:] = 0
        try:
            yield result
        finally:
            result += [self.hits.copy(), processor_time() - begin]
            self.hits |= before

    def cache(self, maxsize: Any = 128, typed: bool = False) -> Any:
        """`functools.lru_cache` for this repository's functions: a test served from the
        cache counts as having run the function.
        """
        if callable(maxsize):
            return self.cache(None)(maxsize)

        def decorate(function: Callable[..., Any]) -> Any:
            if not getattr(function, "__code__", CACHE_CODE).co_filename.startswith(
                str(ROOT)
            ):
                return ORIGINAL_CACHE(maxsize, typed)(function)

            @ORIGINAL_CACHE(maxsize, typed)
            def kept(*args: Any, **options: Any) -> Any:
                with self.alone() as run:
                    value = function(*args, **options)
                return value, run[0]

            @functools.wraps(function)
            def served(*args: Any, **options: Any) -> Any:
                value, run = kept(*args, **options)
                self.hits[:] |= run
                return value

            served.cache_clear, served.cache_info = kept.cache_clear, kept.cache_info  # type: ignore[attr-defined]
            return served

        return decorate

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Any:
        with self.alone() as run:
            value = yield
        self.fixtures[fixturedef] = run[0], run[1]
        return value

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Any:
        self.passed = True
        signal.setitimer(signal.ITIMER_PROF, LONGEST)
        with self.alone() as run:
            value = yield
        signal.setitimer(signal.ITIMER_PROF, 0)
        row, cost = run
        known = getattr(item, "_fixtureinfo", None)
        for definitions in known.name2fixturedefs.values() if known else ():
            hits, seconds = self.fixtures.get(definitions[-1], (0, 0.0))
            row, cost = row | hits, cost + seconds
        if self.passed and cost < 1.5 * LONGEST:
            self.rows[item.nodeid], self.costs[item.nodeid] = row, cost
        return value

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.passed &= report.outcome == "passed"


ORIGINAL_CACHE = functools.lru_cache
CACHE_CODE = functools.lru_cache.__code__


def too_long(_number: int, _frame: Any) -> None:
    raise TimeoutError


def install(codes: dict[str, types.CodeType], place: Path, count: int) -> None:
    """Have this process and its children import these codes in place of the files."""
    shutil.rmtree(place, ignore_errors=True)
    (place / "site").mkdir(parents=True)
    listed = {}
    for k, (path, code) in enumerate(codes.items()):
        listed[path] = str(place / f"{k}.code")
        Path(listed[path]).write_bytes(marshal.dumps(code))
    (place / "codes.json").write_text(json.dumps(listed), encoding="utf-8")
    if count:
        (place / "hits").write_bytes(bytes(count))
    (place / "site" / "sitecustomize.py").write_text(SITE, encoding="utf-8")
    os.environ["FRACLINK_MUTATION"] = str(place)
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [str(place / "site"), os.environ.get("PYTHONPATH", "")]
    )
    original = SourceFileLoader.get_code

    def get_code(self: Any, name: str) -> Any:
        return codes[self.path] if self.path in codes else original(self, name)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]


def options(*more: str) -> list[str]:
    return [
        "-p",
        "no:cacheprovider",
        "-p",
        "no:randomly",
        "-p",
        "no:cov",
        "-q",
        "--hypothesis-seed=0",
        *more,
    ]


def chosen_files(only: list[str]) -> list[str]:
    every = sorted((ROOT / "tests").glob("test_*.py")) + sorted(
        (ROOT / "prove" / "tests").glob("test_*.py")
    )
    tests = [
        str(p.relative_to(ROOT)) for p in every if not p.stem.startswith(UNCONCERNED)
    ]
    return only or [*tests, "src/fraclink"]


def record(only: list[str], *, marks: str) -> None:
    """Run the tests once and note their blocks; with names of files, only those,
    replacing what was recorded of them.
    """
    codes, firsts, count = {}, {}, 0
    for path in files():
        firsts[str(path.relative_to(ROOT))] = count
        codes[str(path)], count = instrumented(path, count)
    install(codes, PLACE / "noted", count)
    buffer = mmap.mmap(os.open(PLACE / "noted" / "hits", os.O_RDWR), count)
    setattr(builtins, HITS, buffer)
    recorder = Recorder(np.frombuffer(buffer, np.uint8))
    functools.lru_cache, functools.cache = recorder.cache, recorder.cache(None)  # type: ignore[assignment]
    signal.signal(signal.SIGPROF, too_long)
    begin = processor_time()
    pytest.main(options("-m", marks, *chosen_files(only)), plugins=[recorder])
    names, costs = list(recorder.rows), [recorder.costs[name] for name in recorder.rows]
    rows = np.packbits(
        np.array([recorder.rows[name] for name in names], np.uint8).reshape(-1, count),
        axis=1,
    )
    if only and (PLACE / "record.npz").exists():
        kept = load_record()
        old = [k for k, name in enumerate(kept["names"]) if name not in recorder.rows]
        names = [kept["names"][k] for k in old] + names
        costs = [float(kept["costs"][k]) for k in old] + costs
        rows = np.concatenate([kept["rows"][old], rows])
    with (PLACE / "record.npz").open("wb") as stream:
        places = json.dumps(firsts)
        np.savez_compressed(
            stream,
            names=names,
            costs=costs,
            rows=rows,
            count=count,
            digest=digest(),
            firsts=places,
        )
    print(
        f"{len(names)} tests noted, {processor_time() - begin:.0f} s of processor time"
    )


def load_record() -> dict[str, Any]:
    with np.load(PLACE / "record.npz") as stored:
        kept = {name: stored[name] for name in stored.files}
    if str(kept["digest"]) != digest():
        raise SystemExit(
            "the sources have changed since they were recorded: run `record` again"
        )
    return kept | {"firsts": json.loads(str(kept["firsts"]))}


# --- drawing ------------------------------------------------------------------------------------------


def draw(seed: int, count: int, only: str = "") -> list[tuple[str, int]]:
    """(file, index of the change) of `count` mutants, of the core or of one room where
    that is named.
    """
    rng = random.Random(seed)  # noqa: S311
    places: dict[str, dict[str, dict[Any, list[tuple[str, int]]]]] = (
        collections.defaultdict(
            lambda: collections.defaultdict(lambda: collections.defaultdict(list))
        )
    )
    for path in files():
        if not chosen(path, only):
            continue
        name = str(path.relative_to(ROOT))
        for k, site in enumerate(sites(path)[1]):
            ends = [
                getattr(site.node, end, 0)
                for end in ("col_offset", "end_lineno", "end_col_offset")
            ]
            where = (name, site.line, *ends)
            places[room(path)][site.kind][where].append((name, k))
    sizes = {name: sum(map(len, kinds.values())) for name, kinds in places.items()}
    fewest = min(FEWEST, count // (2 * len(sizes)))
    left, total = count - fewest * len(sizes), sum(sizes.values())
    result: list[tuple[str, int]] = []
    for name in sorted(sizes):
        for _ in range(fewest + round(left * sizes[name] / total)):
            if not places[name]:
                break  # a small room: all of its places are drawn
            kind = rng.choice(sorted(places[name]))
            spot = rng.choice(sorted(places[name][kind]))
            result.append(rng.choice(places[name][kind].pop(spot)))
            if not places[name][kind]:
                del places[name][kind]
    rng.shuffle(result)  # so that a run that is interrupted has covered every package
    return result


def mentions() -> dict[str, set[int]]:
    """The blocks in which each name is read, for changes at import."""
    found: dict[str, set[int]] = collections.defaultdict(set)
    first = 0
    for path in files():
        tree, _ = sites(path, first)
        for node in ast.walk(tree):
            block = getattr(node, "block", None)
            if block is None:
                continue
            first = max(first, block + 1)
            for part in ast.walk(node):
                name = (
                    part.id
                    if isinstance(part, ast.Name)
                    else getattr(part, "attr", None)
                )
                if isinstance(name, str):
                    found[name].add(block)
    return found


class Choice:
    """The tests of a mutant, the cheapest first."""

    def __init__(self) -> None:
        kept = load_record()
        self.names: list[str] = [str(name) for name in kept["names"]]
        self.costs, self.firsts = kept["costs"], kept["firsts"]
        self.rows = np.unpackbits(kept["rows"], axis=1)[:, : int(kept["count"])]
        self.mentions = mentions()

    def tests(self, file: str, site: Site) -> list[tuple[str, float]]:
        if site.block is not None:
            touched = self.rows[:, site.block] > 0
        else:
            blocks = sorted(
                {b for name in site.names for b in self.mentions.get(name, ())}
            )
            names = list(self.firsts)
            after = [*self.firsts.values(), self.rows.shape[1]][names.index(file) + 1]
            own = range(self.firsts[file], after)
            # a module without a function is imported by all
            inside = self.rows[:, own].any(axis=1) if own else self.costs >= 0.0
            touched = inside & self.rows[:, blocks].any(axis=1) if blocks else inside
            if not touched.any():
                touched = inside
        every = sorted(
            (float(self.costs[k]), self.names[k]) for k in np.flatnonzero(touched)
        )
        # One of each file first: ten cheap tests of one file test the same thing ten
        # times.
        turn: collections.Counter[str] = collections.Counter()
        ranked = []
        for cost, name in every:
            of = name.split("[")[0]
            ranked.append((cost * 1.5 ** turn[of], name, cost))
            turn[of] += 1
        chosen, spent = [], 0.0
        for _, name, cost in sorted(ranked):
            # Every file of tests is collected again for a change at import.
            many = (
                site.block is None
                and len({test.split("::")[0] for test, _ in chosen}) >= COLD_FILES
            )
            new = name.split("::")[0] not in {test.split("::")[0] for test, _ in chosen}
            if spent + cost <= BUDGET and not (many and new):
                chosen.append((name, cost))
                spent += cost
        return chosen


def fates_file(seed: int, only: str) -> Path:
    return PLACE / f"seed-{seed}{only and '-' + only}.json"


# --- judging ------------------------------------------------------------------------------------------


def in_a_fork(
    work: Callable[[Callable[[str], None]], None], limit: float
) -> tuple[str, str, float]:
    """("failed", "passed" or "stopped", what the child said last, its processor time)."""
    board, begin = mmap.mmap(-1, 4096), time.monotonic()

    def say(word: str) -> None:
        board[:] = word.encode()[:4095].ljust(4096, b"\0")

    child = os.fork()
    if not child:
        os.setsid()
        code = 1
        with contextlib.suppress(BaseException):
            signal.signal(signal.SIGPROF, signal.SIG_DFL)
            signal.setitimer(signal.ITIMER_PROF, limit)
            resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
            work(say)
            code = 0
        os._exit(code)
    done, status, usage = 0, 0, None
    while not done:
        done, status, usage = os.wait4(child, os.WNOHANG)
        # a sleeping process uses no processor time
        if not done and time.monotonic() - begin > 30.0 + 15.0 * limit:
            os.killpg(child, signal.SIGKILL)
            done, status, usage = os.wait4(child, 0)
        elif not done:
            time.sleep(0.005)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # processes that it left behind
    fate = (
        "stopped"
        if os.WIFSIGNALED(status)
        else ("failed" if os.WEXITSTATUS(status) else "passed")
    )
    seconds = usage.ru_utime + usage.ru_stime if usage else 0.0
    return fate, bytes(board).rstrip(b"\0").decode(errors="replace"), seconds


class Failed(Exception):
    """A test has failed: the mutant is killed."""


class Watch:
    """A pytest plugin that says which test runs, and whether any has failed."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say, self.failed = say, False

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.say(nodeid)

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.failed |= report.failed


class Judge:
    """A pytest plugin that, once the tests are collected, tries every mutant in a fork
    of its own.
    """

    def __init__(
        self,
        work: list[tuple[str, Callable[[], None], list[tuple[str, float]]]],
        tell: Any,
    ) -> None:
        self.work, self.tell = work, tell
        self.failed = False
        self.alone: dict[str, bool] = {}

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.failed |= report.failed

    def trusted(self, item: Any) -> bool:
        """Whether the test that failed passes alone and without a mutant."""
        if item is None:
            return True  # the failure was not that of a test
        if item.nodeid not in self.alone:

            def run(_say: Callable[[str], None]) -> None:
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
                if self.failed:
                    raise Failed

            self.alone[item.nodeid] = in_a_fork(run, 30.0)[0] == "passed"
        return self.alone[item.nodeid]

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: Any) -> bool:
        items = {item.nodeid: item for item in session.items}
        gc.collect()
        gc.freeze()
        for key, change, tests in self.work:
            some = [items[name] for name, _ in tests if name in items]

            def run(
                say: Callable[[str], None], some: Any = some, change: Any = change
            ) -> None:
                for kept in [
                    o
                    for o in gc.get_objects(2) + gc.get_objects()
                    if isinstance(o, CACHED)
                ]:
                    kept.cache_clear()
                if change is not None:
                    change()
                for item, following in zip(some, [*some[1:], None], strict=True):
                    say(item.nodeid)
                    item.config.hook.pytest_runtest_protocol(
                        item=item, nextitem=following
                    )
                    if self.failed:
                        raise Failed

            limit = 8.0 + 2.0 * sum(cost for _, cost in tests)
            fate = in_a_fork(run, limit)
            while fate[0] == "failed" and not self.trusted(items.get(fate[1])):
                some[:] = [item for item in some if item.nodeid != fate[1]]
                fate = in_a_fork(run, limit)
            self.tell(key, len(some), *fate)
        return True


CACHED = type(ORIGINAL_CACHE(maxsize=1)(len))


def replace_code(path: str, code: types.CodeType) -> None:
    """Give every existing function of the file the new code of the same name and
    line.
    """
    new: dict[tuple[str, int], types.CodeType] = {}

    def gather(block: types.CodeType) -> None:
        for constant in block.co_consts:
            if isinstance(constant, types.CodeType):
                new[constant.co_qualname, constant.co_firstlineno] = constant
                gather(constant)

    gather(code)
    gc.unfreeze()  # frozen objects are not listed
    for one in gc.get_objects():
        if isinstance(one, types.FunctionType) and one.__code__.co_filename == path:
            other = new.get((one.__code__.co_qualname, one.__code__.co_firstlineno))
            if other is not None and other.co_freevars == one.__code__.co_freevars:
                one.__code__ = other


def silence() -> None:
    """Discard what pytest prints; the mutants' fates go to a file."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def run(seed: int, count: int, minutes: float, only: str = "") -> None:
    """Judge the mutants that are not yet judged, for so many minutes of processor time."""
    place = fates_file(seed, only)
    fates: dict[str, Any] = (
        json.loads(place.read_text(encoding="utf-8")) if place.exists() else {}
    )
    choice, end = Choice(), 60.0 * minutes
    cold, warm, told = [], [], {}
    for file, index in draw(seed, count, only):
        key = f"{file}:{index}"
        if key in fates:
            continue
        code, site, words = mutated(ROOT / file, index, choice.firsts[file])
        tests = choice.tests(file, site)
        told[key] = {
            "room": room(ROOT / file), "file": file, "line": site.line, "kind": site.kind, "change": words,
            "function": site.function,
        }  # fmt: skip
        if not tests:
            fates[key] = told[key] | {
                "fate": "no test",
                "by": "",
                "seconds": 0.0,
                "tests": 0,
            }
        elif site.block is None:
            cold.append((key, (str(ROOT / file), code), tests))
        else:
            warm.append((key, (str(ROOT / file), code), tests))

    def tell(key: str, tests: int, fate: str, by: str, seconds: float) -> None:
        words = {"passed": "survived", "failed": "killed", "stopped": "out of time"}
        fates[key] = told[key] | {
            "fate": words[fate],
            "by": by,
            "seconds": round(seconds, 2),
            "tests": tests,
        }
        place.write_text(json.dumps(fates, indent=1), encoding="utf-8")
        if processor_time() > end:
            os._exit(3)

    place.write_text(json.dumps(fates, indent=1), encoding="utf-8")
    preload()
    trusted: dict[str, bool] = {}
    for key, change, tests in cold:
        limit = 8.0 + 2.0 * sum(cost for _, cost in tests)
        names = [name for name, _ in tests]
        fate = in_a_fork(functools.partial(run_anew, dict([change]), names), limit)
        while fate[0] == "failed":
            # otherwise the import failed
            by = [fate[1]] if "::" in fate[1] else names[:1]
            if by[0] not in trusted:
                trusted[by[0]] = (
                    in_a_fork(functools.partial(run_anew, {}, by), 30.0)[0] == "passed"
                )
            if trusted[by[0]] or len(names) == 1:
                break
            names.remove(by[0])
            fate = in_a_fork(functools.partial(run_anew, dict([change]), names), limit)
        tell(key, len(tests), *fate)
    if warm:
        needed = sorted(
            {name.split("::")[0] for _, _, tests in warm for name, _ in tests}
        )
        work = [
            (key, functools.partial(change_and_tell, *change), tests)
            for key, change, tests in warm
        ]
        judge = Judge(work, tell)
        silence()
        pytest.main(options(*needed), plugins=[judge])


def run_anew(
    codes: dict[str, types.CodeType], names: list[str], say: Callable[[str], None]
) -> None:
    """Import fraclink with these codes and run these tests up to the first that fails."""
    place = PLACE / f"cold-{os.getpid()}"
    install(codes, place, 0)
    silence()
    watch = Watch(say)
    # If a docstring's example is among the tests, pytest would rewrite the assertions
    # of that module from the file instead of the mutant's code.
    ended = pytest.main(options("--assert=plain", "-x", *names), plugins=[watch])
    shutil.rmtree(place, ignore_errors=True)
    if watch.failed or ended != pytest.ExitCode.OK:
        raise Failed


def change_and_tell(path: str, code: types.CodeType) -> None:
    """Change this process's functions, and have its children import the same."""
    replace_code(path, code)
    install({path: code}, PLACE / "warm", 0)


def preload() -> None:
    """Import once what every fork needs, but nothing of fraclink."""
    for name in (
        "scipy.optimize",
        "scipy.signal",
        "scipy.linalg",
        "pydantic",
        "typer",
        "rich",
        "mpmath",
    ):
        __import__(name)


DEAD = ("killed", "out of time")


def report(seed: int, only: str = "") -> None:
    """Print the shares by operator and by room, and every mutant that no test noticed."""
    fates = list(
        json.loads(fates_file(seed, only).read_text(encoding="utf-8")).values()
    )
    shares: dict[str, dict[str, list[str]]] = {"kind": {}, "room": {}}
    for by, table in shares.items():
        for fate in fates:
            table.setdefault(fate[by], []).append(fate["fate"])
        for name, ends in sorted(table.items()):
            slow = ends.count("out of time")
            print(
                f"{by} {name:18s} {sum(e in DEAD for e in ends):3d} of {len(ends):3d} killed, {slow} by time"
            )
    for fate in sorted(fates, key=lambda f: (f["file"], f["line"])):
        if fate["fate"] not in DEAD:
            where = f"{fate['file']}:{fate['line']} {fate['kind']}"
            print(
                f"{fate['fate']:8s} {where}: {fate['change']} ({fate['tests']} tests)"
            )
    dead = sum(f["fate"] in DEAD for f in fates)
    worst = min(
        sum(e in DEAD for e in ends) / len(ends) for ends in shares["room"].values()
    )
    mark = "ok  " if dead >= 0.9 * len(fates) else "MISS"
    print(
        f"{mark} mutants killed, seed {seed}   {dead} of {len(fates)}   wanted >= 90 %"
    )
    print(
        f"{'ok  ' if worst >= 0.8 else 'MISS'} killed in the worst room   {worst:.0%}   wanted >= 80 %"
    )
    print(f"        {sum(f['seconds'] for f in fates):.0f} s of processor time")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("step", nargs="?", choices=("record", "run", "report"))
    parser.add_argument("tests", nargs="*")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument(
        "--only",
        default="",
        metavar="ROOM",
        help="mutants of this room, or of the core",
    )
    parser.add_argument(
        "--marks", default="", help="record these tests only, such as 'not slow'"
    )
    parser.add_argument("--minutes", type=float, default=60.0)
    given = parser.parse_args()
    PLACE.mkdir(parents=True, exist_ok=True)
    os.chdir(ROOT)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if given.step == "record":
        record(given.tests, marks=given.marks)
    elif given.step == "run":
        run(given.seed, given.count, given.minutes, given.only)
    elif given.step == "report":
        report(given.seed, given.only)
    else:
        for step in ("record", "run", "report"):
            line = [
                sys.executable,
                __file__,
                step,
                "--seed",
                str(given.seed),
                "--count",
                str(given.count),
            ]
            line += ["--only", given.only]
            subprocess.run(line, check=True)  # noqa: S603


if __name__ == "__main__":
    main()
