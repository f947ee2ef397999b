"""Golden figures: what the package computes today, recorded for comparison after a
refactoring.

    python -m tests.golden.record runs designs    # record these topics again
    python -m tests.golden.record commands        # the texts of the command line
    python -m tests.golden.record                 # list the topics

Each topic is a function that returns its entries: a title, and the function that makes
the plain JSON values under it. `tests/test_golden.py` makes each entry in a test of its
own and names every value that differs. What is under a key ``sha256`` is compared bit
for bit, and only where this machine's floating-point functions give the bits of the
machine that recorded it (`probe`); the numbers beside the digests are compared
everywhere. Record a topic again only for a difference that is understood and wanted.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
import math
import os
import re
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the tests

import numpy as np
from numpy.typing import ArrayLike, NDArray

import fraclink as fl

# Run as a script, it needs the paths that pytest's `pythonpath` gives to the tests.
sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

# All names that are not at the root are imported here, so that a move of modules needs
# one edit.
from fraclink import (  # noqa: E402
    Certificate,
    export_fmu,
    identify_motor,
    identify_payloads,
)
from fraclink.errors import InfeasibleError  # noqa: E402
from fraclink.extend import (  # noqa: E402
    FractionalKelvinVoigt,
    KelvinVoigt,
    Obstacle,
    PayloadChange,
    PowerLaw,
    Restart,
    SensorFault,
    TipPulse,
    equip,
    geared,
)
from fraclink.trials import (  # noqa: E402
    Bench,
    Campaign,
    Case,
    run_case,
    simulate_part,
)
from made_logs import example_motor_log  # noqa: E402

HERE = Path(__file__).resolve().parent

from golden.commands import record_commands  # type: ignore[attr-defined]  # noqa: E402

ROOT = HERE.parents[1]
LINK_MASS = 0.00735  # [kg], of the twin: a quarter of the nominal payload
RIG = fl.Rig.named("paper-2023")
GEARED = geared(RIG)  # the motor behind its gear of 50
LINK = RIG.model
METRICS = (
    "steady_state_error",
    "residual_vibration",
    "overshoot",
    "peak_tip_error",
    "settling_time",
)

Plain = dict[str, Any]
Entries = dict[str, Callable[[], Any]]


def plain(value: Any) -> Any:
    """`value` in JSON types; non-finite numbers become words."""
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def digest(values: ArrayLike | bytes) -> str:
    """The first 16 hexadecimal digits of SHA-256 of bytes, or of an array's bytes as
    float64 or uint32.
    """
    if not isinstance(values, bytes):
        array = np.asarray(values)
        values = np.ascontiguousarray(
            array, dtype="<u4" if array.dtype.kind == "u" else "<f8"
        ).tobytes()
    return hashlib.sha256(values).hexdigest()[:16]


@functools.cache
def probe() -> str:
    """Digest of the results of functions whose last bit depends on the machine."""
    x = np.linspace(-3.0, 3.0, 1001)
    z = (0.3 + 1j * np.abs(x) + 1e-3) ** 0.61
    matrix = np.sin(np.outer(np.arange(1.0, 9.0), np.arange(1.0, 9.0)))
    parts = (
        np.exp(x),
        np.sin(x),
        np.log(np.abs(x) + 0.1),
        z.real,
        z.imag,
        matrix @ matrix.T,
    )
    roots = np.linalg.eigvals(matrix)
    # Above a certain size BLAS distributes a product over its threads, whose number
    # affects the rounding.
    count = np.arange(1.0, 301.0)
    shared = np.cos(np.outer(count, count))
    return digest(
        np.concatenate(
            [np.ravel(p) for p in (*parts, roots.real, roots.imag, shared @ shared)]
        )
    )


# --- the laws that the runs are made with: files, so that another fit of a law changes no run


def design_of(rig: fl.Rig, **asked: Any) -> fl.Design:
    """The design that most figures are based on."""
    wanted = {
        "payloads": (0.020, 0.040),
        "gain_crossover": 12.0,
        "phase_margin": fl.deg(50),
    }
    return fl.design(rig.model, rig, **(wanted | asked))


@functools.cache
def default_law() -> fl.Law:
    """The law of the design that most figures are based on."""
    return design_of(RIG).law()


def unguarded_law() -> fl.Law:
    """The same law with guards that never act."""
    far = replace(
        default_law().limits,
        torque_trip=1e6,
        torque_block=1e6,
        residual_angle=1e6,
        frozen_angle=1e6,
        stuck_torque=1e6,
    )
    return replace(default_law(), limits=far)


PRINTED = fl.Controller(
    derivative_gain=0.148,
    derivative_order=0.65,
    filter_time=0.16,
    filter_order=2,
    link=LINK,
)

# How the laws are fitted today. They are recorded once; the runs read the files.
LAWS: dict[str, Callable[[], fl.Law]] = {
    "default": default_law,
    "order-4": lambda: design_of(RIG, filter_time=0.0).law(order=4),
    "unguarded": unguarded_law,
    "outer": lambda: replace(default_law(), motor_loop=None),
    "ideal": lambda: design_of(RIG, motor_loop="ideal", placement="tustin").law(),
    "printed": lambda: equip(fl.discretize(PRINTED, RIG.period), RIG, LINK),
    "geared": lambda: design_of(GEARED).law(),
}


@functools.cache
def law(name: str, precision: str = "double") -> fl.Law:
    """A recorded law."""
    return fl.Law.load(HERE / "laws" / f"{name}.json").in_precision(precision)  # type: ignore[arg-type]


# --- runs

SIGNALS = (
    "reference",
    "tip_angle",
    "motor_angle",
    "motor_reference",
    "torque",
    "torque_measured",
    "motor_angle_measured",
    "voltage",
    "tip_estimate",
    "flags",
    "mode",
    "reason",
)


def run_figures(run: Any) -> Plain:
    """Digest of every signal of a run, and figures that make a difference readable."""
    figures = {
        name: getattr(run.metrics, name)
        for name in (*METRICS, "peak_voltage", "saturated")
    }
    return plain(
        {
            "sha256": {
                name: digest(getattr(run, name))
                for name in SIGNALS
                if hasattr(run, name)
            },
            "samples": len(run.time),
            "final_tip_angle": run.tip_angle[-1],
            "largest_torque": np.abs(run.torque).max(),
            "final_mode": run.mode[-1],
            "final_reason": run.reason[-1],
            "holds": run.verdict.passed,
            **figures,
        }
    )


def model_runs() -> Iterator[tuple[str, Callable[[], fl.Run]]]:
    """Runs on the lumped model."""
    move = fl.smooth_step(1.0, 0.5)
    for seed, grams in enumerate((8, 16, 20, 30, 40, 60)):
        for motor_loop, named in (("ideal", "outer"), ("sampled", "default")):
            options: Plain = {"payload": grams / 1e3, "seed": seed, "duration": 3.0}
            yield (
                f"model {grams} g {motor_loop}",
                partial(fl.simulate, law(named), move, rig=RIG, model=LINK, **options),
            )
    several: dict[str, tuple[str, str, Plain]] = {
        "quiet": ("default", "double", {"noise": 0.0}),
        "noise": ("default", "double", {"noise": 0.03, "seed": 11}),
        "offset": ("default", "double", {"gauge_offset": 0.078, "seed": 12}),
        "offset beyond": ("default", "double", {"gauge_offset": -3.0, "seed": 13}),
        "delay 0": ("default", "double", {"delay_samples": 0, "seed": 14}),
        "delay 3": ("default", "double", {"delay_samples": 3, "seed": 15}),
        "unguarded delay 3": ("unguarded", "double", {"delay_samples": 3, "seed": 15}),
        "single": ("default", "single", {"seed": 16}),
        "order 4": ("order-4", "double", {"seed": 17}),
        "ideal": ("ideal", "double", {"seed": 18}),
        "printed": ("printed", "double", {"payload": 0.040, "seed": 20}),
    }
    for title, (named, precision, options) in several.items():
        made = {"duration": 3.0} | options
        yield (
            f"model {title}",
            partial(
                fl.simulate, law(named, precision), move, rig=RIG, model=LINK, **made
            ),
        )
    links = {
        "D-FOM": fl.LinkModel(1.56, 11.0, damping=0.8, damping_order=0.6),
        "D-IOM": fl.LinkModel(1.56, 11.0, damping=0.5),
        "UD-IOM": fl.LinkModel(1.56, 11.0),
    }
    for title, link in links.items():
        yield (
            f"model {title}",
            partial(
                fl.simulate,
                law("outer", "single"),
                move,
                rig=RIG,
                model=link,
                seed=21,
                duration=3.0,
            ),
        )
    yield (
        "model pulse",
        partial(
            fl.simulate,
            law("outer"),
            fl.extend.pulse(0.4, 0.5, 1.5),
            rig=RIG,
            model=LINK,
            seed=22,
            duration=3.0,
        ),
    )
    yield (
        "model at rest",
        partial(
            fl.simulate,
            law("outer"),
            fl.extend.hold(0.0),
            rig=RIG,
            model=LINK,
            seed=23,
            duration=3.0,
        ),
    )


def twin_runs() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Runs on the arm with distributed mass."""
    move = fl.smooth_step(1.0, 1.0)
    materials = {
        "power law": PowerLaw(1.92),
        "viscous": KelvinVoigt(0.0118),
        "fractional": FractionalKelvinVoigt(0.05, 0.6),
    }
    for seed, (title, damping) in enumerate(materials.items()):
        for grams in (20, 40):
            arm = fl.Twin.from_rig(
                GEARED, payload=grams / 1e3, link_mass=LINK_MASS, damping=damping
            )
            yield (
                f"twin {title} {grams} g",
                partial(
                    fl.simulate, law("geared"), move, arm=arm, duration=3.0, seed=seed
                ),
            )
    arm = fl.Twin.from_rig(GEARED, link_mass=LINK_MASS)
    slow = replace(arm, gauge_delay=0.004)
    nan = float("nan")
    events: dict[str, list[Any]] = {
        "tip pulse": [TipPulse(time=1.5, force=0.5, duration=0.02)],
        "payload lost": [PayloadChange(time=0.5, payload=0.008)],
        "obstacle": [Obstacle(time=0.0, until=0.9, angle=0.5)],
        "restart": [Restart(time=0.5)],
        "gauge NaN": [SensorFault(time=0.5, until=0.6, kind="gauge value", value=nan)],
        "encoder frozen": [SensorFault(time=0.5, until=0.8, kind="encoder frozen")],
        "gauge gain": [SensorFault(time=0.3, until=2.0, kind="gauge gain", value=0.8)],
        "channels swapped": [
            SensorFault(time=0.5, until=0.508, kind="channels swapped")
        ],
        "ticks": [
            SensorFault(time=0.4, until=0.404, kind="tick missed"),
            SensorFault(time=0.8, until=0.804, kind="tick repeated"),
        ],
    }
    for seed, (title, list_) in enumerate(events.items()):
        run = partial(
            fl.simulate,
            law("geared"),
            move,
            arm=arm,
            duration=3.0,
            seed=seed,
            events=list_,
        )
        yield f"twin {title}", run
    yield (
        "twin single",
        partial(
            fl.simulate, law("geared", "single"), move, arm=arm, duration=3.0, seed=5
        ),
    )
    yield (
        "twin late gauge",
        partial(fl.simulate, law("geared"), move, arm=slow, duration=3.0, seed=6),
    )
    there = fl.smooth_step(1.0, 0.6).then(fl.smooth_step(-0.5, 0.6))
    yield (
        "twin two moves",
        partial(fl.simulate, law("geared"), there, arm=arm, duration=3.0, seed=7),
    )


