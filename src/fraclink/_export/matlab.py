"""The discrete law for MATLAB: a .m file that rebuilds it, and the numbers as a .mat
file.
"""

from __future__ import annotations

import io
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scipy.io import savemat

from fraclink._export.data import identifier
from fraclink._files import atomic_write, output_path
from fraclink._law import Law
from fraclink._validate import checked
from fraclink.errors import FieldError

__all__ = ["export_matlab"]


@checked
def export_matlab(law: Law, path: Path | str, *, force: bool = False) -> Path:
    """Write the law's filters for MATLAB to `path`, ending in .m (a function) or .mat
    (version 5), and return it.

    Both hold: period [s], stiffness [N·m/rad], and for correction and feed-forward the
    direct part, poles and residues of d + Σ g/(z − p); the correction is that times (1
    − 1/z). Where the Control System Toolbox or Octave's control package is there, the
    .m file also returns them as systems, `sys`, in state space: a quotient of
    polynomials would lose digits. What a payload that is given changes is in `payload`.
    Guards and motor loop are in the C export only. Raises FieldError for another
    ending, a file name that is no MATLAB function name, and an existing file without
    `force`.

    >>> import fraclink as fl, tempfile
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.discretize(fl.Controller(gain=0.069876, order=0.612197, link=rig.model), rig.period, order=4)
    >>> export_matlab(law, Path(tempfile.mkdtemp()) / "arm_law.m").name
    'arm_law.m'
    """
    place = output_path(path, force=force)
    if place.suffix not in (".m", ".mat"):
        raise FieldError(
            "out",
            place.name,
            "of another kind",
            allowed=".m or .mat",
            remedy="end the name in .m or .mat",
        )
    if place.suffix == ".m":
        identifier("out", place.stem)
        content = _function(law, place.stem).encode()
    else:
        content = _numbers(law)
    with atomic_write(place, "wb") as stream:
        stream.write(content)
    return place


def _filters(law: Law) -> dict[str, tuple[float, np.ndarray, np.ndarray]]:
    correction, forward = law.correction, law.feedforward
    # The law holds half of each pair and takes twice its real part: Re(g/(z − p)) =
    # g/2/(z − p) + ḡ/2/(z − p̄).
    pairs = np.array(correction.pair_poles), np.array(correction.pair_gains)
    return {
        "correction": (
            correction.direct,
            np.concatenate([correction.poles, pairs[0], pairs[0].conj()]),
            np.concatenate([correction.gains, pairs[1] / 2, pairs[1].conj() / 2]),
        ),
        "feedforward": (
            forward.direct,
            np.array(forward.poles),
            np.array(forward.gains),
        ),
    }


def _numbers(law: Law) -> bytes:
    content: dict[str, object] = {
        "period": law.period,
        "stiffness": law.stiffness,
        "sha256": law.digest,
    }
    for name, (direct, poles, residues) in _filters(law).items():
        content |= {
            f"{name}_direct": direct,
            f"{name}_poles": poles,
            f"{name}_residues": residues,
        }
    if law.tracking is not None:
        content |= {
            f"payload_{name}": value for name, value in asdict(law.tracking).items()
        }
    stream = io.BytesIO()
    # Version 5 is the newest that is no HDF5: MATLAB and Octave read it alike. Columns,
    # as roots() and residue() give them.
    savemat(stream, content, format="5", do_compression=False, oned_as="column")
    return stream.getvalue()


def _vector(values: np.ndarray) -> str:
    # repr of a double comes back to the bit; MATLAB reads 17 digits exactly
    return (
        "["
        + "; ".join(f"{complex(x).real!r} + {complex(x).imag!r}i" for x in values)
        + "]"
    )


def _function(law: Law, name: str) -> str:
    lines = [
        f"function law = {name}()",
        f"%{name.upper()} Discrete control law of a flexible link, made by fraclink.",
        f"%   law {law.digest}",
        "%   motor_reference = reference + feedforward * reference_acceleration + correction * error,",
        "%   error = reference - (motor_angle - torque / stiffness); correction(1) = 0.",
        f"law.period = {law.period!r};",
        f"law.stiffness = {law.stiffness!r};",
    ]
    for part, (direct, poles, residues) in _filters(law).items():
        lines += [
            f"law.{part}.direct = {direct!r};",
            f"law.{part}.poles = {_vector(poles)};",
            f"law.{part}.residues = {_vector(residues)};",
        ]
    if law.tracking is not None:
        lines += [
            "% With a payload [kg] that is given the feed-forward is (payload + link)/nominal times as",
            "% large, and error = H/(z - 1 + H) reference - ..., H = now + next/(z - keep).",
            *(
                f"law.payload.{key} = {value!r};"
                for key, value in asdict(law.tracking).items()
            ),
        ]
    lines += [
        "if exist('ss') > 0 % the Control System Toolbox, or Octave's control package",
        "    difference = ss(0, 1, -1, 1, law.period); % 1 - 1/z",
        "    law.correction.sys = difference * modal_form(law.correction, law.period);",
        "    law.feedforward.sys = modal_form(law.feedforward, law.period);",
        "end",
        "end",
        "",
        "function sys = modal_form(part, period)",
        "% A block for each real pole and each pair. As a quotient of polynomials (tf) poles this close to 1",
        "% would lose three digits and more.",
        "A = [];",
        "B = [];",
        "C = [];",
        "for k = 1:numel(part.poles)",
        "    p = part.poles(k);",
        "    g = part.residues(k);",
        "    if imag(p) == 0",
        "        A = blkdiag(A, real(p));",
        "        B = [B; 1];",
        "        C = [C, real(g)];",
        "    elseif imag(p) > 0",
        "        A = blkdiag(A, [real(p), imag(p); -imag(p), real(p)]);",
        "        B = [B; 1; 0];",
        "        C = [C, 2*real(g), 2*imag(g)];",
        "    end",
        "end",
        "sys = ss(A, B, C, part.direct, period);",
        "end",
        "",
    ]
    return "\n".join(lines)
