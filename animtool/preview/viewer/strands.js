/** Strands and ropes: polylines in space, as wide as they are, at least a pixel. */

import { Lines } from './lines.js';
import { display } from './points.js';

/** @typedef {import('./camera.js').View} View */
/** @typedef {import('./data.js').Streams} Streams */
/** @typedef {import('./types.js').StrandsRecord} StrandsRecord */

export class Strands {
  /** @param {WebGL2RenderingContext} gl @param {Streams} streams @param {StrandsRecord} record @param {number} first Frame of its first sample. */
  constructor(gl, streams, record, first) {
    this.streams = streams;
    this.record = record;
    this.lines = new Lines(gl);
    streams.use([record.points], first);
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
    this.points = points;
    this.lines.set(this.heads.length, points, this.heads, this.color);
  }

  /** @param {View} view */
  draw(view) { this.lines.draw(view, { width: 1, world: this.record.width ?? 0 }); }
}
