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
    this.ends = new Float32Array(0);
    this.colors = new Uint8Array(0);
    /** @type {import('./data.js').Values|null} */
    this.points = null;
  }

  async load() {
    let at = 0;
    for (const count of await this.streams.whole(this.record.counts)) {
      for (let i = 0; i + 1 < count; i++) this.heads.push(at + i);
      at += count;
    }
    this.ends = new Float32Array(this.heads.length * 6);
    const color = display(this.record.color ?? [0.26, 0.15, 0.07]);
    this.colors = new Uint8Array(this.heads.length * 4).map((_, i) => (i % 4 === 3 ? 255 : color[i % 4]));
  }

  /** @param {number} sample */
  update(sample) {
    const points = this.streams.at(this.record.points, sample);
    if (!points) return;
    this.points = points;
    this.heads.forEach((head, i) => this.ends.set(points.subarray(head * 3, head * 3 + 6), i * 6));
    this.lines.set(this.ends, this.colors);
  }

  /** @param {View} view */
  draw(view) { this.lines.draw(view, { width: 1, world: this.record.width ?? 0 }); }
}
