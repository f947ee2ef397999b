"""The summary of a campaign: intervals against exact values, ranks against scipy, and
the command line.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import fraclink as fl
from campaigns import small
from fraclink import main
from fraclink.trials import CampaignRuns, run_campaign
from fraclink.trials._summary import _quantile


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return fl.save(
        run_campaign(small()), tmp_path_factory.mktemp("campaign") / "campaign.npz"
    )


@pytest.mark.parametrize(
    ("n", "p"),
    [(1000, 0.5), (1000, 0.95), (200, 0.05), (2500, 0.99), (50, 0.99), (20, 0.05)],
)
def test_quantile_intervals_cover_and_are_the_narrowest_that_do(n, p):
    """P(x_(l) <= q_p <= x_(u)) is a binomial probability for any distribution."""
    from scipy.stats import binom

    found = _quantile(
        np.arange(1.0, n + 1.0), p
    )  # order statistic number i has the value i
    assert found.value == math.ceil(p * n)
    low = 0 if math.isinf(found.low) else int(found.low)
    high = n + 1 if math.isinf(found.high) else int(found.high)
    below, above = (
        binom.cdf(low - 1, n, p),
        binom.sf(high - 1, n, p),
    )  # q_p < x_(l); q_p > x_(u)
    assert below <= 0.025 and above <= 0.025
    assert binom.cdf(low, n, p) > 0.025 or low == n
    assert high == 1 or binom.sf(high - 2, n, p) > 0.025


@pytest.mark.slow
def test_a_summary_is_that_of_all_runs(file):
    from scipy.stats import spearmanr

    runs = CampaignRuns.load(file)
    column, found = runs.columns, runs.summary
    assert found.failure.runs == 2500 and found.failure.count == int(
        (column["passed"] == 0).sum()
    )
    assert list(found.failed) == column["run"][column["passed"] == 0][:100].tolist()
    by_name = {metric.name: metric for metric in found.metrics}
    assert set(by_name) < set(column)
    metric = by_name["peak_tip_error"]
    for name, value in metric.drivers:
        drawn = column[name]
        wanted = (
            spearmanr(drawn, column["peak_tip_error"]).statistic
            if np.ptp(drawn)
            else 0.0
        )
        assert value == pytest.approx(wanted, abs=1e-12), name
    assert {name for name, _ in metric.drivers} == set(vars(small().draws))
    worst = int(np.argmax(column["peak_tip_error"]))
    assert metric.worst[0] == (worst, float(column["peak_tip_error"][worst]))
    left = column["mode"] != 1  # not in normal operation
    assert sum(count for _, _, count in found.trips) == int(left.sum())
    for mode, reason, count in found.trips:
        assert count == int(
            ((column["mode"] == mode) & (column["reason"] == reason)).sum()
        )


@pytest.mark.slow
def test_the_command_runs_and_replays(tmp_path, capsys):
    rig, file = fl.Rig.named("paper-2023"), tmp_path / "campaign.npz"
    fl.design(rig.model, rig, filter_time=0.0).save(tmp_path / "d.json")
    line = ["campaign", "montecarlo", "--design", str(tmp_path / "d.json")]
    line += ["--runs", "300", "--out", str(file)]
    assert main(line) == 1  # some runs fail
    printed = capsys.readouterr()
    assert "of 300 runs failed" in printed.out and "fraclink replay" in printed.err
    assert main([*line, "--force", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["runs"] == 300 and "overshoot" in told["metrics"]
    number, value = told["metrics"]["overshoot"]["worst"][0]
    out = tmp_path / "run.npz"
    line = [
        "replay",
        str(file),
        "--run",
        str(number),
        "--out",
        str(out),
        "--json",
    ]
    assert main(line) in (0, 1)
    again = json.loads(capsys.readouterr().out)
    assert (
        again["metrics"]["overshoot"] == pytest.approx(value, rel=1e-9) and out.exists()
    )
    assert main(line) == 2  # existing files are never overwritten
    holding = next(n for n in range(300) if n not in told["failed"])
    assert (
        main(
            [
                "replay",
                str(file),
                "--run",
                str(holding),
                "--out",
                str(out),
                "--force",
            ]
        )
        == 0
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "value", "field"),
    [
        ("--runs", "0", "runs"),
        ("--seed", "-3", "seed"),
        ("--workers", "0", "workers"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, capsys, option, value, field):
    out = tmp_path / "campaign.npz"
    rig = fl.Rig.named("paper-2023")
    fl.design(rig.model, rig, filter_time=0.0, law=False).save(tmp_path / "d.json")
    line = ["campaign", "montecarlo", "--design", str(tmp_path / "d.json")]
    assert main([*line, "--out", str(out), option, value]) == 2
    text = capsys.readouterr().err
    assert field in text and len(text.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.slow
def test_a_run_that_is_not_there_is_bad_input(file, tmp_path, capsys):
    line = [
        "replay",
        str(file),
        "--run",
        "2500",
        "--out",
        str(tmp_path / "x.npz"),
    ]
    assert main(line) == 2 and "0 … 2499" in capsys.readouterr().err
