// --- drawing: the arm from above and curves over time, in screen pixels at any width -----------------------

const $ = (id) => document.getElementById(id);
const fixed = (value, places) => {
  if (!Number.isFinite(value)) return 'NaN';
  const text = value.toFixed(places);
  return (Number(text) === 0 ? text.replace('-', '') : text).replace('-', '−');
};

const arm = {svg: $('arm'), pair: []};
const laws = () => [...(alone.shown ? [alone] : []), {tip, motor, mode}];

// With the drive off the arm can swing anywhere, so the whole circle is drawn.
const wild = () => laws().some((law) => law.tip.some((angle) => Math.abs(angle - amplitude() / 2) > 1.45));
const fits = () => arm.pair.length === laws().length && wild() === arm.round;

// Two arms side by side, or about one hub if there is no room.
function layArm() {
  const W = Math.max(280, arm.svg.clientWidth), narrow = W < 560;
  const middle = amplitude() / 2, reach = Math.min(Math.abs(middle) + 0.5, 1.45);
  const round = wild(), all = laws(), beside = !narrow && all.length > 1, margin = narrow ? 44 : 50, foot = beside ? 70 : narrow ? 48 : 58;
  const room = W / (beside ? 4 : 2) - margin, high = 0.38 * innerHeight - margin;
  const L = Math.max(60, round ? Math.min(room, high / 2 - 12) : Math.min(room / Math.max(Math.sin(reach), 0.62), high - foot));
  const H = Math.round(round ? 2 * (L + margin) : L + margin + foot), cy = round ? H / 2 : H - foot;
  Object.assign(arm, {W, H, L, middle, round, beside, thick: narrow ? 8 : 11});
  put(arm.svg, {viewBox: `0 0 ${W} ${H}`, height: H});
  arm.svg.replaceChildren();
  arm.pair = all.map((law, i) => layOne(law, i, beside ? (W * (1 + 2 * i)) / 4 : W / 2, cy, beside || !i));
  drawScale();
  drawPayload();
}

// One arm about its hub; `floor`: whether it has its own protractor.
function layOne(law, place, cx, cy, floor) {
  const rival = law === alone, g = el('g', {class: rival ? 'alone' : 'ours', transform: `translate(${cx} ${cy})`}, arm.svg), one = {law, g, rival};
  if (floor) drawFloor(g);
  one.trail = el('path', {class: 'trail'}, g);
  if (floor) {
    one.ghost = el('g', {class: 'ghost'}, g);
    el('line', {x1: 0, y1: 0, x2: 0, y2: -arm.L}, one.ghost);
    el('circle', {cx: 0, cy: -arm.L, r: payloadRadius() + 3}, one.ghost);
  }
  if (!rival) one.past = el('path', {class: 'past'}, g);
  one.shadow = el('path', {class: 'shadow', 'stroke-width': arm.thick + 4}, g);
  one.link = el('path', {class: 'link', 'stroke-width': 0.8 * arm.thick}, g);
  one.shine = el('path', {class: 'shine', 'stroke-width': 1.5}, g);
  one.gauge = el('path', {class: 'gauge', 'stroke-width': arm.thick + 4}, g);
  drawHub(one);
  one.load = rival ? el('g', {}, g) : arm.load ||= el('g', {id: 'load', role: 'button', tabindex: 0});
  g.append(one.load);
  if (!rival) arm.flying = el('circle', {class: 'load', opacity: 0}, g);
  // below its own hub, or to one side of a common hub
  const own = cx !== arm.W / 2, y = own ? arm.H - 20 : cy - 10;
  const who = own ? {x: cx, 'text-anchor': 'middle'} : place ? {x: arm.W - 4, 'text-anchor': 'end'} : {x: 4};
  el('text', {class: `who ${rival ? 'alone' : 'ours'}`, y, ...who}, arm.svg, rival ? 'Motor PID alone' : 'fraclink');
  one.fate = el('text', {class: 'fate', y: y + 16, ...who}, arm.svg, fate(law));
  return one;
}

// The outcome of the moves there and back, in a few words.
function fate(law) {
  const o = outcome(law), rests = Math.max(o.settles, o.returns);
  return o.worst > 2 ? DATA.modes[o.worst] : !state.move ? '' : Number.isNaN(rests) ? `swings on for ${fixed(DATA.half, 1)} s` : `at rest in ${rests.toFixed(2)} s`;
}

const spot = (angle, radius) => {
  const turn = angle - arm.middle;
  return [-radius * Math.sin(turn), -radius * Math.cos(turn)];
};
const payloadRadius = () => (arm.W < 560 ? 5 : 7) + 2.1 * Math.cbrt(1e3 * DATA.payloads[state.payload]);

