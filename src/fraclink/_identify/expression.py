"""A structure as text: "k*s**a/(s**b + w)*exp(-T*s)", read without executing any of it
as Python.

The text is parsed, every node is compared with the few kinds that a fractional transfer
function consists of, and the tree is evaluated in two algebras: arrays of complex
numbers (many parameter vectors at once) and exact transfer functions.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from fraclink.errors import FieldError
from fracsys._fractional import FractionalTransferFunction, s
from fracsys.checks import Complex

__all__ = ["Expression", "Leaves", "Role", "parse_expression"]

Role = Literal["order", "delay", "coefficient"]

_LONGEST = 1000  # characters; a structure written by hand has about fifty
_DEEPEST = 60  # nesting depth, since the evaluation below is recursive
_MOST = 12  # parameters; a log cannot separate more
_LARGEST_POWER = 8  # of a sum: each power multiplies the number of terms
_RESERVED, _FORMS = (
    ("s", "exp", "offset"),
    "numbers, names, s, + - * / **, and exp(-T*s)",
)
_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


@dataclass(frozen=True)
class Expression:
    """A transfer function of s and named parameters, as a tree.

    `roles` are those of the parameters in the order of the text: an "order" is in an
    exponent of s, a "delay" in exp(-T*s), a "coefficient" elsewhere. A parameter with
    several roles has the narrowest of them.
    """

    text: str
    roles: Mapping[str, Role]
    tree: ast.expr

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters in the order of the text."""
        return tuple(self.roles)

    def of_role(self, role: Role) -> tuple[str, ...]:
        """Parameters of one role."""
        return tuple(name for name, own in self.roles.items() if own == role)

    def response(self, values: Mapping[str, Any], points: Complex) -> Complex:
        """G at `points` [rad/s], shape (K,), for parameters of shape () or (M, 1)."""
        # The principal branch, computed once for all powers: s^a is then the same
        # function at every point, with its cut along the negative real axis.
        logarithm = np.log(points)
        arrays = {
            name: np.asarray(value, dtype=np.float64) for name, value in values.items()
        }
        leaves = Leaves(points, lambda order: np.exp(order * logarithm), np.exp, arrays)
        # a candidate may overflow: its cost is infinite, and it is dropped
        with np.errstate(all="ignore"):
            return np.asarray(walk(self.tree, leaves), dtype=np.complex128)

    @cached_property
    def quotient(self) -> tuple[Expression, Expression]:
        """Numerator and denominator as written in the text."""
        top, bottom = _divided(self.tree)
        return replace(self, tree=top), replace(self, tree=bottom)

    def function(self, values: Mapping[str, float]) -> FractionalTransferFunction:
        """The exact transfer function; FieldError if there is none for these values (a
        negative delay).
        """
        leaves = Leaves(
            s, s.power, _delayed, {name: float(value) for name, value in values.items()}
        )
        try:
            result = walk(self.tree, leaves)
        except ArithmeticError as error:
            raise _not_a_number(self.text, error) from error
        return (
            result
            if isinstance(result, FractionalTransferFunction)
            else float(result) * s**0
        )


@dataclass(frozen=True)
class Leaves:
    """The values of s, s**a, exp and the parameters in one algebra."""

    variable: Any
    power: Callable[[Any], Any]
    exponential: Callable[[Any], Any]
    values: Mapping[str, Any]


def walk(node: ast.expr, leaves: Leaves) -> Any:
    if isinstance(node, ast.Constant):
        return float(node.value)  # type: ignore[arg-type]  # the parser admits int and float alone
    if isinstance(node, ast.Name):
        return leaves.variable if node.id == "s" else leaves.values[node.id]
    if isinstance(node, ast.UnaryOp):
        inner = walk(node.operand, leaves)
        return -inner if isinstance(node.op, ast.USub) else inner
    if isinstance(node, ast.Call):
        return leaves.exponential(walk(node.args[0], leaves))
    if not isinstance(node, ast.BinOp):
        raise TypeError(type(node).__name__)
    right = walk(node.right, leaves)
    if isinstance(node.op, ast.Pow):
        if isinstance(node.left, ast.Name) and node.left.id == "s":
            return leaves.power(right)
        return _real_power(walk(node.left, leaves), right)
    return _OPERATORS[type(node.op)](walk(node.left, leaves), right)


