"""Replay of logs through the compiled export, and the MATLAB files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink._export import Replay, export_c, export_matlab, replay, replay_log
from fraclink._law import Law
from fraclink.errors import FieldError
from law_bench import PERIOD, law, signals, with_pair
from needed_tools import octave_with_control, tool
from test_export import run as shell

ROWS = signals(2000)


def _replay(folder: Path, made: Law, compiler: str = "gcc", *, allow_changed: bool = False) -> Replay:
    tool(compiler)
    names = ("reference", "reference_acceleration", "motor_angle", "torque")
    signals = dict(zip(names, ROWS, strict=True))
    return replay(folder, made, compiler=compiler, allow_changed=allow_changed, **signals)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_the_export_repeats_the_package_to_the_bit(precision: str, compiler: str, tmp_path: Path) -> None:
    made = law(precision)
    export_c(made, tmp_path / "firmware")
    result = _replay(tmp_path / "firmware", made, compiler)
    assert result.passed
    assert result.first_difference is None
    assert result.largest_difference == 0.0
    assert len(result.voltage) == 2000
    assert np.ptp(result.motor_reference) > 0.2


@pytest.mark.slow
def test_a_changed_law_is_found_in_its_period(tmp_path: Path) -> None:
    made = law("double")
    export_c(made, tmp_path / "firmware")
    source = tmp_path / "firmware" / "law.c"
    text = source.read_text(encoding="utf-8")
    source.write_text(
        text.replace("sum += modes[i].gain * value;", "sum -= modes[i].gain * value;"), encoding="utf-8"
    )
    result = _replay(tmp_path / "firmware", made, allow_changed=True)
    assert not result.passed
    assert result.first_difference in (1, 2)
    assert result.largest_difference > 1e-6


def test_what_is_no_export_of_this_law_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="not an export"):
        _replay(tmp_path, law("double"))
    export_c(law("double"), tmp_path / "firmware")
    with pytest.raises(FieldError, match="another law"):
        _replay(tmp_path / "firmware", law("single"))
    (tmp_path / "firmware" / "law.c").write_text("not C", encoding="utf-8")
    with pytest.raises(FieldError, match="refused by the compiler"):
        _replay(tmp_path / "firmware", law("double"), allow_changed=True)
    rest = np.zeros(3)
    with pytest.raises(FieldError, match="not installed"):
        replay(
            tmp_path / "firmware",
            law("double"),
            reference=rest,
            reference_acceleration=rest,
            motor_angle=rest,
            torque=rest,
            compiler="no-such-compiler",
            allow_changed=True,
        )


_RUN = '__attribute__((constructor)) static void ran(void) {{ fclose(fopen("{mark}", "w")); }}\n'


@pytest.mark.slow
@pytest.mark.parametrize("file", ["law.c", "law.h", "law_data.h"])
@pytest.mark.parametrize("how", ["appended", "in front", "behind a comment", "in the first comment's line"])
def test_code_that_is_not_ours_is_not_run_unless_it_is_allowed(file: str, how: str, tmp_path: Path) -> None:
    """The changed file writes a mark as soon as it is run: the oracle is the file system."""
    made, mark = law("double"), tmp_path / "ran"
    export_c(made, tmp_path / "firmware", title="its title is free")
    path = tmp_path / "firmware" / file
    own, code = path.read_text(encoding="utf-8"), "#include <stdio.h>\n" + _RUN.format(mark=mark)
    changed = {
        "appended": own + code,
        "in front": code + own,
        "behind a comment": f"// /*\n{code}// */\n{own}",
        "in the first comment's line": own.replace("*/", "*/\n" + code, 1),
    }[how]
    path.write_text(changed, encoding="utf-8")
    with pytest.raises(FieldError, match="compiles and runs it on this computer") as refused:
        _replay(tmp_path / "firmware", made)
    assert refused.value.value == file
    assert not mark.exists()
    if file != "law.h":  # it is included twice, and the mark would be defined twice
        _replay(tmp_path / "firmware", made, allow_changed=True)
        assert mark.exists()


@pytest.mark.slow
def test_a_header_of_c_beside_the_law_is_not_taken_for_cs_own(tmp_path: Path) -> None:
    export_c(law("double"), tmp_path / "firmware")
    for header in ("math.h", "string.h", "stdint.h", "stdio.h"):
        (tmp_path / "firmware" / header).write_text("#error not the header of C\n", encoding="utf-8")
    assert _replay(tmp_path / "firmware", law("double")).passed


def test_the_mat_file_is_the_discrete_law(tmp_path: Path) -> None:
    from scipy.io import loadmat

    made = with_pair()
    data = loadmat(export_matlab(made, tmp_path / "law.mat"))
    w = np.geomspace(0.05, 500.0, 60)
    z = np.exp(1j * w * PERIOD)[:, None]
    inner = data["correction_direct"][0, 0] + (
        data["correction_residues"].ravel() / (z - data["correction_poles"].ravel())
    ).sum(axis=1)
    np.testing.assert_allclose((1 - 1 / z[:, 0]) * inner, made.frequency_response(w), rtol=1e-9)
    assert data["period"][0, 0] == PERIOD


def test_the_m_file_holds_every_number_to_the_bit(tmp_path: Path) -> None:
    made = with_pair()
    text = export_matlab(made, tmp_path / "arm_law.m").read_text(encoding="utf-8")
    assert text.startswith("function law = arm_law()")
    for value in (made.correction.direct, *made.correction.poles, *made.correction.gains):
        assert repr(value) in text


@pytest.mark.slow
def test_octave_runs_the_m_file_and_gets_the_laws_response(tmp_path: Path) -> None:
    made = with_pair()
    export_matlab(made, tmp_path / "arm_law.m")
    frequencies = np.geomspace(0.05, 500.0, 30)
    code = f"pkg load control; law = arm_law(); w = {frequencies.tolist()};"
    code += "h = squeeze(freqresp(law.correction.sys, w)); printf('%.17g %.17g\\n', [real(h) imag(h)].');"
    code += "printf('%.17g %d\\n', law.correction.sys.Ts, numel(pole(law.feedforward.sys)));"
    answer = shell(octave_with_control(), "--quiet", "--eval", code, cwd=tmp_path)
    *rows, last = (tuple(map(float, row.split())) for row in answer.stdout.splitlines())
    # as a quotient of polynomials it is 1e-4 off at 0.05 rad/s
    np.testing.assert_allclose(
        [complex(*row) for row in rows], made.frequency_response(frequencies), rtol=1e-10
    )
    assert last == (PERIOD, len(made.feedforward.poles))


def test_matlab_names_and_existing_files(tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="another kind"):
        export_matlab(law(), tmp_path / "law.txt")
    with pytest.raises(FieldError, match="identifier"):
        export_matlab(law(), tmp_path / "2 law.m")
    export_matlab(law(), tmp_path / "arm.m")
    with pytest.raises(FieldError, match="already there"):
        export_matlab(law(), tmp_path / "arm.m")
    export_matlab(law(), tmp_path / "arm.m", force=True)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_verb_replays_a_log(precision: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from fraclink._cli.app import run as fraclink

    tool("cc", "gcc")
    made = law(precision)
    export_c(made, tmp_path / "firmware", name="arm_2")
    firmware = str(tmp_path / "firmware")
    assert fraclink(["replay", firmware, "demo"]) == 0
    assert "agree to the last bit" in capsys.readouterr().out
    source = tmp_path / "firmware" / "law.c"
    text = source.read_text(encoding="utf-8")
    source.write_text(text.replace("sum += modes", "sum -= modes"), encoding="utf-8")
    assert fraclink(["replay", firmware, "demo"]) == 2
    assert "add --allow-changed" in " ".join(capsys.readouterr().err.split())
    assert fraclink(["replay", firmware, "demo", "--allow-changed"]) == 1
    printed = capsys.readouterr()
    assert "first difference in period" in printed.out
    assert "law.c was compiled and run on this computer" in " ".join(printed.err.split())
    assert fraclink(["replay", str(tmp_path), "demo"]) == 2
    assert "not an export" in capsys.readouterr().err


@pytest.mark.slow
def test_a_log_of_another_period_is_refused(tmp_path: Path) -> None:
    export_c(law(), tmp_path / "firmware")
    log = fl.Experiment(period=0.005, motor_angle=np.zeros(300), output=np.zeros(300), output_kind="torque")
    with pytest.raises(FieldError, match="period"):
        replay_log(tmp_path / "firmware", log)
