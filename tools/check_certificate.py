"""Check a certificate of fraclink without fraclink: python check_certificate.py FILE LAW.

LAW is what runs on the board: the law_data.h that it was compiled with, or the SHA-256 of its block.
Exit code 0: proved; 1: rejected. 1 + L(e^{jωT}) must miss (-∞, 0]: then the loop is stable, as its parts are.
The tree cuts the box of (ω, payload, delay) in two at each w, m, t: its leaves cover it whatever it says. On
a leaf |L| < 1 - m, or the rectangle around 1/L misses [-1, 0) and the disc that |1 + L| <= m is for 1/L.
Aliases are bounded by ζ(3) times their first term and added to m. See docs/how-to/read-a-certificate.md.
"""

# ruff: noqa: B019, B905, E401, E501, E731, I001
# fmt: off
import cmath, functools, hashlib, json, math, pathlib, re, struct, sys, zlib
from mpmath import iv

iv.prec, TEXT = 64, ("block", "digest", "precision", "hold", "motor_loop")
SENTENCES = "2d1f76391475a539f16268a3a71c5ec6aa690d42f16d38881c6bbcee2e2d607d"  # SHA-256 of the claim's form and of what it assumes
sha = lambda content: hashlib.sha256(content).hexdigest()
canonical = lambda value: json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
above = lambda x, y: bool(iv.mpf(x).a > iv.mpf(y).b)  # every point of x above every point of y
size = lambda v: iv.sqrt(abs(v.real) ** 2 + abs(v.imag) ** 2)
turn = lambda angle: iv.mpc(iv.cos(angle), iv.sin(angle))
hull = lambda values: iv.mpf([min(v.a for v in values), max(v.b for v in values)])

def need(condition, reason):
    if condition is not True:
        raise ValueError(reason)

def board(law):
    """SHA-256 of the block on the board: of law_data.h, packed once more as law.h lays it out."""
    found = dict(re.findall(r"^ +\.(\w+) = (.+),$", pathlib.Path(law).read_text("utf-8"), re.MULTILINE))
    version, length, crc, width, *counts = (int(v[:-1], 0) for v in found.values() if v[-1] == "U")  # of size and crc the last
    rows = {k: [float.fromhex(x) for x in re.findall(r"-?0x[\w.]+p[+-]?\d+", v)] for k, v in found.items()}
    room = {"period": 1, "compliance": 1, "direct": 1, "real": 16, "pair": 8, "forward_direct": 1, "forward": 16}
    flat = [x for k in [*room, *(k for k in [*rows][14:] if k not in room)] for x in (rows.get(k, []) + [0.0] * room.get(k, 1))[: room.get(k, 1)]]
    return sha(struct.pack(f"<14I79{'fd'[width == 8]}", version, length, width, crc, *counts, *flat))

