// --- the page: settings, faults, time ----------------------------------------------------------------------

const still = matchMedia('(prefers-reduced-motion: reduce)');
const box = $('arm').closest('.armbox');
const clock = {k: 0, t: 0, playing: !still.matches, slow: 1, before: 0, seen: true};

// id: [lowest value, highest value, step, text of a value]
const SLIDERS = {
  payload: [0, DATA.payloads.length - 1, 1, (i) => gramsOf(i)],
  move: [-120, 120, 1, (v) => `${fixed(v, 0)}°`],
  time: [0, DATA.times.length - 1, 1, (i) => `${fixed(DATA.times[i], DATA.times[0] < 0.2 ? 4 : 2)} s`],
  noise: [0, DATA.largest.noise, DATA.largest.noise / 50, (v) => `${fixed(1e3 * v, 1)} mN·m`],
  offset: [-DATA.largest.offset, DATA.largest.offset, DATA.largest.offset / 50, (v) => `${fixed(1e3 * v, 0)} mN·m`],
  delay: [0, DATA.largest.delay, 1, (v) => `${v} ${v === 1 ? 'period' : 'periods'}, ${fixed(1e3 * TS * v, 1)} ms`],
};
// Switches that this arm can have.
const SWITCHES = {told: DATA.told, single: true, twin: Boolean(numbers.twin)};

function showSettings() {
  for (const id in SLIDERS) {
    const input = $(id), says = SLIDERS[id][3](state[id]);
    input.value = state[id];
    put(input, {'aria-valuetext': says});
    $(`${id}-is`).textContent = says;
  }
  $('model').checked = true;
  for (const id in SWITCHES) Object.assign($(id), {checked: state[id], disabled: !SWITCHES[id]});
  for (const {id} of FAULTS) put($(`fault-${id}`), {'aria-pressed': id in state.faults});
  put($('fault-late'), {'aria-pressed': state.late});
  $('throw').textContent = state.thrown < 0 ? 'Throw off the payload' : 'Put the payload back';
  const m = DATA.payloads[state.payload], [low, high] = DATA.designed, out = m < low || m > high;
  $('zone').textContent = out ? `${gramsOf(state.payload)} is outside the design range: nothing is promised here.` : 'Within the design range.';
  $('zone').classList.toggle('out', out);
}

// The ends of the slider, and below it the design range.
function showPayloads() {
  const {designed, payloads} = DATA, share = (m) => (100 * payloads.indexOf(m)) / (payloads.length - 1), [low, high] = designed.map(share);
  $('payload').max = payloads.length - 1;
  Object.assign($('designed').style, {left: `${low}%`, width: `${high - low}%`});
}

// What the law does in a mode that is not its usual one.
const REACTIONS = {
  degraded: 'the law ignores the gauge and continues without it.',
  hold: 'the law holds the motor in place.',
  off: 'the law switches the drive off.',
};
// How the move went, in a sentence.
function moved(o) {
  if (!state.move && o.away <= o.band) return `No move: the tip stays within ${fixed(degrees(o.away), 2)}° of its position.`;
  if (!state.move) return `No move, yet the tip moves ${fixed(degrees(o.away), 1)}° from its position.`;
  if (Number.isNaN(o.settles)) return `The tip does not come to rest within 2 % in ${fixed(DATA.half, 1)} s.`;
  const back = Number.isNaN(o.returns) ? 'it does not settle after the move back' : `after the move back, settled after ${o.returns.toFixed(2)} s`;
  return `Settled after ${o.settles.toFixed(2)} s (within 2 %) with ${fixed(100 * o.overshoot, 1)} % overshoot; ${back}.`;
}
function say() {
  const o = outcome({tip, mode}), name = DATA.modes[o.worst], texts = [], said = $('outcome');
  const rests = (state.move || o.away <= o.band) && !Number.isNaN(o.settles), undisturbed = o.worst <= 1;
  if (o.changed >= 0) texts.push(`${name[0].toUpperCase()}${name.slice(1)} at ${(TS * o.changed).toFixed(2)} s (${o.why}): ${REACTIONS[name] || ''}`);
  if (o.worst < 3) texts.push(moved(o));
  if ('reversed' in state.faults && undisturbed) texts.push('The law has no guard against a gauge wired backwards: it keeps running. The wiring test before the first move finds this.');
  if (rests && undisturbed && state.noise) {
    const last = Array.from(voltage.slice(Math.round(0.9 * N), N)), mean = last.reduce((a, v) => a + v, 0) / last.length;
    texts.push(`At rest the gauge's noise moves the motor's voltage by ${fixed(Math.hypot(...last.map((v) => v - mean)) / Math.sqrt(last.length), 2)} V rms.`);
  }
  for (const one of arm.pair) one.fate.textContent = fate(one.law);
  said.textContent = texts.join(' ');
  said.className = rests && undisturbed && !Number.isNaN(o.returns) ? 'good' : o.worst > 2 || !rests ? 'bad' : 'fair';
  $('python').textContent = inPython();
}

