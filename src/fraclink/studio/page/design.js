// Step 4: the loop, its handles, and the requests they send.
import {Plot, digits, ends, joined, ring} from './plot.js';
import {Around} from './around.js';
import {$, capital, change, make, button, emptied, on, table, findings, say, symbol} from './dom.js';
import {degrees, limited, plain} from './svg.js';

const grams = (kg) => 1e3 * kg;
const KINDS = ['light', 'nominal', 'heavy'];

/** |S| [dB] of a loop from its gain [dB] and phase [°]; |T| is |S| times the gain. */
const sensitivity = (gain, phase) => gain.map((g, k) => {
  const a = 10 ** (g / 20);
  return -10 * Math.log10(1 + 2 * a * Math.cos((phase[k] * Math.PI) / 180) + a * a);
});

/** A circle in the complex plane about a centre on the negative real axis, as phases and decibels. */
const disk = (centre, r) => {
  const [x, y] = ring(centre, r), phases = x.map((real, k) => degrees(Math.atan2(y[k], real)));
  return [phases.map((p) => (p > 0 ? p - 360 : p)), x.map((real, k) => 20 * Math.log10(Math.hypot(real, y[k])))];
};

export class Design {
  constructor(app, arm) {
    this.app = app;
    this.arm = arm;
    this.last = null;
    this.doubts = [];
    this.inputs = {};
    for (const input of document.querySelectorAll('[data-option]')) this.field(input);
    this.box = on('box', 'change', () => this.put('box', this.box.checked));
    this.plots();
    this.around = new Around(app, this);
    this.cross(this.around.map);
    arm.moved = () => this.moves();
  }

  // ---- fields ----
  field(input) {
    const name = input.dataset.option, factor = Number(input.dataset.factor), step = Number(input.dataset.step);
    on(input, 'keydown', (event) => {
      const by = {ArrowUp: 1, ArrowDown: -1, PageUp: 10, PageDown: -10}[event.key];
      if (!by) return;
      event.preventDefault();
      this.put(name, digits((Number(input.value || input.placeholder) + by * step) / factor, 6));
    });
    on(input, 'change', () => this.put(name, input.value === '' ? null : Number(input.value) / factor));
    this.inputs[name] = [input, factor];
  }
  get(name) {
    const [key, i] = name.split('.'), value = this.app.state[key];
    if (value !== null && value !== undefined) return i === undefined ? value : value[Number(i)];
    const asked = this.last?.asked || {};
    return key === 'payloads' ? (this.app.axes.rated || [0.02, 0, 0.04])[i === '1' ? 2 : 0] : asked[key] ?? null;
  }
  put(name, value) { this.app.once(() => this.set(name, value)); }
  set(name, value) {
    const [key, i] = name.split('.');
    if (i === undefined) this.app.state = {...this.app.state, [key]: value};
    else {
      const both = [this.get('payloads.0'), this.get('payloads.1')];
      both[Number(i)] = value ?? both[Number(i)];
      // an end that is moved past the other takes the other along
      if (both[0] > both[1]) both[1 - Number(i)] = both[Number(i)];
      this.app.state = {...this.app.state, payloads: both};
    }
  }
  fields() {
    for (const [name, [input, factor]] of Object.entries(this.inputs)) {
      if (document.activeElement === input && !this.app.began) continue;
      const own = name.startsWith('payloads') ? this.get(name) : this.app.state[name];
      const text = own === null || own === undefined ? '' : String(digits(own * factor, 6));
      change(input, 'value', text);
      const shown = name === 'filter_time' ? this.last?.controller?.delta : this.get(name);
      change(input, 'placeholder', shown ? `${digits(shown * factor, 4)}` : 'none');
    }
    this.box.checked = Boolean(this.app.state.box);
    this.box.indeterminate = this.app.state.box === null;
  }