def campaign_figures() -> Plain:
    """Every column of a Monte Carlo part of 250 arms."""
    columns = simulate_part(
        Campaign.of(RIG, LINK, law("default"), runs=250, seed=7),
        0,
    )
    finite = {name: np.asarray(values, dtype=float) for name, values in columns.items()}
    return plain(
        {
            "sha256": {name: digest(values) for name, values in finite.items()},
            "median": {
                name: float(np.median(values)) for name, values in finite.items()
            },
            "largest": {name: float(np.max(values)) for name, values in finite.items()},
        }
    )


def fault_figures(name: str, severity: int, phase: str) -> Plain:
    """One case of the fault campaign."""
    bench = replace(_bench(), law=law("geared"))
    outcome = run_case(bench, Case(name, severity, 0.030, phase, 3))
    checks = {
        check.name: [check.measured, check.limit, check.passed]
        for check in outcome.checks
    }
    told = {
        field: getattr(outcome, field)
        for field in ("peak", "clean_peak", "final", "mode", "reason")
    }
    return plain(told | {"reacted": outcome.reacted, "checks": checks})


@functools.cache
def _bench() -> Bench:
    return Bench.of(design_of(GEARED), link_mass=LINK_MASS)


FAULTS: tuple[tuple[str, int, str], ...] = (
    ("F02", 2, "mid"),
    ("F07", 3, "mid"),
    ("F09", 1, "mid"),
    ("F14", 2, "rest"),
    ("F23", 2, "mid"),
)
# Every fault with every severity; each costs 20 ms.
FAULTS += tuple(
    (fault.number, severity, "mid")
    for fault in fl.trials.CATALOGUE
    for severity in (1, 2, 3)
)


