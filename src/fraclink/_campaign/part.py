"""One part of a campaign: draw, simulate, measure, write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fraclink import _kernels
from fraclink._arm.reference import sampled, smooth_step
from fraclink._campaign.campaign import PART_RUNS, SHAPES, Campaign
from fraclink._campaign.draws import draw
from fraclink._campaign.links import batch_links
from fraclink._campaign.metrics import Signals, measure_many
from fraclink._files import RENAMED, atomic_write
from fraclink._validate import checked_noun, checked_whole
from fraclink.errors import MissingExtraError

if TYPE_CHECKING:
    from fraclink._arm.rig import Rig
    from fraclink._campaign.links import BatchLinks

__all__ = ["part_path", "read_part", "simulate_part", "write_part"]

Real = NDArray[np.float64]

BLOCK = 50  # runs simulated before they are measured: 50 × 1000 periods × 6 signals stay in the cache
SUBSTEPS = 10  # friction steps in a period, as in `simulate`


def simulate_part(campaign: Campaign, part: int) -> dict[str, NDArray[np.generic]]:
    """Return parameters and metrics of every run of a part, by column name; shape (runs of the part,)."""
    checked_noun("campaign", campaign, Campaign, remedy="Campaign.of makes one, load_campaign reads one")
    runs = campaign.part_runs(checked_whole("part", part, 0, campaign.parts - 1))
    values = draw(campaign.draws, campaign.seed, part, runs)
    path = unit_paths(campaign)
    columns = [_simulate_block(campaign, values, path, part, at) for at in range(0, runs, BLOCK)]
    measured = {name: np.concatenate([c[name] for c in columns]) for name in columns[0]}
    number = np.arange(part * PART_RUNS, part * PART_RUNS + runs, dtype=np.int64)
    values["shape"] = values["shape"] % len(SHAPES)
    return {"run": number} | {k: np.asarray(v) for k, v in values.items()} | measured


def unit_paths(campaign: Campaign) -> Real:
    """Return angle and acceleration of a move of 1 rad in each duration, (shapes, 2, N)."""
    count = round(campaign.duration / campaign.law.period) + 1
    rows = [sampled(smooth_step(1.0, d), campaign.law.period, count)[[0, 2]] for d in SHAPES]
    return np.ascontiguousarray(np.stack(rows))


@dataclass(frozen=True)
class Block:
    """Runs that are simulated in one call: what the kernel takes of each. `stiff` is ω₀² of each link."""

    links: BatchLinks
    stiff: Real
    numbers: Real
    seeds: NDArray[np.uint64]
    chosen: NDArray[np.int32]


def block_of(campaign: Campaign, values: dict[str, Real], part: int, at: int) -> Block:
    """Return the block of runs `at` … of a part; `values` are all that the part drew."""
    own = {name: v[at : at + BLOCK] for name, v in values.items()}
    stiff = own["stiffness"] / (own["payload"] * campaign.rig.link.length**2)
    return Block(
        batch_links(stiff, own["order"], campaign.law.period),
        stiff,
        _numbers(campaign.rig, own),
        _seeds(campaign.seed, part, at, len(stiff)),
        (own["shape"] % len(SHAPES)).astype(np.int32),
    )


def _simulate_block(
    campaign: Campaign, values: dict[str, Real], path: Real, part: int, at: int
) -> dict[str, NDArray[np.generic]]:
    block = block_of(campaign, values, part, at)
    links, runs, length = block.links, len(block.stiff), path.shape[2]
    signals = np.empty((3, runs, length))
    marks = np.empty((3, runs, length), dtype=np.uint32)
    _kernels.batch_run(
        campaign.law.block,
        campaign.law.precision == "single",
        shared_rig(campaign),
        links.decay,
        links.weight,
        np.ascontiguousarray(links.pair.real),
        np.ascontiguousarray(links.pair.imag),
        np.ascontiguousarray(links.pair_weight.real),
        np.ascontiguousarray(links.pair_weight.imag),
        links.first,
        block.numbers,
        block.seeds,
        block.chosen,
        path,
        signals,
        marks,
    )
    pole = block.stiff ** (1.0 / values["order"][at : at + runs])
    pole = pole * np.sin(np.pi / values["order"][at : at + runs])
    return measure_many(
        Signals(*signals, *marks),
        block.numbers[:, -1:] * path[block.chosen, 0],
        period=campaign.law.period,
        ended=np.asarray(SHAPES)[block.chosen],
        vibration_period=2.0 * np.pi / pole,
    )


def _numbers(rig: Rig, values: dict[str, Real]) -> Real:
    """The columns of batch.h, in its order."""
    motor = rig.motor
    friction = motor.coulomb_torque / (motor.inertia * motor.gear_ratio)
    columns = (
        values["stiffness"],
        motor.gain * values["motor_gain"],
        motor.decay * values["viscous_friction"],
        friction * values["coulomb_torque"],
        values["gauge_offset"],
        rig.gauge.noise * values["noise"],
        values["delay_samples"],
        values["amplitude"],
    )
    return np.ascontiguousarray(np.stack(columns, axis=1))


def _seeds(seed: int, part: int, at: int, runs: int) -> NDArray[np.uint64]:
    """Noise seeds: the run's number folded into the campaign's seed by an odd multiplier (a bijection)."""
    number = part * PART_RUNS + at + np.arange(runs, dtype=np.uint64)
    with np.errstate(over="ignore"):
        return np.asarray(number * np.uint64(0x9E3779B97F4A7C15) + np.uint64(seed), dtype=np.uint64)


def shared_rig(campaign: Campaign, *, numbers: Real | None = None, seed: int = 0) -> _kernels.LoopRig:
    """Return what all runs of a campaign share, and with a run's `numbers` (columns of batch.h) all of it."""
    rig = campaign.rig
    own = np.zeros(8) if numbers is None else numbers
    return _kernels.LoopRig(
        sampled=campaign.inner == "sampled",
        substeps=SUBSTEPS,
        delay=int(own[6]),
        period=campaign.law.period,
        pole=campaign.law.inner_pole,
        gain=float(own[1]),
        decay=float(own[2]),
        friction=float(own[3]),
        coupling=0.0,
        encoder=rig.encoder.resolution,
        offset=float(own[4]),
        noise=float(own[5]),
        limit=rig.gauge.limit,
        quantum=rig.gauge.quantum,
        start=0.0,
        seed=seed,
    )


