// Plots in screen pixels with fixed axes, curves from arrays, handles that are accessible sliders, and tables.
import {$, button, emptied, make, on, table} from './dom.js';
import {savePlot} from './picture.js';
import {Axes, FOOT, LEFT, RIGHT, TOP} from './plots.js';
import {el, limited, pathOf, plain, put, scaleOf, tenth} from './svg.js';

/** @typedef {{id: string, label: string, unit: string, low: number, high: number, step: number, drag: 'x' | 'y', shape?: string}} Slider */
/** @typedef {Slider & {get: () => number, set: (v: number) => void, at: () => [number, number], line?: boolean}} Placed */
/** @typedef {Placed & {toAxis?: (v: number) => number, fromAxis?: (v: number) => number, text?: (v: number) => string}} Handle */

export const digits = (v, n) => Number(v.toPrecision(n));
/** The first and last value of a list, as the ends of an axis. */
export const ends = (list) => ({low: list[0], high: list[list.length - 1]});
/** The path of a list of values, from left to right over that width. */
export const spark = (ys, width, y) => pathOf(ys.length, (i) => (width * i) / Math.max(1, ys.length - 1), (i) => y(ys[i]));
/** Rows joined to one curve with gaps between them. */
export const joined = (rows) => rows.flatMap((row) => [...row, NaN]);
/** A circle about a point of the real axis: its real and imaginary parts. */
export const ring = (centre, r) => [(v) => centre + r * Math.cos(v), (v) => r * Math.sin(v)].map((part) => Array.from({length: 121}, (_, k) => part((Math.PI * k) / 60)));

/** The event of a pointer move: at once where the browser offers that, else once a frame. */
const MOVED = 'onpointerrawupdate' in window ? 'pointerrawupdate' : 'pointermove';
/** An axis from its text in the page: name; low, high and "log"; ticks; unit after a number. @returns {Axis} */
const axisOf = (text) => {
  const [name, range, ticks, unit = ''] = text.split('; '), [low, high, log] = range.split(' ');
  return {name, low: Number(low), high: Number(high), log: Boolean(log), ticks: ticks ? ticks.split(' ').map(Number) : null, unit};
};
/** The index of the value at the least distance. */
const nearest = (values, distance) => values.reduce((best, v, i) => (distance(v) < distance(values[best]) ? i : best), 0);
/** At most `count` indices, spread evenly over a list. */
const spread = (length, count) => Array.from({length: Math.min(length, count)}, (_, k) => Math.round((k * (length - 1)) / Math.max(1, Math.min(length, count) - 1)));
/** The functions a gesture calls. @typedef {{begin?: () => void, change?: (at?: number) => void, end?: () => void, cancel?: () => void}} Hand */
const STILL = {begin() {}, change() {}, end() {}, cancel() { this.change(); }};
/**
 * Follow a pointer from its press on a node to its release. `press` returns what a move does, or null; `atOnce`: the press
 * is a move already. @returns {() => void} cancels
 */
const follow = (node, hand, press, atOnce = false) => {
  let move = null;
  const finish = (how) => { if (move) { move = null; hand[how](); } };
  on(node, 'pointerdown', (event) => {
    const moved = press(event);
    if (!moved) return;
    event.preventDefault();
    node.setPointerCapture(event.pointerId);
    hand.begin();
    move = (now) => { moved(now); hand.change(now.timeStamp); };
    if (atOnce) move(event);
  });
  on(node, MOVED, (event) => move?.(event));
  on(node, 'pointerup', () => finish('end'));
  on(node, 'pointercancel', () => finish('cancel'));
  return () => finish('cancel');
};
const WHOLE = 1e6; // a share of the axes that exceeds every plot
const ROWS = 14; // of a table of numbers
const SILENT = /area|ghost|contour|bound|disk|fan|sweep/; // curves that are left out of the readings and tables

/** @type {Plot[]} */ const plots = [];

export class Plot extends Axes {
  /** @param {string} id of an svg in a figure, whose axes are its `data-x` and `data-y` */
  constructor(id) {
    const svg = $(id), {x, y, height, equal} = svg.dataset;
    super(svg, axisOf(x), axisOf(y), Number(height) || 210, equal !== undefined);
    Object.assign(this, {names: {}, grid: null, along: null, later: 0, handles: [], desc: el('desc', {}, svg)});
    this.reader = el('svg', {class: 'reader', 'aria-hidden': 'true'}, svg);
    this.grips = el('g', {}, svg);
    const figure = svg.closest('figure'), caption = figure.querySelector('figcaption');
    this.numbers = make('div', 'tablebox');
    svg.after(this.numbers);
    this.tools = make('details', 'tools');
    put(make('summary', 'chip tool', '▦', this.tools), {'aria-label': `${caption.firstChild.textContent.trim()}: the numbers as a table, and the plot as a file`});
    for (const kind of ['SVG', 'PNG']) button(kind, 'chip tool', this.tools, () => savePlot(this, this.told(), kind.toLowerCase()), `Save the plot as ${kind}`);
    caption.prepend(this.tools);
    plots.push(this);
    on(svg, 'pointermove', (event) => { if (!event.buttons) this.point(this.spot(event)[0]); });
    on(this.tools, 'toggle', () => this.tell());
    on(svg, 'pointerleave', () => this.point(NaN));
    on(svg, 'wheel', (event) => { if (event.ctrlKey) { event.preventDefault(); this.zoom(2 ** (event.deltaY / 200), this.spot(event)); } });
    on(svg, 'dblclick', () => this.zoom(WHOLE));
    on(figure, 'keydown', (event) => { const factor = {'+': 0.5, '-': 2, 0: WHOLE}[event.key]; if (factor && !event.ctrlKey) this.zoom(factor); });
  }

