"""What a terminal shows and a pipe does not: progress, folded remarks,
questions.
"""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import pytest

from fraclink import main
from fraclink._cli.console import guarded
from fraclink.errors import (
    FieldError,
    FraclinkError,
    InfeasibleError,
    MissingExtraError,
    NotCertifiedError,
)


class Terminal(io.StringIO):
    """A stream connected to a terminal."""

    def isatty(self) -> bool:
        return True


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Standard error of this test, on a terminal of 60 columns."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "60")
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


# --- errors and warnings ----------------------------------------------------------------------------------


def error(kind: str) -> BaseException:
    made: dict[str, Callable[[], BaseException]] = {
        "field": lambda: FieldError(
            "m\x1b", -1, "negative", allowed="> 0 kg", remedy="say kg"
        ),
        "nearest": lambda: InfeasibleError(
            "(39)", "too slow", {"gain_crossover": 12.0}
        ),
        "hopeless": lambda: InfeasibleError("(39)", "too slow", {}),
        "other": lambda: FraclinkError("of\nsome kind"),
        "file": lambda: OSError(28, "No space left on device"),
        "loader": lambda: OSError("cannot open shared object"),
    }
    return made[kind]()


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (
            FieldError("m", -1, "negative", allowed="> 0 kg", remedy="say kg"),
            2,
            "error: m: negative (got -1)",
        ),
        (MissingExtraError("flint", "certify"), 2, "error: flint is not installed; "),
        (
            InfeasibleError("(39)", "too slow", {"gain_crossover": 12.0}),
            1,
            "✗ failed: (39): too slow; nearest",
        ),
        (NotCertifiedError("at 20 g"), 1, "✗ failed: at 20 g\n"),
        (
            OSError(28, "No space left on device", "out.json"),
            2,
            "error: out.json: No space left on device; check the path",
        ),
        (
            PermissionError(13, "Permission denied", "/x/y"),
            2,
            "error: /x/y: Permission denied; check the path",
        ),
        (KeyboardInterrupt(), 130, "interrupted; "),
        (
            ZeroDivisionError("division by zero"),
            70,
            "error: fraclink failed inside (ZeroDivisionError: ",
        ),
    ],
)
def test_every_error_becomes_one_line(
    capsys: pytest.CaptureFixture[str], error: BaseException, code: int, line: str
) -> None:
    def work() -> int:
        raise error

    assert guarded(work, as_json=False) == code
    told = capsys.readouterr()
    assert told.err.startswith(line)
    assert (told.err.count("\n"), told.out) == (1, "")