def part_path(folder: Path, part: int) -> Path:
    """Return the file of a part; its number has seven digits, so that names sort as numbers do."""
    return folder / f"part-{part:07d}.parquet"


def write_part(campaign: Campaign, folder: Path, part: int) -> int:
    """Simulate a part and write its file in one step; return its number of runs."""
    pa, parquet = _parquet()
    place = part_path(folder, part)
    # A kill leaves the half of the file that it cut off: its part is missing, and is computed here again.
    for left in folder.glob(f".{place.name}.*.tmp"):
        left.unlink(missing_ok=True)
    columns = simulate_part(campaign, part)
    table = pa.table(columns).replace_schema_metadata(
        {
            "fraclink": "campaign part",
            "fingerprint": campaign.fingerprint,
            "part": str(part),
            # the file's footer has no checksum: a flipped bit in a column's name shows against this list
            "columns": ",".join(columns),
        }
    )
    with atomic_write(place, "wb") as stream:
        # No statistics and no time: two computations of one part give the same bytes.
        # Checksums: zstd alone unpacks a flipped bit into other numbers without a word.
        parquet.write_table(
            table, stream, compression="zstd", write_statistics=False, write_page_checksum=True
        )
    return int(table.num_rows)


def read_part(
    campaign: Campaign, folder: Path, part: int, *, names: tuple[str, ...] = ()
) -> dict[str, NDArray[np.generic]] | None:
    """Return columns `names` of a finished part (all where none is named); None where the file is missing,
    damaged or of another campaign.
    """
    pa, parquet = _parquet()
    try:
        with parquet.ParquetFile(
            part_path(folder, part), memory_map=False, page_checksum_verification=True
        ) as file:
            schema, rows = file.schema_arrow, file.metadata.num_rows
            own = {RENAMED.get(name, name): name for name in schema.names}
            table = file.read(columns=[own.get(name, name) for name in names] or None)
    except (OSError, ValueError, pa.ArrowException):  # ValueError: a name that is not UTF-8 any more
        return None
    meta = schema.metadata or {}
    wanted = {
        b"fingerprint": campaign.fingerprint.encode(),
        b"part": str(part).encode(),
        b"columns": ",".join(schema.names).encode(),
    }
    if any(meta.get(k) != v for k, v in wanted.items()) or rows != campaign.part_runs(part):
        return None
    return {RENAMED.get(name, name): table[name].to_numpy() for name in table.column_names}


def _parquet() -> tuple[Any, Any]:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise MissingExtraError("pyarrow", "io") from error
    return pa, parquet