// The previous run, drawn as a ghost next to this one: the run before the settings began to change.
const past = {tip: null, motor: null, fresh: null};
function pass() {
  if (past.fresh) [past.tip, past.motor] = past.fresh;
  past.fresh = null;
}

let pending = 0, speaking = 0;
function renew({layout = false} = {}) {
  renew.layout ||= layout;
  pending ||= requestAnimationFrame(() => {
    pending = 0;
    pass();
    run();
    show(renew.layout);
    renew.layout = false;
    // the live region would be read out at every pixel of a drag
    clearTimeout(speaking);
    speaking = setTimeout(() => { say(); remember(); past.fresh = [tip.slice(), motor.slice()]; }, 150);
  });
}
// Draw the run and its settings.
function show(layout) {
  if (layout || !fits()) layArm(); else drawPayload();
  drawPlots();
  showSettings();
  draw();
}

function draw() {
  const k = clock.k;
  drawArm(k);
  drawCursor(k);
  put($('now'), {'aria-valuetext': `${(TS * k).toFixed(2)} s`}).value = k;
  const shown = {
    't-now': `${(TS * k).toFixed(2)} s`, 'tip-now': `${fixed(degrees(tip[k]), 1)}°`,
    'bend-now': `${fixed(degrees(tip[k] - motor[k]), 1)}°`, 'gauge-now': `${fixed(gauge[k], 2)} N·m`,
    'volt-now': `${fixed(voltage[k], 1)} V`, 'mode-now': DATA.modes[mode[k]],
  };
  for (const id in shown) if ($(id).textContent !== shown[id]) $(id).textContent = shown[id];
  $('mode-now').className = `chip ${DATA.modes[mode[k]]}`;
}

function go(k) {
  clock.k = limited(Math.round(k), 0, N - 1);
  clock.t = clock.k * TS;
}
// Stop at a period.
function seek(k) {
  play(false);
  go(k);
  draw();
}

function frame(now) {
  const passed = Math.min(0.1, (now - clock.before) / 1e3);
  clock.before = now;
  if (clock.playing) {
    clock.t += passed * clock.slow;
    if (clock.t > TS * (N - 1)) clock.t %= TS * (N - 1);
    clock.k = Math.floor(clock.t / TS);
    if (clock.seen) draw();
  }
  requestAnimationFrame(frame);
}

function throwOff() {
  if (state.thrown < 0) {
    if (!still.matches) fly(clock.k);
    state.thrown = state.payload;
    state.payload = 0;
  } else {
    state.payload = state.thrown;
    state.thrown = -1;
  }
  go(0);
  renew();
}
// A lost payload moves on along its velocity and fades; from rest, outwards.
function fly(k) {
  const [x, y] = spot(tip[k], arm.L), [bx, by] = spot(tip[Math.max(0, k - 3)], arm.L), speed = [(x - bx) / (3 * TS), (y - by) / (3 * TS)];
  const [u, v] = Math.hypot(...speed) > 120 ? speed : [x, y], place = (t) => `translate(${x + t * u}px, ${y + t * v}px)`;
  put(arm.flying, {r: payloadRadius()});
  arm.flying.animate([{transform: place(0), opacity: 1}, {transform: place(0.9), opacity: 0}], 900);
}

