"""Every object a user can obtain is written to a file and read back equal."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
import fracsys
from fraclink.errors import FieldError
from law_bench import documented_design

S = fracsys.s
LOOP = 2.0 / (S**1.5 + S)


@cache
def design() -> fl.Design:
    rig = fl.Rig.named("paper-2023")
    return documented_design(rig)


@cache
def pid() -> fl.extend.PidTuning:
    plant = (1 / (0.4 * S**1.5 + 1)).delayed(0.05)
    return fl.tune_pid(plant, gain_crossover=1.0, form="PI", phase_margin=fl.deg(70))


@cache
def log() -> fl.Experiment:
    return fl.read_log(fl.bundled_log("pulse_30g"))


HELD: dict[str, Any] = {
    "FractionalTransferFunction": lambda: (1 / (S**0.5 + 3)).delayed(0.1),
    "TimeResponse": lambda: fracsys.step_response(1 / (S**0.5 + 1), 1.0, 0.01),
    "DiscreteModes": lambda: fracsys.discrete_modes(1 / (S + 1), 0.1, span=10.0),
    "Margins": lambda: fracsys.margins(LOOP),
    "StabilityVerdict": lambda: fracsys.is_stable(LOOP),
    "RationalApproximation": lambda: fracsys.approximate(
        1 / (S**0.5 + 1), (0.1, 10.0), order=4
    ),
    "Controller": lambda: design().controller,
    "Design": design,
    "LinkModel": lambda: design().model,
    "Law": lambda: fl.discretize(design()),
    "Limits": lambda: fl.discretize(design()).limits,
    "MarginCurve": lambda: fl.extend.margin_curve(design(), [0.02, 0.03]),
    "Requirement": lambda: design().requirements[0],
    "Run": lambda: fl.simulate(
        design(), fl.smooth_step(1.0, duration=0.5), duration=0.8
    ),
    "Metrics": lambda: HELD["Run"]().metrics,
    "Experiment": log,
    "Fit": lambda: fl.identify(log(), "D-IOM", details=False),
    "Comparison": lambda: fl.compare_structures(log()),
    "LogListing": lambda: fl.inspect_log(fl.bundled_log("pulse_30g")),
    "PidTuning": pid,
    "PidStep": lambda: pid().step(),
    "FractionalPid": lambda: pid().controller,
    "SampledReference": lambda: fl.extend.SampledReference(
        0.1, [[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]
    ),
    "Finding": lambda: fl.Finding(
        "W210", "warning", "an offset", {"offset": 0.1}, "subtract it"
    ),
    "Rig": lambda: fl.Rig.named("paper-2023"),
    "SecondMode": lambda: fl.SecondMode(60.0, 0.1, 0.02),
    "Path": lambda: fl.smooth_step(1.0, duration=0.5),
}
ENDINGS = {"Rig": ".toml", "Experiment": ".npz", "Run": ".npz"}


@pytest.mark.slow
@pytest.mark.parametrize("name", HELD)
def test_what_a_user_holds_is_saved_and_loaded_equal(name: str, tmp_path: Path) -> None:
    held = HELD[name]()
    assert type(held).__name__ == name
    back = fl.load(fl.save(held, tmp_path / f"held{ENDINGS.get(name, '.json')}"))
    # PidStep is a tuple of arrays, which Python does not compare with ==.
    assert np.array_equal(back, held) if name == "PidStep" else back == held
    assert type(back) is type(held)


def test_arrays_go_into_an_archive_where_the_ending_says_so(tmp_path: Path) -> None:
    response = HELD["TimeResponse"]()
    place = fl.save(response, tmp_path / "step.npz")
    assert fl.load(place) == response
    assert np.load(place)["output"].tolist() == response.output.tolist()


@pytest.mark.slow
def test_a_saved_log_is_read_as_a_log(tmp_path: Path) -> None:
    log().save(tmp_path / "log.csv")
    place = fl.save(log(), tmp_path / "log.npz")
    assert fl.read_log(place) == log()
    # whatever columns the rig states for the logs that it records
    rig = fl.Rig.named("paper-2023")
    stated = {"time": "t [s]", "motor_angle": "theta [deg]", "torque": "gamma [Nm]"}
    assert fl.read_log(place, rig=rig, columns=stated, payload=0.05).payload == 0.05
    cut, text = (
        fl.read_log(tmp_path / name, keep=(5.0, 9.0)) for name in ("log.npz", "log.csv")
    )
    assert np.array_equal(cut.whole_angle, text.whole_angle)
    assert np.array_equal(cut.output, text.output)
    assert cut.start_time == text.start_time and cut.findings[-1] == text.findings[-1]
    again = fl.read_log(fl.save(cut, tmp_path / "cut.npz"), keep=(0.5, 1.5))
    assert np.array_equal(
        again.whole_angle, log().motor_angle[: again.whole_angle.size]
    )


@pytest.mark.slow
def test_a_certificate_is_saved_and_loaded(tmp_path: Path) -> None:
    certificate = fl.certify(design(), payloads=(0.03, 0.03))
    assert fl.load(fl.save(certificate, tmp_path / "certificate.json")) == certificate
    statement = certificate.statement
    assert fl.load(fl.save(statement, tmp_path / "statement.json")) == statement


@pytest.mark.parametrize("value", [(), print, 3.0, fl.Callback, object()])
def test_what_is_no_result_is_refused(value: Any, tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="without a file format"):
        fl.save(value, tmp_path / "nothing.json")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["TimeResponse", "MarginCurve", "DiscreteModes", "Run", "Comparison", "Path"],
)
def test_results_with_arrays_are_equal_where_their_samples_are(name: str) -> None:
    one, other = HELD[name](), HELD[name]()
    assert one == other and hash(one) == hash(other)
    assert one != 3.0 and one != "text"
    if name == "TimeResponse":
        assert one != fracsys.step_response(1 / (S**0.5 + 1), 1.0, 0.02)