  lay() {
    super.lay();
    if (!this.W) return;
    put(emptied(this.reader), this.area);
    this.place();
  }
  curve(...given) {
    super.curve(...given);
    clearTimeout(this.later);
    this.later = setTimeout(() => this.tell(), 500);
  }
  /** Show this share of the axes about values of them, or about their middle; plots over the same axis follow. */
  zoom(share, [x, y] = []) {
    const narrow = (axis, {low, high}, about) => {
      const [to, of] = scaleOf(axis, 0, 1), at = about === undefined ? 0.5 : limited(to(about), 0, 1);
      Object.assign(axis, {low: Math.max(of(at - at * share), low), high: Math.min(of(at + (1 - at) * share), high)});
    };
    narrow(this.y, this.home[1], y);
    for (const plot of plots) if (plot.x.name === this.x.name) { narrow(plot.x, plot.home[0], x); plot.lay(); }
  }

  /** @param {Handle} h @param {Hand} given */
  handle(h, given) {
    const hand = {...STILL, ...given};
    const g = el('g', {
      class: `handle ${h.shape || ''}`, id: h.id, role: 'slider', tabindex: 0, 'aria-label': h.label,
      'aria-orientation': h.drag === 'x' ? 'horizontal' : 'vertical',
    }, this.grips);
    if (h.line) el('line', {class: 'edge'}, g), el('line', {class: 'reach'}, g);
    el('circle', {class: 'touch', r: 14}, g);
    if (h.shape === 'square') el('rect', {class: 'knob', x: -6, y: -6, width: 12, height: 12, rx: 2}, g);
    else if (h.shape === 'diamond') el('path', {class: 'knob', d: 'M0-8L8 0L0 8L-8 0Z'}, g);
    else el('circle', {class: 'knob', r: 7}, g);
    const entry = {h, g, now: ''};
    this.handles.push(entry);
    const to = h.toAxis || ((v) => v), from = h.fromAxis || ((v) => v);
    const take = (v) => h.set(limited(v, h.low, h.high));
    const across = h.drag === 'x', pointer = (event) => (across ? event.clientX : event.clientY);
    const cancel = follow(g, hand, (event) => {
      g.focus({preventScroll: true});
      const grabbed = pointer(event) - (across ? this.X : this.Y)(to(h.get()));
      return (moved) => take(from((across ? this.ofX : this.ofY)(pointer(moved) - grabbed)));
    });
    on(g, 'keydown', (event) => {
      if (event.key === 'Escape') { cancel(); return; }
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const many = {ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 10, PageDown: -10}[event.key];
      const v = many ? h.get() + many * h.step : event.key === 'Home' ? h.low : event.key === 'End' ? h.high : null;
      if (v === null) return;
      event.preventDefault();
      event.stopPropagation();
      hand.begin();
      take(v);
      hand.change();
      hand.end();
    });
    this.place();
    return entry;
  }