def test_a_defect_shows_where_it_is_when_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRACLINK_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        guarded(lambda: 1 // 0, as_json=False)


@pytest.mark.parametrize(
    ("kind", "code", "line", "parts"),
    [
        (
            "field",
            2,
            r"error: m\x1b: negative (got -1); expected > 0 kg. Say kg.",
            {
                "field": r"m\x1b",
                "value": "-1",
                "problem": "negative",
                "allowed": "> 0 kg",
                "remedy": "say kg",
            },
        ),
        (
            "nearest",
            1,
            "✗ failed: (39): too slow; nearest feasible: --gain-crossover 12",
            {
                "condition": "(39)",
                "problem": "too slow",
                "nearest": {"gain_crossover": 12.0},
            },
        ),
        (
            "hopeless",
            1,
            "✗ failed: ",
            {"condition": "(39)", "problem": "too slow", "nearest": {}},
        ),
        ("other", 1, "✗ failed: of some kind", {"problem": "of some kind"}),
        (
            "file",
            2,
            "error: file: No space left on device; check the path, its rights and the disk",
            {"problem": "[Errno 28] No space left on device"},
        ),
        (
            "loader",
            2,
            "error: file: cannot open shared object; check the path, its rights and the disk",
            {"problem": "cannot open shared object"},
        ),
    ],
)
def test_an_error_has_one_line_for_people_and_its_parts_for_programs(
    capsys: pytest.CaptureFixture[str],
    kind: str,
    code: int,
    line: str,
    parts: dict[str, object],
) -> None:
    def work() -> int:
        raise error(kind)

    assert guarded(work, as_json=True) == code
    told = capsys.readouterr()
    assert told.err.startswith(line) and told.err.count("\n") == 1
    if kind != "hopeless":
        assert told.err == line + "\n"
    assert "nearest" not in told.err or kind == "nearest"
    assert json.loads(told.out) == {"exit": code, "error": parts}


def test_a_file_with_several_faults_gets_a_line_for_each(
    capsys: pytest.CaptureFixture[str],
) -> None:
    faults = [
        FieldError(name, 1, "wrong", allowed="2", remedy="mend it")
        for name in ("a", "b")
    ]
    whole = FieldError("rig", "x.toml", "2 faults", allowed="none", remedy="mend them")
    whole.faults = faults  # type: ignore[attr-defined]

    def work() -> int:
        raise whole

    assert guarded(work, as_json=True) == 2
    told = capsys.readouterr()
    assert told.err.splitlines() == [
        "error: a: wrong (got 1); expected 2. Mend it.",
        "error: b: wrong (got 1); expected 2. Mend it.",
    ]
    said = json.loads(told.out)["error"]
    assert said["field"] == "rig" and [fault["field"] for fault in said["faults"]] == [
        "a",
        "b",
    ]


def test_a_reader_that_leaves_a_pipe_is_no_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """`fraclink ... | head`: the rest of the output is discarded on purpose. A verdict
    reached before is the exit code; otherwise it is 128 + SIGPIPE, as for any program.

    A verdict that had been reached stands; left before, it is 128 + SIGPIPE, as of any
    program.
    """

    def left() -> int:
        raise BrokenPipeError

    with (tmp_path / "pipe").open("w") as pipe:

        class Left(io.StringIO):
            def flush(self) -> None:
                raise BrokenPipeError

            def fileno(self) -> int:
                return pipe.fileno()

        monkeypatch.setattr(sys, "stdout", Left())
        codes = [
            guarded(work, as_json=True)
            for work in (lambda: None, lambda: 0, lambda: 1, left)
        ]
        assert codes == [0, 0, 1, 141]
        pipe.write("lost")
    assert (tmp_path / "pipe").read_text() == ""


def left_pipe(*, buffered: bool) -> TextIO:
    """A stream into a pipe whose reader has exited; unbuffered as with
    PYTHONUNBUFFERED=1.
    """
    reader, writer = os.pipe()
    os.close(reader)
    raw = os.fdopen(writer, "wb", -1 if buffered else 0)
    return io.TextIOWrapper(raw, "utf-8", write_through=not buffered)


@pytest.mark.slow
@pytest.mark.parametrize("buffered", [False, True])
@pytest.mark.parametrize(
    ("words", "codes"),
    [
        ("design --rig paper-2023", (0, 0)),  # the verdict reached before
        ("design --rig paper-2023 --json", (0, 0)),
        ("help design", (141, 141)),
        ("design --rig nope --json", (2, 2)),
    ],
)
@pytest.mark.parametrize("both", [False, True])
def test_the_exit_code_outlives_the_reader_of_a_pipe(
    words: str,
    codes: tuple[int, int],
    buffered: bool,
    both: bool,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """`fraclink ... | true`, and with `2>&1`: typer's own exit code of 1 would be a
    verdict.
    """
    stream = left_pipe(buffered=buffered)
    monkeypatch.chdir(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        if both:
            patch.setattr(sys, "stderr", stream)
        assert main(words.split()) == codes[buffered]
        assert sys.stdout is stream  # the wrapping by typer is undone
    # as the interpreter does at exit: no output is left unread
    stream.close()


# --- lists and help -----------------------------------------------------------------------------------------


def test_without_typer_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Gone:
        """An installation without one package, which the application imports first."""

        missing = ""

        def find_spec(self, name: str, *_: object) -> None:
            if name == "fraclink._cli.app":
                raise ModuleNotFoundError(
                    f"No module named {self.missing!r}", name=self.missing
                )

    gone = Gone()
    monkeypatch.delitem(sys.modules, "fraclink._cli.app")
    monkeypatch.setattr(sys, "meta_path", [gone, *sys.meta_path])
    for gone.missing in ("typer", "rich"):
        assert main([]) == 2
        told = capsys.readouterr().err
        assert (
            told.startswith(f"error: {gone.missing} is not installed; ")
            and "fraclink[cli]" in told
        )
    # a broken installation instead of an extra that is not installed
    gone.missing = "scipy"
    with pytest.raises(ModuleNotFoundError):
        main([])


# --- questions ----------------------------------------------------------------------------------------------


TUNE = (
    "tune --io serial:nowhere@1000000 --payload 0.03 --speed 3 --torque 2 --voltage 5"
)


@pytest.mark.parametrize(
    ("said", "go"),
    [("y", True), ("YES", True), ("no", False), ("", False), ("ye", False)],
)
def test_an_arm_moves_after_a_yes_only(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    said: str,
    go: bool,
) -> None:
    monkeypatch.chdir(tmp_path)
    terminal = on_terminal(monkeypatch)
    monkeypatch.setattr(sys, "stdin", Terminal(said + "\n"))
    code = main([*TUNE.split(), "--angle-deg", "90"])
    assert "Go ahead? [no] > " in terminal.getvalue()
    # After a yes the serial line is opened, which does not exist.
    assert code == (2 if go else 1)
    assert ("nowhere" in terminal.getvalue().partition("Go ahead?")[2]) is go
    assert ("nothing was moved" in capsys.readouterr().out) is not go


@pytest.mark.parametrize("blind", ["stdin", "stderr"])
def test_nobody_is_asked_where_one_end_is_a_pipe(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, blind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    terminal = on_terminal(monkeypatch)
    monkeypatch.setattr(sys, "stdin", Terminal("y\n"))
    monkeypatch.setattr(sys, blind, io.StringIO("1\n"))
    seen = sys.stderr if blind == "stderr" else terminal
    assert isinstance(seen, io.StringIO)
    assert main(TUNE.split()) == 2
    told = " ".join(seen.getvalue().split())
    assert "angle_deg is required; " in told and "Give --angle-deg" in told
    assert main([*TUNE.split(), "--angle-deg", "90"]) == 2
    told = " ".join(seen.getvalue().split())
    assert "yes is required" in told
    assert "Give --yes where nobody can be asked" in told


def test_memory_that_does_not_suffice_is_no_defect(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def load() -> None:
        raise ImportError("linalg.so: failed to map segment from shared object")

    def allocate() -> None:
        raise MemoryError

    for work in (load, allocate):
        assert guarded(work, as_json=False) == 2
        error = capsys.readouterr().err
        assert error.startswith("error: memory: ") and "ulimit" in error
