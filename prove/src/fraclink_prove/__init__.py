"""Prove claims about the C files exported by fraclink, with the installed provers.

`fraclink export c --prove` imports this package where it is installed; fraclink itself
does not need it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fraclink._export.claims import Claim, Proof
from fraclink._files import sha256_of
from fraclink._law import Law
from fraclink_prove.eva import commands_claim
from fraclink_prove.rounding import rounding_claim
from fraclink_prove.step import finite_claim, slew_claim

if TYPE_CHECKING:
    from fraclink._certify import Certificate

__all__ = ["prove"]


def prove(
    law: Law,
    folder: Path,
    *,
    certificate: Certificate | None = None,
) -> Proof:
    """Prove what can be proved about law.h, law.c and law_data.h in `folder`; logs go to
    proof/ there.

    (1) commands finite and in their limits, no undefined behaviour: Frama-C Eva. (2)
    the other outputs finite, (3) the slew: law_step as an SMT problem in IEEE
    arithmetic, z3 or cvc5. (4) rounding for all time: Gappa and ball arithmetic. (5)
    the loop: `certificate`; nothing is claimed of the loop of a PID, whose plant the
    law does not know. A tool that is missing leaves its claim unproved and is named
    with its Debian package.
    """
    claims = (
        commands_claim(law, folder),
        finite_claim(law, folder),
        slew_claim(law, folder),
        rounding_claim(law, folder),
        *((loop_claim(law, folder, certificate),) if law.has_gauge else ()),
    )
    sources = {
        file: sha256_of(folder / file) for file in ("law.h", "law.c", "law_data.h")
    }
    return Proof(law.digest, sources, claims)


def loop_claim(law: Law, folder: Path, certificate: Certificate | None) -> Claim:
    """State what `certificate` proves; it must be about the block that is exported, to
    the last bit.
    """
    claim = Claim(
        "loop", "the sampled loop is stable with a distance from -1", "not proved"
    )
    if certificate is None:
        reason = (
            "no certificate was given (`fraclink certify` makes one from the design)"
        )
        return replace(claim, reason=reason)
    if not certificate.passed:
        return replace(claim, status="failed", reason=certificate.verdict)
    # By the hash of the block instead of the design: single precision has another hash,
    # and needs another proof.
    if certificate.statement.digest != law.digest:
        made_for = certificate.statement.digest[:12]
        return replace(
            claim,
            reason=f"the certificate is about the law {made_for}, not about this one",
        )
    path = folder / "proof" / "certificate.json"
    path.parent.mkdir(exist_ok=True)
    certificate.save(path)
    return replace(
        claim,
        status="proved",
        statement=certificate.verdict.removesuffix("."),
        tools=("fraclink._certify", "branch and bound over discs"),
        logs=(("proof/certificate.json", sha256_of(path)),),
    )
