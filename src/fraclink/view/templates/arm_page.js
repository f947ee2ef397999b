// --- the page: settings, faults, time ----------------------------------------------------------------------

const still = matchMedia('(prefers-reduced-motion: reduce)');
const clock = {k: 0, t: 0, playing: !still.matches, slow: 1, before: 0, flight: null, seen: true};

// id: [lowest value, highest value, step, text of a value]
const SLIDERS = {
  payload: [0, DATA.payloads.length - 1, 1, (i) => gramsOf(i)],
  move: [-120, 120, 1, (v) => `${fixed(v, 0)}°`],
  time: [0, DATA.times.length - 1, 1, (i) => `${fixed(DATA.times[i], DATA.times[0] < 0.2 ? 4 : 2)} s`],
  noise: [0, DATA.largest.noise, DATA.largest.noise / 50, (v) => `${fixed(1e3 * v, 1)} mN·m`],
  offset: [-DATA.largest.offset, DATA.largest.offset, DATA.largest.offset / 50, (v) => `${fixed(1e3 * v, 0)} mN·m`],
  delay: [0, DATA.largest.delay, 1, (v) => `${v} ${v === 1 ? 'period' : 'periods'}, ${fixed(1e3 * TS * v, 1)} ms`],
};

function showSettings() {
  for (const id in SLIDERS) {
    const input = $(id), says = SLIDERS[id][3](state[id]);
    input.value = state[id];
    input.setAttribute('aria-valuetext', says);
    $(`${id}-is`).textContent = says;
  }
  $('told').checked = state.told;
  $('single').checked = state.single;
  $(state.twin ? 'twin' : 'model').checked = true;
  for (const fault of FAULTS) $(`fault-${fault.id}`).setAttribute('aria-pressed', fault.id in state.faults);
  $('fault-late').setAttribute('aria-pressed', state.late);
  $('throw').textContent = state.thrown < 0 ? 'Throw off the payload' : 'Put the payload back';
  const m = DATA.payloads[state.payload], [low, high] = DATA.designed;
  $('zone').textContent = m < low || m > high
    ? `${gramsOf(state.payload)} is outside the design range: nothing is promised here.`
    : 'Within the design range.';
  $('zone').className = m < low || m > high ? 'hint out' : 'hint';
}

function say() {
  const o = outcome({tip, mode}), said = $('outcome');
  let text = '';
  if (o.changed >= 0) {
    const name = DATA.modes[o.worst], after = {
      degraded: 'the law ignores the gauge and continues without it.',
      hold: 'the law holds the motor in place.',
      off: 'the law switches the drive off.',
    }[name] || '';
    text = `${name[0].toUpperCase()}${name.slice(1)} at ${(TS * o.changed).toFixed(2)} s (${o.why}): ${after} `;
  }
  const placed = state.move || o.away <= o.band;
  if (o.worst < 3 && !state.move) {
    text += placed
      ? `No move: the tip stays within ${fixed(degrees(o.away), 2)}° of its position.`
      : `No move, yet the tip moves ${fixed(degrees(o.away), 1)}° from its position.`;
  } else if (o.worst < 3) {
    if (Number.isNaN(o.settles)) text += `The tip does not come to rest within 2 % in ${fixed(DATA.half, 1)} s.`;
    else {
      text += `Settled after ${o.settles.toFixed(2)} s (within 2 %) with ${fixed(100 * o.overshoot, 1)} % overshoot`;
      text += Number.isNaN(o.returns) ? '; it does not settle after the move back.' : `; after the move back, settled after ${o.returns.toFixed(2)} s.`;
    }
  }
  if ('reversed' in state.faults && o.worst <= 1) {
    text += ' The law has no guard against a gauge wired backwards: it keeps running. The wiring test before the first move finds this.';
  }
  const rests = placed && !Number.isNaN(o.settles);
  if (rests && o.worst <= 1 && state.noise) {
    const last = Array.from(voltage.slice(Math.round(0.9 * N), N)), mean = last.reduce((a, v) => a + v, 0) / last.length;
    text += ` At rest the gauge's noise moves the motor's voltage by ${fixed(Math.hypot(...last.map((v) => v - mean)) / Math.sqrt(last.length), 2)} V rms.`;
  }
  for (const one of arm.pair) one.fate.textContent = fate(one.law);
  said.textContent = text;
  const good = rests && o.worst <= 1 && !Number.isNaN(o.returns);
  said.className = good ? 'good' : o.worst > 2 || !rests ? 'bad' : 'fair';
  $('python').textContent = inPython();
  $('speed-of-run').textContent = `${fixed(TS * DATA.periods, 1)} s of motion took ${milliseconds.toFixed(2)} ms to compute.`;
}

