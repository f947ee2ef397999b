// The arm of the shared page, given a new law at every drag.
import {startArm} from './arm_box.js';
import {$, on, say} from './dom.js';
import {put} from './svg.js';

export class Arm {
  constructor(app) {
    this.app = app;
    this.key = '';
    this.moving = null; // the interface of the running arm
    this.taken = Promise.resolve(); // resolved when the newest answer has been taken
    this.moved = () => {};
    this.held = null;
    this.hands();
  }

  /** Take the answer of an exact design: a new arm, or a new law for this one. One after the other, since an arm takes a moment to start. */
  take(answer) {
    if (answer.arm_key !== undefined) this.taken = this.taken.then(() => this.taking(answer));
  }
  async taking(answer) {
    if (answer.arm) {
      const fresh = JSON.parse(answer.arm);
      if (!this.moving?.use(fresh)) await this.rebuild(answer.arm);
    } else if (answer.blocks && this.moving) this.moving.law(answer.blocks);
    this.key = answer.arm_key && this.moving ? answer.arm_key : '';
    this.moved();
    this.app.line();
  }
  command(words) { return this.moving ? this.moving.command(words) : words; }

  async rebuild(text) {
    this.moving?.stop();
    this.moving = null;
    say('arm-data', text);
    document.querySelector('.armbox')?.remove();
    this.box = $('arm-template').content.cloneNode(true).querySelector('.armbox');
    $('arm-design').append(this.box);
    this.moving = await startArm(() => this.app.line());
    this.move(this.app.step);
  }

  law(blocks) {
    if (!this.moving) return;
    this.moving.law(blocks, this.box?.classList.contains('compact'));
    this.moved();
  }

  /** Small and beside the loop in the design step; in the move step it fills the page. */
  move(step) {
    $('no-arm').hidden = Boolean(this.box);
    if (!this.box) return;
    const whole = step === 'move';
    $(whole ? 'arm-move' : 'arm-design').append(this.box);
    this.box.classList.toggle('compact', !whole);
    if (whole || step === 'design') this.moving?.lay();
  }

  /** A run computed by Python: the tip held by hand, a payload lost during the move, or a case of the fault campaign. */
  async play(verb, given) {
    const answer = await this.app.need(verb, given);
    if (!answer || !this.moving) return;
    if (this.app.step !== 'move') this.app.show('move');
    this.moving.show(answer);
    this.app.say(answer.said);
  }
  hold(wanted) {
    if (!this.moving || wanted === Boolean(this.held)) return;
    const now = this.moving.now(), {at, angle, duration} = now;
    const {begin, angle: place} = this.held ||= {begin: at, angle};
    put($('hold'), {'aria-pressed': wanted});
    if (!wanted) this.held = null;
    this.play('play', {...now, hold: {begin, angle: place, until: wanted || at < begin ? duration : at}});
  }
  lose() {
    if (!this.moving) return;
    const now = this.moving.now();
    this.play('play', {...now, throw: {time: now.at, payload: now.lightest}});
  }
  /** The pointer on the payload: a click drops the payload during the move; a longer press holds the tip until release. */
  hands() {
    on('hold', 'click', () => this.hold(!this.held));
    on('lose', 'click', () => this.lose());
    let timer = 0, pressed = false;
    const place = $('arm-move'), ours = (event) => event.target.closest('#load');
    place.addEventListener('pointerdown', (event) => { if (ours(event)) timer = setTimeout(() => { timer = 0; this.hold(pressed = true); }, 250); }, true);
    on(window, 'pointerup', () => { clearTimeout(timer); if (pressed) this.hold(pressed = false); });
    place.addEventListener('click', (event) => {
      if (!ours(event)) return;
      event.stopPropagation();
      if (timer) this.lose();
      timer = 0;
    }, true);
  }
  runs(masses, blocks) { return this.moving ? this.moving.runs(masses, blocks) : null; }
}
