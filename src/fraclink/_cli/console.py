"""Output of the command line, its streams and exit codes; never a traceback.

Results go to standard output, everything else to standard error, so that a pipe carries
results only. Terminal escapes in names that come from files are made visible before
they are printed: a log's column called ``\\x1b]0;...`` must not retitle, recolour or
rewrite a terminal.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

import typer

from fraclink.errors import (
    FieldError,
    FraclinkError,
    FraclinkWarning,
    InfeasibleError,
    MissingExtraError,
)
from fraclink.view._text import folded, options_text
from fracsys.errors import printable

Answer = TypeVar("Answer")

PASSED, FAILED, BAD_INPUT = 0, 1, 2
# A defect of fraclink itself, distinct from the three verdicts (EX_SOFTWARE of
# sysexits).
DEFECT = 70
INTERRUPTED = 130  # 128 + SIGINT, as shells report it
UNREAD = 141  # 128 + SIGPIPE, as for any program whose reader left early

_NO_ROOM = "failed to map segment from shared object"  # message of the dynamic loader

# typer contains its own copy of click; the base class of its usage errors is reached
# through a public name.
_USAGE: Any = typer.BadParameter.__mro__[2]


def clean(text: object) -> str:
    """Return `text` with everything a terminal would obey escaped.

    >>> clean("a\\x1b[31mb\\u202ec")
    'a\\\\x1b[31mb\\\\u202ec'
    """
    return "\n".join(map(printable, str(text).split("\n")))


def width() -> int:
    """Columns of the terminal, or COLUMNS where it is set; 80 where neither is known."""
    return shutil.get_terminal_size().columns


def emit(text: str) -> None:
    """Print a result on standard output."""
    sys.stdout.write(clean(text) + "\n")


def emit_json(value: Mapping[str, object]) -> None:
    """Print a result for programs: one JSON object, numbers that read back exactly."""
    # ASCII, for pipes whose locale is not UTF-8; NaN is not JSON, and readers treat it
    # differently.
    sys.stdout.write(json.dumps(value, allow_nan=False, ensure_ascii=True) + "\n")


def tell(text: str) -> None:
    """Print a remark on standard error."""
    if sys.stderr.isatty():
        # Only for a terminal: a log file or `grep` needs one line per remark.
        text = folded(text, width())
    sys.stderr.write(clean(text) + "\n")


# --- questions ---------------------------------------------------------------------------


def interactive() -> bool:
    """Whether somebody is there to ask."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def ask(
    question: str,
    understood: Callable[[str], Answer],
    *,
    default: str = "",
    option: str,
) -> Answer:
    """Ask on the terminal until the answer is understood: until `understood` raises no
    ValueError. FieldError, with `option` as its remedy, where nobody can be asked.
    """
    hint = f"[{default}] " if default else ""
    while True:
        line = ""
        if interactive():
            sys.stderr.write(f"{question} {hint}> ".lstrip())
            sys.stderr.flush()
            line = sys.stdin.readline()
        if not line:
            raise FieldError(
                option.removeprefix("--").replace("-", "_"),
                None,
                "missing",
                f"an answer to: {question.rstrip('?')}" if question else "an answer",
                f"give {option} where nobody can be asked",
            )
        try:
            return understood(line.strip() or default)
        except ValueError as error:
            tell(str(error))


# --- progress -------------------------------------------------------------------------------------------


@contextmanager
def steps(total: int) -> Iterator[Callable[..., None]]:
    """Yield a function that names each of `total` parts on standard error as it begins,
    and moves the bar to `done` if that is given. Without a terminal nothing is shown.
    """
    hidden = total == 0 or not sys.stderr.isatty()
    with typer.progressbar(
        length=total, show_pos=True, hidden=hidden, file=sys.stderr
    ) as bar:

        def begin(name: str, done: int | None = None) -> None:
            bar.label = clean(name)
            bar.update(1 if done is None else done - bar.pos)

        yield begin


# --- from an error to one line and an exit code -----------------------------------------------------------


def _line(text: str) -> str:
    return clean(" ".join(text.split()))


def _describe(error: BaseException) -> dict[str, object]:
    """The parts of an error that a program can evaluate."""
    if isinstance(error, FieldError):
        names = ("field", "value", "problem", "allowed", "remedy")
        return {name: clean(getattr(error, name)) for name in names}
    if isinstance(error, InfeasibleError):
        problem = clean(error.explanation)
        return {
            "condition": error.condition,
            "problem": problem,
            "nearest": error.nearest,
        }
    return {"problem": _line(_words(error))}


