"""The law: what a period costs from Python, in plain C and without guards; orders,
exactness at DC.

Times are CPU seconds, interleaved in one run, ratios of medians. The plain C program is
the package's own loop.c, normal.c and law.c, compiled by gcc with the package's flags;
"without guards" replaces law_step by its own parts without a single check.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import fraclink as fl
from fraclink._export import export_c
from fraclink._law import Law, discretize_controller, equip
from fraclink._law.discretization import fit_correction
from fraclink._simulate.kernel import LumpedArms, run_lumped, shared_rig
from fraclink._simulate.links import LinkWeights, link_weights

ROOT = Path(__file__).resolve().parents[1]
RIG = fl.Rig.named("paper-2023")
PERIODS, ROUNDS = 200_000, 7
KERNEL = (
    "-O3",
    "-ffp-contract=off",
    "-fopenmp-simd",
    "-fno-math-errno",
    "-fno-trapping-math",
)

BARE = """
#include "law.c"
#include "law_data.h"
/* The same law without guards: no credibility, no counters, no limits, no clock. */
static void bare_step(law_state *s, const law_params *p, const law_input *in, law_output *out)
{
    law_real found = (law_real)0;
    law_real left = (law_real)0;
    const law_real forward = feed_forward(s, p, &found, in->reference_acceleration, &left);
    s->motor_angle = in->motor_angle;
    s->torque = in->torque;
    s->model_angle += p->residual_rate * (s->model_near - s->model_angle);
    s->model_near += p->residual_rate * (s->motor_reference - s->model_near);
    out->tip_estimate = s->motor_angle - (s->torque * p->compliance);
    out->error = in->reference - out->tip_estimate;
    s->motor_reference = in->reference + (forward + correct(s, p, &found, out->error - s->error, &left));
    s->error = out->error;
    (void)close_motor(s, p, out);
    out->motor_reference = s->motor_reference;
    out->voltage = s->voltage;
    out->mode = LAW_RUN;
    out->reason = LAW_OK;
    out->flags = 0U;
}
#ifdef WITHOUT_GUARDS
#define law_step bare_step
#endif
#include "law_port.c"
#include "loop.c"
#include "normal.c"
#include "weights.c"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
int main(int count, char **words)
{
    FILE *const file = fopen(words[1], "rb");
    int sizes[3];
    loop_rig rig;
    loop_link link = {0};
    if (count < 2 || file == NULL || fread(sizes, sizeof(sizes), 1, file) != 1 || fread(&rig, sizeof(rig), 1, file) != 1)
        return 1;
    const int n = sizes[0], m = sizes[1], total = sizes[2];
    const size_t words_in = (size_t)(LOOP_POWERS + 1 + 7 * n + 14 * m + 2 * total);
    double *const data = malloc(words_in * sizeof(double));
    if (fread(data, sizeof(double), words_in, file) != words_in)
        return 2;
    double *next = data + LOOP_POWERS + 1;
    link.reals = n;
    link.pairs = m;
    for (int j = 0; j < LOOP_POWERS; j++)
        link.first[j] = data[j];
    link.stiffness = data[LOOP_POWERS];
    link.decay = next; next += n;
    link.weight = next; next += 6 * n;
    link.pair_re = next; next += m;
    link.pair_im = next; next += m;
    link.weight_re = next; next += 6 * m;
    link.weight_im = next; next += 6 * m;
    double *const normal = malloc(sizeof(double) * (size_t)total);
    const loop_input path = {total, next, next + total, normal, NULL};
    double *const o = malloc(sizeof(double) * 8 * (size_t)total);
    uint32_t *const f = malloc(sizeof(uint32_t) * 3 * (size_t)total);
    const loop_trace trace = {o, o + total, o + 2 * total, o + 3 * total, o + 4 * total, o + 5 * total, o + 6 * total,
                              o + 7 * total, f, f + total, f + 2 * total};
    const clock_t begin = clock();
    rig.weights = loop_weights_of(&rig);
    loop_normals(1, normal, total);
    (void)loop_run(&link, &rig, &LAW_IN_DOUBLE, &law_data, &path, &trace);
    printf("%.9f %.17g\\n", (double)(clock() - begin) / CLOCKS_PER_SEC, o[total - 1]);
    return 0;
}
"""  # noqa: E501


def figure(name: str, value: str, wanted: str, good: bool, error: str = "") -> None:
    note = f"  ({error})" if error else ""
    print(f"{'ok  ' if good else 'MISS'} {name:<52} {value:<28} wanted {wanted}{note}")


def fit_time() -> None:
    controller = fl.design(
        RIG.model, RIG, gain_crossover=12.0, phase_margin=fl.deg(50), law=False
    ).controller
    taken = []
    for _ in range(5):
        fit_correction.cache_clear()
        begin = time.process_time()
        made = discretize_controller(controller, RIG.period)
        taken.append(time.process_time() - begin)
    figure(
        "fit of a law, CPU time",
        f"{min(taken):.3f} s",
        "<= 0.1 s",
        min(taken) <= 0.1,
        f"order {made.order}",
    )


def default_law(precision: str = "double") -> Law:
    controller = fl.Controller(gain=0.069876, order=0.612197, link=RIG.model)
    made = discretize_controller(controller, RIG.period)
    assert RIG.model is not None
    return equip(made, RIG, RIG.model).in_precision(precision)  # type: ignore[arg-type]


def accuracy() -> None:
    for delta, wanted in ((0.16, 4), (0.016, 6)):
        controller = fl.Controller(
            gain=0.148, order=0.65, filter_time=delta, filter_order=2, link=RIG.model
        )
        made = discretize_controller(controller, RIG.period, band=(0.05, 600.0))
        db, deg = made.correction_error
        figure(
            f"order of Ĉ, δ = {delta} s, to 600 rad/s", str(made.order), f"<= {wanted}",
            made.order <= wanted and db <= 0.1 and deg <= 0.5, f"{db:.3f} dB, {deg:.3f}°",
        )  # fmt: skip
    made = default_law()
    db, deg = made.correction_error
    figure(
        "order of Ĉ, default design, to 300 rad/s",
        str(made.order),
        "printed",
        True,
        f"{db:.3f} dB, {deg:.3f}°",
    )
    bare = discretize_controller(
        fl.Controller(gain=0.069876, order=0.612197, link=RIG.model), RIG.period
    )
    rows = np.zeros((4, 50_000))
    rows[3, 10:] = 0.078
    last = [
        float(law.run(law.initial_state(), *rows)[1].motor_reference[-1])
        for law in (bare, bare.in_precision("single"))
    ]
    figure(
        "Ĉ of a constant error, double and single",
        str(last),
        "exactly 0",
        last == [0.0, 0.0],
    )


def _inputs(law: Law) -> tuple[object, ...]:
    assert RIG.model is not None
    weights = link_weights(RIG.model, law.period, PERIODS * law.period)
    time_axis = law.period * np.arange(PERIODS)
    reference = np.ascontiguousarray(
        [0.2 * np.sin(time_axis), 0.2 * np.cos(time_axis), -0.2 * np.sin(time_axis)]
    )
    return weights, reference


def _rig(**changed: object) -> dict[str, object]:
    motor = RIG.motor
    return {
        "sampled": True, "substeps": 10, "delay": 1, "period": RIG.period, "pole": 80.0, "gain": motor.gain,
        "decay": motor.decay, "friction": motor.coulomb_torque / motor.inertia, "coupling": 0.0,
        "encoder": RIG.encoder.resolution, "offset": 0.01, "noise": 0.01, "limit": 4.0, "quantum": RIG.gauge.quantum,
        "gauge_delay": 0.0, "gauge_gain": 1.0, "payload": 0.0, "start": 0.0,
    } | changed  # fmt: skip


def from_python(
    law: Law, weights: LinkWeights, reference: np.ndarray
) -> tuple[float, float]:
    r = _rig()
    numbers = {
        name: np.array([float(r[name])])
        for name in ("noise", "gauge_delay", "gauge_gain")
    }
    numbers["payload_given"] = np.array([float(r["payload"])])
    arm = LumpedArms(
        links=weights, stiffness=np.array([1.56]), motor_gain=np.array([r["gain"]]),
        motor_decay=np.array([r["decay"]]), friction=np.array([r["friction"]]),
        gauge_offset=np.array([r["offset"]]), delay_samples=np.array([1.0]), amplitude=np.array([1.0]),
        seed=np.array([1], dtype=np.uint64), **numbers,
    )  # fmt: skip
    shared = shared_rig(
        replace(RIG, gauge=replace(RIG.gauge, limit=4.0)), law, "sampled"
    )
    first = np.zeros(1, dtype=np.int32)
    begin = time.process_time()
    signals, _ = run_lumped(
        law, shared, arm, reference[None, [0, 2]], first, everything=True
    )
    return time.process_time() - begin, float(signals[0, 0, -1])


def _written(folder: Path, weights: object, reference: np.ndarray) -> Path:
    import struct

    w, r = weights, _rig()
    rig = struct.pack(
        "<iii4x15d24x", int(bool(r["sampled"])), r["substeps"], r["delay"],
        *(float(r[k]) for k in ("period", "pole", "gain", "decay", "friction", "coupling", "encoder", "offset",
                                "noise", "limit", "quantum", "gauge_delay", "gauge_gain", "payload", "start")),
    )  # fmt: skip
    parts = [
        w.first,
        [1.56],
        w.decay,
        w.weight,
        w.pair.real,
        w.pair.imag,
        w.pair_weight.real,
        w.pair_weight.imag,
    ]
    flat = np.concatenate(
        [np.ravel(part) for part in (*parts, reference[0], reference[2])]
    )
    place = folder / "loop.bin"
    sizes = struct.pack("<iii", w.decay.size, w.pair.size, PERIODS)
    place.write_bytes(sizes + rig + flat.astype("<f8").tobytes())
    return place


def speed() -> None:
    law = default_law()
    weights, reference = _inputs(law)
    gcc = shutil.which("gcc")
    if gcc is None:
        figure(
            "a period from Python against plain C",
            "gcc is not installed",
            "<= 1.1",
            False,
        )
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        export_c(law, folder / "law")
        (folder / "bench.c").write_text(BARE, encoding="utf-8")
        data = _written(folder, weights, reference)
        include = (
            f"-I{folder / 'law'}",
            f"-I{ROOT / 'csrc'}",
            f"-I{ROOT / 'csrc' / 'kernels'}",
        )
        for name, define in (("guarded", "-DGUARDED"), ("bare", "-DWITHOUT_GUARDS")):
            command = [
                gcc,
                "-std=c11",
                *KERNEL,
                define,
                "-DWITHOUT_ESTIMATOR",
                *include,
                "bench.c",
                "-lm",
                "-o",
                name,
            ]
            subprocess.run(command, cwd=folder, check=True, capture_output=True)  # noqa: S603
        times: dict[str, list[float]] = {"python": [], "guarded": [], "bare": []}
        ends: dict[str, float] = {}
        for _ in range(ROUNDS):
            seconds, ends["python"] = from_python(law, weights, reference)  # type: ignore[arg-type]
            times["python"].append(seconds)
            for name in ("guarded", "bare"):
                answer = subprocess.run(  # noqa: S603
                    [folder / name, data], check=True, capture_output=True, text=True
                ).stdout.split()
                times[name].append(float(answer[0]))
                ends[name] = float(answer[1])
    middle = {name: statistics.median(values) for name, values in times.items()}
    apart = abs(ends["python"] - ends["guarded"])
    each = ", ".join(
        f"{name} {1e9 * value / PERIODS:.0f} ns" for name, value in middle.items()
    )
    plain, without = (
        middle["python"] / middle["guarded"],
        middle["python"] / middle["bare"],
    )
    figure(
        "a period from Python / plain C",
        f"{plain:.2f}",
        "<= 1.1",
        plain <= 1.1,
        f"{each}; tips differ {apart:.1e}",
    )
    figure(
        "a period from Python / plain C without guards",
        f"{without:.2f}",
        "<= 2",
        without <= 2.0,
        each,
    )


def main() -> None:
    accuracy()
    fit_time()
    speed()


if __name__ == "__main__":
    main()
