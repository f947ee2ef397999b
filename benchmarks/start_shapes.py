"""Logs for bench_start: one motion of one arm, written in the shapes and with the
signals of laboratories.
"""

from __future__ import annotations

import datetime
import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import fraclink as fl
import fracsys

Array = NDArray[np.float64]
PERIOD, COUNT, LENGTH, STIFFNESS = 0.004, 3000, 0.32, 1.56
ORDER, FREQUENCY, DELAY = 1.93, 10.02, 0.008  # DELAY applies to the logs that have one
DEG = 180 / np.pi


@functools.cache
def motion() -> dict[str, Array]:
    """Stamps, motor angle, deflection, torque and voltage of the arm, and a late
    deflection.
    """
    time = np.asarray(PERIOD * np.arange(COUNT), dtype=np.float64)
    angle = np.asarray(
        fl.prbs(0.4, 0.24, bits=45, register=9, start=0.3).angle(time), dtype=np.float64
    )
    # smoothed twice, because the voltage needs the motor's acceleration
    for _ in range(2):
        angle = np.convolve(
            np.concatenate((np.zeros(15), angle)), np.ones(16) / 16, "valid"
        )[:COUNT]
    link = fracsys.s**ORDER / (fracsys.s**ORDER + FREQUENCY**2)
    bent = fracsys.time_response(link, angle, PERIOD, hold="first").output
    late = np.concatenate((np.zeros(round(DELAY / PERIOD)), bent))[:COUNT]
    speed = np.gradient(angle, PERIOD)
    noise = np.random.default_rng(5).normal(0, 0.003, COUNT)
    push = np.gradient(speed, PERIOD) + 15.15 * speed + STIFFNESS / 0.05 * bent
    turned = angle + np.clip(time - 1, 0, 10) * 1.2
    swing = fracsys.time_response(link, turned, PERIOD, hold="first").output
    return {
        "long angle": turned,
        "long torque": STIFFNESS * (swing + noise),
        "t": time,
        "angle": angle,
        "deflection": bent + noise,
        "late": late + noise,
        "torque": STIFFNESS * (bent + noise),
        "voltage": push / 61.1,
        "tip": angle - bent + 0.3 * noise,
        "smooth tip": angle - bent,
    }


@dataclass(frozen=True)
class Shape:
    """A log as a file, what it holds, and what `start` must say on the way.

    Parameters
    ----------
    write
        writes it into a folder and returns its path.
    steps
        what each refusal must contain, and the answer: a statement for `column`, an
        option of `start` such as ``period=0.004``, after ``$ `` the words that precede
        a shell command, the fraclink command to continue with, or "" where only the
        laboratory can help.
    kind, voltage, late, raw
        the output; whether the log has a voltage; whether its output is late; whether a
        factor of the output is unknown (a gauge that nobody has calibrated).
    any_radius
        whether a factor of the motor angle is free: a linear axis.
    of
        which motion: "" or "long ", in which the motor also turns by 12 rad.
    times
        how many times as large the motion is.
    stated
        what the call states from the beginning.
    """

    write: Callable[[Path], Path]
    steps: tuple[tuple[str, str], ...] = ()
    kind: str = "torque"
    voltage: bool = False
    late: bool = False
    raw: bool = False
    any_radius: bool = False
    stated: tuple[str, ...] = ()
    times: float = 1.0
    of: str = ""


Columns = dict[str, Array]


def body(columns: Columns, separator: str = ",", digits: str = ".9g") -> str:
    """Rows of numbers."""
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return (
        "\n".join(
            separator.join(format(value, digits) for value in row) for row in rows
        )
        + "\n"
    )


def table(columns: Columns, separator: str = ",", *, digits: str = ".9g") -> str:
    """A header and rows."""
    return separator.join(columns) + "\n" + body(columns, separator, digits)


