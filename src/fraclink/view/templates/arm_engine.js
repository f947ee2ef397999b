// --- the engine: law.c and its loop as WebAssembly, and all inputs and outputs of a run -------------------
// Numbers that require a math library come with the page, so that a run is bitwise equal to one of fraclink.simulate.

const DATA = JSON.parse(document.getElementById('arm-data').textContent);
const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

// Compressed, the engine takes two fifths of its size in the file.
const unpacked = new Blob([bytesOf(DATA.engine)]).stream().pipeThrough(new DecompressionStream('deflate'));
const ENGINE = (await WebAssembly.instantiate(await new Response(unpacked).arrayBuffer())).instance.exports;
const N = DATA.periods + 1;
const TS = DATA.period;
const doubles = (place, count) => new Float64Array(ENGINE.memory.buffer, place, count);

const RIG = 20, HEAD = 22, MOVE = 6, COLUMNS = 12, TWIN_RIG = 15, OUTPUTS = 6; // csrc/web/engine.c, csrc/kernels/twin.h
const AT = {delay: 2, offset: 9, noise: 10, payload: 15};
const INPUT = {reference: 0, acceleration: 2, gaugeError: 3, payload: 11};
const FAULT = {bits: 5, encoderGain: 6, encoderError: 7, encoderValue: 8, gaugeGain: 9, gaugeValue: 10};
const BIT = {encoderReplaced: 1, gaugeReplaced: 2, encoderFrozen: 4, gaugeFrozen: 8, tickMissed: 32};

// The numbers of an arm: of its rig, noise and moves, a link for each payload, the blocks of its laws, and its twin.
function numbersOf(told) {
  const take = taking(told.numbers);
  return {
    rig: take(RIG), noise: take(N), moves: take(MOVE * told.times.length),
    links: told.links.map(([reals, pairs, second]) => ({reals, pairs, second, numbers: take(HEAD + 7 * reals + 14 * pairs)})),
    blocks: told.blocks.map(bytesOf), twin: told.twin && twinOf(told),
  };
}
// The twin: a hub with stiction, a link with distributed mass as modes, and Maxwell elements. Null if the rig has none.
function twinOf({twin, payloads}) {
  const take = taking(twin.numbers), {elements, modes} = twin;
  return {
    ...twin, rig: take(TWIN_RIG), noise: take(N), material: take(5), weights: take(elements), rates: take(elements),
    arms: payloads.map(() => take(1 + 3 * modes)), steps: new Map(),
  };
}
function taking(text) {
  const all = new Float64Array(bytesOf(text).buffer);
  let at = 0;
  return (count) => all.subarray(at, at += count);
}
let numbers = numbersOf(DATA);

const view = {
  link: doubles(ENGINE.link(), HEAD + 21 * 64),
  path: [0, 1, 2].map((row) => doubles(ENGINE.path(row), N)),
  faults: doubles(ENGINE.faults(), N * COLUMNS),
  signal: [0, 1, 2, 3, 4, 5, 6, 7].map((row) => doubles(ENGINE.signal(row), N)),
  mark: [0, 1, 2].map((row) => new Uint32Array(ENGINE.memory.buffer, ENGINE.mark(row), N)),
};
const [tip, motor, , torque, gauge, voltage] = view.signal;
const [, mode, reason] = view.mark;
const reference = view.path[0];
// The same arm in the same run with only the motor's own PID; not shown next to a run from Python.
const alone = {tip: new Float64Array(N), motor: new Float64Array(N), mode: new Uint32Array(N), shown: true};
view.path[2].set(numbers.noise);

// A rig in the engine: three integers, and its doubles from byte 16 on.
function fill(place, values) {
  new Int32Array(ENGINE.memory.buffer, place, 3).set(values.subarray(0, 3));
  doubles(place + 16, values.length - 3).set(values.subarray(3));
}

