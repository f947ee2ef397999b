"""A start for the library through which `fraclink run-realtime` reaches a board."""

from __future__ import annotations

from pathlib import Path

from fraclink._export.sources import law_source
from fraclink._files import atomic_write, checked_path, output_path

__all__ = ["export_io"]

_BOARD = b"""\
/* The way from `fraclink run-realtime` to a board. It compiles and stands still: fill in the four places.
 *
 *   cc -std=c99 -O2 -shared -fPIC my_board.c -o my_board.so
 *   fraclink run-realtime design.json --io library:./my_board.so
 */
#include "arm_io.h"

uint32_t arm_io_version(void)
{
    return ARM_IO_VERSION;
}

int arm_open(void)
{
    /* 1. Open the board. Its drive needs a watchdog that switches the motor off when commands cease. */
    return 0;
}

int arm_read(arm_sample *sample)
{
    /* 2. Encoder counts to rad at the gear's output, gauge counts to N m, with the signs of the rig file. */
    sample->motor_angle = 0.0;
    sample->torque = 0.0;
    return 0;
}

int arm_write(const arm_command *command)
{
    if ((command->mode == ARM_MODE_IDLE) || (command->mode == ARM_MODE_OFF)) {
        /* 3. Keep or switch the drive off. */
        return 0;
    }
    /* 4. Give command->voltage [V] to the amplifier, or command->motor_reference [rad] to the servo. */
    return 0;
}

void arm_close(void)
{
}
"""


def export_io(folder: Path | str, *, force: bool = False) -> tuple[Path, ...]:
    """Write arm_io.h and my_board.c to `folder` and return their paths.

    The header is the one that `fraclink._realtime.Library` was built with; the board compiles as it is and
    gives an arm that stands still. Raises FieldError where one of them is there and `force` is not given.

    >>> import tempfile
    >>> [path.name for path in export_io(tempfile.mkdtemp())]
    ['arm_io.h', 'my_board.c']
    """
    chosen = checked_path("folder", folder)
    contents = {"arm_io.h": law_source("arm_io.h"), "my_board.c": _BOARD}
    places = {name: output_path(chosen / name, force=force) for name in contents}
    for name, place in places.items():
        with atomic_write(place, "wb") as stream:
            stream.write(contents[name])
    return tuple(places.values())
