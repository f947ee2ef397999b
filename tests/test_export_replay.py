"""Replay of logs through the compiled export, and the MATLAB files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink import export_c
from fraclink.errors import FieldError
from fraclink.extend import replay_log
from law_bench import law, signals
from needed_tools import tool

ROWS = signals(2000)


def _log(rows: np.ndarray = ROWS) -> fl.Experiment:
    return fl.Experiment(
        period=0.004, motor_angle=rows[2], output=rows[3], output_kind="torque"
    )


def _replay(folder: Path, compiler: str = "gcc", *, allow_changed: bool = False) -> Any:
    tool(compiler)
    return replay_log(folder, _log(), compiler=compiler, allow_changed=allow_changed)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_the_export_repeats_the_package_to_the_bit(
    precision: str, compiler: str, tmp_path: Path
) -> None:
    made = law(precision)
    export_c(made, tmp_path / "firmware")
    result = _replay(tmp_path / "firmware", compiler)
    assert result.passed
    assert result.first_difference is None
    assert result.largest_difference == 0.0
    assert len(result.voltage) == 2000
    assert np.ptp(result.motor_reference) > 0.2


@pytest.mark.slow
def test_a_replay_holds_what_the_c_gave(tmp_path: Path) -> None:
    """Each signal is compared with that of the package's own run of the law on the
    motor's path.
    """
    made = law("single")
    export_c(made, tmp_path, name="arm_2")
    result = _replay(tmp_path)
    rest = np.zeros_like(ROWS[2])
    _, own = made.run(made.initial_state(), ROWS[2], rest, ROWS[2], ROWS[3])
    assert result.passed and result.largest_difference == 0.0
    for name in ("motor_reference", "voltage", "tip_estimate", "mode", "flags"):
        np.testing.assert_array_equal(getattr(result, name), getattr(own, name))


@pytest.mark.slow
def test_a_changed_law_is_found_in_its_period(tmp_path: Path) -> None:
    made = law("double")
    export_c(made, tmp_path / "firmware")
    source = tmp_path / "firmware" / "law.c"
    text = source.read_text(encoding="utf-8")
    source.write_text(
        text.replace("sum += modes[i].gain * value;", "sum -= modes[i].gain * value;"),
        encoding="utf-8",
    )
    result = _replay(tmp_path / "firmware", allow_changed=True)
    assert not result.passed
    assert result.first_difference in (1, 2)
    assert result.largest_difference > 1e-6


@pytest.mark.slow
def test_what_is_no_export_of_this_law_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FieldError, match="not an export"):
        _replay(tmp_path)
    export_c(law("double"), tmp_path / "firmware")
    law("single").save(tmp_path / "firmware" / "law.json")
    with pytest.raises(FieldError, match="another law"):
        _replay(tmp_path / "firmware")
    law("double").save(tmp_path / "firmware" / "law.json")
    source = tmp_path / "firmware" / "law.c"
    wrong = "int one(void)\n{\n    return nothing;\n}\n"
    source.write_text(source.read_text(encoding="utf-8") + wrong, encoding="utf-8")
    # The line of the error, not the one before it, which only names the function.
    with pytest.raises(
        FieldError,
        match=r"refused by the compiler .got law\.c:\d+:\d+: error: .*nothing",
    ):
        _replay(tmp_path / "firmware", allow_changed=True)
    with pytest.raises(FieldError, match="not installed"):
        replay_log(
            tmp_path / "firmware",
            _log(),
            compiler="no-such-compiler",
            allow_changed=True,
        )


_RUN = '__attribute__((constructor)) static void ran(void) {{ fclose(fopen("{mark}", "w")); }}\n'


@pytest.mark.slow
@pytest.mark.parametrize("file", ["law.c", "law.h", "law_data.h"])
@pytest.mark.parametrize(
    "how", ["appended", "in front", "behind a comment", "in the first comment's line"]
)
def test_code_that_is_not_ours_is_not_run_unless_it_is_allowed(
    file: str, how: str, tmp_path: Path
) -> None:
    """The changed file creates a marker file as soon as it is executed."""
    made, mark = law("double"), tmp_path / "ran"
    export_c(made, tmp_path / "firmware")
    path = tmp_path / "firmware" / file
    own, code = (
        path.read_text(encoding="utf-8"),
        "#include <stdio.h>\n" + _RUN.format(mark=mark),
    )
    changed = {
        "appended": own + code,
        "in front": code + own,
        "behind a comment": f"// /*\n{code}// */\n{own}",
        "in the first comment's line": own.replace("*/", "*/\n" + code, 1),
    }[how]
    path.write_text(changed, encoding="utf-8")
    with pytest.raises(
        FieldError, match="compiles and runs it on this computer"
    ) as refused:
        _replay(tmp_path / "firmware")
    assert refused.value.value == file
    assert not mark.exists()
    if file != "law.h":  # it is included twice, so the mark would be defined twice
        _replay(tmp_path / "firmware", allow_changed=True)
        assert mark.exists()


@pytest.mark.slow
def test_a_header_of_c_beside_the_law_is_not_taken_for_cs_own(tmp_path: Path) -> None:
    export_c(law("double"), tmp_path / "firmware")
    for header in ("math.h", "string.h", "stdint.h", "stdio.h"):
        (tmp_path / "firmware" / header).write_text(
            "#error not the header of C\n", encoding="utf-8"
        )
    assert _replay(tmp_path / "firmware").passed


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_verb_replays_a_log(
    precision: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from fraclink import main as fraclink

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
    assert "law.c was compiled and run on this computer" in " ".join(
        printed.err.split()
    )
    assert fraclink(["replay", str(tmp_path), "demo"]) == 2
    assert "not an export" in capsys.readouterr().err


def test_a_log_of_another_period_is_refused(tmp_path: Path) -> None:
    export_c(law(), tmp_path / "firmware")
    log = fl.Experiment(
        period=0.005,
        motor_angle=np.zeros(300),
        output=np.zeros(300),
        output_kind="torque",
    )
    with pytest.raises(
        FieldError, match=r"period: not the law's .got 0.005.; expected 0.004 s"
    ):
        replay_log(tmp_path / "firmware", log)
    (tmp_path / "firmware" / "law.json").unlink()
    with pytest.raises(FieldError, match="firmware: not an export"):
        replay_log(tmp_path / "firmware", log)
