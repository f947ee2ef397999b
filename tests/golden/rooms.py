"""Figures of what commands do not print: systems, assessments, tuned rivals, and what
drawings hold.

Each has tests of its own against closed forms; what is recorded here is every digit of
them.
"""

from __future__ import annotations

import contextlib
import functools
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import fraclink as fl
from fraclink._arm.recording import Recording
from fraclink._campaign import Campaign, rivals, simulate_part
from fraclink._campaign.faults import Bench, Case, run_case
from fraclink._campaign.rival_controllers import (
    Algebraic,
    Linear,
    Outer,
    Seen,
    Sliding,
    gpi_correction,
    hinf_correction,
    lqg_correction,
    pd_correction,
    sliding_correction,
)
from fraclink._campaign.setting import Filter, NominalLoop, Setting, law_filter
from fraclink._design.alternatives import compare_at_equal_sensitivity, feasibility_map
from fraclink._design.assess import (
    VibrationMode,
    margin_curve,
    mode_gains,
    phase_budget,
    spillover,
    tolerances,
)
from fraclink._export.payload import payload_files
from fraclink._show import figures, fleets, loops
from fraclink._show.figures import structure_figure
from fraclink._show.runs import moves_figure, outcome_figure, shaped_figure
from fraclink._show.sketches import arm_sketch, loop_sketch
from fraclink._simulate import geared
from fraclink._simulate.on_twin import with_motor_loop
from fraclink._systems.fractional import s

Entries = dict[str, Callable[[], Any]]
RIG = fl.Rig.named("paper-2023")
GEARED = geared(RIG)
PERIOD, POLE = 0.004, 80.0


