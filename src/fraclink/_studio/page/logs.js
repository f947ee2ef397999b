// @ts-check
// Steps 1 to 3: the log, its channels on the arm, and the fits.
import {Plot, el, plain} from './plot.js';
import {$, make, button, table, findings, send} from './studio.js';

export class Logs {
  constructor(app) {
    this.app = app;
    this.known = null;
    this.roles = {};
    const drop = $('drop');
    $('pick').addEventListener('click', () => $('file').click());
    $('file').addEventListener('change', () => this.sent($('file').files[0]));
    for (const type of ['dragenter', 'dragover']) drop.addEventListener(type, (event) => { event.preventDefault(); drop.classList.add('over'); });
    drop.addEventListener('dragleave', () => drop.classList.remove('over'));
    drop.addEventListener('drop', (event) => { event.preventDefault(); drop.classList.remove('over'); this.sent(event.dataTransfer.files[0]); });
    for (const type of ['dragover', 'drop']) addEventListener(type, (event) => event.preventDefault()); // a file beside the field must not replace the page
    $('rig').addEventListener('change', () => this.rig($('rig').value));
    $('read').addEventListener('click', () => this.read());
    $('fit').addEventListener('click', () => this.fit());
    this.angle = new Plot('p-angle');
    this.output = new Plot('p-output');
    this.overlay = new Plot('p-fit');
    this.rest = new Plot('p-rest');
    this.spectrum = new Plot('p-spectrum', {low: 0.1, high: 100, log: true, text: (v) => `${plain(v)} Hz`}, {low: -100, high: 5});
    this.bode = new Plot('p-response', {low: 1, high: 300, log: true}, {low: -60, high: 20});
    this.trust = new Plot('p-coherence', {low: 1, high: 300, log: true}, {low: 0, high: 1, ticks: [0, 0.5, 1]});
    this.valley = new Plot('p-valley', {low: 10, high: 12, log: true, text: (v) => plain(v, 3)}, {low: 1.8, high: 2});
    this.heldout = 0.4;
    this.chosen = false; // else the fits take what the command line takes
    this.duration = 10;
    const hand = {begin: () => {}, change: () => this.overlay.lay(), end: () => this.fit(), cancel: () => this.overlay.lay()};
    this.overlay.handle({
      id: 'h-split', label: 'Where the part begins that no fit sees', unit: 's', low: 10, high: 95, step: 1, drag: 'x', line: true,
      get: () => 100 * (1 - this.heldout), set: (v) => { this.heldout = Math.round(100 - v) / 100; this.chosen = true; },
      toAxis: (v) => (v / 100) * this.duration, fromAxis: (t) => (100 * t) / this.duration,
      at: () => [(1 - this.heldout) * this.duration, this.overlay.y.low], text: (v) => `${plain((v / 100) * this.duration, 3)} s, ${Math.round(100 - v)} % held out`,
    }, hand);
    this.overlay.painted(hand, (from, to) => { this.heldout = Math.round(100 - Math.min(95, Math.max(10, (100 * to[0]) / this.duration))) / 100; this.chosen = true; });
  }

  async sent(file) {
    if (!file) return;
    $('log-said').textContent = `Reading ${file.name} …`;
    if (!(await send(file, file.name))) { $('log-said').textContent = ''; return; }
    if (file.name.endsWith('.toml')) this.rig('upload');
    else this.open('upload');
  }
  async rig(name) {
    const answer = await this.app.need('rig', {name});
    if (!answer) return;
    this.app.took(answer);
    this.app.states = [];
    this.app.at = -1;
    await this.app.renew(answer);
    this.app.states = [structuredClone(this.app.state)];
    this.app.at = 0;
    this.app.buttons();
    this.open();
  }
  async open(name) {
    const answer = await this.app.ask('log', name ? {name} : {});
    if (!answer.ok) { $('log-said').textContent = answer.error; $('log-said').className = 'lead bad'; return; }
    this.known = answer;
    this.lists(answer);
    this.experiment(answer);
    if (!answer.log) return;
    if (name || !Object.keys(this.roles).length) this.roles = {...answer.roles};
    this.channels(answer);
    this.slots();
    if (name) this.read(true);
  }
  lists(answer) {
    const place = $('bundled');
    place.replaceChildren();
    for (const name of answer.bundled) button(name === 'prbs_30g' ? 'demo: prbs_30g' : name, 'chip', place, () => this.open(name)).dataset.name = name;
    const rig = $('rig');
    rig.replaceChildren();
    for (const name of new Set([answer.rig, ...answer.rigs])) if (name) { const o = make('option', '', name, rig); o.value = name; o.selected = name === answer.rig; }
  }
  channels(answer) {
    const {log} = answer;
    $('log-said').className = 'lead';
    $('log-said').textContent = `${log.name}: ${log.kind}, ${log.channels.length} channels, ${log.channels[0]?.samples ?? 0} samples.`;
    const place = $('channels'), chips = $('chips');
    place.replaceChildren();
    chips.replaceChildren();
    log.channels.forEach((channel, k) => {
      const card = make('div', 'card channel', '', place), head = make('div', 'card-head', '', card);
      make('b', '', channel.name, head);
      make('span', 'unit', channel.unit || '', head);
      const svg = el('svg', {viewBox: '0 0 240 44', class: 'spark', role: 'img', 'aria-label': `${channel.name} over time`, preserveAspectRatio: 'none'}, card);
      const ys = answer.curves[`spark${k}`]?.[0] || [];
      el('path', {d: Array.from(ys, (v, i) => `${i ? 'L' : 'M'}${((240 * i) / Math.max(1, ys.length - 1)).toFixed(1)} ${(41 - 38 * v).toFixed(1)}`).join('')}, svg);
      const facts = [`${plain(channel.minimum)} … ${plain(channel.maximum)}`];
      if (channel.period) facts.push(`every ${plain(channel.period)}`);
      if (channel.missing) facts.push(`${channel.missing} missing`);
      const role = Object.entries(this.roles).find(([, r]) => r.column === channel.name);
      if (role) facts.unshift(role[0].replace('_', ' '));
      make('p', 'hint', facts.join(' · '), card);
      const chip = make('span', 'chip drag', channel.name, chips);
      chip.draggable = true;
      chip.addEventListener('dragstart', (event) => event.dataTransfer.setData('text/plain', channel.name));
    });
    if (answer.guesses?.length) {
      const why = make('details', 'card', '', place);
      make('summary', '', 'Why these columns', why);
      table(make('div', 'tablebox', '', why), ['what', 'taken as', 'how sure', 'why'], answer.guesses.map((g) => [g.part, g.value, g.certainty, g.evidence]));
    }
  }

