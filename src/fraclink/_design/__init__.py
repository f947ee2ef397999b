"""Design of the outer controller: a table of requirements, one solver, and the
procedure of section 6.
"""

from __future__ import annotations

from fraclink._design.procedure import design
from fraclink._law.design import Design, Requirement, Specification, deg

__all__ = [
    "Design",
    "Requirement",
    "Specification",
    "deg",
    "design",
]
