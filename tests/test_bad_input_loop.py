"""The same junk for the verbs of design, proof, export, campaign and real time: taken,
or refused by name.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink import _export as export
from fraclink import _kernels
from fraclink._arm.box import ParameterBox
from fraclink._arm.motor_loop import MotorLoop
from fraclink._certify import Statement, enclose_phase_margin
from fraclink._design import optimise
from fraclink._design.alternatives import feasibility_map
from fraclink._design.assess import margin_curve, phase_budget
from fraclink._design.completed import design_for
from fraclink._law import Moves, discretize_controller, equip
from fraclink._simulate import geared
from fraclink.errors import FieldError
from fraclink.lab._connections import (
    Callback,
    Library,
    SharedMemory,
    Udp,
    parse_connection,
)
from fraclink.lab._loop import run_realtime
from fraclink.trials import _arms as campaign
from fraclink.trials import _faults as faults
from fraclink.trials._campaign import Campaign, Distribution, Draws, draws_for
from fracsys._discrete import fit_discrete
from junk import JUNK, LINK, RIG, Call, design, fields_of, law, take_or_refuse

WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
    "margins": "loop",
    "filter_time": 0.0,
    "filter_order": None,
    "inner": "ideal",
    "placement": "tustin",
    "max_sensitivity": None,
    "noise_gain": None,
    "settling_time": None,
    "mode_gain": None,
}


@functools.cache
def statement() -> Statement:
    point = ParameterBox.at(LINK)
    exact = {"payloads": (0.030, 0.030), "delay": (0.0, 0.0), "box": point}
    return fl.certify(design(), modulus_margin=0.999, **exact).statement


@functools.cache
def drawn() -> Campaign:
    return Campaign.of(RIG, RIG.model, law(), runs=2)


@functools.cache
def bench() -> faults.Bench:
    return faults.Bench.of(design(), geared(RIG))


def at_rest() -> Callback:
    return Callback(read=lambda: (0.2, 0.0), write=lambda command: None)


# What is called, and arguments with which it works; what takes a file is called in a
# scratch folder.
CALLS: dict[str, Call] = {
    "design": (
        fl.design,
        lambda: {"model": LINK, "rig": RIG, "natural_frequencies": None, **WANTED},
    ),
    "Design.at": (design().at, lambda: {"payload": 0.030}),
    "Design.at_frequency": (design().at_frequency, lambda: {"natural_frequency": 11.0}),
    "Design.payload": (design().payload, lambda: {"natural_frequency": 11.0}),
    "Design.sampled_at": (
        design().sampled_at,
        lambda: {"payload": 0.030, "realisation": "exact"},
    ),
    "Design.sampled_plant": (
        design().sampled_plant,
        lambda: {"natural_frequency": 11.0},
    ),
    "Design.law": (design().law, lambda: {"order": 1, "precision": "double"}),
    "optimise": (optimise, lambda: {"design": design(), "goal": "noise"}),
    "feasibility_map": (
        feasibility_map,
        lambda: {
            "model": LINK,
            "rig": RIG,
            "gain_crossovers": [10.0, 12.0],
            "phase_margins": [0.8],
            "payloads": (0.020, 0.040),
            "natural_frequencies": None,
            "margins": "loop",
            "filter_time": None,
            "filter_order": 1,
            "inner": "ideal",
            "placement": "tustin",
        },
    ),
    "phase_budget": (phase_budget, lambda: {"design": design(), "payload": 0.030}),
    "margin_curve": (
        margin_curve,
        lambda: {"design": design(), "payloads": [0.030], "kind": "loop"},
    ),
    "Controller": (fl.Controller, lambda: fields_of(design().controller)),
    "MotorLoop": (MotorLoop, lambda: fields_of(MotorLoop())),
    "Moves": (Moves, lambda: fields_of(Moves())),
    "equip": (equip, lambda: {"law": law(), "rig": RIG, "link": LINK, "moves": None}),
    "discretize": (
        functools.partial(fl.discretize, design().controller),
        lambda: {"period": RIG.period, "order": 1, "precision": "double"},
    ),
    "discretize_controller": (
        functools.partial(discretize_controller, design().controller),
        lambda: {
            "period": RIG.period,
            "order": 1,
            "link": LINK,
            "rig": RIG,
            "moves": None,
            "band": (1.0, 50.0),
        },
    ),
    "fit_discrete": (
        fit_discrete,
        lambda: {
            "response": lambda frequency: (1j * frequency) ** 0.5,
            "period": 0.004,
            "band": (1.0, 100.0),
            "order": 1,
            "zeros_at_one": 0,
            "offset": 0.0,
            "weight": None,
            "tolerance_db": 0.1,
            "tolerance_deg": 0.5,
            "pairs": 0,
        },
    ),
    "certify": (
        fl.certify,
        lambda: {
            "subject": design(),
            "model": None,
            "rig": None,
            "payloads": (0.030, 0.030),
            "delay": (0.0, 0.0),
            # not kept, which costs less to find out than a proof
            "modulus_margin": 0.999,
            "law": law(),
            "inner": None,
            "box": None,
        },
    ),
    "enclose_phase_margin": (
        enclose_phase_margin,
        lambda: {"statement": statement(), "law": law(), "width": 0.5, "most": 10},
    ),
    "export_c": (
        functools.partial(fl.export_c, force=True),
        lambda: {
            "law": law(),
            "folder": Path("c"),
            "precision": None,
            "name": "law_data",
            "title": "",
            "certificate": None,
        },
    ),
    "export_io": (
        functools.partial(export.export_io, force=True),
        lambda: {"folder": Path("io")},
    ),
    "export_fmu": (
        functools.partial(export.export_fmu, force=True),
        lambda: {
            "law": law(),
            "path": Path("arm_law.fmu"),
            "precision": None,
            "compilers": (),
        },
    ),
    "Campaign.of": (
        Campaign.of,
        lambda: {
            "rig": RIG,
            "model": RIG.model,
            "law": law(),
            "runs": 2,
            "seed": 0,
            "draws": None,
            "motor_loop": "sampled",
        },
    ),
    "Campaign": (Campaign, lambda: fields_of(drawn())),
    "Draws": (Draws, lambda: fields_of(drawn().draws)),
    "draws_for": (draws_for, lambda: {"rig": RIG, "model": LINK}),
    "Distribution": (
        Distribution,
        lambda: {"kind": "uniform", "low": 0.0, "high": 1.0},
    ),
    "simulate_part": (campaign.simulate_part, lambda: {"campaign": drawn(), "part": 0}),
    "arm_of": (campaign.arm_of, lambda: {"campaign": drawn(), "run": 0}),
    "Bench.of": (faults.Bench.of, lambda: {"design": design(), "rig": geared(RIG)}),
    "cases": (
        faults.cases,
        lambda: {
            "bench": bench(),
            "only": ["F01"],
            "severities": [1],
            "payloads": [0.030],
            "phases": ["mid"],
            "seeds": [1],
        },
    ),
    "fault_named": (faults.fault_named, lambda: {"number": "F07"}),
    "Case": (faults.Case, lambda: fields_of(faults.Case("F07", 2, 0.030, "mid", 1))),
    "run_case": (
        faults.run_case,
        lambda: {"bench": bench(), "case": faults.Case("F07", 2, 0.030, "mid", 1)},
    ),
    "run_faults": (faults.run_faults, lambda: {"bench": bench(), "planned": []}),
    "design_for": (design_for, lambda: {"rig": RIG, "model": LINK, **WANTED}),
    "Udp": (Udp, lambda: {"host": "localhost", "port": 5005}),
    "SharedMemory": (SharedMemory, lambda: {"name": "arm"}),
    "Library": (Library, lambda: {"path": Path("board.so")}),
    "parse_connection": (parse_connection, lambda: {"io": "shm:arm"}),
}
ARGUMENTS = [(name, field) for name, (_, usual) in CALLS.items() for field in usual()]
REALTIME: Call = (
    functools.partial(run_realtime, patience=0.02, lock_memory=False),
    lambda: {
        "law": law(),
        "reference": fl.extend.hold(0.0),
        "connection": at_rest(),
        "duration": 0.02,
        "priority": 0,
        "allowed_overruns": 0,
    },
)


@pytest.fixture(autouse=True)
def _scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(
        tmp_path
    )  # where "12" and log.csv are made, which are names of files like any other


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
def test_the_usual_call_works(name: str) -> None:
    call, usual = CALLS[name]
    call(**usual())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of numpy, on the way to an error
@pytest.mark.parametrize(
    ("name", "field"), ARGUMENTS, ids=[".".join(pair) for pair in ARGUMENTS]
)
def test_junk_in_one_argument_is_taken_or_refused_by_name(
    name: str, field: str
) -> None:
    take_or_refuse(CALLS[name], field)


@pytest.mark.skipif(not _kernels.REALTIME, reason="the real-time loop is Linux's")
@pytest.mark.parametrize("field", REALTIME[1]())
def test_junk_in_one_argument_of_a_run_in_real_time(field: str) -> None:
    # None is no junk for the duration, and would take three seconds of the wall clock.
    take_or_refuse(REALTIME, field, [value for value in JUNK if value is not None])


@pytest.mark.parametrize(
    "field", ["max_sensitivity", "gain_crossover", "noise_gain", "mode_gain", "least"]
)
@pytest.mark.parametrize("value", ["12", float("nan"), -1.0, np.ones(2)])
def test_a_bound_of_the_optimisation_is_refused_before_the_search(
    field: str, value: object
) -> None:
    with pytest.raises(FieldError, match=field):
        optimise(design(), **{field: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("out", ["", "\x00", None, b"law"])
def test_what_names_no_folder_is_refused_and_nothing_is_written(out: object) -> None:
    with pytest.raises(FieldError, match=r"^folder: not the name of a file"):
        fl.export_c(law(), out)  # type: ignore[arg-type]
    assert not list(Path().iterdir())
