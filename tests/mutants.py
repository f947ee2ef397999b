"""Mutated files that a reader must survive, whether a disk, a cable or an attacker
changed the bytes.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fraclink import Rig, inspect_log
from fraclink.errors import FraclinkError
from made_files import made_file
from made_logs import made_rows, write_log

KINDS = ("text", "rig", "mat5", "mat73", "tdms")
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
}


def mutate(raw: bytes, rng: np.random.Generator) -> bytes:
    """Make one change or a few: bits flipped, bytes replaced, pieces removed,
    duplicated, moved or truncated.
    """
    data = bytearray(raw)
    # half of them have a single change, which penetrates deepest into the reader
    for _ in range(int(rng.geometric(0.5))):
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
    """The results of the mutants of one format."""

    counts: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    surprises: list[str] = field(default_factory=list)


def base(kind: str, folder: Path) -> bytes:
    """The bytes of a good file."""
    if kind == "rig":
        Rig.named("paper-2023").save(folder / "base.toml")
        return (folder / "base.toml").read_bytes()
    if kind == "text":
        return write_log(
            folder / "base.csv", made_rows(210), before="# payload_kg: 0.03\n"
        ).read_bytes()
    return made_file(kind, folder, count=64).read_bytes()


def run(kind: str, count: int, folder: Path, seed: int = 0) -> Outcome:
    """Feed `count` mutants of a format to its reader."""
    rng, outcome, good = np.random.default_rng(seed), Outcome(), base(kind, folder)
    path = folder / f"mutant{SUFFIX.get(kind, '.' + kind)}"
    for _ in range(count):
        path.write_bytes(mutate(good, rng))
        started = time.process_time()
        try:
            Rig.load(path) if kind == "rig" else inspect_log(path)
        except FraclinkError as error:
            died = any(word in str(error) for word in ("crashed", "parser"))
            outcome.counts["child died" if died else "refused"] += 1
        except Exception as error:  # noqa: BLE001
            outcome.counts["surprise"] += 1
            outcome.surprises.append(f"{type(error).__name__}: {error}"[:200])
        else:
            outcome.counts["read"] += 1
        outcome.slowest = max(outcome.slowest, time.process_time() - started)
    assert not list(folder.glob("core*"))
    return outcome
