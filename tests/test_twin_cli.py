"""The twin from the command line: record a log, run a design on it, compare."""

from __future__ import annotations

import json

import pytest

from fraclink import main


@pytest.mark.slow
def test_record_then_identify(tmp_path, capsys):
    log = tmp_path / "log.csv"
    arguments = [
        "--rig",
        "paper-2023",
        "--link-mass",
        "0.00735",
        "--payload",
        "0.020",
        "--out",
        str(log),
    ]
    assert main(["record", *arguments, "--seed", "3"]) == 0
    assert main(["record", *arguments]) == 2  # never over a file that is there
    assert main(["record", *arguments, "--seed", "3", "--force", "--json"]) == 0
    told = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert told["samples"] == 5001 and told["header"]["simulated"] == "true"
    model = tmp_path / "model.json"
    assert (
        main(
            ["identify", str(log), "--rig", "paper-2023", "--out", str(model), "--json"]
        )
        == 0
    )
    fit = json.loads(capsys.readouterr().out)
    assert fit["model"]["order"] == pytest.approx(1.92, abs=0.003)


@pytest.mark.parametrize("excitation", ["pulse", "chirp"])
def test_other_excitations(tmp_path, excitation):
    log = tmp_path / "log.csv"
    assert (
        main(
            [
                "record",
                "--rig",
                "paper-2023",
                "--excitation",
                excitation,
                "--out",
                str(log),
            ]
        )
        == 0
    )
    assert log.read_text(encoding="utf-8").count("\n") > 5001


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "value", "field"),
    [
        ("--payload", "-0.03", "payload"),
        ("--link-mass", "-1", "link_mass"),
        ("--duration", "1e9", "duration"),
        ("--excitation", "square", "excitation"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, capsys, option, value, field):
    out = tmp_path / "log.csv"
    assert (
        main(["record", "--rig", "paper-2023", "--out", str(out), option, value]) == 2
    )
    text = capsys.readouterr().err
    assert field in text and len(text.strip().splitlines()) == 1
    assert not out.exists()
