"""`fraclink doctor`: what of this installation is there."""

from __future__ import annotations

import platform
import shutil
from importlib.metadata import PackageNotFoundError, version

from fraclink import __version__, _kernels
from fraclink._cli.app import group
from fraclink._cli.command import Answer, command
from fraclink._display import Overview, Row, Table

app = group()

# Distribution, the extra that installs it, and its purpose.
_EXTRAS = (
    ("matplotlib", "report", "figures and reports"),
    ("jinja2", "report", "reports"),
    ("control", "control", "exchange with python-control"),
    ("python-flint", "certify", "proofs"),
    ("h5py", "io", "logs in HDF5 and MATLAB 7.3"),
    ("npTDMS", "io", "logs of LabVIEW"),
    ("rosbags", "io", "logs of ROS"),
    ("starlette", "studio", "the studio"),
)


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _part(name: str, version: str | None, instead: str, use: str) -> tuple[Row, ...]:
    return (
        Row("", "part", name),
        Row("", "version", version or instead),
        Row("", "for", use),
        Row("", "state", "passed" if version else "missing"),
    )


@command(app)
def doctor() -> Answer:
    """Check this installation: kernels, optional packages, C compiler, real-time loop.

    $ fraclink doctor
    """
    extras = {name: _installed(name) for name, _, _ in _EXTRAS}
    # Only `cc`, the compiler that the FMU calls; another one would not help them.
    compiler = shutil.which("cc")
    rows = [
        _part("Python", platform.python_version(), "", ""),
        _part("numpy", _installed("numpy"), "", ""),
        # By distribution instead of import: importing all of them would take seconds,
        # and a broken package would end the check that is meant to find it.
        *(
            _part(name, extras[name], f"pip install 'fraclink[{extra}]'", use)
            for name, extra, use in _EXTRAS
        ),
        _part("C compiler", compiler, "none found", "FMU"),
        _part(
            "real-time loop",
            "here" if _kernels.REALTIME else None,
            "Linux only",
            "run-realtime",
        ),
    ]
    missing = [name.value for name, *_, state in rows if state.value == "missing"]
    headline = f"fraclink {__version__} on {platform.system()} {platform.machine()}"
    headline += f"; without {', '.join(missing)}" if missing else ""
    table = Table.of("", rows)
    python = platform.python_version()
    values = {
        "version": __version__,
        "python": python,
        "extras": extras,
        "compiler": compiler,
    }
    return Answer(
        Overview(headline, "passed", tables=(table,)),
        values=values,
        following="fraclink run --rig paper-2023-geared --log demo --out results",
    )