// A protractor for the angle of the tip, with the start and end of the move.
function drawFloor(hub) {
  const g = el('g', {class: 'floor'}, hub), R = arm.L + (arm.W < 560 ? 16 : 22);
  const seen = arm.round ? 3.1 : Math.min(Math.PI / 2, Math.abs(arm.middle) + 0.5);
  const [x1, y1] = spot(arm.middle + seen, R), [x2, y2] = spot(arm.middle - seen, R);
  el('path', {class: 'arc', d: `M${tenth(x1)} ${tenth(y1)}A${tenth(R)} ${tenth(R)} 0 ${seen > 1.6 ? 1 : 0} 1 ${tenth(x2)} ${tenth(y2)}`}, g);
  const first = Math.ceil(degrees(arm.middle - seen) / 5), last = Math.floor(degrees(arm.middle + seen) / 5);
  for (let i = first; i <= last; i++) {
    const angle = (5 * i * Math.PI) / 180, long = i % 6 === 0, size = long ? 9 : i % 2 === 0 ? 6 : 3;
    const [ax, ay] = spot(angle, R), [bx, by] = spot(angle, R + size), [tx, ty] = spot(angle, R + 20 + 8 * Math.abs(Math.sin(angle - arm.middle)));
    el('line', {class: 'tick', x1: tenth(ax), y1: tenth(ay), x2: tenth(bx), y2: tenth(by)}, g);
    if (long) el('text', {x: tenth(tx), y: tenth(ty + 4), 'text-anchor': 'middle'}, g, `${5 * i}°`.replace('-', '−'));
  }
  for (const angle of [0, amplitude()]) {
    const [ax, ay] = spot(angle, R - 9), [bx, by] = spot(angle, R + 1);
    el('line', {class: 'goal', x1: tenth(ax), y1: tenth(ay), x2: tenth(bx), y2: tenth(by)}, g);
  }
}

// A scale bar, and a note on what is not to scale.
function drawScale() {
  const g = el('g', {class: 'floor'}, arm.svg);
  const unit = [0.02, 0.05, 0.1, 0.2, 0.5, 1].find((m) => (m / DATA.length) * arm.L > 30) || 2;
  const wide = (unit / DATA.length) * arm.L, y = arm.H - 14;
  el('path', {class: 'scale', d: `M14 ${y - 4}V${y}H${tenth(14 + wide)}V${y - 4}`}, g);
  el('text', {x: tenth(14 + wide / 2), y: y - 6, 'text-anchor': 'middle'}, g, `${unit} m`);
  // between two hubs, or on the right of the only one
  const place = arm.beside ? {x: arm.W / 2, 'text-anchor': 'middle'} : {x: arm.W - 6, 'text-anchor': 'end'};
  el('text', {y, ...place}, g, arm.W < 900 ? 'bow drawn ×2' : 'bow drawn twice as deep');
}

function drawHub(one) {
  const r = arm.W < 560 ? 15 : 19, hub = el('g', {class: 'hub'}, one.g);
  el('path', {class: 'plate', d: `M${-2.1 * r} ${1.05 * r}Q${-2.1 * r} ${-1.05 * r} 0 ${-1.45 * r}Q${2.1 * r} ${-1.05 * r} ${2.1 * r} ${1.05 * r}Q0 ${2.1 * r} ${-2.1 * r} ${1.05 * r}Z`}, hub);
  for (const [x, y] of [[-1.45, 0.75], [1.45, 0.75]]) el('circle', {class: 'bolt', cx: x * r, cy: y * r, r: 2.4}, hub);
  one.housing = el('circle', {class: 'housing', r}, hub);
  one.rotor = el('g', {}, hub);
  el('circle', {class: 'rotor', r: 0.62 * r}, one.rotor);
  el('path', {class: 'clamp', d: `M${-0.42 * r} ${0.1 * r}V${-1.35 * r}H${0.42 * r}V${0.1 * r}Z`}, one.rotor);
  el('circle', {class: 'axis', r: 2.6}, hub);
}

function drawPayload() {
  const thrown = state.thrown >= 0, r = payloadRadius();
  arm.load.setAttribute('aria-label', `${gramsOf(state.payload)}: ${thrown ? 'put the payload back' : 'throw off the payload'}`);
  for (const {load, rival} of arm.pair) {
    load.replaceChildren();
    if (!rival) el('circle', {class: 'grip', r: Math.max(20, r + 7)}, load);
    el('circle', {class: 'load', r}, load);
    el('circle', {class: 'spark', cx: -r / 3, cy: -r / 3, r: r / 4.5}, load);
    if (!rival) arm.weight = el('text', {class: 'weight', 'text-anchor': 'middle'}, load, gramsOf(state.payload));
  }
}
const gramsOf = (index) => `${Number((1e3 * DATA.payloads[index]).toPrecision(4))} g`;

// The centre line of the link. Clamped at the hub and loaded at the tip, it bends as 3x²/2 − x³/2. Drawn as x³, its bow
// is twice as deep, while its direction at the hub and the position of the tip are unchanged.
const bent = (from, to, base, bend) => Array.from({length: 25}, (_, i) => {
  const x = from + ((to - from) * i) / 24;
  return spot(base + bend * x * x, arm.L * x);
});

