"""Run a campaign in threads of this machine."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Annotated

import numpy as np

from fraclink.trials._arms import simulate_part
from fraclink.trials._campaign import Campaign
from fraclink.trials._summary import CampaignRuns
from fracsys.checks import Between, checked

__all__ = ["run_campaign"]


@checked
def run_campaign(
    campaign: Campaign,
    *,
    workers: Annotated[int, Between(1, 1024)] = 1,
    watch: Callable[[int, int], None] = lambda done, failed: None,
) -> CampaignRuns:
    """Simulate every run of a campaign and return what was measured.

    Parameters
    ----------
    campaign
        what to run.
    workers
        threads. The result does not depend on their number.
    watch
        called after every thousand runs with how many are done, and how many of them
        failed.
    """
    done = failed = 0
    pool = ThreadPoolExecutor(workers)
    try:
        tasks = [
            pool.submit(simulate_part, campaign, part) for part in range(campaign.parts)
        ]
        for task in as_completed(tasks):
            passed = task.result()["passed"]
            done += passed.size
            failed += passed.size - int(np.count_nonzero(passed))
            watch(done, failed)
    finally:
        # Waiting parts are dropped: an interruption only waits for those in progress.
        pool.shutdown(cancel_futures=True)
    parts = [task.result() for task in tasks]
    columns = {
        name: np.concatenate([part[name] for part in parts], dtype=np.float64)
        for name in parts[0]
    }
    return CampaignRuns(campaign, columns)
