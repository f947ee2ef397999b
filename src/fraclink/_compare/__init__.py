"""Our design and its rivals on one twin, each tuned by a stated rule, with the same inner loop and noise."""

from __future__ import annotations

from fraclink._compare.rivals import Rival
from fraclink._compare.tournament import Standing, Tournament, compare

__all__ = ["Rival", "Standing", "Tournament", "compare"]