def _of_run(make: Callable[[], Any]) -> Plain:
    return run_figures(make())


def runs() -> Entries:
    """Seeded runs of model, twin, Monte Carlo campaign and faults."""
    made: Entries = {
        title: partial(_of_run, make) for title, make in (*model_runs(), *twin_runs())
    }
    made["campaign sampled"] = campaign_figures
    return made | {
        f"fault {name}-{severity}-{phase}": partial(
            fault_figures, name, severity, phase
        )
        for name, severity, phase in FAULTS
    }


# --- certificates


def certificate_figures(found: Certificate) -> Plain:
    """The claim and its ranges, or the place where it fails."""
    s = found.statement
    ranges = [s.payload_low, s.payload_high, s.delay_low, s.delay_high]
    place = [found.payload, found.frequency, found.delay, found.distance]
    return plain(
        {
            "holds": found.passed,
            "modulus": s.modulus,
            "ranges": ranges,
            "motor_loop": s.motor_loop,
            "precision": s.precision,
            "numbers": [
                *s.box[0].values(),
                *s.box[1].values(),
                s.damping_order,
                s.decay,
                s.lowest,
            ],
            "leaves": found.leaves,
            "fails_at": place,
            "sha256": {
                "certificate": found.sha256[:16] if found.passed else None,
                "tree": digest(found.tree.encode()),
            },
        }
    )


