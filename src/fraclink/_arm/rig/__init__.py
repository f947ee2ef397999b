"""The rig: one frozen object for one flexible arm, in one TOML file."""

from fraclink._arm.rig.columns import Channel, LogColumns, parse_columns
from fraclink._arm.rig.parts import DesignRequest, Encoder, Gauge, Inner, Link, Motor, Payloads
from fraclink._arm.rig.rig import Rig

__all__ = [
    "Channel",
    "DesignRequest",
    "Encoder",
    "Gauge",
    "Inner",
    "Link",
    "LogColumns",
    "Motor",
    "Payloads",
    "Rig",
    "parse_columns",
]
