"""Out of the building: C, MATLAB and FMU files of a law, and the replay of logs through them."""

from __future__ import annotations

from fraclink.export.c import export_c

__all__ = ["export_c"]
