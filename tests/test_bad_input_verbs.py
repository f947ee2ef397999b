"""Whatever is handed to a public class or function, in any argument: it works or raises
an error of fraclink.

The values are what scripts hand over by mistake: the file's name for the log, the
design for the law, a text, a gap, a whole number that no float holds. Each stands alone
in a call whose other arguments are right.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import fraclink as fl
import fracsys
from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._identify import (
    design_experiment,
    identify_frequency_response,
    identify_motor,
    identify_payloads,
    simulated_torque,
)
from fraclink._simulate import (
    Beam,
    FractionalKelvinVoigt,
    KelvinVoigt,
    Obstacle,
    PayloadChange,
    PowerLaw,
    Restart,
    SensorFault,
    Sensors,
    TipPulse,
    geared,
    simulate_log,
)
from fraclink.errors import FraclinkError
from fraclink.trials._stages import simulate_move
from fracsys._response import grunwald_letnikov, impulse_response
from junk import (
    ANGLE,
    FREQUENCY,
    LINK,
    RIG,
    SYSTEM,
    Call,
    design,
    fields_of,
    law,
    log,
    take_or_refuse,
    twin,
)
from made_logs import example_motor_log

# Made once: its exact solution takes half a second, and every value of every argument
# asks for it.
motor_log = functools.cache(example_motor_log)


# What is called, and arguments with which it works. Options that are plain switches are
# left out.
CALLS: dict[str, Call] = {
    "LinkModel": (LinkModel, lambda: fields_of(LINK)),
    "Controller": (
        fl.Controller,
        lambda: {"gain": 0.07, "order": 0.7, "filter_time": 0.01, "filter_order": 1},
    ),
    "Experiment": (
        Experiment,
        lambda: {**fields_of(log()), "findings": (), "notes": ()},
    ),
    "Motor": (type(RIG.motor), lambda: fields_of(RIG.motor)),
    "Link": (type(RIG.link), lambda: fields_of(RIG.link)),
    "Payloads": (type(RIG.payloads), lambda: fields_of(RIG.payloads)),
    "Gauge": (type(RIG.gauge), lambda: fields_of(RIG.gauge)),
    "MotorLoop": (type(RIG.motor_loop), lambda: fields_of(RIG.motor_loop)),
    "smooth_step": (
        fl.smooth_step,
        lambda: {"amplitude": 1.0, "duration": 0.5, "start": 0.0},
    ),
    "pulse": (
        fl.extend.pulse,
        lambda: {"amplitude": 1.0, "width": 0.5, "start": 0.0, "rise": 0.1},
    ),
    "prbs": (
        fl.prbs,
        lambda: {"amplitude": 1.0, "bit": 0.1, "bits": 20, "register": 7, "start": 0.0},
    ),
    "chirp": (
        fl.chirp,
        lambda: {
            "amplitude": 1.0,
            "start_frequency_hz": 1.0,
            "end_frequency_hz": 5.0,
            "duration": 2.0,
        },
    ),
    "hold": (fl.extend.hold, lambda: {"angle": 1.0, "duration": 1.0}),
    "identify": (
        functools.partial(fl.identify, details=False),
        lambda: {
            "log": log(),
            "structure": "UD-FOM",
            "heldout": 0.4,
            "stiffness": None,
            "fixed": None,
            "guess": None,
            "hold": "auto",
        },
    ),
    "identify_payloads": (
        identify_payloads,
        lambda: {
            "logs": [log(), log()],
            "structure": "UD-FOM",
            "common": None,
            "length": 0.65,
            "stiffness": None,
            "delay": None,
            "hold": "auto",
        },
    ),
    "identify_motor": (
        identify_motor,
        lambda: {
            "voltage": motor_log()[0],
            "motor_angle": motor_log()[1],
            "period": 0.004,
            "torque": None,
            "inertia": 6.87e-5,
            "delay": None,
            "dead_zone": None,
            "window": None,
        },
    ),
    "identify_frequency_response": (
        identify_frequency_response,
        lambda: {
            "frequency": FREQUENCY,
            "response": LINK.torque()(1j * FREQUENCY),
            "coherence": None,
            "weights": None,
            "resonances": 1,
            "anti_resonances": 0,
            "derivative": None,
            "order": None,
            "delay": None,
        },
    ),
    "design_experiment": (
        design_experiment,
        lambda: {
            "model": LINK,
            "standard_error": 0.001,
            "noise": 0.01,
            "period": 0.004,
            "duration": 1.0,
            "kind": "prbs",
            "motor": RIG.motor,
            "deflection_limit": math.inf,
            "inner_pole": 80.0,
        },
    ),
    "simulated_torque": (
        simulated_torque,
        lambda: {
            "model": LINK,
            "motor_angle": ANGLE,
            "period": 0.004,
            "delay": 0.0,
            "hold": "auto",
        },
    ),
    "compare_structures": (
        functools.partial(fl.compare_structures, details=False),
        lambda: {"log": log()},
    ),
    "diagnose": (fl.logs.diagnose, lambda: {"experiment": log(), "rig": RIG}),
    "simulate": (
        fl.simulate,
        lambda: {
            "design": law(),
            "reference": fl.smooth_step(1.0, duration=0.2),
            "rig": RIG,
            "model": LINK,
            "payload": 0.030,
            "duration": 0.4,
            "motor_loop": "ideal",
            "gauge_delay": 0.0,
            "gauge_gain": 1.0,
            "gauge_offset": 0.0,
            "noise": 0.0,
            "seed": 0,
            "delay_samples": 1,
            "substeps": 10,
            "compensation": "ideal",
        },
    ),
    "simulate_move": (
        simulate_move,
        lambda: {"made": design(), "duration": 0.6, "payload": 0.030, "law": law()},
    ),
    "Twin.from_rig": (
        fl.Twin.from_rig,
        lambda: {
            "rig": RIG,
            "payload": 0.030,
            "link_mass": 0.007,
            "rigidity": "stiffness",
            "gauge_delay": 0.0,
            "gauge_gain": 1.0,
            "stiction": None,
            "modes": None,
            "damping": None,
        },
    ),
    "simulate the twin": (
        fl.simulate,
        lambda: {
            "design": law(),
            "reference": fl.smooth_step(1.0, duration=0.2),
            "arm": twin(),
            "duration": 0.3,
            "events": (),
            "seed": 0,
        },
    ),
    "simulate_log": (
        simulate_log,
        lambda: {
            "beam": twin().beam,
            "damping": KelvinVoigt(0.001),
            "reference": ANGLE,
            "period": 0.004,
            "drive": "servo",
            "sensors": None,
            "modes": None,
            "step": 0.001,
            "servo_pole": 80.0,
            "seed": 0,
        },
    ),
    "step_response": (
        fracsys.step_response,
        lambda: {"G": SYSTEM, "time": 1.0, "period": 0.1},
    ),
    "impulse_response": (
        impulse_response,
        lambda: {"G": SYSTEM, "time": 1.0, "period": 0.1},
    ),
    "time_response": (
        fracsys.time_response,
        lambda: {"G": SYSTEM, "u": np.ones(9), "period": 0.1, "hold": "zero"},
    ),
    "grunwald_letnikov": (
        grunwald_letnikov,
        lambda: {"G": SYSTEM, "u": np.ones(9), "period": 0.1},
    ),
    "poles": (fracsys.poles, lambda: {"system": SYSTEM}),
    "is_stable": (fracsys.is_stable, lambda: {"system": SYSTEM}),
    "margins": (
        fracsys.margins,
        lambda: {"loop": SYSTEM, "limit": None, "unstable_poles": None},
    ),
    "mittag_leffler": (
        fracsys.mittag_leffler,
        lambda: {"z": [1.0, 1j], "alpha": 0.8, "beta": 1.2},
    ),
    "approximate": (
        fracsys.approximate,
        lambda: {
            "system": SYSTEM,
            "band": (1.0, 100.0),
            "order": 3,
            "method": "oustaloup",
            "period": None,
        },
    ),
    "Beam": (Beam, lambda: fields_of(twin().beam)),
    "Sensors": (Sensors, lambda: fields_of(twin().sensors)),
    "KelvinVoigt": (KelvinVoigt, lambda: {"time": 0.01}),
    "FractionalKelvinVoigt": (
        FractionalKelvinVoigt,
        lambda: {"coefficient": 0.01, "order": 0.5},
    ),
    "PowerLaw": (PowerLaw, lambda: {"order": 1.92}),
    "PayloadChange": (PayloadChange, lambda: {"time": 0.1, "payload": 0.030}),
    "Obstacle": (Obstacle, lambda: fields_of(Obstacle(time=0.1, until=0.2, angle=0.1))),
    "Restart": (Restart, lambda: {"time": 0.1}),
    "SensorFault": (
        SensorFault,
        lambda: {"time": 0.1, "until": 0.2, "kind": "gauge offset", "value": 0.1},
    ),
    "TipPulse": (TipPulse, lambda: {"time": 0.1, "force": 0.1, "duration": 0.02}),
    "geared": (geared, lambda: {"rig": RIG, "ratio": 50.0}),
}
ARGUMENTS = [(name, field) for name, (_, usual) in CALLS.items() for field in usual()]


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


NUMBERS = [
    (name, field)
    for name, field in ARGUMENTS
    if isinstance(CALLS[name][1]()[field], float)
]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
@given(st.sampled_from(NUMBERS), st.floats() | st.integers() | st.floats(-3.0, 3.0))
def test_any_number_in_one_argument_is_taken_or_refused(
    where: tuple[str, str], value: float
) -> None:
    call, usual = CALLS[where[0]]
    try:
        call(**{**usual(), where[1]: value})
    except FraclinkError as error:
        assert "\n" not in str(error)
