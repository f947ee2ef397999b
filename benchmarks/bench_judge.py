"""What ships is what passed: one law, judged by its proof, by the package's moves, and
by an independent arm: lumped_arm.c around the files of an export.

Each part has an option for its size; 0 omits it. The number of a case is its seed.
"""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fraclink as fl
from fraclink import extend, lab, trials
from fraclink.errors import FraclinkError
from harness import line, sizes

Real = NDArray[np.float64]
HERE = Path(__file__).parent
RIG = fl.Rig.named("paper-2023-geared")
RUN, OFF = 1, 4  # modes of law.h
GAUGE_STUCK = 7
MOVE = fl.smooth_step(1.0, duration=0.5)


# --- the arm ------------------------------------------------------------------------------------------


class ArmParams(ctypes.Structure):
    """`arm_params` of lumped_arm.c."""

    _fields_ = [
        *((name, ctypes.c_double) for name in (
            "inertia", "friction", "coulomb", "torque_per_volt", "stiffness", "damping",
            "tip_inertia", "gauge_gain", "gauge_delay", "gauge_noise", "gauge_quantum",
            "encoder_step", "period",
        )),
        ("voltage_delay", ctypes.c_int32),
        ("seed", ctypes.c_uint32),
    ]  # fmt: skip


def arm_of(
    rig: fl.Rig,
    payload: float,
    *,
    ratio: float,
    stiffness: float | None = None,
    delay: float = 0.0,
    gain: float = 1.0,
    seed: int = 0,
) -> ArmParams:
    """Return the arm of a rig with damping `ratio` of its link at `payload` [kg]."""
    motor, n = rig.motor, rig.motor.gear_ratio
    spring = rig.link.stiffness if stiffness is None else stiffness
    inertia = (payload + rig.link.tip_mass) * rig.link.length**2
    return ArmParams(
        inertia=n**2 * motor.inertia,
        friction=n**2 * motor.viscous_friction,
        coulomb=n * motor.coulomb_torque,
        torque_per_volt=n * motor.torque_constant,
        stiffness=spring,
        damping=2.0 * ratio * math.sqrt(spring * inertia),
        tip_inertia=inertia,
        gauge_gain=gain,
        gauge_delay=delay,
        gauge_noise=rig.gauge.noise,
        gauge_quantum=rig.gauge.quantum,
        encoder_step=rig.encoder.resolution,
        period=rig.period,
        voltage_delay=rig.motor_loop.delay_samples,
        seed=seed,
    )


@dataclass(frozen=True)
class Moved:
    """What a move of the arm led to, one value a period."""

    tip: Real
    voltage: Real
    mode: NDArray[np.uint8]
    reason: NDArray[np.uint8]
    reference: Real
    period: float

    @property
    def settled(self) -> bool:
        """Whether the law runs, and the tip stays within 2 % for the last fifth."""
        last = len(self.tip) // 5
        away = np.abs(self.tip - self.reference)[-last:]
        return bool(self.mode[-1] == RUN and np.max(away) < 0.02)


