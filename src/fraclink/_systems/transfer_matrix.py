"""Matrices of fractional transfer functions: systems with several inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._systems.fractional import FractionalTransferFunction
from fraclink._systems.terms import Complexes
from fraclink.errors import FieldError

# of the expansion of a determinant in functions, whose terms grow like the factorial
_LARGEST_SIZE = 6
Entries = Sequence[Sequence[FractionalTransferFunction | float]]


@dataclass(frozen=True, repr=False)
class TransferMatrix:
    """A matrix of fractional transfer functions: row i, column k leads from input k to
    output i.

    `@` multiplies matrices, `+` and `−` add them, `*` scales by a function or a number.
    Numbers count as functions: `TransferMatrix([[1 / s, 0], [2, 1 / (s + 1)]])`.

    Attributes
    ----------
    entries
        Rows of functions, of equal lengths; numbers are taken for constant functions.

    Raises
    ------
    FieldError
        No entries, rows of different lengths, an entry that is no function and no
        number.

    Examples
    --------
    >>> from fraclink._systems.fractional import s
    >>> G = TransferMatrix([[1 / s**0.5, 0], [2, 1 / (s + 1)]])
    >>> G(4.0).real
    array([[0.5, 0. ],
           [2. , 0.2]])
    """

    entries: tuple[tuple[FractionalTransferFunction, ...], ...]

    __made_by__ = "fraclink.TransferMatrix([[g11, g12], [g21, g22]])"
    __array_ufunc__ = None  # numpy must hand `array @ G` to us

    def __init__(self, entries: Entries) -> None:
        given: Any = entries
        rows = given if isinstance(given, (list, tuple)) else ()
        if not rows or not all(isinstance(row, (list, tuple)) and row for row in rows):
            raise _refused(entries, "not rows of transfer functions")
        if len({len(row) for row in rows}) > 1:
            raise _refused([len(row) for row in rows], "rows of different lengths")
        object.__setattr__(
            self, "entries", tuple(tuple(_entry(g) for g in row) for row in rows)
        )

    @staticmethod
    def diagonal(*functions: FractionalTransferFunction | float) -> TransferMatrix:
        """Return the square matrix with these functions on its diagonal: one controller
        for each joint.
        """
        size = range(len(functions))
        return TransferMatrix(
            [[functions[i] if i == k else 0.0 for k in size] for i in size]
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs."""
        return len(self.entries), len(self.entries[0])

    def __call__(self, s: complex | NDArray[Any]) -> Complexes:
        """Return G(s); `s` [rad/s] of shape (…) gives an array of shape (…, outputs,
        inputs).
        """
        rows = [
            np.stack([np.asarray(g(np.asarray(s, complex))) for g in row], axis=-1)
            for row in self.entries
        ]
        return np.stack(rows, axis=-2)

    def __matmul__(self, other: TransferMatrix) -> TransferMatrix:
        if not isinstance(other, TransferMatrix):
            return NotImplemented
        if self.shape[1] != other.shape[0]:
            problem = f"{self.shape[1]} inputs that {other.shape[0]} outputs lead to"
            raise FieldError(
                "shape",
                other.shape,
                problem,
                allowed=f"{self.shape[1]} rows",
                remedy="transpose",
            )
        columns = list(zip(*other.entries, strict=True))
        return TransferMatrix(
            [[_dot(row, column) for column in columns] for row in self.entries]
        )

    def __add__(self, other: TransferMatrix) -> TransferMatrix:
        if not isinstance(other, TransferMatrix):
            return NotImplemented
        if self.shape != other.shape:
            allowed, remedy = f"shape {self.shape}", "add matrices of one shape"
            raise FieldError(
                "shape", other.shape, "another shape", allowed=allowed, remedy=remedy
            )
        pairs = zip(self.entries, other.entries, strict=True)
        return TransferMatrix(
            [[a + b for a, b in zip(*rows, strict=True)] for rows in pairs]
        )

    def __mul__(self, factor: FractionalTransferFunction | float) -> TransferMatrix:
        if isinstance(factor, TransferMatrix):
            return NotImplemented
        return TransferMatrix([[g * factor for g in row] for row in self.entries])

    __rmul__ = __mul__

    def __neg__(self) -> TransferMatrix:
        return self * -1.0

    def __sub__(self, other: TransferMatrix) -> TransferMatrix:
        return self + -other if isinstance(other, TransferMatrix) else NotImplemented

    def determinant(self) -> FractionalTransferFunction:
        """Return det G as one function, by expansion along rows; square, at most 6 × 6.

        Factors that cancel in exact arithmetic may remain above and below: margins do
        not use it.
        """
        if self.shape[0] != self.shape[1] or self.shape[0] > _LARGEST_SIZE:
            allowed, remedy = (
                f"square, at most {_LARGEST_SIZE} × {_LARGEST_SIZE}",
                "evaluate it: det(G(s))",
            )
            raise FieldError(
                "shape", self.shape, "no determinant", allowed=allowed, remedy=remedy
            )
        determinant: FractionalTransferFunction = _expanded(self.entries)
        return determinant

    def __repr__(self) -> str:
        rows = (", ".join(repr(g) if g else "0" for g in row) for row in self.entries)
        return f"TransferMatrix([{', '.join(f'[{row}]' for row in rows)}])"

    def __str__(self) -> str:
        return "\n".join(
            "[" + ",  ".join(str(g) if g else "0" for g in row) + "]"
            for row in self.entries
        )

    def _repr_latex_(self) -> str:
        rows = (
            " & ".join(g.latex() if g else "0" for g in row) for row in self.entries
        )
        return r"$\displaystyle\begin{bmatrix}" + r" \\ ".join(rows) + r"\end{bmatrix}$"


def _refused(value: object, problem: str) -> FieldError:
    remedy = "write TransferMatrix([[g11, g12], [g21, g22]])"
    return FieldError(
        "entries", value, problem, allowed="rows of equal lengths", remedy=remedy
    )


def _entry(given: object) -> FractionalTransferFunction:
    if isinstance(given, FractionalTransferFunction):
        return given
    # True is a number to Python; in a matrix of gains it is a slip.
    if isinstance(given, bool) or not isinstance(
        given, (int, float, np.integer, np.floating)
    ):
        raise _refused(given, "neither a transfer function nor a number")
    return FractionalTransferFunction.power(0.0) * float(given)


def _dot(row: Sequence[Any], column: Sequence[Any]) -> Any:
    total = row[0] * column[0]
    for a, b in zip(row[1:], column[1:], strict=True):
        total = total + a * b
    return total


def _expanded(rows: Sequence[Sequence[Any]]) -> Any:
    """Laplace's expansion along the first row."""
    if len(rows) == 1:
        return rows[0][0]
    # Not by elimination, which divides by functions whose factors would stay above and
    # below.
    total = _entry(0.0)
    for k, g in enumerate(rows[0]):
        # A zero entry has a minor that nobody needs: the determinant of a
        # triangular matrix costs its diagonal.
        if g.numerator:
            minor = [(*row[:k], *row[k + 1 :]) for row in rows[1:]]
            total = total + (-1.0) ** k * g * _expanded(minor)
    return total