def written(content: str | bytes, name: str = "log.csv") -> Callable[[Path], Path]:
    """A function that writes `content` into a folder."""

    def write(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def stamped(form: str) -> str:
    """Rows with clock times as time stamps."""
    start = datetime.datetime(2026, 3, 31, 23, 59, 58)
    m, lines = motion(), ["stamp,enc_deg,torque_Nm"]
    for t, a, g in zip(m["t"], m["angle"], m["torque"], strict=True):
        moment = start + datetime.timedelta(milliseconds=round(1e3 * t))
        lines.append(
            f"{moment.strftime(form)}.{moment.microsecond // 1000:03d},{DEG * a:.6f},{g:.6f}"
        )
    return "\n".join(lines) + "\n"


def labview() -> str:
    """A measurement file of LabVIEW."""
    m = motion()
    rows = "\n".join(
        f"{t:.6f}\t{DEG * a:.6f}\t{g:.6f}\t"
        for t, a, g in zip(m["t"], m["angle"], m["torque"], strict=True)
    )
    return (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        "Decimal_Separator\t.\nMulti_Headings\tNo\nX_Columns\tOne\nTime_Pref\tAbsolute\nDate\t2026/03/01\n"
        "Time\t10:00:00.123\n***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t3000\t3000\t\n"
        "Y_Unit_Label\tdeg\tNm\t\nX_Dimension\tTime\tTime\t\nX0\t0\t0\t\nDelta_X\t0.004\t0.004\t\n"
        "***End_of_Header***\t\t\t\nX_Value\tTheta\tTorque\tComment\n" + rows + "\n"
    )


def quoted(text: str) -> str:
    """Every number in quotes, with decimal commas, as a German spreadsheet writes it."""
    head, rest = text.split("\n", 1)
    rows = (
        '","'.join(line.replace(".", ";").split(",")).replace(";", ",")
        for line in rest.splitlines()
    )
    return head + "\n" + "\n".join(f'"{row}"' for row in rows) + "\n"


def matlab(folder: Path) -> Path:
    """A MATLAB file with three arrays."""
    from scipy.io import savemat

    m = motion()
    path = folder / "log.mat"
    savemat(
        path, {"t": m["t"], "theta_deg": DEG * m["angle"], "torque_Nm": m["torque"]}
    )
    return path


def tdms(folder: Path) -> Path:
    """A TDMS file: two channels of a waveform, without stamps of their own."""
    from nptdms import ChannelObject, TdmsWriter

    m, path = motion(), folder / "log.tdms"
    wave = {"wf_increment": PERIOD, "wf_start_offset": 0.0}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [
                ChannelObject(
                    "Arm", "Theta", DEG * m["angle"], {**wave, "unit_string": "deg"}
                ),
                ChannelObject(
                    "Arm", "Torque", m["torque"], {**wave, "unit_string": "Nm"}
                ),
            ]
        )
    return path