  /** The arm with a place for each channel. */
  slots() { for (const box of document.querySelectorAll('[data-role]')) this.slot(/** @type {HTMLElement} */ (box)); }
  slot(old) {
    // a fresh copy: one that is shown again would hear a drop twice
    const {role} = old.dataset, set = this.roles[role], box = old.cloneNode(true), words = box.firstElementChild.textContent;
    while (box.children.length > 2) box.lastElementChild.remove();
    old.replaceWith(box);
    box.className = `slot${set ? ' set' : ''}`;
    const pick = make('select', '', '', box);
    pick.setAttribute('aria-label', `Channel of the ${words.toLowerCase()}`);
    make('option', '', '–', pick).value = '';
    for (const c of this.known.log.channels) { const o = make('option', '', c.name, pick); o.value = c.name; o.selected = set?.column === c.name; }
    const put = (name) => {
      if (name) {
        if (role === 'torque') delete this.roles.deflection;
        if (role === 'deflection') delete this.roles.torque;
        this.roles[role] = {column: name, unit: (this.known.units[role] || [''])[0], sign: 1, scale: 1, ...(set || {}), ...{column: name}};
      } else delete this.roles[role];
      this.slots();
    };
    pick.addEventListener('change', () => put(pick.value));
    box.addEventListener('dragover', (event) => { event.preventDefault(); box.classList.add('over'); });
    box.addEventListener('dragleave', () => box.classList.remove('over'));
    box.addEventListener('drop', (event) => { event.preventDefault(); put(event.dataTransfer.getData('text/plain')); });
    if (!set) return;
    const unit = make('select', '', '', box);
    unit.setAttribute('aria-label', `Unit of the ${words.toLowerCase()}`);
    for (const name of new Set([set.unit, ...(this.known.units[role] || [])])) { const o = make('option', '', name, unit); o.value = name; o.selected = name === set.unit; }
    unit.addEventListener('change', () => { set.unit = unit.value; });
    if (role === 'time') return;
    const sign = button(set.sign < 0 ? '− turned' : '+ as it is', 'chip', box, () => { set.sign = -set.sign; this.slots(); });
    sign.setAttribute('aria-pressed', String(set.sign < 0));
    sign.setAttribute('aria-label', `Sign of the ${words.toLowerCase()}: ${set.sign < 0 ? 'turned' : 'as it is'}`);
  }
  async read(quiet = false) {
    const columns = Object.entries(this.roles).map(([role, c]) => `${role}=${c.sign < 0 ? '-' : ''}${c.column}${c.scale && c.scale !== 1 ? ` * ${c.scale}` : ''} [${c.unit}]`);
    const grams = Number($('log-payload').value), given = {columns: quiet && !grams ? [] : columns};
    if (grams > 0) given.payload = grams / 1e3;
    const answer = await this.app.ask('columns', given);
    if (!answer.ok) {
      if (quiet) { this.app.toast('The columns of this log are not stated: see step 2'); return; }
      findings($('log-findings'), [{severity: 'error', code: '', message: answer.error}]);
      return;
    }
    this.app.took(answer);
    $('toml').textContent = answer.toml || $('toml').textContent;
    this.experiment(answer);
    this.app.toast('Read. Next: fit a model (step 3).');
  }
  experiment(answer) {
    const known = answer.experiment;
    if (!known) return;
    findings($('log-findings'), known.findings);
    $('p-output-name').textContent = known.kind === 'torque' ? 'Torque of the gauge [N·m]' : 'Deflection [rad]';
    if (known.payload && !$('log-payload').value) $('log-payload').placeholder = plain(1e3 * known.payload);
    this.over(this.angle, known.duration, answer.curves.motor_angle?.[0], 'nominal');
    this.over(this.output, known.duration, answer.curves.output?.[0], 'heavy');
  }
  over(plot, duration, ys, kind, name = 'log') {
    if (!ys) return;
    const most = ys.reduce((a, v) => Math.max(a, Math.abs(v)), 1e-9) * 1.08;
    plot.axes({low: 0, high: duration, text: (v) => `${plain(v)} s`}, {low: -most, high: most});
    plot.curve(name, kind, Array.from(ys, (_, i) => (duration * i) / (ys.length - 1)), ys);
  }

