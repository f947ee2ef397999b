"""The box of a certificate: every claim against an independent dense search for the
worst point; leaves and times.

The search evaluates the sampled loop of `fraclink._arm.sampled`, every alias summed, at
random points and corners of each box and goes downhill from the closest by Nelder and
Mead's method: it shares only the coefficients of the law with the proof. Designs and
boxes are random with a stated seed. Times are CPU seconds.
"""

from __future__ import annotations

import importlib.util
import math
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

import fraclink as fl
from fraclink import (
    Certificate,
    Design,
    Law,
    LinkModel,
    ParameterBox,
    Rig,
    SecondMode,
    certify,
)
from fraclink._arm.sampled import SampledPlant, sampled_plant
from fraclink.errors import FieldError, InfeasibleError
from harness import line, sizes

RIG = Rig.named("paper-2023")
SEED = 15
Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
# Coordinates of a case: payload [kg] and delay [s], followed by the parameters of the
# box in their own order.
PARAMETERS = tuple(ParameterBox.__dataclass_fields__)


@dataclass(frozen=True)
class Case:
    """A design, the law that ships, and the box that it is proved over."""

    name: str
    design: Design
    law: Law
    box: ParameterBox
    delay: tuple[float, float]

    @property
    def ends(self) -> tuple[Real, Real]:
        """Lower and upper ends of (payload, delay, the box's parameters)."""
        pairs = [
            self.design.payloads,
            self.delay,
            *(getattr(self.box, name) for name in PARAMETERS),
        ]
        low, high = np.array(pairs, dtype=float).T
        return low, high

    def certified(self) -> Certificate:
        """The certificate with the largest claim."""
        return certify(self.design, law=self.law, delay=self.delay, box=self.box)


# ---- the loop ---------------------------------------------------------------------------------------------


def distance(case: Case, point: Real, frequency: Real) -> Real:
    """|1 + L| of the sampled loop at one point of the box, every alias summed."""
    design, rig = case.design, case.design.rig
    (
        payload,
        delay,
        softness,
        order,
        damping,
        gain,
        late,
        motor,
        mode_frequency,
        mode_gain,
    ) = map(float, point)
    model = design.model
    second = model.second_mode
    if second is not None:
        second = replace(second, frequency=mode_frequency, gain=mode_gain)
    # The angle that the law subtracts per torque, times the true gauge gain: the
    # compliance that ships is not exactly 1/c.
    read = gain * model.stiffness * float(case.law.coefficients["compliance"])  # type: ignore[arg-type]
    known = replace(model, payload=design.payload(model.natural_frequency))
    link = replace(
        replace(
            known, natural_frequency=softness, damping=damping, intervals=()
        ).at_payload(payload),
        order=order,
        gauge_gain=read,
        gauge_delay=late,
        second_mode=second,
    )
    loop = replace(design.motor_loop, kind="ideal")
    if design.motor_loop.kind == "ideal":
        plant = sampled_plant(
            link, replace(loop, pole=loop.pole * motor), rig.motor, rig.period
        )
        plant = replace(plant, delay=delay)
    else:
        ideal = sampled_plant(link, loop, rig.motor, rig.period)
        plant = on_motor(case, ideal, delay, rig.motor.gain * motor)
    return np.asarray(
        np.abs(1.0 + case.law.frequency_response(frequency) * plant(frequency))
    )


def on_motor(
    case: Case, plant: SampledPlant, delay: float, gain: float
) -> SampledPlant:
    """The link driven by the rig's PID on a motor of this gain, delayed by any part of
    a period.
    """
    rig, settings = case.design.rig, case.design.motor_loop
    pid, decay, pole = (
        settings.sampled(rig.motor, rig.period),
        rig.motor.decay,
        settings.pole,
    )

    def motor(s: Complex) -> Complex:
        return np.asarray(gain / (s * (s + decay)))

    def link(s: Complex) -> Complex:
        return np.asarray(plant.response(s) * (1.0 + s / pole) ** 2 * motor(s))

    alone = SampledPlant(motor, rig.period, delay)

    def voltage(frequency: Real) -> Complex:
        first, second = pid.controllers(np.exp(-1j * frequency * rig.period))
        return np.asarray(first / (1.0 + (first + second) * alone(frequency)))

    return SampledPlant(link, rig.period, delay, voltage)


# ---- the search -------------------------------------------------------------------------------------------


