"""The certificate of the closed loop, where one was given for the very law that is exported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fraclink._export.claims import Claim
from fraclink._files import sha256_of
from fraclink._law import Law

if TYPE_CHECKING:
    from fraclink._certify import Certificate

__all__ = ["loop_claim"]


def loop_claim(law: Law, folder: Path, certificate: Certificate | None) -> Claim:
    """State what `certificate` proves; it must be about the block that is exported, to the last bit."""
    claim = Claim("loop", "the sampled loop is stable with a distance from -1", "not proved")
    if certificate is None:
        return replace(claim, reason="no certificate was given (fraclink._certify makes one from the design)")
    if not certificate.passed:
        return replace(claim, status="failed", reason=certificate.verdict)
    # By the hash of the block and not by the design: single precision has another one, and another proof.
    if certificate.statement.digest != law.digest:
        made_for = certificate.statement.digest[:12]
        return replace(claim, reason=f"the certificate is about the law {made_for}, not about this one")
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
