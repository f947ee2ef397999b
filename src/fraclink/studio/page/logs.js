// Steps 1 to 3: the log, its channels on the arm, and the fits.
import {Plot, spark} from './plot.js';
import {$, make, button, choices, emptied, findings, on, table, takes, say} from './dom.js';
import {upload} from './link.js';
import {el, limited, plain, put} from './svg.js';

const PLOTS = ['angle', 'output', 'fitted', 'rest', 'spectrum', 'response', 'turn', 'coherence'];
const peak = (ys) => ys.reduce((a, v) => Math.max(a, Math.abs(v)), 1e-9);
const evenly = (ys, duration) => Array.from(ys, (_, i) => (duration * i) / (ys.length - 1));
const TURN = 14, BEND = 7, LENGTH = 320; // of the drawn arm: largest angles in degrees, and its length in pixels

export class Logs {
  constructor(app) {
    Object.assign(this, {app, known: null, roles: {}, log: null, keep: null, heldout: 0.4, duration: 10});
    this.chosen = false; // if false, the fits use the defaults of the command line
    takes($('drop'), (data) => this.sent(data.files[0]));
    on(window, 'dragover drop', (event) => event.preventDefault()); // a file dropped outside the field must not replace the page
    on('pick', 'click', () => $('file').click());
    on('file', 'change', () => this.sent($('file').files[0]));
    on('rig', 'change', () => this.rig($('rig').value));
    on('read', 'click', () => this.read());
    on('fit', 'click', () => this.fit());
    for (const name of PLOTS) this[name] = new Plot(`p-${name}`);
    const hold = (v) => { this.heldout = Math.round(100 - limited(v, 10, 95)) / 100; this.chosen = true; };
    const hand = {change: () => this.split(), end: () => this.fit()};
    this.fitted.handle({
      id: 'h-split', label: 'Start of the held-out part', unit: 's', low: 10, high: 95, step: 1, drag: 'x', line: true,
      get: () => 100 * (1 - this.heldout), set: hold, toAxis: (v) => (v / 100) * this.duration, fromAxis: (t) => (100 * t) / this.duration,
      at: () => [(1 - this.heldout) * this.duration, this.fitted.y.low], text: (v) => `${plain((v / 100) * this.duration, 3)} s, ${Math.round(100 - v)} % held out`,
    }, hand);
    this.fitted.painted(hand, (from, to) => hold((100 * to[0]) / this.duration));
    this.cutting();
    this.replaying();
  }

  // ---- a section of the log ----
  cutting() {
    this.cut = [0, 10];
    const hand = {change: () => this.brush()};
    this.two = [this.angle, this.output];
    this.edges = ['Start', 'End'].map((word, i) => this.angle.handle({
      id: `h-cut-${i}`, label: `${word} of the marked stretch`, unit: 's', low: 0, high: 10, step: 0.1, drag: 'x', line: true,
      get: () => this.cut[i], set: (v) => { this.cut[i] = v; if (this.cut[0] > this.cut[1]) this.cut[1 - i] = v; }, at: () => [this.cut[i], 0],
    }, hand).h);
    for (const plot of this.two) plot.painted(hand, (from, to) => { this.cut = [from[0], to[0]].sort((a, b) => a - b); }, () => this.log?.cuts);
    on('cut-keep', 'click', () => this.taken(this.cut));
    on('cut-all', 'click', () => this.taken(null));
  }
  taken(keep) { this.keep = keep && keep.map((t) => Number(t.toFixed(3))); this.read(); }
  brush() {
    const [a, b] = this.cut, {duration, keep} = this.log, [from, to] = keep || [0, duration], whole = a <= 0 && b >= duration;
    for (const plot of this.two) {
      plot.box('before', 'held', [0, from], null);
      plot.box('behind', 'held', [to, duration], null);
      if (whole) plot.remove('brush'); else plot.box('brush', 'brush', [a, b], null);
      plot.place();
    }
    say('cut-said', whole ? '' : `Marked: ${plain(a)} to ${plain(b)} s`);
    $('cut-keep').disabled = whole || b - a < 0.1;
    $('cut-all').hidden = !keep;
  }

  // ---- the drawn arm ----
  replaying() {
    let before = 0;
    const frame = (now) => {
      if (!this.playing || $('step-channels').hidden) { this.play(false); return; }
      this.pose((this.at + (now - before) / 1e3) % this.log.duration);
      before = now;
      requestAnimationFrame(frame);
    };
    on('replay', 'click', () => { this.play(!this.playing); if (this.playing) requestAnimationFrame((now) => frame(before = now)); });
    on('replay-at', 'input', () => { this.play(false); this.pose((Number($('replay-at').value) / 1e3) * this.log.duration); });
  }
  play(on) { this.playing = on; say('replay', on ? 'Stop' : 'Replay the log'); }
  /** The arm at a time of the log: the hub at the motor's angle, the tip behind it by the deflection. */
  pose(t) {
    const {motor, output, duration, turn, bend, unit} = this.log, i = Math.round((t / duration) * (motor.length - 1));
    const at = (angle, r) => `${(104 + r * Math.cos((angle * Math.PI) / 180)).toFixed(1)} ${(120 - r * Math.sin((angle * Math.PI) / 180)).toFixed(1)}`;
    const hub = turn * motor[i], tip = hub - bend * output[i];
    this.at = t;
    put($('blade'), {d: `M104 120Q${at(hub, LENGTH / 2)} ${at(tip, LENGTH)}`});
    put($('hub'), {transform: `rotate(${(-hub).toFixed(2)} 104 120)`});
    put($('load-drawn'), {transform: `translate(${at(tip, LENGTH)})`});
    $('replay-at').value = (1e3 * t) / duration;
    say('replay-said', `${t.toFixed(2)} s: motor ${plain(motor[i], 3)}°, ${unit[0]} ${plain(output[i], 3)} ${unit[1]}`);
    for (const plot of this.two) plot.box('now', 'cursor', [t, t], null);
  }

