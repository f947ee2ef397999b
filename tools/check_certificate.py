"""Check a certificate of fraclink without fraclink: python check_certificate.py FILE LAW.

LAW is what runs on the board: the law_data.h that it was compiled with, or the SHA-256 of its block. Exit code 0:
proved; 1: rejected. 1 + L(e^{jωT}) must miss (-∞, 0]: then the loop is stable, as its parts are. The tree cuts a box
of frequency and parameters in two at each letter, so its leaves cover it. On a leaf |L| < 1 - m, or a half plane holds
L (or 1/L) and misses the disc about -1 and the ray to its left: an axis whose slope along its normal keeps its sign is
set to its worse end. Exponentials are mpmath's; discs are widened by U of each result, of which floats lose 2^-50.
"""

# fmt: off
import cmath, functools, hashlib, json, math, pathlib, re, struct, sys, zlib
from mpmath import mp
mp.prec, U, TEXT = 64, 2.0**-48, ("block", "digest", "precision", "hold", "motor_loop")
SENTENCES = "392b757ba1143c99dd5d7f965f0f2e81e03e19e06e75b86198866cee94507853"  # SHA-256 of the claim's form and of what it assumes
AXES = ["delay", "gauge_gain", "gauge_delay", "order", "damping", "motor", "mode_frequency", "mode_gain"]
ALIASES, (W, Q, LATE, GAIN, GLATE, ORDER, DAMP, MOTOR, MODE, SHARE) = (-1, 1, -2, 2, -3), range(10)  # at ω + 2πn/T; ω, q = 1/ω0², and AXES; the motor's is p or A
sha, disc = lambda content: hashlib.sha256(content).hexdigest(), lambda value: value if isinstance(value, Disc) else Disc(value)
canonical = lambda value: json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
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
def board(law):  # SHA-256 of the block on the board: of law_data.h, packed once more as law.h lays it out
    found = dict(re.findall(r"^ +\.(\w+) = (.+),$", pathlib.Path(law).read_text("utf-8"), re.MULTILINE))
    version, length, crc, width, *counts = (int(v[:-1], 0) for v in found.values() if v[-1] == "U")  # of size and crc the last
    rows = {k: [float.fromhex(x) for x in re.findall(r"-?0x[\w.]+p[+-]?\d+", v)] for k, v in found.items()}
    room = {"period": 1, "compliance": 1, "direct": 1, "real": 16, "pair": 8, "forward_direct": 1, "forward": 16}
    flat = [x for k in [*room, *(k for k in [*rows][14:] if k not in room)] for x in (rows.get(k, []) + [0.0] * room.get(k, 1))[: room.get(k, 1)]]
    return sha(struct.pack(f"<14I{len(flat)}{'fd'[width == 8]}", version, length, width, crc, *counts, *flat))
