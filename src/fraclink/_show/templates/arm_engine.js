// --- the engine: law.c and its loop as WebAssembly, and everything that a run is made of ------------------
// Numbers that take a library of mathematics come with the page, so that a run has the bits of fraclink.simulate.

const DATA = JSON.parse(document.getElementById('arm-data').textContent);
const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
const ENGINE = new WebAssembly.Instance(new WebAssembly.Module(bytesOf(DATA.engine))).exports;
const N = DATA.periods + 1;
const TS = DATA.period;
const doubles = (place, count) => new Float64Array(ENGINE.memory.buffer, place, count);

const RIG = 22, HEAD = 21, MOVE = 6, COLUMNS = 12; // csrc/web/engine.c, csrc/kernels/twin.h
const AT = {delay: 2, offset: 10, noise: 11, payload: 16, stiffness: 21};
const FAULT = {bits: 5, encoderGain: 6, gaugeGain: 9, gaugeValue: 10};
const BIT = {gaugeReplaced: 2, encoderFrozen: 4, gaugeFrozen: 8, tickMissed: 32};

const numbers = new Float64Array(bytesOf(DATA.numbers).buffer);
const rigNumbers = numbers.subarray(0, RIG);
const moves = numbers.subarray(RIG + N, RIG + N + MOVE * DATA.times.length);
const links = (() => {
  let at = RIG + N + MOVE * DATA.times.length;
  return DATA.links.map(([reals, pairs, second]) => {
    const count = HEAD + 7 * reals + 14 * pairs;
    const link = {reals, pairs, second, numbers: numbers.subarray(at, at + count)};
    at += count;
    return link;
  });
})();
const blocks = DATA.blocks.map(bytesOf);

const view = {
  rig: doubles(ENGINE.rig(), RIG),
  link: doubles(ENGINE.link(), HEAD + 21 * 64),
  path: [0, 1, 2].map((row) => doubles(ENGINE.path(row), N)),
  faults: doubles(ENGINE.faults(), N * COLUMNS),
  signal: [0, 1, 2, 3, 4, 5, 6, 7].map((row) => doubles(ENGINE.signal(row), N)),
  mark: [0, 1, 2].map((row) => new Uint32Array(ENGINE.memory.buffer, ENGINE.mark(row), N)),
};
const [tip, motor, , torque, gauge, voltage] = view.signal;
const [, mode, reason] = view.mark;
const reference = view.path[0];
view.path[2].set(numbers.subarray(RIG, RIG + N));

// Faults: what a button breaks from a period on. `rows` writes the engine's row, `python` says the same to fraclink.
const FAULTS = [
  {id: 'nan', name: 'Gauge reads NaN', part: 'gauge', row: (r) => { r[FAULT.bits] |= BIT.gaugeReplaced; r[FAULT.gaugeValue] = NaN; },
    python: (a, b) => [`fl.SensorFault(${a}, ${b}, "gauge value", float("nan"))`]},
  {id: 'stuck', name: 'Gauge stuck', part: 'gauge', row: (r) => { r[FAULT.bits] |= BIT.gaugeFrozen; },
    python: (a, b) => [`fl.SensorFault(${a}, ${b}, "gauge frozen")`]},
  {id: 'reversed', name: 'Gauge wired backwards', part: 'gauge', row: (r) => { r[FAULT.gaugeGain] = -1; },
    python: (a, b) => [`fl.SensorFault(${a}, ${b}, "gauge gain", -1.0)`]},
  {id: 'encoder', name: 'Encoder stuck', part: 'encoder', row: (r) => { r[FAULT.bits] |= BIT.encoderFrozen; },
    python: (a, b) => [`fl.SensorFault(${a}, ${b}, "encoder frozen")`]},
  {id: 'missed', name: 'Two of three periods missed', part: 'clock',
    row: (r, k) => { if (k % 3) r[FAULT.bits] |= BIT.tickMissed; },
    python: (a, b, k) => [`*(fl.SensorFault(k * ${TS}, (k + 1) * ${TS}, "tick missed") for k in range(${k}, ${N}) if k % 3)`]},
];
const EXTRA_DELAY = 6; // periods that the button "late" adds

const state = {
  payload: DATA.start.payload, move: 60, time: DATA.start.time, noise: DATA.start.noise, offset: DATA.start.offset,
  delay: DATA.start.delay, told: DATA.told, single: false, late: false, thrown: -1,
  faults: {}, // id: period from which on
};
const amplitude = () => (state.move * Math.PI) / 180;

// smooth_step there and back: the operations of Path.derivative in their order, and so its bits.
function follow() {
  const [end, back, rest, cube, fourth, fifth] = moves.subarray(MOVE * state.time, MOVE * (state.time + 1));
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

function breakSensors() {
  const broken = FAULTS.filter((fault) => fault.id in state.faults);
  if (!broken.length) return 0;
  view.faults.fill(0);
  for (let k = 0; k < N; k++) {
    const row = view.faults.subarray(k * COLUMNS, (k + 1) * COLUMNS);
    row[FAULT.encoderGain] = row[FAULT.gaugeGain] = 1;
    for (const fault of broken) if (k >= state.faults[fault.id]) fault.row(row, k);
  }
  return 1;
}

const periodsLate = () => state.delay + (state.late ? EXTRA_DELAY : 0);
let milliseconds = 0;

function run() {
  const begin = performance.now();
  const link = links[state.payload];
  const numbersOfRig = view.rig;
  numbersOfRig.set(rigNumbers);
  numbersOfRig[AT.delay] = periodsLate();
  numbersOfRig[AT.offset] = state.offset;
  numbersOfRig[AT.noise] = state.noise;
  numbersOfRig[AT.payload] = state.told ? DATA.payloads[state.payload] : 0;
  view.link.set(link.numbers);
  new Uint8Array(ENGINE.memory.buffer).set(blocks[Number(state.single)], ENGINE.block());
  follow();
  const failed = ENGINE.run(Number(state.single), link.reals, link.pairs, link.second, breakSensors(), N);
  if (failed) throw new Error('the engine refused the run');
  milliseconds = performance.now() - begin;
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
  const events = FAULTS.filter((fault) => fault.id in state.faults)
    .flatMap((fault) => fault.python(TS * state.faults[fault.id], end + 1, state.faults[fault.id]));
  return [
    'import zlib',
    'import fraclink as fl',
    '',
    'design = fl.load("design.json")',
    `law = ${DATA.law}${state.single ? '.in_precision("single")' : ''}`,
    `there, back = fl.smooth_step(${a}, ${time}), fl.smooth_step(${-a}, ${time}, ${DATA.half - time})`,
    'run = fl.simulate(',
    '    law, there.then(back), rig=design.rig, model=design.model,',
    `    duration=${end}, seed=${DATA.seed}, noise=${state.noise}, gauge_offset=${state.offset},`,
    `    payload=${DATA.payloads[state.payload]}, told=${state.told ? 'True' : 'False'}, delay_samples=${periodsLate()},`,
    ...(events.length ? [`    events=[${events.join(', ')}],`] : []),
    ')',
    `print(zlib.crc32(run.tip_angle.tobytes()))  # ${digest()} in this page`,
  ].join('\n');
}

// What the run came to. The page judges this move only; what is promised stands in its own text.
function outcome() {
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
