"""Resolution and range of double precision."""

from __future__ import annotations

import math
import sys

EPSILON = sys.float_info.epsilon
# Rounding of a sum relative to the moduli of its terms: six terms of three roundings
# each, or the same numbers added in another sequence, stay below half of it.
ROUNDING = 64 * EPSILON
# How far that rounding can split a double zero. Also the relative step of an
# iteration of second order after which its error is below that rounding.
BLUR = math.sqrt(ROUNDING)
# The step of a central difference that loses as much to rounding as to curvature.
DIFFERENCE_STEP = math.cbrt(EPSILON)
# [rad, or relative] A computed zero closer to an axis than this lies on it, and a
# response closer to a value than this equals it: `ROUNDING`, with two digits lost on
# the way.
RESOLUTION = 1e-12
# Points of the log-plane (ln s) closer than this are one point: a pole and the zero
# that cancels it, a pole and the axis, two neighbours of a grid. Coefficients with ten
# digits determine a zero to that accuracy.
COINCIDENT = 1e-9
# Twice the rounds in which an iteration gains all bits of a double, one bit in each
# round: bisection, or Newton's method at a double zero.
ROUNDS = 2 * sys.float_info.mant_dig
# e-folds after which an exponential is lost in rounding
FOLDS = -math.log(EPSILON)
# ln of the largest double
LARGEST_LOG = math.log(sys.float_info.max)