def dumped(value: Any) -> Any:
    """Any result as plain values; of an array its shape, and sums in which a value
    counts by its place.
    """
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biufc":
            return [dumped(item) for item in value.ravel().tolist()]
        flat = value.ravel().astype(np.complex128)
        weights = np.linspace(1.0, 2.0, max(flat.size, 1))[: flat.size]
        good = np.where(np.isfinite(flat), flat, 0.0)
        sums = [
            complex(good.sum()),
            complex((weights * good).sum()),
            complex(np.abs(good).max(initial=0.0)),
        ]
        return [list(value.shape), int(np.isfinite(flat).sum())] + [
            x for z in sums for x in (z.real, z.imag)
        ]
    if is_dataclass(value) and not isinstance(value, type):
        named = {item.name: getattr(value, item.name) for item in fields(value)}
        return {
            name: dumped(part) for name, part in named.items() if not callable(part)
        }
    if isinstance(value, Mapping):
        return {str(key): dumped(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        if len(value) > 24 and all(isinstance(item, int | float) for item in value):
            return dumped(np.asarray(value, dtype=float))
        return [dumped(item) for item in value]
    if isinstance(value, Path):
        return value.name
    return value


@functools.cache
def design_of(rig_name: str = "paper-2023", **asked: Any) -> fl.Design:
    """A design from the rig's own model."""
    rig = GEARED if rig_name == "geared" else RIG
    wanted = {
        "payloads": (0.020, 0.040),
        "gain_crossover": 12.0,
        "phase_margin": fl.deg(50),
    }
    return fl.design(rig.model, rig, **(wanted | asked))


# --- rivals


@functools.cache
def setting() -> Setting:
    """The paper's arm with a design of ours, at which the rivals are tuned."""
    made = design_of("geared")
    twin = fl.Twin.from_rig(GEARED, link_mass=0.00735)
    law = with_motor_loop(fl.discretize(made.controller, GEARED.period), twin=twin)[0]
    loop = NominalLoop.of(GEARED.model, 0.030, period=GEARED.period, pole=POLE, delay=1)
    return Setting(GEARED, GEARED.model, law, made.controller, loop, 12.0, fl.deg(50.0))


def _response(made: Filter) -> Any:
    z = np.exp(1j * PERIOD * np.array([0.1, 1.0, 5.0, 12.0, 30.0, 200.0, 700.0]))
    values = made.response(z)
    return [made.order, values.real.tolist(), values.imag.tolist()]


def corrections() -> Any:
    """Frequency responses of every correction, with and without a delay."""
    model = GEARED.model
    about: dict[str, Any] = {"period": PERIOD, "pole": POLE}
    made = {
        f"H∞ {d}": hinf_correction(model, **about, delay=d, gain=0.4) for d in (0, 1)
    }
    made |= {
        f"LQG {d}": lqg_correction(model, **about, delay=d, noise=0.0064, weight=2.0)
        for d in (0, 1, 3)
    }
    made["PD"] = pd_correction(0.3, corner=11.0, filter_time=0.01, period=PERIOD)
    made["sliding"] = sliding_correction(15.0, 11.0, filter_time=0.01, period=PERIOD)
    made["GPI"] = gpi_correction(15.0, 11.0, filter_time=0.01, period=PERIOD)
    made["fraclink"] = law_filter(setting().law)
    return {name: _response(item) for name, item in made.items()}


def outer_controllers() -> Any:
    """Outputs on the same bend of an arm that swings."""
    time = PERIOD * np.arange(300)
    tip, bend = (
        0.3 * (1 - np.cos(9.0 * time)),
        -0.3 * 81.0 / 130.0 * np.cos(9.0 * time) * np.tanh(20 * time),
    )
    made: dict[str, Outer] = {
        "linear": Linear(
            pd_correction(0.3, corner=11.0, filter_time=0.01, period=PERIOD)
        ),
        "sliding": Sliding(15.0, 11.0, 2.0, filter_time=0.01, period=PERIOD),
        "algebraic": Algebraic(15.0, 11.0, filter_time=0.01, period=PERIOD, until=0.5),
    }
    found: dict[str, Any] = {}
    for name, outer in made.items():
        values = [
            outer(Seen(0.5, 0.5 - float(y), float(d), 0.1 * float(d)))
            for y, d in zip(tip, bend, strict=True)
        ]
        found[name] = [*values[:5], values[100], values[199], values[-1], sum(values)]
    return found


def rival(name: str) -> Any:
    """A rival tuned by its rule."""
    made = rivals.builders(setting())[name]()
    figures = {
        n: getattr(made, n)
        for n in ("rule", "knob", "peak", "states", "multiplications", "impulses")
    }
    return dumped(figures | {"response": _response(law_filter(made.law))})


RIVALS = (
    rivals.FRACLINK,
    rivals.QUIETER,
    rivals.INTEGER,
    rivals.PRINTED,
    rivals.CORRECTED,
    "collocated PD",
    "ZV shaping",
    "ZVD shaping",
    "PD on the tip estimate",
    "LQG",
    "H∞ loop shaping",
    "sliding mode",
    "algebraic estimator + GPI",
)


# --- assessments


def assessment() -> Any:
    """Every judgement of one design."""
    made, massive = (
        design_of(),
        replace(GEARED, link=replace(GEARED.link, mass=0.00735)),
    )
    with_modes = fl.design(
        massive.model,
        massive,
        payloads=(0.02, 0.04),
        gain_crossover=12.0,
        phase_margin=fl.deg(45),
    )
    payloads = np.linspace(0.015, 0.05, 6)
    return dumped(
        {
            "curves": {
                kind: margin_curve(made, payloads, kind=kind)
                for kind in ("ideal", "motor", "loop")
            },
            "sampled": margin_curve(made, payloads[::2], kind="sampled"),
            "budget": {str(m): phase_budget(made, m) for m in (0.02, 0.03, 0.04)},
            "tolerances": tolerances(made),
            "spillover": spillover(
                made, (VibrationMode(40.0, 0.05, 0.3), VibrationMode(90.0, 0.02, -0.1))
            ),
            "mode gains": [
                mode_gains(with_modes),
                mode_gains(with_modes, limit=0.5, damping_ratio=0.01),
            ],
            "findings": [str(finding) for finding in with_modes.findings],
        }
    )


def alternatives() -> Any:
    """Other orders and filters at the same Ms."""
    return dumped(compare_at_equal_sensitivity(design_of(), max_sensitivity=1.7))


def feasible() -> Any:
    """The map of feasible requests."""
    found = feasibility_map(
        RIG.model,
        RIG,
        gain_crossovers=np.linspace(8.0, 20.0, 9),
        phase_margins=np.radians(np.linspace(20.0, 80.0, 7)),
    )
    return dumped(found)


# --- systems

SYSTEMS = {
    "half": 1 / (s**0.5 + 1),
    "two orders": 1 / (0.8 * s**2.2 + 0.5 * s**0.9 + 1),
    "biproper": (s**1.3 + 2.0) / (s**1.3 + 0.4 * s**0.5 + 1.0),
    "late": (1 / (s**1.1 + 0.7)).delayed(0.3),
    "retarded": (2.0 * (1 / (s**1.5 + 0.4)).delayed(0.2)).feedback(),
    "neutral": ((0.4 * s**1.2 + 1) / (s**1.2 + 0.5)).delayed(0.7).feedback(),
    "closed": (0.148 * s**0.65 * 100 / (s**1.92 + 100)).feedback(),
    "unstable": 1 / (s**1.4 - 0.5 * s**0.7 + 1),
}
LOOPS = {
    "link": 0.148 * s**0.65 * 100 / (s**1.92 + 100),
    "integrator": 3.0 / (s**1.1 * (s + 2.0) * (0.1 * s + 1.0)),
    "late": (1.2 / (s**0.8 * (0.3 * s + 1.0))).delayed(0.25),
}


def system(name: str) -> Any:
    """Poles, verdict, norms and responses of a system."""
    G = SYSTEMS[name]
    made: dict[str, Any] = {"stable": dumped(fl.is_stable(G))}
    with contextlib.suppress(fl.errors.FraclinkError):
        made["poles"] = dumped(fl.poles(G))
    for p in (2.0, np.inf):
        try:
            made[f"norm {p}"] = fl.norm(G, p)
        except fl.errors.FraclinkError as error:
            made[f"norm {p}"] = type(error).__name__
    if name == "neutral":  # its response jumps for ever: refused
        return made
    if any(term.delay for term in G.denominator):
        made["step"] = [float(y) for y in fl.step_response(G, 10.0, 0.05).output[2::22]]
    else:
        times = np.array([0.02, 0.1, 0.5, 1.0, 3.0, 10.0])
        made["step"] = [float(y) for y in fl.step_response(G, times).output]
        made["impulse"] = [float(y) for y in fl.impulse_response(G, times).output]
    u = np.sin(0.3 * np.arange(60.0)) + (np.arange(60) > 30)
    for hold in ("zero", "first"):
        made[hold] = [
            float(y) for y in fl.time_response(G, u, 0.05, hold=hold).output[1::12]
        ]
    return made


def loop_margins(name: str) -> Any:
    """All margins of an open loop."""
    L = LOOPS[name]
    return dumped(
        {
            "margins": fl.margins(L),
            "disks": [fl.disk_margin(L, skew=skew) for skew in (0.0, 1.0, -1.0)],
            "sensitivity": [fl.norm(1 / (1 + L), np.inf)] if L.delay == 0 else [],
        }
    )


METHODS = ("oustaloup", "refined", "carlson", "charef", "minimax")


def approximations() -> Any:
    """Rational approximations by every name, continuous and sampled."""
    made: dict[str, Any] = {}
    for method in METHODS:
        found = fl.approximate(s**0.5 / (s + 1), (0.01, 100.0), 4, method=method)
        made[method] = found
        made[f"{method}, sampled"] = fl.approximate(
            1 / (s**0.5 + 1), (0.01, 50.0), 4, method=method, period=0.05
        )
    made["matched-z"] = fl.approximate(
        1 / (s**0.5 + 1), (0.01, 50.0), 4, method="matched-z", period=0.05
    )
    points = np.array([0.05, 0.3, 1.0, 4.0, 20.0])
    return {
        name: [
            item.order,
            item.error_db,
            item.error_deg,
            *map(dumped, item.frequency_response(points).tolist()),
        ]
        for name, item in made.items()
    }


# --- drawings


def _drawn(figure: Any) -> Any:
    """What a figure holds: its words, its scales and the values of its marks, not how
    they are styled.
    """
    return None if figure is None else dumped(figure)


@functools.cache
def log() -> fl.Experiment:
    """A bundled log."""
    return fl.read_log(fl.bundled_log("prbs_30g"), rig=RIG)


@functools.cache
def fit() -> fl.Fit:
    """Its fit."""
    return fl.identify(log())


def of_a_log() -> Any:
    """Drawings of a log, its fit and its residual."""
    made = {
        "log": figures.log_figure(log()),
        "fit": figures.fit_figure(log(), fit()),
        "detail": figures.detail_figure(fit()),
        "response": figures.response_figure(log(), fit()),
        "residual": figures.residual_figure(fit()),
        "models": figures.models_figure({"UD-FOM": fit()}, "UD-FOM"),
    }
    return {name: _drawn(figure) for name, figure in made.items()}


def of_a_design() -> Any:
    """Drawings of a loop."""
    made = design_of()
    curves = tuple(
        margin_curve(made, (0.015, 0.03, 0.05), kind=kind)
        for kind in ("ideal", "motor", "loop")
    )
    found = feasibility_map(
        RIG.model,
        RIG,
        gain_crossovers=(9.0, 12.0, 15.0),
        phase_margins=tuple(np.radians((30.0, 50.0, 70.0))),
    )
    shown = {
        "bode": loops.bode_figure(made),
        "nyquist": loops.nyquist_figure(made),
        "proved": loops.nyquist_figure(made, 0.35),
        "margins": loops.margins_figure(made),
        "curves": loops.margin_curves_figure(curves, made.payloads, made.phase_margin),
        "budget": loops.budget_figure(phase_budget(made, 0.02), 0.02),
        "map": loops.map_figure(found, (12.0, 0.9), (12.0, 0.8)),
    }
    return {name: _drawn(figure) for name, figure in shown.items()}


def of_a_pid() -> Any:
    """Drawings of a fractional PID."""
    made = fl.tune_pid(
        1 / (0.8 * s**2.2 + 0.5 * s**0.9 + 1),
        gain_crossover=2.0,
        integral_order=1.2,
        derivative_order=0.95,
    )
    return {"loop": _drawn(loops.pid_figure(made))}


def of_runs() -> Any:
    """Drawings of moves."""
    law = fl.Law.load(Path(__file__).resolve().parent / "laws" / "default.json")
    runs = [
        fl.simulate(
            law,
            fl.smooth_step(1.0, 0.5),
            rig=RIG,
            model=RIG.model,
            payload=m,
            duration=2.0,
            noise=0.0,
        )
        for m in (0.02, 0.04)
    ]
    return _drawn(moves_figure(runs))


def of_a_campaign() -> Any:
    """Drawings and tables of many runs, of which some never settle."""
    law = fl.Law.load(Path(__file__).resolve().parent / "laws" / "default.json")
    columns = simulate_part(
        Campaign.of(RIG, RIG.model, law, runs=400, seed=5, motor_loop="sampled"), 0
    )
    shown = {name: np.array(columns[name], dtype=float) for name in fleets.SHOWN}
    shown["settling_time"][::9] = np.inf
    across, up = np.random.default_rng(1).normal(size=(2, 2000))
    failures = fleets.failures_figure(across, up, across + up > 1.5, ("across", "up"))
    return {
        "spread": [_drawn(figure) for figure in fleets.spread_figures(shown)],
        "failures": _drawn(failures),
    }


def of_a_fault() -> Any:
    """The drawing of a case."""
    bench = Bench.of(design_of("geared"), link_mass=0.00735)
    outcome = run_case(bench, Case("F09", 1, 0.030, "mid", 1), single=False)
    return _drawn(outcome_figure(bench, outcome))


def of_a_structure() -> Any:
    """A structure of one's own fitted to a log: its drawing, its tables, its findings."""
    random = np.random.default_rng(2)
    u = np.repeat(random.choice([-1.0, 1.0], size=40), 10)
    y = fl.time_response((2.0 / (0.7 * s**1.2 + 1)).delayed(0.15), u, 0.05).output
    data = Recording(period=0.05, input=u, output=y + 0.02 * random.normal(size=400))
    made = fl.identify_structure(data, "k*exp(-L*s)/(T*s**a + 1)", hold="zero")
    numbers = {
        name: getattr(made, name)
        for name in ("parameters", "standard_errors", "nmse", "heldout_nmse")
    }
    return [
        dumped(numbers),
        dumped(made.intervals),
        _drawn(structure_figure(made)),
        made.undetermined,
    ]


def of_a_shaped_move() -> Any:
    """The fastest move of the tip: its figures and drawing."""
    rig = fl.Rig.named("paper-2023-geared")
    made = fl.shape(_of_geared(rig), 0.5, voltage=8.0, seeds=1)
    return [
        dumped([m.name for m in made.measured]),
        dumped(made.settling_time),
        _drawn(shaped_figure(made)),
    ]


@functools.cache
def _of_geared(rig: fl.Rig) -> fl.Design:
    asked: dict[str, Any] = {
        "payloads": (0.020, 0.040),
        "gain_crossover": 12.0,
        "phase_margin": fl.deg(50),
    }
    return fl.design(rig.model, rig, **asked, filter_time=0.02)


SVG_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def sketches() -> Any:
    """The numbers and words of the sketches."""
    drawn = {"arm": arm_sketch(("one", "two", "three")), "loop": loop_sketch()}
    return {
        name: [
            dumped([float(x) for x in SVG_NUMBER.findall(text)]),
            re.findall(r">([^<>]+)<", text),
        ]
        for name, text in drawn.items()
    }


def exported_estimator() -> Any:
    """The data of a payload estimator as C, in both precisions."""
    rig = fl.Rig.named("paper-2023-geared")
    made = _of_geared(rig)
    bank = fl.payload_estimator(rig.model, rig, made.law(), made.payloads)
    shipped = {"double": bank, "single": bank.in_precision("single")}
    files = {
        name: payload_files(item)["payload_data.h"].decode()
        for name, item in shipped.items()
    }
    hexes = {
        name: [float.fromhex(x) for x in re.findall(r"-?0x[0-9a-f.]+p[+-]?\d+", text)]
        for name, text in files.items()
    }
    return {
        "sizes": [bank.state_size, shipped["single"].state_size],
        **{n: dumped(v) for n, v in hexes.items()},
    }


def enclosures() -> Any:
    """The worst phase margin over a box, from both sides."""
    law = fl.Law.load(Path(__file__).resolve().parent / "laws" / "outer.json")
    statement = fl.certify(
        law, model=RIG.model, rig=RIG, payloads=(0.02, 0.04), modulus_margin=0.3
    ).statement
    found = fl.enclose_phase_margin(statement, law, width=fl.deg(0.5))
    return dumped(found)


def rooms() -> Entries:
    """Every entry."""
    made: Entries = {
        "corrections": corrections,
        "outer controllers": outer_controllers,
        "assessment": assessment,
        "alternatives": alternatives,
        "feasible": feasible,
        "approximations": approximations,
        "drawings of a log": of_a_log,
        "drawings of a design": of_a_design,
        "drawings of a fractional PID": of_a_pid,
        "drawings of runs": of_runs,
        "drawings of a campaign": of_a_campaign,
        "drawing of a fault": of_a_fault,
        "drawing of a structure": of_a_structure,
        "drawing of a shaped move": of_a_shaped_move,
        "sketches": sketches,
        "payload estimator": exported_estimator,
        "enclosure": enclosures,
    }
    made |= {f"system {name}": partial(system, name) for name in SYSTEMS}
    made |= {f"loop {name}": partial(loop_margins, name) for name in LOOPS}
    return made | {f"rival {name}": partial(rival, name) for name in RIVALS}