def certificates() -> Entries:
    """Claims of proofs that succeed and of two that do not."""
    about: Plain = {"model": LINK, "rig": RIG, "payloads": (0.020, 0.040)}
    asked: dict[str, tuple[fl.Law, Plain]] = {
        "asked 0.35": (law("outer"), {"modulus_margin": 0.35}),
        "nine tenths of the grid": (law("outer"), {}),
        "single": (law("outer", "single"), {"modulus_margin": 0.4}),
        "sampled": (law("default"), {"modulus_margin": 0.35}),
        "tustin": (law("ideal"), {"modulus_margin": 0.35}),
        "wider": (
            law("order-4"),
            {"payloads": (0.010, 0.050), "modulus_margin": 0.2},
        ),
        "too much": (law("outer"), {"modulus_margin": 0.9}),
        "printed": (law("printed"), {}),
    }
    return {
        title: lambda subject=subject, options=options: certificate_figures(
            fl.certify(subject, **(about | options))
        )
        for title, (subject, options) in asked.items()
    }


# --- designs


def controller_figures(controller: fl.Controller) -> Plain:
    """The numbers of a controller."""
    return plain(
        {
            "gain": controller.derivative_gain,
            "order": controller.derivative_order,
            "filter_time": controller.filter_time,
            "filter_order": controller.filter_order,
        }
    )


