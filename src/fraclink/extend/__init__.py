"""Names for those who build on the core: parts of a rig, structures, the loop, limits,
and the results that the functions of `fraclink` return.
"""

from __future__ import annotations

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
