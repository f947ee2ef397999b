"""Forty-four ways to break an arm, injected into the shipped law on the twin, each with a verdict."""

from __future__ import annotations

from fraclink._campaign.faults.campaign import cases, observe, run_case, run_faults
from fraclink._campaign.faults.catalogue import CATALOGUE, fault_named
from fraclink._campaign.faults.nouns import PHASES, Case, Check, Fault, Outcome
from fraclink._campaign.faults.soak import Soak, soak
from fraclink._campaign.faults.table import FaultTable, Row
from fraclink._campaign.faults.trial import Bench

__all__ = [
    "CATALOGUE",
    "PHASES",
    "Bench",
    "Case",
    "Check",
    "Fault",
    "FaultTable",
    "Outcome",
    "Row",
    "Soak",
    "cases",
    "fault_named",
    "observe",
    "run_case",
    "run_faults",
    "soak",
]
