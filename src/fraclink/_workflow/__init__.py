"""The whole way from a log to a verdict, and the folder that keeps it."""

from fraclink._workflow.run import (
    design_for,
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
from fraclink._workflow.study import Refusal, Scope, Study, Verdict, load_study, save_study

__all__ = ["START_FILES", "Refusal", "Scope", "Start", "Study", "Verdict", "design_for", "designed"]
__all__ += ["examined", "identified", "load_study", "moved", "proved", "run", "save_study", "simulate_move"]
__all__ += ["start", "subject", "tried"]
