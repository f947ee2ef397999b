"""The design map on the twin: each request is designed, and its law is judged by a move of the twin."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fraclink._arm.rig import Rig
from fraclink._files import read_json, write_json
from fraclink._validate import checked_between, checked_noun, checked_series, checked_whole
from fraclink.errors import FieldError, InfeasibleError, SizeError

if TYPE_CHECKING:
    from fraclink._arm.link import LinkModel
    from fraclink._law import Law

    # rig, gain crossover, phase margin, payloads, link mass: plain values that reach any process
    Task = tuple[Rig, float, float, tuple[float, ...], float | None]

__all__ = ["Cell", "Sweep", "load_sweep", "save_sweep", "sweep"]

KIND, FORMAT = "sweep", 1
LARGEST = 20_000  # cells; 0.2 s each, an hour on one core
MOVE, MOVE_TIME = 1.0, 0.6  # [rad], [s]: the move of the paper's figures


@dataclass(frozen=True)
class Cell:
    """One request on one payload: what the twin made of it, or the condition that made it infeasible.

    Times in s, angles in rad; infinite or NaN where there is no such number.
    """

    gain_crossover: float
    phase_margin: float
    payload: float
    passed: bool
    settling_time: float
    overshoot: float
    residual_vibration: float
    reason: str
    infeasible: str = ""


@dataclass(frozen=True)
class Sweep:
    """All cells, in the order crossover, margin, payload; and the rig and link they are for."""

    rig: str
    link_mass: float
    gain_crossovers: tuple[float, ...]
    phase_margins: tuple[float, ...]
    payloads: tuple[float, ...]
    cells: tuple[Cell, ...]

    def at(self, gain_crossover: float, phase_margin: float, payload: float) -> Cell:
        """Return the cell of one request and payload, each one of the sweep's own values."""
        axes = (self.gain_crossovers, self.phase_margins, self.payloads)
        place = 0
        for axis, value in zip(axes, (gain_crossover, phase_margin, payload), strict=True):
            place = place * len(axis) + axis.index(value)
        return self.cells[place]

    @property
    def passed(self) -> bool:
        """Whether every feasible cell holds on the twin, and there is one."""
        feasible = [cell for cell in self.cells if not cell.infeasible]
        return bool(feasible) and all(cell.passed for cell in feasible)


