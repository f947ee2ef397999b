// Steps 6 and 7: the certificate, the trials, and the exported files.
import {Plot, ends, joined, ring} from './plot.js';
import {$, make, button, emptied, on, table, say} from './dom.js';
import {plain} from './svg.js';

const precision = () => document.querySelector('input[name=precision]:checked').value;
const JOBS = ['prove', 'arms', 'faults'];

export class Proof {
  constructor(app, arm) {
    this.app = app;
    this.arm = arm;
    this.cells = {};
    this.proved = null;
    for (const verb of JOBS) on(verb, 'click', () => this.work(verb));
    on('cancel', 'click', () => this.app.ask('cancel'));
    this.swept = new Plot('p-swept');
    this.plane = new Plot('p-nyquist');
    this.plane.cross('critical', -1, 0);
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
    this.result(answer); // the loop over payload and delay takes longer
    this.open();
  }
  /** Show the results of the study so far. */
  async open() {
    this.draw();
    const answer = await this.app.ask('proof');
    if (answer.ok) this.result(answer);
  }
  result(answer) {
    const {proved, spread, failures, faults, cells, swept} = answer;
    this.proved = proved;
    if (proved) say('proof-said', proved.text);
    if (spread) table($('spread'), spread.header, spread.lines, `${failures.count} of ${failures.runs} arms failed`);
    if (faults) table($('faults-table'), faults.header, faults.lines, answer.faults_said);
    if (cells) {
      this.matrix();
      for (const cell of cells) this.cell(cell);
    }
    this.swept.lay();
    if (swept) { this.sweep(answer); this.fan(answer.curves); }
    this.draw();
  }
  /** Show what the board needs for this law, and how to switch it on. */
  async board() {
    const {board, power_on} = await this.app.need('board', {precision: precision()});
    table($('board-facts'), ['need', 'built for this design', 'with room for any design'], board, 'What the board needs');
    $('power-on').replaceChildren(...power_on.map((text) => make('li', '', text)));
  }
  fan({fan_t, ...fans}) {
    $('moves-of-arms').hidden = !fan_t;
    for (const [name, kind] of [['fan_passed', 'fan'], ['fan_failed', 'fan failed']]) {
      const rows = fans[name] || [];
      if (fan_t) this.arms.curve(name, kind, joined(rows.map(() => fan_t[0])), joined(rows));
    }
  }
  sweep({swept, curves}) {
    const {payloads: x, delays: y} = swept, {proved} = this;
    this.swept.axes(ends(x), ends(y));
    this.swept.cells(x, y, swept.near, [-9, -0.6, -0.5, -0.3, 0], (v, n) => (v > 0 ? 'unstable' : plain(-v, n)));
    if (proved) this.swept.box('proved', 'proved', proved.payloads, proved.delays);
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
    const {cells} = this, title = `${fault}, severity ${severity}, ${plain(1e3 * payload)} g`, words = `${title}: see it happen`;
    if (!cells[fault]) make('span', 'faultname', fault, cells[fault] = make('div', 'faultrow', '', $('matrix')));
    cells[title] ||= Object.assign(make('span', 'cell good', '✓', cells[fault]), {title});
    if (passed || cells[title].matches('.bad')) return;
    const failed = button('✗', 'cell bad', null, () => this.arm.play('fault', {fault, severity, payload, phase}), words);
    failed.title = words;
    cells[title].replaceWith(failed);
    cells[title] = failed;
  }
  took(answer) {
    if (!answer.certificate) this.proved = null;
    say('proof-said', answer.proof_said);
    const files = Object.entries(answer.files || {});
    say('board-said', answer.board_said);
    table($('files'), ['file', 'bytes'], files.map(([name, size]) => [name, String(size)]));
    if (this.app.step === 'proof') this.draw();
  }

  draw() { if (this.proved) this.plane.curve('disk', 'disk', ...ring(-1, this.proved.modulus)); else this.plane.remove('disk'); }

  export(target) {
    this.app.write('export', {target, precision: precision()}, ({written, export_command}) => {
      say('board-said', export_command);
      this.app.toast(`Wrote ${Object.keys(written).length} files`);
    }, (error) => say('board-said', error));
  }
}
