"""Many runs and their joint result: rivals, varied arms, faults, the study of a
log.

A campaign is one law on up to a million arms; a seed gives the same result on any
machine.
"""

from __future__ import annotations

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
