// The page: steps, the state and its history, verdicts. It shows Python's answers and decides nothing itself.
import {Link} from './link.js';
import {Arm} from './arm.js';
import {Design} from './design.js';
import {Logs} from './logs.js';
import {Proof} from './proof.js';
import {palette} from './palette.js';
import {$, emptied, make, on, say} from './dom.js';
import {put} from './svg.js';

const STEPS = ['log', 'channels', 'model', 'design', 'move', 'proof', 'board'];

export const app = {
  /** the request, with the option names of the command line */
  state: {}, states: [], at: -1, axes: {}, study: {}, step: '', began: null, timer: 0, placing: 0, exactly: '', refused: false, told() {},
  link: null,

  // ---- one gesture: begin, change …, end or cancel ----
  begin() {
    if (app.began) return;
    app.began = structuredClone(app.state);
    performance.clearMeasures('drag');
    design.ghost(true);
  },
  change(time) {
    const at = time ?? performance.now();
    const state = {...app.state};
    app.link.drag({state, fan: $('fan').checked, get held() { return Boolean(app.began); }}, (answer) => {
      app.shown(answer);
      // under load the last preview may arrive after the exact answer to the same state, and must not replace it
      if (app.exactly === JSON.stringify(state)) app.told();
      requestAnimationFrame(() => {
        performance.measure('drag', {start: at, end: performance.now()});
      });
    }, () => design.late());
    // after the request, which Python answers in the meantime; once a frame while the pointer moves
    if (time === undefined) app.place();
    else app.placing ||= requestAnimationFrame(app.place);
  },
  place() { app.placing = 0; design.fields(); design.place(); },
  end() {
    app.place();
    design.ghost(false);
    const before = app.began;
    app.began = null;
    if (!before) return;
    if (JSON.stringify(before) === JSON.stringify(app.state)) { app.change(); return; } // tells that the handle is released
    clearTimeout(app.timer);
    app.timer = setTimeout(app.settle, 150);
  },
  cancel() {
    design.ghost(false);
    if (app.began) app.state = app.began;
    app.began = null;
    app.change();
  },
  /** A gesture in one step, from a field, a key or a button. */
  once(act) {
    app.begin();
    act();
    app.change();
    app.end();
  },
  /** After the end of a gesture: add the state to the history and request the exact answer. */
  settle() {
    app.states = [...app.states.slice(0, app.at + 1), structuredClone(app.state)];
    app.at = app.states.length - 1;
    app.ask('note', {state: app.state}).then((answer) => design.doubted(answer.doubts));
    app.buttons();
    app.exact();
  },
  async exact() {
    const asked = JSON.stringify(app.state), answer = await app.ask('exact', {state: app.state, arm: arm.key});
    if (answer.superseded || answer.lost) return;
    app.exactly = asked;
    app.told = () => answer.ok ? design.exact(answer) : design.refuse(answer);
    if (answer.ok) app.took(answer);
    app.told();
    if (!answer.ok) return;
    arm.take(answer);
    app.outdated(false);
    app.say(answer.spoken);
  },
  /** Mark the plots as belonging to another link or rig than the study. */
  outdated(is) {
    $('step-design').classList.remove('drawn');
    for (const id of ['step-design', 'step-move', 'step-proof']) {
      $(id).classList.toggle('outdated', is);
      $(id).setAttribute('aria-busy', String(is));
    }
  },
  shown(answer) {
    if (answer.lost || (answer.of && answer.of !== app.study.of)) return;
    design.preview(answer);
    if (answer.ok) $('step-design').classList.add('drawn'); // the loops are of this model, though perhaps nothing else yet
    if (answer.ok && answer.blocks) arm.law(answer.blocks);
  },

  // ---- history ----
  async go(at) {
    if (at < 0 || at >= app.states.length) return;
    clearTimeout(app.timer);
    app.at = at;
    app.state = structuredClone(app.states[at]);
    app.buttons();
    app.ask('go', {at});
    app.change();
    app.exact();
  },
  /** Start a history with this state alone. */
  begun() { app.states = [structuredClone(app.state)]; app.at = 0; app.buttons(); },
  buttons() {
    design.around.strip();
    $('undo').disabled = app.at <= 0;
    $('redo').disabled = app.at >= app.states.length - 1;
  },

  // ---- what Python reports about the study ----
  took(answer) {
    if (app.study.of !== undefined && app.study.of !== answer.of) app.outdated(true);
    Object.assign(app.study, answer);
    say('study', answer.title);
    $('study').title = answer.title; // a narrow window cuts it off
    app.line();
    for (const step of STEPS) {
      const [sign, mark] = answer.marks[step], item = $(`go-${step}`);
      item.querySelector('.mark').textContent = sign;
      item.dataset.mark = mark;
      item.querySelector('.sr').textContent = `: ${mark}`;
    }
    const strip = emptied('verdict');
    for (const [name, what, why, state] of answer.verdict) {
      const box = make('details', `scope ${state.slice(2).replace(' ', '-')}`, '', strip), top = make('summary', '', '', box);
      make('b', '', name, top);
      make('span', 'state', ` ${state}`, top);
      make('p', 'hint', `${what}: ${why}`, box);
    }
    proof.took(answer);
    design.took(answer);
    design.doubted(answer.doubts);
  },
  /** The command line for what the user did in this step. */
  line() {
    const none = app.refused && STEPS.indexOf(app.step) >= STEPS.indexOf('design');
    const words = app.study.copies?.[app.step] || '', text = none ? '' : app.step === 'move' ? arm.command(words) : words;
    const why = none ? 'No command: no design meets this request' : 'No command: no option covers what was changed here';
    say('command', text || why);
    put($('copy-command'), {title: text ? '' : why});
    $('copy-command').disabled = !text;
  },
  /** A request that no design meets has no command; the last command belongs to another request. */
  refuse(is) { app.refused = is; app.line(); },
  ask: (verb, given) => app.link.ask(verb, given),
  /** Return the answer and apply what it reports about the study. After a refusal, show the error at `place`, or in a toast, and return false. */
  async need(verb, given, place = '') {
    const answer = await app.ask(verb, given);
    if (answer.ok) {
      if (answer.marks) app.took(answer);
    } else if (place) say(place, answer.error);
    else app.toast(answer.error);
    return answer.ok && answer;
  },
  say(text) { say('live', text); },
  toast(text) {
    const place = $('toast');
    place.textContent = text;
    place.classList.add('seen');
    clearTimeout(app.toast.timer);
    app.toast.timer = setTimeout(() => place.classList.remove('seen'), 4000);
  },

  // ---- steps ----
  show(step) {
    app.step = step;
    for (const name of STEPS) {
      $(`step-${name}`).hidden = name !== step;
      $(`go-${name}`).setAttribute('aria-current', name === step ? 'step' : 'false');
    }
    sessionStorage.setItem('step', step);
    const next = STEPS[STEPS.indexOf(step) + 1];
    $('next').hidden = !next;
    if (next) say('next', `Next: ${$(`go-${next}`).querySelector('.word').textContent} →`);
    app.line();
    arm.move(step);
    if (step === 'log' || step === 'channels') logs.open();
    if (step === 'model') logs.models();
    if (step === 'proof') proof.open();
    if (step === 'board') proof.board();
    if (step === 'design' && app.axes.frequencies && app.study.design === null) { app.change(); app.exact(); }
  },
  /** After a new log, rig or fit: new axes and a new initial state. */
  async renew(answer) {
    app.axes = axesOf(answer);
    design.around.pictures.clear(); // of the previous model
    if (answer.state) app.state = answer.state;
    design.axes(app.axes);
    if (answer.frequencies) { app.change(); await app.exact(); }
  },
  keep: () => app.write('keep', {}, ({kept, folder}) => app.toast(`Kept ${kept.length} files in ${folder}`)),
  /** Write files; ask before others are replaced. */
  async write(verb, given, written, failed = app.toast, force = false) {
    const answer = await app.ask(verb, {...given, force});
    if (answer.ok) {
      app.took(answer);
      written(answer);
    } else if (force || !(answer.field === 'folder' || /already|exists|overwrit/i.test(answer.error))) failed(answer.error);
    else {
      const dialog = $('replace');
      say('replace-said', answer.error);
      dialog.onclose = () => { if (dialog.returnValue === 'yes') app.write(verb, given, written, failed, true); };
      dialog.returnValue = '';
      dialog.showModal();
    }
  },
};
const axesOf = ({frequencies, payloads, rated}) => (frequencies ? {frequencies, payloads, rated} : {});

