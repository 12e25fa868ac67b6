/** The ground, the paths of root and feet around the frame, and what touches the ground. */

import { Lines } from './lines.js';
import { roundUp } from './maths.js';

/** @typedef {import('./camera.js').View} View */
/** @typedef {import('./skeleton.js').Pose} Pose */
/** @typedef {{first: number, step: number, count: number}} Time */

const CELLS = 28, PIECE = 4;
/** Samples of a trail before and after the frame. */
const REACH = 48;

export class Ground {
  /** @param {WebGL2RenderingContext} gl @param {number} radius Of what is shown [m]. */
  constructor(gl, radius) {
    this.lines = new Lines(gl);
    /** Size of a cell [m]. */
    this.cell = roundUp(Math.max(radius, 1e-6) * 0.3);
    this.key = '';
  }

  /** Lay the grid around a point. @param {number[]} center @param {number[]} line @param {number[]} strong */
  lay(center, line, strong) {
    const { cell } = this, half = CELLS / 2;
    const [cx, cz] = [center[0], center[2]].map((x) => Math.round(x / cell));
    const key = [cx, cz, line, strong].join();
    if (key === this.key) return;
    this.key = key;
    for (let i = -half; i <= half; i++) {
      const x = (cx + i) * cell, z = (cz + i) * cell;
      // In pieces: what passes the camera is less exact.
      for (let k = -half; k < half; k += PIECE) {
        const [left, right] = [k, k + PIECE].map((n) => (cx + n) * cell);
        const [near, far] = [k, k + PIECE].map((n) => (cz + n) * cell);
        // The rest has faded.
        if (Math.hypot(i, Math.min(Math.abs(k), Math.abs(k + PIECE))) > half) continue;
        this.lines.add([x, 0, near], [x, 0, far], cx + i ? line : strong);
        this.lines.add([left, 0, z], [right, 0, z], cz + i ? line : strong);
      }
    }
    this.lines.flush();
  }

  /** @param {View} view @param {number[]} center */
  draw(view, center) {
    this.lines.draw(view, { width: 1, fade: [center[0], 0, center[2], this.cell * CELLS / 2] });
  }
}

export class Trails {
  /** @param {WebGL2RenderingContext} gl @param {Time} time */
  constructor(gl, time) {
    this.time = time;
    this.trails = new Lines(gl);
    this.rings = new Lines(gl);
  }

  /** @param {Pose} pose @param {number} joint @param {number} sample @returns {boolean} */
  touches({ record }, joint, sample) {
    const frame = this.time.first + sample * this.time.step;
    return (record.contacts ?? []).some((each) => each.joint === joint
      && each.spans.some(([first, last]) => frame >= first - 1e-6 && frame <= last + 1e-6));
  }

  /**
   * @param {Pose[]} poses @param {number} sample @param {(take: number) => number[]} color
   * @param {number[]} contact @param {{trails: boolean, contacts: boolean}} show
   */
  update(poses, sample, color, contact, show) {
    for (const pose of poses) {
      if (show.trails) for (const j of pose.trailed) this.#trail(pose, j, sample, color(pose.index), contact);
      if (!show.contacts) continue;
      for (const { joint } of pose.record.contacts ?? []) {
        if (this.touches(pose, joint, sample)) this.#ring(pose.position(joint), pose.extent * 0.045, contact);
      }
    }
    this.trails.flush();
    this.rings.flush();
  }

  /** @param {Pose} pose @param {number} joint @param {number} sample @param {number[]} color @param {number[]} contact */
  #trail(pose, joint, sample, color, contact) {
    const last = Math.min(this.time.count - 1, sample + REACH);
    /** @type {number[]|null} */
    let before = null;
    for (let i = Math.max(0, sample - REACH); i <= last; i++) {
      const at = pose.path(joint, i);
      const gone = 1 - Math.abs(i - sample) / (REACH + 1);
      const tint = this.touches(pose, joint, i) ? contact : color;
      if (at && before) this.trails.add(before, at, [...tint.slice(0, 3), 255 * gone * (i <= sample ? 0.95 : 0.4)]);
      before = at;
    }
  }

  /** @param {number[]} at @param {number} radius @param {number[]} color */
  #ring([x, y, z], radius, color) {
    const point = (/** @type {number} */ i) => [
      x + radius * Math.cos(i * Math.PI / 12), y, z + radius * Math.sin(i * Math.PI / 12)];
    for (let i = 0; i < 24; i++) this.rings.add(point(i), point(i + 1), color);
  }

  /** @param {View} view */
  draw(view) {
    this.trails.draw(view, { width: 2 });
    this.rings.draw(view, { width: 3 });
  }
}
