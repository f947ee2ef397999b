"""The supported provers, their command lines, and the format of their numbers."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, Context
from pathlib import Path

__all__ = [
    "COMPILER",
    "FRAMA_C",
    "GAPPA",
    "SOLVERS",
    "Answer",
    "Tool",
    "at_most",
    "sha256_of_text",
]

# A proof takes seconds on a desktop; without an answer in ten minutes none will come.
SECONDS = 600


@dataclass(frozen=True)
class Answer:
    """What a program printed, and its exit code; code None where it was stopped for
    time.
    """

    text: str
    code: int | None


@dataclass(frozen=True)
class Tool:
    """A program, the Debian package that brings it, and the words that make it print
    its version.
    """

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

    def run(
        self, arguments: Sequence[str], folder: Path, *, seconds: float = SECONDS
    ) -> Answer:
        """Run the program in `folder` and return all that it printed."""
        # Frama-C takes the working directory from PWD, which a change of directory
        # alone does not update
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
# In the order in which they are run, until one decides.
SOLVERS = (Tool("z3", "z3"), Tool("cvc5", "cvc5"))


def at_most(value: float, digits: int = 6) -> str:
    """Return a positive number in `digits` digits, rounded up: a bound that is printed
    smaller is no bound.

    >>> at_most(7.08102178574), at_most(9.2981e-16, 3)
    ('7.08103', '9.3e-16')
    """
    rounded = Context(prec=digits, rounding=ROUND_CEILING).create_decimal_from_float(
        value
    )
    return f"{float(rounded):.{digits}g}"


def sha256_of_text(text: str) -> str:
    """Return the SHA-256 of the text's UTF-8 bytes as 64 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()