class Harness:
    """The exported law.c and estimator with the arm, compiled for this machine."""

    def __init__(self, folder: Path, law: fl.Law) -> None:
        extend_with = extend.payload_estimator(RIG.model, RIG, law, (0.02, 0.04))
        fl.export_c(law, folder, estimator=extend_with, force=True)
        library = folder / "arm.so"
        single = ("-DLAW_SINGLE",) if law.precision == "single" else ()
        flags = ("-std=c99", "-ffp-contract=off", "-O2", "-shared", "-fPIC", *single)
        sources = (folder / "law.c", folder / "payload_estimator.c")
        command = (*flags, f"-I{folder}", HERE / "lumped_arm.c", *sources)
        compiler = shutil.which("cc") or "cc"
        subprocess.run((compiler, *command, "-o", library), check=True)  # noqa: S603
        self.c = ctypes.CDLL(str(library))
        self.words = int(self.c.state_words())
        self.estimator_words = int(self.c.estimator_words())

    def move(
        self,
        law: fl.Law,
        arm: ArmParams,
        move: fl.Reference = MOVE,
        *,
        duration: float = 4.0,
        told: float = 0.0,
        called: NDArray[np.uint8] | None = None,
        stuck: int = -1,
        bank: extend.PayloadEstimator | None = None,
    ) -> Moved:
        """Run a move on the arm."""
        count = round(duration / law.period)
        time = law.period * np.arange(count)
        reference, acceleration = move.angle(time), move.acceleration(time)
        everywhere = np.ones(count, dtype=np.uint8) if called is None else called
        tip, voltage = np.empty(count), np.empty(count)
        mode, reason = (np.empty(count, dtype=np.uint8) for _ in range(2))
        self.c.arm_run(
            law.block, bank and bank.block, ctypes.byref(arm), count,
            _at(reference), _at(acceleration), ctypes.c_double(told), _at(everywhere),
            stuck, _at(tip), _at(voltage), _at(mode), _at(reason),
        )  # fmt: skip
        return Moved(tip, voltage, mode, reason, reference, law.period)

    def record(
        self, rig: fl.Rig, arm: ArmParams, reference: Real, gain: float, rate: float
    ) -> fl.Experiment:
        """Record a log of the arm under a PD loop of its motor."""
        angle, torque, voltage = (np.empty(len(reference)) for _ in range(3))
        self.c.arm_record(
            ctypes.byref(arm), len(reference), _at(reference), ctypes.c_double(gain),
            ctypes.c_double(rate), ctypes.c_double(rig.motor.voltage_limit),
            _at(angle), _at(torque), _at(voltage),
        )  # fmt: skip
        return fl.Experiment(
            period=rig.period, motor_angle=angle, output=torque, voltage=voltage,
            payload=rig.payloads.nominal,
        )  # fmt: skip


def _at(values: NDArray[Any]) -> Any:
    return np.ascontiguousarray(values).ctypes.data_as(ctypes.c_void_p)


# --- design → certify → export c → checker ------------------------------------------------------------


def chain(tuned: int) -> None:
    """Follow the documented commands with nothing but their defaults."""
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        answers = {
            "design": _plain_chain(place / "plain"),
            "demo": _checked_folder(_demo(place / "demo")),
        }
        for seed in range(tuned):
            folder = _tuned(place / f"tuned-{seed}", seed)
            if folder is not None:
                answers[f"tune {seed}"] = _checked_folder(folder)
    line(
        "design, certify, export c, checker with defaults",
        str(answers),
        "PROVED",
        set(answers.values()) == {"PROVED"},
    )


def _fraclink(*words: str | Path) -> None:
    """Run a command; its exit code is a verdict, and its files contain the rest."""
    command = (sys.executable, "-m", "fraclink", *words)
    subprocess.run(command, check=False, capture_output=True)  # noqa: S603


def _plain_chain(folder: Path) -> str:
    folder.mkdir()
    design, proof = folder / "design.json", folder / "certificate.json"
    asked = ["--gain-crossover", "12", "--phase-margin-deg", "50"]
    loads = ["--payloads", "0.020", "0.040"]
    _fraclink("design", "--rig", "paper-2023", *loads, *asked, "--out", design)
    _fraclink("certify", design, "--out", proof)
    return _checked_folder(folder)


def _demo(folder: Path) -> Path:
    rig = ("--rig", "paper-2023-geared")
    _fraclink("run", *rig, "--log", "demo", "--out", folder, "--certify", "--arms", "0")
    return folder


def _tuned(folder: Path, seed: int) -> Path | None:
    twin = fl.Twin.from_rig(RIG, payload=0.025 + 0.002 * seed, link_mass=0.00735)
    arm = lab.SimulatedArm(twin, RIG.period, seed=seed)
    limits = fl.MotionLimits(0.6, 4.0, 1.5, 10.0)
    plan = fl.TuningPlan(limits, 0.030, (0.024, 0.0375), RIG.period, RIG)
    tuning = fl.tune(arm.callback, plan, out=folder, clock="none")
    return folder if tuning.has_law else None


