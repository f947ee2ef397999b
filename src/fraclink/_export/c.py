"""Export the law to C: law.h and law.c as they were simulated, the data, a self-test and a page to read."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from fraclink._certify import Certificate
from fraclink._export.claims import Proof
from fraclink._export.data import data_header
from fraclink._export.names import identifier, title_text
from fraclink._export.readme import readme
from fraclink._export.selftest import selftest_source
from fraclink._export.sources import law_source
from fraclink._files import atomic_write, checked_path
from fraclink._law import Law
from fraclink._law.block import Precision
from fraclink._validate import checked_noun
from fraclink.errors import FieldError, MissingExtraError

__all__ = ["export_c"]


def export_c(
    law: Law,
    folder: Path | str,
    *,
    precision: Precision | None = None,
    name: str = "law_data",
    title: str = "",
    prove: bool = False,
    certificate: Certificate | None = None,
    force: bool = False,
) -> tuple[Path, ...]:
    """Write the law as C99 to `folder` and return the paths written.

    law.h and law.c are the files that were simulated, to the byte; law_data.h holds the coefficients as
    hex floats; law_selftest.c prints a hash to compare on the target; law.json is the law for
    `replay`; README.md tells the call sequence,
    memory in [B], limits in [rad], [N·m] and [V], and what is claimed.

    Parameters
    ----------
    law
        From `discretize`; with the motor loop of a rig (`equip`) it closes the motor loop too.
    folder
        Made where it is missing; an existing one that is not empty needs `force`.
    precision
        The law's own where it is left out.
    name
        C identifier of the block, and of its header's guard.
    title
        Plain text for the first comment, at most 80 characters.
    prove
        Prove what can be proved about these very files with the provers that are installed (Debian's
        frama-c-base, z3 or cvc5, gappa; python-flint): README.md then claims what was proved and nothing
        else, proof.json lists it (`Proof.load`), proof/ holds the logs. Half a minute on a desktop. Needs
        the package fraclink-prove (folder prove/ of the repository).
    certificate
        Of the loop that the exported law closes, from `certify`; with `prove` it becomes a claim.
    force
        Overwrite the files in an existing folder.

    Raises
    ------
    FieldError
        an existing folder, an illegal name or title.
    MissingExtraError
        `prove` without fraclink-prove.

    >>> import tempfile
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.discretize(fl.Controller(gain=0.069876, order=0.612197, link=rig.model), rig.period, order=4)
    >>> folder = Path(tempfile.mkdtemp())
    >>> [path.name for path in export_c(law, folder, precision="single")]
    ['law.h', 'law.c', 'law_data.h', 'law_selftest.c', 'README.md', 'law.json']
    """
    identifier("name", name)
    title_text(title)
    checked_noun("law", law, Law, remedy="fl.discretize(design) makes one")
    if certificate is not None:
        checked_noun("certificate", certificate, Certificate, remedy="fraclink._certify makes one")
    place = checked_path("folder", folder)
    if place.is_file() or (place.is_dir() and any(place.iterdir()) and not force):
        raise FieldError(
            "out",
            str(place),
            "already there",
            allowed="a new or an empty folder",
            remedy="choose another name or add --force",
        )
    shipped = law if precision is None else law.in_precision(precision)
    data = f"{name}.h"
    files: dict[str, bytes] = {
        "law.h": law_source("law.h"),
        "law.c": law_source("law.c"),
        data: data_header(shipped, name=name, title=title).encode(),
        "law_selftest.c": selftest_source(shipped, name=name, data=data).encode(),
    }
    proof, logs = _proved(shipped, files, name, data, certificate) if prove else (None, {})
    files["README.md"] = readme(shipped, name=name, data=data, proof=proof).encode()
    files |= logs
    # Everything is made before anything is written: a failure above leaves no half folder.
    place.mkdir(parents=True, exist_ok=True)
    # a proof of what stood here before says nothing about what is written now
    (place / "proof.json").unlink(missing_ok=True)
    for file, content in files.items():
        with atomic_write(place / file, "wb") as stream:
            stream.write(content)
    # the law itself, for `fraclink replay`: nothing that is compiled reads it
    shipped.save(place / "law.json")
    written = [*(place / file for file in files), place / "law.json"]
    if proof is not None:
        proof.save(place / "proof.json")
        written.append(place / "proof.json")
    return tuple(written)


def _proved(
    law: Law, files: Mapping[str, bytes], name: str, data: str, certificate: Certificate | None
) -> tuple[Proof, dict[str, bytes]]:
    """Prove in a scratch folder, so that a failure in between leaves nothing behind."""
    try:
        from fraclink_prove import prove as prove_folder
    except ImportError as error:
        raise MissingExtraError("fraclink-prove", "prove", install="./prove") from error
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for file, content in files.items():
            (folder / file).write_bytes(content)
        proof = prove_folder(law, folder, name=name, data=data, certificate=certificate)
        logs = {f"proof/{path.name}": path.read_bytes() for path in sorted((folder / "proof").glob("*"))}
    return proof, logs