// The matrices of the twin, with the operations of `assemble` in the same order, so the results are bitwise equal.
function assemble(index) {
  const {elements, modes, weights, rates, arms, material} = numbers.twin, [inertia, ...rest] = arms[index];
  const [step, length, spring, dashpot, friction] = material;
  const states = 2 + modes * (2 + elements), size = states + 2, stride = (states + 7) & ~7;
  const matrix = doubles(ENGINE.matrix(), size * size), outputs = doubles(ENGINE.outputs(), OUTPUTS * stride);
  const hub = new Float64Array(states), put = (row, column, value) => { matrix[row * size + column] = value * step; };
  matrix.fill(0);
  outputs.fill(0);
  const tips = outputs.subarray(2 * stride), torques = outputs.subarray(3 * stride);
  tips[0] = 1;
  for (let mode = 0; mode < modes; mode++) {
    const [square, load, end] = rest.slice(3 * mode), place = 2 + mode * (2 + elements), speed = place + 1;
    const force = [[0, square * (spring * -load)], [1, square * (dashpot * -load)], [place, square * spring], [speed, square * dashpot]];
    for (let i = 0; i < elements; i++) {
      const own = speed + 1 + i;
      force.push([own, square * weights[i]]);
      put(own, 1, -load);
      put(own, speed, 1);
      put(own, own, -rates[i]);
    }
    put(place, speed, 1);
    for (const [column, value] of force) {
      put(speed, column, -value);
      hub[column] += load * value;
    }
    put(speed, states + 1, end * length);
    tips[0] += end * -load;
    tips[place] += end;
    torques[0] -= square * load * -load;
    torques[place] -= square * load;
  }
  hub.forEach((value, column) => put(1, column, value / inertia - (column === 1 ? friction / inertia : 0)));
  put(0, 1, 1);
  put(1, states, 1 / inertia);
  if (ENGINE.discretise(size)) throw new Error('the engine refused the twin');
  return {size, matrix: matrix.slice(), outputs: outputs.slice()};
}

function runTwin() {
  const at = state.payload, {twin} = numbers, rig = twin.rig.slice();
  if (!twin.steps.has(at)) twin.steps.set(at, assemble(at));
  const {size, matrix, outputs} = twin.steps.get(at);
  doubles(ENGINE.matrix(), matrix.length).set(matrix);
  doubles(ENGINE.outputs(), outputs.length).set(outputs);
  rig[1] = periodsLate();
  fill(ENGINE.twin(), rig);
  breakSensors(true);
  for (let k = 0, row = 0; k < N; k++, row += COLUMNS) {
    view.faults[row + INPUT.reference] = view.path[0][k];
    view.faults[row + INPUT.acceleration] = view.path[1][k];
    view.faults[row + INPUT.gaugeError] = state.offset + state.noise * twin.noise[k];
    view.faults[row + INPUT.payload] = state.told ? DATA.payloads[at] : 0;
  }
  return ENGINE.run_twin(Number(state.single), size, N);
}

