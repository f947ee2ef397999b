"""The rig: everything that is known about one flexible arm before a log is read, in one TOML file."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from fraclink._arm.experiment import Channel, LogColumns
from fraclink._arm.link import LinkModel, SecondMode
from fraclink._arm.motor_loop import LONGEST_DELAY, MotorLoop
from fraclink._arm.tables import parse_toml, read_table, read_toml, suggestion, table_of, toml_text
from fraclink._files import document, stored_as, write_text
from fraclink._validate import Between, Frequency, Length, Payload, Period, Where, checked
from fraclink.errors import FieldError, FileFormatError
from fraclink.findings import Finding

__all__ = ["DesignDefaults", "Encoder", "Gauge", "Link", "Motor", "Payloads", "Rig", "Tolerances"]

_FOLDER = Path(__file__).resolve().parents[1] / "rigs"
_AGREEMENT = 0.02  # two measurements of one stiffness agree to about 2 %; the paper's differ by 30 %
# Gram and kilogram are 1000 apart, and no arm carries payloads a hundred times beyond its own range.
_ANOTHER_UNIT = 100.0
# Products of a handful of values between these stay far from overflow (1e308) and underflow.
_SMALLEST, _LARGEST = 1e-15, 1e15


def _positive(unit: str = "") -> Between:
    return Between(_SMALLEST, _LARGEST, unit)


def _at_least_zero(unit: str = "") -> Between:
    return Between(0.0, _LARGEST, unit)


def _limit(unit: str) -> Between:
    return Between(_SMALLEST, math.inf, unit, finite=False)


def _is_unicode(text: str) -> bool:
    return not any(0xD800 <= ord(character) <= 0xDFFF for character in text)


_UNICODE = Where(_is_unicode, "Unicode text", "not valid Unicode (a lone surrogate)", "remove that character")
Name = Annotated[str, Length(1, 100), _UNICODE]
Source = Annotated[str, Length(0, 500), _UNICODE]
Sentence = Annotated[str, Length(1, 500), _UNICODE]


@checked(prefix="motor.")
@dataclass(frozen=True)
class Motor:
    """The motor with its servo-amplifier and gear, eq. (1) of the source paper.

    With everything but `gear_ratio` n referred to the motor's side of the gear,

        J n θm'' + ν n θm' = K V − sign(θm') Γc − Γ/n,      θm/V = A/(s(s + B)),  A = K/(nJ),  B = ν/J

    where θm is the angle of the gear's output. With n = 1 this is eq. (1).

    Parameters
    ----------
    inertia
        J [kg·m²], > 0.
    viscous_friction
        ν [N·m·s], >= 0.
    torque_constant
        K [N·m/V], > 0: motor torque for one volt at the amplifier's input.
    gear_ratio
        n, motor turns for one turn of the output, > 0; 1 where J, ν, K are already at the output.
    coulomb_torque
        Γc [N·m], >= 0, at the motor.
    voltage_limit
        |V| that the amplifier accepts [V], > 0; infinity where there is none.

    Raises
    ------
    FieldError
        a value out of its range.

    References
    ----------
    Benftima, Gharab, Feliu-Batlle (2023), eq. (1), Table 1.

    Examples
    --------
    >>> motor = Motor(inertia=6.87e-5, viscous_friction=1.041e-3, torque_constant=0.21)
    >>> round(motor.gain, 4), round(motor.decay, 6)
    (3056.7686, 15.152838)
    """

    inertia: Annotated[float, _positive("kg·m²")]
    viscous_friction: Annotated[float, _at_least_zero("N·m·s")]
    torque_constant: Annotated[float, _positive("N·m/V")]
    gear_ratio: Annotated[float, _positive()] = 1.0
    coulomb_torque: Annotated[float, _at_least_zero("N·m")] = 0.0
    voltage_limit: Annotated[float, _limit("V")] = math.inf

    @property
    def gain(self) -> float:
        """A = K/(nJ) [rad/(V·s²)] of eq. (1)."""
        return self.torque_constant / (self.gear_ratio * self.inertia)

    @property
    def decay(self) -> float:
        """B = ν/J [1/s] of eq. (1)."""
        return self.viscous_friction / self.inertia


@checked(prefix="link.")
@dataclass(frozen=True)
class Link:
    """The flexible link: length L [m], flexural rigidity EI [N·m²], measured stiffness c [N·m/rad] > 0.

    A stiffness that is left out is c = 3EI/L of a uniform beam, eq. (3). The `mass` [kg] is the link's own:
    the lumped models neglect it, the twin does not.

    >>> round(Link(length=0.65, flexural_rigidity=0.260).stiffness, 12)
    1.2
    """

    length: Annotated[float, _positive("m")]
    flexural_rigidity: Annotated[float, _positive("N·m²")]
    # None stands for "not measured" in the call only: the attribute is always a number.
    stiffness: Annotated[float, _positive("N·m/rad")] = None  # type: ignore[assignment]
    mass: Annotated[float, _at_least_zero("kg")] = 0.0

    def __post_init__(self) -> None:
        if self.stiffness is None:
            object.__setattr__(self, "stiffness", self.beam_stiffness)

    @property
    def beam_stiffness(self) -> float:
        """3EI/L [N·m/rad], the stiffness of a uniform beam clamped at the motor."""
        return 3 * self.flexural_rigidity / self.length


@checked(prefix="payloads.")
@dataclass(frozen=True)
class Payloads:
    """The payloads that the arm carries: lightest, heaviest and nominal mass [kg], low <= nominal <= high.

    >>> Payloads(low=0.020, high=0.040, nominal=0.030).nominal
    0.03
    """

    low: Annotated[float, _positive("kg")]
    high: Annotated[float, _positive("kg")]
    nominal: Annotated[float, _positive("kg")]

    def __post_init__(self) -> None:
        if self.low > self.high:
            problem, allowed = f"above payloads.high = {self.high:g} kg", "low <= nominal <= high [kg]"
            raise FieldError("payloads.low", self.low, problem, allowed=allowed, remedy="exchange the two")
        if not self.low <= self.nominal <= self.high:
            raise FieldError(
                "payloads.nominal",
                self.nominal,
                "outside the payload range",
                allowed=f"{self.low:g} … {self.high:g} kg",
                remedy="choose a nominal payload between low and high",
            )

    def doubt(self, payload: float) -> Finding | None:
        """Return finding W105 where a payload [kg] is so far off the range that its unit must be wrong.

        >>> finding = Payloads(low=0.020, high=0.040, nominal=0.030).doubt(30)
        >>> finding.message
        'a payload of 30 kg is 750 times the heaviest that the rig states'
        """
        if self.low / _ANOTHER_UNIT <= payload <= self.high * _ANOTHER_UNIT:
            return None
        nearest, word = (self.high, "heaviest") if payload > self.high else (self.low, "lightest")
        return Finding(
            "W105",
            "warning",
            f"a payload of {payload:.4g} kg is {payload / nearest:.3g} times the {word} that the rig states",
            {"payload": payload, "low": self.low, "high": self.high},
            "payloads are stated in kg: 30 g is 0.030",
        )


@checked(prefix="encoder.")
@dataclass(frozen=True)
class Encoder:
    """The encoder of the gear's output: counts for one turn, or None where it is taken as exact.

    >>> round(Encoder(counts_per_revolution=4096).resolution, 6)
    0.001534
    """

    counts_per_revolution: Annotated[int | None, Between(1, 10**15)] = None

    @property
    def resolution(self) -> float:
        """Angle of one count [rad]; 0 where the encoder is taken as exact."""
        return 0.0 if self.counts_per_revolution is None else 2 * math.pi / self.counts_per_revolution


@checked(prefix="gauge.")
@dataclass(frozen=True)
class Gauge:
    """The strain gauges at the base of the link, calibrated as coupling torque.

    Parameters
    ----------
    noise
        standard deviation of the noise of one sample [N·m], >= 0.
    offset
        constant added to every reading [N·m].
    limit
        largest |torque| that the amplifier shows [N·m], > 0; infinity where there is none.
    quantum
        step of the converter [N·m], >= 0; 0 where it is taken as exact.
    delay_in_loop
        whether a delay that is identified between motor angle and torque is in the control loop; False where
        the logger alone is late, not the signal that the controller reads.

    Examples
    --------
    >>> Gauge(noise=0.01).limit
    inf
    """

    noise: Annotated[float, _at_least_zero("N·m")] = 0.0
    offset: Annotated[float, Between(-_LARGEST, _LARGEST, "N·m")] = 0.0
    limit: Annotated[float, _limit("N·m")] = math.inf
    quantum: Annotated[float, _at_least_zero("N·m")] = 0.0
    delay_in_loop: bool = True


@checked(prefix="design.")
@dataclass(frozen=True)
class DesignDefaults:
    """What a design for this rig reaches where the call does not say: the `[design]` table.

    `gain_crossover` [rad/s] and `phase_margin_deg` [°] are the least over the payload range; `filter_time`
    δ [s] is 0 for no filter and None for the 10 % rule.

    >>> round(DesignDefaults(gain_crossover=12.0, phase_margin_deg=50.0).phase_margin, 6)
    0.872665
    """

    gain_crossover: Frequency
    phase_margin_deg: Annotated[float, Between(0.0, 179.0, "°", low_open=True)]
    filter_time: Annotated[float | None, _at_least_zero("s")] = None

    @property
    def phase_margin(self) -> float:
        """Least phase margin [rad]."""
        return math.radians(self.phase_margin_deg)


@checked(prefix="tolerances.")
@dataclass(frozen=True)
class Tolerances:
    """How far the arm may differ from its model: what a proof covers, at least, beyond what a fit is sure of.

    natural_frequency, gauge_gain and motor_pole are relative [1]; order λ is absolute [1]; gauge_delay is the
    largest delay beyond the identified one [s]. The defaults are a careful laboratory's: 3 % of ω₀², a strain
    gauge calibrated to 5 %, half a period of an undeclared delay at 4 ms.

    >>> Tolerances().order
    0.03
    """

    natural_frequency: Annotated[float, Between(0.0, 0.5)] = 0.015
    order: Annotated[float, Between(0.0, 0.5)] = 0.03
    gauge_gain: Annotated[float, Between(0.0, 0.9)] = 0.05
    gauge_delay: Annotated[float, Between(0.0, 1.0, "s")] = 0.002
    motor_pole: Annotated[float, Between(0.0, 0.9)] = 0.10


@checked
@dataclass(frozen=True)
class Rig:
    """One flexible-link robot: motor, link, payloads, sensors, sampling period, and what was assumed.

    Parameters
    ----------
    name
        how reports call it.
    motor, link, payloads, encoder, gauge
        its parts.
    period
        sampling period Ts [s], > 0 and <= 10.
    motor_loop
        the loop that closes the motor: pole [rad/s] and computation delay [samples].
    model
        link model that the file carries, or None.
    log
        which column of a log is what, or None.
    design
        what a design reaches where the call does not say, or None.
    tolerances
        how far the arm may differ from its model.
    assumptions
        sentences on values that nobody measured, shown in every report.
    source
        where the values come from.

    `warnings` lists contradictions between the values (codes W101 …).

    Raises
    ------
    FieldError
        a value out of its range.

    References
    ----------
    Benftima, Gharab, Feliu-Batlle (2023), section 2 and Table 1.

    Examples
    --------
    >>> rig = Rig.named("paper-2023")
    >>> rig.link.stiffness, rig.period
    (1.56, 0.004)
    """

    name: Name
    motor: Motor
    link: Link
    payloads: Payloads
    period: Period
    encoder: Encoder = field(default_factory=Encoder)
    gauge: Gauge = field(default_factory=Gauge)
    motor_loop: MotorLoop = field(default_factory=MotorLoop)
    model: LinkModel | None = None
    log: LogColumns | None = None
    design: DesignDefaults | None = None
    assumptions: tuple[Sentence, ...] = ()
    source: Source = ""
    tolerances: Tolerances = field(default_factory=Tolerances)

    @staticmethod
    def named(name: str) -> Rig:
        """Return a rig that comes with the package; `Rig.names()` lists them.

        >>> Rig.named("paper")
        Traceback (most recent call last):
        fraclink.errors.FieldError: rig: unknown (got paper); expected paper-2023. Did you mean 'paper-2023'?
        """
        names = Rig.names()
        if name not in names:
            remedy = suggestion(str(name), names) or "give one of these, or the path of your own file"
            raise FieldError("rig", name, "unknown", allowed=", ".join(names), remedy=remedy)
        return Rig.load(_FOLDER / f"{name}.toml")

    @staticmethod
    def names() -> tuple[str, ...]:
        """The names of the rigs that come with the package.

        >>> Rig.names()
        ('paper-2023',)
        """
        return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))

    @staticmethod
    def load(path: Path | str) -> Rig:
        """Read a rig file; every fault of it is listed at once.

        Raises FileFormatError (not TOML, or over its limits), FieldError (a value) or FileFaults (several).
        """
        place = Path(path)
        if not place.is_file():
            remedy = f"check the path; rigs by name: {', '.join(Rig.names())}"
            raise FileFormatError("rig", str(path), "not a file", allowed="a rig file (TOML)", remedy=remedy)
        return Rig.from_tables(read_toml(place))

    @staticmethod
    def from_tables(data: Any) -> Rig:
        """Return the rig of a file's tables; FieldError for one fault, FileFaults for several."""
        # Until the motor loop had one name everywhere, its table was called [inner_loop].
        names = {"inner_loop": "motor_loop"} if isinstance(data, dict) and "motor_loop" not in data else {}
        if isinstance(data, dict):
            data = {names.get(name, name): table for name, table in data.items()}
        file: _RigFile = read_table(_RigFile, data)
        return file.build()

    @property
    def inner(self) -> MotorLoop:
        """The motor loop, under the name that some packages still use."""
        return self.motor_loop

    def tables(self) -> dict[str, Any]:
        """Return the tables of the rig's file: SI units, plain values; `from_tables` reads them back."""
        return table_of(_RigFile.of(self))

    @staticmethod
    def from_toml(text: str) -> Rig:
        """Return the rig of a file's text; see `load`."""
        return Rig.from_tables(parse_toml(text, Path("rig")))

    def to_toml(self) -> str:
        """Return the rig file of this rig; `load` reads back an equal one."""
        from fraclink import __version__

        return f"# Written by fraclink {__version__}.\n{toml_text(self.tables())}"

    def save(self, path: Path | str) -> None:
        """Write the rig to one TOML file that `Rig.load` reads back equal."""
        write_text(path, self.to_toml())

    @checked
    def natural_frequency(self, payload: Payload) -> float:
        """ω₀ = √(c/(m L²)) of a payload m [kg] > 0, eq. (5), in s^(−λ/2): rad/s for λ = 2 only.

        >>> round(Rig.named("paper-2023").natural_frequency(0.030), 4)
        11.094
        """
        return _lumped_frequency(self.link.stiffness, payload, self.link.length)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Contradictions between the rig's own values, each with both of them."""
        link, model = self.link, self.model
        found = [self._stiffness_finding()]
        if model is not None:
            stated = ("model.stiffness", model.stiffness)
            found.append(_contradiction("W102", *stated, "link.stiffness", link.stiffness))
        if model is not None and model.payload is not None:
            lumped = (f"eq. (5) at {model.payload:g} kg", self.natural_frequency(model.payload))
            found.append(_contradiction("W103", "model.natural_frequency", model.natural_frequency, *lumped))
        return tuple(finding for finding in (*found, self._mass_finding()) if finding is not None)

    def _stiffness_finding(self) -> Finding | None:
        stated, computed = self.link.stiffness, self.link.beam_stiffness
        if abs(stated - computed) <= _AGREEMENT * computed:
            return None
        return Finding(
            "W101",
            "warning",
            f"link.stiffness = {stated:.6g} N·m/rad contradicts 3EI/L = {computed:.6g} N·m/rad",
            {"stiffness": stated, "beam_stiffness": computed},
            "fraclink uses the stated stiffness; measure it, or correct EI or L",
        )

    def _mass_finding(self) -> Finding | None:
        if self.link.mass <= self.payloads.low:
            return None
        return Finding(
            "W104",
            "info",
            f"the link ({self.link.mass:g} kg) outweighs the lightest payload ({self.payloads.low:g} kg): "
            "one vibration mode may not be enough",
            {"link_mass": self.link.mass, "lightest_payload": self.payloads.low},
            "look at the residual of the fit above the first resonance",
        )