class Loop:
    def __init__(self, s):
        ideal, numbers = s["motor_loop"] == "ideal", [s[k] for k in s if k not in (*TEXT, "mode_gain")]
        need(all(0 <= x < 1e300 for x in (*numbers, abs(s["mode_gain"]))), "a number is negative or not finite")
        need(0 < s["payload_low"] <= s["payload_high"] and s["delay_low"] <= s["delay_high"], "an empty range")
        need(0 < s["modulus"] < 1 and s["softness"] * s["lowest"] * s["stiffness"] * s["gauge_gain"] > 0, "zeros")
        need(1 < s["order"] <= 2 and (s["order"] < 2 or s["damping"] > 0), "the order of the link")
        need(0 < s["damping_order"] < s["order"] and (not s["mode_frequency"] or 0 < s["mode_damping"] < 1), "damping")
        need(s["hold"] == "zero-order" and (ideal or s["motor_loop"] == "sampled"), "another hold or motor loop")
        need((s["pole"] if ideal else s["gain"] * s["decay"]) > 0, "numbers of the motor loop")
        block, (width, kind) = bytes.fromhex(s["block"]), {"single": (4, "f"), "double": (8, "d")}[s["precision"]]
        head = (2, len(block), width, zlib.crc32(block[16:]))
        need(struct.unpack("<4I", block[:16]) == head and sha(block) == s["digest"], "version, size, CRC or hash")
        options, n, p, ahead, *guards = struct.unpack("<10I", block[16:56])
        c = [x for x, in struct.iter_unpack("<" + kind, block[56 : 56 + 79 * width])]  # law.h
        need(all(map(math.isfinite, c)) and min(*guards, *c[44:65]) > 0, "a number is not finite, or a limit not > 0")
        need(options == 1 or (ideal and options == 0), "the law closes no motor loop")
        need(n <= 8 and p <= 2 and ahead <= 8 and not any(c[3 + 2 * n : 19] + c[19 + 4 * p : 27]), "counts of modes")
        v = [iv.mpf(x) for x in c]
        self.modes = [(iv.mpc(v[i], 0), iv.mpc(v[i + 1], 0)) for i in range(3, 3 + 2 * n, 2)]
        for pole, y, g, x in (v[i : i + 4] for i in range(19, 19 + 4 * p, 4)):
            self.modes += [(iv.mpc(pole, t * y), iv.mpc(g, t * x) / 2) for t in (1, -1)]
        need(all(above(1, size(p)) for p, _ in self.modes), "a pole of the correction is not stable")
        self.read = {"law": s["digest"][:12], "real_modes": n, "pair_modes": p, "period": c[0], "compliance": c[1]}
        self.s, self.sampled, self.T, self.direct, self.pid = s, not ideal, v[0], v[2], v[-14:-5]
        self.guards(c, s)
        self.A, self.B, self.mu = (iv.mpf(s[k]) for k in ("gain", "decay", "damping"))
        self.powers, self.e = [iv.mpf(s["order"]), iv.mpf(s["damping_order"])], iv.exp(-self.B * self.T)
        w, self.soft, self.gauge = iv.pi / self.T, iv.mpf(s["softness"]), v[1] * s["stiffness"] * s["gauge_gain"]
        inertia, drag = (self.soft * s["payload_low"] * iv.exp(iv.log(w) * p) for p in self.powers)
        stiff, motor = inertia - 1 - self.mu * drag, self.A / w**2 if self.sampled else (s["pole"] / w) ** 2
        need(above(stiff, 0), "the resonance is not below the Nyquist frequency")
        zeta, ratio = iv.mpf(s["mode_damping"]), s["mode_frequency"] / w
        peak = 1 / (1 - ratio**2) if ratio.b < 0.7 else 1 / (2 * zeta * iv.sqrt(1 - zeta**2))
        tip = self.gauge * ((1 + self.mu * drag) / stiff + abs(s["mode_gain"]) * peak)
        tip += 1 + self.gauge if s["gauge_delay"] else abs(1 - self.gauge)
        self.tail = iv.mpf("1.20206") * motor * tip / w * 2 / self.T
        self.start()

    def guards(self, c, s):
        """The gauge is the link's, the limits leave room, and the link is the one that they were made for."""
        bent, least, q = c[1] * s["stiffness"], s["linear_range"], s["softness"] * s["nominal_payload"]
        off = max(min(abs(bent - 1), abs(bent * s["gauge_gain"] - 1)), abs(c[1] * c[63] - 1))
        need(off <= 1e-6, "the gauge's compliance is not 1/c of the link, or not of the law's own c")
        norms = [(1 + size(1 - p) / (1 - size(p)), size(g)) for p, g in self.modes]
        reach = [iv.mpf(min(c[44], c[56], c[57] / 2)) / (2 * abs(self.direct) + sum(a * b for a, b in norms))]
        reach += [c[45] / a for a, _ in norms]  # limits of the sum, the command, its step; and of each mode
        need(least >= 1e-5 and all(above(x, least) for x in reach), "the limits are too narrow")
        need(s["pole"] == 0 or abs(c[60] + math.expm1(-s["pole"] * c[0])) < 1e-6, "another motor loop")
        near = -3 * math.log1p(-c[54]) / c[0]  # |pole| of the link that the limits were derived from
        poles = (cmath.rect(near, math.pi * (0.5 + k / 8000)) for k in range(4001))
        terms = [(q * x ** s["order"], q * s["damping"] * x ** s["damping_order"]) for x in poles]
        off = min(abs(1 + a + b) / (1 + abs(a) + abs(b)) for a, b in terms)
        need(off < 1e-3, "the link is not the one that the law was made for")

    def sensed(self, w):
        read, r = self.gauge * turn(-w * self.s["gauge_delay"]), 0
        if self.s["mode_frequency"]:
            r = w / self.s["mode_frequency"]
            r = self.s["mode_gain"] * r**2 / iv.mpc(r**2 - 1, -2 * iv.mpf(self.s["mode_damping"]) * r)
        return read, 1 - read * (1 + r)

    def link(self, a, b, light, heavy):
        ends = [[iv.exp(iv.log(iv.mpf(w)) * p) if w else iv.mpf(0) for w in (a, b)] for p in self.powers]
        inertia, drag = (hull(e) * turn(iv.pi * p / 2) for e, p in zip(ends, self.powers))
        q = iv.mpf([light, heavy]) * self.soft
        return 1 + q * inertia / (1 + q * self.mu * drag)

    def outer(self, angle):
        z, x, ends = turn(angle), turn(-angle), [turn(iv.mpf(angle.a)), turn(iv.mpf(angle.b))]
        kernel = sum((g / (z - p) for p, g in self.modes), iv.mpc(self.direct, 0))
        near = [size(ends[p.real.b < 0] - p) if p.imag == 0 else 1 - size(p) for p, _ in self.modes]
        bound = abs(self.direct) + sum(size(g) / v for (_, g), v in zip(self.modes, near))
        bound, y, (d, a, i0, i1, f0, f1, g0, g1, r) = iv.mpf(min(bound.b, size(kernel).b)), 1 - x, self.pid
        parts = [(d - i1, f0 + f1, f1), (d + a - i1, f0 + f1 + g0 + g1, f1 + g1)]
        c0 = (i0 + i1) * (1 - r)
        top = [c0 + y * (k * (1 - r) + (i0 + i1) * r + n + y * (k * r - m)) for k, n, m in parts]
        return x, kernel, bound, top[0] / (1 - r * x) if self.sampled else iv.mpc(1, 0), top[1] / (1 - r * x)

    def closing(self, x, both, *delay):
        if not self.sampled: return iv.mpc(1, 0)  # noqa: E701
        late, span = [self.B * iv.mpf(t) for t in delay], self.B * self.T
        n0 = hull([span - t - 1 + iv.exp(t - span) for t in late])
        n2 = hull([self.e * (iv.exp(t) - 1 - t) for t in late])
        held = span * (1 - self.e) * x + (1 - x) * (n0 - n2 * x)
        return (1 - x) * (1 - x) + both * x * held * self.A / self.B**2 / (1 - self.e * x)

    def start(self):
        s, (x, _, kernel, first, both) = self.s, self.outer(iv.mpf([0, self.s["lowest"]]) * self.T)
        read, unread = self.sensed(iv.mpf([0, s["lowest"]]))
        read = read / self.link(0.0, s["lowest"], s["payload_low"], s["payload_high"])
        bound = s["lowest"] * self.T * kernel * (size(read + unread) + self.tail)
        if self.sampled:
            closing = size(self.closing(x, both, s["delay_low"], s["delay_high"]))
            bound = bound * size(first) / closing * (self.T * self.A / self.B + 2)
            circle = [self.outer(iv.pi * n / 4) for n in range(8)]
            c = [self.closing(x, both, s["delay_low"]) * (1 - self.e * x) for x, *_, both in circle]
            c = [v * (1 - self.pid[8] * x) for v, (x, *_) in zip(c, circle)]
            c = [sum(v * circle[-n * k % 8][0] for n, v in enumerate(c)).real for k in range(6)]
            while len(c) > 1:
                need(above(abs(c[0]), abs(c[-1])), "the motor loop is not stable at the shortest delay")
                c = [c[i] - c[-1] / c[0] * c[-1 - i] for i in range(len(c) - 1)]
        need(above(1 - iv.mpf(s["modulus"]), bound), "|L| is not small at low frequency")

    @functools.cache
    def window(self, a, b):
        w, h, j = iv.mpf([a, b]), (iv.mpf(a) * self.T / 2, iv.mpf(b) * self.T / 2), iv.mpc(0, 1)
        x, kernel, bound, first, both = self.outer(w * self.T)
        sinc, scale = hull([v / iv.sin(v) for v in h]), hull([1 / iv.sin(v) for v in h]) / 2
        lag = self.B + j * w if self.sampled else 1 + j * w / self.s["pole"]
        motor = lag * sinc * (sinc / self.T / self.A if self.sampled else lag)
        alias = 2 * iv.sin(h[1]) * bound * self.tail * (2 * size(first) if self.sampled else 1)
        least = size(motor) * scale / bound / iv.mpf(size(first).b)
        return w, x, both, alias, -j * motor * scale / (kernel * first), least, *self.sensed(w)

    def leaf(self, box):
        w, x, both, alias, factor, least, read, unread = self.window(*box[:2])
        link, closing = self.link(*box[:4]), self.closing(x, both, *box[4:])
        m = self.s["modulus"] + iv.mpf((alias / size(closing)).b)
        if above(size(closing) * least * (1 - m), size(read) / size(link) + size(unread)):
            return above(1, m)
        link = link / (read + unread * link)
        spin = turn(w * (iv.mpf(box[4:]) + (1.5 if self.sampled else 1) * self.T))
        value, c = link * (factor * closing * spin), 1 / (1 - m * m)
        re, im = value.real, value.imag
        beside = above(-1, re) or above(re, 0) or above(0, im) or above(im, 0)
        return above(1, m) and beside and above(abs(re + c) ** 2 + abs(im) ** 2, (m * c) ** 2)

