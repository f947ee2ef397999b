"""The page that travels in an FMU (documentation/index.html): how to connect it and what its numbers mean."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape

from fraclink._export.fmu_model import VARIABLES, FmuModel
from fraclink._export.sources import law_source
from fraclink._law import MODES, REASONS, Law

__all__ = ["documentation"]

_STYLE = (
    "body { font: 16px/1.5 system-ui, sans-serif; max-width: 50rem; margin: 2rem auto; padding: 0 1rem; } "
    "th { text-align: left; } th, td { padding: .1rem .9rem .1rem 0; vertical-align: baseline; }"
)
_FLAG = re.compile(r"#define LAW_FLAG_(\w+) (\d+)U +/\* (.+?) \*/")


def documentation(model: FmuModel, law: Law) -> str:
    """Return the page as HTML, complete in itself."""
    flags = _FLAG.findall(law_source("law.h").decode())
    servo = (
        f"The law closes the motor loop: connect <code>voltage</code>, within ±{law.drive.voltage_limit:g} V."
        if law.drive is not None
        else "The robot has a motor loop: connect <code>motor_reference</code>, not <code>voltage</code>."
    )
    variables = [(v.name, v.causality, v.unit or "–", v.description) for v in VARIABLES]
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{escape(model.name)}</title>
<style>{_STYLE}</style></head><body>
<h1>{escape(model.name)}</h1>
<p>{escape(model.description)}; {law.precision} precision.</p>
<h2>Connect it</h2>
<ul>
<li>The communication step is {model.period!r} s, constant. Another step is an error.</li>
<li>Outputs answer the inputs at the beginning of a step: the importer sees them one period later, which is
the delay that the design counts on. No output depends on an input at the same instant.</li>
<li>Before the first step the arm is taken to rest at <code>motor_angle</code>.</li>
<li>{servo}</li>
</ul>
{_table(("variable", "", "unit", ""), variables)}
<h2>mode</h2>
{_table(("value", "name"), enumerate(MODES))}
<h2>reason</h2>
{_table(("value", "what"), enumerate(REASONS))}
<h2>flags</h2>
<p>Bits of the last period; they add up.</p>
{_table(("bit", "name", "what"), ((bit, name, what) for name, bit, what in flags))}
</body></html>
"""


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = ["<table>", "<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows]
    return "\n".join([*lines, "</table>"])
