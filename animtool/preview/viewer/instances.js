/** Instances of a mesh: rigid bodies, flocks, crowds and props. */

import { attribute, makeBuffer } from './gl.js';
import { compose } from './maths.js';
import { COLOR } from './meshes.js';
import { display, repeated } from './points.js';

/** @typedef {import('./camera.js').Eye} View */
/** @typedef {import('./data.js').Streams} Streams */
/** @typedef {import('./meshes.js').Mesh} Mesh */
/** @typedef {import('./types.js').InstancesRecord} InstancesRecord */

export class Instances {
  /** @param {WebGL2RenderingContext} gl @param {Streams} streams @param {InstancesRecord} record @param {Mesh} mesh */
  constructor(gl, streams, record, mesh) {
    this.gl = gl;
    this.streams = streams;
    this.record = record;
    this.mesh = mesh;
    this.count = Math.floor(streams.width(record.t) / 3);
    streams.use([record.t, record.r, record.s, record.visible]);
    this.matrices = new Float32Array(this.count * 16);
    this.places = makeBuffer(gl);
    this.colors = makeBuffer(gl);
    this.shown = 0;
  }

  /** @param {number} sample */
  update(sample) {
    const { gl, record, streams, matrices } = this;
    const at = (/** @type {number|null|undefined} */ id) => (id == null ? null : streams.at(id, sample));
    const t = at(record.t), r = at(record.r), s = at(record.s);
    const visible = at(record.visible);
    if (!t || !r) return;
    const tints = repeated(this.count, display(this.mesh.record.color ?? COLOR));
    this.shown = 0;
    for (let i = 0; i < this.count; i++) {
      if (visible && !visible[i] || !Number.isFinite(t[i * 3])) continue;
      compose(matrices, this.shown * 16, t, i * 3, r, i * 4, s, i * 3);
      this.shown++;
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.places);
    gl.bufferData(gl.ARRAY_BUFFER, matrices, gl.DYNAMIC_DRAW);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.colors);
    gl.bufferData(gl.ARRAY_BUFFER, tints, gl.DYNAMIC_DRAW);
  }

  /** @param {View} view */
  draw(view) {
    const { gl } = this;
    gl.bindVertexArray(this.mesh.geometry.array);
    for (let c = 0; c < 4; c++) attribute(gl, 5 + c, this.places, 4, { stride: 64, offset: c * 16, each: 1 });
    attribute(gl, 9, this.colors, 3, { type: gl.UNSIGNED_BYTE, normal: true, each: 1 });
    this.mesh.draw(view, this.shown);
  }
}
