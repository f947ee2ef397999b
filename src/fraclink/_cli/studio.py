"""The command `studio`: a page on this machine for a study by hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fraclink._cli.app import group
from fraclink._cli.command import Answer, argument, command, option
from fraclink._cli.console import emit
from fraclink.errors import FieldError, MissingExtraError
from fracsys.checks import Between

if TYPE_CHECKING:
    from fraclink.studio._session import Session

app = group()


@command(app)
def studio(
    place: Annotated[
        Path | None,
        argument("[RESULTS | LOG | DESIGN | MODEL]"),
        "A folder of results, a log, a design, or a model of identify; without it the rig's own model",
    ] = None,
    rig: Annotated[
        str | None,
        option("RIG"),
        "A rig file or a bundled rig; default: the study's own",
    ] = None,
    out: Annotated[Path, "Folder that Keep writes to where no folder is opened"] = Path(
        "results"
    ),
    port: Annotated[
        int, Between(0, 65535), "Port to listen on; 0 takes a free one"
    ] = 0,
    open: Annotated[bool, "Open the page in a browser"] = True,
) -> Answer:
    """Open a study in a page on this machine: drag the loop, see the arm; Keep saves
    what the commands would write.

    $ fraclink studio results
    """
    try:
        from fraclink.studio._serving import serve
    # Only for the packages of the extra: a missing module of fraclink is a defect, and
    # must be reported as one.
    except ModuleNotFoundError as error:
        if error.name not in (
            "starlette",
            "uvicorn",
            "anyio",
            "h11",
            "click",
            "idna",
            "wsproto",
        ):
            raise
        raise MissingExtraError(error.name, "studio") from error
    if place is not None and not place.exists():
        raise FieldError(
            "place",
            str(place),
            "no such file",
            "a folder, a log, a design or a model that is there",
            "check the name, or leave it out",
        )
    session = serve(
        lambda: _opened(place, rig, out),
        port=port,
        open_page=open,
        say=emit,
    )
    return Answer(
        text=f"kept in {session.folder}"
        if session.folder.is_dir()
        else "nothing was kept"
    )


def _opened(place: Path | None, rig: str | None, out: Path) -> Session:
    # Everything numerical is loaded here, one second of work, while the browser loads
    # the page.
    from fraclink._cli.options import load_rig
    from fraclink.studio._session import opened

    return opened(place, rig=None if rig is None else load_rig(rig), out=out)
