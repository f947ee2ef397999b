// Steps 6 and 7: the certificate, the trials, and the exported files.
import {Plot, ends, joined, ring} from './plot.js';
import {$, make, button, emptied, items, on, table, say} from './dom.js';
import {plain} from './svg.js';

const precision = () => document.querySelector('input[name=precision]:checked').value;
const JOBS = ['prove', 'arms', 'faults'];

export class Proof {
  constructor(app, arm) {
    this.app = app;
    this.arm = arm;
    this.cells = {};
    for (const verb of JOBS) on(verb, 'click', () => this.work(verb));
    on('cancel', 'click', () => this.app.ask('cancel'));
    this.swept = new Plot('p-swept');
    this.plane = new Plot('p-nyquist');
    this.arms = new Plot('p-fan');
    on(document.querySelector('.choice'), 'change', () => this.board());
    for (const one of document.querySelectorAll('[data-target]')) on(one, 'click', () => this.export(one.dataset.target));
  }

  async work(verb) {
    const busy = (on) => { for (const id of JOBS) $(id).disabled = on; $('progress').hidden = !on; };
    busy(true);
    $('bar').removeAttribute('value');
    say('progress-said', 'Starting …');
    if (verb === 'faults') this.matrix();
    const answer = await this.app.need(verb, {}, 'proof-said');
    busy(false);
    if (!answer) return;
    this.result(answer);
    if (verb === 'arms') this.open();
  }
  /** Show the results of the study so far. */
  async open() {
    this.draw();
    const answer = await this.app.ask('proof');
    if (answer.ok) this.result(answer);
  }
  /** Show what the board needs for this law, and how to switch it on. */
  async board() {
    const {board, power_on} = await this.app.need('board', {precision: precision()});
    table($('board-facts'), ['need', 'built for this design', 'with room for any design'], board, 'What the board needs');
    items('power-on', power_on);
  }
  fan({fan_t, ...fans}) {
    $('moves-of-arms').hidden = !fan_t;
    for (const [name, kind] of [['fan_passed', 'fan'], ['fan_failed', 'fan failed']]) {
      const rows = fans[name] || [];
      if (fan_t) this.arms.curve(name, kind, joined(rows.map(() => fan_t[0])), joined(rows));
    }
  }
  sweep({swept, curves}) {
    const {payloads: x, delays: y} = swept, {box} = this;
    this.swept.axes(ends(x), ends(y));
    this.swept.cells(x, y, swept.near, [-9, -0.6, -0.5, -0.3, 0], (v, n) => (v > 0 ? 'unstable' : plain(-v, n)));
    if (box) this.swept.box('proved', 'proved', box.payloads, box.delays);
    else this.swept.remove('proved');
    this.plane.curve('sweep', 'fan', joined(curves.sweep_x), joined(curves.sweep_y));
    ['light', 'nominal', 'heavy'].forEach((kind, i) => this.plane.curve(kind, kind, curves.sweep_x[2 * i], curves.sweep_y[2 * i]));
    this.plane.names = Object.fromEntries(['light', 'nominal', 'heavy'].map((kind, i) => [kind, swept.names[i]]));
  }
  progress(answer) {
    say('progress-said', answer.said);
    if (answer.all) { $('bar').max = answer.all; $('bar').value = answer.done; }
    if (answer.fault) this.cell(answer);
  }
  matrix() { this.cells = {}; emptied('matrix'); }
  /** One row per fault, one column per severity and payload; a cell shows its worst run. */
  cell({fault, severity, payload, phase, passed}) {
    const id = `${fault}|${severity}|${payload}`;
    let square = this.cells[id];
    if (!square) {
      let row = this.cells[fault];
      if (!row) {
        row = this.cells[fault] = make('div', 'faultrow', '', $('matrix'));
        make('span', 'faultname', fault, row);
      }
      square = this.cells[id] = make('span', 'cell good', '✓', row);
      square.title = `${fault}, severity ${severity}, ${plain(1e3 * payload)} g`;
    }
    if (passed || square.matches('.bad')) return;
    const words = `${square.title}: see it happen`, failed = this.cells[id] = button('✗', 'cell bad', null, () => this.arm.play('fault', {fault, severity, payload, phase}), words);
    failed.title = words;
    square.replaceWith(failed);
  }
  result(answer) {
    if (answer.proved) say('proof-said', answer.proved.text);
    if (answer.spread) table($('spread'), answer.spread.header, answer.spread.lines, `${answer.failures.count} of ${answer.failures.runs} arms failed`);
    if (answer.faults) table($('faults-table'), answer.faults.header, answer.faults.lines, answer.faults_said);
    if (answer.cells) {
      this.matrix();
      for (const cell of answer.cells) this.cell(cell);
    }
    this.modulus = answer.proved?.modulus ?? this.modulus;
    this.box = answer.proved || this.box;
    this.swept.lay();
    if (answer.swept) { this.sweep(answer); this.fan(answer.curves); }
    this.draw();
  }
  took(answer) {
    if (!answer.certificate) this.modulus = this.box = undefined;
    say('proof-said', answer.proof_said);
    const files = Object.entries(answer.files || {});
    say('board-said', answer.board_said);
    table($('files'), ['file', 'bytes'], files.map(([name, size]) => [name, String(size)]));
    if (this.app.step === 'proof') this.draw();
  }

  draw() {
    const points = ring(-1, this.modulus);
    if (this.modulus) this.plane.curve('disk', 'disk', points.map((p) => p[0]), points.map((p) => p[1])); else this.plane.remove('disk');
    this.plane.cross('critical', -1, 0);
  }

  async export(target, force = false) {
    const answer = await this.app.ask('export', {target, precision: precision(), force});
    if (answer.ok) {
      this.app.took(answer);
      say('board-said', answer.export_command);
      this.app.toast(`Wrote ${Object.keys(answer.written).length} files`);
    } else if (/already|exists|overwrit/i.test(answer.error) && !force) {
      this.app.replace(answer.error, () => this.export(target, true));
    } else say('board-said', answer.error);
  }
}
