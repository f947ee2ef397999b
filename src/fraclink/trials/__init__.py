"""Many runs and what they say together: rivals, arms that differ, faults, the study of
one log.

A campaign is one law on a million arms, resumable, the same for a seed on any machine.
"""

from __future__ import annotations

from pathlib import Path

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(
    __name__, Path(__file__).with_suffix(".pyi")
)