// The previous run, drawn as a ghost next to this one: the run before the settings began to change.
const past = {tip: null, motor: null, fresh: null};
function pass() {
  if (past.fresh) [past.tip, past.motor] = past.fresh;
  past.fresh = null;
}

let pending = 0, speaking = 0;
function renew({layout = false} = {}) {
  renew.layout = renew.layout || layout;
  if (pending) return;
  pending = requestAnimationFrame(() => {
    pending = 0;
    pass();
    run();
    if (renew.layout || !fits()) layArm(); else drawPayload();
    renew.layout = false;
    drawPlots();
    showSettings();
    draw();
    // the live region would be read out at every pixel of a drag
    clearTimeout(speaking);
    speaking = setTimeout(() => { say(); remember(); past.fresh = [tip.slice(), motor.slice()]; }, 150);
  });
}

function draw() {
  const k = clock.k;
  drawArm(k);
  drawCursor(k);
  $('now').value = k;
  $('now').setAttribute('aria-valuetext', `${(TS * k).toFixed(2)} s`);
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

function frame(now) {
  const passed = Math.min(0.1, (now - clock.before) / 1e3);
  clock.before = now;
  if (clock.playing) {
    clock.t += passed * clock.slow;
    if (clock.t > TS * (N - 1)) clock.t %= TS * (N - 1);
    clock.k = Math.floor(clock.t / TS);
    if (clock.seen) draw();
  }
  if (clock.flight) fly(now);
  requestAnimationFrame(frame);
}

// A lost payload moves on along its velocity and fades.
function fly(now) {
  const {from, speed, begin, r} = clock.flight, t = (now - begin) / 1e3;
  if (t > 0.9) { clock.flight = null; arm.flying.setAttribute('r', 0); return; }
  set(arm.flying, {cx: px(from[0] + speed[0] * t), cy: px(from[1] + speed[1] * t), r: px(r), 'fill-opacity': (1 - t / 0.9).toFixed(2)});
}

function throwOff() {
  if (state.thrown < 0) {
    const k = clock.k, [x, y] = spot(tip[k], arm.L), [bx, by] = spot(tip[Math.max(0, k - 3)], arm.L);
    const rate = 1 / (3 * TS), speed = [(x - bx) * rate, (y - by) * rate], size = Math.hypot(...speed);
    const away = size > 120 ? speed : [x * 0.9, y * 0.9];
    if (!still.matches) clock.flight = {from: [x, y], speed: away, begin: performance.now(), r: payloadRadius()};
    state.thrown = state.payload;
    state.payload = 0;
  } else {
    state.payload = state.thrown;
    state.thrown = -1;
  }
  go(0);
  renew();
}

function play(on) {
  clock.playing = on;
  $('play').textContent = on ? 'Pause' : 'Play';
  $('play').setAttribute('aria-label', on ? 'Pause the arm' : 'Play: move the arm');
}

// The settings in the address of the page, so that a run can be shared as a link.
const KEPT = ['payload', 'move', 'time', 'noise', 'offset', 'delay', 'told', 'single', 'twin', 'late'];
function remember() {
  const parts = KEPT.map((key) => `${key}=${Number(state[key])}`);
  for (const id in state.faults) parts.push(`${id}=${state.faults[id]}`);
  history.replaceState(null, '', `#${parts.join('&')}`);
}
function recall() {
  for (const part of location.hash.slice(1).split('&')) {
    const [key, text] = part.split('='), value = Number(text);
    if (!text || !Number.isFinite(value)) continue;
    if (key in SLIDERS) {
      const [low, high, step] = SLIDERS[key];
      state[key] = limited(step === 1 ? Math.round(value) : value, low, high);
    } else if (key === 'told') state.told = DATA.told && value === 1;
    else if (['single', 'late'].includes(key)) state[key] = value === 1;
    else if (key === 'twin') state.twin = TWIN !== null && value === 1;
    else if (FAULTS.some((fault) => fault.id === key)) state.faults[key] = limited(Math.round(value), 0, N - 1);
    else if (key === 'at') { play(false); go(value / TS); }
  }
}

function reset() {
  Object.assign(state, {
    payload: DATA.start.payload, move: 60, time: DATA.start.time, noise: DATA.start.noise, offset: DATA.start.offset,
    delay: DATA.start.delay, told: false, single: false, twin: false, late: false, thrown: -1, faults: {},
  });
  renew({layout: true});
}

function scrub(event) {
  if (event.type === 'pointermove' && !event.buttons) return;
  const box = $('plots').getBoundingClientRect(), x = event.clientX - box.left;
  play(false);
  go(((x - LEFT) / (plots.W - LEFT - END())) * (N - 1));
  draw();
}

function listen() {
  for (const id in SLIDERS) {
    const input = $(id), [low, high, step] = SLIDERS[id];
    Object.assign(input, {min: low, max: high, step});
    input.addEventListener('input', () => {
      state[id] = Number(input.value);
      if (id === 'payload') state.thrown = -1;
      renew({layout: id === 'move' || id === 'payload'});
    });
  }
  for (const fault of FAULTS) {
    $(`fault-${fault.id}`).addEventListener('click', () => {
      if (fault.id in state.faults) delete state.faults[fault.id];
      else state.faults[fault.id] = clock.k;
      renew();
    });
  }
  $('fault-late').addEventListener('click', () => { state.late = !state.late; renew(); });
  const place = (m) => (DATA.payloads.indexOf(m) / (DATA.payloads.length - 1)) * 100, [low, high] = DATA.designed.map(place);
  Object.assign($('designed').style, {left: `${low}%`, width: `${high - low}%`});
  $('told').disabled = !DATA.told;
  $('twin').disabled = !TWIN;
  for (const id of ['model', 'twin']) $(id).addEventListener('change', () => { state.twin = $('twin').checked; renew(); });
  $('told').addEventListener('change', () => { state.told = $('told').checked; renew(); });
  $('single').addEventListener('change', () => { state.single = $('single').checked; renew(); });
  $('throw').addEventListener('click', throwOff);
  $('arm').addEventListener('click', (event) => { if (event.target.closest('#load')) throwOff(); });
  $('arm').addEventListener('keydown', (event) => {
    if (event.target.closest('#load') && (event.key === 'Enter' || event.key === ' ')) {
      event.preventDefault();
      event.stopPropagation();
      throwOff();
    }
  });
  $('play').addEventListener('click', () => play(!clock.playing));
  $('slow').addEventListener('change', () => { clock.slow = 1 / Number($('slow').value); });
  $('reset').addEventListener('click', reset);
  $('now').max = N - 1;
  $('now').addEventListener('input', () => { play(false); go(Number($('now').value)); draw(); });
  for (const type of ['pointerdown', 'pointermove']) $('plots').addEventListener(type, (event) => { if (event.target.closest('svg')) scrub(event); });
  document.addEventListener('keydown', (event) => {
    // in a report the space bar turns the page
    if (!document.documentElement.matches('.armpage') && !event.target.closest('.armbox')) return;
    if (event.target.closest('button, input, select, summary, a, pre, [role=button]') || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === ' ') play(!clock.playing);
    else if (event.key === '.' || event.key === ',') { play(false); go(clock.k + (event.key === '.' ? 1 : -1)); draw(); } else return;
    event.preventDefault();
  });
  new IntersectionObserver((entries) => { clock.seen = entries.some((entry) => entry.isIntersecting); }).observe($('arm').closest('.armbox'));
  let width = innerWidth;
  addEventListener('resize', () => { if (innerWidth !== width) { width = innerWidth; renew({layout: true}); } });
}

play(clock.playing);
recall();
listen();
run();
layArm();
drawPlots();
showSettings();
draw();
say();
past.fresh = [tip.slice(), motor.slice()];
requestAnimationFrame((now) => { clock.before = now; frame(now); });
document.documentElement.dataset.ready = 'true';
