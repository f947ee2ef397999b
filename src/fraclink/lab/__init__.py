"""The law in real time, with an arm or with two Python functions; and the tuning of an
arm.

The loop is C code with absolute deadlines; it runs law.c, the file that is simulated
and exported. It does not judge transmission faults: a lost sample is NaN and a missed
period is a jump of the tick, so that the guards of the law decide, and a record replays
to the last bit.
"""

from __future__ import annotations

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
