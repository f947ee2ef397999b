"""Numbers as people read them: few digits, a real minus, powers of ten."""

from __future__ import annotations

import math

__all__ = ["degrees", "grams", "milli", "number", "quantity", "sentence", "uncertain"]


def number(value: float | None, digits: int = 4) -> str:
    """Return `value` with `digits` significant digits.

    >>> number(-0.00068712), number(13399.771, 8), number(float("inf")), number(None)
    ('−6.871×10⁻⁴', '13399.771', '∞', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{digits}g}"
    mantissa, _, exponent = text.partition("e")
    small = 0 < abs(value) < 1e-3
    if small and not exponent:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    mantissa = mantissa.replace("-", "−")
    if not exponent:
        return mantissa
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{mantissa}×10{str(int(exponent)).translate(_RAISED)}"


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def uncertain(value: float, error: float | None) -> str:
    """Return `value ± error`, both with the digits that the error leaves meaningful.

    >>> uncertain(1.918734, 0.000213), uncertain(10.02, None)
    ('1.91873 ± 0.00021', '10.02')
    >>> uncertain(116.0, 145.0)
    'undetermined'
    """
    if error is None or not math.isfinite(error) or error <= 0:
        return number(value, 5)
    if error >= abs(value):
        return "undetermined"
    places = max(0, 1 - math.floor(math.log10(error)))
    if places > 9 or abs(value) >= 1e6:
        return f"{number(value, 5)} ± {number(error, 2)}"
    return f"{value:.{places}f} ± {error:.{places}f}".replace("-", "−")


def grams(payload: float | None) -> str:
    """A payload in grams.

    >>> grams(0.0305)
    '30.5 g'
    """
    return "–" if payload is None else f"{number(1e3 * payload)} g"


def milli(value: float | None, places: int = 1) -> str:
    """A value in thousandths, with as many decimal places as matter beside its neighbours in a column.

    >>> milli(0.0633), milli(-0.0000519, 2), milli(-1e-9, 2)
    ('63.3', '−0.05', '0.00')
    """
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{1e3 * value:.{places}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def sentence(text: str) -> str:
    """`text` with a capital and a full stop.

    >>> sentence("measure it"), sentence("link.stiffness = 1.56 contradicts 3EI/L")
    ('Measure it.', 'link.stiffness = 1.56 contradicts 3EI/L.')
    """
    text = text.strip()
    first = text.partition(" ")[0]
    # The name of a field is written as the file writes it, and ours without a capital.
    named = "_" in first or "." in first.rstrip(".") or first == "fraclink"
    return (
        (text[:1] if named else text[:1].upper())
        + text[1:]
        + ("" if text.endswith((".", "?", "!", ":")) or not text else ".")
    )


def degrees(angle: float | None) -> str:
    """An angle in degrees.

    >>> degrees(math.pi / 6)
    '30.0°'
    """
    return "–" if angle is None or math.isnan(angle) else f"{math.degrees(angle):.1f}°".replace("-", "−")


def quantity(value: float | None, unit: str) -> str:
    """A value with its unit; angles in degrees.

    >>> quantity(12.0, "rad/s"), quantity(math.pi / 4, "rad")
    ('12 rad/s', '45.0°')
    """
    return degrees(value) if unit == "rad" else f"{number(value)} {unit}".strip()
