"""What a design is asked for, checked: every refusal names the field, the value, the range and the remedy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._validate import checked_between, checked_noun, checked_series, is_whole
from fraclink.errors import FieldError

if TYPE_CHECKING:
    from fraclink._arm.rig import Motor

__all__ = [
    "Request",
    "check_arm",
    "check_request",
    "checked_axis",
    "checked_natural_frequency",
    "checked_pair",
    "deg",
    "link_at",
]


def deg(angle: float) -> float:
    """Return an angle given in degrees in radians, ``x π/180``.

    Parameters
    ----------
    angle
        angle [deg], any finite number.

    >>> from fraclink._design import deg
    >>> round(deg(50), 6)
    0.872665
    """
    return math.radians(checked_between("angle", angle, -1e9, 1e9, "deg"))


@dataclass(frozen=True)
class Request:
    """A checked design request; frequencies in rad/s, angles in radians, times in seconds."""

    model: LinkModel
    motor: Motor
    low: float  # ω₀ of the heaviest payload
    high: float  # ω₀ of the lightest payload
    payloads: tuple[float, float]  # kg, (light, heavy)
    gain_crossover: float
    phase_margin: float
    margins: str
    filter_time: float | None
    filter_order: int | None
    inner_kind: str
    placement: str
    inner_pole: float
    delay_samples: int
    period: float


def check_arm(model: object, rig: object) -> None:
    """FieldError where a design is handed anything but a link and a rig, such as a fit or a file's name."""
    checked_noun("model", model, LinkModel, remedy="fit.model, or rig.model")
    checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one")


def link_at(model: LinkModel, rig: Rig, payload: float) -> LinkModel:
    """Return the link at `payload` [kg]: ω₀ ∝ m^(-1/2) from the model's own payload, else eq. (5)."""
    from dataclasses import replace

    if model.payload is not None:
        return model.at_payload(payload)
    return replace(model, natural_frequency=rig.natural_frequency(payload), payload=payload)


def checked_natural_frequency(value: object) -> float:
    """Return a link's ω₀ as a float; FieldError where it is no number that a link can have."""
    return checked_between("natural_frequency", value, 0.0, 1e6, "s^(-λ/2)", open_low=True)


def checked_axis(field: str, values: object) -> NDArray[np.float64]:
    """Return one number or a list of them as an array of shape (N,), N > 0; FieldError for anything else."""
    single = isinstance(values, int | float | np.number) and not isinstance(values, bool)
    axis = checked_series(field, [values] if single else values, remedy="give one axis of numbers")
    if axis.size == 0:
        raise FieldError(field, 0, "without values", allowed="one or more", remedy="give numbers")
    return axis


def payload_of(model: LinkModel, rig: Rig, natural_frequency: float) -> float:
    """Return the payload [kg] at which the link has `natural_frequency`: the inverse of `link_at`."""
    if model.payload is not None:
        return model.payload * (model.natural_frequency / natural_frequency) ** 2
    return rig.payloads.nominal * (rig.natural_frequency(rig.payloads.nominal) / natural_frequency) ** 2


def checked_pair(field: str, value: object, high: float, unit: str) -> tuple[float, float]:
    """Return (low, high), each in (0, high]; FieldError for anything else."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise FieldError(
            field, value, "not a pair", allowed=f"(low, high) in {unit}", remedy="give two numbers"
        )
    first = checked_between(f"{field}[0]", value[0], 0.0, high, unit, open_low=True)
    second = checked_between(f"{field}[1]", value[1], 0.0, high, unit, open_low=True)
    if first > second:
        raise FieldError(
            field,
            (first, second),
            "the wrong way round",
            allowed="low <= high",
            remedy=f"say ({second:g}, {first:g})",
        )
    return first, second


def _range(
    model: LinkModel,
    rig: Rig,
    payloads: object,
    natural_frequencies: object,
) -> tuple[float, float, tuple[float, float]]:
    """(ω₀ low, ω₀ high, payloads) from whichever of the two the user gave; else the rig's own payloads."""
    if payloads is not None and natural_frequencies is not None:
        raise FieldError(
            "natural_frequencies",
            natural_frequencies,
            "given beside payloads",
            allowed="one of the two",
            remedy="leave one out",
        )
    if natural_frequencies is not None:
        low, high = checked_pair("natural_frequencies", natural_frequencies, 1e4, "s^(-λ/2)")
        return low, high, (payload_of(model, rig, high), payload_of(model, rig, low))
    if payloads is None:
        payloads = (rig.payloads.low, rig.payloads.high)
    light, heavy = checked_pair("payloads", payloads, 1e4, "kg")
    return (
        link_at(model, rig, heavy).natural_frequency,
        link_at(model, rig, light).natural_frequency,
        (light, heavy),
    )


