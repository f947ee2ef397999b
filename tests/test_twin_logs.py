"""Logs of the twin: readable, marked as simulated, and the bundled ones are those made
by the script.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

import fraclink as fl

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_bundled_logs_are_what_the_script_makes():
    path = ROOT / "tools" / "make_logs.py"
    spec = importlib.util.spec_from_file_location("make_logs", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made = module.build()
    folder = ROOT / "src" / "fraclink" / "data" / "logs"
    assert sorted(made) == sorted(p.name for p in folder.glob("*.csv"))
    for name, text in made.items():
        assert (folder / name).read_bytes() == text.encode(), name
        assert len(text) < 250_000


@pytest.mark.parametrize(
    ("name", "payload"), [("prbs_20g", 0.02), ("prbs_30g", 0.03), ("pulse_30g", 0.03)]
)
def test_bundled_logs_read_back(name, payload):
    log = fl.read_log(
        ROOT / "src/fraclink/data/logs" / f"{name}.csv", rig=fl.Rig.named("paper-2023")
    )
    assert (
        log.simulated and log.payload == payload and log.period == pytest.approx(0.004)
    )
    assert log.motor_angle.size == 5001