def plan_figures(plan: fl.Design) -> Plain:
    """Controller, requirements, the margins at both ends and the codes of the findings."""
    ends = [plan.at(payload) for payload in plan.payloads]
    return plain(
        {
            "controller": controller_figures(plan.controller),
            "holds": plan.passed,
            "chi": plan.chi,
            "gain_crossover_upper": plan.gain_crossover_upper,
            "natural_frequencies": plan.natural_frequencies,
            "payloads": plan.payloads,
            "phase_margins": [found.phase_margin for found in ends],
            "gain_margins": [found.gain_margin for found in ends],
            "requirements": {
                # Without the slack: it is the difference of the first two, and nothing
                # but rounding for an active bound.
                item.name: [item.wanted, item.achieved, item.at_payload, item.passed]
                for item in plan.requirements
            },
            "findings": [finding.code for finding in plan.findings],
        }
    )


REQUESTS: dict[str, Plain] = {
    "default": {},
    "no filter": {"filter_time": 0.0},
    "filter 10 ms": {"filter_time": 0.01, "filter_order": 2},
    "narrow range": {"payloads": (0.028, 0.032)},
    "wide range": {
        "payloads": (0.008, 0.060),
        "gain_crossover": 10.0,
        "phase_margin": fl.deg(40),
    },
    "slow": {"gain_crossover": 9.0, "phase_margin": fl.deg(60)},
    "fast": {"gain_crossover": 16.0, "phase_margin": fl.deg(40)},
    "ideal": {"motor_loop": "ideal", "placement": "tustin"},
    "tustin": {"placement": "tustin"},
    "paper": {
        "payloads": None,
        "natural_frequencies": (9.42, 14.14),
        "gain_crossover": 16.0,
        "phase_margin": fl.deg(70),
        "procedure": "published",
    },
    "paper, n = 1": {
        "gain_crossover": 16.0,
        "phase_margin": fl.deg(70),
        "procedure": "published",
        "filter_order": 1,
    },
    "Ms": {"phase_margin": None, "max_sensitivity": 1.6},
    "bounds": {
        "gain_crossover": None,
        "phase_margin": None,
        "max_sensitivity": 1.6,
        "settling_time": 0.55,
        "noise_gain": 2.0,
    },
    "noise": {"noise_gain": 1.2},
    "infeasible margin": {"gain_crossover": 30.0, "phase_margin": fl.deg(80)},
    "infeasible crossover": {"gain_crossover": 2.0},
    "infeasible noise": {"noise_gain": 0.05},
    "infeasible Ms": {"phase_margin": None, "max_sensitivity": 1.02},
}


def answer(rig: fl.Rig, asked: Plain) -> Plain:
    """The figures of a design, or the condition that makes it infeasible with the
    nearest request.
    """
    try:
        return plan_figures(design_of(rig, **asked))
    except InfeasibleError as error:
        return plain({"condition": error.condition, "nearest": error.nearest})


def _of_damped_link() -> Plain:
    link = fl.LinkModel(1.56, 11.0, damping=0.8, damping_order=0.6, payload=0.03)
    asked: Plain = {
        "payloads": (0.02, 0.04),
        "gain_crossover": 12.0,
        "phase_margin": fl.deg(50),
    }
    return plan_figures(fl.design(link, RIG, **asked))


def designs() -> Entries:
    """Designs over a grid of requests, of other links, with a bound on higher modes."""
    made: Entries = {
        title: partial(answer, RIG, asked) for title, asked in REQUESTS.items()
    }
    made["damped link"] = _of_damped_link
    # The law of a design takes a second to fit: its margin is added to two of them.
    shipped: tuple[Plain, ...] = (
        {"filter_time": 0.0},
        {"motor_loop": "ideal", "placement": "tustin"},
    )
    for asked in shipped:
        made[f"with law {asked}"] = lambda asked=asked: plan_figures(
            design_of(RIG, **asked).with_law()
        )
    massive = replace(GEARED, link=replace(GEARED.link, mass=LINK_MASS))
    for bound in (0.9, 0.05):
        mode: Plain = {"mode_gain": bound, "phase_margin": fl.deg(40)}
        made[f"mode gain {bound:g}"] = partial(answer, massive, mode)
    return made


# --- identification

LOGS = ("pulse_30g", "prbs_20g", "prbs_30g", "prbs_40g")
LINK_NUMBERS = ("stiffness", "natural_frequency", "order", "damping", "damping_order")
FIT_NUMBERS = (
    "gain",
    "offset",
    "delay",
    "mse",
    "nmse",
    "aic",
    "heldout_nmse",
    "effective_parameters",
)