class Loop:
    def __init__(self, s):
        self.s, self.ideal, numbers = s, s["motor_loop"] == "ideal", [s[k] for k in s if k not in TEXT]
        least = ["softness_low", "lowest", "stiffness", "gauge_gain_low", "payload_low", "modulus", "damping_order"] + (["pole_low"] if self.ideal else ["decay", "gain_low"])
        need(all(0 <= x < 1e300 for x in numbers) and min(s[k] for k in least) > 0, "a number is negative, zero or not finite")
        need(all(s[k] <= s[k[:-3] + "high"] for k in s if k.endswith("_low")) and s["modulus"] < 1, "an empty range")
        need(max(1, s["damping_order"]) < s["order_low"] and s["order_high"] <= 2 and max(2 - s["order_high"], s["damping_low"]) > 0, "orders or damping of the link")
        need(not s["mode_gain_high"] or (0 < s["mode_damping"] < 1 and s["mode_frequency_low"] > 0), "the second mode")
        need(s["hold"] == "zero-order" and s["motor_loop"] in ("ideal", "sampled"), "another hold or motor loop")
        block, (width, kind) = bytes.fromhex(s["block"]), {"single": (4, "f"), "double": (8, "d")}[s["precision"]]
        need(struct.unpack("<4I", block[:16]) == (2 + (len(block) > 56 + 79 * width), len(block), width, zlib.crc32(block[16:])) and sha(block) == s["digest"], "version, size, CRC or hash")
        options, n, p, ahead, *guards = struct.unpack("<10I", block[16:56])
        c = [x for x, in struct.iter_unpack("<" + kind, block[56:])]  # law.h; from 79 on what a payload changes, outside the loop
        need(all(map(math.isfinite, c)) and min(*guards, *c[44:65]) > 0, "a number is not finite, or a limit not > 0")
        need((options & ~2) in (1, 1 - self.ideal) and n <= 8 and p <= 2 and ahead <= 8 and not any(c[3 + 2 * n : 19] + c[19 + 4 * p : 27]), "counts of modes, or a law that closes no motor loop")
        pairs = [(complex(x, t * y), complex(g, t * h) / 2) for x, y, g, h in zip(*(c[19 + k : 19 + 4 * p : 4] for k in range(4))) for t in (1, -1)]
        self.modes = [(complex(x), complex(g)) for x, g in zip(c[3 : 3 + 2 * n : 2], c[4 : 4 + 2 * n : 2])] + pairs
        need(all(abs(p) < 1 - U for p, _ in self.modes), "a pole of the correction is not stable")
        self.text = s | {"law": s["digest"][:12], "real_modes": n, "pair_modes": p, "period": c[0], "compliance": c[1]}
        self.T, self.turn, self.direct, self.pid, self.read, self.B = c[0], 2 * math.pi / c[0], c[2], c[65:74], c[1] * s["stiffness"], s["decay"]
        self.guards(c, s)
        rest = [(s[k + "_low"], s[k + "_high"]) for k in (*AXES[:5], "pole" if self.ideal else "gain", *AXES[6:])]
        soft = math.nextafter(s["softness_low"] * s["payload_low"], 0), math.nextafter(s["softness_high"] * s["payload_high"], math.inf)
        self.root = ((s["lowest"], math.nextafter(math.pi / c[0], math.inf) * (1 + U)), soft, *rest[:-2], *(rest[-2:] if s["mode_gain_high"] else [(0.0, 0.0)] * 2))
        self.start(math.pi / c[0], *zip(*self.root))
    def guards(self, c, s):  # The gauge is the link's, the limits leave room, and the link is the one that they were made for
        order, damping, soft = ((s[k + "_low"] + s[k + "_high"]) / 2 for k in ("order", "damping", "softness"))
        bent, q = c[1] * s["stiffness"], soft * s["nominal_payload"]  # the deflection the law computes over the true one, 1/ω0²
        near = abs(bent - 1) <= 1e-6 or s["gauge_gain_low"] * (1 - 1e-6) <= 1 / bent <= s["gauge_gain_high"] * (1 + 1e-6)
        need(near and abs(c[1] * c[63] - 1) <= 1e-6, "the gauge's compliance is not 1/c of the link, or not of the law's own c")
        norms = [(1 + abs(1 - p) / (1 - abs(p)), abs(g)) for p, g in self.modes]  # limits of the sum, the command, its step; and of each mode
        reach = [min(c[44], c[56], c[57] / 2) / (2 * abs(self.direct) + sum(a * b for a, b in norms)), *(c[45] / a for a, _ in norms)]
        need(1e-5 <= s["linear_range"] < min(reach) * (1 - 1e-9), "the limits are too narrow")
        pole, near = -math.log1p(-c[60]) / c[0], -3 * math.log1p(-c[54]) / c[0]  # of the motor, and of the link, that the limits were made for
        need(not self.ideal or s["pole_low"] * (1 - 1e-5) <= pole <= s["pole_high"] * (1 + 1e-5), "another motor loop")
        terms = [(q * x**order, q * damping * x ** s["damping_order"]) for x in (cmath.rect(near, math.pi * (0.5 + k / 8000)) for k in range(4001))]
        need(min(abs(1 + a + b) / (1 + abs(a) + abs(b)) for a, b in terms) < 1e-3, "the link is not the one that the law was made for")
    def controllers(self, x):  # y Cm1 and y (Cm1 + Cm2) of the block's PID, as polynomials in y = 1 - x over 1 - r x
        (d, a, i, j, f0, f1, g0, g1, r), y, lag = self.pid, 1 - x, (1 - x * self.pid[8]).over()
        horner = lambda k, n, m: ((i + j) * (1 - r) + y * (k * (1 - r) + (i + j) * r + n + m + y * (k * r - m))) * lag
        return horner(d - j, f0, f1), horner(d + a - j, f0 + g0, f1 + g1)
    def closing(self, x, gain, late, slow):  # X/A of the sampled motor loop: y²/A + y² (Cm1 + Cm2) P/A, P the held motor
        B, T, e = self.B, self.T, math.exp(-self.B * self.T)
        held = lambda t: ((t - T) * B).exp() - 1 - (t - T) * B, lambda t: ((t * B).exp() - 1 - t * B) * e
        n0, n2 = (f(late).closer(f(Disc(late.c)), w2=late.r) for f in held)
        return (1 - x) * (1 - x) * slow + gain * x * (1 - x * e).over() * (x * (B * T * (1 - e)) + (1 - x) * (n0 - x * n2)) * B**-2
    @functools.cache
    def window(self, count, *ends):  # What frequencies contribute: F at ω and `count` - 1 ALIASES but for delay and motor, what aliases share, x, y (Cm1 + Cm2)
        w, turns, x = real(ends, W), (real(ends, W) * (1j * self.T)).exp(), (real(ends, W) * (-1j * self.T)).exp()
        kernel, (first, gain), most = sum(((turns - p).over() * g for p, g in self.modes), Disc(self.direct)), self.controllers(x), min((1 - x).most, 2)
        shared, alias = kernel * (1 - x) * (1 - x) * (1 / self.T), kernel.most * most**2 / self.T * (1 + 1e-9)
        if not self.ideal: shared, alias = shared * (1 - x) * first, alias * most * first.most
        fronts = [shared * (s if self.ideal else s * s * (s + self.B)).over() for s in ((w + n * self.turn) * 1j for n in (0, *ALIASES)[:count])]
        return [f.closer(at, w0=w.r) for f, at in zip(fronts, self.window(count, *middle(ends))[0])] if ends[0] < ends[1] else fronts, alias, x, gain
    def front(self, box, count):  # F with its slopes, and at ALIASES, and the bound of the other aliases of L
        fronts, alias, *motor = self.window(count, *box[W])
        w, late, slow, alias = real(box[W], W), real(box[LATE], LATE), real(box[MOTOR], MOTOR).over(), alias * self.aliases(box)
        rests = [(f * (v * t * -1j).exp(), (1 + v * p * 1j).over(), n) for n, front in zip((0, *ALIASES), fronts) for f, v, t, p in [exact(n, front, w + n * self.turn, late, slow)]]
        if self.ideal: return [f * lag * lag for f, lag, _ in rests], alias
        point = self.closing(*self.window(1, *middle(box[W]))[2:], Disc(late.c), Disc(middle(box[MOTOR])[0]).over())
        lag = self.closing(*motor, late, slow).closer(point, w0=w.r, w2=late.r, w7=real(box[MOTOR], MOTOR).r).over()
        return [f * exact(n, lag)[0] for f, _, n in rests], alias * lag.most * slow.most
    def aliases(self, box):  # Bound of Σ |F(s_k)/s_k| but for what all share: the nearest at 2π/T - ω where L lacks it, the others
        w, m, late, ends = math.pi / self.T, box[MOTOR][1], box[GLATE][1], box[W]
        near, turn, begin = (2 * w - min(ends[1], w)) * (1 - 1e-9), min(late * (2 * w - ends[0]) * (1 + 1e-9), math.pi), 2 + 4 * (ends[0] >= 0.2 * w)
        terms = sum(t**-3 + 0.25 / (t + 1) ** 2 for t in (begin + ends[0] / w, begin + 2 - min(ends[1] / w, 1)))  # of a convex function: half its integral
        first, rest = self.tip(box, near, turn) / near**3 * (begin == 2), self.tip(box, 2 * w, late and math.pi) * terms / w**3
        return (m * m * (first / (1 + (m / near) ** 2) + rest) if self.ideal else m * (first + rest)) * (1 + 1e-9)
    def tip(self, box, w, turn):  # Bound of |H| from w on, where the gauge's delay turns by `turn` at most: |G|, |1 - E| and |E R|
        gains, drag, ratio = [self.read * x for x in box[GAIN]], box[Q][0] * box[DAMP][1] * w ** self.s["damping_order"], box[MODE][1] / w
        mode = box[SHARE][1] * (1 / (1 - ratio**2) if ratio < 0.7 else self.peak) + (1 + drag) / (box[Q][0] * w ** box[ORDER][0] - 1 - drag)
        return (math.sqrt(max((1 - g) ** 2 for g in gains) + 4 * gains[1] * math.sin(turn / 2) ** 2) + gains[1] * mode) * (1 + 1e-9)
    def form(self, box, plain, rest=()):  # L or 1/L with its slopes, the bound of the aliases, and from 0.2 of Nyquist on the middle of the small ones, of a point its box's
        count = 1 + 5 * (box[W][0] >= 0.2 * math.pi / self.T) if rest == () else 1 + (rest is not None)
        (fronts, alias), alpha, axes = self.front(box, count), self.s["damping_order"], list(map(real, box, range(10)))
        def seen(n):  # log(jv), E, R and what they are made of at v = ω + 2πn/T
            w, q, _, gain, late, order, damping, _, mode, share = exact(n, *axes)
            v, sign, ends = w + n * self.turn, -1 if n < 0 else 1, sorted(abs(end + n * self.turn) for end in box[W])
            span, (a, b), read, second = real(ends, W), map(math.log, ends), (v * late * -1j).exp() * gain * self.read, Disc(0)
            if self.peak:  # the second mode; over wide boxes it may seem to be infinite
                second = (1 + mode * (v * 1j).over() * (mode * (v * 1j).over() + 2 * self.s["mode_damping"])).over()
                second = (second if second.r < self.peak else Disc(0, self.peak, second.d)) * share
            return Disc((a + b) / 2 + sign * 0.5j * math.pi, (b - a) / 2 + U * (1 + abs(a)), {k: span.plain().over() * sign for k in v.d}), read, second, q, order, damping
        tip = lambda log, read, second, q, order, damping: 1 - read * ((q.over() * (log * order * -1).exp() + (damping * (log * (alpha - order)).exp() if self.root[DAMP][1] else 0) + 1).over() + second)
        log, read, second, q, order, damping = here = seen(0)
        near = [f * tip(*seen(n)) for f, n in zip(fronts[1:], ALIASES)]
        if rest == (): rest, alias = ((small := sum(near[1:], Disc(0))).c, alias + small.r) if near else (None, alias)
        near = near[0] + rest if near else Disc(0)
        if plain: return fronts[0] * tip(*here) + near, alias, rest
        link = q * (log * order).exp() * ((1 + q * damping * (log * alpha).exp()).over() if self.root[DAMP][1] else 1)
        inverse = fronts[0].over() * ((link + 1) * (read + (1 - read * (1 + second)) * (link + 1)).over())
        return inverse * (1 + near * inverse).over() if len(fronts) > 1 else inverse, alias, rest
    def leaf(self, box, plain):  # Whether |L| is small, or L (or 1/L) lies in a half plane that misses everything forbidden
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
        stiff, w, x = low[Q] * (w ** low[ORDER] - high[DAMP] * w ** s["damping_order"]) - 1, s["lowest"], Disc(1, s["lowest"] * T)
        ratio, soft, kernel = w / low[MODE] if self.peak else 0.0, high[Q] * (w ** low[ORDER] + high[DAMP] * w ** s["damping_order"]), sum((g * (x - p).over() for p, g in self.modes), Disc(self.direct))
        need(stiff > 0 and max(soft, ratio) < 0.5 and w < 1 < math.pi / T, "the resonance is not between the lowest and the Nyquist frequency")
        bound = kernel.most * w * T * (1 + most * (soft / (1 - soft) + high[SHARE] * ratio**2 / (1 - ratio**2)) + self.aliases(((0.0, self.root[W][1]), *self.root[1:])) * 2 / T)
        if not self.ideal:
            first, gain = self.controllers(x)
            inverse = self.closing(x, gain, real(self.root[LATE], LATE), real(self.root[MOTOR], MOTOR).over()).over()
            bound *= first.most * inverse.most / low[MOTOR] * (T * high[MOTOR] / self.B + 2)
            circle = [Disc(cmath.rect(1, math.pi * k / 4)) for k in range(8)]  # on it, the polynomial (1 - e x)(1 - r x) X/A
            c = [self.closing(x, self.controllers(x)[1], Disc(low[LATE]), Disc(1 / low[MOTOR])) * (1 - x * e) * (1 - x * r) for x in circle]
            c = [sum((v * circle[-k * i % 8] for i, v in enumerate(c)), Disc(0)).c.real / 8 for k in range(6)]
            while len(c) > 1:  # Schur-Cohn; for every other delay and gain each leaf shows X != 0 on its arc
                need(abs(c[0]) * (1 - 1e-9) > abs(c[-1]), "the motor loop is not stable at the shortest delay")
                c = [c[i] - c[-1] / c[0] * c[-1 - i] for i in range(len(c) - 1)]
        need(bound * (1 + 1e-9) < 1 - s["modulus"], "|L| is not small at low frequency")