def _real_power(base: Any, exponent: Any) -> Any:
    """A power; ArithmeticError for a negative base, for which Python, unlike numpy,
    returns a complex number.
    """
    if (
        type(base) is float
        and type(exponent) is float
        and base < 0
        and not exponent.is_integer()
    ):
        raise ArithmeticError
    return base**exponent


def _delayed(exponent: FractionalTransferFunction) -> FractionalTransferFunction:
    """e^(−τs) for the exponent −τs."""
    slope = exponent / s
    return (s**0).delayed(-slope.numerator[0].coefficient if slope.numerator else 0.0)


# --- numerator and denominator ------------------------------------------------------------------------------

_ONE = ast.Constant(1.0)


def _divided(node: ast.expr) -> tuple[ast.expr, ast.expr]:
    """Numerator and denominator of a tree; the denominator is 1 if it is not a
    quotient.
    """
    if isinstance(node, ast.UnaryOp):
        top, bottom = _divided(node.operand)
        return ast.UnaryOp(node.op, top), bottom
    if not isinstance(node, ast.BinOp):
        return node, _ONE
    top, bottom = _divided(node.left)
    if isinstance(node.op, ast.Pow):
        power = node.right
        if not _names(power) and (number := _constant(power)) < 0.0:
            # (s + 1)^−1 has its root in the denominator.
            top, bottom, power = bottom, top, ast.Constant(-number)
        return _power(top, power), _power(bottom, power)
    other, divisor = _divided(node.right)
    if isinstance(node.op, ast.Mult):
        return _product(top, other), _product(bottom, divisor)
    if isinstance(node.op, ast.Div):
        return _product(top, divisor), _product(bottom, other)
    # A common denominator is kept instead of being squared: the equations would have
    # roots that G does not have.
    if ast.dump(bottom) == ast.dump(divisor):
        return ast.BinOp(top, node.op, other), bottom
    left, right = _product(top, divisor), _product(other, bottom)
    return ast.BinOp(left, node.op, right), _product(bottom, divisor)


def _power(base: ast.expr, exponent: ast.expr) -> ast.expr:
    return base if base is _ONE else ast.BinOp(base, ast.Pow(), exponent)


def _product(left: ast.expr, right: ast.expr) -> ast.expr:
    if left is _ONE or right is _ONE:
        return left if right is _ONE else right
    return ast.BinOp(left, ast.Mult(), right)


# --- parsing ------------------------------------------------------------------------------------------------


def parse_expression(text: str) -> Expression:
    """Return the structure described by `text`; FieldError names the first part without
    a meaning here.

    >>> parse_expression("k*s**a/(s**a + w)*exp(-T*s)").roles["a"]
    'order'
    >>> try:
    ...     parse_expression("1/sin(s)")
    ... except FieldError as error:
    ...     error.value, error.problem
    ('sin(s)', 'a function that is not known')
    """
    if not isinstance(text, str) or not text.strip() or len(text) > _LONGEST:
        raise FieldError(
            "expression",
            text,
            "no text"
            if not isinstance(text, str)
            else "empty"
            if not text.strip()
            else "too long",
            allowed=f"a text of 1 to {_LONGEST} characters",
            remedy='write it as in "k/(T*s**a + 1)"',
        )
    try:
        # Parsed as Python but never executed: `_check` compares every node with the few
        # kinds that a transfer function consists of, and rejects any other by name.
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        where = (
            f" at character {error.offset}"
            if isinstance(error, SyntaxError) and error.offset
            else ""
        )
        raise FieldError(
            "expression",
            text,
            f"not a formula{where}",
            allowed=_FORMS,
            remedy="check brackets and operators; a product needs its *",
        ) from error
    # A number is a transfer function too, but a text without s is nearly always a
    # mistake.
    if "s" not in _names(tree):
        raise _refused(
            tree, "without s", "write the transfer function, such as k/(T*s**a + 1)"
        )
    _check(tree, 0)
    roles = _roles(tree)
    if len(roles) > _MOST:
        raise FieldError(
            "expression",
            len(roles),
            "too many parameters",
            allowed=f"<= {_MOST} parameters",
            remedy="write known values as numbers",
        )
    # After the checks, so that an error quotes the original text.
    tree = _Distributed().visit(tree)
    # again, since a factor of a term may now be a root of a negative number
    _check(tree, 0)
    expression = Expression(" ".join(text.split()), roles, tree)
    _check_exponentials(expression)
    return expression


