"""Frequency responses as small rational functions, discrete or continuous, with the achieved error."""

from __future__ import annotations

from fraclink._systems.rational.approximation import RationalApproximation, approximate
from fraclink._systems.rational.discrete import fit_discrete
from fraclink._systems.rational.parallel import DiscreteRational

__all__ = ["DiscreteRational", "RationalApproximation", "approximate", "fit_discrete"]
