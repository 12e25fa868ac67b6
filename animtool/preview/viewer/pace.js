/** Pictures that come late are drawn less well: rough edges, and a crowd as bones. */

import { button } from './dom.js';

/** @typedef {import('./main.js').App} App */

/** Edges are smooth while pictures come as soon as this, and crowds have skins as soon as that [ms]. */
const QUICK = 20, LONG = 50;

export class Pace {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    /** Whether edges are smooth while it plays. */
    this.fine = true;
    /** Whether the user said how a crowd is drawn. */
    this.chosen = false;
    this.mean = 0;
  }

  /** Begin to measure. */
  reset() { this.mean = 0; }

  /** @param {number} now @param {number} before When the last picture was begun, 0 for none [ms]. */
  hurry(now, before) {
    if (!before) return;
    const { scene } = this.app, last = now - before;
    this.mean += (last - (this.mean || last)) / 8;
    if (this.mean > QUICK) this.fine = false;
    if (this.mean > LONG && scene.crowd && scene.bodies.length && !this.chosen && !scene.simple) this.setSimple(true);
  }

  /** @param {boolean} simple Whether a crowd is drawn as bones. */
  setSimple(simple) {
    const { scene } = this.app, note = button('simple');
    note.hidden = !scene.crowd || !scene.bodies.length;
    scene.simple = !note.hidden && simple;
    note.textContent = scene.simple ? 'crowd drawn as bones; key M draws meshes' : 'key M draws the crowd as bones';
    this.app.invalidate(true);
  }

  /** The user's word is the last. */
  toggle() {
    this.chosen = true;
    this.setSimple(!this.app.scene.simple);
  }
}
