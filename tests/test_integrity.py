"""Files of results: an edited, truncated or damaged one is refused by every command
with exit code 2.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import load, main
from fraclink.errors import FieldError, FileFormatError
from fraclink.findings import Finding
from fraclink.trials import Study, load_study, save_study

Edit = Callable[[dict[str, Any]], object]
RIG = fl.Rig.named("paper-2023")


@pytest.fixture(scope="module")
def made() -> fl.Design:
    assert RIG.model is not None
    return fl.design(
        RIG.model, RIG, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0
    )


@pytest.fixture(scope="module")
def files(made: fl.Design, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    made.save(folder / "design.json")
    made.law().save(folder / "law.json")
    fl.save(RIG.model, folder / "model.json")
    return folder


def _edited(source: Path, out: Path, edit: Edit) -> Path:
    data = json.loads(source.read_text("utf-8"))
    edit(data)
    out.write_text(json.dumps(data), "utf-8")
    return out


def _eight_times(data: dict[str, Any]) -> None:
    data["content"]["controller"]["derivative_gain"] *= 8


COMMANDS = (
    "assess FILE",
    "simulate FILE --payload 0.03 --out run.npz",
    "simulate FILE --on twin",
    "certify FILE --out c.json",
    "export c FILE --out firmware",
    "export fmu FILE --out law.fmu",
    "run-realtime FILE --io udp://127.0.0.1:1 --out rt",
    "serve-arm FILE --io udp://127.0.0.1:1",
    "campaign montecarlo --design FILE --out mc",
    "campaign faults --design FILE --out faults",
    "design --rig paper-2023 --model FILE --out d.json",
    "compare FILE --out comparison",
)


@pytest.mark.slow
@pytest.mark.parametrize("line", COMMANDS)
def test_a_design_with_eight_times_the_gain_is_refused_by_every_command(
    line: str,
    files: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    _edited(files / "design.json", tmp_path / "bad.json", _eight_times)
    assert main(line.replace("FILE", "bad.json").split()) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "bad.json was changed after it was written" in said
    # nothing was derived from it
    assert [path.name for path in tmp_path.iterdir()] == ["bad.json"]


DOUBT = {
    "code": "W106",
    "severity": "warning",
    "message": "another arm",
    "evidence": {},
    "remedy": "",
}
EDITS: dict[str, Edit] = {
    "a limit": lambda d: d["content"]["requirements"][0].update(wanted=1.0),
    "a value achieved": lambda d: d["content"]["requirements"][0].update(achieved=99.0),
    "the payload range": lambda d: d["content"].update(payloads=[0.001, 0.5]),
    "the rig": lambda d: d["content"]["rig"]["link"].update(stiffness_Nm_per_rad=2.0),
    "a finding": lambda d: d["content"].update(findings=[DOUBT]),
    "the text": lambda d: d["summary"].update(controller="C(s) = 1"),
    "the verdict": lambda d: d["summary"].update(passed=not d["summary"]["passed"]),
    "the units": lambda d: d.update(units="deg"),
    "the period": lambda d: d.update(period=0.04),
    "the digest left out": lambda d: d.pop("sha256"),
    "the content left out": lambda d: d.pop("content"),
    "no content": lambda d: d.update(content=None),
    "a key left out": lambda d: d["content"].pop("controller"),
    "a key more": lambda d: d.update(note="checked"),
    "an earlier format": lambda d: d.update(format=2),
    "a later format": lambda d: d.update(format=99),
    "another kind": lambda d: d.update(fraclink="law"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EDITS)
def test_an_edited_design_is_refused(name: str, files: Path, tmp_path: Path) -> None:
    path = _edited(files / "design.json", tmp_path / "bad.json", EDITS[name])
    if (
        path.read_bytes()
        == json.dumps(json.loads((files / "design.json").read_text("utf-8"))).encode()
    ):
        pytest.fail("nothing was edited")
    with pytest.raises(FileFormatError):
        fl.Design.load(path)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("name", ["design.json", "law.json", "model.json"])
def test_a_file_cut_short_is_refused(
    name: str, share: float, files: Path, tmp_path: Path
) -> None:
    raw = (files / name).read_bytes()
    path = tmp_path / name
    path.write_bytes(raw[: int(share * len(raw.rstrip()))])
    with pytest.raises(FieldError):
        load(path)


def test_a_gate_cannot_be_deleted_from_the_folder_of_a_study(tmp_path: Path) -> None:
    wrong = Finding(
        "W211",
        "error",
        "the torque has the wrong sign",
        {"gain": -1.5},
        "state sign = -1",
    )
    save_study(
        Study(rig=RIG, findings=(wrong,), missing={"design": "not designed"}),
        tmp_path / "study",
    )
    study = load_study(tmp_path / "study")
    assert study.findings == (wrong,)
    assert study.verdict.promise.state == "failed"
    for edit in (
        lambda d: d["content"].update(findings=[]),
        lambda d: d["content"].update(missing={}),
    ):
        folder = shutil.copytree(
            tmp_path / "study", tmp_path / "edited", dirs_exist_ok=True
        )
        _edited(folder / "study.json", folder / "study.json", edit)
        with pytest.raises(
            FileFormatError, match=r"study\.json was changed after it was written"
        ):
            load_study(folder)
        assert main(["report", str(folder)]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["design.json", "law.json", "model.json"])
def test_a_file_with_one_wrong_byte_is_refused_or_means_the_same(
    name: str, files: Path, tmp_path: Path
) -> None:
    rng, raw, refused = np.random.default_rng(3), (files / name).read_bytes(), 0
    whole = load(files / name)
    for _ in range(150):
        damaged = bytearray(raw)
        damaged[int(rng.integers(len(raw)))] = int(rng.integers(256))
        (tmp_path / name).write_bytes(damaged)
        try:
            assert load(tmp_path / name) == whole  # a space, or the version of the tool
        except FieldError:
            refused += 1
    assert refused > 100
