"""Mutated files: what a reader must survive, whatever a disk, a cable or an enemy did
to the bytes.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import numpy as np

from fraclink import Rig, read_log
from fraclink._reading.formats import ReaderChild, sniffed_kind
from fraclink._reading.text import CPU_SECONDS
from fraclink.errors import FraclinkError
from made_files import made_file
from made_logs import made_rows, write_log

KINDS = ("text", "rig", "mat5", "mat73", "hdf5", "parquet", "tdms", "mcap", "db3")
_TELLING = (
    b"\x00",
    b"\xff",
    b"\xff\xff\xff\xff",
    b"\x00\x00\x00\x80",
    b"\x7f\xff\xff\xff",
    b"nan",
    b"1e999",
    b"\n",
    b",",
)
SUFFIX = {
    "text": ".csv",
    "rig": ".toml",
    "mat5": ".mat",
    "mat73": ".mat",
    "hdf5": ".h5",
}


def mutate(raw: bytes, rng: np.random.Generator) -> bytes:
    """One change or a few: bits flipped, bytes replaced, pieces cut, doubled, moved or
    cut off.
    """
    data = bytearray(raw)
    for _ in range(
        int(rng.geometric(0.5))
    ):  # half of them one change, which reaches deepest
        at, size = int(rng.integers(0, max(1, len(data)))), int(rng.integers(1, 33))
        change = int(rng.integers(0, 7))
        if change == 0:
            data[at : at + 1] = (
                bytes([data[at] ^ (1 << int(rng.integers(0, 8)))]) if data else b""
            )
        elif change == 1:
            data[at : at + 1] = bytes([int(rng.integers(0, 256))])
        elif change == 2:
            data[at : at + size] = rng.bytes(size)
        elif change == 3:
            del data[at : at + size]
        elif change == 4:
            data[at:at] = data[max(0, at - size) : at]
        elif change == 5:
            telling = _TELLING[int(rng.integers(0, len(_TELLING)))]
            data[at : at + len(telling)] = telling
        elif rng.random() < 0.2:
            del data[at:]
    return bytes(data)


@dataclass
class Outcome:
    """What became of the mutants of one format."""

    counts: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    surprises: list[str] = field(default_factory=list)


class Arena:
    """Feeds mutants to one reader; binary ones to one child, which is replaced when it
    dies.
    """

    def __init__(self, kind: str, folder: Path, cpu_seconds: int) -> None:
        self.kind, self.folder = kind, folder
        self.base = self._base()
        self.path = folder / f"mutant{SUFFIX.get(kind, '.' + kind)}"
        self.child = ReaderChild(cpu_seconds)

    def __enter__(self) -> Arena:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.child.__exit__(kind, error, trace)

    def _base(self) -> bytes:
        if self.kind == "rig":
            Rig.named("paper-2023").save(self.folder / "base.toml")
            return (self.folder / "base.toml").read_bytes()
        if self.kind == "text":
            return write_log(
                self.folder / "base.csv", made_rows(210), before="# payload_kg: 0.03\n"
            ).read_bytes()
        return made_file(self.kind, self.folder, count=64).read_bytes()

    def _read(self) -> None:
        if self.kind == "rig":
            Rig.load(self.path)
        elif self.kind == "text":
            read_log(self.path)
        else:
            kind = sniffed_kind(self.path)
            if kind != "text":
                self.child.read(self.path, kind)

    def try_one(self, raw: bytes, outcome: Outcome) -> None:
        """Read one mutant and note what came of it."""
        self.path.write_bytes(raw)
        started = time.process_time()
        try:
            self._read()
        except FraclinkError as error:
            died = any(
                word in str(error)
                for word in ("crashed", "parser needed", "was stopped", "parser ended")
            )
            outcome.counts["child died" if died else "refused"] += 1
        except Exception as error:  # noqa: BLE001
            outcome.counts["surprise"] += 1
            outcome.surprises.append(f"{type(error).__name__}: {error}"[:200])
        else:
            outcome.counts["read"] += 1
        outcome.slowest = max(outcome.slowest, time.process_time() - started)


def run(
    kind: str, count: int, folder: Path, seed: int = 0, cpu_seconds: int = CPU_SECONDS
) -> Outcome:
    """Feed `count` mutants of a format to its reader."""
    rng, outcome = np.random.default_rng(seed), Outcome()
    with Arena(kind, folder, cpu_seconds) as arena:
        for _ in range(count):
            arena.try_one(mutate(arena.base, rng), outcome)
    assert not list(folder.glob("core*"))
    return outcome
