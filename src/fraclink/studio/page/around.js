// @ts-check
// Around the loop: regions that it keeps out of, the map of what can be asked for, states laid over one another.
import {Plot, digits, el, ends, limited, line, plain} from './plot.js';
import {$, make, button, emptied, on, put, table} from './dom.js';

const EDGES = [['left', 'x', 'right', 'Left'], ['right', 'x', 'left', 'Right'], ['low', 'y', 'high', 'Lower'], ['high', 'y', 'low', 'Upper']];

export class Around {
  constructor(app, design) {
    Object.assign(this, {app, design, key: '', of: '', pictures: new Map(), pinned: '', entered: []});
    this.plots = {gain: design.gain, nichols: design.nichols};
    for (const [name, plot] of Object.entries(this.plots)) this.tool(name, plot);
    this.map = new Plot('p-map');
    this.both = (x, y) => { design.set('gain_crossover', round(x)); design.set('phase_margin_deg', Math.round(y)); };
    this.map.painted(app.hand, (from, to) => this.both(...to));
    on('fan', 'change', () => app.change());
  }

  // ---- regions ----
  list() { return this.app.state.regions || []; }
  put(list) { this.app.state = {...this.app.state, regions: list}; }
  change(list) { this.app.begin(); this.put(list); this.app.change(); this.app.end(); }
  drop(i) { this.change(this.list().filter((r, k) => k !== i)); }
  tool(name, plot) {
    const mode = on(`keepout-${name}`, 'click', (event) => {
      if (event.detail) { draw(mode.ariaPressed !== 'true'); return; }
      // by keys: one in the middle, with its edges to be moved
      this.change([...this.list(), box([plot.value(plot.x, 0.6), plot.value(plot.y, 0.6)], [plot.value(plot.x, 0.75), plot.value(plot.y, 0.75)])]);
      $(`h-region-${this.list().length - 1}-left`).focus();
    });
    const draw = (now) => { put(mode, {'aria-pressed': now}); plot.svg.classList.toggle('drawing', now); };
    const box = ([x, y], [u, v]) => ({plot: name, left: round(Math.min(x, u)), right: round(Math.max(x, u)), low: round(Math.min(y, v)), high: round(Math.max(y, v))});
    let before = [];
    plot.painted({...this.app.hand, end: () => { draw(false); this.app.end(); }}, (from, to) => {
      if (from === to) before = this.list();
      else this.put([...before, box(from, to)].filter((r) => r.left < r.right && r.low < r.high));
    }, () => plot.svg.classList.contains('drawing') && this.list().length < 8);
  }
  edges() {
    for (const plot of Object.values(this.plots)) plot.drop('region');
    this.list().forEach((region, i) => {
      const plot = this.plots[region.plot], logs = plot.x.log;
      for (const [edge, drag, other, words] of EDGES) {
        const now = () => this.list()[i] || region, axis = plot[drag];
        plot.handle({
          id: `h-region-${i}-${edge}`, label: `${words} edge of region ${i + 1}`, unit: drag === 'y' ? 'dB' : logs ? 'rad/s' : '°',
          low: axis.low, high: axis.high, step: 1, drag, shape: 'small', get: () => now()[edge],
          set: (v) => { const least = edge === 'left' || edge === 'low'; if (least ? v < now()[other] : v > now()[other]) this.put(this.list().map((r, k) => (k === i ? {...r, [edge]: round(v)} : r))); },
          at: () => { const r = now(), x = logs ? Math.sqrt(r.left * r.right) : (r.left + r.right) / 2; return drag === 'x' ? [r[edge], (r.low + r.high) / 2] : [x, r[edge]]; },
          remove: () => this.drop(i),
        }, this.app.hand);
      }
    });
  }
  place() {
    const list = this.list(), key = list.map((r) => r.plot).join();
    if (key !== this.key) { this.key = key; this.edges(); }
    list.forEach((r, i) => this.plots[r.plot].box(`region${i}`, `keepout${this.entered[i] ? ' entered' : ''}`, [r.left, r.right], [r.low, r.high]));
    this.map.place();
  }
  /** Which of them the loop enters, as Python found it. */
  found({entered, regions}) {
    this.entered = entered;
    const said = regions.join();
    if (said === this.said) return;
    this.said = said;
    const place = emptied('regions');
    regions.forEach((words, i) => {
      const item = make('li', entered[i] ? 'error' : 'info', `${words} `, place);
      button('×', 'chip', item, () => this.drop(i), `Remove region ${i + 1}`);
    });
  }

