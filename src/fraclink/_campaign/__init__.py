"""Many runs and what they say together: rivals, arms that differ, faults, and the study
of one log.

A campaign is one law on a million arms, resumable, the same for a seed on any machine.
"""

from __future__ import annotations

from fraclink._campaign.arms import arm_of, replay_run, simulate_part
from fraclink._campaign.campaign import (
    Campaign,
    Distribution,
    Draws,
    draws_for,
    load_campaign,
    save_campaign,
)
from fraclink._campaign.run import Progress, read_part, run_campaign
from fraclink._campaign.summary import (
    MetricSummary,
    Quantile,
    Summary,
    columns,
    summarise,
)

__all__ = [
    "Campaign",
    "Distribution",
    "Draws",
    "MetricSummary",
    "Progress",
    "Quantile",
    "Summary",
    "arm_of",
    "columns",
    "draws_for",
    "load_campaign",
    "read_part",
    "replay_run",
    "run_campaign",
    "save_campaign",
    "simulate_part",
    "summarise",
]