def fit_figures(fit: fl.Fit) -> Plain:
    """Parameters, errors and assessment of a fit."""
    return plain(
        {name: getattr(fit.model, name) for name in LINK_NUMBERS}
        | {f"fit_{name}": getattr(fit, name) for name in FIT_NUMBERS}
        | {
            "standard_errors": fit.standard_errors,
            "intervals": {
                name: [item.low, item.high] for name, item in fit.intervals.items()
            },
            "at_bound": fit.at_bound,
            "hold": fit.hold,
            "samples": [fit.samples, fit.fitted_samples],
            "findings": [finding.code for finding in fit.findings],
        }
    )


@functools.cache
def log_of(name: str) -> fl.Experiment:
    """A bundled log, read once."""
    return fl.read_log(fl.bundled_log(name), rig=RIG)


def structure_figures(name: str) -> Plain:
    """The four structures fitted to a bundled log, and the findings of its diagnosis."""
    found = fl.compare_structures(log_of(name))
    made: Plain = {structure: fit_figures(fit) for structure, fit in found.fits.items()}
    made["preferred"] = found.preferred
    made["diagnosis"] = [finding.code for finding in fl.logs.diagnose(log_of(name))]
    return made


def payload_figures(tied: bool) -> Plain:
    """One fit of three payloads."""
    joint = identify_payloads(
        [log_of(name) for name in LOGS[1:]], tied=tied, length=RIG.link.length
    )
    return plain(
        {
            "links": [
                [getattr(model, name) for name in LINK_NUMBERS]
                for model in joint.models
            ],
            "standard_errors": joint.standard_errors,
            "test": [
                joint.test.statistic,
                joint.test.degrees,
                joint.test.p_value,
                joint.test.common,
            ],
        }
    )


MOTOR_NUMBERS = (
    "gain",
    "decay",
    "coulomb_voltage",
    "coulomb_torque",
    "dead_zone",
    "delay",
    "nmse",
)


def motor_figures() -> Plain:
    """A motor with a dead zone and a delay."""
    voltage, angle = example_motor_log(samples=2500, dead_zone=0.03, delay=0.006)
    motor = identify_motor(voltage, angle, period=0.004, inertia=RIG.motor.inertia)
    return plain(
        {name: getattr(motor, name) for name in (*MOTOR_NUMBERS, "standard_errors")}
    )


def identification() -> Entries:
    """Fits of the bundled logs, several payloads together, the motor, a spectrum."""
    return {name: partial(structure_figures, name) for name in LOGS} | {
        "payloads": partial(payload_figures, False),
        "payloads tied": partial(payload_figures, True),
        "motor": motor_figures,
    }


# --- exports


COMMENT = re.compile(rb"/\*.*?\*/", re.DOTALL)
TOKEN = re.compile(rb'FMU_TOKEN "([^"]+)"')


def shipped(name: str, content: bytes) -> str:
    """Digest of an exported file: of C the code without comments, and without the
    release number.
    """
    if name.endswith((".c", ".h")):
        content = b" ".join(COMMENT.sub(b"", content).split())
    return digest(content.replace(fl.__version__.encode(), b"VERSION"))


def _files(folder: Path) -> Plain:
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {
        path.relative_to(folder).as_posix(): shipped(path.name, path.read_bytes())
        for path in paths
    }


def _members(path: Path) -> Plain:
    with zipfile.ZipFile(io.BytesIO(path.read_bytes())) as archive:
        contents = {name: archive.read(name) for name in sorted(archive.namelist())}
    # The token is a hash of the sources including their comments.
    token = TOKEN.search(contents["sources/all.c"])
    assert token is not None
    return {
        name: shipped(name, content.replace(token[1], b"TOKEN"))
        for name, content in contents.items()
    }


def _c_files(named: str, precision: str) -> Plain:
    with tempfile.TemporaryDirectory() as place:
        fl.export_c(law(named, precision), Path(place) / "c")
        return {"sha256": _files(Path(place) / "c")}


def _fmu(named: str, precision: str) -> Plain:
    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / f"arm_{named}_{precision}.fmu"
        export_fmu(law(named, precision), target, compilers=())
        return {"sha256": _members(target)}


