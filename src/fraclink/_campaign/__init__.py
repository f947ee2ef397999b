"""Monte Carlo campaigns: one law on a million arms, resumable, the same for a seed whoever computes it."""

from __future__ import annotations

from fraclink._campaign.campaign import Campaign, load_campaign, save_campaign
from fraclink._campaign.conduct import Progress, conduct
from fraclink._campaign.draws import Distribution, Draws, draws_for
from fraclink._campaign.part import read_part, simulate_part
from fraclink._campaign.replay import arm_of, replay
from fraclink._campaign.summary import MetricSummary, Quantile, Summary, columns, summarise
from fraclink._campaign.sweep import Cell, Sweep, load_sweep, save_sweep, sweep

__all__ = [
    "Campaign",
    "Cell",
    "Distribution",
    "Draws",
    "MetricSummary",
    "Progress",
    "Quantile",
    "Summary",
    "Sweep",
    "arm_of",
    "columns",
    "conduct",
    "draws_for",
    "load_campaign",
    "load_sweep",
    "read_part",
    "replay",
    "save_campaign",
    "save_sweep",
    "simulate_part",
    "summarise",
    "sweep",
]
