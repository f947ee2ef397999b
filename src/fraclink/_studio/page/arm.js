// @ts-check
// The arm of the shared page, with another law at every drag.
import {startArm} from './arm_box.js';

export class Arm {
  constructor(app) {
    this.app = app;
    this.key = '';
    this.moving = null; // the doors of the running arm
    this.moved = () => {};
    this.masses = [];
  }

  /** What an exact design brings: a new arm, or a new law for this one. */
  take(answer) {
    if (answer.arm_key === undefined) return;
    if (answer.arm) {
      const fresh = JSON.parse(answer.arm);
      if (!this.moving || !this.moving.use(fresh)) this.rebuild(answer.arm);
    } else if (answer.blocks && this.moving) this.moving.law(answer.blocks);
    this.key = answer.arm_key && this.moving ? answer.arm_key : '';
    this.moved();
  }

  rebuild(text) {
    this.moving?.stop();
    document.getElementById('arm-data').textContent = text;
    const template = /** @type {HTMLTemplateElement} */ (document.getElementById('arm-template'));
    document.querySelector('.armbox')?.remove();
    this.box = /** @type {HTMLElement} */ (/** @type {any} */ (template.content.cloneNode(true)).querySelector('.armbox'));
    document.getElementById('arm-design').append(this.box);
    this.moving = startArm();
    this.move(this.app.step);
  }

  law(blocks, masses) {
    if (!this.moving) return;
    this.masses = masses;
    this.moving.law(blocks, this.box?.classList.contains('compact'));
    this.moved();
  }

  /** In the design it is small and beside the loop, in the move it has the page. */
  move(step) {
    document.getElementById('no-arm').hidden = Boolean(this.box);
    if (!this.box) return;
    const whole = step === 'move';
    document.getElementById(whole ? 'arm-move' : 'arm-design').append(this.box);
    this.box.classList.toggle('compact', !whole);
    if (whole || step === 'design') this.moving.lay();
  }

  runs(masses) { return this.moving ? this.moving.runs(masses) : null; }
}