def forms() -> dict[str, Shape]:
    """The same three columns in the forms of many loggers."""
    m = motion()
    t, a, g, u = m["t"], m["angle"], m["torque"], m["voltage"]
    plain = {"time_s": t, "motor_angle_rad": a, "torque_Nm": g}
    degrees = {"t_s": t, "theta_deg": DEG * a, "torque_mNm": 1e3 * g}
    shifted = np.convolve(a, np.ones(25) / 25, "same")
    german = table(
        {"Zeit [s]": t, "Winkel [°]": DEG * a, "Moment [Nm]": -g}, ";"
    ).replace(".", ",")
    r_rows = "\n".join(
        f"{k + 1},{row}" for k, row in enumerate(body(degrees).splitlines())
    )
    raw = np.column_stack((t, DEG * a, g))
    gaps = table(plain).splitlines()
    del gaps[700:708]
    holes = table(plain).splitlines()
    holes[900] = holes[900].rsplit(",", 1)[0] + ","
    side = "\n".join(
        ",".join([name, *(f"{x:.7g}" for x in values)])
        for name, values in degrees.items()
    )
    extra = {
        "index": np.arange(COUNT, dtype=np.float64),
        "t": 1e3 * t,
        "theta_ref": np.round(a, 1),
        "theta": DEG * a,
        "theta_dot": DEG * np.gradient(a, PERIOD),
        "tip_angle": DEG * m["tip"],
        "current_A": 0.3 * u,
        "u_V": -u,
        "temp": 21 + 0.01 * t,
        "bridge_mNm": -1e3 * g,
    }
    joint = {
        "stamp": t,
        "joint_position": a,
        "joint_velocity": np.gradient(a, PERIOD),
        "joint_effort": g,
    }
    return {
        "names that state all": Shape(written(table(plain))),
        "milliseconds, degrees, mN·m, turned": Shape(
            written(
                table({"t_ms": 1e3 * t, "theta_deg": DEG * a, "bridge_mNm": -1e3 * g})
            )
        ),
        "German: semicolons, decimal commas, cp1252": Shape(
            written(german.encode("cp1252"))
        ),
        "no units, tabs": Shape(
            written(table({"time": t, "theta": a, "torque": g}, "\t"), "log.txt"),
            (("in which unit", "motor_angle=[rad]"), ("is a torque", "torque=[Nm]")),
        ),
        "no units: ms and degrees": Shape(
            written(table({"t": 1e3 * t, "enc": DEG * a, "torque": g})),
            (("in which unit", "motor_angle=[deg]"), ("is a torque", "torque=[Nm]")),
        ),
        "no units: µs and mN·m": Shape(
            written(table({"t": 1e6 * t, "enc": a, "moment": 1e3 * g})),
            (("in which unit", "motor_angle=[rad]"), ("is a torque", "torque=[mNm]")),
        ),
        "no units: radians beyond a turn": Shape(
            written(
                table({"t": t, "theta": m["long angle"], "torque_Nm": m["long torque"]})
            ),
            (('--column "motor_angle=theta [deg]"', "motor_angle=theta [rad]"),),
            of="long ",
        ),
        "no units: less than a degree": Shape(
            written(table({"t": t, "theta": DEG * a / 60, "torque_Nm": g / 60})),
            (('--column "motor_angle=theta [deg]"', "motor_angle=theta [deg]"),),
            times=1 / 60,
        ),
        "extra columns": Shape(
            written(table(extra)),
            (("in which unit", "motor_angle=[deg]"),),
            voltage=True,
        ),
        "joint states": Shape(
            written(table(joint)),
            (("in which unit", "motor_angle=[rad]"), ("is a torque", "torque=[Nm]")),
        ),
        "LabVIEW .lvm": Shape(
            written(labview(), "log.lvm"), (("sed -n '/^X_Value/,$p'", ""),)
        ),
        "ISO stamps over midnight": Shape(written(stamped("%Y-%m-%dT%H:%M:%S"))),
        "a clock over midnight": Shape(written(stamped("%H:%M:%S"))),
        "a title and a row of units": Shape(
            written(
                "Arm 3, run 5\nDate: 1 March\n\ntime,angle,torque\ns,deg,Nm\n"
                + body({"t": t, "a": DEG * a, "g": g})
            )
        ),
        "on its side": Shape(written(side), (("one sample a line", ""),)),
        "decimal commas in quotes": Shape(written(quoted(table(degrees)))),
        "UTF-16 with tabs": Shape(
            written(table(degrees, "\t").encode("utf-16"), "log.txt")
        ),
        "blanks, no header": Shape(
            written(body(plain, "  "), "log.dat"),
            (
                ("Which column is the motor angle", "motor_angle=#2 [rad]"),
                ("Which column is the link's output", "deflection=#3 [raw]"),
            ),
            kind="deflection",
            raw=True,
        ),
        "row numbers of R without a name": Shape(
            written(",".join(degrees) + "\n" + r_rows + "\n")
        ),
        "a name too many": Shape(
            written(table(degrees).replace("torque_mNm\n", "torque_mNm,spare\n", 1)),
        ),
        "text behind the table": Shape(
            written(table(degrees) + "\nEnd of run\n"),
            (("cut off the rest", "$ cut off the rest by "),),
        ),
        "raw float64": Shape(written(raw.tobytes(), "log.bin"), (("np.fromfile", ""),)),
        "raw float64, channel after channel": Shape(
            written(raw.T.tobytes(), "log.bin"), (("np.fromfile", ""),)
        ),
        "MATLAB": Shape(matlab),
        "TDMS": Shape(tdms),
        "no stamps": Shape(
            written(table({"theta_deg": DEG * a, "torque_Nm": g})),
            (("--period-ms 4", "period=0.004"),),
        ),
        "a counter for a clock": Shape(
            written(
                table(
                    {
                        "n": np.arange(COUNT, dtype=np.float64),
                        "theta_deg": DEG * a,
                        "torque_Nm": g,
                    }
                )
            ),
            (('--column "time=n * 0.004 [s]"', "time=n * 0.004 [s]"),),
        ),
        "gaps": Shape(
            written("\n".join(gaps) + "\n"), (("--resample", "resample=True"),)
        ),
        "missing cells": Shape(
            written("\n".join(holes) + "\n"), (("--interpolate", "interpolate=True"),)
        ),
        "commas between decimal commas": Shape(
            written(table(plain, digits=".6f").replace(".", ",")),
            (("export with decimal points", ""),),
        ),
        "a spreadsheet": Shape(
            written(b"PK\x03\x04" + bytes(500), "log.xlsx"), (("export it as CSV", ""),)
        ),
        "a reference beside the angle": Shape(
            written(
                table(
                    {"t": t, "phi_soll": DEG * shifted, "phi_ist": DEG * a, "dms_Nm": g}
                )
            ),
            (("in which unit", "motor_angle=[deg]"),),
        ),
    }


