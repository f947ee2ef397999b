"""The codec: a saved object is equal when loaded, and any other file content raises
FileFormatError.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import stat
import subprocess
import sys
import threading
import zipfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
import fracsys
from fraclink import load, save
from fraclink._files import document
from fraclink.errors import FieldError, FileFormatError, SizeError
from fraclink.extend import kind_of
from fraclink.findings import Finding
from mutants import mutate


class Span(NamedTuple):
    low: float
    high: float = math.inf


SPAN = Span(0.0)


@dataclasses.dataclass(frozen=True)
class Gear:
    ratio: float
    teeth: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.ratio > 0:
            raise FieldError(
                "ratio",
                self.ratio,
                "not positive",
                allowed="> 0",
                remedy="give a ratio",
            )


@dataclasses.dataclass(frozen=True)
class Belt:
    length: float


@document(
    "made-up",
    version=3,
    period=lambda made: made.period,
    sources=lambda made: {"log.csv": "0" * 64},
    summary=lambda made: {
        "verdict": "passed" if made.passed else "failed",
        "worst": math.inf,
    },
)
@dataclasses.dataclass(frozen=True)
class Made:
    name: str
    period: float
    passed: bool = True
    count: int = 0
    drive: Gear | Belt | None = None
    offset: float | Literal["first"] = 0.0
    kind: Literal["zero", "first"] = "zero"
    poles: tuple[complex, ...] = ()
    pair: tuple[float, int] = (1.0, 2)
    span: Span = SPAN
    table: Mapping[str, Gear] = dataclasses.field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    notes: tuple[tuple[str, str], ...] = ()
    anything: Any = None
    mass: Annotated[float | None, "kg"] = None
    cached: list[int] = dataclasses.field(
        default_factory=list, metadata={"stored": False}, compare=False
    )


FULL = Made(
    name='é "quoted" \ud800\n',
    period=0.004,
    passed=False,
    count=2**70,
    drive=Gear(50.0, (20, 1000)),
    offset="first",
    kind="first",
    poles=(complex(-0.0, 1e-308), complex(math.inf, 0.1)),
    pair=(0.1, -3),
    span=Span(-math.inf, 1.7976931348623157e308),
    table={"a": Gear(1.0), "": Gear(2.0, (1,))},
    findings=(Finding("W101", "warning", "c contradicts", {"c": 1.56}, "measure"),),
    notes=(("simulated", "true"),),
    anything={"x": [1, None, "y", 2.5, {"z": True}]},
    mass=0.03,
    cached=[1],
)


@document("made-up-run", version=2, container="npz")
@dataclasses.dataclass(frozen=True, eq=False)
class Signals:
    time: NDArray[np.float64]
    flags: NDArray[np.uint32]
    response: NDArray[np.complex128] | None = None
    parts: tuple[NDArray[np.float64], ...] = ()
    made: Made | None = None


@document("made-up-exact", hex_floats=True)
@dataclasses.dataclass(frozen=True)
class Exact:
    value: float
    pole: complex
    rows: NDArray[np.float64] = dataclasses.field(
        default_factory=lambda: np.zeros(0), compare=False
    )


SIGNALS = Signals(
    time=np.array([0.0, np.nan, -0.0, np.inf]),
    flags=np.arange(3, dtype=np.uint32),
    response=np.array([[1 + 2j, -0.0 - 1e-308j]]),
    parts=(np.zeros((0, 2)), np.arange(6.0).reshape(2, 3).T),
    made=FULL,
)


def same_signals(a: Signals, b: Signals) -> bool:
    pairs: list[tuple[Any, Any]] = [
        (a.time, b.time),
        (a.flags, b.flags),
        (a.response, b.response),
        *zip(a.parts, b.parts, strict=True),
    ]
    return a.made == b.made and all(
        x is y
        or (x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes())
        for x, y in pairs
    )


@pytest.mark.parametrize(
    "made",
    [Made("plain", 1e-3), FULL, Made("x", 1, drive=Belt(2.0), count=np.int64(3))],
)
def test_a_nested_value_comes_back_equal(made: Made, tmp_path: Path) -> None:
    path = save(made, tmp_path / "made.json")
    assert load(path) == made
    assert load(path, Made) == made and load(path, kind=(Made, Exact)) == made
    assert [type(load(path).drive), type(load(path).period)] == [
        type(made.drive),
        float,
    ]


def test_every_bit_of_a_real_comes_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = rng.integers(0, 2**63, 2000, dtype=np.uint64).view(np.float64)
    values = values[np.isfinite(values)]
    made = Made("x", 1.0, poles=tuple(complex(x, -x) for x in values))
    assert load(save(made, tmp_path / "a.json")).poles == made.poles
    exact = Exact(float(values[0]), complex(values[1], -0.0), values)
    back = load(save(exact, tmp_path / "b.json"))
    assert back == exact and back.rows.tobytes() == values.tobytes()
    assert math.copysign(1.0, back.pole.imag) == -1.0
    assert (
        '"0x' in (tmp_path / "b.json").read_text()
        and '"0x' not in (tmp_path / "a.json").read_text()
    )


def test_signals_come_back_and_anybody_can_open_them(tmp_path: Path) -> None:
    path = save(SIGNALS, tmp_path / "run.npz")
    back = load(path, Signals)
    assert same_signals(back, SIGNALS)
    assert not back.time.flags.writeable
    with np.load(path, allow_pickle=False) as data:
        assert np.array_equal(data["parts.1"], SIGNALS.parts[1])
        assert json.loads(str(data["about"]))["fraclink"] == "made-up-run"


def stated_and_own_digest(text: str) -> tuple[str, str]:
    """The digest stated in a document, and the one computed as described in
    docs/reference/file-formats.md.
    """
    data = json.loads(text)
    covered = {key: item for key, item in data.items() if key not in ("sha256", "tool")}
    plain = json.dumps(covered, sort_keys=True, separators=(",", ":"))
    return data["sha256"], hashlib.sha256(plain.encode("ascii")).hexdigest()


def test_the_same_value_gives_the_same_bytes_and_digest(tmp_path: Path) -> None:
    for value, name in ((FULL, "x.json"), (SIGNALS, "x.npz")):
        first = save(value, tmp_path / name).read_bytes()
        assert save(value, tmp_path / name, force=True).read_bytes() == first
    stated, own = stated_and_own_digest((tmp_path / "x.json").read_text())
    with np.load(tmp_path / "x.npz", allow_pickle=False) as data:
        of_archive = stated_and_own_digest(str(data["about"]))
    assert stated == own and of_archive[0] == of_archive[1] != own
    save(
        dataclasses.replace(FULL, period=0.0040000000000000001 + 1e-18),
        tmp_path / "other.json",
    )
    assert stated_and_own_digest((tmp_path / "other.json").read_text())[0] != stated


def test_the_envelope_says_what_the_file_is(tmp_path: Path) -> None:
    data = json.loads(save(FULL, tmp_path / "x.json").read_text())
    assert (data["fraclink"], data["format"], data["units"]) == (
        "made-up",
        3,
        "SI, radians",
    )
    assert (data["tool"], data["period"], data["sources"]) == (
        fl.__version__,
        0.004,
        {"log.csv": "0" * 64},
    )
    assert data["summary"] == {"verdict": "failed", "worst": "inf"}
    assert data["content"]["drive"] == {
        "type": "Gear",
        "ratio": 50.0,
        "teeth": [20, 1000],
    }
    assert "cached" not in data["content"]


def edited(path: Path, change: Any) -> Path:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    return path


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda d: d["content"]["drive"].update(ratio=400.0), "sha256"),
        (lambda d: d["content"].update(passed=True), "sha256"),
        (lambda d: d["summary"].update(verdict="passed"), "sha256"),
        (lambda d: d["sources"].update({"log.csv": "1" * 64}), "sha256"),
        (lambda d: d.update(period=0.008), "sha256"),
        (lambda d: d.update(units="mm"), "sha256"),
        (lambda d: d.pop("sha256"), "sha256"),
        (lambda d: d.update(sha256=None), "sha256"),
        (lambda d: d.update(more=1), "more"),
        (lambda d: d.update(format=4), "format"),
        (lambda d: d.update(format=True), "format"),
        (lambda d: d.update(format=[3]), "format"),
        (lambda d: d.update(fraclink="law"), "file"),
        (lambda d: d.update(fraclink=["made-up"]), "file"),
        (lambda d: d.pop("fraclink"), "file"),
        (lambda d: d.pop("content"), "content"),
    ],
)
def test_an_edited_file_is_refused(change: Any, field: str, tmp_path: Path) -> None:
    path = edited(save(FULL, tmp_path / "x.json"), change)
    with pytest.raises(FileFormatError) as caught:
        load(path, Made)
    assert caught.value.field == field and caught.value.remedy


def written(tmp_path: Path, text: str) -> Path:
    """A file with a correct digest, whatever its content."""
    path = tmp_path / "written.json"
    head = '{"fraclink": "made-up", "format": 3, "units": "SI, radians"'
    digest = stated_and_own_digest(f'{head}, "sha256": "", "content": {text}}}')[1]
    path.write_text(f'{head}, "sha256": "{digest}", "content": {text}}}')
    return path


@pytest.mark.parametrize(
    ("content", "field"),
    [
        ({"name": "a"}, "period"),
        ({"name": "a", "period": 1.0, "extra": 1}, "extra"),
        ({"name": 5, "period": 1.0}, "name"),
        ({"name": "a", "period": True}, "period"),
        ({"name": "a", "period": "fast"}, "period"),
        ({"name": "a", "period": 10**320}, "period"),
        ({"name": "a", "period": "0x1.0p+1"}, "period"),
        ({"name": "a", "period": 1.0, "count": 1.0}, "count"),
        ({"name": "a", "period": 1.0, "passed": 1}, "passed"),
        (
            {"name": "a", "period": 1.0, "drive": {"type": "Gear", "ratio": -1.0}},
            "drive.ratio",
        ),
        ({"name": "a", "period": 1.0, "drive": {"type": "Gear"}}, "drive.ratio"),
        ({"name": "a", "period": 1.0, "drive": {"type": "os.system"}}, "drive"),
        ({"name": "a", "period": 1.0, "drive": {"type": ["Gear"]}}, "drive"),
        ({"name": "a", "period": 1.0, "drive": {"ratio": 1.0}}, "drive"),
        ({"name": "a", "period": 1.0, "kind": "second"}, "kind"),
        ({"name": "a", "period": 1.0, "offset": "last"}, "offset"),
        ({"name": "a", "period": 1.0, "poles": [[1.0]]}, "poles.0"),
        ({"name": "a", "period": 1.0, "poles": {"0": 1}}, "poles"),
        ({"name": "a", "period": 1.0, "pair": [1.0]}, "pair"),
        ({"name": "a", "period": 1.0, "pair": [1.0, 2.5]}, "pair.1"),
        ({"name": "a", "period": 1.0, "raw": "0g"}, "raw"),
        ({"name": "a", "period": 1.0, "span": {"high": 1.0}}, "span.low"),
        (
            {
                "name": "a",
                "period": 1.0,
                "table": {"x": {"ratio": 1.0, "teeth": [1, "2"]}},
            },
            "table.x.teeth.1",
        ),
        (
            {"name": "a", "period": 1.0, "findings": [{"code": "W1", "message": "x"}]},
            "findings.0.severity",
        ),
    ],
)
def test_the_first_wrong_key_is_named(
    content: dict[str, Any], field: str, tmp_path: Path
) -> None:
    with pytest.raises(FileFormatError) as caught:
        load(written(tmp_path, json.dumps(content)))
    assert caught.value.field == field
    assert caught.value.allowed and caught.value.remedy


def test_what_is_expected_is_compared_before_anything_is_made(tmp_path: Path) -> None:
    path = save(FULL, tmp_path / "x.json")
    with pytest.raises(FileFormatError, match="of kind 'made-up'"):
        load(path, Exact)
    (tmp_path / "y.json").write_text('{"fraclink": "no-such-kind", "format": 1}')
    with pytest.raises(FileFormatError, match="of kind 'no-such-kind'"):
        load(tmp_path / "y.json")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"PK",
        b"PK\x03\x04" + bytes(40),
        b"{",
        b"[]",
        b"null",
        b"\xff{}",
        b"[" * 99999,
    ],
)
def test_foreign_files_are_refused(content: bytes, tmp_path: Path) -> None:
    for name in ("x.json", "x.npz", "x"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileFormatError):
            load(tmp_path / name)
    assert kind_of(tmp_path / "x") == ""
    with pytest.raises(FileFormatError, match="not there"):
        load(tmp_path / "none.json")
    with pytest.raises(FileFormatError):
        load(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("ending", ["json", "npz"])
def test_a_pipe_or_a_folder_in_the_place_of_a_file_holds_nobody(
    ending: str, tmp_path: Path
) -> None:
    """Opening a pipe that nothing writes to would block forever."""
    os.mkfifo(tmp_path / f"pipe.{ending}")
    (tmp_path / f"folder.{ending}").mkdir()
    with ThreadPoolExecutor() as pool:
        for place in sorted(tmp_path.iterdir()):
            reading, asking = pool.submit(load, place), pool.submit(kind_of, place)
            done, _ = wait((reading, asking), timeout=20)
            if len(done) < 2:  # release them, or the test itself waits
                os.close(os.open(place, os.O_WRONLY | os.O_NONBLOCK))
            assert asking in done and asking.result() == ""
            assert reading in done
            error = reading.exception()
            assert isinstance(error, FileFormatError) and error.problem == "not a file"
            assert error.value == place.name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("value", "name"),
    [(FULL, "x.json"), (SIGNALS, "x.npz"), (Exact(0.1, 1j), "y.json")],
)
def test_mutants_are_equal_or_refused(value: Any, name: str, tmp_path: Path) -> None:
    rng, refused = np.random.default_rng(5), 0
    path = save(value, tmp_path / name)
    raw, count = path.read_bytes(), 400
    for _ in range(count):
        path.write_bytes(mutate(raw, rng))
        try:
            back = load(path)
        except FileFormatError:
            refused += 1
        # a space, the version of the tool, or what the zip archive contains twice
        else:
            assert (
                same_signals(back, value)
                if isinstance(value, Signals)
                else back == value
            )
    assert refused > 0.8 * count


@pytest.mark.slow
def test_what_cannot_be_saved_is_refused_before_a_file_is_made(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    for value in (5, Gear(1.0), Made):
        with pytest.raises(FieldError, match="without a file format"):
            save(value, path)
    wrong_values: tuple[Any, ...] = (
        Made(5, 1.0),
        Made("x", "y"),
        Made("x", 1.0, anything={1, 2}),
        Made("x", 1.0, drive=Span(1.0)),  # type: ignore[arg-type]
    )
    for wrong in wrong_values:
        with pytest.raises(FieldError):
            save(wrong, path)
    with pytest.raises(SizeError):
        save(Made("x", 1.0, anything="y" * 17_000_000), path)
    with pytest.raises(FieldError, match="float64"):
        save(
            Signals(np.zeros(3, np.float32), np.zeros(3, np.uint32)), tmp_path / "x.npz"
        )  # type: ignore[arg-type]
    unlike: tuple[tuple[Any, str], ...] = (
        (FULL, "x.npz"),
        (SIGNALS, "x.json"),
        (SIGNALS, "x.csv"),
    )
    for noun, name in unlike:
        with pytest.raises(FieldError, match="another kind of file"):
            save(noun, tmp_path / name)
    assert list(tmp_path.iterdir()) == []
    assert load(save(FULL, tmp_path / "no-ending")) == FULL
    save(FULL, path)
    with pytest.raises(FieldError, match="already there"):
        save(FULL, path)
    assert save(Made("new", 1.0), path, force=True) == path and load(path).name == "new"


@pytest.mark.slow
def test_threads_that_save_leave_permissions_and_files_alone(tmp_path: Path) -> None:
    mask = os.umask(0o027)
    try:
        seen: list[int] = []

        def work(number: int) -> None:
            for turn in range(20):
                save(Made(str(number), 1.0), tmp_path / "shared.json", force=True)
                own = tmp_path / f"{number}-{turn}"
                own.touch()
                seen.extend(
                    (
                        stat.S_IMODE(own.stat().st_mode),
                        stat.S_IMODE((tmp_path / "shared.json").stat().st_mode),
                    )
                )
                load(tmp_path / "shared.json")

        threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        os.umask(mask)
    assert set(seen) == {0o640} and len(seen) == 320
    assert len(list(tmp_path.iterdir())) == 161


def test_a_zip_archive_with_arrays_exchanged_is_refused(tmp_path: Path) -> None:
    path = save(SIGNALS, tmp_path / "x.npz")
    with zipfile.ZipFile(path) as archive:
        members = {item.filename: archive.read(item) for item in archive.infolist()}
    members["time.npy"], members["parts.0.npy"] = (
        members["parts.0.npy"],
        members["time.npy"],
    )
    with zipfile.ZipFile(path, "w") as archive:
        for name, blob in members.items():
            archive.writestr(name, blob)
    with pytest.raises(FileFormatError, match="arrays"):
        load(path)


def test_the_root_saves_and_loads(tmp_path: Path) -> None:
    assert fl.load(fl.save(FULL, tmp_path / "x.json")) == FULL


@pytest.mark.parametrize("depth", [100, 300, 600, 900, 980])
def test_deep_nesting_ends_in_a_file_format_error(depth: int, tmp_path: Path) -> None:
    path = save(FULL, tmp_path / "x.json")
    deep = "[" * depth + "]" * depth
    path.write_text(path.read_text().replace("2.5", deep, 1))
    with pytest.raises(FileFormatError):
        load(path)


@pytest.mark.slow
def test_a_process_that_has_loaded_nothing_finds_the_class_of_a_kind(
    tmp_path: Path,
) -> None:
    log = fl.Experiment(period=0.004, motor_angle=[0.0, 0.1], output=[0.0, 0.01])
    for value in (log, fracsys.margins(2.0 / (fracsys.s * (fracsys.s + 1)))):
        file = fl.save(value, tmp_path / type(value).__name__)
        command = f"import fraclink as fl; print(type(fl.load({str(file)!r})).__name__)"
        done = subprocess.run(  # noqa: S603
            [sys.executable, "-c", command], capture_output=True, text=True, check=False
        )
        assert done.stdout.strip() == type(value).__name__, done.stderr