function play(on) {
  clock.playing = on;
  put($('play'), {'aria-label': on ? 'Pause the arm' : 'Play: move the arm'}).textContent = on ? 'Pause' : 'Play';
}

// The settings in the address of the page, so that a run can be shared as a link.
function remember() {
  const kept = [...Object.keys(SLIDERS), ...Object.keys(SWITCHES), 'late'].map((key) => [key, Number(state[key])]);
  history.replaceState(null, '', `#${new URLSearchParams([...kept, ...Object.entries(state.faults)])}`);
}
function recall() {
  for (const [key, text] of new URLSearchParams(location.hash.slice(1))) {
    const value = Number(text);
    if (!text || !Number.isFinite(value)) continue;
    if (key in SLIDERS) {
      const [low, high, step] = SLIDERS[key];
      state[key] = limited(step === 1 ? Math.round(value) : value, low, high);
    } else if (key in SWITCHES) state[key] = SWITCHES[key] && value === 1;
    else if (key === 'late') state.late = value === 1;
    else if (FAULTS.some(({id}) => id === key)) state.faults[key] = limited(Math.round(value), 0, N - 1);
    else if (key === 'at') { play(false); go(value / TS); }
  }
}

// What each button does, by its id; the payload is one, too.
const PRESSED = {
  play: () => play(!clock.playing), throw: throwOff, load: throwOff,
  reset: () => { Object.assign(state, begun()); renew({layout: true}); },
  'fault-late': () => { state.late = !state.late; renew(); },
};
for (const {id, name} of FAULTS) {
  const button = document.createElement('button');
  put(button, {type: 'button', id: `fault-${id}`}).textContent = name;
  $('fault-late').before(button);
  PRESSED[button.id] = () => {
    if (id in state.faults) delete state.faults[id]; else state.faults[id] = clock.k;
    renew();
  };
}

function changed({target: {id, value}}) {
  if (id === 'now') { seek(Number(value)); return; }
  if (id === 'slow') { clock.slow = 1 / Number(value); return; }
  if (id in SLIDERS) state[id] = Number(value);
  else for (const name in SWITCHES) state[name] = $(name).checked;
  if (id === 'payload') state.thrown = -1;
  renew({layout: id === 'move' || id === 'payload'});
}

function scrub(event) {
  if (!event.target.closest('svg') || (event.type === 'pointermove' && !event.buttons)) return;
  seek(plotTip.ofX(event.clientX - $('plot-tip').getBoundingClientRect().left) / TS);
}

function typed(event) {
  const {key, target} = event;
  // in a report the space bar turns the page
  if (!document.documentElement.matches('.armpage') && !target.closest('.armbox')) return;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (target.closest('#load') && (key === 'Enter' || key === ' ')) throwOff();
  else if (target.closest('button, input, select, summary, a, pre, [role=button]')) return;
  else if (key === ' ') play(!clock.playing);
  else if (key === '.' || key === ',') seek(clock.k + (key === '.' ? 1 : -1));
  else return;
  event.preventDefault();
}

function listen() {
  for (const id in SLIDERS) {
    const [min, max, step] = SLIDERS[id];
    Object.assign($(id), {min, max, step});
  }
  $('now').max = N - 1;
  box.addEventListener('input', changed);
  box.addEventListener('click', ({target}) => PRESSED[target.closest('button, #load')?.id]?.());
  for (const type of ['pointerdown', 'pointermove']) $('plots').addEventListener(type, scrub);
  document.addEventListener('keydown', typed);
  new IntersectionObserver((entries) => { clock.seen = entries.some((entry) => entry.isIntersecting); }).observe(box);
  new ResizeObserver(drawRibbon).observe($('ribbon')); // as wide as the plot above it
  let width = innerWidth;
  addEventListener('resize', () => { if (innerWidth !== width) { width = innerWidth; renew({layout: true}); } });
}

play(clock.playing);
recall();
listen();
run();
showPayloads();
show(true);
say();
past.fresh = [tip.slice(), motor.slice()];
requestAnimationFrame((now) => { clock.before = now; frame(now); });
document.documentElement.dataset.ready = 'true';