def check(path, law=None):
    need(law is not None, "nothing is proved without the law on the board: give law_data.h or its SHA-256")
    data = json.loads(pathlib.Path(path).read_text("utf-8"), object_pairs_hook=lambda pairs: dict(pairs) if len(dict(pairs)) == len(pairs) else {})
    signed = sha(canonical({k: data[k] for k in ("assumed", "claim", "form", "statement", "tree")}))
    need((data["fraclink"], data["format"], data["sha256"]) == ("certificate", 3, signed), "not a certificate of format 3, or its hash is wrong")
    need(sha(canonical([data["form"], data["assumed"]])) == SENTENCES, "claim or assumptions of another form")
    s, tree = {k: v if k in TEXT else float.fromhex(v) for k, v in data["statement"].items()}, data["tree"]
    need(len(s) == 35 and tree.count(".") + tree.count(",") == data["leaves"], "another number of fields or of leaves")
    need((law if re.fullmatch("[0-9a-f]{64}", law) else board(law)) == s["digest"], "it is about another law than the one on the board")
    stack, letters = [((loop := Loop(s)).root, 0, True)], iter(tree)
    need(data["claim"] == data["form"].format(**loop.text), "the claim is not the statement")
    while stack:
        box, extra, plain = stack.pop()
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
    return data["claim"]
if __name__ == "__main__":
    try:
        print("PROVED:", check(*sys.argv[1:]))
    except (ValueError, KeyError, TypeError, OSError, ArithmeticError, AttributeError, struct.error) as error:
        sys.exit(f"REJECTED: {error!r:.300}")
