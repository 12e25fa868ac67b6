/** Strands and ropes: polylines in space, as wide as they are, at least a pixel. */

import { Lines } from './lines.js';
import { identity, multiply } from './maths.js';
import { display } from './points.js';

/** @typedef {import('./camera.js').Eye} View */
/** @typedef {import('./data.js').Streams} Streams */
/** @typedef {import('./skeleton.js').Pose} Pose */
/** @typedef {import('./types.js').StrandsRecord} StrandsRecord */

export class Strands {
  /** @param {WebGL2RenderingContext} gl @param {Streams} streams @param {StrandsRecord} record @param {Pose|null} pose Of the take that carries it. */
  constructor(gl, streams, record, pose) {
    this.streams = streams;
    this.record = record;
    this.lines = new Lines(gl);
    this.pose = pose;
    streams.use([record.points], pose?.span[0]);
    /** @type {number[]} Points that begin a segment. */
    this.heads = [];
    this.color = [0, 0, 0];
    /** @type {import('./data.js').Values|null} */
    this.points = null;
  }

  async load() {
    let at = 0;
    for (const count of await this.streams.whole(this.record.counts)) {
      for (let i = 0; i + 1 < count; i++) this.heads.push(at + i);
      at += count;
    }
    this.color = display(this.record.color ?? [0.26, 0.15, 0.07]);
  }

  /** @param {number} sample */
  update(sample) {
    const points = this.streams.at(this.record.points, sample);
    if (!points) return;
    this.points = this.#carried(points);
    this.lines.set(this.heads.length, this.points, this.heads, this.color);
  }

  /** @param {import('./data.js').Values} points @returns {import('./data.js').Values} Where the joint takes them that carries them. */
  #carried(points) {
    const { pose, record: { joint, bind } } = this;
    if (!pose) return points;
    const m = identity(), out = new Float32Array(points.length);
    [m[12], m[13], m[14]] = pose.shift;
    if (joint != null && bind) multiply(m, 0, pose.world, joint * 16, bind, 0);
    for (let i = 0; i < out.length; i += 3) {
      const x = points[i], y = points[i + 1], z = points[i + 2];
      for (let k = 0; k < 3; k++) out[i + k] = m[k] * x + m[4 + k] * y + m[8 + k] * z + m[12 + k];
    }
    return out;
  }

  /** @param {View} view */
  draw(view) {
    if (this.pose?.visible === false) return;
    this.lines.draw(view, { width: 1, world: this.record.width ?? 0 });
  }
}
