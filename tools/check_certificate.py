"""Check a certificate of fraclink without fraclink: python check_certificate.py FILE LAW.

LAW is what runs on the board: the law_data.h that it was compiled with, which must be byte for byte the text that
`fraclink export c` makes of the block, or the SHA-256 of the block. Exit code 0: proved; 1: rejected. 1 + L(e^{jωT}) must miss (-∞, 0]: then the loop is stable, as its parts are. The tree cuts a box
of frequency and parameters in two at each letter, so its leaves cover it. On a leaf |L| < 1 - m, or a half plane holds
L (or 1/L) and misses the disc about -1 and the ray to its left: an axis whose slope along its normal keeps its sign is
set to its worse end. Exponentials are mpmath's; discs are widened by U of each result, of which floats lose 2^-50.
"""

# fmt: off
import cmath, functools, hashlib, json, math, pathlib, re, struct, sys, zlib
from mpmath import mp
mp.prec, U, TEXT = 64, 2.0**-48, ("block", "digest", "precision", "hold", "motor_loop")
SENTENCES = "f48e28c40d31705b0afdf8cba82fef527642beace0b557a66b29572f7fb9d2d7"  # SHA-256 of the claim's form and of what it assumes
AXES = ["delay", "gauge_gain", "gauge_delay", "order", "loss", "motor", "mode_frequency", "mode_gain"]
ALIASES, (W, Q, LATE, GAIN, GLATE, ORDER, LOSS, MOTOR, MODE, SHARE) = (-1, 1, -2, 2, -3), range(10)  # at ω + 2πn/T; ω, q = 1/ω0², and AXES; MODE is its detuning f/ω, the loss is μ/ω0², the motor's p or A
COUNTS = ["options", "real_modes", "pair_modes", "forward_modes", "bad_limit", "missed_limit", "residual_limit", "stuck_limit", "frozen_limit", "block_limit"]
NAMES = ["period", "compliance", "direct", "real", "pair", "forward_direct", "forward", "sum_limit", "correction_limit", "forward_limit", "angle_limit", "angle_step", "torque_limit", "torque_step", "torque_trip", "torque_block", "reference_step", "reference_rate", "acceleration_limit", "motor_limit", "motor_step", "fade_step", "residual_angle", "motor_now", "motor_next", "motor_keep", "swing_angle", "frozen_angle", "stuck_torque", "stiffness", "wiring_energy", "inner_direct", "inner_angle", "integral_now", "integral_before", "filter_now", "filter_before", "filter_angle_now", "filter_angle_before", "filter_decay", "wanted_limit", "voltage_limit", "torque_voltage", "coulomb_voltage", "coulomb_slope", "link_scale", "payload_scale", "gauge_now", "gauge_keep", "payload_limit", "scale_step"]
ROOM = {"real": 16, "pair": 8, "forward": 16}
sha, disc = lambda content: hashlib.sha256(content).hexdigest(), lambda value: value if isinstance(value, Disc) else Disc(value)
canonical = lambda value: json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")
middle, both = lambda pair: ((pair[0] + pair[1]) / 2,) * 2, lambda a, b: {k: a[k] + b[k] if k in a and k in b else a.get(k) or b[k] for k in a | b}
real = lambda ends, axis: Disc(sum(ends) / 2, (ends[1] - ends[0]) / 2 + U * ends[1], {axis: Disc(1)} if ends[0] < ends[1] else {})
exact = lambda n, *discs: discs if n in (0, -1) else [value.plain() for value in discs]  # small aliases need no slopes
def need(condition, reason):
    if condition is not True: raise ValueError(reason)
