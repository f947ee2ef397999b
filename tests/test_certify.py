"""Certificates: what is proved, what is refused, and that no forgery passes the independent checker."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._arm.rig import Rig
from fraclink._certify import Certificate, certify
from fraclink._certify.balls import Loop, outside
from fraclink._certify.numeric import loop_values
from fraclink._certify.search import Failure, clear, prove
from fraclink._certify.statement import Statement
from fraclink._design import Design
from fraclink._design.poles import PRINTED
from fraclink._law import Law
from fraclink.errors import FieldError, FileFormatError, NotCertifiedError

RIG = Rig.named("paper-2023")
CHECKER = Path(__file__).resolve().parents[1] / "tools" / "check_certificate.py"


def plan_for(inner: str, placement: str = "tustin") -> Design:
    wanted = {"gain_crossover": 12.0, "phase_margin": fl.deg(50), "filter_time": 0.0}
    return fl.design(RIG.model, RIG, payloads=(0.020, 0.040), inner=inner, placement=placement, **wanted)


@pytest.fixture(scope="module")
def checker() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check_certificate", CHECKER)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def law() -> Law:
    return plan_for("ideal").law()


@pytest.fixture(scope="module")
def certificate(law: Law) -> Certificate:
    return certify(plan_for("ideal"), law=law, modulus_margin=0.35)


@pytest.fixture(scope="module")
def document(certificate: Certificate, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    place = tmp_path_factory.mktemp("certificate") / "certificate.json"
    certificate.save(place)
    return dict(json.loads(place.read_text(encoding="utf-8")))


def test_default_design_is_certified_and_checked_by_other_arithmetic(
    certificate: Certificate, tmp_path: Path
):
    assert certificate.passed
    assert "20 to 40 g" in certificate.verdict and "0 to 4 ms" in certificate.verdict
    certificate.save(tmp_path / "c.json")
    assert Certificate.load(tmp_path / "c.json") == certificate
    run = subprocess.run(  # noqa: S603  # our own checker on our own file
        [sys.executable, str(CHECKER), str(tmp_path / "c.json"), certificate.statement.digest],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0 and run.stdout.startswith("PROVED"), run.stderr


@pytest.mark.parametrize("placement", ["tustin", "direct"])
def test_sampled_motor_loop_is_certified_and_checked(placement: str, checker: ModuleType, tmp_path: Path):
    found = certify(plan_for("sampled", placement), modulus_margin=0.35)
    assert found.passed, found.verdict
    found.save(tmp_path / "c.json")
    assert "0.35" in checker.check(str(tmp_path / "c.json"))


def test_single_precision_law_and_default_claim(law: Law):
    found = certify(plan_for("ideal"), law=law.in_precision("single"))
    assert found.passed
    assert 0.5 < found.statement.modulus < 0.66


def test_checker_is_one_short_file_of_mpmath_only():
    text = CHECKER.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 150
    assert "import fraclink" not in text and "numpy" not in text


@pytest.mark.parametrize("inner", ["ideal", "sampled"])
def test_balls_hold_the_loop_at_random_points_of_random_boxes(inner: str):
    design = plan_for(inner)
    proper = design.law()
    claim = certify(design, law=proper, modulus_margin=0.999).statement
    loop, rng = Loop(claim, proper.coefficients), np.random.default_rng(5)
    for _ in range(60):
        w0, m0 = float(np.exp(rng.uniform(-1, 6.5))), float(rng.uniform(0.02, 0.039))
        t0 = float(rng.uniform(0, 0.0035))
        box = (w0, min(w0 * (1 + 10 ** rng.uniform(-4, -1)), 785.0), m0, m0 + 0.001, t0, t0 + 0.0005)
        value, size, _ = loop.inverse(loop.window(*box[:2]), box[2:4], box[4:])
        where = [rng.uniform(box[2 * i], box[2 * i + 1], 20) for i in range(3)]
        exact = 1.0 / loop_values(claim, proper, *where)
        if value.is_finite():
            real, imaginary = outside(value.real), outside(value.imag)
            assert np.all((real[0] <= exact.real) & (exact.real <= real[1]))
            assert np.all((imaginary[0] <= exact.imag) & (exact.imag <= imaginary[1]))
        if size.is_finite():
            assert outside(size)[0] <= np.min(np.abs(exact)) * (1 + 1e-12)


def test_loop_of_the_certificate_is_the_sampled_loop_of_the_plan():
    for inner, delay in (("ideal", 0.004), ("sampled", 0.004)):
        design = plan_for(inner)
        proper = design.law()
        claim = certify(design, law=proper, modulus_margin=0.999).statement
        w = np.geomspace(1.0, 300.0, 40)
        plant = design.sampled_plant(design.natural_frequency(0.023))
        true = proper.frequency_response(w) * plant(w)
        main = loop_values(claim, proper, w, 0.023, delay)
        balls = Loop(claim, proper.coefficients)
        for k, frequency in enumerate(w):
            bound = balls.inverse(balls.window(frequency, frequency), (0.023, 0.023), (delay, delay))[2]
            assert abs(true[k] - main[k]) <= bound


def test_claim_above_the_truth_is_refused_with_the_place(law: Law):
    found = certify(plan_for("ideal"), law=law, modulus_margin=0.9)
    assert not found.passed
    assert found.payload == pytest.approx(0.020)
    assert found.distance is not None and found.distance < 0.9
    assert "20 g" in found.verdict and "rad/s" in found.verdict
    with pytest.raises(NotCertifiedError):
        found.save("nowhere.json")


def test_claim_just_above_the_truth_is_not_proved(law: Law):
    found = certify(plan_for("ideal"), law=law, modulus_margin=0.3)
    close = replace(found.statement, modulus=0.6572)
    outcome = prove(Loop(close, law.coefficients), most=20_000)
    assert isinstance(outcome, Failure)
    assert outcome.payload == pytest.approx(0.020, rel=0.05)


def test_printed_controller_is_refused_with_payload_and_poles():
    found = certify(PRINTED["(58)"], model=RIG.model, rig=RIG, payloads=(0.020, 0.040))
    assert not found.passed and "unstable" in found.verdict
    assert found.payload == pytest.approx(0.040)
    assert found.poles[0].real == pytest.approx(0.168, abs=5e-4)
    assert abs(found.poles[0].imag) == pytest.approx(10.84, abs=5e-3)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"modulus_margin": 1.5}, "modulus_margin"),
        ({"modulus_margin": 0.0}, "modulus_margin"),
        ({"payloads": (0.0, 0.04)}, "payloads[0]"),
        ({"payloads": (0.04, 0.02)}, "payloads[1]"),
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


def test_rectangles_that_are_clear_hold_no_forbidden_point():
    rng = np.random.default_rng(3)
    t = np.linspace(0, 1, 9)
    for _ in range(2000):
        a, b = np.sort(rng.uniform(-4, 2, 2)), np.sort(rng.uniform(-2, 2, 2))
        m = float(rng.uniform(0.05, 0.9))
        if clear((a[0], a[1]), (b[0], b[1]), m):
            y = (a[0] + (a[1] - a[0]) * t)[:, None] + 1j * (b[0] + (b[1] - b[0]) * t)
            loop = 1.0 / y
            assert np.all(np.abs(1 + loop) > m)
            assert not np.any((np.abs(loop.imag) < 1e-12) & (loop.real <= -1))


# Forgeries, each by somebody who also mends the certificate's own hash.


def _number(field: str, factor: float = 1.0, value: float | None = None) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        old = float.fromhex(data["statement"][field])
        data["statement"][field] = (old * factor if value is None else value).hex()

    return change


def _text(field: str, value: str) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        data["statement"][field] = value

    return change


def _tree(edit: Callable[[str], str]) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        data["tree"] = edit(data["tree"])
        data["leaves"] = data["tree"].count(".")

    return change


def _block(place: int, factor: float, *, mend: bool) -> Callable[[dict[str, Any]], None]:
    """Scale one coefficient of the law; `mend` gives the block a fitting CRC and hash."""

    def change(data: dict[str, Any]) -> None:
        block = bytearray.fromhex(data["statement"]["block"])
        (old,) = struct.unpack_from("<d", block, 56 + 8 * place)
        struct.pack_into("<d", block, 56 + 8 * place, old * factor)
        if mend:
            struct.pack_into("<I", block, 12, zlib.crc32(block[16:]))
            data["statement"]["digest"] = hashlib.sha256(block).hexdigest()
        data["statement"]["block"] = block.hex()

    return change


def _drop(field: str) -> Callable[[dict[str, Any]], None]:
    return lambda data: data["statement"].pop(field)


def _envelope(field: str, value: object) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.__setitem__(field, value)


FORGERIES: dict[str, Callable[[dict[str, Any]], None]] = {
    "leaf missing": _tree(lambda t: t[:-1]),
    "leaf too many": _tree(lambda t: t + "."),
    "subtree replaced by a leaf": _tree(lambda _: "."),
    "unknown letter": _tree(lambda t: t.replace("w", "x", 1)),
    "number of leaves": _envelope("leaves", 7),
    "margin claimed larger": _number("modulus", value=0.64),
    "margin of one": _number("modulus", value=1.0),
    "lighter payload claimed": _number("payload_low", value=0.004),
    "payload range turned round": _number("payload_low", value=0.05),
    "longer delay claimed": _number("delay_high", value=0.040),
    "negative delay": _number("delay_low", value=-0.004),
    "slower motor": _number("pole", value=12.0),
    "order of two": _number("order", value=2.0),
    "order not a number": _number("order", value=float("nan")),
    "payload law changed": _number("softness", factor=0.1),
    "lowest frequency raised": _number("lowest", value=30.0),
    "coefficient changed": _block(2, 3.0, mend=False),
    "coefficient changed, hashes mended": _block(2, 30.0, mend=True),
    "unstable mode, hashes mended": _block(5, -20.0, mend=True),
    "hash of another law": _text("digest", "0" * 64),
    "other precision": _text("precision", "single"),
    "motor loop renamed": _text("inner", "sampled"),
    "field missing": _drop("pole"),
    "other kind of file": _envelope("fraclink", "design"),
    "other format": _envelope("format", 2),
}


def _rejected(checker: ModuleType, place: Path) -> bool:
    try:
        checker.check(str(place))
    except (ValueError, KeyError, TypeError, ArithmeticError, AttributeError, struct.error):
        return True
    return False


@pytest.mark.parametrize("name", FORGERIES)
def test_forgeries_are_rejected(name: str, document: dict[str, Any], checker: ModuleType, tmp_path: Path):
    forged = json.loads(json.dumps(document))
    FORGERIES[name](forged)
    signed = {"statement": forged["statement"], "tree": forged["tree"]}
    text = json.dumps(signed, sort_keys=True, separators=(",", ":"))
    forged["sha256"] = hashlib.sha256(text.encode()).hexdigest()
    place = tmp_path / "forged.json"
    place.write_text(json.dumps(forged), encoding="utf-8")
    assert _rejected(checker, place)


def test_careless_forgeries_are_rejected_by_the_hash(
    document: dict[str, Any], checker: ModuleType, tmp_path: Path
):
    for name in ("slower motor", "margin claimed larger", "leaf missing", "payload law changed"):
        forged = json.loads(json.dumps(document))
        FORGERIES[name](forged)
        place = tmp_path / "forged.json"
        place.write_text(json.dumps(forged), encoding="utf-8")
        assert _rejected(checker, place)
        with pytest.raises((FileFormatError, FieldError)):
            Certificate.load(place)


def test_key_given_twice_and_other_law_are_rejected(
    document: dict[str, Any], checker: ModuleType, tmp_path: Path
):
    place = tmp_path / "c.json"
    place.write_text(json.dumps(document).replace('"leaves"', '"leaves": 1, "leaves"', 1), encoding="utf-8")
    assert _rejected(checker, place)
    place.write_text(json.dumps(document), encoding="utf-8")
    assert not _rejected(checker, place)
    with pytest.raises(ValueError, match="another law"):
        checker.check(str(place), "1" * 64)


def test_statement_survives_json_bit_for_bit(certificate: Certificate):
    assert Statement.from_json(certificate.statement.to_json()) == certificate.statement


def test_the_checker_reads_the_block_where_the_law_wrote_it(checker: ModuleType) -> None:
    """It knows the block by offsets alone; a field that moves must not be taken for another."""
    law = plan_for("sampled").law()
    claim = certify(plan_for("sampled"), law=law, modulus_margin=0.35).statement
    fields = {k: v if k in checker.TEXT else float.fromhex(v) for k, v in claim.to_json().items()}
    loop, written = checker.Loop(fields), law.coefficients
    names = ("direct", "angle", "integral_now", "integral_before", "filter_now", "filter_before")
    motor = [f"{'inner_' if name in ('direct', 'angle') else ''}{name}" for name in names]
    motor += ["filter_angle_now", "filter_angle_before", "filter_decay"]
    assert [float(v.mid) for v in loop.pid] == [written[name] for name in motor]
    assert (float(loop.T.mid), float(loop.direct.mid)) == (written["period"], written["direct"])
    poles = [float(p.real.mid) for p, _ in loop.modes]
    assert poles == list(law.correction.poles)
