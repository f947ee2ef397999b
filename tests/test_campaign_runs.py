"""The runs of a campaign: the same from any number of threads, and in one file."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from campaigns import small
from fraclink.errors import FieldError, FileFormatError
from fraclink.trials import (
    CampaignRuns,
    Study,
    load_study,
    run_campaign,
    save_study,
    simulate_part,
)


@pytest.fixture(scope="module")
def runs() -> CampaignRuns:
    """A campaign of two parts and a half."""
    return run_campaign(small())


@pytest.mark.slow
def test_the_runs_are_those_of_the_parts_in_their_order(runs: CampaignRuns) -> None:
    parts = [simulate_part(small(), part) for part in range(3)]
    for name, column in runs.columns.items():
        assert np.array_equal(column, np.concatenate([part[name] for part in parts]))
    assert np.array_equal(runs.columns["run"], np.arange(2500))


@pytest.mark.slow
def test_two_workers_give_the_runs_of_one(runs: CampaignRuns) -> None:
    seen: list[tuple[int, int]] = []
    both = run_campaign(
        small(), workers=2, watch=lambda done, failed: seen.append((done, failed))
    )
    assert both == runs
    assert len(seen) == 3 and seen[-1] == (2500, runs.summary.failure.count)
    assert runs.summary.failure.count > 0


def test_an_interruption_drops_what_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []

    def counted(campaign: fl.trials.Campaign, part: int) -> dict[str, np.ndarray]:
        begun.append(part)
        time.sleep(0.01)
        return {"passed": np.ones(campaign.part_runs(part), dtype=bool)}

    def interrupt(done: int, failed: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("fraclink.trials._run.simulate_part", counted)
    with pytest.raises(KeyboardInterrupt):
        run_campaign(small(900_000), watch=interrupt)
    assert len(begun) < 900


@pytest.mark.parametrize("workers", [0, 2000, 1.5, True])
def test_impossible_workers_are_refused(workers: float) -> None:
    with pytest.raises(FieldError, match="workers"):
        run_campaign(small(), workers=workers)  # type: ignore[arg-type]


@pytest.mark.slow
def test_runs_come_back_from_their_file_and_edited_ones_do_not(
    runs: CampaignRuns, tmp_path: Path
) -> None:
    path = fl.save(runs, tmp_path / "campaign.npz")
    assert fl.load(path) == runs
    with np.load(path) as archive:
        members = dict(archive.items())
    (name,) = (each for each in members if each.endswith("settling_time"))
    with path.open("wb") as stream:
        np.savez(stream, **members | {name: members[name] + 1e-9})  # type: ignore[arg-type]
    with pytest.raises(FileFormatError, match="was changed"):
        fl.load(path)


@pytest.mark.slow
def test_a_study_keeps_its_arms(runs: CampaignRuns, tmp_path: Path) -> None:
    save_study(Study(rig=small().rig, arms=runs), tmp_path)
    study = load_study(tmp_path)
    assert study.arms == runs
    assert study.verdict.twin.state == "failed"