  /** A grid of values, a shade for each interval from edges[k] to edges[k + 1]; the last has no upper end. */
  cells(xs, ys, values, edges, said = plain) {
    this.grid = {xs, ys, values, said};
    for (const [k, from] of edges.entries()) {
      this.mark(`cells${k}`, `cells c${k}`, () => {
        const dx = (this.X(xs[1]) - this.X(xs[0])) / 2, dy = (this.Y(ys[0]) - this.Y(ys[1])) / 2, to = edges[k + 1] ?? Infinity, box = `h${tenth(2 * dx)}v${tenth(2 * dy)}h${tenth(-2 * dx)}z`;
        return Array.from(ys, (y, i) => Array.from(xs, (x, j) => (values[i][j] >= from && values[i][j] < to ? `M${tenth(this.X(x) - dx)} ${tenth(this.Y(y) - dy)}${box}` : '')).join('')).join('');
      });
    }
  }
  /** Drag a range on the background: calls `move` with its start and its end. */
  painted(given, move, ready = () => true) {
    follow(this.svg, {...STILL, ...given}, (event) => {
      if (!ready() || event.target.closest('.handle')) return null;
      const from = this.spot(event);
      return (moved) => move(from, this.spot(moved));
    }, true);
  }
  /** Draw a hairline in every plot with the same axis, with the values of its curves there, and dots in a plot whose curves run along that axis. */
  point(v) {
    for (const plot of plots) {
      if (!plot.W) continue;
      if (plot.x.name === this.x.name) plot.read(v);
      else if (plot.along && this.x.name === plot.along.name) plot.dots(v);
    }
  }
  dots(v) {
    const place = emptied(this.reader), at = v === v && nearest(this.along.values, (u) => Math.abs(Math.log(u / v)));
    if (at !== false) for (const {xs, ys} of this.told()) el('circle', {r: 3.5, cx: this.X(xs[at]), cy: this.Y(ys[at])}, place);
  }
  read(v) {
    const place = emptied(this.reader), told = v === v && this.told();
    if (!told?.length) return;
    const x = this.X(v), near = (xs) => nearest(xs, (u) => Math.abs(this.X(u) - x)), left = x > this.W / 2, unit = this.x.unit || ` ${(this.x.name.match(/\[(.*)\]/) || ['', ''])[1]}`;
    el('path', {d: `M${tenth(x)} ${TOP}V${this.height - FOOT}`}, place);
    [plain(v, 3) + unit, ...told.map(({name, xs, ys}) => `${told.length > 1 ? `${name}: ` : ''}${plain(ys[near(xs)], 3)}${this.y.unit}`)].forEach((text, i) => {
      el('text', {x: left ? LEFT + 4 : this.W - RIGHT - 4, y: TOP + 12 + 13 * i, 'text-anchor': left ? 'start' : 'end'}, place, text);
    });
  }
  told() { return [...this.curves].filter(([, c]) => c.xs?.length && !SILENT.test(c.kind)).map(([key, {xs, ys, path}]) => ({name: this.names[key] || key, xs, ys, path})); }
  /** The position of a pointer in the units of the axes. */
  spot(event) {
    const box = this.svg.getBoundingClientRect();
    return [this.ofX(limited(event.clientX - box.left, LEFT, this.W - RIGHT)), this.ofY(limited(event.clientY - box.top, TOP, this.height - FOOT))];
  }

  place() {
    if (!this.W) return;
    for (const entry of this.handles) {
      const {h, g} = entry, [dx, dy] = h.at(), v = h.get();
      const x = limited(this.X(dx), LEFT, this.W - RIGHT), y = limited(this.Y(dy), TOP, this.height - FOOT);
      const now = `${x} ${y} ${v} ${this.W}`;
      if (now === entry.now) continue;
      entry.now = now;
      g.setAttribute('transform', `translate(${tenth(x)} ${tenth(y)})`);
      const along = h.drag === 'x' ? {x1: 0, x2: 0, y1: TOP - y, y2: this.height - FOOT - y} : {x1: LEFT - x, x2: this.W - RIGHT - x, y1: 0, y2: 0};
      for (const k in along) along[k] = tenth(along[k]);
      for (const line of g.querySelectorAll('line')) put(line, along);
      const text = (h.text || ((u) => `${plain(u)} ${h.unit}`))(v);
      put(g, {'aria-valuemin': h.low, 'aria-valuemax': h.high, 'aria-valuenow': v, 'aria-valuetext': text});
    }
  }

  /** Describe the curves: a sentence for users who cannot see them, and tables of the numbers. */
  tell() {
    const told = this.told(), {x, y, grid} = this;
    const at = (list, unit) => plain(list, 3) + unit, least = (ys, pick) => at(ys.reduce((a, v) => pick(a, v)), y.unit);
    this.desc.textContent = told.map(({name, xs, ys}) => `${name} from ${at(ys[0], y.unit)} at ${at(xs[0], x.unit)} to ${at(ys[ys.length - 1], y.unit)} at ${at(xs[xs.length - 1], x.unit)}, least ${least(ys, Math.min)}, most ${least(ys, Math.max)}`).join('; ');
    emptied(this.numbers);
    if (!this.tools.open) return;
    const add = (...rest) => table(make('div', '', '', this.numbers), ...rest);
    for (const same of Object.values(Object.groupBy(told, ({xs}) => [...Object.values(ends(xs)), xs.length].join()))) {
      add([x.name, ...same.map(({name}) => `${name}: ${y.name}`)], spread(same[0].xs.length, ROWS).map((i) => [plain(same[0].xs[i], 3), ...same.map(({ys}) => plain(ys[i], 3))]));
    }
    if (!grid) return;
    const columns = spread(grid.xs.length, 9);
    add([`${y.name} over ${x.name}`, ...columns.map((j) => plain(grid.xs[j], 3))], spread(grid.ys.length, 9).map((i) => [plain(grid.ys[i], 3), ...columns.map((j) => grid.said(grid.values[i][j], 3))]));
  }
}