  // ---- plots and their handles ----
  plots() {
    for (const name of ['gain', 'phase', 'nichols', 'margin', 'S', 'T', 'tip']) this[name] = new Plot(`p-${name}`);
    this.over = [this.gain, this.phase, this.S, this.T];
    this.all = [...this.over, this.nichols, this.margin, this.tip];
    this.contours();
    const {app} = this, hand = app.hand = {begin: app.begin, change: (time) => app.change(time), end: app.end, cancel: app.cancel};
    const crossover = {label: 'Gain crossover, at the heaviest payload', unit: 'rad/s', low: 1, high: 300, step: 0.1, get: () => this.get('gain_crossover') || 10, set: (v) => this.set('gain_crossover', digits(v, 4))};
    const margin = {label: 'Phase margin, at the lightest payload', unit: '°', low: 1, high: 120, step: 0.5, get: () => this.get('phase_margin_deg') || 50, set: (v) => this.set('phase_margin_deg', Math.round(10 * v) / 10), text: (v) => `${plain(v)}°`};
    this.sliders = {crossover, margin};
    const upper = () => this.last?.controller?.upper || 15, corner = () => 1 / Math.max(this.app.state.filter_time ?? this.last?.controller?.delta ?? 0.005, 5e-4);
    const turned = {...margin, shape: 'square', toAxis: (v) => v - 180, fromAxis: (v) => v + 180};
    this.gain.handle({...crossover, id: 'h-crossover', drag: 'x', at: () => [crossover.get(), 0]}, hand);
    this.gain.handle({
      id: 'h-filter', label: 'Corner of the filter, 1/δ', unit: 'rad/s', low: 5, high: 2000, step: 5, drag: 'x', shape: 'diamond',
      get: corner, set: (v) => this.set('filter_time', digits(1 / v, 3)), at: () => [corner(), -32],
      text: (v) => `${plain(v, 3)} rad/s, δ = ${plain(1e3 / v, 3)} ms`,
    }, hand);
    this.phase.handle({...turned, id: 'h-margin-phase', drag: 'y', at: () => [upper(), margin.get() - 180]}, hand);
    this.nichols.handle({...turned, id: 'h-margin-nichols', drag: 'x', at: () => [margin.get() - 180, 0]}, hand);
    this.margin.handle({...margin, id: 'h-margin-payload', drag: 'y', shape: 'square', line: true, at: () => [Math.sqrt(this.payload(0) * this.payload(1)), margin.get()]}, hand);
    for (const [i, end] of [[0, 'Lightest'], [1, 'Heaviest']]) {
      this.margin.handle({
        id: `h-payload-${i}`, label: `${end} payload designed for`, unit: 'g', low: 1, high: 1e5, step: 0.5, drag: 'x', line: true,
        get: () => this.payload(i), set: (v) => this.set(`payloads.${i}`, digits(v / 1e3, 3)), at: () => [this.payload(i), 6],
      }, hand);
    }
  }
  payload(i) { return grams(this.get(`payloads.${i}`)); }
  /** The current design on the map: two lines, each a slider. */
  cross(map) {
    const {crossover, margin} = this.sliders;
    map.handle({...crossover, id: 'h-map-crossover', drag: 'x', line: true, at: () => [crossover.get(), map.y.low]}, this.app.hand);
    map.handle({...margin, id: 'h-map-margin', drag: 'y', shape: 'square', line: true, at: () => [map.x.low, margin.get()]}, this.app.hand);
  }
  /** Regions the request itself excludes: gains below 0 dB left of the crossover, 0 dB closer to −180° than the margin, the disk of Ms. */
  forbidden() {
    const {gain, phase, nichols} = this, w = this.get('gain_crossover'), m = this.get('phase_margin_deg'), up = this.last?.controller?.upper, ms = this.app.state.max_sensitivity;
    if (!w || !m) return;
    gain.box('bound', 'bound', [gain.x.low, w], [gain.y.low, 0]);
    if (up) phase.box('bound', 'bound', [w, Math.max(up, w)], [phase.y.low, m - 180]);
    nichols.box('bound', 'bound', [-180 - m, m - 180], [-1.2, 1.2]);
    if (ms) nichols.curve('disk', 'bound', ...disk(-1, 1 / ms)); else nichols.remove('disk');
  }
  place() { this.forbidden(); for (const plot of [...this.all, this.around.map]) plot.place(); }

