"""The provers that may be installed, and how each is run."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["COMPILER", "FRAMA_C", "GAPPA", "SOLVERS", "Answer", "Tool"]

# A proof takes seconds on a desktop; ten minutes without an answer is one that will not come.
SECONDS = 600


@dataclass(frozen=True)
class Answer:
    """What a program printed, and its exit code; code None where it was stopped for time."""

    text: str
    code: int | None


@dataclass(frozen=True)
class Tool:
    """A program, the Debian package that brings it, and the words that make it print its version."""

    program: str
    package: str
    version: tuple[str, ...] = ("--version",)

    @property
    def path(self) -> str | None:
        """Where the program is, or None."""
        return shutil.which(self.program)

    @property
    def missing(self) -> str:
        """What is said where the program is not installed."""
        return f"{self.program} is not installed (Debian package {self.package})"

    @property
    def name(self) -> str:
        """The program with its version."""
        words = self.run(self.version, Path.cwd()).text.split("\n", 1)[0].split()
        number = next((word for word in words if word[:1].isdigit()), "")
        return f"{self.program} {number}".strip()

    def run(self, arguments: Sequence[str], folder: Path, *, seconds: float = SECONDS) -> Answer:
        """Run the program in `folder` and return all that it printed."""
        # Frama-C takes the working directory from PWD, which a change of directory alone leaves behind
        environment = os.environ | {"PWD": str(folder.resolve())}
        command = [self.path or self.program, *arguments]
        try:
            done = subprocess.run(  # noqa: S603
                command,
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=seconds,
                check=False,
                env=environment,
            )
        except subprocess.TimeoutExpired:
            return Answer(f"{self.program}: no answer within {seconds:g} s\n", None)
        return Answer(done.stdout + done.stderr, done.returncode)


FRAMA_C = Tool("frama-c", "frama-c-base", ("-version",))
GAPPA = Tool("gappa", "gappa")
COMPILER = Tool("cc", "gcc")
# In the order they are asked, until one decides.
SOLVERS = (Tool("z3", "z3"), Tool("cvc5", "cvc5"))
