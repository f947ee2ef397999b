"""The statements the paper makes in words, each with the measurement that decides it,
under the names of claims.toml.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from reproduce.evidence_margins import MARGINS
from reproduce.evidence_model import MODEL
from reproduce.evidence_theorems import THEOREMS
from reproduce.evidence_tracking import TRACKING
from reproduce.judged import Evidence
from reproduce.published import Published

__all__ = ["EVIDENCE"]

EVIDENCE: Mapping[str, Callable[[Published], Evidence]] = {
    **MODEL,
    **THEOREMS,
    **MARGINS,
    **TRACKING,
}