def _checked_folder(folder: Path) -> str:
    """Export the folder's design, and check its certificate against that law."""
    proof = folder / "certificate.json"
    if not proof.exists():
        return "no certificate"
    _fraclink("export", "c", folder / "design.json", "--out", folder / "firmware")
    checker = HERE.parent / "tools" / "check_certificate.py"
    header = folder / "firmware" / "law_data.h"
    command = (sys.executable, str(checker), str(proof), str(header))
    answer = subprocess.run(command, check=False, capture_output=True, text=True)  # noqa: S603
    return (answer.stdout + answer.stderr).partition(":")[0]


# --- changed laws -------------------------------------------------------------------------------------


class ChangedLaw(fl.Law):
    """A law with one field of its block changed after everything was derived."""

    @property
    def values(self) -> dict[str, Any]:
        """The fields of the block, as `change` leaves them."""
        values = dict(super().values)
        for name, factor in self.__dict__["change"].items():
            old = values[name]
            values[name] = (
                [factor * x for x in old]
                if isinstance(old, list)
                else type(old)(factor * old)
            )
        return values


def changed_law(law: fl.Law, change: dict[str, float]) -> fl.Law:
    """Return the law with the named fields of its block multiplied by their factors."""
    values = {item.name: getattr(law, item.name) for item in fields(fl.Law)}
    made = ChangedLaw(**values)
    made.__dict__["change"] = change
    return made


PID = (
    "inner_direct", "inner_angle", "integral_now", "integral_before", "filter_now",
    "filter_before", "filter_angle_now", "filter_angle_before",
)  # fmt: skip
# The ways in which an earlier certificate was presented with a law other than the one
# that runs.
KNOWN = (
    *(dict.fromkeys(PID, factor) for factor in (-1.0, 0.02, 30.0)),
    {"forward": 10.0, "forward_direct": 10.0},
    {"forward": 1.05},
    *({name: 1e-3} for name in (
        "angle_limit", "angle_step", "residual_angle", "frozen_angle", "torque_limit",
        "torque_step", "motor_limit", "stuck_limit", "reference_step", "sum_limit",
        "reference_rate", "motor_step", "compliance", "bad_limit",
    )),
)  # fmt: skip


def drawn_change(law: fl.Law, seed: int) -> dict[str, float]:
    """Return a change of one field that is not zero already."""
    random = np.random.default_rng(seed)
    header = ("version", "size", "precision", "crc", "options", "period")
    names = [
        name
        for name, value in law.coefficients.items()
        if name not in header and np.any(np.asarray(value))
    ]
    factors = (-1.0, 0.0, 1e-3, 0.02, 0.3, 0.7, 1.5, 3.0, 30.0, 1e3)
    return {str(random.choice(names)): float(random.choice(factors))}


def changed_laws(harness: Harness, design: fl.Design, drawn: int) -> None:
    """Ask for a proof of every changed law, and run those that have one."""
    law = design.law()
    changes = [*KNOWN, *(drawn_change(law, seed) for seed in range(drawn))]
    certified, wrong = 0, []
    for change in changes:
        made = changed_law(law, change)
        if not _is_certified(design, made):
            continue
        certified += 1
        # payloads told and not told: the feed-forward's scale is a part of the law too
        arms = (arm_of(RIG, m, ratio=0.03) for m in (0.02, 0.03, 0.04))
        for arm, told in ((arm, told) for arm in arms for told in (False, True)):
            mass = arm.tip_inertia / RIG.link.length**2 - RIG.link.tip_mass
            if not harness.move(made, arm, told=mass if told else 0.0).settled:
                wrong.append(f"{change} at {1e3 * mass:.0f} g, told {told}")
    line(
        "changed laws that are certified, and trip or do not settle",
        f"{len(wrong)} of {len(changes)} ({certified} certified) {wrong}",
        "0",
        not wrong,
    )