def _words(error: BaseException) -> str:
    return error.format_message() if isinstance(error, _USAGE) else str(error)


def _answer(error: BaseException) -> tuple[int, str]:
    """Exit code and the line that explains it."""
    words = _words(error)
    if isinstance(error, _USAGE):
        # The command whose help lists the correct words.
        command = "fraclink" if error.ctx is None else error.ctx.command_path
        problem = words.rstrip(".")
        # Where a text is not a number, or not one of the words, the parser names
        # neither value nor range.
        refused: list[Any] = getattr(error.__context__, "errors", list)()
        if refused and (parameter := getattr(error, "param", None)):
            why = refused[0]["msg"].removeprefix("Value error, ").rstrip(".")
            problem = f"{parameter.opts[0]}: {why} (got {refused[0]['input']})"
            problem += f"; expected: {(parameter.help or '').rstrip('.')}"
        return BAD_INPUT, f"error: {problem} (see `{command} --help`)"
    # Before FraclinkError, the base of both: bad input is 2, and a missing package is
    # no verdict on an arm.
    if isinstance(error, FieldError | MissingExtraError):
        return BAD_INPUT, f"error: {words}"
    if isinstance(error, InfeasibleError) and error.nearest:
        refusal = f"✗ failed: {error.condition}: {error.explanation}"
        return FAILED, f"{refusal}; nearest feasible: {options_text(error.nearest)}"
    if isinstance(error, FraclinkError):
        return FAILED, f"✗ failed: {words}"
    if isinstance(error, OSError):
        # The error of a full disk or of a loader names no file.
        name = error.filename if error.filename is not None else "file"
        problem = f"{name}: {error.strerror or words}"
        return BAD_INPUT, f"error: {problem}; check the path, its rights and the disk"
    # A shared library without room in memory raises ImportError although its package
    # exists.
    if isinstance(error, MemoryError) or _NO_ROOM in words:
        return BAD_INPUT, (
            f"error: memory: not enough for this command ({words or 'an array'}); expected 1 GB of address space."
            " Raise the limit of the process (ulimit -v)."
        )
    if isinstance(error, KeyboardInterrupt):
        state = "finished files are complete, nothing is half written"
        return INTERRUPTED, f"interrupted; {state}"
    return DEFECT, (
        f"error: fraclink failed inside ({type(error).__name__}: {words}); this is a defect, please report it"
        " (FRACLINK_TRACEBACK=1 shows where)"
    )


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print fraclink's warnings as lines on standard error and drop those of other
    libraries.
    """

    def show(
        message: Warning | str, category: type[Warning], *_: object, **__: object
    ) -> None:
        if issubclass(category, FraclinkWarning):
            tell(_line(f"warning: {message}"))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", FraclinkWarning)
        warnings.showwarning = show
        yield


@contextmanager
def unread_allowed() -> Iterator[None]:
    """Allow printing to a reader who leaves: the exit code is known, and this does not
    change it.
    """
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_unread()


def _discard_unread() -> None:
    """Discard output that a departed reader did not take, since the interpreter flushes
    it again at exit.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def guarded(work: Callable[[], int | None], *, as_json: bool) -> int:
    """Run `work` and return its exit code, or the one its error stands for."""
    verdict = UNREAD
    try:
        with _warnings_as_lines():
            code = work()
        verdict = PASSED if code is None else int(code)
        sys.stdout.flush()
        return verdict
    except BrokenPipeError:
        # The reader of a pipe left (`| head`): this is not an error, but stdout must
        # not be flushed again. Nor is it a verdict: a verdict already reached stands,
        # otherwise there is none.
        _discard_unread()
        return verdict
    except (Exception, KeyboardInterrupt) as error:
        (code, line), parts = _answer(error), _describe(error)
        # For bug reports; all other users read one line.
        if os.environ.get("FRACLINK_TRACEBACK") == "1" and not isinstance(
            error, _USAGE
        ):
            raise
        lines = [line]
        # A rig file reports all its faults together, one line each.
        if faults := getattr(error, "faults", ()):
            lines = [f"error: {fault}" for fault in faults]
            parts = parts | {"faults": [_describe(fault) for fault in faults]}
        # such as the name of the file that the error is in
        notes = "".join(f" ({note})" for note in getattr(error, "__notes__", ()))
        lines = [f"{line}{notes}" for line in lines]
    # Separately: one stream may have a reader although the other has none.
    with unread_allowed():
        for line in lines:
            tell(_line(line))
    with unread_allowed():
        if as_json:
            emit_json({"exit": code, "error": parts})
    return code