def _phase_margin(value: object) -> float:
    number = checked_between(
        "phase_margin", value, 0.0, 1e9, "rad", open_low=True, remedy="give an angle between 0 and π"
    )
    if number >= math.pi:
        raise FieldError(
            "phase_margin",
            number,
            "more than half a turn",
            allowed="> 0 and < 3.14159 rad",
            remedy=f"if {number:g} are degrees, write deg({number:g})",
        )
    return number


def _choice(field: str, value: object, allowed: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in allowed:
        raise FieldError(
            field, value, "not known", allowed=" or ".join(map(repr, allowed)), remedy=f"say {allowed[0]!r}"
        )
    return value


def _filter_order(value: object) -> int | None:
    if value is None:
        return None
    if not is_whole(value, 1, 2):
        raise FieldError(
            "filter_order", value, "not 1 or 2", allowed="1 or 2", remedy="n = 1 for β < 1, else 2"
        )
    return int(value)  # type: ignore[call-overload, no-any-return]


def check_request(
    model: LinkModel,
    rig: Rig,
    *,
    payloads: object,
    natural_frequencies: object,
    gain_crossover: object,
    phase_margin: object,
    margins: object,
    filter_time: object,
    filter_order: object,
    inner: object,
    placement: object,
) -> Request:
    """Return the request with every number checked (entries B25–B44 of the list of bad inputs)."""
    low, high, masses = _range(model, rig, payloads, natural_frequencies)
    checked_between(
        "order", model.order, 1.0, 2.0, "(λ)", open_low=True, remedy="λ is 2 for a classical link"
    )
    kind = _choice("margins", margins, ("loop", "ideal"))
    if kind == "ideal" and low <= 1.0:
        raise FieldError(
            "natural_frequencies",
            low,
            "not above one (Theorem 2 needs ω₀ > 1)",
            allowed="> 1 s^(-λ/2)",
            remedy='say margins="loop", which checks the whole range itself',
        )
    period = checked_between("period", rig.period, 0.0, 10.0, "s", open_low=True)
    crossover = checked_between("gain_crossover", gain_crossover, 0.0, 1e6, "rad/s", open_low=True)
    _check_bandwidth(crossover, kind, rig, period)
    return Request(
        model=model,
        motor=rig.motor,
        low=low,
        high=high,
        payloads=masses,
        gain_crossover=crossover,
        phase_margin=_phase_margin(phase_margin),
        margins=kind,
        filter_time=None
        if filter_time is None
        else checked_between("filter_time", filter_time, 0.0, 1e3, "s"),
        filter_order=_filter_order(filter_order),
        inner_kind=_choice("inner", inner, ("ideal", "sampled")),
        placement=_choice("placement", placement, ("tustin", "direct")),
        inner_pole=checked_between("inner.pole", rig.inner.pole, 0.0, 1e6, "rad/s", open_low=True),
        delay_samples=int(rig.inner.delay_samples),
        period=period,
    )


def _check_bandwidth(crossover: float, kind: str, rig: Rig, period: float) -> None:
    """B38: above Nyquist nothing crosses; above the motor loop's pole its own lag alone exceeds 90°."""
    if kind == "ideal":
        return
    nyquist = math.pi / period
    if crossover >= nyquist:
        raise FieldError(
            "gain_crossover",
            crossover,
            "above the Nyquist frequency",
            allowed=f"< {nyquist:.6g} rad/s",
            remedy="ask for a slower loop or sample faster",
        )
    if crossover >= rig.inner.pole:
        raise FieldError(
            "gain_crossover",
            crossover,
            "above the motor loop's bandwidth",
            allowed=f"< {rig.inner.pole:.6g} rad/s",
            remedy="ask for a slower loop or a faster motor loop",
        )
