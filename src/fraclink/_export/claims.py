"""What is claimed of an exported law: its worst-case bounds, and claims, each proved or
not.

The provers themselves are a package of their own, `fraclink_prove`; reading a proof
needs only this module.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fraclink._files import from_plain, read_json, write_json
from fraclink._law import Law

__all__ = ["Claim", "CommandBounds", "Proof", "claims_text", "worst_case"]


@dataclass(frozen=True)
class CommandBounds:
    """gain: |Ĉe| ≤ gain · max|e| for every error signal [rad/rad] (l1 norm of the exact
    coefficients).

    rounding: largest distance of the computed correction from the exact one while nothing is limited, for
    |e| ≤ `error` [rad]: one-step rounding errors times the l1 norms from where they enter to the output.
    rigorous: the sums were made in ball arithmetic, else in plain double precision.
    """

    gain: float
    rounding: float
    error: float
    rigorous: bool


def worst_case(law: Law, *, error: float = 0.5) -> CommandBounds:
    """Return the worst-case bounds of the correction for errors up to `error` [rad].

    With the modes apart, the impulse response of Ĉ is h[0] = d, h[k] = Σ g (p − 1)
    p^(k−2) + ...; its sum of moduli is taken to N and closed with the geometric tail Σ
    |g(p − 1)| |p|^(N−1)/(1 − |p|).
    """
    c = law.coefficients
    n, m = len(law.correction.poles), len(law.correction.pair_poles)
    real = np.asarray(c["real"]).reshape(-1, 2)[:n].tolist()
    pair = np.asarray(c["pair"]).reshape(-1, 4)[:m].tolist()
    poles: list[complex] = [pole for pole, _ in real] + [
        complex(a, b) for a, b, _, _ in pair
    ]
    gains: list[complex] = [gain for _, gain in real] + [
        complex(a, b) for _, _, a, b in pair
    ]
    direct = float(c["direct"])  # type: ignore[arg-type]
    slowest = max((abs(p) for p in poles), default=0.0)
    # e^(−40) = 4e-18 of the slowest mode: what is left is below the last bit of a
    # double. The cap ends the sum of a pole such as 0.99997 early, which costs
    # sharpness and no rigour, since the tail is added as a bound.
    count = (
        3 if slowest == 0 else min(200_000, max(50, math.ceil(-40 / math.log(slowest))))
    )
    gain, rigorous = _ball_norm(direct, poles, gains, count)
    return CommandBounds(
        gain, _rounding(law, direct, poles, gains, error), error, rigorous
    )


_GONE = 80.0  # |p|^k = e^(-80): 1e-35


def _ball_norm(
    direct: float, poles: list[complex], gains: list[complex], count: int
) -> tuple[float, bool]:
    try:
        from flint import acb, arb, ctx
    except ImportError:
        return _plain_norm(direct, poles, gains, count), False
    # A rectangle around a complex number grows by a factor √2 each time it is turned,
    # half a bit: more bits while a pair lives, and it is let go once no double sees it.
    lives = max(
        (math.ceil(-_GONE / math.log(abs(p))) for p in poles if isinstance(p, complex)),
        default=0,
    )
    before, ctx.prec = ctx.prec, 106 + (lives + 1) // 2
    try:
        # The coefficients are doubles: each is an exact ball, so that the norm is that
        # of the shipped numbers and not of the design they were rounded from.
        p, g = [acb(x) for x in poles], [acb(x) for x in gains]
        total = abs(arb(direct))
        power = list(g)  # g p^(k-1)
        previous, tail = arb(direct), arb(0)
        before_it = power
        for k in range(count):
            if lives and k == lives:
                pairs = [isinstance(x, complex) for x in poles]
                dropped = zip(before_it, power, p, pairs, strict=True)
                # `previous` holds what the pairs were in it: that is counted, too
                tail += sum(
                    (abs(w) + _rest(x, y) for w, x, y, pair in dropped if pair), arb(0)
                )
                power, p = (
                    [x for x, pair in zip(each, pairs, strict=True) if not pair]
                    for each in (power, p)
                )
                ctx.prec = 106
            level = sum((x.real for x in power), arb(0))
            total += abs(level - previous)  # (1 − z⁻¹) of the inner response
            previous, before_it = level, power
            power = [x * y for x, y in zip(power, p, strict=True)]
        tail += sum((_rest(x, y) for x, y in zip(power, p, strict=True)), arb(0)) + abs(
            previous
        )
        # float() rounds to nearest, perhaps below the ball's upper end: one unit in the
        # last place more is above.
        return math.nextafter(float((total + tail).upper()), math.inf), True
    finally:
        ctx.prec = before


def _rest(power: Any, pole: Any) -> Any:
    """What a mode still adds to the sum of |h[k] − h[k−1]|: Σ |g p^j (p − 1)| ≤ 2 |g
    p^k|/(1 − |p|).
    """
    return abs(power) * 2 / (1 - abs(pole))


def _plain_norm(
    direct: float, poles: list[complex], gains: list[complex], count: int
) -> float:
    # The same sum without balls: at most 200 000 terms in doubles are off by 2e-11 of
    # their sum, for which the factor 1 + 1e-9 stands.
    k = np.arange(count)
    inner = np.zeros(count + 1)
    inner[0] = direct
    tail = 0.0
    for pole, gain in zip(poles, gains, strict=True):
        inner[1:] += (gain * np.power(complex(pole), k)).real
        tail += 2 * abs(gain) * abs(pole) ** count / (1 - abs(pole))
    return float(np.abs(np.diff(inner, prepend=0.0)).sum() + tail + abs(inner[-1])) * (
        1 + 1e-9
    )


def _rounding(
    law: Law, direct: float, poles: list[complex], gains: list[complex], error: float
) -> float:
    """Sum over the modes of (largest one-step rounding) × (l1 norm from the state to
    the output).
    """
    unit = 2.0**-24 if law.precision == "single" else 2.0**-53
    # The law stores changes of the error, e[k] − e[k−1]: as large as twice the error.
    change = 2 * error
    # the change of the error is rounded once, and so is each product and each partial
    # sum of the output
    total = abs(direct) * change * unit
    partial = abs(direct) * change
    for pole, gain in zip(poles, gains, strict=True):
        # a mode that leaks slowly without turning holds e minus its average: at most 2
        # max|e|, which is `change`
        steady = isinstance(pole, float) and pole >= 0
        size = change if steady else change / (1 - abs(pole))
        # p·state is rounded, and its sum with the change: u(2|p| size + change). A pair
        # makes two products and their difference of each part, hence 3, and has two
        # parts.
        step = (
            (abs(pole) * size * 3 + change)
            * unit
            * (1 if isinstance(pole, float) else 2)
        )
        total += abs(gain) * step / (1 - abs(pole)) + abs(gain) * size * unit
        partial += abs(gain) * size
    # Every partial sum of the output is rounded; none is larger than the sum of the
    # moduli.
    terms = len(poles) + 1
    # a change that is rounded by u·change acts through the whole filter without its
    # difference
    static = abs(direct) + sum(
        abs(g) / (1 - abs(p)) for p, g in zip(poles, gains, strict=True)
    )
    return total + terms * partial * unit + static * change * unit


KIND, FORMAT = "proof", 1
Status = Literal["proved", "failed", "not proved"]


@dataclass(frozen=True)
class Claim:
    """One statement about the exported files and what became of it.

    Attributes
    ----------
    name
        "outputs", "finite", "slew", "rounding" or "loop".
    statement
        what is proved where `status` is "proved", in words and numbers.
    status
        "proved"; "failed": a tool found that it does not hold; "not proved": nothing
        decided it.
    reason
        why it is not proved: the alarm, the counterexample, the missing tool with its
        Debian package.
    tools
        who decided it, with versions.
    logs
        files below the folder that show it, and their SHA-256.
    """

    name: str
    statement: str
    status: Status
    reason: str = ""
    tools: tuple[str, ...] = ()
    logs: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Proof:
    """The claims about one exported folder.

    Attributes
    ----------
    law
        SHA-256 of the law's parameter block.
    sources
        SHA-256 of law.h, law.c and the header of coefficients: the proof is about these
        bytes.
    claims
        every claim that was tried.
    """

    law: str
    sources: Mapping[str, str]
    claims: tuple[Claim, ...]

    @property
    def passed(self) -> bool:
        """Whether every claim is proved."""
        # An open claim is no failure of the law, and yet no proof of it: the whole is
        # as good as its worst part.
        return all(claim.status == "proved" for claim in self.claims)

    def __getitem__(self, name: str) -> Claim:
        return next(claim for claim in self.claims if claim.name == name)

    def __str__(self) -> str:
        return "\n".join(
            f"{claim.status}: {claim.statement}"
            + (f" [{claim.reason}]" if claim.reason else "")
            for claim in self.claims
        )

    def save(self, path: Path | str) -> None:
        """Write the proof to one JSON file."""
        # "passed" is for people and other programs; `load` leaves it out and asks the
        # claims again, so that an edited verdict changes nothing.
        write_json(path, KIND, FORMAT, {"passed": self.passed} | asdict(self))

    @staticmethod
    def load(path: Path | str) -> Proof:
        """Read a proof back; FileFormatError for another file."""
        data = read_json(path, KIND, (FORMAT,))
        return from_plain(
            Proof,
            {
                field.name: data[field.name]
                for field in fields(Proof)
                if field.name in data
            },
        )


NOT_CLAIMED = """\
Anything about the compiler; about a motor loop that is not the one designed for; about Coulomb friction,
modes of the link that nothing above names, saturation, a payload that changes in a move (simulated only);
about the physical robot.
"""


NOT_CLAIMED_OF_PID = """\
Anything about the compiler; about the plant and the stability of its loop, which the tuning computes and
does not prove; about the rounding of the integral.
"""


def claims_text(law: Law, proof: Proof | None) -> str:
    """Return the sections "Claimed" and "Not claimed" of README.md."""
    open_ = NOT_CLAIMED if law.has_gauge else NOT_CLAIMED_OF_PID
    built = "For this `law.c`, compiled as ISO C99 without fast-math and with contraction off:"
    if proof is None:
        voltage = (
            f" and `voltage` within ±{law.drive.voltage_limit:g} V"
            if law.drive is not None
            else ""
        )
        claimed = (
            f"{built} whatever the inputs (NaN and\n"
            "infinities among them) and whatever the state memory holds, no undefined behaviour, both\n"
            f"commands finite, `motor_reference` within ±{law.limits.motor_limit:.6g} rad{voltage}.\n"
            "This was proved for the designs of fraclink's own tests, not for this one: `fraclink export c\n"
            "... --prove` proves it for this one, and more.\n"
        )
        stability = (
            "Stability of the loop is the design's matter.\n" if law.has_gauge else ""
        )
        return f"## Claimed\n{claimed}\n## Not claimed\n{open_}{stability}"
    proved = [claim for claim in proof.claims if claim.status == "proved"]
    rest = [claim for claim in proof.claims if claim.status != "proved"]
    # Hashes are cut to 12 digits, 48 bits: enough to tell two logs apart; proof.json
    # has them whole.
    text = f"## Proved\n{built}\n\n" + "\n".join(map(_proved, proved)) if proved else ""
    if rest:
        text += "\n\n## Not proved\n" + "\n".join(_open(claim) for claim in rest)
    listed = "`proof.json` lists the tools and the hashes of all files named here."
    return f"{text.strip()}\n\n{listed}\n\n## Not claimed\n{open_}"


def _proved(claim: Claim) -> str:
    shown = ", ".join(f"`{file}` {digest[:12]}" for file, digest in claim.logs)
    return _item(f"{claim.statement}. ({', '.join(claim.tools)}: {shown})")


def _open(claim: Claim) -> str:
    word = "does not hold" if claim.status == "failed" else "not proved"
    return _item(f"{claim.statement}: {word}. {claim.reason}.")


def _item(text: str) -> str:
    return textwrap.fill(
        text,
        105,
        initial_indent="- ",
        subsequent_indent="  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