def law_figures(named: str) -> Plain:
    """A law as it is fitted now, beside the digest of the recorded one."""
    fitted = LAWS[named]()
    return plain(
        {
            "sha256": {
                "recorded": law(named).digest[:16],
                "fitted": fitted.digest[:16],
            },
            "states": fitted.order,
            "correction_error": fitted.correction_error,
            "feedforward_error": fitted.feedforward_error,
            "band": fitted.band,
            "response": _response(fitted),
        }
    )


def exports() -> Entries:
    """Bytes of exported files, for laws that are read from files; digests of laws
    fitted now.
    """
    made: Entries = {}
    for named in ("default", "outer", "geared"):
        for precision in ("double", "single"):
            made[f"C {named} {precision}"] = partial(_c_files, named, precision)
            made[f"FMU {named} {precision}"] = partial(_fmu, named, precision)
    return made | {f"law {named}": partial(law_figures, named) for named in LAWS}


def _response(fitted: fl.Law) -> list[list[float]]:
    values: NDArray[np.complex128] = fitted.frequency_response(
        [1.0, 5.0, 12.0, 20.0, 60.0, 200.0]
    )
    return [[value.real, value.imag] for value in values.tolist()]


# --- record and compare

TOPICS: dict[
    str, tuple[Callable[[], Entries], float]
] = {  # topic: its entries and their relative tolerance
    "runs": (runs, 1e-9),
    "certificates": (certificates, 1e-9),
    # A search ends within its own tolerance; the equations before it are exact.
    "designs": (designs, 1e-5),
    "identification": (identification, 1e-7),
    "exports": (exports, 1e-9),
}


@functools.cache
def entries(topic: str) -> Entries:
    """The entries of a topic, by title."""
    return TOPICS[topic][0]()


def differences(
    told: Any, found: Any, rel: float, *, bits: bool, place: str = ""
) -> list[str]:
    """Every entry in which `found` differs from what was recorded, with both values."""
    if isinstance(told, dict) and isinstance(found, dict):
        lost = [f"{place}/{key}: gone" for key in told if key not in found]
        new = [f"{place}/{key}: new" for key in found if key not in told]
        same = [key for key in told if key in found and (bits or key != "sha256")]
        inner = [
            differences(told[k], found[k], rel, bits=bits, place=f"{place}/{k}")
            for k in same
        ]
        return lost + new + [line for lines in inner for line in lines]
    if isinstance(told, list) and isinstance(found, list) and len(told) == len(found):
        pairs = zip(told, found, strict=True)
        inner = [
            differences(a, b, rel, bits=bits, place=f"{place}[{i}]")
            for i, (a, b) in enumerate(pairs)
        ]
        return [line for lines in inner for line in lines]
    numbers = all(
        isinstance(x, int | float) and not isinstance(x, bool) for x in (told, found)
    )
    # A value that should be zero is a rounding error and is not compared to relative
    # digits.
    if numbers and math.isclose(told, found, rel_tol=rel, abs_tol=1e-3 * rel):
        return []
    return (
        []
        if type(told) is type(found) and told == found
        else [f"{place}: {told!r} became {found!r}"]
    )


@functools.cache
def recorded(topic: str) -> Plain:
    """The record of a topic."""
    return dict(json.loads((HERE / f"{topic}.json").read_text("utf-8")))


def record(topic: str) -> None:
    """Record a topic again."""
    figures = {title: plain(make()) for title, make in entries(topic).items()}
    text = json.dumps(
        {"probe": probe(), "figures": figures},
        indent=1,
        ensure_ascii=False,
        allow_nan=False,
    )
    (HERE / f"{topic}.json").write_text(text + "\n", "utf-8")


def main(names: list[str]) -> int:
    """Record the topics named on the command line."""
    for name in names:
        if name == "laws":
            for title, make in LAWS.items():
                make().save(HERE / "laws" / f"{title}.json")
        elif name == "commands":
            record_commands()
        else:
            record(name)
        print("recorded", name)
    if not names:
        print("topics: laws (the runs' input), commands, " + ", ".join(TOPICS))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