class Disc:  # The values within r of c, widened for rounding; `d` has their slopes by axis
    def __init__(self, c, r=0.0, d=()):
        self.c, self.r, self.d, self.most = complex(c), r * (1 + U) + U * abs(c), dict(d), (abs(c) + r) * (1 + 3 * U)
    def __add__(self, b): return Disc(self.c + (b := disc(b)).c, self.r + b.r, both(self.d, b.d))
    def __mul__(self, b):
        if not isinstance(b, Disc): return Disc(self.c * b, self.r * abs(b), {k: x * b for k, x in self.d.items()})
        slopes = both({k: x * b.plain() for k, x in self.d.items()}, {k: x * self.plain() for k, x in b.d.items()}) if self.d or b.d else ()
        return Disc(self.c * b.c, self.most * b.r + abs(b.c) * self.r, slopes)
    def over(self):  # 1/z: the image of a disc is a disc; a disc that holds zero gives the whole plane
        size, gap = abs(self.c), abs(self.c) * (1 - U) - self.r
        if not gap > 0: return Disc(0, math.inf, dict.fromkeys(self.d, Disc(0, math.inf)))
        found = Disc(c := self.c.conjugate() / gap / (size + self.r), self.r / gap / (size + self.r) + 8 * U * size / gap * abs(c))
        return Disc(found.c, found.r, {k: x * found * found * -1 for k, x in self.d.items()})
    def exp(self):
        return Disc((found := Disc(c := complex(mp.exp(self.c)), abs(c) * math.expm1(self.r) if self.r < 50 else math.inf)).c, found.r, {k: x * found for k, x in self.d.items()})
    def closer(self, point, **widths):  # The disc about the value at the middle, where the slopes make it smaller
        return Disc(point.c, r, self.d) if (r := point.r + sum(x.most * widths[f"w{k}"] for k, x in self.d.items()) * (1 + 8 * U)) < self.r else self
    __radd__, __rmul__, __sub__, __rsub__, plain = __add__, __mul__, lambda self, b: self + b * -1, lambda self, b: self * -1 + b, lambda self: Disc(self.c, self.r) if self.d else self
def fields(block, width):  # The numbers of a block by name, in the order of law.h
    reals = iter(struct.unpack(f"<{(len(block) - 56) // width}{'fd'[width == 8]}", block[56:]))
    return dict(zip(COUNTS, struct.unpack("<10I", block[16:56]))) | {k: [next(reals) for _ in range(ROOM[k])] if k in ROOM else next(reals) for k in NAMES}
def law_data(block, version, name):  # law_data.h as `export c` writes it; with -DLAW_REALS the struct is shorter, and so its size and CRC
    width, c = struct.unpack("<I", block[8:12])[0], fields(block, struct.unpack("<I", block[8:12])[0])
    used, each = {k: c[k + "_modes"] for k in ROOM}, {"real": 2, "pair": 4, "forward": 2}
    shorter = block[16:56] + b"".join(struct.pack(f"<{'fd'[width == 8]}", x) for k in NAMES for x in (c[k][: each[k] * used[k]] if k in ROOM else [c[k]]))
    number = lambda x: (lambda m, e: f"{m.split('.')[0]}.{m.partition('.')[2].rstrip('0') or '0'}p{e}" + "F" * (width == 4))(*x.hex().split("p"))
    rows = [f"    .version = {struct.unpack('<I', block[:4])[0]}U,", "#ifdef LAW_EXACT", f"    .size = {16 + len(shorter)}U,", f"    .crc = 0x{zlib.crc32(shorter):08X}U,", "#else"]
    rows += [f"    .size = {len(block)}U,", f"    .crc = 0x{zlib.crc32(block[16:]):08X}U,", "#endif", f"    .precision = {width}U,", *(f"    .{k} = {c[k]}U," for k in COUNTS)]
    for k in NAMES:
        groups = [[number(x) for x in c[k][i : i + each[k]]] for i in range(0, each[k] * used[k], each[k])] if k in ROOM else ()
        if k not in ROOM or groups: rows.append(f"    .{k} = " + ("{" + ", ".join("{" + ", ".join(g) + "}" for g in groups) + "}" if k in ROOM else number(c[k])) + ",")
    differs, flags = " || ".join(f"(LAW_{k.upper()}_MODES != {n}U)" for k, n in used.items()), " ".join(f"-DLAW_{k.upper()}S={n}U" for k, n in used.items() if n)
    kind, no, remedy = ("single", "! ", "with") if width == 4 else ("double", " ", "without")
    return f"""/* Coefficients of the control law: data only, generated by fraclink {version}.
 * law {sha(block)}
 * Reals are hex floats, so that no decimal conversion can round them. */
#ifndef FRACLINK_{name.upper()}_H
#define FRACLINK_{name.upper()}_H

#include "law.h"

#if {no.strip()}{" " if no.strip() else ""}defined(LAW_SINGLE)
#error "this block is in {kind} precision: compile law.c and this file {remedy} -DLAW_SINGLE"
#endif
#if defined(LAW_EXACT) && ({differs})
#error "this block was made for {flags}"
#endif

static const law_params {name} = {{
{chr(10).join(rows)}
}};

#endif
"""
def on_board(law, block):  # Whether a file is the canonical text of this block: a compiler might obey anything else in it, unseen by people
    text = pathlib.Path(law).read_bytes().decode("ascii")
    version, name = (re.search(p, text, re.MULTILINE) for p in (r"^/\* Coefficients of the control law: data only, generated by fraclink ([0-9a-z.+]+)\.$", r"^static const law_params ([A-Za-z]\w{0,30}) = \{$"))
    return None not in (version, name) and text == law_data(block, version[1], name[1])