def _lumped_frequency(stiffness: float, mass: float, length: float) -> float:
    return math.sqrt(stiffness / (mass * length**2))


def _contradiction(code: str, first: str, value: float, second: str, other: float) -> Finding | None:
    if abs(value - other) <= _AGREEMENT * other:
        return None
    return Finding(
        code,
        "warning",
        f"{first} = {value:.6g} contradicts {second} = {other:.6g}",
        {"stated": value, "expected": other},
        f"fraclink uses {first}; correct the one that is wrong",
    )


# --- the file: one class a table, where it differs from the object that it becomes -----------------------


@checked(prefix="motor_loop.")
@dataclass(frozen=True)
class _MotorLoopTable:
    pole: Frequency = MotorLoop.pole
    delay_samples: Annotated[int, Between(0, LONGEST_DELAY, "samples")] = MotorLoop.delay_samples


@checked(prefix="model.second_mode.")
@dataclass(frozen=True)
class _SecondModeTable:
    frequency: Frequency
    gain: Annotated[float, Between(0.0, 1e3, low_open=True)]
    damping_ratio: Annotated[float, Between(0.0, 1.0, low_open=True, high_open=True)] = 0.02


@checked(prefix="model.")
@dataclass(frozen=True)
class _ModelTable:
    """What it leaves out follows from the link and the nominal payload."""

    order: Annotated[float, Between(1.0, 2.0, low_open=True)]
    stiffness: Annotated[float | None, _positive("N·m/rad")] = None
    natural_frequency: Annotated[float | None, _positive("s^(-order/2)")] = None
    damping: Annotated[float, _at_least_zero()] = 0.0
    damping_order: Annotated[float, Between(0.0, 2.0)] = 1.0
    payload: Annotated[float | None, _positive("kg")] = None
    gauge_delay: Annotated[float | None, Between(-10.0, 10.0, "s")] = None
    gauge_gain: Annotated[float | None, Between(-1e6, 1e6)] = None
    second_mode: _SecondModeTable | None = None
    unseen_up_to: Annotated[float | None, _positive("rad/s")] = None
    intervals: dict[str, tuple[float, float]] | None = None

    def build(self, link: Link, payloads: Payloads) -> LinkModel:
        """Return the link model, with eq. (5) where the file states no natural frequency."""
        stiffness, payload = self.stiffness or link.stiffness, self.payload or payloads.nominal
        mode = self.second_mode
        second = None if mode is None else SecondMode(mode.frequency, mode.gain, mode.damping_ratio)
        return LinkModel(
            stiffness=stiffness,
            natural_frequency=self.natural_frequency or _lumped_frequency(stiffness, payload, link.length),
            order=self.order,
            damping=self.damping,
            damping_order=self.damping_order,
            payload=payload,
            gauge_delay=self.gauge_delay or 0.0,
            gauge_gain=1.0 if self.gauge_gain is None else self.gauge_gain,
            second_mode=second,
            unseen_up_to=self.unseen_up_to,
            intervals=tuple((name, *pair) for name, pair in (self.intervals or {}).items()),
        )

    @staticmethod
    def of(model: LinkModel) -> _ModelTable:
        """Return the table of a link model; an ideal gauge is left out."""
        mode = model.second_mode
        second = None if mode is None else _SecondModeTable(mode.frequency, mode.gain, mode.damping_ratio)
        return _ModelTable(
            order=model.order,
            stiffness=model.stiffness,
            natural_frequency=model.natural_frequency,
            damping=model.damping,
            damping_order=model.damping_order,
            payload=model.payload,
            gauge_delay=model.gauge_delay or None,
            gauge_gain=None if model.gauge_gain == 1.0 else model.gauge_gain,
            second_mode=second,
            unseen_up_to=model.unseen_up_to,
            intervals={name: (low, high) for name, low, high in model.intervals} or None,
        )


