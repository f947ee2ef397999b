"""The claims of an export's README, made from what was proved."""

from __future__ import annotations

import textwrap

from fraclink._export.proof.claim import Claim, Proof
from fraclink._law import Law

__all__ = ["claims_text"]

NOT_CLAIMED = """\
Anything about the compiler; about a motor loop that is not the one designed for; about Coulomb friction,
modes above the first, saturation, a payload that changes in a move (simulated only); about the physical
robot.
"""


def claims_text(law: Law, proof: Proof | None) -> str:
    """Return the sections "Claimed" and "Not claimed" of README.md."""
    built = "For this `law.c`, compiled as ISO C99 without fast-math and with contraction off:"
    if proof is None:
        voltage = f" and `voltage` within ±{law.drive.voltage_limit:g} V" if law.drive is not None else ""
        claimed = (
            f"{built} whatever the inputs (NaN and\n"
            "infinities among them) and whatever the state memory holds, no undefined behaviour, both\n"
            f"commands finite, `motor_reference` within ±{law.limits.motor_limit:.6g} rad{voltage}.\n"
            "This was proved for the designs of fraclink's own tests, not for this one: `fraclink export c\n"
            "... --prove` proves it for this one, and more.\n"
        )
        stability = "Stability of the loop is the design's matter.\n"
        return f"## Claimed\n{claimed}\n## Not claimed\n{NOT_CLAIMED}{stability}"
    proved = [claim for claim in proof.claims if claim.status == "proved"]
    rest = [claim for claim in proof.claims if claim.status != "proved"]
    text = f"## Proved\n{built}\n\n" + "\n".join(map(_proved, proved)) if proved else ""
    if rest:
        text += "\n\n## Not proved\n" + "\n".join(_open(claim) for claim in rest)
    listed = "`proof.json` lists the tools and the hashes of all files named here."
    return f"{text.strip()}\n\n{listed}\n\n## Not claimed\n{NOT_CLAIMED}"


def _proved(claim: Claim) -> str:
    shown = ", ".join(f"`{file}` {digest[:12]}" for file, digest in claim.logs)
    return _item(f"{claim.statement}. ({', '.join(claim.tools)}: {shown})")


def _open(claim: Claim) -> str:
    word = "does not hold" if claim.status == "failed" else "not proved"
    return _item(f"{claim.statement}: {word}. {claim.reason}.")


def _item(text: str) -> str:
    return textwrap.fill(
        text, 105, initial_indent="- ", subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
