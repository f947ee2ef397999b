"""The interactive arm for the pages that link to it: `_static/arm.html`, written by the
current version of the package.

It is generated in every build, so that no page shows the law of another version.
"""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx

import fraclink as fl


def write(app: Sphinx, error: Exception | None) -> None:
    """Write the page where the pages that name it were built."""
    if (
        error is not None
        or app.builder.format != "html"
        or "how-to/share-an-arm" not in app.env.found_docs
    ):
        return
    rig = fl.Rig.named("paper-2023-geared")
    design = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    study = fl.trials.Study(rig=rig, design=design)
    fl.view.write_arm_page(study, Path(app.outdir) / "_static" / "arm.html")


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True}
