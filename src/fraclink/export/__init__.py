"""Out of the building: C, MATLAB and FMU files of a law, and the replay of logs through them."""

from __future__ import annotations

from fraclink.export.c import export_c
from fraclink.export.fmu import export_fmu
from fraclink.export.matlab import export_matlab
from fraclink.export.replay import Replay, replay, replay_log

__all__ = ["Replay", "export_c", "export_fmu", "export_matlab", "replay", "replay_log"]