export const arm = new Arm(app);
export const design = new Design(app, arm);
export const logs = new Logs(app);
export const proof = new Proof(app, arm);

async function hello() {
  const answer = await app.ask('hello');
  if (!answer.ok) return;
  design.around.pictures.clear(); // those requested when the connection was lost
  const first = !app.states.length && app.at < 0;
  if (first || !('box' in app.state)) {
    app.states = answer.states;
    app.at = answer.at;
    app.state = answer.state;
    if (!app.states.length) { app.begun(); app.ask('note', {state: app.state}); }
  }
  app.axes = axesOf(answer);
  app.took(answer);
  design.axes(app.axes);
  app.buttons();
  if (!app.step) app.show(sessionStorage.getItem('step') || (answer.frequencies ? 'design' : 'log'));
  if (answer.frequencies) {
    app.change();
    app.exact();
  }
  document.documentElement.dataset.ready = 'true';
}

function listen() {
  const open = palette(app), clicked = {next: () => app.show(STEPS[STEPS.indexOf(app.step) + 1]), undo: () => app.go(app.at - 1), redo: () => app.go(app.at + 1), keep: app.keep, 'help-open': () => $('help').showModal(), 'palette-open': open, theme: () => {
    const root = document.documentElement, dark = root.dataset.theme ? root.dataset.theme === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
    sessionStorage.setItem('theme', root.dataset.theme = dark ? 'light' : 'dark');
  }};
  for (const step of STEPS) clicked[`go-${step}`] = () => app.show(step);
  clicked['copy-command'] = async () => {
    const text = $('command').textContent;
    try {
      await navigator.clipboard.writeText(text);
      app.toast('Copied');
    } catch {
      say('command', text); // without a clipboard the text can be selected there
    }
  };
  for (const id in clicked) on(id, 'click', clicked[id]);
  // with Ctrl anywhere, else where nothing is typed
  const held = {z: (event) => app.go(app.at + (event.shiftKey ? 1 : -1)), k: open, s: app.keep}, pressed = {'/': open, '?': clicked['help-open']};
  STEPS.forEach((step, i) => { pressed[i + 1] = () => app.show(step); });
  on(document, 'keydown', (event) => {
    const typing = event.altKey || event.target.closest('input:not([type=range]), select, textarea, dialog');
    const act = event.ctrlKey || event.metaKey ? held[event.key.toLowerCase()] : !typing && pressed[event.key];
    if (!act) return;
    event.preventDefault();
    act(event);
  });
}

listen();
if (sessionStorage.getItem('theme')) document.documentElement.dataset.theme = sessionStorage.getItem('theme');
app.link = new Link((answer) => {
  if (answer.verb === 'progress') proof.progress(answer);
  else if (answer.error) app.toast(answer.error);
}, (state) => {
  const banner = $('banner');
  banner.hidden = state === 'open';
  banner.textContent = banner.dataset[state] || '';
  if (state === 'open') hello();
});
