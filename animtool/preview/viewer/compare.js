/** Several takes: beside or over one another, and how far they are from the first. */

import { Box, roundUp } from './maths.js';
import { SERIES, button, click, css, make, named, need, number, press } from './dom.js';

/** @typedef {import('./main.js').App} App */
/** @typedef {import('./skeleton.js').Pose} Pose */

export class Compare {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.poses = app.scene.poses;
    this.beside = this.poses.some((pose) => (pose.record.offset ?? []).some((x) => x));
    this.heat = false;
    /** Distance with the hottest colour [m]; it grows with what was seen. */
    this.scale = 1e-3;
    /** @type {(number[]|null)[]} For each take, the joint of the first that each joint has for like. */
    this.likes = this.poses.map((pose, i) => {
      const first = new Map(this.poses[0].names.map((name, j) => [name, j]));
      return i ? pose.names.map((name) => first.get(name) ?? -1) : null;
    });
    this.results = this.poses.map(() => make('span', { class: 'where' }));
    need('takes', HTMLElement).append(...this.poses.map((pose, i) => this.#entry(pose, i)));
    const several = this.poses.length > 1;
    need('layouts', HTMLElement).hidden = !several;
    click('over', () => this.arrange(false));
    click('beside', () => this.arrange(true));
    click('heat', () => {
      this.heat = !this.heat;
      this.show();
      app.invalidate(true);
    });
    this.show();
  }

  /** @param {Pose} pose @param {number} i @returns {HTMLElement} */
  #entry(pose, i) {
    const dot = make('i', { class: 'dot' });
    if (this.poses.length > 1) dot.style.background = css(SERIES[i % SERIES.length]);
    const check = make('input', {
      type: 'checkbox', checked: true, change: (event) => {
        pose.wanted = event.target instanceof HTMLInputElement && event.target.checked;
        this.app.invalidate(true);
      },
    });
    return make('li', {}, make('label', {}, check, dot, named(pose.record.name),
      make('span', { class: 'where' }, `${pose.count} joints`)), this.results[i]);
  }

  /** Shift the takes. @param {boolean} beside */
  arrange(beside) {
    this.beside = beside;
    const given = this.poses.some((pose) => (pose.record.offset ?? []).some((x) => x));
    let gap = 0;
    for (const pose of this.poses) {
      const box = new Box();
      for (let j = 0; j < pose.count; j++) box.add(pose.world, j * 16 + 12);
      if (!box.empty) gap = Math.max(gap, (box.high[0] - box.low[0]) * 1.25, box.radius * 0.6);
    }
    this.poses.forEach((pose, i) => {
      pose.shift = !beside ? [0, 0, 0] : given ? pose.record.offset ?? [0, 0, 0] : [i * gap, 0, 0];
    });
    this.show();
    this.app.home();
    this.app.invalidate(true);
  }

  /** Measure the takes of a sample that is posed. */
  update() {
    const [first, ...others] = this.poses;
    // Those of a crowd are no versions of one motion.
    if (!others.length || this.app.scene.crowd && !this.heat && !first.heat) return;
    first.heat = this.heat ? new Float32Array(first.count) : null;
    /** @type {Float32Array[]} */
    const apart = [];
    for (const pose of others) {
      const far = new Float32Array(pose.count), likes = this.likes[pose.index] ?? [];
      let most = 0, worst = -1;
      for (let j = 0; j < pose.count; j++) {
        if (likes[j] < 0) continue;
        let sum = 0;
        for (let k = 0; k < 3; k++) {
          const d = pose.world[j * 16 + 12 + k] - pose.shift[k]
            - first.world[likes[j] * 16 + 12 + k] + first.shift[k];
          sum += d * d;
        }
        far[j] = Math.sqrt(sum);
        if (far[j] > most) [most, worst] = [far[j], j];
      }
      this.scale = Math.max(this.scale, roundUp(most));
      apart.push(far);
      this.results[pose.index].replaceChildren(worst < 0 ? 'no difference'
        : `up to ${number(most * 1000, 2)} mm, `, worst < 0 ? '' : named(pose.names[worst]));
    }
    others.forEach((pose, i) => {
      pose.heat = this.heat ? apart[i].map((x) => Math.min(x / this.scale, 1)) : null;
    });
    need('heat-most', HTMLElement).textContent = `${number(this.scale * 1000)} mm`;
  }

  show() {
    press(button('over'), !this.beside);
    press(button('beside'), this.beside);
    press(button('heat'), this.heat);
    need('heat-scale', HTMLElement).hidden = !this.heat;
  }
}
