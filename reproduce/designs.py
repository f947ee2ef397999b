"""The controllers that the comparison is about: printed, corrected, and designed for
the loop that runs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fraclink._arm.controller import Controller
from fraclink._arm.link import LinkModel
from fraclink._arm.motor_loop import MotorLoop
from fraclink._arm.rig import Rig
from fraclink._design import Design, design
from fraclink._design.assess import PRINTED

__all__ = [
    "CROSSOVER",
    "MARGIN_DEG",
    "ORDER",
    "SMALL",
    "Pair",
    "carried_out",
    "corrected",
    "in_loop",
    "matched_integer",
    "measured",
    "printed",
    "printed_design",
    "procedure",
    "readings",
    "rescaled",
    "rig",
    "unfiltered",
]

ORDER = 1.92  # λ of Tables 2 and 3
CROSSOVER, MARGIN_DEG = 16.0, 70.0  # rad/s and °, asked for in section 7.1
SMALL = (0.016, 0.008)  # kg, section 7.2
_PRINTED = (9.42, 11.54, 14.14)  # ϖ of Table 1: minimal, nominal, maximal


@dataclass(frozen=True)
class Pair:
    """A controller from the fractional model, C, and its rival from the integer model,
    C'.
    """

    name: str
    fractional: Controller
    integer: Controller


@cache
def rig() -> Rig:
    """The paper's rig, with the measured stiffness."""
    return Rig.named("paper-2023")


def link(payload: float, order: float = ORDER) -> LinkModel:
    """The link at `payload` [kg] by eq. (5) with the measured c = 1.56 N·m."""
    arm = rig()
    return LinkModel(
        arm.link.stiffness, arm.natural_frequency(payload), order=order, payload=payload
    )


def carried_out(
    low: float,
    high: float,
    nominal: float,
    *,
    crossover: float = CROSSOVER,
    margin: float = math.radians(MARGIN_DEG),
    **options: object,
) -> Design:
    """Section 6 for ω₀ from `low` to `high`: M(s) = 1, `crossover` [rad/s] and `margin`
    [rad] at its ends.
    """
    model = LinkModel(
        rig().link.stiffness, nominal, order=ORDER, payload=rig().payloads.nominal
    )
    return design(
        model,
        rig(),
        natural_frequencies=(low, high),
        gain_crossover=crossover,
        phase_margin=margin,
        margins="ideal",
        procedure="published",
        law=False,
        **options,  # type: ignore[arg-type]
    )


@cache
def printed_design() -> Design:
    """Section 6 applied to the printed inputs of Table 1, without a filter."""
    return carried_out(_PRINTED[0], _PRINTED[2], _PRINTED[1], filter_time=0.0)


@cache
def measured_design() -> Design:
    """Section 6 applied to eq. (5) with c = 1.56 N·m at 40, 30 and 20 g, without a
    filter.
    """
    arm = rig()
    return carried_out(
        *(arm.natural_frequency(m) for m in (0.040, 0.020, 0.030)), filter_time=0.0
    )


@cache
def rule_filter(which: str, order: int) -> float:
    """δ [s] of the paper's 10 % rule for the "printed" or the "measured" inputs."""
    arm = rig()
    ends = (
        _PRINTED
        if which == "printed"
        else tuple(arm.natural_frequency(m) for m in (0.040, 0.030, 0.020))
    )
    return carried_out(
        ends[0], ends[2], ends[1], filter_order=order
    ).controller.filter_time


def matched_integer(designed: Design, nominal: float) -> tuple[float, float]:
    """(k_d', β') that give λ = 2 the crossing and the margin of `designed` at ϖ =
    `nominal`, from (42).

    (ω_c² − ϖ²)/ϖ² is |1/G| above the resonance, and the phase of −L is β'π/2.
    """
    found = designed.at_frequency(nominal)
    crossing = max(found.gain_crossings, key=lambda item: item.frequency)
    order = 2.0 * crossing.phase_margin / math.pi
    gain = (crossing.frequency**2 - nominal**2) / (
        nominal**2 * crossing.frequency**order
    )
    return gain, order


def measured() -> tuple[Design, float]:
    """The design for c = 1.56 N·m and its nominal ϖ."""
    return measured_design(), rig().natural_frequency(0.030)