def worst(
    case: Case, rng: np.random.Generator, *, points: int = 150, starts: int = 2
) -> tuple[float, Real]:
    """(smallest |1 + L| found, its point with ω at the end): corners, random points,
    then downhill.
    """
    low, high = case.ends
    nyquist = math.pi / case.law.period
    grid = np.unique(
        np.concatenate([np.geomspace(1.0, nyquist, 60), np.linspace(4.0, 60.0, 40)])
    )
    second = case.design.model.second_mode
    if second is not None:
        # The closed loop shifts its resonance away from the mode by several of its
        # widths 2ζω: four points per width on either side.
        near, far = np.multiply(case.box.mode_frequency, (0.8, 1.25))
        step = 0.5 * second.damping_ratio * near
        grid = np.unique(np.concatenate([grid, np.arange(near, far, step)]))
    grid = grid[grid <= nyquist]
    shares = np.concatenate(
        [
            rng.integers(0, 2, (2 * points // 3, low.size)).astype(float),
            rng.random((points // 3, low.size)),
            [np.full(low.size, 0.5)],
        ]
    )
    found = []
    for share in shares:
        values = distance(case, low + share * (high - low), grid)
        k = int(np.argmin(values))
        found.append((float(values[k]), np.append(share, math.log(grid[k]))))
    found.sort(key=lambda pair: pair[0])

    def at(place: Real) -> float:
        point = low + np.clip(place[:-1], 0.0, 1.0) * (high - low)
        return float(
            distance(case, point, np.exp(np.minimum(place[-1:], math.log(nyquist))))[0]
        )

    best = found[0]
    for _, start in found[:starts]:
        best = min(best, _downhill(at, start, high > low), key=lambda pair: pair[0])
    return best


def _downhill(at, start: Real, varied: NDArray[np.bool_]) -> tuple[float, Real]:  # type: ignore[no-untyped-def]
    free = np.append(varied, True)

    def value(x: Real) -> float:
        place = start.copy()
        place[free] = x
        return at(place)

    size = int(np.count_nonzero(free))
    steps = np.where(start[free] > 0.5, -0.2, 0.2)
    steps[-1] = 0.02
    simplex = np.vstack([start[free], start[free] + np.diag(steps)])
    options = {
        "initial_simplex": simplex,
        "maxfev": 60 * size,
        "xatol": 1e-4,
        "fatol": 1e-6,
    }
    result = minimize(value, start[free], method="Nelder-Mead", options=options)
    place = start.copy()
    place[free] = result.x
    return float(result.fun), place


# ---- random designs and boxes -----------------------------------------------------------------------------


def random_case(rng: np.random.Generator) -> Case:
    """A design for a random rig, link and request, and a box, from a thirtieth of the
    large one to a quarter larger.
    """
    while True:
        light = float(rng.uniform(0.012, 0.030))
        inner = ("ideal", "ideal", "sampled", "direct")[int(rng.integers(4))]
        second = None
        if rng.random() < 0.4:
            second = SecondMode(
                float(rng.uniform(120, 260)), float(rng.uniform(0.005, 0.05)), 0.02
            )
        damped = rng.random() < 0.5
        rig = replace(
            RIG,
            period=float(rng.choice([0.002, 0.004])),
            motor_loop=replace(RIG.motor_loop, pole=float(rng.uniform(60, 110))),
        )
        model = LinkModel(
            rig.link.stiffness,
            float(rng.uniform(10.0, 13.0)),
            order=2.0
            if damped and rng.random() < 0.3
            else float(rng.uniform(1.86, 1.97)),
            damping=float(rng.uniform(0.1, 1.0)) if damped else 0.0,
            damping_order=float(rng.uniform(0.7, 1.0)),
            payload=0.03,
            gauge_delay=float(rng.choice([0.0, 0.002])),
            second_mode=second,
        )
        wanted = {
            "payloads": (light, light * float(rng.uniform(1.2, 2.5))),
            "gain_crossover": float(rng.uniform(10.0, 16.0)),
            "phase_margin": math.radians(rng.uniform(40, 60)),
            "filter_time": None if rng.random() < 0.5 else 0.0,
            "motor_loop": "ideal" if inner == "ideal" else "sampled",
            "placement": "direct" if inner == "direct" else "tustin",
        }
        design = nearest_design(model, rig, wanted)
        # Without a filter a correction with β > 0.9 amplifies noise without bound: its
        # limits act at once.
        if design is None or (
            not design.controller.filter_time
            and design.controller.derivative_order > 0.9
        ):
            continue
        size = 10.0 ** rng.uniform(-1.5, 0.1)
        longest = float(rng.uniform(0.2, 1.0)) * rig.period
        delay = (0.0, longest) if rng.random() < 0.7 else (rig.period, rig.period)
        name = f"{inner}, {1e3 * rig.period:g} ms" + (", mode 2" if second else "")
        law = design.law()
        # Without the motor loop of the law, the claim is about M(s) as written.
        shipped = replace(law, motor_loop=None) if inner == "ideal" else law
        return Case(name, design, shipped, box_around(design, size), delay)


def nearest_design(model: LinkModel, rig: Rig, wanted: dict[str, Any]) -> Design | None:
    """The design asked for, or the nearest one that its refusal offers; None where it
    offers none.
    """
    for _ in range(2):
        try:
            return fl.design(model, rig, **wanted)
        except InfeasibleError as error:
            wanted = wanted | dict(error.nearest)
        except FieldError:
            return None
    return None


def box_around(design: Design, size: float) -> ParameterBox:
    """The large box of this project times `size`: λ ±0.04, ω₀² ±5 %, gauge ±10 % and 4
    ms, motor ±20 %.
    """
    model = design.model
    mode = model.second_mode

    def about(value: float, part: float) -> tuple[float, float]:
        return value * (1.0 - part * size), value * (1.0 + part * size)

    highest = 2.0 if model.damping else 0.5 * (model.order + 2.0)
    return ParameterBox(
        natural_frequency=about(model.natural_frequency, 0.025),
        order=(model.order - 0.04 * size, min(model.order + 0.04 * size, highest)),
        damping=about(model.damping, 0.2),
        gauge_gain=about(model.gauge_gain, 0.1),
        gauge_delay=(model.gauge_delay, model.gauge_delay + 0.004 * size),
        motor_ratio=about(1.0, 0.2),
        mode_frequency=(0.0, 0.0) if mode is None else about(mode.frequency, 0.05),
        mode_gain=(0.0, 0.0) if mode is None else about(mode.gain, 0.2),
    )


# ---- figures ----------------------------------------------------------------------------------------------


def against_search(first: int, count: int, seed: int) -> None:
    """Every claim next to the true value found by the search."""
    gaps: list[float] = []
    unproved = 0
    print(
        f"{count} random designs and boxes, seed {seed}: claim, truth, leaves, CPU seconds"
    )
    for number in range(first, first + count):
        # every case separately, so that each can be repeated
        rng = np.random.default_rng([seed, number])
        case = random_case(rng)
        begin = time.process_time()
        certificate = case.certified()
        spent = time.process_time() - begin
        claim = certificate.statement.modulus
        if "stable" in certificate.verdict and not certificate.passed:
            print(
                f"  {number:2d} {case.name:<26} {certificate.verdict[:80]}", flush=True
            )
            continue
        truth, _ = worst(case, rng)
        if certificate.passed:
            gaps.append(truth - claim)
            note = "proved"
        else:
            # A failed proof is a miss only where the loop keeps the claim with 0.02 to
            # spare.
            unproved += truth > claim + 0.02
            note = certificate.verdict[:90]
        print(
            f"  {number:2d} {case.name:<26} claim {claim:.3f} truth {truth:.4f} gap {truth - claim:+.4f} "
            f"leaves {certificate.leaves:6d} {spent:6.2f} s  {note}",
            flush=True,
        )
    below = sum(gap < 0 for gap in gaps)
    line("truth below the claim", str(below), "0", below == 0)
    far = sum(gap > 0.02 for gap in gaps)
    line("claim farther than 0.02 from the truth", str(far), "0", far == 0)
    largest = max(gaps, default=0.0)
    line("largest gap", f"{largest:.4f}", "<= 0.02", largest <= 0.02)
    line("not proved", str(unproved), "0", unproved == 0)


def load_checker() -> ModuleType:
    """tools/check_certificate.py as a module."""
    place = Path(__file__).resolve().parents[1] / "tools" / "check_certificate.py"
    spec = importlib.util.spec_from_file_location("check_certificate", place)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def named_boxes(count: int) -> None:
    """Leaves and seconds for the moderate and the large box."""
    checker = load_checker()
    wanted = {
        "payloads": (0.020, 0.040),
        "gain_crossover": 12.0,
        "phase_margin": fl.deg(58),
    }
    design = fl.design(RIG.model, RIG, **wanted)
    law = design.law()
    boxes = {"moderate": (ParameterBox.of(design.model, RIG), 5_000, 3.0)}
    boxes["large"] = (box_around(design, 1.0), 15_000, 10.0)
    for name, (box, most, limit) in list(boxes.items())[:count]:
        begin = time.process_time()
        made = certify(design, law=law, box=box)
        spent = time.process_time() - begin
        line(
            f"{name} box, proved modulus",
            f"{made.statement.modulus:.3f}",
            "proved",
            made.passed,
        )
        line(
            f"{name} box, leaves",
            str(made.leaves),
            f"<= {most}",
            made.passed and made.leaves <= most,
        )
        line(
            f"{name} box, CPU seconds", f"{spent:.2f}", f"<= {limit:g}", spent <= limit
        )
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / "certificate.json"
            made.save(place)
            begin = time.process_time()
            checker.check(str(place), law.digest)
            spent = time.process_time() - begin
        line(
            f"{name} box, CPU seconds to check", f"{spent:.2f}", "<= 10", spent <= 10.0
        )


def main() -> None:
    given = sizes(__doc__, cases=(60, 1), first=(0, 1), boxes=(2, 0))
    named_boxes(given.boxes)
    against_search(given.first, given.cases, SEED)


if __name__ == "__main__":
    main()
