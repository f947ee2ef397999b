"""The rig: the paper's values, files that survive a round trip, and contradictions that
are named.
"""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fraclink as fl
from fraclink import Channel, LinkModel, LogColumns, MotorLoop, Rig, SecondMode
from fraclink.errors import FieldError
from fraclink.extend import Encoder, Gauge, Link, Motor, Payloads
from junk import CHARACTERS

ROOT = Path(__file__).parents[1]
RIGS = ROOT / "tests" / "rigs"


def test_the_paper_rig_holds_table_1() -> None:
    rig = Rig.named("paper-2023")
    assert (
        rig.motor.inertia,
        rig.motor.viscous_friction,
        rig.motor.torque_constant,
    ) == (
        6.87e-5,
        1.041e-3,
        0.21,
    )
    assert (rig.link.length, rig.link.flexural_rigidity, rig.link.stiffness) == (
        0.65,
        0.260,
        1.56,
    )
    assert (rig.payloads.low, rig.payloads.high, rig.payloads.nominal) == (
        0.020,
        0.040,
        0.030,
    )
    assert rig.period == 0.004
    assert rig.model is not None
    assert rig.model.order == 1.92
    # A = K/J and B = ν/J as printed in the corrected (19), (20).
    assert rig.motor.gain == pytest.approx(3056.7686, rel=1e-7)
    assert rig.motor.decay == pytest.approx(15.152838, rel=1e-7)


def test_the_geared_rig_differs_from_the_printed_one_by_gear_link_mass_and_request_only() -> (
    None
):
    printed, geared = Rig.named("paper-2023"), Rig.named("paper-2023-geared")
    assert geared.motor == dataclasses.replace(printed.motor, gear_ratio=50.0)
    assert geared.link == dataclasses.replace(printed.link, mass=0.00735)
    assert (geared.design.gain_crossover, geared.design.phase_margin_deg) == (
        11.4,
        45.0,
    )
    same = {
        "motor": printed.motor,
        "link": printed.link,
        "design": printed.design,
        "name": printed.name,
    }
    assert (
        dataclasses.replace(geared, **same, assumptions=printed.assumptions) == printed
    )
    assert set(printed.assumptions) < set(geared.assumptions)


def test_the_geared_rig_has_the_link_mass_of_the_bundled_logs() -> None:
    said = dict(
        fl.read_log(
            fl.bundled_log("prbs_30g"), rig=Rig.named("paper-2023-geared")
        ).notes
    )
    assert float(said["link_mass_kg"]) == Rig.named("paper-2023-geared").link.mass


@pytest.mark.parametrize(
    ("payload", "frequency"), [(0.030, 11.0940), (0.040, 9.6077), (0.020, 13.5873)]
)
def test_natural_frequency_is_equation_5(payload: float, frequency: float) -> None:
    assert Rig.named("paper-2023").natural_frequency(payload) == pytest.approx(
        frequency, abs=5e-5
    )


def test_what_the_paper_does_not_print_is_listed_as_assumed() -> None:
    said = " ".join(Rig.named("paper-2023").assumptions)
    for value in ("voltage", "Coulomb", "encoder", "noise"):
        assert value in said


def test_b30_a_stiffness_that_contradicts_the_beam_is_a_warning_that_names_both() -> (
    None
):
    (finding,) = Rig.named("paper-2023").warnings
    assert finding.code == "W101"
    assert "1.56" in finding.message and "1.2 " in finding.message
    assert dict(finding.evidence) == pytest.approx({"stated": 1.56, "expected": 1.2})
    unmeasured = dataclasses.replace(
        Rig.named("paper-2023"), link=Link(0.65, 0.260), model=None
    )
    assert unmeasured.link.stiffness == pytest.approx(1.2)
    assert unmeasured.warnings == ()


def test_a_model_that_contradicts_the_rig_is_a_warning() -> None:
    rig = Rig.named("paper-2023")
    model = LinkModel(stiffness=2.0, natural_frequency=14.0, order=1.92, payload=0.030)
    codes = [finding.code for finding in dataclasses.replace(rig, model=model).warnings]
    assert codes == ["W101", "W101", "W101"]


