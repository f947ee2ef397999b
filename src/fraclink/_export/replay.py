"""Replay: compile an exported law and run a log through it, period by period, beside
the package's own.

The C of the folder runs on this computer with the rights of its user. Files that are
not what `export_c` writes for the folder's law.json are therefore refused, unless the
caller allows them.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fraclink._arm.experiment import Experiment
from fraclink._arm.recording import Recording
from fraclink._export.data import data_header, identifier, law_source
from fraclink._export.fmu import complaint, found
from fraclink._files import checked_path
from fraclink._law import Law
from fraclink.errors import FieldError
from fracsys.checks import checked_between, checked_noun, checked_series
from fracsys.checks.equality import compared

__all__ = ["Replay", "replay", "replay_log"]

Real = NDArray[np.float64]

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


def replay(
    folder: Path | str,
    law: Law,
    *,
    reference: ArrayLike,
    reference_acceleration: ArrayLike,
    motor_angle: ArrayLike,
    torque: ArrayLike,
    payload: float = 0.0,
    name: str = "law_data",
    compiler: str = "cc",
    allow_changed: bool = False,
) -> Replay:
    """Compile the law exported to `folder`, run the log through it and compare it with
    `law`, period by period.

    The C of the folder is compiled and run on this computer.

    Parameters
    ----------
    folder, law
        the export, and the law that it is compared with.
    reference, reference_acceleration, motor_angle, torque
        signals at the law's period, shape (N,) [rad], [rad/s²], [rad], [N·m].
    payload
        that the law is given [kg]; 0 for none.
    name
        of the block.
    compiler
        a C compiler on the PATH.
    allow_changed
        whether law.c, law.h or the header of the block may differ from what `export_c`
        writes.

    Raises
    ------
    FieldError
        the folder holds no export, its block is not that of `law`, its files were
        changed, or the compiler fails.

    >>> import fraclink as fl, tempfile
    >>> from fraclink._export import export_c, replay
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.discretize(fl.Controller(gain=0.069876, order=0.612197, link=rig.model), rig.period, order=4)
    >>> folder = tempfile.mkdtemp()
    >>> _ = export_c(law, folder)
    >>> rest = np.zeros(100)
    >>> replay(folder, law, reference=rest, reference_acceleration=rest, motor_angle=rest, torque=rest).passed
    True
    """
    identifier("name", name)
    checked_noun("law", law, Law, remedy="Law.load reads the folder's law.json")
    place = checked_path("folder", folder).resolve()
    signals = _signals(
        reference=reference,
        reference_acceleration=reference_acceleration,
        motor_angle=motor_angle,
        torque=torque,
    )
    # One payload for the whole log: logs do not hold one for each sample.
    given = np.full(
        signals[0].shape, checked_between("payload", payload, 0.0, 1e9, "kg")
    )
    # A row for each period, as the program below reads them: five doubles at a time
    # from its standard input. Neither text nor a file comes between, so that no digit
    # is lost.
    rows = np.ascontiguousarray(np.column_stack([*signals, given]))
    # First whose law it is, then whether its C is ours: "another law" is the plainer
    # answer where both are so. Nothing is compiled before.
    _check_block(place, law, name)
    if not allow_changed:
        _check_unchanged(place, law, name)
    output = _compiled(place, law, name, compiler, rows.tobytes())
    got = np.frombuffer(output, dtype=np.float64).reshape(-1, 6)
    _, own = law.run(law.initial_state(), *rows.T)
    wanted = np.column_stack(
        [
            own.motor_reference,
            own.voltage,
            own.tip_estimate,
            own.error,
            own.mode,
            own.flags,
        ]
    )
    # Fewer rows: the program ended early, as law_init refused the block.
    if got.shape != wanted.shape:
        raise FieldError(
            "firmware",
            got.shape,
            "incomplete",
            allowed=f"{wanted.shape}",
            remedy="export the law again",
        )
    # A comparison of values: NaN would differ from itself, but the law gives none; −0
    # and 0 are the same command.
    differs = np.flatnonzero(np.any(got != wanted, axis=1))
    return Replay(
        motor_reference=got[:, 0].copy(),
        voltage=got[:, 1].copy(),
        tip_estimate=got[:, 2].copy(),
        mode=got[:, 4].copy(),
        flags=got[:, 5].copy(),
        first_difference=int(differs[0]) if differs.size else None,
        largest_difference=float(np.max(np.abs(got - wanted), initial=0.0)),
    )


def _signals(**given: ArrayLike) -> list[Real]:
    """The four columns; FieldError where one is none, or of another length than the
    first.
    """
    columns = [checked_series(field, values) for field, values in given.items()]
    for field, column in zip(given, columns, strict=True):
        if column.shape != columns[0].shape:
            allowed = f"{columns[0].size} samples, as many as the reference has"
            raise FieldError(
                field,
                column.size,
                "of another length",
                allowed=allowed,
                remedy="cut or extend",
            )
    return columns


def replay_log(
    folder: Path | str,
    log: Experiment | Recording,
    *,
    compiler: str = "cc",
    allow_changed: bool = False,
) -> Replay:
    """Run the sensors of a log through the law exported to `folder` and through the
    package's, and compare.

    The motor's own path is the reference, with acceleration 0, so that the guards see a
    motor that follows. A `Recording` is for the law of a fractional PID: its input is
    the reference, its output the measurement. The law is the folder's law.json. Raises
    FieldError where its period [s] is not that of the log, or where the C of the folder
    was changed, unless `allow_changed`: it is compiled and run on this computer.
    """
    if not isinstance(log, Recording):
        checked_noun("log", log, Experiment, remedy="read_log makes one")
    place = checked_path("folder", folder)
    law_file = place / "law.json"
    if not law_file.is_file():
        raise FieldError(
            "firmware",
            str(place),
            "not an export",
            allowed="a folder of export_c",
            remedy="export the law",
        )
    law = Law.load(law_file)
    # Stamps in decimals leave a period that is off by a part in 10⁹; a millionth is no
    # other rate, and in an hour 4 ms.
    if abs(log.period - law.period) > 1e-6 * law.period:
        raise FieldError(
            "period",
            log.period,
            "not the law's",
            allowed=f"{law.period} s",
            remedy="resample the log",
        )
    # The block's name was free at the export. The header is known by the digest in its
    # first comment, which stands in no other file.
    headers = [
        file.stem
        for file in sorted(place.glob("*.h"))
        if f"law {law.digest}" in file.read_text("utf-8")
    ]
    reference, measured, torque = _sensors(law, log)
    return replay(
        place,
        law,
        reference=reference,
        reference_acceleration=np.zeros_like(reference),
        motor_angle=measured,
        torque=torque,
        name=headers[0] if headers else "law_data",
        compiler=compiler,
        allow_changed=allow_changed,
    )


def _sensors(law: Law, log: Experiment | Recording) -> tuple[Real, Real, Real]:
    """Reference, motor angle (of a PID: its measurement) and torque."""
    if isinstance(log, Recording) == law.has_gauge:
        given = "a recording" if isinstance(log, Recording) else "an arm's log"
        remedy = "the law of an arm takes an Experiment, that of a fractional PID a Recording (--input, --output)"
        raise FieldError(
            "log",
            given,
            "of another kind than the law",
            allowed="its own",
            remedy=remedy,
        )
    if isinstance(log, Recording):
        return log.input, log.output, np.zeros_like(log.output)
    # Γ = c (θm − θt): the law knows the torque alone.
    torque = log.output if log.output_kind == "torque" else law.stiffness * log.output
    # A log has no reference. With the motor's own path as one the error of the motor
    # loop is small, and the guards see a motor that follows; the two commands are
    # compared, not judged.
    return log.motor_angle, log.motor_angle, torque


def _check_block(place: Path, law: Law, name: str) -> None:
    header = place / f"{name}.h"
    if not (header.is_file() and (place / "law.c").is_file()):
        raise FieldError(
            "firmware",
            str(place),
            "not an export",
            allowed="a folder of export_c",
            remedy="export the law first",
        )
    if f"law {law.digest}" not in header.read_text(encoding="utf-8"):
        raise FieldError(
            "firmware",
            str(place),
            "the export of another law",
            allowed=f"law {law.digest[:16]}...",
            remedy="export this law, in the precision it has",
        )


def _check_unchanged(place: Path, law: Law, name: str) -> None:
    """Refuse C that this release does not export for `law`; only the title in the first
    comment is free.
    """

    def code(text: bytes) -> bytes:
        # What follows the first comment, in which a title stands; a file that begins
        # otherwise is all code.
        return text.partition(b"*/")[2] if text.startswith(b"/*") else text

    ours = {file: law_source(file) for file in ("law.h", "law.c")}
    ours[f"{name}.h"] = data_header(law, name=name, title="").encode()
    changed = [
        file
        for file, text in ours.items()
        if not (place / file).is_file()
        or code((place / file).read_bytes()) != code(text)
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
        for file in (
            "law.h",
            "law.c",
            f"{name}.h",
        ):  # alone: a math.h beside them would be taken for C's own
            if (place / file).is_file():
                shutil.copyfile(place / file, Path(scratch) / file)
        source.write_text(
            _HARNESS.replace("@DATA@", f"{name}.h").replace("@NAME@", name),
            encoding="utf-8",
        )
        if said := complaint(
            [*command, source.name, "law.c", "-o", program.name], Path(scratch)
        ):
            allowed, remedy = "C99", "export the law again"
            raise FieldError(
                "firmware",
                said,
                "refused by the compiler",
                allowed=allowed,
                remedy=remedy,
            )
        return subprocess.run(  # noqa: S603
            [program], input=log, capture_output=True, check=True
        ).stdout
