"""The command line: commands that chain through files; the exit code is the verdict."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence

from fraclink.errors import MissingExtraError

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line with `arguments` (default: the process's own) and return the
    exit code.

    0 passed, 1 failed (infeasible, not certified, a run that does not settle) or not
    shown, 2 bad input.
    """
    try:
        from fraclink._cli.app import run
    except ModuleNotFoundError as error:
        if error.name not in {"typer", "rich"}:
            raise
        sys.stderr.write(f"error: {MissingExtraError(error.name, 'cli')}\n")
        return 2
    _accept_any_text()
    return run(sys.argv[1:] if arguments is None else arguments)


def _accept_any_text() -> None:
    """Let an ASCII pipe or a closed stream accept what is printed: the exit code is a
    verdict on the arm and not on the terminal.
    """
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started the process
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115
        elif name != "stdin" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