  // ---- the map ----
  async mapped() {
    const {state} = this.app, of = JSON.stringify([state.payloads, state.filter_time, state.filter_order, this.app.axes.payloads]);
    if (of === this.of || !this.app.axes.payloads) return;
    this.of = of;
    const found = await this.app.ask('map', {state});
    if (!found.ok) { if (this.of === of) this.of = ''; return; }
    const {crossovers: x, margins: y, noise} = found;
    const levels = noise.flat().filter((v) => v >= 0).sort((a, b) => a - b);
    this.map.axes(ends(x), ends(y));
    this.map.cells(x, y, noise, [0, 1, 2, 3].map((k) => levels[Math.floor((k * levels.length) / 4)]), (v, n) => (v < 0 ? 'none' : plain(v, n)));
  }

  // ---- states beside one another ----
  words(state) { return `${plain(state.gain_crossover, 3)} rad/s, ${plain(state.phase_margin_deg, 3)}°`; }
  /** The promise is kept, not its answer: a state is asked for once, however often the strip is drawn meanwhile. */
  look(state) {
    const key = JSON.stringify(state);
    if (!this.pictures.has(key)) this.pictures.set(key, this.app.ask('look', {state}));
    return this.pictures.get(key);
  }
  strip() {
    const {states, at} = this.app, place = emptied('strip');
    for (let k = Math.max(0, states.length - 12); k < states.length; k++) {
      const state = states[k], item = make('div', `thumb${k === at ? ' now' : ''}`, '', place), kept = this.app.kept.has(k) ? ', kept' : '';
      const go = button('', '', item, () => this.app.go(k), `Go to state ${k + 1}: ${this.words(state)}${kept}`), key = JSON.stringify(state);
      const path = el('path', {}, el('svg', {viewBox: '0 0 64 40', 'aria-hidden': 'true'}, go));
      make('small', '', `${kept ? '★ ' : ''}${this.words(state)}`, go);
      put(button('B', 'chip', item, () => this.pin(key === this.pinned ? '' : key, state), `Lay state ${k + 1} over this design`), {'aria-pressed': key === this.pinned});
      this.look(state).then((seen) => {
        const c = seen.curves;
        if (c?.gain) put(path, {d: line(c.gain[1], 64, (v) => 20 - limited(v, -40, 40) / 2)});
      });
    }
  }
  async pin(key, state) {
    this.pinned = key;
    this.other = key ? await this.look(state) : null;
    this.strip();
    this.compare();
  }
  compare() {
    const {design} = this, {frequencies: w, payloads} = this.app.axes, b = this.other, a = design.last;
    const shown = b?.ok && a, {four} = design;
    if (!shown) { for (const plot of four) plot.remove('other'); emptied('compared'); return; }
    const c = b.curves;
    [[w, c.gain[1]], [w, c.phase[1]], [c.phase[1], c.gain[1]], [payloads.map((m) => 1e3 * m), c.margin[0]]].forEach(([x, y], i) => four[i].curve('other', 'other', x, y, 'B'));
    table($('compared'), ['figure', 'A, now', 'B'], a.facts.map(([name, value], i) => [name, value, b.facts[i][1]]), 'A and B');
  }
}
const round = (v) => digits(v, 3);