  async sent(file) {
    if (!file) return;
    say('log-said', `Reading ${file.name} …`);
    const why = await upload(file, file.name, this.app.link.token);
    if (why) { this.app.toast(why); say('log-said', ''); return; }
    if (/\.(toml|json)$/.test(file.name)) this.rig('upload');
    else this.open('upload');
  }
  async rig(name) {
    const answer = await this.app.need('rig', {name});
    if (!answer) return;
    await this.app.renew(answer);
    this.app.begun();
    this.open();
  }
  async open(name) {
    const answer = await this.app.need('log', name ? {name} : {}, 'log-said');
    $('log-said').classList.toggle('bad', !answer);
    if (!answer) return;
    this.app.study.copies = answer.copies;
    this.app.line();
    this.known = answer;
    if (name) this.keep = null;
    this.lists(answer);
    this.experiment(answer);
    if (!answer.log) { say('log-said', answer.experiment ? `${answer.experiment.said} Drop the file here to see its channels.` : ''); return; }
    if (name || !Object.keys(this.roles).length) this.roles = {...answer.roles};
    this.channels(answer);
    this.slots();
    if (name) this.read(true);
  }
  lists(answer) {
    const place = emptied('bundled');
    for (const name of answer.bundled) button(name, 'chip', place, () => this.open(name)).dataset.name = name;
    choices(emptied('rig'), answer.rigs, answer.rig || undefined);
  }
  channels(answer) {
    const {log} = answer;
    say('log-said', log.said);
    const place = emptied('channels'), chips = emptied('chips');
    log.channels.forEach((channel, k) => {
      const card = make('div', 'card channel', '', place), head = make('div', 'card-head', '', card);
      make('b', '', channel.name, head);
      make('span', 'unit', channel.unit || '', head);
      const svg = el('svg', {viewBox: '0 0 240 44', class: 'spark', role: 'img', 'aria-label': `${channel.name} over time`, preserveAspectRatio: 'none'}, card);
      el('path', {d: spark(answer.curves[`spark${k}`]?.[0] || [], 240, (v) => 41 - 38 * v)}, svg);
      make('p', 'hint', channel.facts, card);
      const chip = make('span', 'chip drag', channel.name, chips);
      chip.draggable = true;
      on(chip, 'dragstart', (event) => event.dataTransfer.setData('text/plain', channel.name));
    });
    if (answer.guesses?.length) {
      const why = make('details', 'card', '', place);
      make('summary', '', 'Why these columns', why);
      table(make('div', 'tablebox', '', why), ['what', 'taken as', 'how sure', 'why'], answer.guesses.map((g) => [g.part, g.value, g.certainty, g.evidence]));
    }
  }