def test_a_heavy_link_is_pointed_out() -> None:
    assert [finding.code for finding in Rig.load(RIGS / "merced.toml").warnings] == [
        "W104"
    ]


@pytest.mark.parametrize("payload", [20.0, 30, 1e-4])
def test_a_payload_in_another_unit_is_doubted(payload: float) -> None:
    finding = Rig.named("paper-2023").payloads.doubt(payload)
    assert finding is not None
    assert (finding.code, finding.severity) == ("W105", "error")


@pytest.mark.parametrize("payload", [0.002, 0.030, 0.5])
def test_a_payload_beyond_the_range_is_believed(payload: float) -> None:
    assert Rig.named("paper-2023").payloads.doubt(payload) is None


def test_the_gear_is_included_in_the_gain() -> None:
    geared = Motor(
        inertia=1e-4, viscous_friction=1e-3, torque_constant=0.2, gear_ratio=50
    )
    assert geared.gain == pytest.approx(0.2 / (50 * 1e-4))
    assert geared.decay == pytest.approx(10.0)


@pytest.mark.parametrize("path", [*RIGS.glob("*.toml")], ids=lambda path: path.stem)
def test_a_rig_file_comes_back_equal(path: Path, tmp_path: Path) -> None:
    rig = Rig.load(path)
    rig.save(tmp_path / "again.toml")
    assert Rig.load(tmp_path / "again.toml") == rig


def test_every_bundled_rig_comes_back_equal(tmp_path: Path) -> None:
    for name in Rig.names():
        Rig.named(name).save(tmp_path / "again.toml")
        assert Rig.load(tmp_path / "again.toml") == Rig.named(name)


positive = st.floats(1e-9, 1e9)
texts = st.text(CHARACTERS, min_size=1, max_size=40)
channels = st.builds(
    Channel,
    texts,
    st.just("s"),
    sign=st.sampled_from([-1, 1]),
    scale=positive,
    offset=st.one_of(
        st.just("first"), st.floats(-1e9, 1e9).filter(lambda x: x == 0 or abs(x) > 1e-9)
    ),
)


def _with_unit(channel: Channel, unit: str) -> Channel:
    return dataclasses.replace(channel, unit=unit)


rigs = st.builds(
    Rig,
    name=texts,
    motor=st.builds(
        Motor,
        positive,
        positive,
        positive,
        positive,
        positive,
        st.one_of(positive, st.just(math.inf)),
    ),
    link=st.builds(Link, st.floats(1e-6, 100), positive, positive, positive),
    payloads=positive.map(lambda m: Payloads(m, 2 * m, 1.5 * m)),
    period=st.floats(1e-6, 10),
    encoder=st.builds(Encoder, st.one_of(st.none(), st.integers(1, 10**9))),
    gauge=st.builds(Gauge, positive, positive, positive, positive, st.booleans()),
    motor_loop=st.builds(MotorLoop, st.floats(1e-9, 1e6), st.integers(0, 100)),
    log=st.one_of(
        st.none(),
        st.builds(
            lambda t, a, o, v, kind: LogColumns(
                t,
                _with_unit(a, "deg"),
                **{kind: _with_unit(o, "Nm" if kind == "torque" else "mrad")},
                voltage=v and _with_unit(v, "mV"),
            ),
            channels,
            channels,
            channels,
            st.one_of(st.none(), channels),
            st.sampled_from(["torque", "deflection"]),
        ),
    ),
    assumptions=st.lists(texts, max_size=3).map(tuple),
    source=texts,
)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(rigs)
def test_any_rig_comes_back_equal_whatever_its_texts_hold(rig: Rig) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        rig.save(path)
        assert Rig.load(path) == rig


