"""ROS 2 recordings (rosbag2 folders, .db3 and .mcap): joint states and other stamped numbers, without ROS.

The stamps are those of the messages' headers: the time at which the bag received a message is later by
whatever the computer was busy with.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from fraclink._logs.readers.parsers.column import RawColumn, check_size
from fraclink.errors import MissingExtraError

__all__ = ["read"]

_JOINT_STATE = "sensor_msgs/msg/JointState"
_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "Nm"}  # as the message's definition states them
_DEEPEST = 4


def read(path: Path) -> tuple[list[RawColumn], dict[str, str]]:
    """Columns ``topic/joint.position`` (velocity, effort) and ``topic/time`` [s] after the first stamp."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingExtraError("rosbags", "io") from error

    series: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    stamps: dict[str, list[int]] = defaultdict(list)
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        check_size(8 * reader.message_count)
        for connection, _received, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            header = getattr(message, "header", None)
            if header is None:
                continue
            numbers = (
                _joints(message) if connection.msgtype == _JOINT_STATE else _numbers(message, "", _DEEPEST)
            )
            count = len(stamps[connection.topic])
            stamps[connection.topic].append(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)
            for name, value in numbers.items():
                values = series[connection.topic][name]
                values.extend([np.nan] * (count - len(values)))  # a joint that earlier messages did not name
                values.append(value)
    return _columns(series, stamps)


def _joints(message: Any) -> dict[str, float]:
    found = {}
    for field in _UNITS:
        for joint, value in zip(message.name, getattr(message, field), strict=False):
            found[f"{joint}.{field}"] = float(value)
    return found


def _numbers(value: Any, name: str, depth: int) -> dict[str, float]:
    """The plain numbers of any stamped message, by their dotted path."""
    found: dict[str, float] = {}
    for field in getattr(value, "__dataclass_fields__", {}):
        item = getattr(value, field)
        label = f"{name}.{field}" if name else field
        if isinstance(item, (int, float)) and not isinstance(item, bool):
            found[label] = float(item)
        elif depth and field not in ("header", "__msgtype__"):
            found.update(_numbers(item, label, depth - 1))
    return found


def _columns(
    series: dict[str, dict[str, list[float]]], stamps: dict[str, list[int]]
) -> tuple[list[RawColumn], dict[str, str]]:
    columns, notes = [], {}
    for topic, times in stamps.items():
        first = min(times)
        notes[f"first stamp of {topic}"] = f"{first} ns"
        after = np.array([time - first for time in times], dtype=np.float64) * 1e-9
        # Bags are sorted by when messages were received; two that overtook each other stand reversed.
        order = np.argsort(after, kind="stable")
        columns.append(RawColumn(f"{topic}/time", "s", after[order]))
        for name, values in series[topic].items():
            padded = np.array(values + [np.nan] * (len(times) - len(values)))
            columns.append(
                RawColumn(f"{topic}/{name}", _UNITS.get(name.rsplit(".", 1)[-1], ""), padded[order])
            )
    return columns, notes