  /** Circles of constant |T| around −180°, and the critical point. */
  contours() {
    for (const peak of [1.2, 1.5, 3]) {
      const left = disk(-peak * peak / (peak * peak - 1), peak / (peak * peak - 1)).map((list) => [...list.slice(60), ...list.slice(0, 61)]);
      this.nichols.curve(`m${peak}`, 'contour', ...left, `${plain(20 * Math.log10(peak), 2)} dB`);
    }
    this.nichols.cross('critical', -180, 0);
  }

  axes(axes) {
    if (!axes.frequencies) return;
    const {low, high} = ends(axes.frequencies), across = {low: Math.max(low, high / 500), high};
    for (const plot of this.over) plot.axes(across);
    this.nichols.along = {name: this.gain.x.name, values: axes.frequencies};
    this.margin.axes(ends(axes.payloads.map(grams)));
  }

  /** The curves at the beginning of a drag, thin and behind the current ones. */
  ghost(on) {
    const c = on && this.app.axes.frequencies && this.last?.curves;
    if (c) this.nominal('ghost', 'ghost', c); else this.remove('ghost');
  }
  remove(name) { for (const plot of this.all) plot.remove(name); }
  /** The loop of a design with its nominal payload, and its margins. */
  nominal(name, kind, c, label) {
    this.loop(name, kind, c.gain[1], c.phase[1], label);
    this.margin.curve(name, kind, this.app.axes.payloads.map(grams), c.margin[0], label);
  }
  /** One loop in every plot: L over frequency and as a Nichols curve, S and T; the payloads are labelled in the Nichols plot only. */
  loop(name, kind, gain, phase, label, w = this.app.axes.frequencies) {
    const S = sensitivity(gain, phase);
    [gain, phase, S, S.map((s, k) => s + gain[k])].forEach((values, i) => this.over[i].curve(name, kind, w, values, kind === name ? '' : label));
    this.nichols.curve(name, kind, phase, gain, label);
  }

  preview(answer) {
    this.searching = false;
    if (!answer.ok) { this.refuse(answer); return; }
    $('step-design').classList.remove('stale');
    $('refused').hidden = true;
    this.app.refuse(false);
    this.last = answer;
    const {curves: c} = answer, {frequencies: w, payloads} = this.app.axes;
    const {names} = answer, named = Object.fromEntries(KINDS.map((kind, i) => [kind, names[i]]));
    for (const plot of this.all) plot.names = plot === this.margin ? {} : named;
    KINDS.forEach((kind, i) => { for (const key of document.querySelectorAll(`.k-${kind}`)) change(key, 'textContent', names[i]); });
    this.nichols.curve('band', 'area', [...c.phase[0], ...Array.from(c.phase[2]).reverse()], [...c.gain[0], ...Array.from(c.gain[2]).reverse()]);
    KINDS.forEach((kind, i) => this.loop(kind, kind, c.gain[i], c.phase[i], i === 1 ? '' : names[i]));
    const g = payloads.map(grams), [low, , high] = answer.three.map(grams);
    this.margin.curve('margin', 'nominal', g, c.margin[0]);
    this.margin.box('zone', 'zone', [low, high], null);
    const few = Array.from(w).filter((_, k) => k % 4 === 0);
    if (c.fan_gain) this.loop('fan', 'fan', joined(c.fan_gain), joined(c.fan_phase), '', joined(c.fan_gain.map(() => few)));
    else this.remove('fan');
    this.around.compare();
    this.place();
    this.fields();
    this.facts(answer, true);
    this.moves();
    say('budget-at', `[°] at the crossover of ${names[0]}`);
    say('assumed', answer.assumed);
    this.findings(answer.findings);
    $('requirements').classList.add('preview');
  }

