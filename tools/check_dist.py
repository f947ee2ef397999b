"""Build the sdist, build the wheel from it, and run the README's session with nothing
but the wheel, numpy and scipy, in a separate environment outside the repository.

python tools/check_dist.py [--out dist] needs the build tools of requirements.lock.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

SESSION = """
import doctest, sys
import fraclink
assert not fraclink.__file__.startswith(sys.argv[2]), fraclink.__file__
text = open(sys.argv[1], encoding="utf-8").read()
test = doctest.DocTestParser().get_doctest(text, {}, "README session", None, 0)
outcome = doctest.DocTestRunner(optionflags=doctest.REPORT_NDIFF).run(test)
print(f"README: {outcome.attempted - outcome.failed} of {outcome.attempted} examples")
sys.exit(outcome.failed > 0 or outcome.attempted < 10)
"""


def run(*command: object, cwd: Path) -> None:
    # An editable install of this checkout must not be imported.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    subprocess.run(  # noqa: S603
        [str(part) for part in command], cwd=cwd, env=environment, check=True
    )


def locked(names: tuple[str, ...]) -> str:
    """The entries of some packages in requirements.lock, with versions and hashes."""
    text = (ROOT / "requirements.lock").read_text("utf-8")
    entries = re.findall(r"^\S.*(?:\n[ \t].*)*", text, flags=re.MULTILINE)
    return "\n".join(row for row in entries if re.split(r"[=\s]", row)[0] in names)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "dist")
    out = parser.parse_args().out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    for earlier in [*out.glob("fraclink-*.tar.gz"), *out.glob("fraclink-*.whl")]:
        earlier.unlink()
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
    build = "from scikit_build_core.build import build_sdist; build_sdist({!r})"
    run(sys.executable, "-c", build.format(str(out)), cwd=ROOT)
    (sdist,) = out.glob("fraclink-*.tar.gz")
    with tempfile.TemporaryDirectory() as folder:
        away = Path(folder)
        options = ("--no-deps", "--no-build-isolation", "--wheel-dir", out)
        run(*pip, "wheel", *options, sdist, cwd=away)
        (wheel,) = out.glob("fraclink-*.whl")
        run(sys.executable, "-m", "venv", away / "venv", cwd=away)
        scripts = "Scripts" if os.name == "nt" else "bin"
        python = away / "venv" / scripts / "python"
        into = (python, *pip[1:], "install")
        (away / "needed.txt").write_text(locked(("numpy", "scipy")))
        run(*into, "--require-hashes", "--no-deps", "-r", "needed.txt", cwd=away)
        run(*into, "--no-deps", wheel, cwd=away)
        run(*into[:-1], "check", cwd=away)
        # The block without its fences: the text that a reader would paste.
        readme = (ROOT / "README.md").read_text("utf-8")
        (session,) = re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)
        (away / "session.txt").write_text(session, encoding="utf-8")
        (away / "session.py").write_text(SESSION, encoding="utf-8")
        run(python, "-I", "session.py", "session.txt", ROOT, cwd=away)
    print(f"{sdist.name} builds {wheel.name}, which passes alone")


if __name__ == "__main__":
    main()
