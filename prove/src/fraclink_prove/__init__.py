"""Prove claims about the C files that fraclink exports, with the provers that are installed.

`fraclink export c --prove` imports this package where it is installed; fraclink itself does not need it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fraclink._export.claims import Proof
from fraclink._files import sha256_of
from fraclink._law import Law
from fraclink_prove.certificate import loop_claim
from fraclink_prove.eva import commands_claim
from fraclink_prove.rounding import rounding_claim
from fraclink_prove.step import finite_claim, slew_claim

if TYPE_CHECKING:
    from fraclink._certify import Certificate

__all__ = ["prove"]


def prove(law: Law, folder: Path, *, name: str, data: str, certificate: Certificate | None = None) -> Proof:
    """Prove what can be proved about law.h, law.c and the header `data` in `folder`; logs go to proof/ there.

    (1) commands finite and in their limits, no undefined behaviour: Frama-C Eva. (2) the other outputs
    finite, (3) the slew: law_step as an SMT problem in IEEE arithmetic, z3 or cvc5. (4) rounding for all
    time: Gappa and ball arithmetic. (5) the loop: `certificate`; nothing is claimed of the loop of a PID,
    whose plant the law does not know. A tool that is missing leaves its claim unproved and is named with its
    Debian package.
    """
    claims = (
        commands_claim(law, folder, name=name, data=data),
        finite_claim(law, folder),
        slew_claim(law, folder),
        rounding_claim(law, folder),
        *((loop_claim(law, folder, certificate),) if law.has_gauge else ()),
    )
    sources = {file: sha256_of(folder / file) for file in ("law.h", "law.c", data)}
    return Proof(law.digest, sources, claims)