function drawArm(k) { for (const one of arm.pair) drawOne(one, k); }

function drawOne({law: {tip, motor, mode}, ...one}, k) {
  const base = motor[k], bend = tip[k] - motor[k], points = bent(0, 1, base, bend);
  one.link.setAttribute('d', line(points));
  one.shine.setAttribute('d', line(bent(0.08, 0.97, base, bend)));
  one.shadow.setAttribute('d', line(points));
  one.past?.setAttribute('d', past.tip ? line(bent(0, 1, past.motor[k], past.tip[k] - past.motor[k])) : '');
  one.gauge.setAttribute('d', line(bent(0.1, 0.17, base, bend)));
  const turn = (angle) => fixed(-degrees(angle - arm.middle), 2).replace('−', '-');
  one.ghost?.setAttribute('transform', `rotate(${turn(reference[k])})`);
  one.rotor.setAttribute('transform', `rotate(${turn(base)})`);
  const [x, y] = points[24], aside = (payloadRadius() + 20) / arm.L;
  one.load.setAttribute('transform', `translate(${tenth(x)} ${tenth(y)})`);
  if (!one.rival) put(arm.weight, {x: tenth(-y * aside), y: tenth(x * aside + 4)});
  const begin = Math.max(0, k - Math.round(0.5 / TS)); // the last half second
  one.trail.setAttribute('d', pathOf(k - begin, (i) => spot(tip[begin + i], arm.L)[0], (i) => spot(tip[begin + i], arm.L)[1]));
  const breaks = (part) => broken().some((fault) => fault.part === part && k >= state.faults[fault.id]);
  one.gauge.classList.toggle('broken', breaks('gauge'));
  one.housing.classList.toggle('broken', breaks('encoder'));
  one.g.dataset.mode = DATA.modes[mode[k]];
}

// --- curves ------------------------------------------------------------------------------------------------

const times = Float64Array.from({length: N}, (_, k) => TS * k);
const [plotTip, plotGauge, plotVoltage] = [['tip', 190], ['gauge', 116], ['voltage', 116]].map(([name, height]) => (
  new Axes($(`plot-${name}`), {low: 0, high: times[N - 1], unit: ' s'}, {low: -1, high: 1, unit: ''}, height)
));

// The ranges of a plot follow the settings; a curve without values is left out.
function drawPlot(plot, [low, high], curves) {
  plot.flagged = broken().map(({id, name}) => ({at: times[state.faults[id]], severity: 'error', message: name, code: plot === plotTip ? name : ''}));
  for (const kind in curves) if (curves[kind]) plot.curve(kind, kind, times, curves[kind]); else plot.remove(kind);
  plot.axes({}, {low, high});
  plot.lay();
}

function drawPlots() {
  const a = degrees(amplitude()), room = Math.max(8, 0.45 * Math.abs(a)), inDegrees = (values) => values && Array.from(values, degrees);
  // the same in both directions: as far as the values reach, within the given limits
  const both = (values, least, most) => {
    const reach = Math.min(roundUp(1.05 * values.reduce((x, y) => Math.max(x, Math.abs(y)), least)), most);
    return [-reach, reach];
  };
  drawPlot(plotTip, [Math.min(0, a) - room, Math.max(0, a) + room], {
    past: inDegrees(past.tip), wanted: inDegrees(reference), alone: inDegrees(alone.shown && alone.tip), hub: inDegrees(motor), tip: inDegrees(tip),
  });
  plotTip.box('band', 'band', [0, times[N >> 1]], [0.98 * a, 1.02 * a].sort((x, y) => x - y));
  drawPlot(plotGauge, both(torque, 0.3 * DATA.torque, 4 * DATA.torque), {measured: gauge, true: torque});
  drawPlot(plotVoltage, both(voltage, 1, roundUp(DATA.voltage || 10)), {volts: voltage});
  drawRibbon();
}

function drawRibbon() {
  const height = 24, {W, X} = plotTip, svg = put($('ribbon'), {viewBox: `0 0 ${W} ${height}`, height});
  svg.replaceChildren();
  for (let from = 0, k = 1; W && k <= N; k++) {
    if (k < N && mode[k] === mode[from]) continue;
    const x = X(times[from]), wide = X(times[Math.min(k, N - 1)]) - x, name = DATA.modes[mode[from]];
    el('rect', {class: `mode ${name}`, x: tenth(x), y: 2, width: tenth(Math.max(1, wide)), height: height - 4}, svg);
    if (name === 'degraded') el('rect', {class: 'hatched', x: tenth(x), y: 2, width: tenth(wide), height: height - 4}, svg);
    if (wide > 10 * name.length) el('text', {class: `on ${name}`, x: tenth(x + wide / 2), y: 16.5, 'text-anchor': 'middle'}, svg, name);
    from = k;
  }
}

function drawCursor(k) {
  for (const plot of [plotTip, plotGauge, plotVoltage]) plot.box('now', 'cursor', [times[k], times[k]], null);
}
