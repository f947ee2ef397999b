"""Tables that compare several results, for pages."""

from __future__ import annotations

from collections.abc import Iterable

from fraclink._design import Design
from fraclink._design.assess import PhaseShare
from fraclink._display import Row, Table, quantity, rows_of

__all__ = ["budget_table", "margins_table"]


def budget_table(shares: Iterable[PhaseShare], payload: float) -> Table:
    """Phase of each element of the loop at the crossover with a payload [kg]."""
    heading = f"phase at {quantity(payload, 'g')}"
    return Table.of(
        "",
        (
            (Row("", heading, share.element), Row("", "share", share.phase, "rad"))
            for share in shares
        ),
    )


def margins_table(design: Design, payloads: Iterable[float]) -> Table:
    """Margins at some payloads: of the continuous loop of the design, then of the
    sampled one.
    """
    return Table.of("margins", (_margins(design, payload) for payload in payloads))


def _margins(design: Design, payload: float) -> tuple[Row, ...]:
    ideal = design.at(payload)
    sampled = design.sampled_at(payload) if design.has_law else None
    figures = (
        ("gain_crossover", "sampled crossover", "rad/s"),
        ("phase_margin", "sampled phase margin", "rad"),
        ("gain_margin", "gain margin", ""),
        ("sensitivity_peak", "Ms", ""),
    )
    return rows_of(
        ideal,
        Row("payload", "payload", payload, "g"),
        ("gain_crossover", "crossover", "rad/s"),
        ("phase_margin", "phase margin", "rad"),
        *(
            Row(f"sampled.{name}", label, sampled and getattr(sampled, name), unit)
            for name, label, unit in figures
        ),
        Row(
            "sampled.modulus_margin",
            "distance to −1",
            sampled and sampled.modulus_margin,
            digits=3,
        ),
    )