@checked(prefix="log.")
@dataclass(frozen=True)
class _LogTable:
    time: Channel
    motor_angle: Channel
    torque: Channel | None = None
    deflection: Channel | None = None
    voltage: Channel | None = None

    def __post_init__(self) -> None:
        self.build()  # so that a unit of another quantity is among the faults of the file

    def build(self) -> LogColumns:
        """Return the columns; FieldError where there is not one output, or a unit measures something else."""
        outputs = {"torque": self.torque, "deflection": self.deflection}
        stated = [(kind, channel) for kind, channel in outputs.items() if channel is not None]
        if len(stated) != 1:
            raise FieldError(
                "log",
                " and ".join(kind for kind, _ in stated) or "(no output)",
                "not one output",
                allowed="torque or deflection",
                remedy="state exactly one of log.torque and log.deflection",
            )
        return LogColumns(self.time, self.motor_angle, stated[0][1], stated[0][0], self.voltage)  # type: ignore[arg-type]


@checked
@dataclass(frozen=True, kw_only=True)
class _RigFile:
    """A rig file: its keys and tables in the order in which they are written."""

    format: Annotated[int, Between(1, 1)] = 1
    name: Name
    source: Source | None = None
    period: Period | None = None
    period_ms: Annotated[float | None, Between(0.0, 10_000.0, "ms", low_open=True)] = None
    assumptions: tuple[Sentence, ...] = ()
    motor: Motor
    link: Link
    payloads: Payloads
    encoder: Encoder = field(default_factory=Encoder)
    gauge: Gauge = field(default_factory=Gauge)
    motor_loop: _MotorLoopTable = field(default_factory=_MotorLoopTable)
    model: _ModelTable | None = None
    design: DesignDefaults | None = None
    tolerances: Tolerances | None = None
    log: _LogTable | None = None

    def __post_init__(self) -> None:
        if (self.period is None) == (self.period_ms is None):
            raise FieldError(
                "period_ms" if self.period is None else "period_s",
                "(nothing)" if self.period is None else self.period,
                "missing" if self.period is None else "given twice, as period_s and as period_ms",
                allowed="one sampling period",
                remedy="state the control period as period_ms = … or period_s = …",
            )

    def build(self) -> Rig:
        """Return the rig that the file describes."""
        return Rig(
            name=self.name,
            motor=self.motor,
            link=self.link,
            payloads=self.payloads,
            period=self.period_ms / 1000 if self.period is None else self.period,  # type: ignore[operator]
            encoder=self.encoder,
            gauge=self.gauge,
            motor_loop=MotorLoop(self.motor_loop.pole, self.motor_loop.delay_samples),
            model=None if self.model is None else self.model.build(self.link, self.payloads),
            log=None if self.log is None else self.log.build(),
            design=self.design,
            assumptions=self.assumptions,
            source=self.source or "",
            tolerances=self.tolerances or Tolerances(),
        )

    @staticmethod
    def of(rig: Rig) -> _RigFile:
        """Return the file that describes `rig`."""
        return _RigFile(
            name=rig.name,
            motor=rig.motor,
            link=rig.link,
            payloads=rig.payloads,
            source=rig.source or None,
            period=rig.period,
            assumptions=rig.assumptions,
            encoder=rig.encoder,
            gauge=rig.gauge,
            motor_loop=_MotorLoopTable(rig.motor_loop.pole, rig.motor_loop.delay_samples),
            model=None if rig.model is None else _ModelTable.of(rig.model),
            design=rig.design,
            tolerances=None if rig.tolerances == Tolerances() else rig.tolerances,
            log=None if rig.log is None else _LogTable(**rig.log.channels()),
        )


def _stored(data: Any) -> Rig:
    """The rig inside another document: its tables, or the text of its file as the first formats had it."""
    return Rig.from_toml(data) if isinstance(data, str) else Rig.from_tables(data)


document("rig", container="toml")(Rig)
stored_as(Rig, write=Rig.tables, read=_stored)
