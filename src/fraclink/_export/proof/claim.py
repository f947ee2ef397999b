"""What a proof of an exported law says: its claims, each proved or not, and the file that carries them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from decimal import ROUND_CEILING, Context
from pathlib import Path
from typing import Literal

from fraclink._files import read_json, write_json

__all__ = ["Claim", "Proof", "Status", "at_most", "sha256_of_text"]

KIND, FORMAT = "proof", 1
Status = Literal["proved", "failed", "not proved"]


def at_most(value: float, digits: int = 6) -> str:
    """Return a positive number in `digits` digits, rounded up: a bound that is printed smaller is no bound.

    >>> at_most(7.08102178574), at_most(9.2981e-16, 3)
    ('7.08103', '9.3e-16')
    """
    rounded = Context(prec=digits, rounding=ROUND_CEILING).create_decimal_from_float(value)
    return f"{float(rounded):.{digits}g}"


def sha256_of_text(text: str) -> str:
    """Return the SHA-256 of the text's UTF-8 bytes as 64 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Claim:
    """One statement about the exported files and what became of it.

    Attributes
    ----------
    name
        "outputs", "finite", "slew", "rounding" or "loop".
    statement
        what is proved where `status` is "proved", in words and numbers.
    status
        "proved"; "failed": a tool found that it does not hold; "not proved": nothing decided it.
    reason
        why it is not proved: the alarm, the counterexample, the missing tool with its Debian package.
    tools
        who decided it, with versions.
    logs
        files below the folder that show it, and their SHA-256.
    """

    name: str
    statement: str
    status: Status
    reason: str = ""
    tools: tuple[str, ...] = ()
    logs: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Proof:
    """The claims about one exported folder.

    Attributes
    ----------
    law
        SHA-256 of the law's parameter block.
    sources
        SHA-256 of law.h, law.c and the header of coefficients: the proof is about these bytes.
    claims
        every claim that was tried.
    """

    law: str
    sources: Mapping[str, str]
    claims: tuple[Claim, ...]

    @property
    def holds(self) -> bool:
        """Whether every claim is proved."""
        return all(claim.status == "proved" for claim in self.claims)

    def __getitem__(self, name: str) -> Claim:
        return next(claim for claim in self.claims if claim.name == name)

    def __str__(self) -> str:
        return "\n".join(
            f"{claim.status}: {claim.statement}" + (f" [{claim.reason}]" if claim.reason else "")
            for claim in self.claims
        )

    def save(self, path: Path | str) -> None:
        """Write the proof to one JSON file."""
        write_json(path, KIND, FORMAT, {"holds": self.holds} | asdict(self))

    @staticmethod
    def load(path: Path | str) -> Proof:
        """Read a proof back; FileFormatError for another file."""
        data = read_json(path, KIND, (FORMAT,))
        claims = tuple(
            Claim(
                name=str(claim["name"]),
                statement=str(claim["statement"]),
                status=claim["status"],
                reason=str(claim["reason"]),
                tools=tuple(map(str, claim["tools"])),
                logs=tuple((str(file), str(digest)) for file, digest in claim["logs"]),
            )
            for claim in data["claims"]
        )
        return Proof(str(data["law"]), dict(data["sources"]), claims)
