// @ts-check
// Steps 6 and 7: what was proved and tried, and the files that leave the house.
import {Plot, plain} from './plot.js';
import {$, arm, make, button, table} from './studio.js';
import {download} from './link.js';

export class Proof {
  constructor(app) {
    this.app = app;
    this.cells = {};
    for (const verb of ['prove', 'arms', 'faults']) $(verb).addEventListener('click', () => this.work(verb));
    $('cancel').addEventListener('click', () => this.app.ask('cancel'));
    this.swept = new Plot('p-swept', {low: 10, high: 60, log: true}, {low: 0, high: 30});
    this.plane = new Plot('p-nyquist', {low: -2.6, high: 1.2}, {low: -1.8, high: 1.2});
    for (const one of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll('[data-target]'))) one.addEventListener('click', () => this.export(one.dataset.target));
    $('zip').addEventListener('click', async () => {
      const answer = await app.link.ask('zip');
      const why = answer.ok ? await download(app.link.token, 'fraclink.zip') : answer.error;
      if (why) app.toast(why);
    });
  }

  async work(verb) {
    const busy = (on) => { for (const id of ['prove', 'arms', 'faults']) $(id).disabled = on; $('progress').hidden = !on; };
    busy(true);
    $('bar').removeAttribute('value');
    $('progress-said').textContent = 'Starting …';
    if (verb === 'faults') { this.cells = {}; $('matrix').replaceChildren(); }
    const answer = await this.app.ask(verb);
    busy(false);
    if (!answer.ok) { $('proof-said').textContent = answer.error; return; }
    this.app.took(answer);
    this.result(answer);
  }
  /** What the study as it stands has to show. */
  async open() {
    this.draw();
    const answer = await this.app.ask('proof');
    if (answer.ok) this.result(answer);
  }
  sweep({swept, curves}) {
    const x = swept.payloads.map((m) => 1e3 * m), y = swept.delays.map((t) => 1e3 * t), last = (list) => list[list.length - 1];
    this.swept.axes({...this.swept.x, low: x[0], high: last(x)}, {low: y[0], high: last(y)});
    this.swept.cells(x, y, swept.near, [-9, -0.6, -0.5, -0.3, 0]);
    this.swept.mark('proved', 'proved', () => { const b = this.box; return b ? `M${this.swept.X(1e3 * b.payloads[0])} ${this.swept.Y(Math.max(y[0], 1e3 * b.delays[0]))}H${this.swept.X(1e3 * b.payloads[1])}V${this.swept.Y(1e3 * b.delays[1])}H${this.swept.X(1e3 * b.payloads[0])}Z` : ''; });
    const joined = (rows) => rows.flatMap((row) => [...row, NaN]);
    this.plane.curve('sweep', 'fan', joined(curves.sweep_x), joined(curves.sweep_y));
    ['light', 'nominal', 'heavy'].forEach((kind, i) => this.plane.curve(kind, kind, curves.sweep_x[2 * i], curves.sweep_y[2 * i], `${plain(1e3 * swept.three[i], 3)} g`));
  }
  progress(answer) {
    $('progress-said').textContent = answer.said || `${answer.done} of ${answer.all} runs${answer.fault ? `, ${answer.fault}` : ''}`;
    if (answer.all) { $('bar').max = answer.all; $('bar').value = answer.done; }
    if (answer.fault) this.cell(answer);
  }
  /** One row a fault, one column for each severity and payload; a cell is as good as its worst run. */
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
    const failed = this.cells[id] = button('✗', 'cell bad', null, () => arm.play('fault', {fault, severity, payload, phase}));
    failed.title = `${square.title}: see it happen`;
    failed.setAttribute('aria-label', failed.title);
    square.replaceWith(failed);
  }
  result(answer) {
    if (answer.proved) $('proof-said').textContent = answer.proved.text;
    if (answer.spread) table($('spread'), answer.spread.header, answer.spread.rows, `${answer.failures.count} of ${answer.failures.runs} arms fail`);
    if (answer.faults) table($('faults-table'), answer.faults.header, answer.faults.rows, answer.faults_said);
    if (answer.cells) {
      this.cells = {};
      $('matrix').replaceChildren();
      for (const cell of answer.cells) this.cell(cell);
    }
    this.modulus = answer.proved?.modulus ?? this.modulus;
    this.box = answer.proved || this.box;
    this.swept.lay();
    if (answer.swept) this.sweep(answer);
    this.draw();
  }
  took(answer) {
    if (!answer.certificate) { this.modulus = this.box = undefined; $('proof-said').textContent = answer.uncertified ? `Not proved: ${answer.uncertified}` : ''; } else $('proof-said').textContent = answer.certificate;
    const files = Object.entries(answer.files || {});
    $('board-said').textContent = files.length ? `Written into ${answer.folder}.` : answer.design ? 'Nothing written yet.' : 'Make a design first (step 4).';
    $('zip').hidden = !files.length;
    table($('files'), ['file', 'bytes'], files.map(([name, size]) => [name, String(size)]));
    if (this.app.step === 'proof') this.draw();
  }

  draw() {
    const disk = (name, kind, r) => {
      const turn = Array.from({length: 91}, (_, k) => (2 * Math.PI * k) / 90);
      this.plane.curve(name, kind, turn.map((a) => -1 + r * Math.cos(a)), turn.map((a) => r * Math.sin(a)));
    };
    if (this.modulus) disk('disk', 'disk', this.modulus); else this.plane.remove('disk');
    this.plane.mark('critical', 'critical', () => { const x = this.plane.X(-1), y = this.plane.Y(0); return `M${x - 6} ${y}H${x + 6}M${x} ${y - 6}V${y + 6}`; });
  }

  async export(target, force = false) {
    const precision = /** @type {HTMLInputElement} */ (document.querySelector('input[name=precision]:checked')).value;
    const answer = await this.app.ask('export', {target, precision, force});
    if (answer.ok) {
      this.app.took(answer);
      $('board-said').textContent = answer.export_command;
      this.app.toast(`Wrote ${Object.keys(answer.written).length} files`);
    } else if (/already|exists|overwrit/i.test(answer.error) && !force) {
      $('replace-said').textContent = answer.error;
      $('replace').showModal();
      $('replace').addEventListener('close', () => { if ($('replace').returnValue === 'yes') this.export(target, true); }, {once: true});
    } else { $('board-said').textContent = answer.error; }
  }
}
