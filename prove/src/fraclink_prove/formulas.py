"""Terms of SMT-LIB with their kinds, in the IEEE arithmetic of one precision."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fraclink._law.block import Precision
from fraclink_prove.source import Unreadable

__all__ = ["FALSE", "TRUE", "ZERO", "Formulas", "Value", "kind_of", "real_literal"]

# Bits of the exponent and of the significand including the hidden bit, as counted in
# SMT-LIB.
_WIDTHS = {"single": (8, 24), "double": (11, 53)}
_REAL = {"+": "fp.add RNE", "-": "fp.sub RNE", "*": "fp.mul RNE", "/": "fp.div RNE"}
# not operators of C: differences that enclose the exact one
_REAL |= {
    "-up": "fp.sub RTP",
    "-down": "fp.sub RTN",
}
_REAL_TESTS = {
    "<": "fp.lt",
    "<=": "fp.leq",
    ">": "fp.gt",
    ">=": "fp.geq",
    "==": "fp.eq",
}
_WORD = {
    "+": "bvadd",
    "-": "bvsub",
    "*": "bvmul",
    "|": "bvor",
    "&": "bvand",
    "^": "bvxor",
    "<<": "bvshl",
    ">>": "bvlshr",
}
_WORD_TESTS = {"<": "bvult", "<=": "bvule", ">": "bvugt", ">=": "bvuge", "==": "="}
# Prefix of all names created here; no operation of SMT-LIB has it.
_NAMES = re.compile(r"\b(?:any_\w+|t\d+)\b")
_SUM = re.compile(r"\(fp\.(?:add|sub) R.. (\S+) ([^\s)]+)\)\)$")


@dataclass(frozen=True)
class Value:
    """A term and its kind: "real", "word" (32 bits), "bool", or "pointer" (term: the
    place pointed to).
    """

    kind: str
    term: str


TRUE, FALSE = Value("bool", "true"), Value("bool", "false")
ZERO = Value("word", "(_ bv0 32)")


def real_literal(value: float, precision: Precision) -> str:
    """Return `value`, which `precision` holds exactly, as SMT-LIB.

    >>> real_literal(-0.5, "single")
    '(fp #b1 #b01111110 #b00000000000000000000000)'
    """
    exponent, mantissa = _WIDTHS[precision]
    code = "f" if precision == "single" else "d"
    bits = int.from_bytes(struct.pack(f">{code}", value), "big")
    text = f"{bits:0{exponent + mantissa}b}"
    return f"(fp #b{text[0]} #b{text[1 : 1 + exponent]} #b{text[1 + exponent :]})"


class Formulas:
    """Makes terms; `lines` collects their definitions, `known` the values of the
    literals among them.
    """

    def __init__(self, precision: Precision, known: Sequence[float]) -> None:
        self.precision = precision
        exponent, mantissa = _WIDTHS[precision]
        self.real_sort = f"(_ FloatingPoint {exponent} {mantissa})"
        self.known = {real_literal(value, precision): value for value in known}
        self.lines: list[str] = []
        self.count = 0
        self._names: dict[tuple[str, str], Value] = {}
        self.choices: dict[
            str, tuple[Value, Value, Value]
        ] = {}  # by name: condition, and both values
        self.operations: dict[
            str, tuple[str, Value, Value]
        ] = {}  # for reals, by name: sign, and both operands
        self.bounded: dict[
            str, float
        ] = {}  # by name: |value| is assumed to be at most this, and not NaN

    def sort(self, kind: str) -> str:
        """Return the SMT-LIB sort of a kind."""
        return {"real": self.real_sort, "word": "(_ BitVec 32)", "bool": "Bool"}[kind]

    def any(self, kind: str, hint: str) -> Value:
        """Return a value that may be anything of its kind."""
        self.count += 1
        name = f"any_{hint}_{self.count}"
        self.lines.append(f"(declare-const {name} {self.sort(kind)})")
        return Value(kind, name)

    def defined(self, kind: str, term: str) -> Value:
        """Return a name for `term`, so that it is written once however often it is
        used.
        """
        # Equal terms get the same name: that two sums round alike then needs no
        # arithmetic, where a solver would compare two adders bit by bit.
        if (kind, term) not in self._names:
            self.count += 1
            name = f"t{self.count}"
            self.lines.append(f"(define-fun {name} () {self.sort(kind)} {term})")
            self._names[kind, term] = Value(kind, name)
        return self._names[kind, term]

    def choice(self, test: Value, yes: Value, no: Value) -> Value:
        """Return `yes` where `test` holds, else `no`."""
        # Conditions decided here never reach a solver; each branch less halves its
        # work.
        if test == TRUE or yes == no:
            return yes
        if test == FALSE:
            return no
        if (yes, no) == (TRUE, FALSE):
            return test
        chosen = self.defined(yes.kind, f"(ite {test.term} {yes.term} {no.term})")
        self.choices[chosen.term] = (test, yes, no)
        return chosen

    def negated(self, test: Value) -> Value:
        """Return the condition that `test` does not hold."""
        if test in (TRUE, FALSE):
            return FALSE if test == TRUE else TRUE
        return self.defined("bool", f"(not {test.term})")

    def joined(self, sign: str, tests: Sequence[Value]) -> Value:
        """Return `tests[0] && tests[1]` or `||`; neither has an effect."""
        left, right = tests
        return (
            self.choice(left, right, FALSE)
            if sign == "&&"
            else self.choice(left, TRUE, right)
        )

    def operated(self, sign: str, a: Value, b: Value) -> Value:
        """Return `a sign b` as C computes it, for two reals or two words.

        A sum of a choice and the bounded command becomes a choice of sums, so that two
        roundings of one difference are recognised as such.
        """
        if a.kind != b.kind or a.kind not in ("real", "word"):
            raise Unreadable(f"{a.kind} {sign} {b.kind}")
        # Not a separate test: IEEE's != is true for NaN, and so is the negation of ==.
        if sign == "!=":
            return self.negated(self.operated("==", a, b))
        for left in (True, False):
            chosen, other = (a.term, b.term) if left else (b.term, a.term)
            if chosen in self.choices and other in self.bounded:
                test, *values = self.choices[chosen]
                yes, no = (
                    self.operated(sign, *((x, b) if left else (a, x))) for x in values
                )
                return self.choice(test, yes, no)
        decided = self._decided(sign, a, b)
        if decided is not None:
            return decided
        operations, tests_of = (
            (_REAL, _REAL_TESTS) if a.kind == "real" else (_WORD, _WORD_TESTS)
        )
        if sign in operations:
            result = self.defined(a.kind, f"({operations[sign]} {a.term} {b.term})")
            if a.kind == "real":
                self.operations[result.term] = (sign, a, b)
            return result
        if sign in tests_of:
            return self.defined("bool", f"({tests_of[sign]} {a.term} {b.term})")
        raise Unreadable(f"{a.kind} {sign} {b.kind}")

    def _decided(self, sign: str, a: Value, b: Value) -> Value | None:
        """A comparison with a known result: of constants, or from the assumptions."""
        if a.kind == "word":
            # Only literals: two names may denote the same word.
            if (
                a.term.startswith("(_ bv")
                and b.term.startswith("(_ bv")
                and sign == "=="
            ):
                return TRUE if a == b else FALSE
            return TRUE if a == b and sign == "==" else None
        # x == x is false for NaN: an assumption is needed that there is none.
        if a == b and sign == "==" and a.term in self.bounded:
            return TRUE
        limit = self.known.get(b.term)
        if (
            limit is None
            or a.term not in self.bounded
            or self.bounded[a.term] > abs(limit)
        ):
            return None
        # Only where the bound of |a| decides, since the sign of a is open.
        if sign == "<=" and limit >= self.bounded[a.term]:
            return TRUE
        if (sign == ">" and limit > 0) or (sign == "<" and limit < 0):
            return FALSE
        return None

    def negative(self, value: Value) -> Value:
        """Return `-value`."""
        if value.kind == "float":  # a constant that a cast turns into a real
            return Value("float", f"-{value.term}")
        if value.term in self.known:
            # The negative of a literal is again a literal and stays known: bounds are
            # compared with both ends of a range.
            literal = real_literal(-self.known[value.term], self.precision)
            self.known[literal] = -self.known[value.term]
            return Value("real", literal)
        return self.defined(
            value.kind,
            f"({'fp.neg' if value.kind == 'real' else 'bvneg'} {value.term})",
        )

    def magnitude(self, value: Value) -> Value:
        """Return |value|."""
        result = self.defined("real", f"(fp.abs {value.term})")
        if value.term in self.bounded:
            self.bounded[result.term] = self.bounded[value.term]
        return result

    def at_most(self, value: Value, limit: float) -> Value:
        """Return a condition under which |value| <= `limit`, and no NaN; it may ask for
        more than that.

        A sum meets it, too, where both parts are at most a quarter of the limit (a half
        would do but for the rounding), a multiple of a constant where the other factor
        is small enough: only comparisons are left for a solver, which needs minutes for
        an adder of 53 bits in every branch.
        """
        if value.term in self.choices:
            test, yes, no = self.choices[value.term]
            return self.choice(test, self.at_most(yes, limit), self.at_most(no, limit))
        literal = real_literal(_single(repr(limit)), self.precision)
        itself = self.defined("bool", f"(fp.leq (fp.abs {value.term}) {literal})")
        sign, a, b = self.operations.get(value.term, ("", value, value))
        if sign in ("+", "-"):
            parts = self.joined(
                "&&", [self.at_most(part, 0.25 * limit) for part in (a, b)]
            )
        elif sign == "*" and (a.term in self.known) != (b.term in self.known):
            factor, other = (a, b) if a.term in self.known else (b, a)
            parts = self.at_most(
                other, 0.25 * limit / max(abs(self.known[factor.term]), 1.0)
            )
        else:
            return itself
        return self.joined("||", [itself, parts])

    def number(self, text: str) -> Value:
        """Return a constant of C, of the kind "float" until a cast makes it a real."""
        if text.lower().startswith("0x") or text.rstrip("uU").isdigit():
            return Value("word", f"(_ bv{int(text.rstrip('uU'), 0)} 32)")
        if text[-1] not in "fF":
            raise Unreadable(f"{text}, a constant in double precision")
        # a C compiler rounds a float constant once, from its decimal digits
        return Value("float", text[:-1])

    def truth(self, value: Value) -> Value:
        """Return `value` as a condition."""
        if value.kind == "bool":
            return value
        if value.kind != "word":
            raise Unreadable(f"{value.kind} as a condition")
        return self.operated("!=", value, ZERO)

    def converted(self, kind: str, value: Value) -> Value:
        """Return `value` as the type `kind` of C."""
        wanted = kind_of(kind)
        if value.kind == wanted:
            return value
        if wanted == "real" and value.kind == "float":
            return Value("real", real_literal(_single(value.term), self.precision))
        if wanted == "real" and value == ZERO:
            return Value("real", real_literal(0.0, self.precision))
        if wanted == "real" and value.kind == "word":
            exponent, mantissa = _WIDTHS[self.precision]
            return self.defined(
                "real", f"((_ to_fp_unsigned {exponent} {mantissa}) RNE {value.term})"
            )
        raise Unreadable(f"{value.kind} as {kind}")

    def relevant(self, goals: Sequence[str], *, arithmetic: bool = True) -> list[str]:
        """Return the definitions on which `goals` depend, in their order.

        A sum with a part that may be anything and is used nowhere else may be anything
        itself: it is set free, which leaves less to decide and allows no less than
        before. Without `arithmetic` all of its results are set free, which suffices
        where only comparisons bound the goals.
        """
        defined = {line.split()[1]: line for line in self.lines}
        if not arithmetic:
            defined |= {
                name: f"(declare-const {name} {self.real_sort})"
                for name in self.operations
            }
        while True:
            uses = _uses(defined, goals)
            sums = [
                name
                for name, count in uses.items()
                if count
                and (found := _SUM.search(defined[name]))
                and any(
                    uses.get(part) == 1 and "declare-const" in defined[part]
                    for part in found.groups()
                )
            ]
            if not sums:
                return [line for name, line in defined.items() if uses.get(name)]
            for name in sums:
                defined[name] = f"(declare-const {name} {self.real_sort})"


def _uses(defined: Mapping[str, str], goals: Sequence[str]) -> dict[str, int]:
    """The number of uses of each name in the goals and the terms on which they depend."""
    uses: dict[str, int] = {}
    waiting = [name for goal in goals for name in _NAMES.findall(goal)]
    while waiting:
        name = waiting.pop()
        uses[name] = uses.get(name, 0) + 1
        if uses[name] == 1 and defined[name].startswith("(define-fun"):
            waiting += _NAMES.findall(defined[name])[1:]
    return uses


def _single(digits: str) -> float:
    # Through its four bytes: numpy's float32 would warn if a constant overflows, while
    # struct rejects it.
    return float(struct.unpack("<f", struct.pack("<f", float(digits)))[0])


def kind_of(c_type: str) -> str:
    """Return the kind of a type of C."""
    # int and double are omitted on purpose: C would promote them silently, but this
    # arithmetic would not.
    kinds = {"law_real": "real", "uint32_t": "word"}
    if c_type not in kinds:
        raise Unreadable(f"the type {c_type}")
    return kinds[c_type]