class Loop:
    def __init__(self, s):
        self.s, self.ideal, numbers = s, s["motor_loop"] == "ideal", [s[k] for k in s if k not in TEXT]
        least = ["softness_low", "lowest", "stiffness", "gauge_gain_low", "payload_low", "modulus", "damping_order"] + (["pole_low"] if self.ideal else ["decay", "gain_low"])
        need(all(0 <= x < 1e300 for x in numbers) and min(s[k] for k in least) > 0, "a number is negative, zero or not finite")
        need(not any(s[k] for k in (("decay", "gain_low", "gain_high") if self.ideal else ("pole_low", "pole_high"))), "a number of the other motor loop")
        need(all(s[k] <= s[k[:-3] + "high"] for k in s if k.endswith("_low")) and s["modulus"] < 1, "an empty range")
        need(max(1, s["damping_order"]) < s["order_low"] and s["order_high"] <= 2 and max(2 - s["order_high"], s["loss_low"]) > 0, "orders or damping of the link")
        need(not s["mode_gain_high"] or (0 < s["mode_damping"] < 1 and s["mode_frequency_low"] > 0), "the second mode")
        need(s["hold"] == "zero-order" and s["motor_loop"] in ("ideal", "sampled"), "another hold or motor loop")
        block, (width, kind) = bytes.fromhex(s["block"]), {"single": (4, "f"), "double": (8, "d")}[s["precision"]]
        need(struct.unpack("<4I", block[:16]) == (4, 56 + (len(NAMES) - 3 + 40) * width, width, zlib.crc32(block[16:])) and len(block) == 56 + (len(NAMES) + 37) * width and sha(block) == s["digest"], "version, size, CRC or hash")
        c, n, p, ahead = fields(block, width), *struct.unpack("<3I", block[20:32])
        need(all(map(math.isfinite, struct.unpack(f"<{(len(block) - 56) // width}{kind}", block[56:]))), "a number is not finite")
        need((c["options"] & ~6) == 1 - self.ideal and n <= 8 and p <= 2 and ahead <= 8 and not any(c["real"][2 * n :] + c["pair"][4 * p :] + c["forward"][2 * ahead :]), "counts of modes, or another motor loop than the claim's")
        pairs = [(complex(x, t * y), complex(g, t * h) / 2) for x, y, g, h in zip(*(c["pair"][k : 4 * p : 4] for k in range(4))) for t in (1, -1)]
        self.modes = [(complex(x), complex(g)) for x, g in zip(c["real"][: 2 * n : 2], c["real"][1 : 2 * n : 2])] + pairs
        need(all(abs(p) < 1 - U for p, _ in self.modes), "a pole of the correction is not stable")
        self.text = s | {"law": s["digest"][:12], "real_modes": n, "pair_modes": p, "period": c["period"], "compliance": c["compliance"]}
        self.T, self.turn, self.direct, self.read, self.B, pid = (T := c["period"]), 2 * math.pi / T, c["direct"], c["compliance"] * s["stiffness"], s["decay"], NAMES.index("inner_direct")
        self.pid, self.whole = [c[k] for k in NAMES[pid : pid + 9]], max(math.ceil(s["delay_high"] / T * (1 - 1e-9)) - 1, 0)
        need(self.ideal or s["delay_low"] >= self.whole * T * (1 - 1e-12), "delays of more than one period")
        self.guards(c, s)
        rest = [(s[k + "_low"], s[k + "_high"]) for k in (*AXES[:5], "pole" if self.ideal else "gain", *AXES[6:])]
        soft = math.nextafter(s["softness_low"] * s["payload_low"], 0), math.nextafter(s["softness_high"] * s["payload_high"], math.inf)
        self.root = ((s["lowest"], math.nextafter(math.pi / T, math.inf) * (1 + U)), soft, *rest[:-2], *([(0.0, math.inf), rest[-1]] if s["mode_gain_high"] else [(0.0, 0.0)] * 2))
        self.root = self.possible(self.root)
        self.start(math.pi / T, *zip(*self.root))
    def possible(self, box):  # A box without the detunings f/ω that no second mode of the claim has; perhaps empty
        ends = max(box[MODE][0], self.s["mode_frequency_low"] / box[W][1] * (1 - 4 * U)), min(box[MODE][1], self.s["mode_frequency_high"] / box[W][0] * (1 + 4 * U))
        return (*box[:MODE], ends, *box[MODE + 1 :])
    def guards(self, c, s):  # The link is the one that the law was made for, and neither a guard nor a filter beside the loop stands in the moves' way
        T, v, a, stiff = self.T, s["velocity"], s["acceleration"], s["stiffness"]
        order, loss, soft = ((s[k + "_low"] + s[k + "_high"]) / 2 for k in ("order", "loss", "softness"))
        need(max(1 - 1e-9, 1 - c["motor_keep"], 1 - c["reference_rate"]) > 0 and s["velocity"] > 0 < s["acceleration"], "no move")
        q, near, read = soft * s["nominal_payload"], -3 * math.log1p(-c["reference_rate"]) / T, c["compliance"] * stiff
        gauge = s["gauge_gain_low"], s["gauge_gain_high"]
        need((abs(read - 1) <= 1e-6 or gauge[0] * (1 - 1e-6) <= 1 / read <= gauge[1] * (1 + 1e-6)) and abs(c["compliance"] * c["stiffness"] - 1) <= 1e-6, "the gauge's compliance is not 1/c of the link, or not of the law's own c")
        terms = [(q * x**order, loss * x ** s["damping_order"]) for x in (cmath.rect(near, math.pi * (0.5 + k / 8000)) for k in range(4001))]
        need(min(abs(1 + a1 + b1) / (1 + abs(a1) + abs(b1)) for a1, b1 in terms) < 1e-3, "the link is not the one that the law was made for")
        norms = [(1 + abs(1 - p) / (1 - abs(p)), abs(g)) for p, g in self.modes]  # limits of the sum, the command, its step; and of each mode
        reach = [min(c["sum_limit"], c["motor_limit"], c["motor_step"] / 2) / (2 * abs(self.direct) + sum(a1 * b1 for a1, b1 in norms)), *(c["correction_limit"] / a1 for a1, _ in norms)]
        need(1e-5 <= s["linear_range"] < min(reach) * (1 - 1e-9), "the limits are too narrow")
        bend = lambda w: q * (1j * w) ** (order - 2) / (1 + loss * (1j * w) ** s["damping_order"])  # 1/G - 1 over s²
        most, held, step = abs(bend(near)) * a, 1.5 * math.pi / near, 3 * v * T
        h = lambda x: c["motor_now"] + c["motor_next"] * x / (1 - c["motor_keep"] * x)
        late, push, slow = 1 / h(1), 2 * stiff * most, abs(bend(near / 1.5))
        least = {"sum_limit": 4 * most + abs(self.direct) * (2 * step + 1.05 * v * T), "correction_limit": 1.5 * (late * T * v + 0.15), "forward_limit": 3 * v / T, "angle_limit": s["angle"] + 2 * most, "angle_step": 2 * step, "torque_limit": push, "torque_step": 2 * stiff * step, "torque_trip": push, "torque_block": 0.95 * s["payload_high"] / s["nominal_payload"] * stiff * slow * min(a, 2 * v / held), "reference_step": 1.05 * v * T, "acceleration_limit": 1.2 * a, "motor_limit": s["angle"], "motor_step": step, "fade_step": min(1, 5 * T), "scale_step": min(1, 10 * T) * (c["payload_limit"] > 0), "frozen_angle": min(4.5 * a * T**2, v * T), "bad_limit": 5, "missed_limit": 5, "residual_limit": 10, "stuck_limit": 10 + s["gauge_delay_low"] // T, "frozen_limit": 8, "block_limit": max(5, round(held / T) - 1), "stuck_torque": 1e-6, "swing_angle": 1e-6, "wiring_energy": 1e-6}
        if not self.ideal: least |= {"voltage_limit": (a + self.B * v) / s["gain_low"], "wanted_limit": c["voltage_limit"] + abs(c["inner_direct"]) * late * step}
        def parted(w):  # the motor loop less its model, over ω
            x, e = cmath.exp(-1j * w * T), math.exp(-self.B * T)
            if self.ideal:
                k = math.exp(-(p := (s["pole_low"] + s["pole_high"]) / 2 * T))
                loop = ((1 - k * (1 + p)) * x + k * (k - 1 + p) * x * x) / (1 - k * x) ** 2 * x ** round(s["delay_high"] / T)
            else:
                d, both, i0, i1, f0, f1, g0, g1, r = self.pid
                first, rest = d + (i0 + i1 * x) / (1 - x) + (f0 + f1 * x) / (1 - r * x), (1 - e) / self.B
                both += first + (g0 + g1 * x) / (1 - r * x)
                motor = (s["gain_low"] + s["gain_high"]) / 2 / self.B * (T - rest + (rest - T * e) * x) * x ** (2 + self.whole) / (1 - x) / (1 - e * x)
                loop = first * motor / (1 + both * motor)
            return abs(loop - h(x) * x / (1 - x + h(x) * x)) / w
        least["residual_angle"] = v * T + v * max(parted(near * k) for k in (0.25, 0.5, 1, 2))
        for k, x in least.items(): need(c[k] >= x * (1 - 1e-4), f"{k} is too small for the moves of the claim")
        poles, n0, k0 = c["forward"][::2], c["motor_now"], c["motor_keep"]
        ahead = lambda z: c["forward_direct"] + sum(g / (z - p) for p, g in zip(poles, c["forward"][1::2]))
        need(max(map(abs, poles)) < 1 and all(abs(ahead(cmath.exp(1j * w * T)) / bend(w) - 1) <= 0.5 * (1 + 1e-6) for w in (near / 2, near)), "the feed-forward is not stable, or not the link's")
        need(abs(w2 := k0 - n0 * k0 + c["motor_next"]) < 1 and abs(n0 - 1 - k0) < 1 + w2, "the motor's model is not stable")
        need(not c["payload_limit"] or 0.5 <= c["link_scale"] + c["payload_scale"] * s["nominal_payload"] <= 1.5, "the feed-forward's scale is not the payload's")
        within = lambda x: gauge[0] * 0.95 * (1 - 1e-6) <= x <= gauge[1] * 1.05 * (1 + 1e-6)
        need(not c["options"] & 2 or (0 <= c["gauge_keep"] < 1 and within(c["gauge_now"] / (1 - c["gauge_keep"]))), "the gauge's model is not the gauge's")
        need(self.ideal or (0 <= c["coulomb_voltage"] <= 1.05 * s["friction"] * (1 + 1e-6) and 0 <= c["coulomb_slope"] <= 1.06 / (0.02 * T)), "the compensation of friction")
        need(self.ideal or c["torque_voltage"] == 0 or (c["torque_voltage"] > 0 and within(s["coupling"] / c["torque_voltage"])), "the compensation of the coupling torque")
    def controllers(self, x):  # y Cm1 and y (Cm1 + Cm2) of the block's PID, as polynomials in y = 1 - x over 1 - r x
        (d, a, i, j, f0, f1, g0, g1, r), y, lag = self.pid, 1 - x, (1 - x * self.pid[8]).over()
        horner = lambda k, n, m: ((i + j) * (1 - r) + y * (k * (1 - r) + (i + j) * r + n + m + y * (k * r - m))) * lag
        return horner(d - j, f0, f1), horner(d + a - j, f0 + g0, f1 + g1)
    def closing(self, x, gain, late, slow):  # X/A of the sampled motor loop: y²/A + y² (Cm1 + Cm2) P/A, P the held motor
        B, T, e = self.B, self.T, math.exp(-self.B * self.T)
        late = late - self.whole * T  # besides whole periods
        held = lambda t: ((t - T) * B).exp() - 1 - (t - T) * B, lambda t: ((t * B).exp() - 1 - t * B) * e
        n0, n2 = (f(late).closer(f(Disc(late.c)), w2=late.r) for f in held)
        both = gain * x * (1 - x * e).over() * (x * (B * T * (1 - e)) + (1 - x) * (n0 - x * n2)) * B**-2
        for _ in range(self.whole): both = both * x
        return (1 - x) * (1 - x) * slow + both
    @functools.cache
    def window(self, count, *ends):  # What frequencies contribute: F at ω and `count` - 1 ALIASES but for delay and motor, what aliases share, x, y (Cm1 + Cm2)
        w, turns, x = real(ends, W), (real(ends, W) * (1j * self.T)).exp(), (real(ends, W) * (-1j * self.T)).exp()
        kernel, (first, gain), most = sum(((turns - p).over() * g for p, g in self.modes), Disc(self.direct)), self.controllers(x), min((1 - x).most, 2)
        shared, alias = kernel * (1 - x) * (1 - x) * (1 / self.T), kernel.most * most**2 / self.T * (1 + 1e-9)
        if not self.ideal: shared, alias = shared * (1 - x) * first, alias * most * first.most
        fronts = [shared * (s if self.ideal else s * s * (s + self.B)).over() for s in ((w + n * self.turn) * 1j for n in (0, *ALIASES)[:count])]
        return [f.closer(at, w0=w.r) for f, at in zip(fronts, self.window(count, *middle(ends))[0])] if ends[0] < ends[1] else fronts, alias, x, gain
    def front(self, box, count):  # F with its slopes, and at ALIASES, 1/F (affine in 1/A, so not formed from F), and the bound of the other aliases of L
        fronts, alias, *motor = self.window(count, *box[W])
        w, late, slow, alias = real(box[W], W), real(box[LATE], LATE), real(box[MOTOR], MOTOR).over(), alias * self.aliases(box)
        rests = [(f * (v * t * -1j).exp(), 1 + v * p * 1j, n) for n, front in zip((0, *ALIASES), fronts) for f, v, t, p in [exact(n, front, w + n * self.turn, late, slow)]]
        if self.ideal: return [f * lag.over() * lag.over() for f, lag, _ in rests], rests[0][0].over() * rests[0][1] * rests[0][1], alias
        point = self.closing(*self.window(1, *middle(box[W]))[2:], Disc(late.c), Disc(middle(box[MOTOR])[0]).over())
        lag = (closing := self.closing(*motor, late, slow).closer(point, w0=w.r, w2=late.r, w7=real(box[MOTOR], MOTOR).r)).over()
        return [f * exact(n, lag)[0] for f, _, n in rests], rests[0][0].over() * closing, alias * lag.most * slow.most
    def aliases(self, box):  # Bound of Σ |F(s_k)/s_k| but for what all share: the nearest at 2π/T - ω where L lacks it, the others
        w, m, late, ends = math.pi / self.T, box[MOTOR][1], box[GLATE][1], box[W]
        near, turn, begin = (2 * w - min(ends[1], w)) * (1 - 1e-9), min(late * (2 * w - ends[0]) * (1 + 1e-9), math.pi), 2 + 4 * (ends[0] >= 0.2 * w)
        terms = sum(t**-3 + 0.25 / (t + 1) ** 2 for t in (begin + ends[0] / w, begin + 2 - min(ends[1] / w, 1)))  # of a convex function: half its integral
        first, rest = self.tip(box, near, turn) / near**3 * (begin == 2), self.tip(box, 2 * w, late and math.pi) * terms / w**3
        return (m * m * (first / (1 + (m / near) ** 2) + rest) if self.ideal else m * (first + rest)) * (1 + 1e-9)
    def tip(self, box, w, turn):  # Bound of |H| from w on, where the gauge's delay turns by `turn` at most: |G|, |1 - E| and |E R|
        gains, drag, ratio = [self.read * x for x in box[GAIN]], box[LOSS][1] * w ** self.s["damping_order"], self.s["mode_frequency_high"] / w
        mode = box[SHARE][1] * (1 / (1 - ratio**2) if ratio < 0.7 else self.peak) + (1 + drag) / (box[Q][0] * w ** box[ORDER][0] - 1 - drag)
        return (math.sqrt(max((1 - g) ** 2 for g in gains) + 4 * gains[1] * math.sin(turn / 2) ** 2) + gains[1] * mode) * (1 + 1e-9)
    def form(self, box, plain, rest=()):  # L or 1/L with its slopes, the bound of the aliases, and, from 0.2 of Nyquist on, the middle of the small aliases (for a point, that of its box)
        count = 1 + 5 * (box[W][0] >= 0.2 * math.pi / self.T) if rest == () else 1 + (rest is not None)
        (fronts, back, alias), alpha, axes = self.front(box, count), self.s["damping_order"], list(map(real, box, range(10)))
        def seen(n):  # log(jv), E, R and what they are made of at v = ω + 2πn/T
            w, q, _, gain, late, order, loss, _, mode, share = exact(n, *axes)
            v, sign, ends = w + n * self.turn, -1 if n < 0 else 1, sorted(abs(end + n * self.turn) for end in box[W])
            span, (a, b), read, second = real(ends, W), map(math.log, ends), (v * late * -1j).exp() * gain * self.read, Disc(0)
            if self.peak:  # the second mode; over wide boxes it may seem to be infinite
                ratio = mode * w * (v * 1j).over() if n else mode * -1j
                second = (1 + ratio * (ratio + 2 * self.s["mode_damping"])).over()
                second = (second if second.r < self.peak else Disc(0, self.peak, second.d)) * share
            return Disc((a + b) / 2 + sign * 0.5j * math.pi, (b - a) / 2 + U * (1 + abs(a)), {k: span.plain().over() * sign for k in v.d}), read, second, q, order, loss
        material = lambda log, loss: 1 + loss * (log * alpha).exp() if self.root[LOSS][1] else Disc(1)
        tip = lambda log, read, second, q, order, loss: 1 - read * ((q.over() * (log * order * -1).exp() * material(log, loss) + 1).over() + second)
        log, read, second, q, order, loss = here = seen(0)
        near = [f * tip(*seen(n)) for f, n in zip(fronts[1:], ALIASES)]
        if rest == (): rest, alias = ((small := sum(near[1:], Disc(0))).c, alias + small.r) if near else (None, alias)
        near = near[0] + rest if near else Disc(0)
        if plain: return fronts[0] * tip(*here) + near, alias, rest
        link = q * (log * order).exp() * material(log, loss).over()
        inverse = back * ((link + 1) * (read + (1 - read * (1 + second)) * (link + 1)).over())
        return inverse * (1 + near * inverse).over() if len(fronts) > 1 else inverse, alias, rest
    def leaf(self, box, plain):  # Whether |L| is small, or L (or 1/L) lies in a half plane that misses everything forbidden
        if box[MODE][0] > box[MODE][1]: return True
        (value, alias, rest), at, loss, unit = self.form(box, plain), [middle(pair) for pair in box], 0.0, lambda v: v / max(abs(v), 1e-300)
        if not ((m := self.s["modulus"] + alias) < 0.99 and math.isfinite(value.r)): return False
        if plain and value.most < 1 - m: return True
        centre, side = 1 / (1 - m * m), math.copysign(1, value.c.imag)  # 1/L must miss a disc about -centre, and what is left of -1 from it to 0
        straight, away, kink = unit(value.c), unit(value.c + (1 if plain else centre)), complex(m, side * math.sqrt(1 - m * m))
        normal = (away if away.real >= 0 else side * 1j) if plain else straight if straight.real >= m else away if away.real <= m else kink
        for axis, slope in value.d.items():
            along, spread, (first, second) = (normal.conjugate() * slope.c).real, slope.r * (1 + U) + 4 * U * abs(slope.c), box[axis]
            if abs(along) >= spread: at[axis] = (first, first) if along > 0 else (second, second)
            else: loss += ((second - first) / 2 + 4 * U * second) * (1 + 4 * U) * (abs(along) + spread)
        point, least = self.form(tuple(at), plain, rest)[0], m - normal.real if plain else max(centre * (m - normal.real), 0.0)
        return (normal.conjugate() * point.c).real - point.r - 4 * U * (1 + abs(point.c)) - loss > least + 1e-9
    def start(self, w, low, high):  # Bound |L| from 0 to the lowest frequency, with all aliases; check the motor loop
        s, T, most, r, e = self.s, self.T, self.read * high[GAIN], self.pid[8], math.exp(-self.B * self.T)
        self.peak = (1 + 1e-9) / (2 * s["mode_damping"] * math.sqrt(1 - s["mode_damping"] ** 2)) if s["mode_gain_high"] else 0.0
        stiff, w, x = low[Q] * w ** low[ORDER] - high[LOSS] * w ** s["damping_order"] - 1, s["lowest"], Disc(1, s["lowest"] * T)
        ratio, soft, kernel = w / s["mode_frequency_low"] if self.peak else 0.0, high[Q] * w ** low[ORDER] + high[LOSS] * w ** s["damping_order"], sum((g * (x - p).over() for p, g in self.modes), Disc(self.direct))
        need(stiff > 0 and max(soft, ratio) < 0.5 and w < 1 < math.pi / T, "the resonance is not between the lowest and the Nyquist frequency")
        bound = kernel.most * w * T * (1 + most * (soft / (1 - soft) + high[SHARE] * ratio**2 / (1 - ratio**2)) + self.aliases(((0.0, self.root[W][1]), *self.root[1:])) * 2 / T)
        if not self.ideal:
            first, gain = self.controllers(x)
            inverse = self.closing(x, gain, real(self.root[LATE], LATE), real(self.root[MOTOR], MOTOR).over()).over()
            bound *= first.most * inverse.most / low[MOTOR] * (T * high[MOTOR] / self.B + 2)
            circle = [Disc(cmath.rect(1, math.pi * k / 8)) for k in range(16)]  # on it, the polynomial (1 - e x)(1 - r x) X/A
            c = [self.closing(x, self.controllers(x)[1], Disc(low[LATE]), Disc(1 / low[MOTOR])) * (1 - x * e) * (1 - x * r) for x in circle]
            c = [sum((v * circle[-k * i % 16] for i, v in enumerate(c)), Disc(0)).c.real / 16 for k in range(6 + self.whole)]
            while len(c) > 1:  # Schur-Cohn; for every other delay and gain each leaf shows X != 0 on its arc
                need(abs(c[0]) * (1 - 1e-9) > abs(c[-1]), "the motor loop is not stable at the shortest delay")
                c = [c[i] - c[-1] / c[0] * c[-1 - i] for i in range(len(c) - 1)]
        need(bound * (1 + 1e-9) < 1 - s["modulus"], "|L| is not small at low frequency")
def check(path, law=None):
    need(law is not None, "nothing is proved without the law on the board: give law_data.h or its SHA-256")
    data = json.loads(pathlib.Path(path).read_text("utf-8"), object_pairs_hook=lambda pairs: dict(pairs) if len(dict(pairs)) == len(pairs) else {})
    signed, said, proof = sha(canonical({k: data[k] for k in data if k not in ("sha256", "tool")})), data["summary"], data["content"]
    need((data["fraclink"], data["format"], data["sha256"]) == ("certificate", 6, signed), "not a certificate of format 6, or its hash is wrong")
    need(sha(canonical([said["form"], said["assumed"]])) == SENTENCES, "claim or assumptions of another form")
    s, tree = {k: v if k in TEXT else float.fromhex(v) for k, v in proof["statement"].items()}, proof["tree"]
    need(len(s) == 40 and tree.count(".") + tree.count(",") == proof["leaves"], "another number of fields or of leaves")
    need(law == s["digest"] if re.fullmatch("[0-9a-f]{64}", law) else on_board(law, bytes.fromhex(s["block"])), "it is about another law than the one on the board, or law_data.h is not as it was exported")
    stack, letters = [((loop := Loop(s)).root, 0, True)], iter(tree)
    need(said["claim"] == said["form"].format(**loop.text), "the claim is not the statement")
    while stack:
        box, extra, plain = stack.pop()
        box = loop.possible(box)
        axis, plain = (10, plain) if extra else ("wmtgdoupfa.,".find(letter := next(letters, "?")), letter == ".")
        need(axis >= 0, "the tree ends early or has another letter")
        if axis >= 10:
            if loop.leaf(box, plain): continue
            need(extra < 8, f"a leaf is not proved: {box}")  # cut again: other arithmetic rounds elsewhere
            wide = [(b - a) * box[W][1] if k in (LATE, GLATE) else (b - a) / (a + b or 1) for k, (a, b) in enumerate(box)]
            axis, extra = wide.index(max(wide)), extra + 1
        (a, b), cut = box[axis], math.sqrt(math.prod(box[axis])) if axis == 0 else sum(box[axis]) / 2
        stack += [((*box[:axis], half, *box[axis + 1 :]), extra, plain) for half in ((cut, b), (a, cut))]
    need(next(letters, None) is None, "the tree goes on after its last leaf")
    return said["claim"]
if __name__ == "__main__":
    try:
        print("PROVED:", check(*sys.argv[1:]))
    except (ValueError, KeyError, TypeError, OSError, ArithmeticError, AttributeError, struct.error) as error:
        sys.exit(f"REJECTED: {error!r:.300}")
