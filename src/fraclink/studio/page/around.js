// Around the loop: the map of feasible requests, and states compared with one another.
import {Plot, digits, ends, spark} from './plot.js';
import {$, make, button, emptied, on, table} from './dom.js';
import {el, limited, plain, put} from './svg.js';

export class Around {
  constructor(app, design) {
    Object.assign(this, {app, design, of: '', pictures: new Map(), pinned: new Map()});
    this.map = new Plot('p-map');
    this.map.painted(app.hand, (from, [x, y]) => { design.set('gain_crossover', digits(x, 3)); design.set('phase_margin_deg', Math.round(y)); });
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
      const state = states[k], item = make('div', `thumb${k === at ? ' now' : ''}`, '', place);
      const go = button('', '', item, () => this.app.go(k), `Go to state ${k + 1}: ${this.words(state)}`), key = JSON.stringify(state);
      const path = el('path', {}, el('svg', {viewBox: '0 0 64 40', 'aria-hidden': 'true'}, go));
      make('small', '', this.words(state), go);
      const letter = this.others().find((other) => other.key === key)?.letter;
      put(button(letter || '+', 'chip', item, () => this.pin(key, state), `Overlay state ${k + 1} on this design`), {'aria-pressed': Boolean(letter)});
      this.look(state).then((seen) => {
        const c = seen.curves;
        if (c?.gain) put(path, {d: spark(c.gain[1], 64, (v) => 20 - limited(v, -40, 40) / 2)});
      });
    }
  }
  /** Overlay a state, or remove it; a third one takes the place of the first. */
  async pin(key, state) {
    const {pinned} = this;
    if (!pinned.delete(key)) {
      const seen = await this.app.ask('look', {state}); // its picture may be older than the law, and then has no blocks
      if (seen.ok) pinned.set(key, seen);
    }
    if (pinned.size > 2) pinned.delete(pinned.keys().next().value);
    this.strip();
    this.compare();
    this.design.moves();
  }
  others() { return [...this.pinned].map(([key, seen], i) => ({key, seen, letter: 'BC'[i]})); }
  compare() {
    const {design} = this, a = design.last, others = a ? this.others() : [];
    for (const letter of 'BC') {
      const other = others.find((one) => one.letter === letter);
      if (other) design.nominal(letter, `other ${letter}`, other.seen.curves, letter); else design.remove(letter);
    }
    table($('compared'), ['figure', 'A, now', ...others.map(({letter}) => letter)], others.length && a.facts.map(([name, value], i) => [name, value, ...others.map(({seen}) => seen.facts[i][1])]), 'Designs laid over one another');
  }
}