def check(path, law=None):
    need(law is not None, "nothing is proved without the law on the board: give law_data.h or its SHA-256")
    unique = lambda pairs: dict(pairs) if len(dict(pairs)) == len(pairs) else {}
    data = json.loads(pathlib.Path(path).read_text("utf-8"), object_pairs_hook=unique)
    need((data["fraclink"], data["format"]) == ("certificate", 2), "not a certificate of format 2")
    hashed = {k: data[k] for k in ("assumed", "claim", "form", "statement", "tree")}
    need(sha(canonical(hashed)) == data["sha256"], "the hash of the certificate is wrong")
    need(sha(canonical([data["form"], data["assumed"]])) == SENTENCES, "claim or assumptions of another form")
    s, tree = {k: v if k in TEXT else float.fromhex(v) for k, v in data["statement"].items()}, data["tree"]
    need(len(s) == 26 and tree.count(".") == data["leaves"], "another number of fields or of leaves")
    need((law if re.fullmatch("[0-9a-f]{64}", law) else board(law)) == s["digest"], "it is about another law than the one on the board")
    loop, letters = Loop(s), iter(tree)
    need(data["claim"] == data["form"].format(**(loop.read | s)), "the claim is not the statement")
    top = math.nextafter(float((iv.pi / loop.T).b), math.inf)
    stack = [(s["lowest"], top, s["payload_low"], s["payload_high"], s["delay_low"], s["delay_high"], 0)]
    while stack:
        *box, extra = stack.pop()
        side = 3 if extra else "wmt.".find(next(letters, "?"))
        need(side >= 0, "the tree ends early or has another letter")
        if side == 3:
            if loop.leaf(tuple(box)):
                continue
            need(extra < 8, f"a leaf does not hold: {box}")  # cut again: other arithmetic rounds elsewhere
            wide = [(box[1] - box[0]) / box[0] * 3, (box[3] - box[2]) / box[2], (box[5] - box[4]) * box[1]]
            side, extra = wide.index(max(wide)), extra + 1
        a, b = box[2 * side : 2 * side + 2]
        middle = math.sqrt(a * b) if side == 0 else (a + b) / 2
        stack += [(*box[: 2 * side], *p, *box[2 * side + 2 :], extra) for p in ((middle, b), (a, middle))]
    need(next(letters, None) is None, "the tree goes on after its last leaf")
    return data["claim"]

if __name__ == "__main__":
    try:
        print("PROVED:", check(*sys.argv[1:]))
    except (ValueError, KeyError, TypeError, OSError, ArithmeticError, AttributeError, struct.error) as error:
        sys.exit(f"REJECTED: {error!r:.300}")
