// Plots in screen pixels with fixed axes and curves from arrays, for the studio and for the page of the arm.
import {el, pathOf, plain, put, scaleOf, steps, tenth} from './svg.js';

/** @typedef {{name?: string, low: number, high: number, log?: boolean, ticks?: number[] | null, unit: string}} Axis */

export const LEFT = 42, RIGHT = 10, TOP = 8, FOOT = 20;
const decades = (low, high) => {
  const found = [];
  for (let p = Math.floor(Math.log10(low)); p <= Math.ceil(Math.log10(high)); p++) {
    for (const m of [1, 2, 5]) if (m * 10 ** p >= low * 0.999 && m * 10 ** p <= high * 1.001) found.push(m * 10 ** p);
  }
  return found;
};

export class Axes {
  /** @param {SVGSVGElement} svg @param {Axis} x @param {Axis} y; `equal`: a step is as long along both */
  constructor(svg, x, y, height, equal = false) {
    Object.assign(this, {svg, x, y, height, equal, home: [{...x}, {...y}], flagged: [], curves: new Map(), W: 0});
    this.frame = el('g', {class: 'frame', 'aria-hidden': 'true'}, svg);
    this.inside = el('svg', {'aria-hidden': 'true'}, svg); // which clips its curves
    this.over = el('g', {'aria-hidden': 'true'}, svg);
    new ResizeObserver(() => { if (svg.clientWidth && Math.abs(svg.clientWidth - this.W) > 1) this.lay(); }).observe(svg);
  }

  /** Set new ends of the axes: only after another log, model or move is opened, never during a drag. */
  axes(x, y) {
    const home = [{...this.home[0], ...x}, {...this.home[1], ...y}];
    if (JSON.stringify(home) === JSON.stringify(this.home)) return;
    this.home = home;
    Object.assign(this.x, x);
    Object.assign(this.y, y);
    this.lay();
  }

  lay() {
    this.W = this.svg.clientWidth;
    if (!this.W) return; // hidden: laid out when it is seen, as its width changes then
    const {W} = this, [x, y] = this.home;
    if (this.equal) this.height = TOP + FOOT + ((W - LEFT - RIGHT) * (y.high - y.low)) / (x.high - x.low);
    const {height} = this;
    [this.X, this.ofX] = scaleOf(this.x, LEFT, W - RIGHT);
    [this.Y, this.ofY] = scaleOf(this.y, height - FOOT, TOP);
    put(this.svg, {viewBox: `0 0 ${W} ${height}`, height});
    const inside = {x: LEFT, y: TOP, width: Math.max(1, W - LEFT - RIGHT), height: height - TOP - FOOT};
    this.area = {...inside, viewBox: Object.values(inside).join(' ')};
    put(this.inside, this.area);
    this.frame.replaceChildren();
    el('rect', {class: 'ground', ...inside}, this.frame);
    const across = this.ticks(this.x, x, W / 75);
    let last = -Infinity; // a label that would touch the one before it is left out
    for (const t of across) {
      const x = this.X(t);
      el('line', {class: 'grid', x1: x, x2: x, y1: TOP, y2: height - FOOT}, this.frame);
      if (x - last < 34) continue;
      last = x;
      el('text', {x, y: height - 5, 'text-anchor': x > W - 25 ? 'end' : 'middle'}, this.frame, plain(t) + this.x.unit);
    }
    last = Infinity;
    for (const t of this.ticks(this.y, y, height / 40)) {
      const y = this.Y(t);
      el('line', {class: t ? 'grid' : 'grid zero', x1: LEFT, x2: W - RIGHT, y1: y, y2: y}, this.frame);
      if (last - y < 12) continue;
      last = y;
      el('text', {x: LEFT - 5, y: y + 4, 'text-anchor': 'end'}, this.frame, plain(t) + this.y.unit);
    }
    for (const c of this.curves.values()) c.draw();
    this.flagged.forEach(({at, severity, code, message}, i) => {
      const flag = el('g', {class: `flag ${severity}`, transform: `translate(${tenth(this.X(at))} ${TOP + 14 * i})`}, this.frame);
      el('title', {}, flag, message);
      el('path', {d: `M0 ${height - FOOT - TOP - 14 * i}V0l11 5l-11 5`}, flag);
      el('text', {x: 13, y: 9}, flag, code);
    });
  }

  /** The ticks: those of the page for the whole axis, round numbers for a part of it. */
  ticks({low, high, log, ticks}, home, count) {
    if (ticks && low === home.low && high === home.high) return ticks;
    const round = log ? decades(low, high) : [];
    return round.length > 2 ? round : steps(low, high, count);
  }

  /** The path of that name, and what draws it. */
  named(name) {
    if (!this.curves.has(name)) this.curves.set(name, {path: el('path', {}, this.inside)});
    return this.curves.get(name);
  }
  /** A named curve; redrawn only if its numbers change. */
  curve(name, kind, xs, ys, label = '') {
    const c = this.named(name);
    if (label) c.tag ||= el('text', {class: `end ${kind}`}, this.over);
    if (kind !== c.kind) put(c.path, {class: `curve ${c.kind = kind}`});
    Object.assign(c, {xs, ys});
    c.draw = () => {
      const {X, Y} = this;
      put(c.path, {d: pathOf(xs.length, (i) => X(xs[i]), (i) => Y(ys[i]))});
      if (c.tag) this.label(c, label, kind === 'heavy' ? 14 : -5);
    };
    if (this.W) c.draw();
  }
  /** The label of a curve at its last visible point, below the labels that are there already. */
  label(c, text, beside) {
    const {X, Y} = this, {xs, ys} = c, most = this.W - RIGHT - 30, foot = this.height - FOOT;
    const [x, at] = Array.from(xs, (v, i) => [X(v), Y(ys[i])]).findLast(([x, y]) => y > TOP + 10 && y < foot && x > LEFT + 30 && x < most) || [0, Infinity];
    c.spot = null;
    const others = [...this.curves.values()].filter((o) => o.spot && Math.abs(o.spot[0] - x) < 42);
    let y = at + beside, near;
    while ((near = others.find((o) => Math.abs(o.spot[1] - y) < 12))) y = near.spot[1] + 13; // always further down
    c.tag.textContent = y < foot ? text : '';
    if (y >= foot) return;
    c.spot = [x, y];
    put(c.tag, {transform: `translate(${tenth(x)} ${tenth(y)})`});
  }
  mark(name, kind, d) {
    const c = this.named(name);
    put(c.path, {class: kind});
    c.draw = () => { const now = d(); if (now !== c.now) put(c.path, {d: c.now = now}); };
    if (this.W) c.draw();
  }
  /** A rectangle between values of the axes; null stands for the whole axis. */
  box(name, kind, x, y) {
    this.mark(name, kind, () => {
      const [left, right] = (x || [this.x.low, this.x.high]).map((v) => tenth(this.X(v))), [foot, top] = (y || [this.y.low, this.y.high]).map((v) => tenth(this.Y(v)));
      return `M${left} ${top}H${right}V${foot}H${left}Z`;
    });
  }
  cross(name, x, y) { this.mark(name, 'critical', () => `M${tenth(this.X(x) - 6)} ${tenth(this.Y(y))}h12m-6-6v12`); }
  remove(name) {
    const c = this.curves.get(name);
    if (!c) return;
    c.path.remove();
    c.tag?.remove();
    this.curves.delete(name);
  }
}