def _names(tree: ast.AST) -> list[str]:
    """Names in the order of the text, those of functions left out."""
    # The parser treats exp as a name, but it is not a parameter.
    functions = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    nodes = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and id(node) not in functions
    ]
    return list(
        dict.fromkeys(
            node.id for node in sorted(nodes, key=lambda n: (n.lineno, n.col_offset))
        )
    )


def _has_s(node: ast.AST) -> bool:
    return "s" in _names(node)


def _refused(node: ast.expr, problem: str, remedy: str) -> FieldError:
    try:
        text = ast.unparse(node)
    except RecursionError:  # a sum of hundreds of terms is a tree of that depth
        text = f"characters {node.col_offset + 1} to {node.end_col_offset}"
    return FieldError("expression", text, problem, allowed=_FORMS, remedy=remedy)


def _not_a_number(text: str, error: ArithmeticError | None = None) -> FieldError:
    return FieldError(
        "expression",
        text,
        "a division by zero"
        if isinstance(error, ZeroDivisionError)
        else "no finite real number",
        allowed=_FORMS,
        remedy="write numbers and powers whose value is real and finite",
    )


def _constant(node: ast.expr) -> float:
    """The value of a subtree without names; FieldError if it is not a finite real
    number.
    """
    try:
        # in floating point, so that every power is fast
        value = walk(node, Leaves(s, s.power, _delayed, {}))
    except ArithmeticError as error:
        raise _not_a_number(ast.unparse(node), error) from error
    if not math.isfinite(value):
        raise _not_a_number(ast.unparse(node))
    return float(value)


def _check(node: ast.expr, depth: int) -> None:
    """Raise FieldError for the first node of the tree that cannot belong to a
    fractional transfer function.
    """
    if depth > _DEEPEST:
        raise _refused(node, "nested too deeply", "write it with fewer brackets")
    if isinstance(node, ast.Constant):
        if (
            isinstance(node.value, bool)
            or not isinstance(node.value, int | float)
            # Room for a product: with 1e308 the first multiplication would overflow.
            or not abs(node.value) < 1e300
        ):
            raise _refused(node, "not a number", "write numbers as 0.5 or 1e-3")
    elif isinstance(node, ast.Name):
        if node.id in _RESERVED[1:]:
            raise _refused(
                node,
                "a name with a meaning of its own",
                "give the parameter another name",
            )
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        _check(node.operand, depth + 1)
    elif isinstance(node, ast.Call):
        _check_call(node, depth)
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        _check_power(node, depth)
    elif isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        _check(node.left, depth + 1)
        _check(node.right, depth + 1)
        if (
            isinstance(node.op, ast.Div)
            and not _names(node.right)
            and _constant(node.right) == 0.0
        ):
            raise _refused(node, "a division by zero", "divide by another number")
    elif isinstance(node, ast.BinOp):
        raise _refused(
            node,
            "an operator that is not known",
            "write a power as s**0.5"
            if isinstance(node.op, ast.BitXor)
            else "write it with + - * / **",
        )
    else:
        raise _refused(
            node, "a piece that is not known", "write it with + - * / ** and exp(-T*s)"
        )
    # Constants are computed here once, so that an overflow or a root of −1 is reported
    # with its subtree.
    if isinstance(node, ast.BinOp) and not _names(node):
        _constant(node)


def _check_call(node: ast.Call, depth: int) -> None:
    if not isinstance(node.func, ast.Name) or node.func.id != "exp":
        raise _refused(
            node, "a function that is not known", "the only function is exp, of a delay"
        )
    if len(node.args) != 1 or node.keywords or not _has_s(node.args[0]):
        raise _refused(node, "not a delay", "write it as exp(-T*s)")
    _check(node.args[0], depth + 1)


