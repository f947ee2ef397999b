"""Replay: compile an exported law and run a log through it, period by period, and
compare it with the package's own law.

The C code of the folder runs on this computer with the rights of the user. Files that
differ from what `export_c` writes for the folder's law.json are therefore rejected,
unless the caller allows them.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.recording import Recording
from fraclink._display import Overview, Row, displayed, number, state_of
from fraclink._export.data import data_header, identifier, law_source
from fraclink._export.fmu import complaint, found
from fraclink._files import checked_path
from fraclink._law import Law
from fraclink.errors import FieldError
from fracsys.checks import Real, checked_noun
from fracsys.checks.equality import compared

__all__ = ["Replay", "replay_log"]


_HARNESS = """\
#include "law.h"
#include "@DATA@"
#include <stdio.h>

int main(void)
{
    static law_state state;
    double row[5];
    law_input in;
    law_output out;
    if (law_init(&state, &@NAME@) != LAW_OK) {
        return 3;
    }
    in.tick = 0U;
    while (fread(row, sizeof(row), 1, stdin) == 1U) {
        in.tick++;
        in.reference = (law_real)row[0];
        in.reference_acceleration = (law_real)row[1];
        in.motor_angle = (law_real)row[2];
        in.torque = (law_real)row[3];
        in.payload = (law_real)row[4];
        law_step(&state, &@NAME@, &in, &out);
        const double result[6] = {(double)out.motor_reference, (double)out.voltage, (double)out.tip_estimate,
                                  (double)out.error, (double)out.mode, (double)out.flags};
        if (fwrite(result, sizeof(result), 1, stdout) != 1U) {
            return 4;
        }
    }
    return 0;
}
"""


@compared
@displayed
@dataclass(frozen=True, eq=False)
class Replay:
    """What the exported law and the package's law gave for the same log; signals have
    shape (N,).

    motor_reference [rad], voltage [V], tip_estimate [rad] and mode of the exported law;
    `first_difference` is the first period in which any output differs from the
    package's, None where all agree to the last bit.
    """

    motor_reference: Real
    voltage: Real
    tip_estimate: Real
    mode: Real
    flags: Real
    first_difference: int | None
    largest_difference: float

    @property
    def passed(self) -> bool:
        """Whether every output of every period agrees to the last bit."""
        return self.first_difference is None

    def overview(self) -> Overview:
        """Whether they agree, and where they first do not."""
        agreed = f"{len(self.mode)} periods agree to the last bit"
        differs = (
            f"first difference in period {self.first_difference}, "
            f"largest {number(self.largest_difference, 3)}"
        )
        rows = (
            Row("first_difference", "", self.first_difference),
            Row("largest_difference", "", self.largest_difference),
            Row("periods", "", len(self.mode)),
            Row("last_mode", "", int(self.mode[-1])),
        )
        return Overview(agreed if self.passed else differs, state_of(self.passed), rows)


def replay_log(
    folder: Path | str,
    log: Experiment | Recording,
    *,
    compiler: str = "cc",
    allow_changed: bool = False,
) -> Replay:
    """Run the sensors of a log through the law exported to `folder` and through the
    package's, and compare them period by period.

    The C of the folder is compiled and run on this computer. The law is the folder's
    law.json. The motor's own path is the reference, with acceleration 0, so that the
    guards see a motor that follows.

    Parameters
    ----------
    folder
        of `export_c`.
    log
        at the law's period; a `Recording` for the law of a fractional PID: its input is
        the reference, its output the measurement.
    compiler
        a C compiler on the PATH.
    allow_changed
        whether law.c, law.h or the header of the block may differ from what `export_c`
        writes.

    Raises
    ------
    FieldError
        the folder holds no export, its files were changed, the log is of another period
        [s] or of another kind than the law, or the compiler fails.

    >>> import fraclink as fl, tempfile
    >>> from fraclink.extend import replay_log
    >>> rig = fl.Rig.named("paper-2023")
    >>> controller = fl.Controller(derivative_gain=0.069876, derivative_order=0.612197, link=rig.model)
    >>> folder = tempfile.mkdtemp()
    >>> _ = fl.export_c(fl.discretize(controller, rig.period, order=4), folder)
    >>> replay_log(folder, fl.read_log(fl.bundled_log("prbs_30g"), rig=rig)).passed
    True
    """
    if not isinstance(log, Recording):
        checked_noun("log", log, Experiment, remedy="read_log makes one")
    place = checked_path("folder", folder).resolve()
    law, name = _exported(place)
    # Decimal stamps leave a relative error of 1e-9 in the period; 1e-6 is still the
    # same rate (4 ms in an hour).
    if abs(log.period - law.period) > 1e-6 * law.period:
        raise FieldError(
            "period",
            log.period,
            "not the law's",
            allowed=f"{law.period} s",
            remedy="resample the log",
        )
    reference, measured, torque = _sensors(law, log)
    none = np.zeros_like(reference)
    # One row per period, in the form in which the program below reads them: five
    # doubles at a time from standard input. With no text or file in between, no digit
    # is lost.
    rows = np.column_stack([reference, none, measured, torque, none])
    if not allow_changed:
        _check_unchanged(place, law, name)
    output = _compiled(place, law, name, compiler, rows.tobytes())
    replayed = np.frombuffer(output, dtype=np.float64).reshape(-1, 6)
    _, own = law.run(law.initial_state(), *rows.T)
    names = ("motor_reference", "voltage", "tip_estimate", "error", "mode", "flags")
    expected = np.column_stack([getattr(own, signal) for signal in names])
    # Fewer rows: the program ended early because law_init rejected the block.
    if replayed.shape != expected.shape:
        raise FieldError(
            "firmware",
            replayed.shape,
            "incomplete",
            allowed=f"{expected.shape}",
            remedy="export the law again",
        )
    # Values are compared: the law never returns NaN, and −0 and 0 are the same command.
    differs = np.flatnonzero(np.any(replayed != expected, axis=1))
    signals = dict(zip(names, replayed.T.copy(), strict=True))
    del signals["error"]
    return Replay(
        **signals,
        first_difference=int(differs[0]) if differs.size else None,
        largest_difference=float(np.max(np.abs(replayed - expected), initial=0.0)),
    )


def _exported(place: Path) -> tuple[Law, str]:
    """The law of an export, and the name of its block, which the user chose: its header
    is recognised by the digest in its first comment, which no other file contains.
    """
    if not all((place / file).is_file() for file in ("law.json", "law.c")):
        raise FieldError(
            "firmware",
            str(place),
            "not an export",
            allowed="a folder of export_c",
            remedy="export the law first",
        )
    law = Law.load(place / "law.json")
    for file in sorted(place.glob("*.h")):
        if f"law {law.digest}" in file.read_text("utf-8"):
            return law, identifier("name", file.stem)
    raise FieldError(
        "firmware",
        str(place),
        "the export of another law",
        allowed=f"law {law.digest[:16]}...",
        remedy="export this law, in the precision it has",
    )


def _sensors(law: Law, log: Experiment | Recording) -> tuple[Real, Real, Real]:
    """Reference, motor angle (for a PID its measurement) and torque."""
    if isinstance(log, Recording) == law.has_gauge:
        raise FieldError(
            "log",
            "a recording" if isinstance(log, Recording) else "an arm's log",
            "of another kind than the law",
            allowed="its own",
            remedy="the law of an arm takes an Experiment, that of a fractional PID a Recording (--input, --output)",
        )
    if isinstance(log, Recording):
        return log.input, log.output, np.zeros_like(log.output)
    # Γ = c (θm − θt): the law only reads torque.
    torque = log.output if log.output_kind == "torque" else law.stiffness * log.output
    # A log contains no reference. With the path of the motor as reference the error of
    # the motor loop is small, and the guards see a motor that follows; the commands are
    # only compared with each other.
    return log.motor_angle, log.motor_angle, torque


def _check_unchanged(place: Path, law: Law, name: str) -> None:
    """Reject C code that this release does not export for `law`."""
    ours = {file: law_source(file) for file in ("law.h", "law.c")}
    ours[f"{name}.h"] = data_header(law, name=name).encode()
    changed = [
        file
        for file, text in ours.items()
        if not (place / file).is_file() or (place / file).read_bytes() != text
    ]
    if changed:
        raise FieldError(
            "firmware",
            ", ".join(changed),
            "not as this release exports it, and replay compiles and runs it on this computer",
            allowed="the files of fraclink export c",
            remedy="export the law again, or add --allow-changed (allow_changed=True) if you trust them",
        )


def _compiled(place: Path, law: Law, name: str, compiler: str, log: bytes) -> bytes:
    command = [
        found(compiler, "install gcc or clang"),
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
    ]
    command += ["-DLAW_SINGLE"] if law.precision == "single" else []
    with tempfile.TemporaryDirectory() as scratch:
        source, program = Path(scratch) / "replay.c", Path(scratch) / "replay"
        # in a separate folder: a math.h next to the files would replace that of C
        for file in (
            "law.h",
            "law.c",
            f"{name}.h",
        ):
            if (place / file).is_file():
                shutil.copyfile(place / file, Path(scratch) / file)
        source.write_text(
            _HARNESS.replace("@DATA@", f"{name}.h").replace("@NAME@", name),
            encoding="utf-8",
        )
        if message := complaint(
            [*command, source.name, "law.c", "-o", program.name], Path(scratch)
        ):
            raise FieldError(
                "firmware",
                message,
                "refused by the compiler",
                allowed="C99",
                remedy="export the law again",
            )
        return subprocess.run(  # noqa: S603
            [program], input=log, capture_output=True, check=True
        ).stdout
