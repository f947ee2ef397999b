"""The whole way in one call: log → model → controller → simulated moves, with what was assumed."""

from fraclink._workflow.folder import load_study, save_study
from fraclink._workflow.nouns import Move, Study
from fraclink._workflow.request import Request, design_for
from fraclink._workflow.way import conduct, simulate_move

__all__ = ["Move", "Request", "Study", "conduct", "design_for", "load_study", "save_study", "simulate_move"]