def _check_power(node: ast.BinOp, depth: int) -> None:
    if _has_s(node.right):
        raise _refused(node, "s in an exponent", "a delay is exp(-T*s)")
    _check(node.left, depth + 1)
    _check(node.right, depth + 1)
    if not _has_s(node.left) or _is_single_term(node.left):
        return
    # A power that is a parameter may be fractional, and (s + 1)^a is not a quotient of
    # powers of s.
    power = None if _names(node.right) else _constant(node.right)
    if power is None or not power.is_integer() or abs(power) > _LARGEST_POWER:
        raise _refused(
            node,
            "a power of a sum that is not a whole number up to 8",
            "no quotient of powers of s is equal to it; multiply out, or use powers of s alone",
        )


def _is_single_term(node: ast.expr) -> bool:
    """Whether a subtree is c·s^a, for which every real power is again of this form."""
    if not _has_s(node) or isinstance(node, ast.Name):
        return True
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        return _is_single_term(node.left) and _is_single_term(node.right)
    return (
        isinstance(node, ast.BinOp)
        and isinstance(node.op, ast.Pow)
        and _is_single_term(node.left)
    )


class _Distributed(ast.NodeTransformer):
    """(c s^a)^p becomes c^p s^(a p): the power 0.5 of an array s^3 would be -s^1.5, its
    principal value.
    """

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        if (
            isinstance(node.op, ast.Pow)
            and isinstance(node.left, ast.BinOp)
            and _is_single_term(node.left)
        ):
            return _raised(node.left, node.right)
        return node


def _raised(term: ast.expr, power: ast.expr) -> ast.expr:
    if not isinstance(term, ast.BinOp) or not _has_s(term):
        return ast.BinOp(term, ast.Pow(), power)
    if isinstance(term.op, ast.Pow):
        return ast.BinOp(term.left, term.op, ast.BinOp(term.right, ast.Mult(), power))
    return ast.BinOp(_raised(term.left, power), term.op, _raised(term.right, power))


def _uses(node: ast.AST, inside: Role) -> Iterator[tuple[str, Role]]:
    """Every parameter with its role at each place where it occurs."""
    if isinstance(node, ast.Name) and node.id != "s":
        yield node.id, inside
    elif isinstance(node, ast.Call):
        yield from _uses(node.args[0], "delay")
    elif (
        isinstance(node, ast.BinOp)
        and isinstance(node.op, ast.Pow)
        and _has_s(node.left)
    ):
        yield from _uses(node.left, inside)
        yield from _uses(node.right, "order")
    else:
        for child in ast.iter_child_nodes(node):
            yield from _uses(child, inside)


def _roles(tree: ast.expr) -> dict[str, Role]:
    # The range of an order is the narrowest: a parameter that occurs in an exponent and
    # elsewhere gets that range.
    rank: tuple[Role, ...] = ("order", "delay", "coefficient")
    uses = list(_uses(tree, "coefficient"))
    return {
        name: min((role for used, role in uses if used == name), key=rank.index)
        for name in _names(tree)
        if name != "s"
    }


def _check_exponentials(made: Expression) -> None:
    """Raise FieldError for an exponent that is not a delay, i.e. not proportional to −s
    for positive parameters.
    """
    # Differences between two of these values, or between one of them and a number that
    # people write, are never zero.
    values = {
        name: 0.7 + 0.1037 * (place + 0.71) for place, name in enumerate(made.names)
    }
    for node in ast.walk(made.tree):
        if not isinstance(node, ast.Call):
            continue
        leaves = Leaves(s, s.power, _delayed, values)
        try:
            exponent = walk(node.args[0], leaves)
        except (FieldError, ArithmeticError) as error:
            raise _refused(node, "not a delay", "write it as exp(-T*s)") from error
        slope = exponent / s
        # exponent/s must be a number, without a further delay and without a power of s.
        if slope.delay or any(
            t.order for terms in (slope.numerator, slope.denominator) for t in terms
        ):
            raise _refused(
                node,
                "not a delay: its exponent is not proportional to s",
                "write it as exp(-T*s)",
            )
        if slope.numerator and slope.numerator[0].coefficient > 0:
            raise _refused(
                node,
                "a prediction: it answers before its input",
                "write it as exp(-T*s)",
            )