def signals() -> dict[str, Shape]:
    """What laboratories measure."""
    m = motion()
    t, a, d, g, u = m["t"], m["angle"], m["deflection"], m["torque"], m["voltage"]
    both = {"t_s": t, "enc_deg": DEG * a}
    bent = {"kind": "deflection"}
    raw = {"kind": "deflection", "raw": True}
    counts = np.round(a * 4096 / (2 * np.pi))
    noise = np.random.default_rng(6).normal(0, 0.002, (2, COUNT))
    acceleration = (
        LENGTH * np.gradient(np.gradient(m["smooth tip"], PERIOD), PERIOD) + noise[0]
    )
    turned = fracsys.time_response(
        61.1 / (fracsys.s * (fracsys.s + 15.15)),
        np.repeat(np.random.default_rng(2).choice([-3.0, 3.0], 60), 50),
        PERIOD,
    )
    drive = np.repeat(np.random.default_rng(2).choice([-3.0, 3.0], 60), 50)
    ring = 0.1 * (
        1
        - fracsys.step_response(
            FREQUENCY**2 / (fracsys.s**ORDER + FREQUENCY**2), t
        ).output
    )
    held = np.concatenate((np.full(100, ring[0]), ring))[:COUNT] + 0.2 * noise[0]
    w = np.geomspace(1, 80, 120)
    h = (fracsys.s**ORDER / (fracsys.s**ORDER + FREQUENCY**2))(1j * w)
    return {
        "strain in volts, turned, offset": Shape(
            written(table({**both, "strain_V": 0.05 - 0.4 * d})), **raw
        ),
        "strain in counts": Shape(
            written(table({**both, "adc_bridge": np.round(20000 * d + 2048)})), **raw
        ),
        "strain in mV, late, with a voltage": Shape(
            written(table({**both, "u_V": u, "dms_mV": 12 * m["late"]})),
            voltage=True,
            late=True,
            **raw,
        ),
        "a deflection in degrees, late": Shape(
            written(table({**both, "alpha_deg": DEG * m["late"]})), late=True, **bent
        ),
        "a deflection in radians beside degrees": Shape(
            written(table({**both, "alpha": -d})), **raw
        ),
        "two gauges of a half bridge": Shape(
            written(
                table(
                    {
                        **both,
                        "strain1_V": 0.9 * d + 1.2 + noise[0],
                        "strain2_V": 0.7 - 0.9 * d + noise[1],
                    }
                )
            ),
            (
                (
                    "Which column is the link's output",
                    "deflection=strain1_V - strain2_V [raw]",
                ),
            ),
            **raw,
        ),
        "two gauges that the call adds": Shape(
            written(table({**both, "g1": 0.25 * d, "g2": 0.75 * d})),
            (("Which column is the link's output", "deflection=g1 + g2 [rad]"),),
            **bent,
        ),
        "an encoder at the tip": Shape(
            written(table({**both, "tip_deg": DEG * m["tip"]})), **bent
        ),
        "an encoder at the tip, in other units": Shape(
            written(table({**both, "tip_rad": m["tip"]})), **bent
        ),
        "a tip angle that is called alpha": Shape(
            written(table({"t_s": t, "theta_rad": a, "alpha_rad": m["tip"]})), **bent
        ),
        "a camera that sees the tip, in metres": Shape(
            written(table({**both, "camera_y_m": 0.7 + LENGTH * m["tip"]})),
            (
                (
                    "sees the tip in space",
                    "deflection=enc_deg - 179.049 * camera_y_m [deg]",
                ),
            ),
            **bent,
        ),
        "a laser on the hub, in millimetres": Shape(
            written(table({**both, "laser_mm": 80 + 1e3 * LENGTH * d})), **raw
        ),
        "a deflection in metres": Shape(
            written(table({**both, "deflection_m": LENGTH * d})), **raw
        ),
        "a deflection in metres, length stated": Shape(
            written(table({**both, "deflection_m": LENGTH * d})),
            stated=("deflection=deflection_m * 1/0.32 [rad]",),
            **bent,
        ),
        "a linear axis in metres": Shape(
            written(table({"t_s": t, "cart_m": 0.1 * a, "strain_V": 0.4 * d})),
            any_radius=True,
            **raw,
        ),
        "encoder counts": Shape(
            written(table({"t": t, "enc": counts, "torque": g})),
            (
                (
                    '--column "motor_angle=enc * 1/N [rev]"',
                    "motor_angle=enc * 1/4096 [rev]",
                ),
                ("is a torque", "torque=[Nm]"),
            ),
        ),
        "a potentiometer in volts": Shape(
            written(table({"t": t, "pot_V": DEG * a / 36.8 + 2.5, "torque_Nm": g})),
            (
                (
                    '--column "motor_angle=pot_V * N [deg]"',
                    "motor_angle=pot_V * 36.8 [deg]",
                ),
            ),
        ),
        "two encoders and a torque": Shape(
            written(
                table({"t": t, "enc1": DEG * a, "enc2": DEG * m["tip"], "torque_Nm": g})
            ),
            (('--column "motor_angle=enc1 [deg]"', "motor_angle=enc1 [deg]"),),
        ),
        "an accelerometer at the tip": Shape(
            written(table({**both, "acc_ms2": acceleration})),
            (("--structure", "fraclink "),),
        ),
        "angle and voltage only": Shape(
            written(table({"t_s": t, "u_V": drive, "enc_deg": DEG * turned.output})),
            (("--structure motor", "fraclink "),),
        ),
        "a ring-down with the motor locked": Shape(
            written(table({"t_s": t, "strain_V": 0.3 + 2 * held})),
            (("--ring-down", "fraclink "),),
        ),
        "a ring-down, motor angle constant": Shape(
            written(
                table(
                    {
                        "t_s": t,
                        "theta_rad": np.full(COUNT, 0.2),
                        "strain_V": 2 * (ring + 0.2 * noise[1]),
                    }
                )
            ),
            (("--ring-down", "fraclink "),),
        ),
        "a frequency response": Shape(
            written(
                table({"freq_rad_s": w, "gain": np.abs(h), "phase_rad": np.angle(h)})
            ),
            (("--structure driven", "fraclink identify"),),
        ),
        "a motor alone": Shape(
            written(table({"t_s": t, "theta_deg": DEG * a})),
            (("record both signals together", ""),),
        ),
    }