def _is_certified(design: fl.Design, law: fl.Law) -> bool:
    try:
        return fl.certify(design, law=law, modulus_margin=0.25).passed
    except FraclinkError:
        return False


# --- random rigs --------------------------------------------------------------------------------------


def drawn_rig(seed: int) -> tuple[fl.Rig, ArmParams, str]:
    """Return a rig, its arm and the structure that its model is to have: gauge 0 to 60 ms
    late with a gain of 0.8 to 1.3, hub of 0.5 to 10 times the tip's inertia.
    """
    random = np.random.default_rng(seed)
    frequency, payload = random.uniform(4.0, 25.0), 10.0 ** random.uniform(-2.0, 0.0)
    length = random.uniform(0.3, 1.0)
    tip = payload * length**2
    stiffness, hub = tip * frequency**2, tip * 10.0 ** random.uniform(-0.3, 1.0)
    # A motor that can follow: twice the torque required by hub and link at 60 rad/s².
    decay, gear = random.uniform(3.0, 20.0), 50.0
    torque = 2.0 * (60.0 * (hub + tip) + 6.0 * decay * hub)
    structure = ("D-IOM", "UD-FOM")[seed % 2]
    # The order λ of UD-FOM corresponds to the damping ratio −cos(π/λ) at the resonance.
    order = random.uniform(1.93, 1.995)
    ratio = (
        random.uniform(0.003, 0.06)
        if structure == "D-IOM"
        else -math.cos(math.pi / order)
    )
    rig = fl.Rig(
        name=f"drawn-{seed}",
        motor=extend.Motor(
            inertia=hub / gear**2,
            viscous_friction=decay * hub / gear**2,
            torque_constant=torque / 10.0 / gear,
            gear_ratio=gear,
            coulomb_torque=0.01 * torque / gear,
            voltage_limit=10.0,
        ),
        link=extend.Link(length=length, stiffness=stiffness),
        payloads=extend.Payloads(low=0.75 * payload, high=1.3 * payload, nominal=payload),
        period=0.004,
        encoder=replace(RIG.encoder),
        gauge=extend.Gauge(
            noise=0.003 * stiffness, quantum=0.001 * stiffness, limit=3.0 * stiffness
        ),
    )  # fmt: skip
    arm = arm_of(
        rig,
        payload,
        ratio=ratio,
        delay=random.uniform(0.0, 0.060),
        gain=random.uniform(0.8, 1.3),
        seed=seed,
    )
    return rig, arm, structure


def excitation(frequency: float, period: float, seed: int) -> Real:
    """Return steps of random size, each held for 0.3 to 1.5 periods of the link's
    vibration, smoothed over 0.1 s.
    """
    random, count = np.random.default_rng(seed), round(24.0 / period)
    reference, k = np.zeros(count), 0
    while k < count:
        length = round(random.uniform(0.3, 1.5) * 2 * math.pi / frequency / period)
        reference[k : k + length] = random.uniform(-0.3, 0.3)
        k += length
    width = round(0.1 / period)
    return np.convolve(reference, np.ones(width) / width)[:count]


def with_payload(arm: ArmParams, ratio: float) -> ArmParams:
    """Return the arm with its tip's inertia times `ratio`; the material stays."""
    made = ArmParams.from_buffer_copy(arm)
    made.tip_inertia *= ratio
    return made


