"""The certificate: a statement, its proof as a tree, and the file that others check."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fraclink._certify.statement import ASSUMPTIONS, Statement, digest_of
from fraclink._files import read_json, write_json
from fraclink.errors import FileFormatError, NotCertifiedError

__all__ = ["Certificate"]

KIND, FORMAT = "certificate", 1


@dataclass(frozen=True)
class Certificate:
    """The outcome of `certify`: a proof, or the place where there is none.

    Attributes
    ----------
    statement
        what was to be proved, in exact numbers.
    holds
        whether it was proved.
    verdict
        one sentence for people.
    tree, leaves
        the proof; empty where there is none.
    payload, frequency, delay
        where it fails [kg, rad/s, s], None where it holds.
    distance
        |1 + L| found there.
    poles
        closed-loop poles of the fractional loop with M(s) at that payload [rad/s], where it is unstable.
    """

    statement: Statement
    passed: bool
    verdict: str
    tree: str = ""
    leaves: int = 0
    payload: float | None = None
    frequency: float | None = None
    delay: float | None = None
    distance: float | None = None
    poles: tuple[complex, ...] = ()

    @property
    def sha256(self) -> str:
        """SHA-256 over statement and tree, as the file carries it."""
        return digest_of(self.statement, self.tree)

    def save(self, path: Path | str) -> None:
        """Write the certificate to one JSON file; NotCertifiedError where nothing was proved."""
        if not self.passed:
            raise NotCertifiedError(self.verdict, payload=self.payload, frequency=self.frequency)
        write_json(
            path,
            KIND,
            FORMAT,
            {
                "claim": self.verdict,
                "assumed": list(ASSUMPTIONS),
                "statement": self.statement.to_json(),
                "tree": self.tree,
                "leaves": self.leaves,
                "sha256": self.sha256,
                "made_with": _versions(),
            },
        )

    @staticmethod
    def load(path: Path | str) -> Certificate:
        """Read a certificate back; FileFormatError where its hash does not fit. Reading is not checking."""
        data = read_json(path, KIND, (FORMAT,))
        statement = Statement.from_json(data["statement"])
        made = Certificate(statement, True, str(data["claim"]), str(data["tree"]), int(data["leaves"]))
        if made.sha256 != data.get("sha256") or made.verdict != statement.words():
            raise FileFormatError(
                "sha256",
                data.get("sha256"),
                "not that of the certificate",
                allowed=made.sha256,
                remedy="make the certificate again",
            )
        return made


def _versions() -> dict[str, str]:
    from importlib.metadata import version

    return {"python-flint": version("python-flint"), "method": "bisection in ball arithmetic, 64 bit"}