def test_what_was_identified_and_what_is_tolerated_stay_with_the_rig(
    tmp_path: Path,
) -> None:
    model = LinkModel(
        1.56,
        11.0,
        order=1.9,
        payload=0.03,
        gauge_delay=0.057,
        gauge_gain=0.98,
        second_mode=SecondMode(180.0, 0.05),
        unseen_up_to=300.0,
        intervals=(("order", 1.89, 1.91), ("a name with blanks", -1.0, 1.0)),
    )
    printed = Rig.named("paper-2023")
    rig = dataclasses.replace(
        printed,
        model=model,
        gauge=Gauge(delay_in_loop=False),
        tolerances=dataclasses.replace(
            printed.tolerances, order=0.05, gauge_delay=0.004
        ),
    )
    rig.save(tmp_path / "rig.toml")
    assert Rig.load(tmp_path / "rig.toml") == rig
    text = (tmp_path / "rig.toml").read_text()
    assert "delay_in_loop = false" in text and "gauge_delay_s = 0.057" in text
    assert "frequency_rad_per_s = 180.0" in text


def test_a_file_that_says_nothing_of_the_gauge_has_its_delay_in_the_loop() -> None:
    rig = Rig.load(RIGS / "merced.toml")
    assert rig.gauge.delay_in_loop is True
    assert "delay_in_loop" not in rig.to_toml() and "tolerances" not in rig.to_toml()


# --- values that were left out, and what contradicts --------------------------------------------------------


@pytest.mark.parametrize(
    ("payload", "doubted"), [(2e-4, False), (1.9e-4, True), (4.0, False), (4.1, True)]
)
def test_a_payload_a_hundred_times_off_is_doubted(
    payload: float, doubted: bool
) -> None:
    finding = Payloads(0.02, 0.04).doubt(payload)
    assert (finding is not None) is doubted
    if finding is not None:
        word, end = ("lightest", 0.02) if payload < 1 else ("heaviest", 0.04)
        assert f"is {payload / end:.3g} times the {word} that" in finding.message
        assert finding.evidence == {"payload": payload, "low": 0.02, "high": 0.04}


def test_a_model_table_is_completed_from_link_and_payload() -> None:
    text = Rig.named("paper-2023").to_toml()
    bare = re.sub(r"\[model\][^\[]*", "[model]\norder = 1.9\n\n", text)
    model = Rig.from_tables(tomllib.loads(bare)).model
    assert model is not None
    assert (model.stiffness, model.payload, model.order) == (1.56, 0.03, 1.9)
    assert model.natural_frequency == pytest.approx(math.sqrt(1.56 / (0.03 * 0.65**2)))
    assert (
        model.gauge_gain,
        model.gauge_delay,
        model.intervals,
        model.second_mode,
    ) == (1.0, 0.0, (), None)
    more = bare.replace(
        "order = 1.9\n", "order = 1.9\nstiffness_Nm_per_rad = 2.0\npayload_kg = 0.05\n"
    )
    other = Rig.from_tables(tomllib.loads(more)).model
    assert other is not None and other.natural_frequency == pytest.approx(
        math.sqrt(2.0 / (0.05 * 0.65**2))
    )
    with pytest.raises(
        FieldError, match=r"period_ms is required.*state the control period|period"
    ):
        Rig.from_tables(tomllib.loads(text.replace("period_s = 0.004\n", "")))
    twice = text.replace("period_s = 0.004\n", "period_s = 0.004\nperiod_ms = 4.0\n")
    with pytest.raises(FieldError, match="given twice, as period_s and as period_ms"):
        Rig.from_tables(tomllib.loads(twice))


def test_the_link_weighs_at_its_tip_what_its_bent_shape_moves() -> None:
    """Rayleigh: the mass times the mean square of the shape (3x² − x³)/2."""
    nodes, sizes = np.polynomial.legendre.leggauss(4)
    x = 0.5 * (1.0 + nodes)
    share = 0.5 * sizes @ (0.5 * (3 * x**2 - x**3)) ** 2
    link = Link(length=0.65, flexural_rigidity=0.26, mass=0.04)
    assert link.tip_mass == pytest.approx(share * 0.04, rel=1e-12)