@cache
def printed() -> Pair:
    """(58) and (59) as they are printed."""
    pair = (_on_link(PRINTED["(58)"], ORDER), _on_link(PRINTED["(59)"], 2.0))
    return Pair("printed (58), (59)", *pair)


@cache
def rescaled() -> Pair:
    """The printed gains with δ = 0.0016 s, the only power-of-ten reading of 0.16 that
    keeps the 10 % rule.
    """
    return _with_filter("printed gains, δ = 0.0016 s", printed(), 0.0016)


def unfiltered(pair: Pair, name: str) -> Pair:
    """The pair without its filter."""
    return _with_filter(name, pair, 0.0)


def _with_filter(name: str, pair: Pair, time: float) -> Pair:
    changed = (
        replace(item, filter_time=time) for item in (pair.fractional, pair.integer)
    )
    return Pair(name, *changed)


@cache
def readings() -> tuple[Pair, ...]:
    """Every way to read the paper's two controllers: as printed, and as its own
    procedure gives them.
    """
    return (
        Pair(
            "(58), (59) as printed, δ = 0.16 s", printed().fractional, printed().integer
        ),
        unfiltered(printed(), "printed gains, no filter"),
        rescaled(),
        unfiltered(corrected(), "procedure carried out, no filter"),
        Pair(
            "procedure, its own 10 % filter",
            corrected().fractional,
            corrected().integer,
        ),
    )


@cache
def procedure() -> Pair:
    """Section 6 carried out on the printed inputs of Table 1, with the filter of its 10
    % rule, n = 2.
    """
    designed, delta = printed_design(), rule_filter("printed", 2)
    gain, order = matched_integer(designed, _PRINTED[1])
    base = _controller(
        designed.controller.gain, designed.controller.order, delta, 2, ORDER
    )
    return Pair("procedure from Table 1", base, _controller(gain, order, delta, 2, 2.0))


@cache
def corrected() -> Pair:
    """Section 6 carried out with c = 1.56 N·m and the filter of its own 10 % rule, n =
    2.
    """
    designed, nominal = measured()
    delta = rule_filter("measured", 2)
    gain, order = matched_integer(designed, nominal)
    base = _controller(
        designed.controller.gain, designed.controller.order, delta, 2, ORDER
    )
    return Pair("corrected", base, _controller(gain, order, delta, 2, 2.0))


@cache
def in_loop() -> Pair:
    """Designed on the loop that runs (12 rad/s, 50°, 10 % rule), and λ = 2 matched at
    30 g in that loop.
    """
    base = design(
        link(0.030),
        rig(),
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=math.radians(50.0),
        procedure="published",
    )
    return Pair("in the loop", base.controller, _matched_in_loop(base))


def _matched_in_loop(designed: Design) -> Controller:
    """The controller that gives the loop with λ = 2 the same crossing and phase at 30
    g.
    """
    nominal = designed.natural_frequency(0.030)
    crossing = max(designed.at(0.030).gain_crossings, key=lambda item: item.frequency)
    s = 1j * crossing.frequency
    fractional = nominal**2 / (np.exp(ORDER * np.log(s)) + nominal**2)
    integer = nominal**2 / (s**2 + nominal**2 + 0j)
    # (jω)^β carries both: its phase takes up the difference of the links' phases.
    shift = np.angle(fractional / integer)
    order = (
        designed.controller.order
        + 2.0 * float(np.mod(shift + math.pi, 2 * math.pi) - math.pi) / math.pi
    )
    gain = (
        designed.controller.gain
        * abs(fractional / integer)
        * crossing.frequency ** (designed.controller.order - order)
    )
    return replace(
        designed.controller, gain=float(gain), order=order, link=link(0.030, 2.0)
    )


def _controller(
    gain: float, order: float, delta: float, n: int, link_order: float
) -> Controller:
    return _on_link(
        Controller(gain=gain, order=order, filter_time=delta, filter_order=n),
        link_order,
    )


def _on_link(controller: Controller, link_order: float) -> Controller:
    """`controller` with the link, the motor loop and the period of the paper's rig."""
    inner = MotorLoop(pole=80.0, delay_samples=1)
    return replace(
        controller, link=link(0.030, link_order), inner=inner, period=rig().period
    )
