"""The verb `campaign` and the verbs below it."""

from __future__ import annotations

import typer

from fraclink._cli import faults, montecarlo
from fraclink._cli.listing import Listing

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add `campaign` with its verbs to the application."""
    campaign = typer.Typer(cls=Listing, help="Many runs: Monte Carlo, faults.")
    montecarlo.register(campaign)
    faults.register(campaign)
    app.add_typer(campaign, name="campaign")
