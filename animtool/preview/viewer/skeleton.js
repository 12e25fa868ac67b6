/** Poses: the world matrices of a take's joints at a sample, and paths of single joints. */

import { compose, multiply } from './maths.js';

/** @typedef {import('./types.js').TakeRecord} TakeRecord */
/** @typedef {import('./data.js').Streams} Streams */
/** @typedef {'t'|'r'|'s'} Part */

const FOOT = /foot|toe|ankle|paw|hoof|ball/i;

/** @param {number[]} parents @returns {number[]} Joints, each after its parent. */
function inOrder(parents) {
  const depth = parents.map((_, j) => {
    let count = 0;
    for (let p = parents[j]; p >= 0 && count <= parents.length; p = parents[p]) count++;
    return count;
  });
  return parents.map((_, j) => j).sort((a, b) => depth[a] - depth[b] || a - b);
}

export class Pose {
  /** @param {Streams} streams @param {TakeRecord} record @param {number} index */
  constructor(streams, record, index) {
    this.streams = streams;
    this.record = record;
    this.index = index;
    this.names = record.skeleton.names;
    this.parents = record.skeleton.parents;
    this.count = this.names.length;
    this.order = inOrder(this.parents);
    this.world = new Float32Array(16 * this.count);
    this.local = new Float32Array(16 * this.count);
    const still = record.still ?? record.skeleton.rest;
    this.tips = record.skeleton.tips ?? [];
    /** First and last frame of its own; others hold these. */
    this.span = record.span ?? [0, Infinity];
    /** @type {Record<Part, Float32Array>} Local values, those that move at the last sample. */
    this.values = {
      t: new Float32Array(still.t.flat()),
      r: new Float32Array(still.r.flat()),
      s: new Float32Array((still.s ?? this.names.map(() => [1, 1, 1])).flat()),
    };
    /** @type {{part: Part, stream: number, joints: number[]}[]} */
    this.moving = [];
    for (const part of /** @type {Part[]} */ (['t', 'r', 's'])) {
      const stream = record[part], joints = record.moving[part];
      if (stream == null || !joints?.length) continue;
      this.moving.push({ part, stream, joints });
      streams.use([stream], this.span[0]);
    }
    streams.use([record.shapes?.weights, record.visible], this.span[0]);
    /** Where the take stands beside the others [m]. */
    this.shift = [0, 0, 0];
    /** Whether it is drawn at the sample, and whether it is wanted at all. */
    this.visible = this.wanted = true;
    /** @type {Float32Array|null} How far each joint is from its like in the first take, 0…1. */
    this.heat = null;
    this.scratch = new Float32Array(16);
    this.root = Math.max(this.#root(), 0);
    this.trailed = this.#trailed();
    this.extent = 1;
  }

  /** @returns {number} The first joint that moves in space, else the first. */
  #root() {
    const moves = new Set(this.moving.find((each) => each.part === 't')?.joints ?? []);
    return this.order.find((j) => moves.has(j)) ?? this.order[0] ?? 0;
  }

  /** @returns {number[]} */
  #trailed() {
    if (!this.count) return [];
    const held = (this.record.contacts ?? []).map((each) => each.joint);
    const feet = held.length ? held : this.order.filter((j) => FOOT.test(this.names[j])
      && !FOOT.test(this.names[this.parents[j]] ?? '')).slice(0, 8);
    return [...new Set([this.root, ...feet])];
  }

  /** Read the local values of a sample. @param {number} sample */
  #read(sample) {
    for (const { part, stream, joints } of this.moving) {
      const values = this.streams.at(stream, sample);
      if (!values) return false;
      const width = part === 'r' ? 4 : 3, into = this.values[part];
      for (let i = 0; i < joints.length; i++) {
        for (let k = 0; k < width; k++) into[joints[i] * width + k] = values[i * width + k];
      }
    }
    return true;
  }

  /** Pose the skeleton. @param {number} sample @returns {boolean} False where it is not decoded. */
  update(sample) {
    const { visible } = this.record;
    this.visible = this.wanted && (visible == null || this.streams.at(visible, sample)?.[0] !== 0);
    if (!this.#read(sample)) return false;
    const { t, r, s } = this.values, { world, local, parents } = this;
    for (const j of this.order) {
      compose(local, j * 16, t, j * 3, r, j * 4, s, j * 3);
      if (parents[j] < 0) world.set(local.subarray(j * 16, j * 16 + 16), j * 16);
      else multiply(world, j * 16, world, parents[j] * 16, local, j * 16);
    }
    const [x, y, z] = this.shift;
    if (x || y || z) {
      for (let i = 12; i < world.length; i += 16) {
        world[i] += x; world[i + 1] += y; world[i + 2] += z;
      }
    }
    return true;
  }

  /** @param {number} j @returns {number[]} Where a joint is in the world. */
  position(j) {
    return [this.world[j * 16 + 12], this.world[j * 16 + 13], this.world[j * 16 + 14]];
  }

  /** @param {number[]} tip A joint, and a point in its frame. @returns {number[]} Where the point is. */
  tip([j, x, y, z]) {
    const m = this.world.subarray(j * 16, j * 16 + 16);
    return [0, 1, 2].map((k) => m[k] * x + m[4 + k] * y + m[8 + k] * z + m[12 + k]);
  }

  /** @param {number} joint @param {number} sample @returns {number[]|null} Where it is then. */
  path(joint, sample) {
    if (!this.#read(sample)) return null;
    const { t, r, s } = this.values, m = this.scratch;
    let [x, y, z] = [0, 0, 0];
    for (let j = joint, n = 0; j >= 0 && n <= this.count; j = this.parents[j], n++) {
      compose(m, 0, t, j * 3, r, j * 4, s, j * 3);
      [x, y, z] = [0, 1, 2].map((k) => m[k] * x + m[4 + k] * y + m[8 + k] * z + m[12 + k]);
    }
    return [x + this.shift[0], y + this.shift[1], z + this.shift[2]];
  }
}
