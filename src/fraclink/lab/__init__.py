"""The law in real time, around an arm or two functions of Python; an arm tuned over it.

The loop is C on absolute deadlines; what it runs is law.c, the file that is simulated
and exported. It does not judge what happens on the way to the arm: a sample that did
not come is NaN and a missed period is a jump of the tick, so that the law's own guards
decide, and a record replays to the last bit.
"""

from __future__ import annotations

from pathlib import Path

from fracsys._public import public_names

__getattr__, __dir__, __all__ = public_names(
    __name__, Path(__file__).with_suffix(".pyi")
)
