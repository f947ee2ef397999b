"""A study as a folder of files, one for each noun, and back."""

from __future__ import annotations

from pathlib import Path

from fraclink.study.nouns import Study

__all__ = ["load_study", "save_study"]


def save_study(study: Study, folder: Path | str) -> None:
    """Write every part to its file."""


def load_study(folder: Path | str) -> Study:
    """Read a folder that `fraclink run` or the single stages wrote."""
    return Study()
