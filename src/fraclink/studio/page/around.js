// @ts-check
// Around the loop: the map of feasible requests, and states compared with one another.
import {Plot, digits, el, ends, limited, line, plain} from './plot.js';
import {$, make, button, emptied, on, put, table} from './dom.js';

export class Around {
  constructor(app, design) {
    Object.assign(this, {app, design, of: '', pictures: new Map(), pinned: ''});
    this.map = new Plot('p-map');
    this.both = (x, y) => { design.set('gain_crossover', digits(x, 3)); design.set('phase_margin_deg', Math.round(y)); };
    this.map.painted(app.hand, (from, to) => this.both(...to));
    on('fan', 'change', () => app.change());
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

  // ---- states side by side ----
  words(state) { return `${plain(state.gain_crossover, 3)} rad/s, ${plain(state.phase_margin_deg, 3)}°`; }
  /** The promise is stored instead of its answer, so that a state is requested only once, however often the strip is drawn in the meantime. */
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
      put(button('B', 'chip', item, () => this.pin(key === this.pinned ? '' : key, state), `Overlay state ${k + 1} on this design`), {'aria-pressed': key === this.pinned});
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
