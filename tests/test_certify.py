"""Certificates: what is proved, what is rejected, and that the independent checker
accepts no forgery.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import math
import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import (
    Certificate,
    Design,
    Law,
    LinkModel,
    MotorLoop,
    ParameterBox,
    Rig,
    SecondMode,
    certify,
    export_c,
)
from fraclink._certify.enclosure import BoxLoop
from fraclink._certify.numeric import loop_values
from fraclink.errors import FieldError, FileFormatError, NotCertifiedError
from law_bench import documented_design
from law_bench import law as any_law

RIG = Rig.named("paper-2023")
PRINTED = fl.Controller(  # (58)
    derivative_gain=0.148, derivative_order=0.65, filter_time=0.16, filter_order=2
)
# the parameters of an arm, in the order of the certificates
AXES = ["frequency", "softness", "delay", "gauge_gain", "gauge_delay", "order"]
AXES += ["loss", "motor", "mode_frequency", "mode_gain"]
# a box of the proof has the mode's detuning f/ω in place of its frequency
MODE = AXES.index("mode_frequency")
TEXTS = ("block", "digest", "precision", "hold", "motor_loop")
CHECKER = Path(__file__).resolve().parents[1] / "tools" / "check_certificate.py"


@cache
def plan_for(motor_loop: str, placement: str = "tustin") -> Design:
    wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.0}
    return fl.design(
        RIG.model,
        RIG,
        payloads=(0.020, 0.040),
        motor_loop=motor_loop,
        placement=placement,
        **wanted,
    )


@pytest.fixture(scope="module")
def checker() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check_certificate", CHECKER)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def law() -> Law:
    return plan_for("ideal").law().in_precision("double")


# Narrower than the default one: its proof takes the checker a tenth of the time.
NARROW = replace(
    ParameterBox.at(RIG.model),
    order=(1.915, 1.925),
    gauge_gain=(0.99, 1.01),
    gauge_delay=(0.0, 0.0005),
    motor_ratio=(0.99, 1.01),
)


@pytest.fixture(scope="module")
def certificate(law: Law) -> Certificate:
    return certify(plan_for("ideal"), law=law, modulus_margin=0.35, box=NARROW)


@pytest.fixture(scope="module")
def document(
    certificate: Certificate, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Any]:
    place = tmp_path_factory.mktemp("certificate") / "certificate.json"
    certificate.save(place)
    return dict(json.loads(place.read_text(encoding="utf-8")))


@pytest.mark.slow
def test_default_design_is_certified_and_checked_by_other_arithmetic(
    law: Law, tmp_path: Path
):
    certificate = certify(plan_for("ideal"), law=law, modulus_margin=0.35)
    assert certificate.passed
    assert (
        "from 0.02 to 0.04 kg" in certificate.verdict
        and "from 0.0 to 0.004 s" in certificate.verdict
    )
    certificate.save(tmp_path / "c.json")
    assert Certificate.load(tmp_path / "c.json") == certificate
    run = subprocess.run(  # our own checker on our own file  # noqa: S603
        [
            sys.executable,
            str(CHECKER),
            str(tmp_path / "c.json"),
            certificate.statement.digest,
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, run.stdout) == (0, f"PROVED: {certificate.verdict}\n"), (
        run.stderr
    )


@pytest.mark.slow
@pytest.mark.parametrize("placement", ["tustin", "direct"])
def test_sampled_motor_loop_is_certified_and_checked(
    placement: str, checker: ModuleType, tmp_path: Path
):
    # Direct placement rings near Nyquist: over its box with a late gauge it comes to
    # within 0.04 of −1.
    box = ParameterBox.at(RIG.model) if placement == "direct" else NARROW
    found = certify(plan_for("sampled", placement), modulus_margin=0.35, box=box)
    assert found.passed, found.verdict
    found.save(tmp_path / "c.json")
    assert "|1 + L| > 0.35 " in checker.check(
        str(tmp_path / "c.json"), found.statement.digest
    )


@pytest.mark.slow
def test_single_precision_law_and_default_claim(law: Law):
    """The claim for the model itself is stronger than that for every arm of its box,
    and equals the value of the design's own sampled loop.
    """
    single = law.in_precision("single")
    exact = certify(plan_for("ideal"), law=single, box=ParameterBox.at(RIG.model))
    found = certify(plan_for("ideal"), law=single)
    assert exact.passed and found.passed
    loop, filtered = plan_for("sampled"), single.frequency_response
    truth = min(
        loop.sampled_at(payload, correction=filtered).modulus_margin
        for payload in (0.020, 0.040)
    )
    assert truth - 0.02 < exact.statement.modulus < truth
    assert 0.25 <= found.statement.modulus < exact.statement.modulus - 0.05


def test_checker_is_one_short_file_of_mpmath_only():
    text = CHECKER.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 280  # short enough to be read in an evening
    assert "import fraclink" not in text and "numpy" not in text


def patient(law: Law) -> Law:
    """The law with a stuck guard that accepts a gauge with a delay of 80 ms: its own
    guard is for the link that it was designed for.
    """
    return replace(law, limits=replace(law.limits, stuck_limit=30))


@cache
def known(model: LinkModel, placement: str) -> tuple[Certificate, Law]:
    """Return the result for a claim about a wide box that is not true, and the law."""
    motor_loop = "ideal" if placement == "ideal" else "sampled"
    law = plan_for(motor_loop, "tustin" if placement == "ideal" else placement).law()
    law = patient(law.in_precision("double"))
    if motor_loop == "ideal":
        law = replace(law, motor_loop=None)
    wanted = {"payloads": (0.02, 0.04), "modulus_margin": 0.999}
    return certify(law, model=model, rig=RIG, **wanted), law  # type: ignore[arg-type]


RICH = replace(
    RIG.model,
    order=1.95,
    damping=0.3,
    damping_order=0.9,
    gauge_delay=0.001,
    gauge_gain=1.02,
    second_mode=SecondMode(150.0, 0.02, 0.02),
)


@pytest.mark.slow
@pytest.mark.parametrize("placement", ["ideal", "tustin", "direct"])
@pytest.mark.parametrize("model", [RIG.model, RICH], ids=["plain", "rich"])
def test_discs_hold_the_loop_and_its_slopes_at_random_points_of_random_boxes(
    placement: str, model: LinkModel
):
    """Values are compared with a loop in another form, slopes with its difference
    quotients between points.
    """
    found, law = known(model, placement)
    claim, loop = found.statement, BoxLoop(found.statement)
    low, high = loop.root()
    rng, count = np.random.default_rng(5), 40
    width = 10 ** rng.uniform(-4, -0.5, (count, len(AXES)))
    first = low + (high - low) * rng.random((count, len(AXES))) * 0.5
    second = np.minimum(first + (high - low) * 0.5 * width, high)
    first[:, 0] = np.exp(rng.uniform(-1, 6, count))
    # where the aliases matter for L; Nyquist: 785 rad/s
    first[::3, 0] = rng.uniform(320, 780, len(first[::3]))
    second[:, 0] = np.minimum(first[:, 0] * (1 + width[:, 0]), high[0, 0])
    first[:, MODE], second[:, MODE] = low[0, MODE], high[0, MODE]
    least, most, _ = loop.possible(first, second)
    room = 0.5 * (most - least)[:, MODE]
    first[:, MODE] = least[:, MODE] + room * rng.random(count)
    second[:, MODE] = first[:, MODE] + room * width[:, MODE]
    plain, inverse, _ = loop.forms(first, second)
    held = loop.held(first[:, 0])
    assert 14 <= np.count_nonzero(held) < 26  # some, not all
    # Ten points of every box, five at a time (50 MB for all): corners and interior
    # points.
    steps = 5
    for _ in range(2):
        corner = rng.random((steps, *first.shape))
        corner[::2] = np.round(corner[::2])
        x = (first + (second - first) * corner).reshape(-1, len(AXES))
        place = {name: x[:, k] for k, name in enumerate(AXES)}
        place["mode_frequency"] = x[:, MODE] * x[:, 0]
        every = np.tile(held, steps)
        exact = loop_values(claim, law, x[:, 0], place, held=every)
        for value, true in ((plain, exact), (inverse, 1 / exact)):
            centre, radius = np.tile(value.c, steps), np.tile(value.r, steps)
            with np.errstate(invalid="ignore"):
                assert not np.any(np.abs(true - centre) > radius + 1e-6 * np.abs(true))
        at, at_inverse, _ = loop.forms(x, x, every)
        for name in loop.axes:
            k = MODE if name == "detuning" else AXES.index(name)
            near = x.copy()
            ends = np.tile(first[:, k], steps), np.tile(second[:, k], steps)
            near[:, k] = ends[0] + (ends[1] - ends[0]) * rng.random(len(x))
            other, other_inverse, _ = loop.forms(near, near, every)
            for disc, a, b in (
                (plain, at, other),
                (inverse, at_inverse, other_inverse),
            ):
                slope = np.tile(np.abs(disc.d[name].c) + disc.d[name].r, steps)
                most = slope * np.abs(near[:, k] - x[:, k])
                assert not np.any(np.abs(b.c - a.c) > most + a.r + b.r)


@pytest.mark.slow
@pytest.mark.parametrize("placement", ["ideal", "tustin", "direct"])
def test_loop_of_the_certificate_is_the_sampled_loop_of_the_plan(placement: str):
    motor_loop = "ideal" if placement == "ideal" else "sampled"
    design = plan_for(motor_loop, "tustin" if placement == "ideal" else placement)
    law = design.law().in_precision("double")
    if placement == "ideal":
        law = replace(law, motor_loop=None)
    point = ParameterBox.at(RIG.model)
    claim = certify(design, law=law, modulus_margin=0.999, box=point).statement
    loop, low = BoxLoop(claim), claim.box[0]
    w = np.geomspace(1.0, 780.0, 60)
    link = replace(RIG.model.at_payload(0.023))
    true = law.frequency_response(w) * design.sampled_plant(link.natural_frequency)(w)
    place = low | {"softness": link.natural_frequency**-2, "delay": 0.004}
    main = loop_values(claim, law, w, place)
    for frequency, exact, found in zip(w, true, main, strict=True):
        assert abs(exact - found) <= loop.alias_at(
            place | {"frequency": float(frequency)}
        )


@pytest.mark.slow
def test_claim_above_the_truth_is_refused_with_the_place(law: Law):
    found = certify(plan_for("ideal"), law=law, modulus_margin=0.9)
    assert not found.passed
    assert found.payload == pytest.approx(0.020)
    assert found.distance is not None and found.distance < 0.9
    assert "20 g" in found.verdict and "rad/s" in found.verdict
    with pytest.raises(NotCertifiedError):
        found.save("nowhere.json")


@pytest.mark.slow
def test_claim_just_above_the_truth_is_not_proved(law: Law):
    plan, point = plan_for("ideal"), ParameterBox.at(RIG.model)
    least = certify(plan, law=law, modulus_margin=0.9, box=point).distance
    assert least is not None
    assert certify(plan, law=law, modulus_margin=least - 2e-3, box=point).passed
    close = certify(plan, law=law, modulus_margin=least + 2e-4, box=point)
    assert not close.passed and close.distance == pytest.approx(least, abs=1e-6)
    assert close.payload == pytest.approx(0.020, rel=0.05)


def test_printed_controller_is_refused_with_its_payload():
    point = ParameterBox.at(RIG.model)
    law = fl.discretize(replace(PRINTED, link=RIG.model), RIG.period)
    found = certify(law, model=RIG.model, rig=RIG, payloads=(0.020, 0.040), box=point)
    assert not found.passed and "unstable" in found.verdict
    assert found.payload == pytest.approx(0.040)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"modulus_margin": 1.5}, "modulus_margin"),
        ({"modulus_margin": 0.0}, "modulus_margin"),
        ({"payloads": (0.0, 0.04)}, "payloads[0]"),
        ({"payloads": (0.04, 0.02)}, "payloads"),
        ({"delay": (0.004, 0.001)}, "delay[1]"),
        ({"delay": (-0.001, 0.001)}, "delay[0]"),
    ],
)
def test_bad_requests_name_the_field(changes: dict[str, object], field: str, law: Law):
    with pytest.raises(FieldError) as caught:
        certify(plan_for("ideal"), law=law, **changes)
    assert caught.value.field == field


def test_undamped_integer_link_is_refused(law: Law):
    with pytest.raises(FieldError, match="stability boundary"):
        certify(law, model=replace(RIG.model, order=2.0), rig=RIG)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gauge", "distance"),
    [
        ({"gauge_gain": 1.1}, 0.54),
        ({"gauge_delay": 0.004}, 0.5),
        ({"gauge_delay": 0.001, "second_mode": SecondMode(150.0, 0.02, 0.02)}, 0.5),
        (
            {"second_mode": SecondMode(900.0, 0.01, 0.05)},
            0.5,
        ),  # above the Nyquist frequency
    ],
)
@pytest.mark.parametrize("motor_loop", ["ideal", "sampled"])
def test_what_the_gauge_shows_is_in_the_proof(
    gauge: dict[str, Any],
    distance: float,
    motor_loop: str,
    checker: ModuleType,
    tmp_path: Path,
):
    """|1 + L| of the certificate agrees with a loop written out here, and the checker
    confirms it.
    """
    model = replace(RIG.model, **gauge)
    design = plan_for(motor_loop)
    law = patient(design.law().in_precision("double"))
    assert law.motor_loop is not None
    # the compensation of the coupling torque undoes the gain of the gauge
    torque_voltage = law.motor_loop.torque_voltage / model.gauge_gain
    compensated = replace(law.motor_loop, torque_voltage=torque_voltage)
    law = replace(law, motor_loop=None if motor_loop == "ideal" else compensated)
    wanted = {"modulus_margin": distance, "box": ParameterBox.at(model)}
    found = certify(law, model=model, rig=RIG, payloads=(0.02, 0.04), **wanted)
    assert found.passed, found.verdict
    found.save(tmp_path / "c.json")
    checker.check(str(tmp_path / "c.json"), law.digest)
    w, claim = np.geomspace(1.0, 700.0, 400), found.statement
    none = np.zeros(w.shape, dtype=bool)  # every alias has its own tip angle
    link = model.at_payload(0.025)
    tip = link.tip()(1j * w)
    mode = 0.0 if model.second_mode is None else model.second_mode.response(1j * w)
    read = model.gauge_gain * np.exp(-1j * w * model.gauge_delay)
    place = claim.box[0] | {
        "softness": link.natural_frequency**-2,
        "delay": 0.001,
        "order": model.order,
    }
    place |= {"gauge_gain": model.gauge_gain, "gauge_delay": model.gauge_delay}
    if model.second_mode is not None:
        place |= {
            "mode_frequency": model.second_mode.frequency,
            "mode_gain": model.second_mode.gain,
        }
    plain = place | {"gauge_gain": 1.0, "gauge_delay": 0.0, "mode_gain": 0.0}
    expected = (
        loop_values(claim, law, w, plain, held=none)
        / tip
        * (1 - read * (1 - tip + mode))
    )
    assert loop_values(claim, law, w, place, held=none) == pytest.approx(
        expected, rel=1e-9
    )
    points = np.tile([place.get(name, 0.0) for name in AXES], (w.size, 1))
    points[:, 0] = w
    points[:, MODE] /= w
    value, inverse, _ = BoxLoop(claim).forms(points, points, none)
    assert np.all(np.abs(value.c - expected) <= value.r + 1e-9 * np.abs(expected))
    assert np.all(np.abs(inverse.c * expected - 1) < 1e-7)


@pytest.mark.slow
def test_the_link_of_the_claim_is_the_one_that_the_law_was_made_for(law: Law):
    wanted = {"modulus_margin": 0.1, "rig": RIG}
    point = ParameterBox.at(RIG.model)
    claim = certify(
        law, model=RIG.model, payloads=(0.02, 0.025), box=point, **wanted
    ).statement
    assert claim.nominal_payload == pytest.approx(0.03, rel=1e-5)
    other = replace(RIG.model, damping=3.0, damping_order=0.7)
    claim = certify(law, model=other, box=ParameterBox.at(other), **wanted).statement
    resonance = abs(other.at_payload(claim.nominal_payload).pole)
    assert resonance == pytest.approx(abs(RIG.model.pole), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [3.0, -2.0, 2.0, 1.5, -1.0, math.nan, 1.001, 0.999])
def test_a_law_with_another_compliance_is_not_certified(law: Law, factor: float):
    with pytest.raises(FieldError) as caught:
        certify(
            plan_for("ideal"),
            law=replace(law, stiffness=law.stiffness * factor),
            modulus_margin=0.35,
        )
    assert caught.value.field == "law.stiffness"


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits",
    [
        {"sum_limit": 0.0},
        {"correction_limit": 1e-9},
        {"motor_step": 1e-6},
        {"torque_limit": 0.0},
        {"torque_step": -1.0},
        {"bad_limit": 0},
        {"sum_limit": math.nan},
    ],
)
def test_a_law_whose_limits_leave_no_room_is_not_certified(
    law: Law, limits: dict[str, Any]
):
    with pytest.raises(FieldError) as caught:
        certify(
            plan_for("ideal"), law=replace(law, limits=replace(law.limits, **limits))
        )
    assert caught.value.field in {"law.limits", *(f"law.{name}" for name in limits)}


@pytest.mark.parametrize(
    ("field", "value"), [("gauge_delay", -0.002), ("gauge_gain", -0.5)]
)
def test_a_gauge_that_cannot_be_is_refused_by_its_name(field: str, value: float):
    plan = plan_for("ideal")
    box = replace(ParameterBox.at(plan.model), **{field: (value, value)})
    with pytest.raises(FieldError) as caught:
        certify(plan, box=box, modulus_margin=0.3)
    assert caught.value.field == f"model.{field}"


@pytest.mark.parametrize("factor", [3.0, 0.3])
def test_a_law_that_scales_its_link_out_of_reach_is_not_certified(factor: float):
    plan = plan_for("sampled")
    made = plan.law()
    assert made.tracking is not None
    scaled = replace(made.tracking, nominal=factor * made.tracking.nominal)
    with pytest.raises(FieldError) as caught:
        certify(plan, law=replace(made, tracking=scaled), modulus_margin=0.3)
    assert caught.value.field == "law.payload_scale"


@pytest.mark.slow
def test_no_limit_acts_on_errors_within_the_linear_range(
    certificate: Certificate, law: Law
):
    """Random errors of that size through law.c itself: the correction equals that of
    the linear filter.
    """
    rng = np.random.default_rng(2)
    reach = certificate.statement.linear_range
    assert 5e-4 < reach < 5e-3
    error = reach * rng.choice([-1.0, 1.0], 400)
    error[0] = 0.0  # the law starts at rest
    zeros = np.zeros_like(error)
    outer = replace(law, motor_loop=None)
    _, out = outer.run(
        outer.initial_state(), zeros, zeros, zeros, law.stiffness * error
    )
    computed = law.stiffness * error / law.stiffness
    direct, poles, gains = (
        law.correction.direct,
        np.array(law.correction.poles),
        law.correction.gains,
    )
    states, expected = np.zeros(len(poles)), []
    for change in np.diff(computed, prepend=0.0):
        expected.append(direct * change + np.dot(gains, states))
        states = poles * states + change
    # the guard of the gauge's step concerns a sensor, not the command
    credible = out.flags & 2 == 0
    assert credible.all() and (out.mode == 1).all()
    assert not np.any(out.flags & 32)
    assert out.motor_reference == pytest.approx(np.array(expected), abs=1e-12)


# Forgeries, each with the hash of the certificate corrected, and the claim where
# possible.


def _number(
    field: str, factor: float = 1.0, value: float | None = None
) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        old = float.fromhex(data["content"]["statement"][field])
        data["content"]["statement"][field] = (
            old * factor if value is None else value
        ).hex()

    return change


def _text(field: str, value: str) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        data["content"]["statement"][field] = value

    return change


def _tree(edit: Callable[[str], str]) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        proof = data["content"]
        proof["tree"] = edit(proof["tree"])
        proof["leaves"] = proof["tree"].count(".") + proof["tree"].count(",")

    return change


def _mended(data: dict[str, Any], block: bytearray, *, mend: bool = True) -> None:
    """Insert the block, with correct CRC and hash if requested."""
    if mend:
        struct.pack_into("<I", block, 12, zlib.crc32(block[16:]))
        data["content"]["statement"]["digest"] = hashlib.sha256(block).hexdigest()
    data["content"]["statement"]["block"] = block.hex()


def _block(
    place: int, factor: float, *, mend: bool = True
) -> Callable[[dict[str, Any]], None]:
    """Scale one real number of the law."""

    def change(data: dict[str, Any]) -> None:
        block = bytearray.fromhex(data["content"]["statement"]["block"])
        (old,) = struct.unpack_from("<d", block, 56 + 8 * place)
        struct.pack_into("<d", block, 56 + 8 * place, old * factor)
        _mended(data, block, mend=mend)

    return change


def _real(
    name: str, factor: float = 1.0, value: float | None = None
) -> Callable[[dict[str, Any]], None]:
    """Scale or replace one real of the block, by its name in law.h."""
    values = any_law().coefficients
    reals = list(values)[list(values).index("period") :]
    before = reals[: reals.index(name)]
    place = sum(np.size(values[field]) for field in before)

    def change(data: dict[str, Any]) -> None:
        block = bytearray.fromhex(data["content"]["statement"]["block"])
        (old,) = struct.unpack_from("<d", block, 56 + 8 * place)
        struct.pack_into(
            "<d", block, 56 + 8 * place, old * factor if value is None else value
        )
        _mended(data, block)

    return change


def _count(name: str, value: int) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        block = bytearray.fromhex(data["content"]["statement"]["block"])
        place = list(any_law().coefficients).index(name)
        struct.pack_into("<I", block, 4 * place, value)
        _mended(data, block)

    return change


def _drop(field: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data["content"]["statement"].pop(field)


def _leaves(count: int) -> Callable[[dict[str, Any]], None]:
    return lambda data: data["content"].update(leaves=count)


def _envelope(field: str, value: object) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.__setitem__(field, value)


def _all_of(
    *changes: Callable[[dict[str, Any]], None],
) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        for each in changes:
            each(data)

    return change


def _interval(
    field: str, factor: float = 1.0, value: float | None = None
) -> Callable[[dict[str, Any]], None]:
    """Change both ends."""

    def change(data: dict[str, Any]) -> None:
        for end in ("low", "high"):
            _number(f"{field}_{end}", factor, value)(data)

    return change


FORGERIES: dict[str, Callable[[dict[str, Any]], None]] = {
    "leaf missing": _tree(lambda t: t[:-1]),
    "leaf too many": _tree(lambda t: t + "."),
    "subtree replaced by a leaf": _tree(lambda _: "."),
    "unknown letter": _tree(lambda t: t.replace("w", "x", 1)),
    "number of leaves": _leaves(7),
    "margin claimed larger": _number("modulus", value=0.73),
    "margin of one": _number("modulus", value=1.0),
    "lighter payload claimed": _number("payload_low", value=0.004),
    "payload range turned round": _number("payload_low", value=0.05),
    "longer delay claimed": _number("delay_high", value=0.040),
    "negative delay": _number("delay_low", value=-0.004),
    "slower motor": _interval("gain", factor=0.2),
    "order of two": _interval("order", value=2.0),
    "order not a number": _number("order_low", value=float("nan")),
    "payload law changed": _interval("softness", factor=0.1),
    "lowest frequency raised": _number("lowest", value=30.0),
    "coefficient changed": _block(2, 3.0, mend=False),
    "coefficient changed, hashes mended": _block(2, 30.0, mend=True),
    "unstable mode, hashes mended": _block(5, -20.0, mend=True),
    "hash of another law": _text("digest", "0" * 64),
    "other precision": _text("precision", "single"),
    "motor loop renamed": _text("motor_loop", "ideal"),
    "another word for the motor loop": _text("motor_loop", "perfect"),
    "first-order hold": _text("hold", "first-order"),
    "field missing": _drop("pole_low"),
    "other kind of file": _envelope("fraclink", "design"),
    "other format": _envelope("format", 1),
    "leaves by the other form": _tree(lambda t: t.replace(".", ",")),
    "cut along another axis": _tree(lambda t: t.replace("w", "m")),
    "orders up to 1.99": _number("order_high", value=1.99),
    "orders from 1.5": _number("order_low", value=1.5),
    "orders turned round": _number("order_low", value=1.96),
    "order of one": _number("order_low", value=1.0),
    "slow motor admitted": _number("gain_low", factor=0.5),
    "gain of zero": _number("gain_low", value=0.0),
    "softer links admitted": _number("softness_high", factor=4.0),
    "stiffer links admitted": _number("softness_low", factor=0.1),
    "gauge of half the gain admitted": _number("gauge_gain_low", value=0.5),
    "gauge of twice the gain admitted": _number("gauge_gain_high", value=2.0),
    "damping turned round": _number("loss_low", value=1.0),
    "negative damping": _number("loss_low", value=-0.1),
    "second mode without a frequency": _number("mode_gain_high", value=0.1),
    "second mode without damping": _all_of(
        _interval("mode_frequency", value=90.0),
        _interval("mode_gain", value=0.1),
    ),
    "link of another payload, all else mended": _all_of(
        _number("payload_low", factor=10.0),
        _number("payload_high", factor=10.0),
        _interval("softness", factor=0.1),
    ),
    "law of the sampled loop": _all_of(
        _text("motor_loop", "ideal"),
        _interval("gain", value=3000.0),
        _number("decay", value=13.0),
    ),
    "damping of 50": _interval("loss", value=50.0),
    "softness times three": _interval("softness", factor=3.0),
    "order": _interval("order", value=1.8),
    "order of the damping": _number("damping_order", value=5.0),
    "faster motor": _interval("pole", value=90.0),
    "stiffness of the link": _number("stiffness", factor=2.0),
    "gauge gain": _interval("gauge_gain", factor=2.0),
    "gauge gain of zero": _interval("gauge_gain", value=0.0),
    "gauge delay of 50 ms": _number("gauge_delay_high", value=0.05),
    "negative gauge delay": _number("gauge_delay_low", value=-0.001),
    "gauge delay not a number": _number("gauge_delay_low", value=math.nan),
    "strong second mode": _text("mode_gain_high", (40.0).hex()),
    "undamped second mode": _all_of(
        _number("mode_frequency_low", value=90.0),
        _interval("mode_frequency", value=90.0),
        _interval("mode_gain", value=0.1),
    ),
    "payload that the law was made for": _number("nominal_payload", factor=3.0),
    "modulus not a number": _number("modulus", value=math.nan),
    "lighter and lighter": _number("payload_low", value=0.0),
    "payload infinite": _number("payload_high", value=math.inf),
    "linear range larger": _number("linear_range", value=0.5),
    "linear range of zero": _number("linear_range", value=0.0),
    "linear range not a number": _number("linear_range", value=math.nan),
    "compliance times three": _real("compliance", factor=3.0),
    "compliance times minus two": _real("compliance", factor=-2.0),
    "compliance times two": _real("compliance", factor=2.0),
    "compliance times 1.5": _real("compliance", factor=1.5),
    "compliance reversed": _real("compliance", factor=-1.0),
    "compliance not a number": _real("compliance", value=math.nan),
    "compliance of zero": _real("compliance", value=0.0),
    "stiffness of the law": _real("stiffness", factor=2.0),
    "no modes": _count("real_modes", 0),
    "one mode": _count("real_modes", 1),
    "99 modes": _count("real_modes", 99),
    "two pairs of nothing": _count("pair_modes", 3),
    "forward modes": _count("forward_modes", 9),
    "option": _count("options", 8),
    "period": _real("period", factor=0.5),
    "period not a number": _real("period", value=math.nan),
    "no sum": _real("sum_limit", value=0.0),
    "no correction": _real("correction_limit", value=1e-9),
    "correction limit not a number": _real("correction_limit", value=math.nan),
    "no motor step": _real("motor_step", value=1e-9),
    "no range of the motor": _real("motor_limit", value=0.0),
    "negative torque limit": _real("torque_limit", factor=-1.0),
    "torque that trips at once": _real("torque_trip", value=0.0),
    "resonance that the limits were made for": _real("reference_rate", factor=0.5),
    "motor model of the guards": _real("motor_next", factor=0.3),
    "guard that trips at once": _count("bad_limit", 0),
    "claim of 1 g to 1 kg": lambda data: data["summary"].update(
        claim=data["summary"]["claim"].replace("0.02 to 0.04", "0.001 to 1")
    ),
    "claim in other words": lambda data: data["summary"].update(
        form=data["summary"]["form"] + " Always.",
        claim=data["summary"]["claim"] + " Always.",
    ),
    "claim without conditions": lambda data: data["summary"].update(
        form="Everything holds.", claim="Everything holds."
    ),
    "no assumptions": lambda data: data["summary"].update(assumed=[]),
    "an assumption less": lambda data: data["summary"]["assumed"].pop(2),
}


def _rejected(checker: ModuleType, place: Path, board: str) -> bool:
    try:
        checker.check(str(place), board)
    except (
        ValueError,
        KeyError,
        TypeError,
        ArithmeticError,
        AttributeError,
        struct.error,
    ):
        return True
    return False


def _signed(
    data: dict[str, Any], certificate: Certificate, *, claim: bool = True
) -> None:
    """Correct the hash; with `claim` also the sentence, as the checker itself would
    write it.
    """
    if claim:
        with contextlib.suppress(KeyError, ValueError, TypeError, struct.error):
            numbers = {
                k: v if k in TEXTS else float.fromhex(v)
                for k, v in data["content"]["statement"].items()
            }
            data["summary"]["claim"] = replace(certificate.statement, **numbers).words()
    signed = {key: data[key] for key in data if key not in ("sha256", "tool")}
    text = json.dumps(signed, sort_keys=True, separators=(",", ":"))
    data["sha256"] = hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.slow
@pytest.mark.parametrize("name", FORGERIES)
def test_forgeries_are_rejected(
    name: str,
    document: dict[str, Any],
    certificate: Certificate,
    checker: ModuleType,
    tmp_path: Path,
):
    """The law of the board is forged along with the certificate, so the hash of the
    board does not help.
    """
    forged = json.loads(json.dumps(document))
    FORGERIES[name](forged)
    _signed(
        forged,
        certificate,
        claim=forged["summary"]["claim"] == document["summary"]["claim"],
    )
    place = tmp_path / "forged.json"
    place.write_text(json.dumps(forged), encoding="utf-8")
    assert _rejected(checker, place, forged["content"]["statement"].get("digest", ""))


@pytest.mark.slow
def test_the_discs_of_the_checker_hold_the_loop_at_random_points_of_boxes(
    certificate: Certificate, law: Law, checker: ModuleType
):
    """L and 1/L in another form, with the same aliases; no parameter is left at its
    middle.
    """
    claim, rng = certificate.statement, np.random.default_rng(6)
    loop = checker.Loop(asdict(claim))
    (low, high), bounded = np.array(loop.root).T, 0
    for _ in range(60):
        share = np.sort(rng.random((2, len(AXES))), axis=0)
        first, second = low + (high - low) * share
        first[0] = np.exp(rng.uniform(math.log(4.0), math.log(700.0)))
        second[0] = first[0] * (1 + 1e-3)
        box = tuple(zip(first.tolist(), second.tolist(), strict=True))
        x = first + (second - first) * np.round(rng.random((40, len(AXES))))
        place = {name: x[:, k] for k, name in enumerate(AXES)}
        held = np.full(len(x), first[0] >= 0.2 * math.pi / law.period)
        true = loop_values(claim, law, x[:, 0], place, held=held)
        for plain, exact in ((True, true), (False, 1 / true)):
            value, alias, _ = loop.form(box, plain)
            if math.isfinite(value.r):  # else it proves nothing
                bounded += 1
                room = value.r + (alias if plain else 0.0) + 1e-9 * np.abs(exact)
                assert np.all(np.abs(exact - value.c) <= room)
    assert bounded >= 90  # of 120
    # What is left out of L counts against the claim.
    point = tuple((x, x) for x in (100.0, *(0.5 * (low + high))[1:].tolist()))
    assert loop.leaf(point, True)
    loop.aliases = lambda _: 1e6
    assert not loop.leaf(point, True)


def slow_claim(lowest: float) -> Any:
    """1 s, with a second mode at 5.58 rad/s whose alias is at 0.70 rad/s: |1 + L| is
    0.09 there.
    """
    mode = SecondMode(2 * math.pi - 0.7, 1.0, 5e-4)
    link = replace(
        RIG.model,
        natural_frequency=0.75**-0.5,
        order=1.9,
        damping=0.0,
        payload=1.0,
        second_mode=mode,
    )
    motor_loop = MotorLoop(pole=2.0, placement="tustin")
    controller = replace(
        plan_for("ideal").controller, motor_loop=motor_loop, period=1.0, link=link
    )
    law = fl.discretize(controller, 1.0, order=0, precision="double")
    law = replace(law, correction=law.correction._replace(direct=0.11))
    found = certify(
        law,
        model=link,
        rig=RIG,
        box=ParameterBox.at(link),
        payloads=(1.0, 1.0),
        delay=(0.28, 0.28),
        modulus_margin=0.2,
    )
    return replace(found.statement, lowest=lowest)


@pytest.mark.slow
@pytest.mark.parametrize("lowest", [0.5, 0.63, 0.8])
def test_what_lies_below_the_lowest_frequency_is_bounded_with_every_alias(
    lowest: float, checker: ModuleType
):
    """From 0.2 of Nyquist on, 0.63 rad/s, the leaves include aliases in L; below the
    lowest frequency none does.
    """
    statement = slow_claim(lowest)
    with pytest.raises(ValueError, match=r"\|L\| is not small at low frequency"):
        checker.Loop(asdict(statement))
    assert BoxLoop(statement).low_bound() > 0.8


@pytest.mark.slow
def test_a_file_that_is_signed_again_unchanged_is_proved(
    document: dict[str, Any],
    certificate: Certificate,
    checker: ModuleType,
    tmp_path: Path,
):
    """The forgeries above fail because of their changes, not because of the way they
    were signed.
    """
    forged = json.loads(json.dumps(document))
    _signed(forged, certificate)
    assert forged == document
    place = tmp_path / "same.json"
    place.write_text(json.dumps(forged), encoding="utf-8")
    assert not _rejected(checker, place, forged["content"]["statement"]["digest"])


@pytest.mark.slow
def test_careless_forgeries_are_rejected_by_the_hash(
    document: dict[str, Any], checker: ModuleType, tmp_path: Path
):
    board = document["content"]["statement"]["digest"]
    careless = (
        "slower motor",
        "margin claimed larger",
        "leaf missing",
        "damping of 50",
        "claim of 1 g to 1 kg",
    )
    for name in (*careless, "no assumptions"):
        forged = json.loads(json.dumps(document))
        FORGERIES[name](forged)
        place = tmp_path / "forged.json"
        place.write_text(json.dumps(forged), encoding="utf-8")
        assert _rejected(checker, place, board)
        with pytest.raises((FileFormatError, FieldError)):
            Certificate.load(place)


@pytest.mark.slow
def test_a_damaged_certificate_ends_in_one_kind_of_error(
    document: dict[str, Any], tmp_path: Path
):
    rng, place = np.random.default_rng(7), tmp_path / "damaged.json"
    text = json.dumps(document)
    for _ in range(300):
        at, length = int(rng.integers(len(text))), int(rng.integers(1, 9))
        piece = "".join(map(chr, rng.integers(32, 127, int(rng.integers(0, 9)))))
        place.write_text(text[:at] + piece + text[at + length :], encoding="utf-8")
        with contextlib.suppress(FieldError):
            assert Certificate.load(place).verdict == document["summary"]["claim"]


@pytest.mark.slow
def test_the_sentences_of_the_checker_are_those_of_the_package(
    document: dict[str, Any], checker: ModuleType
):
    said = [document["summary"]["form"], document["summary"]["assumed"]]
    assert checker.sha(checker.canonical(said)) == checker.SENTENCES


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_law_on_the_board_is_read_from_its_header(
    precision: str,
    law: Law,
    certificate: Certificate,
    checker: ModuleType,
    tmp_path: Path,
):
    pairs = law.correction._replace(
        pair_poles=(0.9 + 0.1j,), pair_gains=(0.02 - 0.03j,)
    )
    for made in (law, replace(law, correction=pairs), replace(law, motor_loop=None)):
        shipped = made.in_precision(precision)
        export_c(shipped, tmp_path / "firmware", force=True)
        header = tmp_path / "firmware" / "law_data.h"
        assert checker.on_board(str(header), shipped.block)
    text = header.read_text(encoding="utf-8")
    header.write_text(
        text.replace("compliance = 0x1.4", "compliance = 0x1.5"), encoding="utf-8"
    )
    assert not checker.on_board(str(header), shipped.block)
    # what a compiler reads may be next to what the checker looks for
    for other in (f"/*\n{text}*/\n{text}", text.replace("    .", "\t."), text + "\n"):
        header.write_text(other, encoding="utf-8")
        assert not checker.on_board(str(header), shipped.block)


@pytest.mark.slow
def test_nothing_is_proved_without_the_law_on_the_board(
    document: dict[str, Any],
    certificate: Certificate,
    law: Law,
    checker: ModuleType,
    tmp_path: Path,
):
    place = tmp_path / "c.json"
    certificate.save(place)
    with pytest.raises(ValueError, match="without the law on the board"):
        checker.check(str(place))
    export_c(law, tmp_path / "firmware")
    assert (
        checker.check(str(place), str(tmp_path / "firmware" / "law_data.h"))
        == certificate.verdict
    )


@pytest.mark.slow
def test_key_given_twice_and_other_law_are_rejected(
    document: dict[str, Any], checker: ModuleType, tmp_path: Path
):
    place, board = tmp_path / "c.json", document["content"]["statement"]["digest"]
    place.write_text(
        json.dumps(document).replace('"leaves"', '"leaves": 1, "leaves"', 1),
        encoding="utf-8",
    )
    assert _rejected(checker, place, board)
    place.write_text(json.dumps(document), encoding="utf-8")
    assert not _rejected(checker, place, board)
    with pytest.raises(ValueError, match="another law"):
        checker.check(str(place), "1" * 64)


@pytest.mark.slow
def test_the_checker_reads_the_block_where_the_law_wrote_it(
    checker: ModuleType,
) -> None:
    """The checker knows the block by offsets alone; a field that moves must not be
    taken for another one.
    """
    law = plan_for("sampled").law()
    claim = certify(plan_for("sampled"), law=law, modulus_margin=0.35).statement
    loop, written = checker.Loop(asdict(claim)), law.coefficients
    names = (
        "direct",
        "angle",
        "integral_now",
        "integral_before",
        "filter_now",
        "filter_before",
    )
    motor = [
        f"{'inner_' if name in ('direct', 'angle') else ''}{name}" for name in names
    ]
    motor += ["filter_angle_now", "filter_angle_before", "filter_decay"]
    assert list(loop.pid) == [written[name] for name in motor]
    assert (loop.T, loop.direct) == (written["period"], written["direct"])
    assert [p.real for p, _ in loop.modes] == list(law.correction.poles)


def test_a_law_alone_says_which_noun_is_missing() -> None:
    made = documented_design(RIG)
    law = made.law()
    with pytest.raises(FieldError, match="model is required"):
        certify(law)
    with pytest.raises(FieldError, match="model is required"):
        certify(law, rig=RIG)
    with pytest.raises(FieldError, match="rig is required"):
        certify(law, model=RIG.model)


@pytest.mark.slow
def test_the_search_for_the_closest_loop_ends_below_random_points_of_the_box() -> None:
    """The result is a loop of the box, and none of two thousand random loops is closer
    to −1.
    """
    found, law = known(RICH, "tustin")
    statement, least, at = found.statement, found.distance, dict(found.place)
    assert least is not None and set(at) == set(AXES)
    here = {name: np.array([value]) for name, value in at.items()}
    assert abs(
        1 + loop_values(statement, law, here["frequency"], here)[0]
    ) == pytest.approx(least, rel=1e-12)
    g = np.random.default_rng(0)
    low, high = statement.box
    place = {name: g.uniform(low[name], high[name], 2000) for name in low}
    place["frequency"] = np.exp(
        g.uniform(math.log(1.0), math.log(math.pi / law.period), 2000)
    )
    for name in low:  # a tenth of them near the place that was found
        place[name][:200] = np.clip(
            at[name] * (1 + 1e-3 * g.normal(size=200)), low[name], high[name]
        )
    place["frequency"][:200] = at["frequency"] * (1 + 1e-3 * g.normal(size=200))
    assert np.abs(
        1 + loop_values(statement, law, place["frequency"], place)
    ).min() >= least * (1 - 1e-6)


def test_the_law_of_another_plant_is_refused_with_what_computes_its_margins() -> None:
    controller = fl.extend.FractionalPid(
        proportional=0.5, integral=0.9, integral_order=1.3
    )
    law = fl.extend.discretize_pid(
        controller, 0.02, output_limit=1.0, measurement_limit=1.0
    )
    with pytest.raises(FieldError, match="sampled_margins"):
        fl.certify(law)


@pytest.mark.slow
def test_the_box_of_a_statement_holds_every_payload_times_every_softness(
    certificate: Certificate,
):
    claim = certificate.statement
    low, high = claim.box
    assert set(low) == set(high) == set(AXES[1:])
    assert low["softness"] < claim.softness_low * claim.payload_low
    assert high["softness"] > claim.softness_high * claim.payload_high
    assert high["softness"] == pytest.approx(
        claim.softness_high * claim.payload_high, rel=1e-15
    )
    assert claim.softness == pytest.approx(
        0.5 * (claim.softness_low + claim.softness_high)
    )
    assert (low["motor"], high["motor"]) == (claim.gain_low, claim.gain_high)
    none = replace(
        claim, mode_gain_high=0.0, mode_frequency_low=3.0, mode_frequency_high=5.0
    ).box
    assert none[0]["mode_frequency"] == none[1]["mode_frequency"] == 0.0
    some = replace(
        claim, mode_gain_high=0.1, mode_frequency_low=3.0, mode_frequency_high=5.0
    ).box
    assert (some[0]["mode_frequency"], some[1]["mode_frequency"]) == (3.0, 5.0)
    servo = replace(claim, motor_loop="ideal", pole_low=3.0, pole_high=4.0).box
    assert (servo[0]["motor"], servo[1]["motor"]) == (3.0, 4.0)


@pytest.mark.slow
def test_the_words_name_every_number_of_the_claim(certificate: Certificate, law: Law):
    said = certificate.verdict
    claim = certificate.statement
    assert said == claim.words() and "meet no limit of the command" in said
    named = (
        "modulus",
        "payload_low",
        "delay_high",
        "order_high",
        "stiffness",
        "linear_range",
    )
    for name in (*named, "softness_low", "gain_high", "nominal_payload"):
        assert f" {getattr(claim, name)}" in said
    assert f"law {law.digest[:12]} " in said and f"period {law.period} s" in said
    assert claim.lowest == pytest.approx(
        min([2.0**-20 * math.pi, *(0.05 * (1 - abs(p)) for p in law.correction.poles)])
        / law.period
    )


@pytest.mark.slow
def test_delays_up_to_what_the_proof_knows(law: Law):
    """The proof supports delays of up to one period for a sampled motor loop, and eight
    for an ideal one.
    """
    wanted = {
        "model": RIG.model,
        "rig": RIG,
        "payloads": (0.02, 0.04),
        "modulus_margin": 0.999,
    }
    # for a servo with that delay
    wide = replace(law.limits, residual_angle=10.0, correction_limit=10.0)
    servo = replace(law, motor_loop=None, limits=wide)
    for made, most in ((law, law.period), (servo, 8 * law.period)):
        claim = certify(made, delay=(0.0, most), **wanted).statement  # type: ignore[arg-type]
        assert (claim.delay_low, claim.delay_high) == (0.0, most)
        with pytest.raises(FieldError, match=r"delay\[1\]"):
            certify(made, delay=(0.0, 1.001 * most), **wanted)  # type: ignore[arg-type]
    assert certify(law, **wanted).statement.delay_high == law.period  # type: ignore[arg-type]


@pytest.mark.slow
def test_where_it_fails_is_told_with_all_that_is_not_exact(law: Law):
    wanted = {
        "model": RIG.model,
        "rig": RIG,
        "payloads": (0.02, 0.04),
        "modulus_margin": 0.95,
    }
    exact = certify(law, box=ParameterBox.at(RIG.model), **wanted)  # type: ignore[arg-type]
    found = re.fullmatch(
        r"Not certified: \|1 \+ L\| = (\S+) is not above 0\.95 at (\S+) g, (\S+) rad/s and (\S+) ms of delay",
        exact.verdict,
    )
    assert found is not None, exact.verdict
    assert exact.distance is not None and exact.payload is not None
    assert exact.frequency is not None and exact.delay is not None
    numbers = (exact.distance, 1e3 * exact.payload, exact.frequency, 1e3 * exact.delay)
    assert [float(x) for x in found.groups()] == pytest.approx(numbers, rel=1e-3)
    place = dict(exact.place)
    assert set(place) == set(AXES) and place["frequency"] == exact.frequency
    at = {name: np.array([value]) for name, value in place.items()}
    distance = abs(1 + loop_values(exact.statement, law, at["frequency"], at)[0])
    assert distance == pytest.approx(exact.distance, rel=1e-9) and distance <= 0.95
    wide = certify(law, **wanted)  # type: ignore[arg-type]
    low, high = wide.statement.box
    named = [name.replace("_", " ") for name in AXES[3:] if low[name] < high[name]]
    assert named and all(f"{name} " in wide.verdict.split("(")[-1] for name in named)
    assert exact.tree == "" and exact.leaves == 0 and not exact.passed


@pytest.mark.slow
def test_a_motor_loop_that_barely_decays_is_proved_and_one_that_does_not_is_named(
    checker: ModuleType, tmp_path: Path
):
    """The continuous PID, placed without its delay at 96 rad/s, rings at 134 rad/s: its
    poles have the modulus 0.997, and leave the circle where the motor gains 10 %.
    """
    rig = replace(RIG, motor_loop=replace(RIG.motor_loop, pole=96.0))
    link = replace(RIG.model, second_mode=SecondMode(126.0, 0.03, 0.02))
    design = fl.design(
        link,
        rig,
        payloads=(0.024, 0.06),
        gain_crossover=10.0,
        phase_margin=fl.deg(50),
        motor_loop="sampled",
        placement="tustin",
    )

    def slowest(ratio: float) -> float:
        loop = design.motor_loop.sampled(rig.motor, rig.period, ratio=ratio)
        return float(abs(loop.poles()[0]))

    assert 0.99 < slowest(0.985) < slowest(1.015) < 1.0 < slowest(1.1)
    at, late = ParameterBox.at(link), (rig.period, rig.period)
    narrow = replace(at, motor_ratio=(0.985, 1.015), gauge_gain=(0.99, 1.01))
    proved = certify(design, box=narrow, delay=late)
    assert proved.passed, proved.verdict
    proved.save(tmp_path / "c.json")
    claim = checker.check(str(tmp_path / "c.json"), proved.statement.digest)
    assert claim == proved.verdict
    refused = certify(design, box=replace(at, motor_ratio=(0.9, 1.1)), delay=late)
    place = dict(refused.place)
    assert "the sampled motor loop is not stable" in refused.verdict
    assert slowest(place["motor"] / rig.motor.gain) > 1.0
    gain = 1.1 * rig.motor.gain
    other = replace(proved.statement, gain_low=gain, gain_high=gain)
    with pytest.raises(ValueError, match="motor loop is not stable"):
        checker.Loop(asdict(other))


def test_a_law_of_another_link_or_none_is_refused(law: Law):
    limits = replace(law.limits, reference_rate=1.0 - 1e-15)
    with pytest.raises(FieldError, match="reference_rate"):
        certify(
            replace(law, limits=limits), model=RIG.model, rig=RIG, modulus_margin=0.3
        )
    still = replace(RIG, motor=replace(RIG.motor, viscous_friction=0.0))
    with pytest.raises(FieldError, match="friction"):
        certify(law, model=RIG.model, rig=still, modulus_margin=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("placement", ["ideal", "tustin"])
def test_points_are_enclosed_as_the_loop_that_is_written_another_way(placement: str):
    """L and 1/L of boxes without extent, with damping, gauge and second mode, with and
    without aliases.
    """
    found, law = known(RICH, placement)
    claim, loop = found.statement, BoxLoop(found.statement)
    low, high = loop.root()
    points = low + (high - low) * np.random.default_rng(8).random((300, len(AXES)))
    points[:, 0] = np.geomspace(1.0, 780.0, 300)
    points[:, MODE] = RICH.second_mode.frequency / points[:, 0]
    place = {name: points[:, k] for k, name in enumerate(AXES)}
    place["mode_frequency"] = points[:, MODE] * points[:, 0]
    for held_ in (np.zeros(300, dtype=bool), np.ones(300, dtype=bool)):
        plain, inverse, _ = loop.forms(points, points, held_)
        exact = loop_values(claim, law, points[:, 0], place, held=held_)
        np.testing.assert_allclose(plain.c, exact, rtol=1e-7)
        np.testing.assert_allclose(inverse.c * exact, 1.0, rtol=1e-6)
        assert np.all(plain.r <= 1e-6 * np.abs(exact))


@pytest.mark.slow
def test_a_second_mode_that_hardly_decays_is_proved_over_its_interval() -> None:
    # Aluminium of 64 g under 101 to 158 g: ζ of a thousandth, known to 3 %. All else of
    # the box but the order is known, or the proof would take ten times as long.
    rig = Rig.named("paper-2023")
    rig = replace(
        rig,
        motor=replace(
            rig.motor,
            inertia=0.52,
            viscous_friction=7.9,
            torque_constant=17.6,
            gear_ratio=1.0,
            coulomb_torque=0.79,
        ),
        link=fl.extend.Link(length=0.593, stiffness=3.88, mass=0.064),
        payloads=replace(rig.payloads, low=0.101, high=0.158, nominal=0.126),
        motor_loop=MotorLoop(43.7, 2),
    )
    model = LinkModel(
        3.88,
        8.843,
        order=1.9976,
        payload=0.126,
        gauge_delay=0.0036,
        second_mode=SecondMode(121.4, 1.28, 0.001),
    )
    box = ParameterBox(
        natural_frequency=(8.71, 8.98),
        order=(1.9876, 1.9988),
        damping=(0.0, 0.0),
        gauge_gain=(0.97, 1.03),
        gauge_delay=(0.0033, 0.0046),
        motor_ratio=(0.95, 1.05),
        mode_frequency=(117.8, 125.0),
        mode_gain=(1.153, 1.409),
    )
    design = fl.design(model, rig, box=box, gain_crossover=9.0)
    known = replace(ParameterBox.at(model), order=box.order)
    narrow = replace(known, mode_frequency=box.mode_frequency, mode_gain=box.mode_gain)
    assert certify(design, box=narrow).passed