  /** The arm with a place for each channel. */
  slots() { for (const box of document.querySelectorAll('[data-role]')) this.slot(box); }
  slot(old) {
    // A new copy: with the listeners added to the same element again, it would receive a drop twice.
    const {role} = old.dataset, set = this.roles[role], box = old.cloneNode(true), words = box.firstElementChild.textContent;
    while (box.children.length > 2) box.lastElementChild.remove();
    old.replaceWith(box);
    box.className = `slot${set ? ' set' : ''}`;
    const select = (label, names, chosen, change) => {
      const made = choices(put(make('select', '', '', box), {'aria-label': `${label} of the ${words.toLowerCase()}`}), names, chosen);
      on(made, 'change', () => change(made.value));
    };
    const place = (name) => {
      if (name) {
        if (role === 'torque') delete this.roles.deflection;
        if (role === 'deflection') delete this.roles.torque;
        this.roles[role] = {column: name, unit: (this.known.units[role] || [''])[0], sign: 1, scale: 1, ...(set || {}), ...{column: name}};
      } else delete this.roles[role];
      this.slots();
    };
    select('Channel', ['', ...this.known.log.channels.map((c) => c.name)], set?.column || '', place);
    takes(box, (data) => place(data.getData('text/plain')));
    if (!set) return;
    select('Unit', this.known.units[role] || [], set.unit, (name) => { set.unit = name; });
    if (role === 'time') return;
    const turned = set.sign < 0;
    put(button(turned ? '− reversed' : '+ as recorded', 'chip', box, () => { set.sign = -set.sign; this.slots(); }, `Sign of the ${words.toLowerCase()}: ${turned ? 'reversed' : 'as recorded'}`), {'aria-pressed': turned});
  }
  async read(quiet = false) {
    const columns = Object.entries(this.roles).map(([role, c]) => `${role}=${c.sign < 0 ? '-' : ''}${c.column}${c.scale && c.scale !== 1 ? ` * ${c.scale}` : ''} [${c.unit}]`);
    const grams = Number($('log-payload').value), given = {columns: quiet && !grams ? [] : columns};
    if (grams > 0) given.payload = grams / 1e3;
    if (this.keep) given.keep = this.keep;
    const answer = await this.app.ask('columns', given);
    if (!answer.ok) {
      if (quiet) { this.app.toast('State the columns of this log in step 2'); return; }
      findings($('log-findings'), [{severity: 'error', message: answer.error}]);
      return;
    }
    this.app.took(answer);
    say('toml', answer.toml || $('toml').textContent);
    this.experiment(answer);
  }
  experiment(answer) {
    const known = answer.experiment;
    if (!known) return;
    findings($('log-findings'), known.findings);
    say('p-output-name', known.kind === 'torque' ? 'Torque of the gauge [N·m]' : 'Deflection [rad]');
    if (known.payload && !$('log-payload').value) $('log-payload').placeholder = plain(1e3 * known.payload);
    const motor = answer.curves.motor_angle?.[0], output = answer.curves.output?.[0], {duration, keep, whole} = known;
    if (!motor) return;
    const flagged = known.findings.filter((f) => f.evidence?.time_s !== undefined).map((f) => ({...f, at: f.evidence.time_s + (keep?.[0] || 0)}));
    this.log = {motor, output, duration, keep, cuts: whole, turn: Math.min(1, TURN / peak(motor)), bend: BEND / peak(output), unit: known.kind === 'torque' ? ['torque', 'N·m'] : ['deflection', 'rad']};
    this.keep = keep;
    for (const plot of this.two) Object.assign(plot, {flagged});
    this.over(this.angle, motor, 'nominal');
    this.over(this.output, output, 'heavy');
    $('cut').hidden = !whole;
    $('replayed').hidden = false;
    this.edges.forEach((edge) => { edge.high = duration; });
    this.cut = [...(keep || [0, duration])];
    this.brush();
    this.pose(keep?.[0] || 0);
    say('drawn-said', `${this.log.turn < 1 ? `Angles are drawn at ${plain(this.log.turn, 2)} of their size` : 'Angles are to scale'}; the largest bend is drawn as ${BEND}°.`);
  }
  over(plot, ys, kind) {
    const {duration} = this.log, high = 1.08 * peak(ys);
    plot.axes({low: 0, high: duration}, {low: -high, high});
    plot.lay(); // draws the new flags even if the axes are unchanged
    plot.curve('log', kind, evenly(ys, duration), ys);
  }

  // ---- the fits ----
  async models(structure) {
    if (structure) this.app.outdated(true);
    const answer = await this.app.need('model', structure ? {structure} : {});
    if (!answer) { if (structure) this.app.outdated(false); return; }
    this.drawModels(answer);
    if (structure) this.app.renew(answer);
  }
  async fit() {
    $('fit').disabled = true;
    say('model-said', 'Fitting four structures …');
    const answer = await this.app.need('identify', this.chosen ? {heldout: this.heldout} : {}, 'model-said');
    $('fit').disabled = false;
    if (!answer) return;
    this.drawModels(answer);
    this.app.renew(answer);
  }
  drawModels(answer) {
    const place = emptied('models');
    for (const fit of answer.fits) {
      const card = button('', `card model${fit.used ? ' used' : ''}`, place, () => this.models(fit.name));
      put(card, {'aria-pressed': fit.used});
      const head = make('span', 'card-head', '', card);
      make('b', '', fit.name, head);
      make('span', fit.passed ? 'good' : 'bad', fit.passed ? '✓' : '✗', head);
      make('span', 'hint', fit.what, card);
      const error = fit.heldout_nmse === null ? '' : `held-out error ${plain(100 * fit.heldout_nmse, 2)} %`;
      make('span', '', error, card);
    }
    const used = answer.fits.find((fit) => fit.used);
    say('model-words', answer.said);
    say('model-said', answer.conclusion);
    findings($('model-findings'), used?.findings);
    table($('model-table'), answer.table?.header, answer.table?.lines, 'All four structures');
    for (const plot of PLOTS.slice(2)) for (const name of [...this[plot].curves.keys()]) this[plot].remove(name);
    if (!answer.plots) return;
    this.duration = answer.duration;
    this.heldout = Math.round(100 * answer.heldout) / 100;
    for (const [plot, {axes, lines}] of Object.entries(answer.plots)) {
      this[plot].axes(...axes);
      lines.forEach(([name, kind], k) => this[plot].curve(name, kind, ...answer.curves[`${plot} ${k}`]));
    }
    say('model-unit', answer.plots.fitted.label);
    this.split();
  }
  split() { this.fitted.box('held', 'held', [(1 - this.heldout) * this.duration, this.duration], null); }
}
