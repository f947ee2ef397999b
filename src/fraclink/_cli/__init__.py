"""The command line: commands that chain through files; the exit code is the verdict."""

from __future__ import annotations

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
    return run(sys.argv[1:] if arguments is None else arguments)
