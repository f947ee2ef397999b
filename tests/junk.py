"""Values that scripts pass by mistake, and correct ones to combine them with."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import fraclink as fl
import fracsys
from fraclink import Experiment, LinkModel
from fraclink.errors import FraclinkError
from fraclink.extend import geared, simulated_torque

Call = tuple[Callable[..., object], Callable[[], Mapping[str, Any]]]

RIG = fl.Rig.named("paper-2023")
LINK = LinkModel(
    stiffness=1.56, natural_frequency=11.0, order=1.92, damping=0.1, payload=0.030
)
SYSTEM = 100 / (fracsys.s**1.92 + 100)
TIME = 0.004 * np.arange(301)
ANGLE = 0.1 * np.sin(7.0 * TIME)
FREQUENCY = np.geomspace(1.0, 100.0, 40)

JUNK: tuple[object, ...] = (
    *(
        None,
        "12",
        "",
        "\x00",
        b"x",
        1j,
        object(),
        print,
        Path("log.csv"),
        RIG,
        LINK,
        {},
        {"a": 1.0},
    ),
    *(
        math.nan,
        math.inf,
        -math.inf,
        -1.0,
        0.0,
        -0.0,
        5e-324,
        1e308,
        1e12,
        10**400,
        -(10**400),
        2**64,
    ),
    *(
        [1.0],
        (1.0,),
        (1.0, 2.0, 3.0),
        (math.nan, 2.0),
        ("a", "b"),
        [None],
        [[1.0], [1.0, 2.0]],
    ),
    *(np.array([]), np.array([1.0, math.nan]), np.ones((3, 3)), np.float64(math.nan)),
)

# A quarter of the BMP, combining and direction characters, and the ends of planes. They
# are listed because for an alphabet given by categories, hypothesis builds a table of
# all of Unicode, which takes 200 MB if it is not cached.
_ENDS = (
    (0, 0x3000),
    (0xE000, 0xE010),
    (0xFE00, 0x10010),
    (0x1F5F0, 0x1F610),
    (0x10FFF0, 0x110000),
)
CHARACTERS = "".join(chr(code) for ends in _ENDS for code in range(*ends))


@functools.cache
def log() -> Experiment:
    noise = np.random.default_rng(1).normal(0.0, 0.01, ANGLE.size)
    return Experiment(
        0.004, ANGLE, simulated_torque(LINK, ANGLE, 0.004) + noise, payload=0.030
    )


@functools.cache
def design() -> fl.Design:
    request = {
        "payloads": (0.020, 0.040),
        "gain_crossover": 12.0,
        "phase_margin": fl.deg(50),
    }
    return fl.design(LINK, RIG, **request, filter_time=0.0)


@functools.cache
def law() -> fl.Law:
    return fl.discretize(design().controller, RIG.period)


@functools.cache
def twin() -> fl.Twin:
    return fl.Twin.from_rig(geared(RIG))


def fields_of(noun: object) -> dict[str, Any]:
    """The constructor arguments of a frozen object."""
    return {
        field.name: getattr(noun, field.name)
        for field in dataclasses.fields(noun)
        if field.init
    }  # type: ignore[arg-type]


def take_or_refuse(call: Call, field: str, values: Iterable[object] = JUNK) -> None:
    """Pass every value as `field`: the call works, or raises an error of fraclink with
    one line.
    """
    function, usual = call
    for value in values:
        try:
            function(**{**usual(), field: value})
        except FraclinkError as error:
            assert "\n" not in str(error)
            assert len(str(error)) < 600