// Faults: what a button breaks from a certain period on. `row` writes it for the engine, `python` for fraclink.
const FAULTS = [
  {id: 'nan', name: 'Gauge reads NaN', part: 'gauge', row: (r) => { r[FAULT.bits] |= BIT.gaugeReplaced; r[FAULT.gaugeValue] = NaN; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "gauge value", float("nan"))`]},
  {id: 'stuck', name: 'Gauge stuck', part: 'gauge', row: (r) => { r[FAULT.bits] |= BIT.gaugeFrozen; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "gauge frozen")`]},
  {id: 'reversed', name: 'Gauge wired backwards', part: 'gauge', row: (r) => { r[FAULT.gaugeGain] = -1; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "gauge gain", -1.0)`]},
  {id: 'zero', name: 'Gauge reads zero', part: 'gauge', row: (r) => { r[FAULT.bits] |= BIT.gaugeReplaced; r[FAULT.gaugeValue] = 0; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "gauge value", 0.0)`]},
  {id: 'half', name: 'Gauge reads half', part: 'gauge', row: (r) => { r[FAULT.gaugeGain] = 0.5; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "gauge gain", 0.5)`]},
  {id: 'encoder', name: 'Encoder stuck', part: 'encoder', row: (r) => { r[FAULT.bits] |= BIT.encoderFrozen; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "encoder frozen")`]},
  {id: 'blind', name: 'Encoder reads NaN', part: 'encoder', row: (r) => { r[FAULT.bits] |= BIT.encoderReplaced; r[FAULT.encoderValue] = NaN; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "encoder value", float("nan"))`]},
  {id: 'backwards', name: 'Encoder counts backwards', part: 'encoder', row: (r) => { r[FAULT.encoderGain] = -1; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "encoder gain", -1.0)`]},
  {id: 'slip', name: 'Encoder slips by 0.1 rad', part: 'encoder', row: (r) => { r[FAULT.encoderError] += 0.1; },
    python: (a, b) => [`fl.extend.SensorFault(${a}, ${b}, "encoder offset", 0.1)`]},
  {id: 'missed', name: 'Two of three periods missed', part: 'clock',
    row: (r, k) => { if (k % 3) r[FAULT.bits] |= BIT.tickMissed; },
    python: (a, b, k) => [`*(fl.extend.SensorFault(k * ${TS}, (k + 1) * ${TS}, "tick missed") for k in range(${k}, ${N}) if k % 3)`]},
];
const EXTRA_DELAY = 6; // periods that the button "late" adds

const begun = () => ({
  ...DATA.start, move: 60, told: false, single: false, twin: false, late: false, thrown: -1,
  faults: {}, // id: its first period
});
const state = begun();
const amplitude = () => (state.move * Math.PI) / 180;

// smooth_step there and back, with the operations of Path.derivative in the same order: bitwise equal results.
function follow() {
  const [end, back, rest, cube, fourth, fifth] = numbers.moves.subarray(MOVE * state.time, MOVE * (state.time + 1));
  const a = amplitude();
  const there = [a * 0, a * 0 / end, a * 0 / (end * end), a * 10 / cube, a * -15 / fourth, a * 6 / fifth];
  const b = -a;
  const home = [b * 0 + a, b * 0, b * 0, b * 10 / cube, b * -15 / fourth, b * 6 / fifth];
  const flat = [a, 0, 0, 0, 0, 0], last = [b + a, 0, 0, 0, 0, 0];
  for (let k = 0; k < N; k++) {
    const t = TS * k;
    const [from, c] = t < end ? [0, there] : t < back ? [end, flat] : t < rest ? [back, home] : [rest, last];
    const x = Math.max(t - from, 0);
    let angle = 0, acceleration = 0;
    for (let p = 5; p >= 0; p--) angle = angle * x + c[p];
    for (let p = 5; p >= 2; p--) acceleration = acceleration * x + p * (p - 1) * c[p];
    view.path[0][k] = angle;
    view.path[1][k] = acceleration;
  }
}

// If two faults set the same number, the later one applies, as in fraclink.
const broken = () => FAULTS.filter(({id}) => id in state.faults).sort((a, b) => state.faults[a.id] - state.faults[b.id]);

function breakSensors(always = false) {
  const faults = broken();
  if (!faults.length && !always) return 0;
  view.faults.fill(0);
  for (let k = 0; k < N; k++) {
    const row = view.faults.subarray(k * COLUMNS, (k + 1) * COLUMNS);
    row[FAULT.encoderGain] = row[FAULT.gaugeGain] = 1;
    for (const fault of faults) if (k >= state.faults[fault.id]) fault.row(row, k);
  }
  return 1;
}

const periodsLate = () => state.delay + (state.late ? EXTRA_DELAY : 0);

