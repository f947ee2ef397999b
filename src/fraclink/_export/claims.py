"""The claims about an exported law, each proved or not.

The provers themselves are a package of their own, `fraclink_prove`; reading a proof
needs only this module.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from fraclink._files import Saved, document
from fraclink._law import Law

__all__ = ["Claim", "Proof", "claims_text"]


Status = Literal["proved", "failed", "not proved"]


@dataclass(frozen=True)
class Claim:
    """One statement about the exported files, and whether it was proved.

    Attributes
    ----------
    name
        "outputs", "finite", "slew", "rounding" or "loop".
    statement
        what is proved where `status` is "proved", in words and numbers.
    status
        "proved"; "failed": a tool found that it does not hold; "not proved": nothing
        decided it.
    reason
        why it is not proved: the alarm, the counterexample, the missing tool with its
        Debian package.
    tools
        the tools that decided it, with versions.
    logs
        files in the folder that document the decision, and their SHA-256.
    """

    name: str
    statement: str
    status: Status
    reason: str = ""
    tools: tuple[str, ...] = ()
    logs: tuple[tuple[str, str], ...] = ()


@document("proof")
@dataclass(frozen=True)
class Proof(Saved):
    """The claims about one exported folder.

    Attributes
    ----------
    law
        SHA-256 of the law's parameter block.
    sources
        SHA-256 of law.h, law.c and the header of coefficients: the proof is about these
        bytes.
    claims
        every claim that was tried.
    """

    law: str
    sources: Mapping[str, str]
    claims: tuple[Claim, ...]

    @property
    def passed(self) -> bool:
        """Whether every claim is proved."""
        # An open claim is neither a failure of the law nor a proof of it: the whole is
        # only as good as its worst part.
        return all(claim.status == "proved" for claim in self.claims)

    def __getitem__(self, name: str) -> Claim:
        return next(claim for claim in self.claims if claim.name == name)

    def __str__(self) -> str:
        return "\n".join(
            f"{claim.status}: {claim.statement}"
            + (f" [{claim.reason}]" if claim.reason else "")
            for claim in self.claims
        )


NOT_CLAIMED = """\
Anything about the compiler; about a motor loop that is not the one designed for; about Coulomb friction,
modes of the link that nothing above names, saturation, a payload that changes in a move (simulated only);
about the physical robot.
"""


NOT_CLAIMED_OF_PID = """\
Anything about the compiler; about the plant and the stability of its loop, which the tuning computes and
does not prove; about the rounding of the integral.
"""


def claims_text(law: Law, proof: Proof | None) -> str:
    """Return the sections "Claimed" and "Not claimed" of README.md."""
    not_claimed = NOT_CLAIMED if law.has_gauge else NOT_CLAIMED_OF_PID
    preamble = "For this `law.c`, compiled as ISO C99 without fast-math and with contraction off:"
    if proof is None:
        voltage = (
            f" and `voltage` within ±{law.motor_loop.voltage_limit:g} V"
            if law.motor_loop is not None
            else ""
        )
        claimed = (
            f"{preamble} whatever the inputs (NaN and\n"
            "infinities among them) and whatever the state memory holds, no undefined behaviour, both\n"
            f"commands finite, `motor_reference` within ±{law.limits.motor_limit:.6g} rad{voltage}.\n"
            "This was proved for the designs of fraclink's own tests, not for this one: `fraclink export c\n"
            "... --prove` proves it for this one, and more.\n"
        )
        stability = (
            "The stability of the loop, which the design computes.\n"
            if law.has_gauge
            else ""
        )
        return f"## Claimed\n{claimed}\n## Not claimed\n{not_claimed}{stability}"
    proved = [claim for claim in proof.claims if claim.status == "proved"]
    rest = [claim for claim in proof.claims if claim.status != "proved"]
    # Hashes are cut to 12 digits, 48 bits, enough to tell two logs apart; proof.json
    # has the full hashes.
    text = (
        f"## Proved\n{preamble}\n\n" + "\n".join(map(_proved, proved)) if proved else ""
    )
    if rest:
        text += "\n\n## Not proved\n" + "\n".join(_unproved(claim) for claim in rest)
    closing = "`proof.json` lists the tools and the hashes of all files named here."
    return f"{text.strip()}\n\n{closing}\n\n## Not claimed\n{not_claimed}"


def _proved(claim: Claim) -> str:
    logs = ", ".join(f"`{file}` {digest[:12]}" for file, digest in claim.logs)
    return _item(f"{claim.statement}. ({', '.join(claim.tools)}: {logs})")


def _unproved(claim: Claim) -> str:
    word = "does not hold" if claim.status == "failed" else "not proved"
    return _item(f"{claim.statement}: {word}. {claim.reason}.")


def _item(text: str) -> str:
    return textwrap.fill(
        text,
        105,
        initial_indent="- ",
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