def rigs(harness: Harness, first: int, count: int, arms: int) -> None:
    """Run a study of each rig's log; where it passes, its law must hold on the arm."""
    outcomes: Counter[str] = Counter()
    false: list[str] = []
    for seed in range(first, first + count):
        rig, arm, structure = drawn_rig(seed)
        frequency = math.sqrt(arm.stiffness / arm.tip_inertia)
        # PD gains for 20 rad/s with a damping ratio of one, of a hub without friction
        # and link
        per_volt = arm.torque_per_volt / arm.inertia
        gain, rate = 400.0 / per_volt, 40.0 / per_volt
        log = harness.record(
            rig, arm, excitation(frequency, rig.period, seed), gain, rate
        )
        study = trials.run(rig, log, structure=structure, certified=True, arms=arms)
        outcomes[study.verdict.state] += 1
        failed: list[str] = []
        if study.verdict.state == "passed" and study.law is not None:
            for load in (rig.payloads.low, rig.payloads.nominal, rig.payloads.high):
                loaded = with_payload(arm, load / rig.payloads.nominal)
                for told in (0.0, load):
                    # a study promises to settle within 4 s, where the last fifth begins
                    moved = harness.move(study.law, loaded, duration=5.0, told=told)
                    if not moved.settled:
                        told_or_not = "told" if told else "untold"
                        failed.append(
                            f"{seed}: {1e3 * load:.0f} g {told_or_not}, reason {moved.reason[-1]}"
                        )
        # Each rig is printed as it ends: a run of two hundred takes an hour and may be
        # cut short.
        print(
            f"    {seed} {structure} {1e3 * arm.gauge_delay:.0f} ms: {study.verdict.state}; {study.sentence}",
            *failed,
            flush=True,
        )
        false += failed
    line(
        "random rigs whose run passes, and whose law fails on the arm",
        f"{len(false)} of {count} {dict(outcomes)} {false}",
        "0",
        not false,
    )


# --- late gauges --------------------------------------------------------------------------------------


def late_gauges(harness: Harness, count: int) -> None:
    """Move arms with a late gauge: a good one is never stuck, a stuck one is found."""
    false, late, unseen = [], [], []
    for seed in range(count):
        random = np.random.default_rng(seed)
        delay, kind = random.uniform(0.010, 0.060), seed % 3
        gauge = replace(
            RIG.gauge,
            noise=0.01 if kind == 2 else 0.0,
            quantum=RIG.gauge.quantum if kind else 0.0,
        )
        rig = replace(RIG, gauge=gauge)
        assert RIG.model is not None
        link = replace(RIG.model, gauge_delay=delay)
        # A correction without effect: the guard is under test, and no law for 60 ms
        # passes its design.
        controller = fl.Controller(
            derivative_gain=1e-6, derivative_order=0.6, link=link
        )
        law = extend.equip(fl.discretize(controller, rig.period), rig, link)
        arm = arm_of(
            rig, random.uniform(0.02, 0.04), ratio=0.06, delay=delay, seed=seed
        )
        # From a quarter of the rig's acceleration to all of it.
        amplitude = random.uniform(0.3, 1.5)
        wanted = random.uniform(0.25, 1.0) * rig.moves.acceleration
        move = fl.smooth_step(amplitude, math.sqrt(5.77 * amplitude / wanted))
        good = harness.move(law, arm, move)
        if np.any(good.reason == GAUGE_STUCK):
            false.append(seed)
        # From the middle of the move on, while the required torque changes.
        begin = round(0.5 * move.duration / rig.period)
        dead = harness.move(law, arm, move, stuck=begin)
        where = np.flatnonzero(dead.reason == GAUGE_STUCK)
        if not where.size:
            unseen.append(seed)
        elif where[0] - begin > delay / rig.period + 15:
            late.append((seed, int(where[0] - begin - delay / rig.period)))
    line("late gauges that are taken for stuck", str(false), "none", not false)
    line(
        f"stuck gauges of {count} not found, found after delay + 15 periods",
        f"{unseen}, {late}",
        "none",
        not unseen and not late,
    )


# --- flipped bits -------------------------------------------------------------------------------------


