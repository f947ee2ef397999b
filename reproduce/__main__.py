"""Recompute the paper: `python -m reproduce [--out FOLDER]` writes RESULTS.md and
figures/.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from fraclink._files import write_text
from reproduce import figures
from reproduce.drawings import loop_drawings
from reproduce.figures_tracking import tracking_pictures
from reproduce.published import read_published
from reproduce.results import results_text
from reproduce.values import computed

HERE = Path(__file__).parent


def reproduce(published: Path, out: Path) -> Path:
    """Recompute the paper from `published`/*.toml; write RESULTS.md and figures/ to
    `out`, return the former.

    A second run writes the same bytes. Raises FileFormatError where the files of
    `published` are missing or wrong.
    """
    paper = read_published(published)
    values = computed(paper)
    drawn = (
        *figures.identification_pictures(),
        *loop_drawings(),
        figures.nyquist_picture(),
        *figures.margin_pictures(),
        *tracking_pictures(),
    )
    for picture in drawn:
        write_text(out / "figures" / picture.name, picture.drawing + "\n")
    write_text(out / "RESULTS.md", results_text(paper, values, drawn))
    return out / "RESULTS.md"


def main(arguments: list[str] | None = None) -> int:
    """Run from the command line; the data are those beside this file."""
    parser = argparse.ArgumentParser(prog="python -m reproduce", description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=HERE, help="folder for RESULTS.md and figures/"
    )
    sys.stdout.write(f"{reproduce(HERE, parser.parse_args(arguments).out)}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