  // ---- the fits ----
  async models(structure) {
    const answer = await this.app.need('model', structure ? {structure} : {});
    if (!answer) return;
    this.drawModels(answer);
    if (structure) { this.app.took(answer); this.app.renew(answer); }
  }
  async fit() {
    $('fit').disabled = true;
    $('model-said').textContent = 'Fitting four structures …';
    const answer = await this.app.ask('identify', this.chosen ? {heldout: this.heldout} : {});
    $('fit').disabled = false;
    $('model-said').textContent = '';
    if (!answer.ok) { $('model-said').textContent = answer.error; return; }
    this.app.took(answer);
    this.drawModels(answer);
    this.app.renew(answer);
  }
  drawModels(answer) {
    const place = $('models');
    place.replaceChildren();
    for (const fit of answer.fits) {
      const card = button('', `card model${fit.used ? ' used' : ''}`, place, () => this.models(fit.name));
      card.setAttribute('aria-pressed', String(fit.used));
      const head = make('span', 'card-head', '', card);
      make('b', '', fit.name, head);
      make('span', fit.passed ? 'good' : 'bad', fit.passed ? '✓' : '✗', head);
      make('span', 'hint', fit.what, card);
      const error = fit.heldout_nmse === null ? '' : `held-out error ${plain(100 * fit.heldout_nmse, 2)} %`;
      make('span', '', error, card);
    }
    const used = answer.fits.find((fit) => fit.used);
    $('model-words').textContent = used ? `The arm ${used.words}.` : this.app.study.marks?.log === 'not run' ? 'Read a log first (steps 1 and 2).' : 'Not fitted yet.';
    $('model-said').textContent = answer.conclusion || '';
    findings($('model-findings'), used?.findings);
    table($('model-table'), answer.table?.header, answer.table?.rows, 'All four structures');
    const c = answer.curves;
    if (!c.measured) return;
    this.duration = answer.duration;
    this.heldout = Math.round(100 * answer.heldout) / 100;
    this.over(this.overlay, answer.duration, c.measured[0], 'measured', 'measured');
    this.overlay.curve('predicted', 'predicted', Array.from(c.predicted[0], (_, i) => (answer.duration * i) / (c.predicted[0].length - 1)), c.predicted[0]);
    this.overlay.mark('held', 'held', () => `M${this.overlay.X((1 - this.heldout) * this.duration)} 0H9999V999H${this.overlay.X((1 - this.heldout) * this.duration)}Z`);
    this.over(this.rest, answer.duration, c.residual[0], 'heavy');
    this.rest.axes(null, this.overlay.y);
    const hz = c.spectrum_hz[0];
    this.spectrum.axes({...this.spectrum.x, low: Math.max(hz[0], 0.05), high: hz[hz.length - 1]}, null);
    this.spectrum.curve('log', 'measured', hz, c.spectrum_log[0]);
    const w = c.response_w[0], [first, last] = [w[0], w[w.length - 1]], top = Math.max(...c.response_log[0], ...c.response_model[0]) + 5;
    this.bode.axes({...this.bode.x, low: first, high: last}, {low: top - 70, high: top});
    this.bode.curve('log', 'measured', w, c.response_log[0]);
    this.bode.curve('model', 'predicted', w, c.response_model[0]);
    this.trust.axes(this.bode.x, null);
    this.trust.curve('coherence', 'heavy', w, c.coherence[0]);
    const [x, y] = [c.error_resonance[0], c.error_order[0]];
    this.valley.axes({...this.valley.x, low: x[0], high: x[x.length - 1]}, {low: y[0], high: y[y.length - 1]});
    this.valley.cells(x, y, c.error, [1, 1.01, 1.05, 1.25]);
    this.valley.mark('fit', 'critical', () => { const [a, b] = [this.valley.X(used.at[0]), this.valley.Y(used.at[1])]; return `M${a - 6} ${b}h12M${a} ${b - 6}v12`; });
    this.spectrum.curve('rest', 'predicted', hz, c.spectrum_rest[0]);
  }
}
