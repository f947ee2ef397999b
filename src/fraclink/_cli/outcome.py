"""From what happened to one line and an exit code; never a traceback."""

from __future__ import annotations

import math
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from fraclink._cli.console import clean, emit_json, tell
from fraclink.errors import FieldError, FraclinkError, FraclinkWarning, InfeasibleError, MissingExtraError

__all__ = ["BAD_INPUT", "FAILS", "FAULT", "HOLDS", "guarded"]

HOLDS, FAILS, BAD_INPUT = 0, 1, 2
FAULT = 70  # a defect of fraclink itself, kept apart from the three verdicts (sysexits' EX_SOFTWARE)
INTERRUPTED = 130  # 128 + SIGINT, as shells report it


def _line(text: str) -> str:
    return clean(" ".join(text.split()))


def _describe(error: BaseException) -> dict[str, object]:
    """The parts of an error that a program can act on."""
    if isinstance(error, FieldError):
        return {
            "field": clean(error.field),
            "value": clean(error.value),
            "problem": clean(error.problem),
            "allowed": clean(error.allowed),
            "remedy": clean(error.remedy),
        }
    if isinstance(error, InfeasibleError):
        return {"condition": error.condition, "problem": clean(error.explanation), "nearest": error.nearest}
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    return {"problem": _line(text)}


def _usage(error: Exception) -> str:
    """What is wrong with the words of a command, and where the right ones are listed."""
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    # The library that checks the values puts its own class's name before what it says.
    text = text.replace("Value error, ", "").rstrip(".")
    context = getattr(error, "ctx", None)
    verb = "fraclink" if context is None else context.command_path
    return f"{text} (`{verb} --help` says more)"


def _option(name: str, value: float) -> str:
    """A keyword argument as the option that stands for it; all digits: the nearest request lies on a bound.

    >>> _option("phase_margin", math.radians(50.5)), _option("gain_crossover", 12.0)
    ('--phase-margin-deg 50.5', '--gain-crossover 12.0')
    """
    word = f"--{name.replace('_', '-')}"
    # Rounded to degrees, an angle may come back on the other side of its bound by a part in 1e16.
    return f"{word}-deg {math.degrees(value):.12g}" if name == "phase_margin" else f"{word} {value!r}"


def _verdict(error: BaseException) -> tuple[int, str]:
    """Exit code and the line that explains it."""
    if isinstance(error, FieldError | MissingExtraError):
        return BAD_INPUT, f"error: {error}"
    if isinstance(error, InfeasibleError) and error.nearest:
        options = " ".join(_option(name, value) for name, value in error.nearest.items())
        return FAILS, f"does not hold: {error.condition}: {error.explanation}; nearest feasible: {options}"
    if isinstance(error, FraclinkError):
        return FAILS, f"does not hold: {error}"
    if isinstance(error, OSError):
        name = error.filename if error.filename is not None else "file"
        return BAD_INPUT, f"error: {name}: {error.strerror or error}"
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED, "interrupted; finished files are complete, nothing is half written"
    return FAULT, (
        f"error: fraclink failed inside ({type(error).__name__}: {error}); this is a defect, please report it"
        " (FRACLINK_TRACEBACK=1 shows where)"
    )


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print fraclink's warnings as lines on standard error and drop other libraries' chatter."""

    def show(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        if issubclass(category, FraclinkWarning):
            tell(_line(f"warning: {message}"))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", FraclinkWarning)
        warnings.showwarning = show
        yield


def guarded(work: Callable[[], int | None], *, as_json: bool) -> int:
    """Run `work` and return its exit code, or the one its error stands for."""
    import typer

    # typer carries its own copy of click; its base of usage errors is reached through a public name.
    usage_error: type[Exception] = typer.BadParameter.__mro__[2]
    try:
        with _warnings_as_lines():
            code = work()
        sys.stdout.flush()
        return HOLDS if code is None else int(code)
    except usage_error as error:
        code, lines, parts = BAD_INPUT, [f"error: {_usage(error)}"], _describe(error)
    except BrokenPipeError:
        # The reader of a pipe left (`| head`): no error of ours, but stdout must not be flushed again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return HOLDS
    except (Exception, KeyboardInterrupt) as error:
        if os.environ.get("FRACLINK_TRACEBACK") == "1":
            raise
        (code, line), parts = _verdict(error), _describe(error)
        lines = [line]
        if faults := getattr(error, "faults", ()):  # a rig file lists all its faults at once: a line for each
            lines = [f"error: {fault}" for fault in faults]
            parts = parts | {"faults": [_describe(fault) for fault in faults]}
    for line in lines:
        tell(_line(line))
    if as_json:
        emit_json({"exit": code, "error": parts})
    return code