def flipped_bits(harness: Harness, design: fl.Design, step: int) -> None:
    """Flip every bit of the law's memory (in every `step`-th word) in every second
    period of a move.
    """
    law = design.law()
    bank = extend.payload_estimator(design.model, RIG, law, design.payloads)
    move = fl.smooth_step(1.0, duration=0.5, start=0.2)
    count, begin, end = (round(t / law.period) for t in (1.6, 0.2, 0.9))
    time = law.period * np.arange(count)
    cases = [("none", 0.0, 0.03)]
    cases += [(f"told {1e3 * m:.0f} g", m, m) for m in (0.02, 0.03, 0.04)]
    cases += [(f"estimated {1e3 * m:.0f} g", -1.0, m) for m in (0.02, 0.03, 0.04)]
    for name, told, mass in cases:
        arm = arm_of(RIG, mass, ratio=0.03)
        words = harness.words + (harness.estimator_words if told < 0 else 0)
        worst, counts = np.zeros(words), np.zeros(2, dtype=np.int64)
        for word in range(0, words, step):
            harness.c.arm_flips(
                law.block, bank.block, ctypes.byref(arm), count,
                _at(move.angle(time)), _at(move.acceleration(time)),
                ctypes.c_double(told), begin, end, round(0.6 / law.period),
                32 * word, 32 * word + 32, ctypes.c_double(0.3), _at(worst), _at(counts),
            )  # fmt: skip
        far = {int(k): round(float(worst[k]), 2) for k in np.flatnonzero(worst > 0.3)}
        line(
            f"flipped bits, payload {name}: farthest tip, off in 10 periods aside",
            f"{worst.max():.2f} rad; {counts[1]} of {counts[0]} {far}",
            "<= 0.3 rad",
            worst.max() <= 0.3,
        )


# --- missed periods -----------------------------------------------------------------------------------


def missed_patterns(seeds: int) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield patterns of periods in which the law is called, 12 s long."""
    count = 3000
    k = np.arange(count)
    for out, of in ((1, 2), (1, 3), (2, 3), (3, 4), (4, 5), (5, 6)):
        yield f"{out} of {of} missed", (k % of >= out).astype(np.uint8)
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        share = random.uniform(0.05, 0.60)
        yield f"{100 * share:.0f} % missed", (random.random(count) > share).astype("u1")
    for stall in (3, 6, 12, 50):
        called = np.ones(count, dtype=np.uint8)
        called[60 : 60 + stall] = 0
        yield f"stall of {stall}", called


def missed_periods(harness: Harness, design: fl.Design, seeds: int) -> None:
    """Call the law in some periods only: it rides through, or it is off."""
    law, wrong = design.law(), []
    for name, called in missed_patterns(seeds):
        for mass in (0.02, 0.04):
            arm = arm_of(RIG, mass, ratio=0.03)
            moved = harness.move(law, arm, duration=12.0, called=called)
            railed = np.abs(moved.voltage) >= RIG.motor.voltage_limit * (1 - 1e-6)
            saturated = float(np.sum(railed)) * law.period
            if saturated > 0.5 or not (moved.settled or moved.mode[-1] == OFF):
                wrong.append(f"{name} at {1e3 * mass:.0f} g: {saturated:.2f} s")
    line(
        "patterns of missed periods: saturated beyond 0.5 s, or neither settled nor off",
        str(wrong),
        "none",
        not wrong,
    )


def main() -> None:
    asked = sizes(
        __doc__, tuned=(2, 0), chains=(1, 0), drawn=(40, 2), rigs=(200, 0), first=(0, 0),
        arms=(20, 4), gauges=(200, 6), word_step=(1, 20), patterns=(40, 2),
    )  # fmt: skip
    design = fl.design(
        RIG.model, RIG, payloads=(0.02, 0.04), gain_crossover=11.7,
        phase_margin=fl.deg(45),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as scratch:
        harness = Harness(Path(scratch) / "law", design.law())
        if asked.patterns:
            missed_periods(harness, design, asked.patterns)
        if asked.gauges:
            late_gauges(harness, asked.gauges)
        if asked.word_step:
            flipped_bits(harness, design, asked.word_step)
        if asked.drawn:
            changed_laws(harness, design, asked.drawn)
        if asked.chains:
            chain(asked.tuned)
        if asked.rigs:
            rigs(harness, asked.first, asked.rigs, asked.arms)


if __name__ == "__main__":
    main()
