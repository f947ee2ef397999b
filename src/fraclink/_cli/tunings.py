"""The commands `tune` and `watch`: an unknown arm, moved until it has a law, and
watched afterwards.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from fraclink._arm.experiment import Experiment
from fraclink._cli.app import group
from fraclink._cli.boards import Address, KeyFile, UnsafeRemote, connection_of
from fraclink._cli.command import Answer, argument, command, option
from fraclink._cli.console import ask, tell
from fraclink._cli.options import in_seconds, load_rig
from fraclink._files import checked_path, load, output_path
from fraclink.errors import FieldError
from fraclink.lab._run import RealtimeRun
from fraclink.lab._tune import tune as tune_arm
from fraclink.lab._tune_guard import MotionLimits
from fraclink.lab._tuning import FILES, Tuning, TuningPlan
from fraclink.lab._watch import watch as watch_arm
from fracsys.checks import Between, Payload

app = group()

# The question for each limit and the payload, in the unit of its option.
_QUESTIONS = {
    "angle_deg": "How far may the motor turn to each side of where the arm stands now [°]?",
    "speed": "How fast may it turn at the gear's output [rad/s]?",
    "torque": "How much torque may the gauge show [N·m]?",
    "voltage": "How much voltage may the amplifier get [V]?",
    "payload": "Which mass does the tip carry now [kg]?",
}


@command(app)
def tune(
    io: Annotated[str, Address, "serial:PORT@BAUD or udp:HOST:PORT"],
    payload: Annotated[
        Payload | None, "Payload at the tip while it is tuned [kg]"
    ] = None,
    payloads: Annotated[
        tuple[float, float] | None,
        option("LOW HIGH"),
        "Payload range [kg]; default: the rig's",
    ] = None,
    angle_deg: Annotated[
        float | None,
        Between(10.0, 5e4, "°"),
        "Limit of the motor's angle to each side of where it stands",
    ] = None,
    speed: Annotated[
        float | None, "Limit of the motor's speed at the gear's output [rad/s]"
    ] = None,
    torque: Annotated[
        float | None, "Limit of the torque that the gauge shows [N·m]"
    ] = None,
    voltage: Annotated[
        float | None, "Limit of the voltage at the amplifier's input [V]"
    ] = None,
    rig: Annotated[
        str | None,
        option("RIG"),
        "What is known of the arm; measured scales are compared with it",
    ] = None,
    period_ms: Annotated[
        float | None,
        Between(0.05, 1000.0, "ms"),
        "Period of an arm that does not state its own",
    ] = None,
    out: Annotated[Path, "Folder for the results"] = Path("tuned"),
    resume: Annotated[
        bool,
        "Move with the law already tuned, with another --payload of its range",
    ] = False,
    yes: Annotated[bool, "Do not ask before the arm moves"] = False,
    unsafe_remote: UnsafeRemote = False,
    key_file: KeyFile = None,
    force: bool = False,
) -> Answer:
    """Tune an unknown arm within limits: wiring, motor, link, design, proof, law and
    first moves.

    Limits and payload that are not given are asked for; without them nothing moves. The
    plan is shown first. Ctrl-C, a limit, a lost link or a wrong sign switches the drive
    off; the record is kept. --resume moves with the law already tuned and another
    payload. The arm needs its own watchdog and an emergency stop.

    $ fraclink tune --io udp:127.0.0.1:5005 --payload 0.030
    """
    connection = connection_of(io, unsafe_remote, key_file)
    answers = dict(
        zip(_QUESTIONS, (angle_deg, speed, torque, voltage, payload), strict=True)
    )
    own_rig = None if rig is None else load_rig(rig)
    if resume and (out / FILES[0]).is_file():
        earlier: Tuning = load(out / FILES[0], Tuning)
        limits = earlier.limits
        before = {
            "angle_deg": math.degrees(limits.angle),
            "payload": earlier.payload,
            **asdict(limits),
        }
        answers = {k: before[k] if x is None else x for k, x in answers.items()}
        payloads, own_rig = payloads or earlier.payloads, own_rig or earlier.rig
    # Before the limits are requested: nobody should answer five questions to learn that
    # a file is in the way, or the address misspelt.
    elif not (resume or force):
        for name in FILES:
            output_path(out / name, force=False)
    values = {
        name: ask(_QUESTIONS[name], float, option=f"--{name.replace('_', '-')}")
        if value is None
        else value
        for name, value in answers.items()
    }
    mass = values.pop("payload")
    limits = MotionLimits(
        angle=math.radians(values["angle_deg"]),
        # no defaults for these: the person at the arm decides what it may do
        **{name: values[name] for name in ("speed", "torque", "voltage")},
    )
    plan = TuningPlan(limits, mass, payloads, in_seconds(period_ms), own_rig)
    # On standard error, so that it is read even if the result goes to a pipe.
    tell(plan.text)
    if resume:
        tell(f"of these only the wiring and the first moves, with {1e3 * mass:.3g} g")
    # A bare Enter means no: moving a machine requires a word.
    if not yes and ask("Go ahead?", str.lower, default="no", option="--yes") not in (
        "y",
        "yes",
    ):
        return Answer(text="nothing was moved", passed=False)
    # Every stage is announced when it begins: a turning motor must not come as a
    # surprise.
    tuning = tune_arm(connection, plan, out=out, resume=resume, force=force, begin=tell)
    files = tuple(out / name for name in FILES if (out / name).is_file())
    return Answer(
        tuning, tuning.passed, written=files, following=_following(tuning, io, out)
    )


def _following(tuning: Tuning, io: str, out: Path) -> str:
    if tuning.passed or (tuning.has_law and tuning.verdict.arm.state == "not run"):
        following = f"fraclink run-realtime {out / 'design.json'} --io {io}"
        if tuning.next_move is None:
            return following
        amplitude, duration, payload = tuning.next_move
        return (
            f"{following} --payload {payload:g} --amplitude {amplitude:.3f} "
            f"--move-time {duration:.3f}"
        )
    if tuning.stopped:
        return f"fraclink tune --io {io} --out {out} --force"
    # A law whose first moves missed the promise is not to be used further, with or
    # without a proof.
    return f"fraclink diagnose {out / 'log.npz'} --rig {out / 'rig.toml'}"


@command(app)
def watch(
    record: Annotated[
        Path,
        argument("RECORD"),
        "Record of the running arm (npz): of run-realtime, or a log",
    ],
    tuned: Annotated[Path, "Folder of the tuning, or its tuning.json"] = Path("tuned"),
) -> Answer:
    """Compare a record of a running arm with its tuning, and say what has changed: ω₀,
    gauge, friction.

    The exit code is 1 where a retune is due.

    $ fraclink watch realtime.npz --tuned tuned
    """
    # The folder as printed by `tune`, or the file as completed by a shell.
    place = tuned / FILES[0] if tuned.is_dir() else tuned
    content = load(checked_path("record", record))
    # Up to 1 % of lost samples of a run are interpolated, as for any log.
    log = content.experiment() if isinstance(content, RealtimeRun) else content
    if not isinstance(log, Experiment):
        raise FieldError(
            "record",
            str(record),
            "neither a run nor a log",
            "a run in real time, or a log",
            "record one: `fraclink run-realtime --out realtime.npz`",
        )
    comparison = watch_arm(log, load(place, Tuning))
    following = (
        ""
        if comparison.passed
        else "fraclink tune --io ADDRESS --payload KG --out retuned"
    )
    return Answer(comparison, comparison.passed, following=following)
