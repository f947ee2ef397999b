"""Check a certificate of fraclink without fraclink: python check_certificate.py FILE [SHA-256 of a law].

Exit code 0: proved; 1: rejected. 1 + L(e^{jωT}) must miss (-∞, 0]: then the loop is stable, as its parts are.
The tree cuts the box of (ω, payload, delay) in two at each w, m, t: its leaves cover it whatever it says. On
a leaf |L| < 1 - m, or the rectangle around 1/L misses [-1, 0) and the disc that |1 + L| <= m is for 1/L.
Aliases are bounded by ζ(3) times their first term and added to m. See docs/how-to/read-a-certificate.md.
"""

# ruff: noqa: B019, B905, E401, E731, I001
# fmt: off
import functools, hashlib, json, math, pathlib, struct, sys, zlib
from mpmath import iv

iv.prec, TEXT = 64, ("block", "digest", "precision", "inner")
above = lambda x, y: bool(iv.mpf(x).a > iv.mpf(y).b)  # every point of x above every point of y
size = lambda v: iv.sqrt(abs(v.real) ** 2 + abs(v.imag) ** 2)
turn = lambda angle: iv.mpc(iv.cos(angle), iv.sin(angle))
hull = lambda values: iv.mpf([min(v.a for v in values), max(v.b for v in values)])

def need(condition, reason):
    if condition is not True:
        raise ValueError(reason)

class Loop:
    def __init__(self, s):
        ideal, m0, m1 = s["inner"] == "ideal", s["payload_low"], s["payload_high"]
        need(all(0 <= s[k] < 1e300 for k in s if k not in TEXT), "a number is negative or not finite")
        need(0 < m0 <= m1 and s["delay_low"] <= s["delay_high"], "a range is empty")
        need(0 < s["modulus"] < 1 and s["softness"] * s["lowest"] > 0, "modulus, softness, lowest frequency")
        need(1 < s["order"] <= 2 and (s["order"] < 2 or s["damping"] > 0), "the order of the link")
        need(0 < s["damping_order"] < s["order"], "the order of the damping")
        need((s["pole"] if ideal else s["gain"] * s["decay"]) > 0, "numbers of the motor loop")
        block, width = bytes.fromhex(s["block"]), {"single": 4, "double": 8}[s["precision"]]
        need(hashlib.sha256(block).hexdigest() == s["digest"], "the hash of the law is wrong")
        head, kind = (2, len(block), width, zlib.crc32(block[16:])), "fd"[width == 8]
        need(struct.unpack("<4I", block[:16]) == head, "the law is damaged or of another version")
        v = [iv.mpf(x) for x, in struct.iter_unpack("<" + kind, block[56:])]  # law.h
        modes = [(iv.mpc(p, 0), iv.mpc(g, 0)) for p, g in zip(v[3:19:2], v[4:19:2])]
        for p, y, g, x in zip(v[19:27:4], v[20:27:4], v[21:27:4], v[22:27:4]):
            modes += [(iv.mpc(p, t * y), iv.mpc(g, t * x) / 2) for t in (1, -1)]
        self.s, self.sampled, self.T, self.direct, self.pid = s, not ideal, v[0], v[2], v[-14:-5]
        self.modes = [(p, g) for p, g in modes if size(g).b > 0]
        need(all(above(1, size(p)) for p, _ in self.modes), "a pole of the correction is not stable")
        self.A, self.B, self.mu = (iv.mpf(s[k]) for k in ("gain", "decay", "damping"))
        self.powers, self.e = [iv.mpf(s["order"]), iv.mpf(s["damping_order"])], iv.exp(-self.B * self.T)
        w, self.soft = iv.pi / self.T, iv.mpf(s["softness"])
        inertia, drag = (self.soft * s["payload_low"] * iv.exp(iv.log(w) * p) for p in self.powers)
        stiff, motor = inertia - 1 - self.mu * drag, self.A / w**2 if self.sampled else (s["pole"] / w) ** 2
        need(above(stiff, 0), "the resonance is not below the Nyquist frequency")
        self.tail = iv.mpf("1.20206") * motor * (1 + self.mu * drag) / stiff / w * 2 / self.T
        self.start()

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
        link = size(self.link(0.0, s["lowest"], s["payload_low"], s["payload_high"]))
        bound = s["lowest"] * self.T * kernel * (1 / link + self.tail)
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
        return w, x, both, alias, -j * motor * scale / (kernel * first), least

    def leaf(self, box):
        w, x, both, alias, factor, least = self.window(*box[:2])
        link, closing = self.link(*box[:4]), self.closing(x, both, *box[4:])
        m = self.s["modulus"] + iv.mpf((alias / size(closing)).b)
        if above(size(link) * size(closing) * least * (1 - m), 1):
            return above(1, m)
        spin = turn(w * (iv.mpf(box[4:]) + (1.5 if self.sampled else 1) * self.T))
        value, c = link * (factor * closing * spin), 1 / (1 - m * m)
        re, im = value.real, value.imag
        beside = above(-1, re) or above(re, 0) or above(0, im) or above(im, 0)
        return above(1, m) and beside and above(abs(re + c) ** 2 + abs(im) ** 2, (m * c) ** 2)

def check(path, digest=None):
    unique = lambda pairs: dict(pairs) if len(dict(pairs)) == len(pairs) else {}
    data = json.loads(pathlib.Path(path).read_text("utf-8"), object_pairs_hook=unique)
    need((data["fraclink"], data["format"]) == ("certificate", 1), "not a certificate of format 1")
    text, tree = data["statement"], data["tree"]
    hashed = json.dumps({"statement": text, "tree": tree}, sort_keys=True, separators=(",", ":")).encode()
    need(hashlib.sha256(hashed).hexdigest() == data["sha256"], "the hash of statement and tree is wrong")
    s = {k: v if k in TEXT else float.fromhex(v) for k, v in text.items()}
    need(len(s) == 17 and tree.count(".") == data["leaves"], "another number of fields or of leaves")
    need(digest in (None, s["digest"]), "it is about another law")
    loop, letters = Loop(s), iter(tree)
    top = math.nextafter(float((iv.pi / loop.T).b), math.inf)
    stack = [(s["lowest"], top, s["payload_low"], s["payload_high"], s["delay_low"], s["delay_high"], 0)]
    while stack:
        *box, extra = stack.pop()
        side = 3 if extra else "wmt.".find(next(letters, "?"))
        need(side >= 0, "the tree ends early or has another letter")
        if side == 3:
            if loop.leaf(tuple(box)):
                continue
            need(extra < 6, f"a leaf does not hold: {box}")  # cut again: other arithmetic rounds elsewhere
            wide = [(box[1] - box[0]) / box[0] * 3, (box[3] - box[2]) / box[2], (box[5] - box[4]) * box[1]]
            side, extra = wide.index(max(wide)), extra + 1
        a, b = box[2 * side : 2 * side + 2]
        middle = math.sqrt(a * b) if side == 0 else (a + b) / 2
        stack += [(*box[: 2 * side], *p, *box[2 * side + 2 :], extra) for p in ((middle, b), (a, middle))]
    need(next(letters, None) is None, "the tree goes on after its last leaf")
    return "{payload_low} to {payload_high} kg, {delay_low} to {delay_high} s, |1+L| > {modulus}".format(**s)

if __name__ == "__main__":
    try:
        print("PROVED:", check(*sys.argv[1:]))
    except (ValueError, KeyError, TypeError, OSError, ArithmeticError, AttributeError, struct.error) as error:
        sys.exit(f"REJECTED: {error!r:.300}")
