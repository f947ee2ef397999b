"""Bound of the rounding for all time: one step by Gappa, propagated to the output by
norms in ball arithmetic.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from fraclink._export.claims import Claim
from fraclink._export.data import hex_float
from fraclink._law import Law
from fraclink_prove.norms import worst_gain
from fraclink_prove.tools import GAPPA, at_most, sha256_of_text

__all__ = ["Rounding", "rounding_bound", "rounding_claim"]

# The statements of law.c from which the Gappa script below was made; another text needs
# another proof.
_FORM = (
    "sum += modes[i].gain * value;",
    "const law_real next = (modes[i].pole * value) + input;",
    "states[i] = next;",
    "sum += (pair->gain * re) - (pair->cross * im);",
    "state[0] = ((pair->pole * re) - (pair->turn * im)) + change;",
    "state[1] = (pair->pole * im) + (pair->turn * re);",
    "run_modes(p->direct * change, &s->real[0], change, &p->real[0], found, count, left);",
    "tip = s->motor_angle - (s->torque * p->compliance);",
    "law_real angle = s->reference;",
    "error = expected(s, p, forward) - tip;",
    "correct(s, p, &found, error - s->error, &left);",
    "s->reference + offset;",
    "command(s, p, forward + faded(s, p, correction));",
)
_SWEPT = Fraction(1, 10**18)  # a mode below it is set to 0, one in each period
# margin of the states above their exact bounds for the rounding added to them
_ROOM = Fraction(1025, 1024)


@dataclass(frozen=True)
class Rounding:
    """What the rounding can do, for ever, while nothing is limited and no sample is
    rejected.

    correction: distance of the computed correction from the exact one of the same
    errors e, |e| ≤ `error` [rad]. command: distance of motor_reference from that of
    exact arithmetic on the same samples [rad].
    """

    correction: float
    command: float
    error: float


@dataclass(frozen=True)
class _Mode:
    """A real mode, or one with `turn` and `cross` for a pair; names in the script end
    in `tag`.
    """

    tag: str
    pole: float
    gain: float
    turn: float = 0.0
    cross: float = 0.0

    @property
    def paired(self) -> bool:
        return self.tag.startswith("pair")

    @property
    def leak(self) -> Fraction:
        """1 - |p|, rounded down."""
        size = Fraction(self.pole) ** 2 + Fraction(self.turn) ** 2
        root = (
            Fraction(math.nextafter(math.sqrt(float(size)), math.inf))
            if self.paired
            else abs(Fraction(self.pole))
        )
        # Four units in the last place for the rounding of the square and of its root:
        # an overestimated leak would make all later bounds too small.
        return 1 - root * (1 + Fraction(1, 2**50)) if self.paired else 1 - root

    @property
    def weight(self) -> Fraction:
        """|g|, rounded up: what one unit of the state gives at the output."""
        return abs(Fraction(self.gain)) + abs(Fraction(self.cross))

    def size(self, change: Fraction, *, of_change: bool) -> Fraction:
        """Largest state for inputs up to `change`, or for differences of errors of up
        to half of it.
        """
        if not of_change:
            return change / self.leak
        # (1 - 1/z)/(z - p) has the norm 2 if the mode decays without oscillating, else
        # 1 + |1 - p|/(1 - |p|)
        if not self.paired and self.pole >= 0:
            return change
        away = abs(1 - Fraction(self.pole)) + abs(Fraction(self.turn))
        return change / 2 * (1 + away / self.leak)


def _modes(law: Law) -> tuple[list[_Mode], list[_Mode]]:
    """Modes of the correction and of the feed-forward, with the numbers of the block."""
    values = law.coefficients

    def grouped(field: str, count: int, width: int) -> Iterator[Sequence[float]]:
        numbers = values[field]
        assert isinstance(numbers, list)  # the block's arrays are lists  # noqa: S101
        return (numbers[i * width : (i + 1) * width] for i in range(count))

    real = [
        _Mode(f"real{i}", *row)
        for i, row in enumerate(grouped("real", len(law.correction.poles), 2))
    ]
    pairs = [
        _Mode(f"pair{i}", pole, gain, turn, cross)
        for i, (pole, turn, gain, cross) in enumerate(
            grouped("pair", len(law.correction.pair_poles), 4)
        )
    ]
    forward = [
        _Mode(f"ahead{i}", *row)
        for i, row in enumerate(grouped("forward", len(law.feedforward.poles), 2))
    ]
    return real + pairs, forward


def _real(law: Law, name: str) -> float:
    value = law.coefficients[name]
    assert isinstance(value, float)  # the arrays are read by _modes  # noqa: S101
    return value


def rounding_claim(law: Law, folder: Path, *, error: float = 0.5) -> Claim:
    """Prove how far the computed command can be from the one of exact arithmetic, for
    ever.

    Gappa bounds each rounding of one period; an error that enters a state comes out
    multiplied by at most the l1 norm from there to the output, so that the sum of the
    products is a bound at all times.
    """
    claim = Claim(
        "rounding",
        "the distance of the command from exact arithmetic is bounded",
        "not proved",
    )
    if GAPPA.path is None:
        return replace(claim, reason=GAPPA.missing)
    # Blanks do not count, since the layout of the text does not affect the arithmetic.
    text = re.sub(r"\s+", " ", (folder / "law.c").read_text(encoding="utf-8"))
    gone = [form for form in _FORM if form not in text]
    if gone:
        return replace(
            claim,
            reason=f"law.c has a form that the proof does not know: without `{gone[0]}`",
        )
    script = _script(law, error)
    (folder / "proof").mkdir(exist_ok=True)
    (folder / "proof" / "rounding.gappa").write_text(script, encoding="utf-8")
    answer = GAPPA.run(("proof/rounding.gappa",), folder)
    (folder / "proof" / "rounding.log").write_text(answer.text, encoding="utf-8")
    files = (
        ("proof/rounding.gappa", sha256_of_text(script)),
        ("proof/rounding.log", sha256_of_text(answer.text)),
    )
    try:
        largest = worst_gain(law)
        bound = rounding_bound(law, answer.text, largest, error)
    except ValueError as problem:
        return replace(claim, logs=files, reason=str(problem))
    gain, own, command = (
        at_most(largest * error),
        at_most(bound.correction, 3),
        at_most(bound.command, 3),
    )
    statement = (
        f"while nothing is limited and every sample is credible, at all times: |e| ≤ {error:g} rad gives "
        f"|Ĉe| ≤ {gain} rad and |Ĉe - exact| ≤ {own} rad, and from the same samples "
        f"|motor_reference - exact| ≤ {command} rad; exact is the same law without rounding"
    )
    return replace(
        claim,
        status="proved",
        statement=statement,
        tools=(GAPPA.name, "ball arithmetic of python-flint"),
        logs=files,
    )


def rounding_bound(law: Law, answer: str, gain: float, error: float) -> Rounding:
    """Return the all-time bounds for errors up to `error` [rad] from Gappa's `answer`
    about one step and the correction's `gain`; ValueError where it is not enough.
    """
    step = _answers(answer)
    correction, ahead = _modes(law)
    own = _of_filter(correction, step, "sum", Fraction(2 * error), of_change=True)
    # the change of the error is rounded too; this acts through the filter without its
    # difference
    static = abs(Fraction(_real(law, "direct"))) + sum(
        (mode.weight / mode.leak for mode in correction), Fraction(0)
    )
    own += static * step["change"]
    forward = _of_filter(
        ahead,
        step,
        "ahead",
        Fraction(_real(law, "acceleration_limit")),
        of_change=False,
    )
    # The rounding of the error signal passes through the whole filter, whose worst-case
    # gain is the l1 norm of the correction.
    from_samples = Fraction(gain) * step["error"]
    command = own + forward + from_samples + step["offset"] + step["wanted"]
    return Rounding(_up(own), _up(command), error)


def _of_filter(
    modes: list[_Mode],
    step: dict[str, Fraction],
    name: str,
    change: Fraction,
    *,
    of_change: bool,
) -> Fraction:
    total = step[f"{name}_output"]
    for mode in modes:
        # The error of the two states of a pair is at most the sum of both errors in
        # modulus.
        entering = step[mode.tag] + step.get(f"{mode.tag}_turned", Fraction(0)) + _SWEPT
        # The bound of one step was computed for states up to `_ROOM` times their exact
        # bound: it holds for all time if the rounding never carries them beyond that.
        through = (
            (entering + step["change"]) / mode.leak
            if of_change
            else entering / mode.leak
        )
        if (
            mode.size(change, of_change=of_change) + through
            > mode.size(change, of_change=of_change) * _ROOM
        ):
            raise ValueError(
                f"the rounding in mode {mode.tag} grows beyond what was assumed of its state"
            )
        total += mode.weight * entering / mode.leak
    return total


def _up(value: Fraction) -> float:
    return math.nextafter(float(value), math.inf)


def _answers(text: str) -> dict[str, Fraction]:
    """Largest moduli of the intervals that Gappa prints for each `name_off in ?`."""
    found: dict[str, Fraction] = {}
    for name, low, high in re.findall(
        r"^\s*(\w+) - \w+ in \[(\S+?)(?: \{[^}]*\})?, (\S+?)(?: \{[^}]*\})?\]",
        text,
        re.MULTILINE,
    ):
        found[name.removesuffix("_computed")] = max(
            abs(_dyadic(low)), abs(_dyadic(high))
        )
    if not found:
        raise ValueError(
            "Gappa gave no bounds: " + text.strip().split("\n", 1)[0][:200]
        )
    return found


def _dyadic(text: str) -> Fraction:
    """Gappa writes 123b-45 for 123 · 2^-45."""
    mantissa, _, exponent = text.partition("b")
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent or 0)


def _script(law: Law, error: float) -> str:
    """The Gappa script of one period: every rounding of law.c's outer law, in the order
    of computation.
    """
    single = law.precision == "single"
    correction, ahead = _modes(law)
    number = {
        key: hex_float(_real(law, key), "double")
        for key in ("direct", "forward_direct", "compliance")
    }
    change = Fraction(2 * error)
    lines = [f"@rnd = float<{'ieee_32' if single else 'ieee_64'}, ne>;"]
    given: list[str] = []
    asked: list[str] = []

    def sample(name: str, limit: float) -> None:
        # Any number of this precision instead of any real: Gappa then knows that it has
        # no rounding of its own.
        lines.append(f"{name} = rnd({name}_any);")
        # In hexadecimal and one double outwards: a decimal could be read back below the
        # limit.
        given.append(
            f"|{name}| <= {hex_float(math.nextafter(limit, math.inf), 'double')}"
        )

    def computed(name: str, formula: str) -> None:
        lines.append(f"{name}_computed rnd= {formula};")
        lines.append(f"{name}_exact = {formula};")
        asked.append(f"{name}_computed - {name}_exact in ?")

    def filtered(
        modes: list[_Mode],
        name: str,
        direct: str,
        driven: str,
        largest: Fraction,
        *,
        of_change: bool,
    ) -> None:
        total = f"{direct} * {driven}"
        for mode in modes:
            reach = float(mode.size(largest, of_change=of_change) * _ROOM)
            pole, gain, turn, cross = (
                hex_float(x, "double")
                for x in (mode.pole, mode.gain, mode.turn, mode.cross)
            )
            sample(f"x_{mode.tag}", reach)
            if mode.paired:
                sample(f"y_{mode.tag}", reach)
                total += f" + ({gain} * x_{mode.tag} - {cross} * y_{mode.tag})"
                computed(
                    mode.tag,
                    f"({pole} * x_{mode.tag} - {turn} * y_{mode.tag}) + {driven}",
                )
                computed(
                    f"{mode.tag}_turned",
                    f"{pole} * y_{mode.tag} + {turn} * x_{mode.tag}",
                )
            else:
                total += f" + {gain} * x_{mode.tag}"
                computed(mode.tag, f"{pole} * x_{mode.tag} + {driven}")
        computed(f"{name}_output", total)

    sample("now", error)
    sample("before", error)
    computed("change", "now - before")
    # The computed change may be one rounding above 2·error; 2^-20 is far more, and does
    # not affect the bound.
    sample("driven", 2 * error * (1 + 2.0**-20))
    filtered(correction, "sum", number["direct"], "driven", change, of_change=True)
    sample("acceleration", _real(law, "acceleration_limit"))
    filtered(
        ahead,
        "ahead",
        number["forward_direct"],
        "acceleration",
        Fraction(_real(law, "acceleration_limit")),
        of_change=False,
    )
    for name, key in (
        ("reference", "angle_limit"),
        ("angle", "angle_limit"),
        ("torque", "torque_limit"),
    ):
        sample(name, _real(law, key) * (1 + 2.0**-20))
    computed("error", f"reference - (angle - torque * {number['compliance']})")
    sample("corrected", _real(law, "sum_limit") * (1 + 2.0**-20))
    sample("forwarded", _real(law, "sum_limit") * (1 + 2.0**-20))
    computed("offset", "forwarded + corrected")
    sample("offset", 2 * _real(law, "sum_limit") * (1 + 2.0**-20))
    computed("wanted", "reference + offset")
    return "\n".join(
        (
            *lines,
            "{ " + "\n  /\\ ".join(given),
            "-> " + "\n  /\\ ".join(asked) + " }",
            "",
        )
    )
