"""Damage every kind of file that fraclink writes, and read it: 20 000 mutants in all,
or as many as stated.

    python benchmarks/fuzz_documents.py [count] [seed]

Half of them are changes of bytes, half of them, where the file is JSON, changes of its
structure, which leave it JSON and so reach the checks behind the parser. The files are
those of release 0.1; whatever of them `load` reads is saved anew, as today's documents,
and what such a one holds is changed under a digest that fits: it would refuse every
other change. Wanted: no surprise, that is, no exception that is not fraclink's own.
"""

from __future__ import annotations

import contextlib
import copy
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import fraclink as fl
from fraclink._campaign import load_campaign, read_part
from fraclink._certify import Certificate
from fraclink._files import _digest as document_digest
from fraclink.errors import FraclinkError
from mutants import mutate

FORMATS = Path(__file__).resolve().parents[1] / "tests" / "golden" / "formats"
WRONG = (
    None,
    "",
    "x",
    -1,
    0,
    2.5,
    10**400,
    "0x1.8p+2000",
    True,
    [],
    {},
    [[]],
    {"type": "Gear"},
    "nan",
    "\x00",
)


def nodes(data: Any) -> list[tuple[Any, Any]]:
    """Every place of a JSON value: its container and key."""
    pairs = (
        data.items()
        if isinstance(data, dict)
        else enumerate(data)
        if isinstance(data, list)
        else ()
    )
    return [place for key, item in pairs for place in ((data, key), *nodes(item))]


def restructured(raw: bytes, rng: np.random.Generator) -> bytes:
    """JSON with a value replaced, left out, doubled, or exchanged for another."""
    data = json.loads(raw)
    places = nodes(data)
    for _ in range(int(rng.geometric(0.6))):
        where, key = places[int(rng.integers(len(places)))]
        other, name = places[int(rng.integers(len(places)))]
        try:
            change = int(rng.integers(4))
            if change == 0:
                where[key] = WRONG[int(rng.integers(len(WRONG)))]
            elif change == 1:
                del where[key]
            elif change == 2 and isinstance(where, list):
                where.insert(key, where[key])
            else:
                where[key] = copy.deepcopy(other[name])
        except (KeyError, IndexError):  # the place went with a change before
            continue
    return json.dumps(data).encode()


def load_proof(path: Path) -> object:
    return fl.Proof.load(path)


def load_folder(path: Path) -> object:
    """A campaign of which one file is damaged, and its part."""
    return read_part(load_campaign(path.parent), path.parent, 0)


def readers() -> list[tuple[Path, Callable[[Path], object]]]:
    """Each file of the collection and how it is read."""
    special: dict[str, Callable[[Path], object]] = {
        "proof.json": load_proof,
        "certificate.json": Certificate.load,
    }
    found: list[tuple[Path, Callable[[Path], object]]] = []
    for path in sorted(FORMATS.rglob("*.*")):
        if path.parent.name == "campaign":
            found.append((path, load_folder))
        elif path.name == "log.csv":
            found.append((path, fl.read_log))
        elif path.name == "study.json":
            found.append((path, lambda place: fl.load_study(place.parent)))
        else:
            found.append((path, special.get(path.name, fl.load)))
    return found


def signed(raw: bytes, rng: np.random.Generator) -> bytes:
    """A document of today with a changed content, and the digest of that content."""
    data = json.loads(raw)
    if "content" not in data:  # a proof, which states claims and carries no digest
        return restructured(raw, rng)
    data["content"] = json.loads(
        restructured(json.dumps(data["content"]).encode(), rng)
    )
    with contextlib.suppress(
        ValueError
    ):  # a number that is none: no digest, and so none that fits
        data["sha256"] = document_digest(data)
    return json.dumps(data).encode()


def renewed(folder: Path) -> list[tuple[Path, Callable[[Path], object]]]:
    """Today's documents of what the collection holds."""
    found: list[tuple[Path, Callable[[Path], object]]] = []
    for path in sorted(FORMATS.rglob("*.json")):
        with contextlib.suppress(FraclinkError):  # with a reader of its own
            found.append(
                (fl.save(fl.load(path), folder / "today" / path.name), fl.load)
            )
    proof = folder / "proof" / "certificate.json"
    fl.certify(fl.load(folder / "today" / "design.json", fl.Design)).save(proof)
    return [*found, (proof, Certificate.load)]


def fuzz(
    path: Path, read: Callable[[Path], object], count: int, seed: int, folder: Path
) -> tuple[Counter[str], float]:
    """Read `count` mutants of a file; how they ended, and the slowest [s of processor
    time].
    """
    rng, ended, slowest = np.random.default_rng(seed), Counter[str](), 0.0
    today = path.parent.name == "today"
    here = folder / path.parent.name
    shutil.copytree(path.parent, here, dirs_exist_ok=True)
    place, raw = here / path.name, path.read_bytes()
    for number in range(count):
        structured = number % 2 == 1 and path.suffix == ".json"
        change = (signed if today else restructured) if structured else mutate
        place.write_bytes(change(raw, rng))
        began = time.process_time()
        try:
            read(place)
            ended["read"] += 1
        except FraclinkError:
            ended["refused"] += 1
        except Exception as error:  # noqa: BLE001
            ended[f"surprise {type(error).__name__}: {error}"[:110]] += 1
        slowest = max(slowest, time.process_time() - began)
    shutil.rmtree(here)
    return ended, slowest


def main(count: int = 20_000, seed: int = 1) -> bool:
    """Print one line for each file; return whether every mutant was read or refused."""
    good, total = True, 0
    print(
        f"{'file':32} {'mutants':>8} {'read':>7} {'refused':>8} {'surprises':>9}  slowest"
    )
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as new:
        found = [*readers(), *renewed(Path(new))]
        each = -(-count // len(found))
        for path, read in found:
            ended, slowest = fuzz(path, read, each, seed, Path(folder))
            surprises = {
                name: n for name, n in ended.items() if name.startswith("surprise")
            }
            name = "/".join(path.parts[-2:])
            figures = f"{each:8d} {ended['read']:7d} {ended['refused']:8d} {sum(surprises.values()):9d}"
            print(f"{name:32} {figures}  {slowest:.2f} s", flush=True)
            for surprise, times in surprises.items():
                print(f"    {times} x {surprise}")
            good, total = good and not surprises, total + each
    outcome = "no surprise" if good else "surprises"
    print(f"{total} mutants of {len(found)} files, seed {seed}: {outcome}")
    return good


if __name__ == "__main__":
    sys.exit(0 if main(*map(int, sys.argv[1:3])) else 1)