def sweep(
    rig: Rig,
    *,
    gain_crossovers: Sequence[float],
    phase_margins: Sequence[float],
    payloads: Sequence[float] | None = None,
    link_mass: float | None = None,
    workers: int = 1,
    watch: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Design each (gain crossover, phase margin) for the rig's payload range and run its law on the twin.

    Parameters
    ----------
    rig
        with a model; the design is for its payload range.
    gain_crossovers, phase_margins
        [rad/s] and [rad], each > 0.
    payloads
        of the twin [kg]; default: the ends of the rig's range and its nominal one.
    link_mass
        of the twin [kg], as `Twin.from_rig` takes it.
    workers
        processes, 1 … 1024; the result does not depend on it.
    watch
        called after every request with the number done and wanted.

    Raises
    ------
    FieldError
        an axis is empty or has a value that is not positive; SizeError for more than 20 000 cells.

    >>> import fraclink as fl
    >>> from fraclink._simulate.twin import geared
    >>> rig = geared(fl.Rig.named("paper-2023"))
    >>> map_ = sweep(rig, gain_crossovers=[12.0], phase_margins=[fl.deg(50)], payloads=[0.03])
    >>> map_.cells[0].passed, map_.cells[0].infeasible
    (True, '')
    """
    _model(checked_noun("rig", rig, Rig, remedy="Rig.named or Rig.load make one"))
    if link_mass is not None:
        link_mass = checked_between("link_mass", link_mass, 0.0, 1e4, "kg")
    masses = (
        sorted({rig.payloads.low, rig.payloads.nominal, rig.payloads.high}) if payloads is None else payloads
    )
    axes = (
        _axis("gain_crossovers", gain_crossovers),
        _axis("phase_margins", phase_margins),
        _axis("payloads", masses),
    )
    if math.prod(map(len, axes)) > LARGEST:
        raise SizeError(
            "cells", math.prod(map(len, axes)), "too many", allowed=f"<= {LARGEST}", remedy="ask less"
        )
    checked_whole("workers", workers, 1, 1024)
    tasks = [(rig, crossover, margin, axes[2], link_mass) for crossover in axes[0] for margin in axes[1]]
    cells: list[Cell] = []
    for done, row in enumerate(_rows(tasks, workers), start=1):
        cells.extend(row)
        if watch is not None:
            watch(done, len(tasks))
    return Sweep(rig.name, link_mass or rig.link.mass, *axes, tuple(cells))


def _model(rig: Rig) -> LinkModel:
    if rig.model is None:
        raise FieldError(
            "model",
            None,
            "missing",
            allowed="a rig with a model",
            remedy="identify one and put it in the rig",
        )
    return rig.model


def _axis(name: str, values: Sequence[float]) -> tuple[float, ...]:
    axis = tuple(map(float, checked_series(name, values, remedy="give a list of numbers")))
    if not axis or not all(math.isfinite(v) and v > 0.0 for v in axis) or len(set(axis)) != len(axis):
        raise FieldError(
            name, list(axis), "not usable", allowed="different numbers > 0", remedy="give at least one value"
        )
    return axis


def _rows(tasks: list[Task], workers: int) -> Iterator[list[Cell]]:
    """Cells of each request, in the order of the requests."""
    if workers == 1:
        yield from map(_request, tasks)
        return
    from fraclink._campaign.workers import process_pool

    with process_pool(workers) as pool:
        yield from pool.map(_request, tasks)


def _request(task: Task) -> list[Cell]:
    from fraclink._design import design

    rig, crossover, margin, payloads, _ = task
    try:
        result = design(_model(rig), rig, gain_crossover=crossover, phase_margin=margin)
    except InfeasibleError as error:
        nan = math.nan
        return [
            Cell(crossover, margin, m, False, nan, nan, nan, error.explanation, error.condition)
            for m in payloads
        ]
    law = result.controller.discretize(rig.period)
    return [_on_twin(task, law, payload) for payload in payloads]


def _on_twin(task: Task, law: Law, payload: float) -> Cell:
    from fraclink._arm.reference import smooth_step
    from fraclink._simulate.twin import Twin, run_twin

    rig, crossover, margin, _, link_mass = task
    twin = Twin.from_rig(rig, payload=payload, link_mass=link_mass)
    run = run_twin(twin, law, smooth_step(MOVE, MOVE_TIME))
    m = run.metrics
    return Cell(
        crossover,
        margin,
        payload,
        run.verdict.passed,
        m.settling_time,
        m.overshoot,
        m.residual_vibration,
        run.verdict.reason,
    )


def save_sweep(found: Sweep, path: Path | str) -> None:
    """Write a sweep to one JSON file, complete or not at all."""
    cells = [
        {k: v if not isinstance(v, float) or math.isfinite(v) else str(v) for k, v in asdict(cell).items()}
        for cell in found.cells
    ]
    axes = {name: list(getattr(found, name)) for name in ("gain_crossovers", "phase_margins", "payloads")}
    about = {"rig": found.rig, "link_mass": found.link_mass}
    write_json(path, KIND, FORMAT, about | axes | {"cells": cells})


def load_sweep(path: Path | str) -> Sweep:
    """Read back what `save_sweep` wrote; FileFormatError for anything else."""
    from fraclink.errors import FileFormatError

    data = read_json(Path(path), KIND, (FORMAT,))
    numbers = ("settling_time", "overshoot", "residual_vibration")
    try:
        cells = tuple(Cell(**cell | {n: float(cell[n]) for n in numbers}) for cell in data["cells"])
        first, second, third = (
            tuple(map(float, data[n])) for n in ("gain_crossovers", "phase_margins", "payloads")
        )
        axes = (first, second, third)
        if len(cells) != math.prod(map(len, axes)):
            raise ValueError("cells are missing")
        return Sweep(str(data["rig"]), float(data["link_mass"]), *axes, cells)
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            "sweep", str(error), "missing or unknown", allowed="a sweep's file", remedy="make it again"
        ) from error
