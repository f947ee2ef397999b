"""What double precision tells apart, and how far it reaches."""

from __future__ import annotations

import math
import sys

EPSILON = sys.float_info.epsilon
# Rounding of a sum relative to the moduli of its terms: six terms of three roundings
# each, or the same numbers added in another sequence, stay below half of it.
ROUNDING = 64 * EPSILON
# Where that rounding leaves the two halves of a double zero. It is also the relative
# step of an iteration of second order after which the error is that rounding.
BLUR = math.sqrt(ROUNDING)
# The step of a central difference that loses as much to rounding as to curvature.
DIFFERENCE_STEP = math.cbrt(EPSILON)
# [rad, or relative] A computed zero this far from an axis lies on it, and a response
# this close to a value has it: rounding, with two digits lost on the way.
RESOLUTION = 1e-12
# Points of the log-plane (ln s) closer than this are one point: a pole and the zero
# that cancels it, a pole and the axis, two neighbours of a grid. Coefficients written
# with ten digits place a zero as well as that.
COINCIDENT = 1e-9
# Rounds after which an iteration has gained every bit of a double twice over, one in a
# round: bisection, and Newton's method at a multiple zero.
ROUNDS = 2 * sys.float_info.mant_dig
# e-folds after which an exponential is lost in rounding
FOLDS = -math.log(EPSILON)
# ln of the largest double
LARGEST_LOG = math.log(sys.float_info.max)
