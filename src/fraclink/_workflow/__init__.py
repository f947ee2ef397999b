"""The whole way from a log to a verdict, and the folder that keeps it."""

from fraclink._workflow.run import (
    designed,
    examined,
    identified,
    moved,
    proved,
    run,
    simulate_move,
    subject,
    tried,
)
from fraclink._workflow.start import START_FILES, Start, start
from fraclink._workflow.study import Refusal, Study, load_study, save_study

__all__ = ["START_FILES", "Refusal", "Start", "Study", "designed", "examined", "identified", "load_study"]
__all__ += ["moved", "proved", "run", "save_study", "simulate_move", "start", "subject", "tried"]