  /** Shown only if they change, since a drag brings them at every move. */
  findings(list) {
    const said = JSON.stringify(list);
    if (said !== this.found) findings($('design-findings'), list);
    this.found = said;
  }
  /** A preview is grey and marked with ≈ until the exact answer replaces it. */
  facts(answer, preview) {
    const place = $('controller'), sign = preview ? '≈ ' : '';
    place.classList.toggle('preview', preview);
    answer.facts.slice(2).forEach(([name, value], i) => {
      const box = place.children[i] || make('div', '', '', place);
      if (!box.firstChild) { symbol('dt', name, box); make('dd', '', '', box); }
      change(box.lastChild, 'textContent', `${sign}${value}`);
    });
  }
  exact(answer) {
    if (this.last) this.facts(this.last, false);
    this.findings(answer.design.findings);
    $('requirements').classList.remove('preview');
    this.around.mapped();
    $('step-design').classList.remove('stale');
  }
  took(answer) {
    if (!answer.design) return;
    const {requirements, moves} = answer.design;
    table($('requirements'), requirements.header, requirements.lines, 'Requirements');
    table($('moves-table'), moves.header, moves.lines, 'Moves of the model with the exact law');
  }
  /** Doubts about rig, model and payloads are known before anything is searched for. */
  doubted(doubts) {
    this.doubts = doubts || [];
    if (this.searching) this.late();
  }
  /** The curves belong to an earlier request: say why. */
  unmet(head, text) {
    const place = emptied('refused');
    place.hidden = false;
    make('b', '', head, place);
    place.append(text);
    $('step-design').classList.add('stale');
    this.app.refuse(true);
    return place;
  }
  /** No answer yet. */
  late() {
    this.searching = true;
    this.unmet(this.doubts.map(({message, remedy}) => `${capital(message)} (${remedy}). `).join(''), 'Searching for a controller that meets this request …');
  }
  refuse({condition, explanation, error, nearest = {}}) {
    const place = this.unmet(condition ? `${capital(condition)}: ` : 'Not possible. ', explanation || error);
    if (Object.keys(nearest).length) {
      button('Use the nearest feasible request', '', place, () => this.app.once(() => { this.app.state = {...this.app.state, ...nearest}; }));
    }
    this.app.say(error);
  }

  drawBudget(shares) {
    const place = emptied('p-budget'), row = (name, from, value, kind) => {
      const line = make('div', 'share', '', place), ends = [from, from + value].map((v) => limited(v, 0, 200) / 2);
      make('span', '', name, line);
      const bar = make('i', `bar ${kind}`, '', make('b', '', '', line));
      Object.assign(bar.style, {left: `${Math.min(...ends)}%`, width: `${Math.abs(ends[1] - ends[0])}%`});
      make('span', 'value', `${plain(Number(value.toFixed(1)))}°`, line);
    };
    let sum = 180;
    for (const [name, value] of shares) { row(name, sum, value, value < 0 ? 'lag' : 'lead'); sum += value; }
    row('remaining phase margin', 0, sum, 'rest');
  }

  /** Simulate the moves of three payloads in the page, 1 ms each; no more often than can be seen. */
  moves() {
    if (this.moving) return;
    this.moving = setTimeout(() => { this.moving = 0; this.drawMoves(); }, 60);
  }
  drawMoves() {
    if (!this.last) return;
    this.drawBudget(this.last.budget);
    const {three} = this.last, found = this.arm.runs(three);
    if (!found) return;
    const room = Math.max(8, 0.8 * Math.abs(found.goal)), low = Math.min(0, found.goal) - room / 2, high = Math.max(0, found.goal) + room;
    const until = Math.min(found.until * found.period, 2.5), few = (list) => list.filter((_, k) => k % 3 === 0 && k * found.period <= until); // a pixel is three periods wide
    this.tip.axes({low: 0, high: until}, {low, high});
    const cut = few(found.reference.map((_, k) => k * found.period));
    this.tip.curve('reference', 'reference', cut, few(found.reference));
    this.tip.curve('motor PID alone', 'alone', cut, few(found.alone));
    KINDS.forEach((kind, i) => this.tip.curve(kind, kind, cut, few(found.tips[i])));
    for (const {letter, seen} of this.around.others()) if (seen.blocks) this.tip.curve(letter, `other ${letter}`, cut, few(this.arm.runs([three[1]], seen.blocks).tips[0]), letter);
  }
}
