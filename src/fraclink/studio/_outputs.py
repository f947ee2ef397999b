"""Step 7: the files for a board and the pages to be shared, written to the same places
as by the command line.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fraclink import _kernels
from fraclink._export import export_c, export_fmu
from fraclink._export.data import exact_sizes
from fraclink._export.selftest import expected
from fraclink._files import output_path
from fraclink._law import Law
from fraclink.studio._messages import Reply
from fraclink.studio._session import Session, Verb
from fraclink.view._arm_page import write_arm_page
from fraclink.view._report import write_report
from fraclink.view._words import power_on
from fracsys.checks import checked_choice

__all__ = ["OUTPUT_VERBS"]

_PRECISIONS = ("single", "double")
# Measured by benchmarks/bench_law.py on a Cortex-M4F, gcc -O2, for a law of 6 + 2 modes
# in single precision: built for this design alone, and with room for every design; and
# the cost of another mode.
_COUNTED, _OF_MODES, _A_MODE = (409, 495), 8, 8


_TARGETS = ("c", "fmu", "share", "report")


def _written(
    target: str, session: Session, law: Law, precision: Any, *, force: bool
) -> tuple[Iterable[Path], str]:
    """The files of a kind of output, and the command that writes them."""
    folder, option = session.folder, f"--precision {precision}"
    if target == "c":
        firmware = folder / "firmware"
        paths = export_c(law.in_precision(precision), firmware, force=force)
        return paths, f"fraclink export c design.json {option} --out {firmware}"
    if target == "fmu":
        fmu = folder / "arm_law.fmu"
        made = export_fmu(law, fmu, precision=precision, compilers=(), force=force)
        return [made], f"fraclink export fmu design.json --source {option} --out {fmu}"
    name, write, only = (
        ("arm.html", write_arm_page, " --arm")
        if target == "share"
        else ("report.html", write_report, "")
    )
    page = output_path(folder / name, force=force)
    return [write(session.study, page)], f"fraclink report {folder}{only} --out {page}"


def _export(session: Session, given: Mapping[str, Any]) -> Reply:
    """Write one kind of output into the folder of the study, without overwriting files
    unless allowed.
    """
    target, precision = str(given.get("target")), given.get("precision", "single")
    checked_choice("target", target, _TARGETS)
    checked_choice("precision", precision, _PRECISIONS)
    design, law = session.shippable()
    session.folder.mkdir(parents=True, exist_ok=True)
    paths, command = _written(
        target, session, law, precision, force=given.get("force") is True
    )
    names = {
        path.relative_to(session.folder).as_posix(): path.stat().st_size
        for path in paths
    }
    # Files of an earlier design stay in the folder, but do not belong to this export.
    session.written = session.written | names if session.current else names
    session.exported = design
    return Reply(
        {
            "target": target,
            "written": names,
            "export_command": command,
            **session.overview(),
        }
    )


def _board(session: Session, given: Mapping[str, Any]) -> Reply:
    """The needs of the law on a board: memory, instructions, the hash of the self-test;
    and the first power-on.
    """
    precision, design, law = (
        given.get("precision", "single"),
        session.study.design,
        session.study.law,
    )
    if design is None or law is None or precision not in _PRECISIONS:
        return Reply({"board": [], "power_on": []})
    law = law.in_precision(precision)
    flash, state = exact_sizes(law)
    room = _kernels.law_sizes(precision == "single")
    modes = law.order + len(law.feedforward.poles)
    counts = [f"about {count + _A_MODE * (modes - _OF_MODES)}" for count in _COUNTED]
    rows = [
        ["memory of each arm (RAM)", f"{state} bytes", f"{room[1]} bytes"],
        ["coefficients (flash)", f"{flash} bytes", f"{room[0]} bytes"],
        [f"instructions a period, Cortex-M4F, {modes} modes",
         *(counts if precision == "single" else ["not counted: its FPU is single precision"] * 2)],
        ["last line of the self-test", *[f"hash {expected(law):08X}"] * 2],
    ]  # fmt: skip
    return Reply({"board": rows, "power_on": power_on(design)})


OUTPUT_VERBS: dict[str, Verb] = {
    "export": _export,
    "board": _board,
}
