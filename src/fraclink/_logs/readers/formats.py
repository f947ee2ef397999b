"""Which format a file is in, by its first bytes; a name that says another one is an error."""

from __future__ import annotations

from pathlib import Path

from fraclink._logs.readers.child import ReaderChild
from fraclink._logs.readers.limits import FILE_LIMIT, check_file
from fraclink._logs.readers.table import Table
from fraclink._logs.readers.text import read_text_table
from fraclink.errors import FileFormatError, LogError

__all__ = ["read_table", "sniffed_kind"]

_MAGIC = (
    (0, b"MATLAB 5.0", "MAT v5"),
    (0, b"MATLAB 7.3", "HDF5"),
    (0, b"\x89HDF\r\n\x1a\n", "HDF5"),
    (512, b"\x89HDF\r\n\x1a\n", "HDF5"),
    (0, b"PAR1", "Parquet"),
    (0, b"TDSm", "TDMS"),
    (0, b"\x89MCAP0\r\n", "ROS 2"),
    (0, b"SQLite format 3\x00", "ROS 2"),
)
_FOREIGN = (
    (b"PK\x03\x04", "a zip or spreadsheet"),
    (b"\x1f\x8b", "gzip"),
    (b"\xd0\xcf\x11\xe0", "an old spreadsheet"),
    (b"%PDF", "PDF"),
    (b"\x93NUMPY", "NumPy"),
    (b"\x80\x04", "pickle"),
    (b"{", "JSON"),
    (b"<", "HTML or XML"),
)
# Names that promise a format; other endings (.txt, .dat, .log …) promise nothing.
_PROMISED = {
    ".mat": ("MAT v5", "HDF5"),
    ".h5": ("HDF5",),
    ".hdf5": ("HDF5",),
    ".parquet": ("Parquet",),
    ".tdms": ("TDMS",),
    ".mcap": ("ROS 2",),
    ".db3": ("ROS 2",),
    ".csv": ("text",),
    ".tsv": ("text",),
}


def sniffed_kind(path: Path) -> str:
    """The format of the file at `path`: text, MAT v5, HDF5, Parquet, TDMS or ROS 2.

    Raises FileFormatError where its content holds no log, or is of another format than its name says.
    """
    if path.is_dir():
        if (path / "metadata.yaml").is_file():
            return "ROS 2"
        raise FileFormatError(
            "log",
            path.name or str(path),
            "a folder",
            allowed="a file, or a rosbag2 folder",
            remedy="give the file itself",
        )
    check_file(path)
    with path.open("rb") as stream:
        head = stream.read(1024)
    kind = next((kind for at, magic, kind in _MAGIC if head[at : at + len(magic)] == magic), "text")
    for magic, name in _FOREIGN:
        if head.startswith(magic):
            raise _other(path, name, "text, MAT, HDF5, Parquet, TDMS, rosbag2, MCAP", "export it as CSV")
    promised = _PROMISED.get(path.suffix.lower(), (kind,))
    if kind not in promised:
        raise _other(path, kind, " or ".join(promised), _remedy(path, kind))
    return kind


def _other(path: Path, found: str, allowed: str, remedy: str) -> FileFormatError:
    return FileFormatError("log", path.name, f"{found} by its content", allowed=allowed, remedy=remedy)


def _remedy(path: Path, kind: str) -> str:
    if path.suffix.lower() == ".mat":
        return "it is damaged or of MATLAB v4: save it again, save log.mat t theta torque -v7"
    return "correct the ending of its name" if kind != "text" else "it is damaged, or correct its ending"


def read_table(path: Path) -> Table:
    """Read the columns of a file of any known format.

    Binary formats are parsed in a child process with limits of memory and time. Raises FileFormatError,
    LogError, SizeError or MissingExtraError.
    """
    kind = sniffed_kind(path)
    if kind == "text":
        return read_text_table(path)
    _check_folder(path)
    with ReaderChild() as child:
        table = child.read(path, kind)
    if not table.names:
        raise LogError(
            "log",
            path.name,
            f"a {kind} file without a numeric array of two samples or more",
            allowed="arrays of real numbers",
            remedy="export plain arrays; in MATLAB save log.mat t theta torque -v7",
        )
    return table


def _check_folder(path: Path) -> None:
    if path.is_dir():
        size = sum(file.stat().st_size for file in path.iterdir() if file.is_file())
        if size > FILE_LIMIT:
            check_file(
                max((file for file in path.iterdir() if file.is_file()), key=lambda f: f.stat().st_size)
            )