function runModel() {
  const link = numbers.links[state.payload], rig = numbers.rig.slice();
  rig[AT.delay] = periodsLate();
  rig[AT.offset] = state.offset;
  rig[AT.noise] = state.noise;
  rig[AT.payload] = state.told ? DATA.payloads[state.payload] : 0;
  fill(ENGINE.rig(), rig);
  view.link.set(link.numbers);
  return ENGINE.run(Number(state.single), link.reals, link.pairs, link.second, breakSensors(), N);
}

function runLaw(block) {
  new Uint8Array(ENGINE.memory.buffer).set(block, ENGINE.block());
  if (state.twin ? runTwin() : runModel()) throw new Error('the engine refused the run');
}

// `both`: also the run of the motor PID alone, which does not change with the law.
function run(both = true) {
  follow();
  if (both) {
    runLaw(numbers.blocks[2 + Number(state.single)]);
    alone.tip.set(tip);
    alone.motor.set(motor);
    alone.mode.set(mode);
    alone.shown = true;
  }
  runLaw(numbers.blocks[Number(state.single)]);
}

// CRC-32 of the tip's bytes, as zlib.crc32(run.tip_angle.tobytes()) gives it.
const CRC = Uint32Array.from({length: 256}, (_, n) => {
  for (let bit = 0; bit < 8; bit++) n = n & 1 ? 0xEDB88320 ^ (n >>> 1) : n >>> 1;
  return n;
});
function digest() {
  let crc = ~0;
  for (const byte of new Uint8Array(tip.buffer, tip.byteOffset, tip.byteLength)) crc = CRC[(crc ^ byte) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

// The same run in Python.
function inPython() {
  const a = amplitude(), time = DATA.times[state.time], end = TS * DATA.periods;
  const events = broken().flatMap(({id, python}) => python(TS * state.faults[id], end + 1, state.faults[id]));
  return [
    'import zlib',
    'import fraclink as fl',
    '',
    'design = fl.load("design.json")',
    `law = ${DATA.law}${state.single ? '.in_precision("single")' : ''}`,
    `there, back = fl.smooth_step(${a}, ${time}), fl.smooth_step(${-a}, ${time}, ${DATA.half - time})`,
    ...(state.twin ? [
      `arm = fl.Twin.from_rig(design.rig, model=design.model, link_mass=${numbers.twin.mass}, modes=${numbers.twin.modes})`,
      'run = fl.simulate(', '    law, there.then(back), arm=arm,',
    ] : ['run = fl.simulate(', '    law, there.then(back), rig=design.rig, model=design.model,']),
    `    duration=${end}, seed=${DATA.seed}, noise=${state.noise}, gauge_offset=${state.offset},`,
    `    payload=${DATA.payloads[state.payload]}, told=${state.told ? 'True' : 'False'}, delay_samples=${periodsLate()},`,
    ...(events.length ? [`    events=[${events.join(', ')}],`] : []),
    ')',
    `print(zlib.crc32(run.tip_angle.tobytes()))  # ${digest()} in this page`,
  ].join('\n');
}

// The results of the run. The page judges only this move; its text states what is guaranteed.
function outcome({tip, mode}) {
  const a = amplitude(), half = Math.floor(N / 2), band = 0.02 * (Math.abs(a) || 1); // without a move: of 1 rad
  let changed = -1, settled = 0, back = half, peak = 0, away = 0;
  for (let k = 0; k < N; k++) {
    if (changed < 0 && mode[k] > 1) changed = k;
    away = Math.max(away, Math.abs(tip[k]));
    if (k < half) {
      if (!(Math.abs(tip[k] - a) <= band)) settled = k + 1;
      peak = Math.max(peak, (tip[k] - a) * Math.sign(a));
    } else if (!(Math.abs(tip[k]) <= band)) back = k + 1;
  }
  return {
    changed, band, away, worst: mode.reduce((x, y) => Math.max(x, y), 0),
    why: changed < 0 ? '' : DATA.reasons[reason[changed]],
    settles: settled < half ? TS * settled : NaN,
    returns: back < N ? TS * back - DATA.half : NaN,
    overshoot: a ? peak / Math.abs(a) : 0,
  };
}
