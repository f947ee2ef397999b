"""Functions of law.c as formulas: every path at once, in exact IEEE arithmetic, as
SMT-LIB (QF_BVFP).

A call whose effects matter is followed; any other one is assumed to leave arbitrary
values in everything that it may write. The formulas therefore allow more than the law
can do, and what holds for them holds for the law.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from fraclink._law.block import Precision
from fraclink_prove.formulas import (
    FALSE,
    TRUE,
    ZERO,
    Formulas,
    Value,
    kind_of,
    real_literal,
)
from fraclink_prove.source import Function, Node, Source, Unreadable

__all__ = ["Symbolic"]

Place = tuple[str, str]  # (struct or frame of a call, member or variable)
Memory = dict[Place, Value]


class Symbolic(Formulas):
    """Executes functions of `source` on terms.

    constants: members of law_params with a known value; every other one may have any
    value. tracked: pairs (owner, member): calls that may change one are followed.
    assumed: what functions return by assumption, by their names.
    """

    def __init__(
        self,
        source: Source,
        precision: Precision,
        *,
        constants: Mapping[str, float],
        tracked: frozenset[tuple[str, str]],
        assumed: Mapping[str, Value] = MappingProxyType({}),
    ) -> None:
        super().__init__(precision, tuple(constants.values()))
        self.source, self.tracked, self.assumed = source, tracked, assumed
        self.memory: Memory = {
            ("law_params", name): Value("real", real_literal(value, precision))
            for name, value in constants.items()
        }

    def load(self, place: Place) -> Value:
        """Return what stands at `place`; anything, where nothing was written yet."""
        if place not in self.memory:
            kind = self.source.members.get(place[1])
            if kind is None:
                raise Unreadable(f"{place[1]} is read before it is written")
            self.memory[place] = self.any(kind_of(kind), place[1])
        return self.memory[place]

    def call(self, name: str, arguments: tuple[Value, ...]) -> Value | None:
        """Return what the function returns after its effects; None for void."""
        function = self.source.functions[name]
        # A pure function costs its formula once, and its result may bound the goal; one
        # with effects elsewhere would only enlarge the problem.
        followed = function.pure or bool(self.source.effects(name) & self.tracked)
        if not followed or function.loops:
            return self._anything(function, arguments)
        self.count += 1
        # A separate frame for each call, so that two calls of one function share no
        # variables.
        frame = f"{name}#{self.count}"
        for (kind, pointer, parameter), value in zip(
            function.parameters, arguments, strict=True
        ):
            if pointer != (value.kind == "pointer"):
                raise Unreadable(f"{name}({parameter}) is given something else")
            self.memory[frame, parameter] = (
                value if pointer else self.converted(kind, value)
            )
        body = function.body()
        returned: Value | None = None
        for number, statement in enumerate(body):
            if statement[0] == "return":
                # An early return makes all following statements conditional; functions
                # of law.c have one exit each.
                if number != len(body) - 1:
                    raise Unreadable(f"{name} returns before its end")
                returned = self.converted(
                    function.result, self._value(_node(statement[1]), frame)
                )
            else:
                self._run(statement, frame)
        return returned

    def _anything(
        self, function: Function, arguments: tuple[Value, ...]
    ) -> Value | None:
        # Sorted, so that the same text always gives the same problem: the logs are
        # compared by their hashes.
        for owner, member in sorted(self.source.effects(function.name)):
            kind = self.source.members.get(member)
            if kind is None:
                raise Unreadable(f"{function.name} writes {member}, of unknown type")
            self.memory[owner, member] = self.any(kind_of(kind), member)
        for value in arguments:
            if (
                value.kind == "pointer" and "." in value.term
            ):  # the address of one variable or member
                owner, member = value.term.split(".")
                if (owner, member) in self.memory:
                    self.memory[owner, member] = self.any(
                        self.memory[owner, member].kind, "written"
                    )
        return (
            None
            if function.result == "void"
            else self.any(kind_of(function.result), function.name)
        )

    def _run(self, statement: Node, frame: str) -> None:
        kind = statement[0]
        if kind == "declare":
            _, made_of, name, value = statement
            start = (
                self.any(kind_of(str(made_of)), str(name))
                if value is None
                else self._value(_node(value), frame)
            )
            self.memory[frame, str(name)] = self.converted(str(made_of), start)
        elif kind == "set":
            place = self._place(_node(statement[1]), frame)
            value = self._value(_node(statement[2]), frame)
            before = self.load(place)
            self.memory[place] = self.converted(
                "law_real" if before.kind == "real" else "uint32_t", value
            )
        elif kind == "do":
            self._call_node(_node(statement[1]), frame)
        elif kind == "if":
            self._branch(statement, frame)
        else:
            raise Unreadable(f"{kind} inside a branch")

    def _branch(self, statement: Node, frame: str) -> None:
        test = self.truth(self._value(_node(statement[1]), frame))
        # A branch that cannot be taken is not executed: its members would be merged
        # with values that never occur.
        if test in (TRUE, FALSE):
            for part in _nodes(statement[2 if test == TRUE else 3]):
                self._run(part, frame)
            return
        # Both branches start from the same memory; their results are merged place by
        # place.
        before = dict(self.memory)
        for part in _nodes(statement[2]):
            self._run(part, frame)
        after, self.memory = self.memory, before
        for part in _nodes(statement[3]):
            self._run(part, frame)
        for place in dict.fromkeys((*after, *self.memory)):
            yes = after.get(place) or self._late(place)
            no = self.memory.get(place) or self._late(place)
            # a variable of one branch only, which no later statement reads
            if yes is None or no is None:
                self.memory.pop(place, None)
            else:
                self.memory[place] = self.choice(test, yes, no)

    def _late(self, place: Place) -> Value | None:
        """A member written in one branch only: in the other it has an arbitrary value,
        which is sound.
        """
        kind = self.source.members.get(place[1])
        return (
            None
            if kind is None or "#" in place[0]
            else self.any(kind_of(kind), place[1])
        )

    def _place(self, node: Node, frame: str) -> Place:
        if node[0] == "name":
            return frame, str(node[1])
        if node[0] == "member":
            pointer = self.memory[frame, str(node[1])]
            return pointer.term, str(node[2])
        if node[0] == "at":
            pointer = self._value(_node(node[1]), frame)
            owner, member = pointer.term.split(".")
            return owner, member
        raise Unreadable(f"writing to {node[0]}")

    def _call_node(self, node: Node, frame: str) -> Value | None:
        name = str(node[1])
        if name in ("__builtin_fabs", "__builtin_fabsf"):
            return self.magnitude(self._value(_nodes(node[2])[0], frame))
        # a hint for the compiler about the first of the two
        if name == "__builtin_expect":
            return self._value(_nodes(node[2])[0], frame)
        if name in self.assumed:
            return self.assumed[name]
        if name not in self.source.functions:
            raise Unreadable(f"a call of {name}, whose text is not here")
        return self.call(
            name, tuple(self._value(part, frame) for part in _nodes(node[2]))
        )

    def _value(self, node: Node, frame: str) -> Value:
        kind = node[0]
        if kind == "number":
            return self.number(str(node[1]))
        if kind in ("name", "member", "at"):
            return self.load(self._place(node, frame))
        if kind == "address":
            target = _node(node[1])
            # an element represents its array
            whole = _node(target[1]) if target[0] == "element" else target
            return Value("pointer", ".".join(self._place(whole, frame)))
        if kind == "call":
            value = self._call_node(node, frame)
            if value is None:
                raise Unreadable(f"the value of {node[1]}, which returns none")
            return value
        if kind == "cast":
            return self.converted(str(node[1]), self._value(_node(node[2]), frame))
        if kind == "minus":
            return self.negative(self._value(_node(node[1]), frame))
        if kind == "choice":
            test = self.truth(self._value(_node(node[1]), frame))
            yes, no = (
                self._value(_node(node[2]), frame),
                self._value(_node(node[3]), frame),
            )
            if yes.kind != no.kind:
                raise Unreadable("a choice between two types")
            return self.choice(test, yes, no)
        return self._binary(str(node[1]), _node(node[2]), _node(node[3]), frame)

    def _binary(self, sign: str, left: Node, right: Node, frame: str) -> Value:
        if sign in ("&&", "||"):
            before = dict(self.memory)
            tests = [self.truth(self._value(part, frame)) for part in (left, right)]
            # C evaluates the second part only depending on the first: an effect there
            # would be unconditional here.
            if any(self.memory.get(place) != value for place, value in before.items()):
                raise Unreadable("an effect inside a condition")
            return self.joined(sign, tests)
        a, b = self._value(left, frame), self._value(right, frame)
        if sign == "!=" and a.kind == "bool" and b == ZERO:
            return a
        return self.operated(sign, a, b)


def _node(part: object) -> Node:
    if not isinstance(part, tuple):
        raise Unreadable("an expression is missing")
    return part


def _nodes(part: object) -> tuple[Node, ...]:
    return tuple(_node(inner) for inner in _node(part))
