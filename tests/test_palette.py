"""Any two colours of a figure can be distinguished with every kind of colour vision, in
grey, and from the page.

Colour vision: Machado, Oliveira and Fernandes (2009), A physiologically-based model for
simulation of color vision deficiency, IEEE Trans. Vis. Comput. Graph. 15, matrices of
severity 1.0. Distance: CIEDE2000 as in Sharma, Wu and Dalal (2005), Color Res. Appl.
30, whose first pairs check it below.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from fraclink.view._pages import DARK, LIGHT, LINES, colours

Real = NDArray[np.float64]

VISION = {
    "normal": np.eye(3),
    "protan": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deutan": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritan": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
_WHITE = np.array([0.95047, 1.0, 1.08883])
CURVES = ("ink", *(f"line-{line}" for line in LINES))
# the curves that the page of the arm shows together
ARM = (
    ("ink", "tip", "hub"),
    ("ink", "measured"),
)


def linear(colour: str) -> Real:
    """Linear red, green and blue of a hexadecimal colour."""
    values = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(
        values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4
    )


def lab(light: Real) -> Real:
    """CIE L*a*b* of linear light, white D65."""
    ratio = _XYZ @ np.clip(light, 0, 1) / _WHITE
    x, y, z = np.where(
        ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16) / 116
    )
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def distance(first: Real, second: Real) -> float:
    """CIEDE2000."""
    mean = 0.5 * (math.hypot(*first[1:]) + math.hypot(*second[1:]))
    g = 1.5 - 0.5 * math.sqrt(mean**7 / (mean**7 + 25.0**7))
    (l1, c1, h1), (l2, c2, h2) = (_polar(colour, g) for colour in (first, second))
    turn = (h2 - h1 + 180) % 360 - 180 if c1 * c2 else 0.0
    hue = 2 * math.sqrt(c1 * c2) * math.sin(math.radians(turn) / 2)
    # For hues on opposite sides the mean is taken in the direction of the published
    # formula.
    middle = h1 + turn / 2 if c1 * c2 else h1 + h2
    light, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    waves = ((0.17, 1, 30), (-0.24, 2, 0), (-0.32, 3, -6), (0.20, 4, 63))
    t = 1 - sum(size * math.cos(math.radians(k * middle - at)) for size, k, at in waves)
    spread = 60 * math.exp(-(((middle % 360 - 275) / 25) ** 2))
    turned = (
        -2
        * math.sqrt(chroma**7 / (chroma**7 + 25.0**7))
        * math.sin(math.radians(spread))
    )
    dl = (l2 - l1) / (1 + 0.015 * (light - 50) ** 2 / math.sqrt(20 + (light - 50) ** 2))
    dc, dh = (c2 - c1) / (1 + 0.045 * chroma), hue / (1 + 0.015 * chroma * t)
    return math.sqrt(dl**2 + dc**2 + dh**2 + turned * dc * dh)


def _polar(colour: Real, stretched: float) -> tuple[float, float, float]:
    light, a, b = (float(value) for value in colour)
    return (
        light,
        math.hypot(stretched * a, b),
        math.degrees(math.atan2(b, stretched * a)) % 360,
    )


@pytest.mark.parametrize("theme", [LIGHT, DARK])
@pytest.mark.parametrize("names", [CURVES, *ARM])
@pytest.mark.parametrize("vision", VISION)
def test_any_two_colours_of_a_figure_differ_for_every_eye(
    theme: int, names: tuple[str, ...], vision: str
) -> None:
    seen = [lab(VISION[vision] @ linear(colours(theme)[name])) for name in names]
    assert min(distance(a, b) for a, b in combinations(seen, 2)) >= 20.0


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_any_two_colours_of_a_figure_differ_in_grey(theme: int) -> None:
    grey = sorted(float(lab(linear(colours(theme)[name]))[0]) for name in CURVES)
    assert min(np.diff(grey)) >= 9.0
