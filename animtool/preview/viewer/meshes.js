/** Meshes: skins and blend shapes in the vertex shader, and points that move as cached. */

import { CELL, SHADE, Table, attribute, makeBuffer, makeProgram } from './gl.js';
import { multiply } from './maths.js';
import { display } from './points.js';

/** @typedef {import('./camera.js').View} View */
/** @typedef {import('./data.js').Streams} Streams */
/** @typedef {import('./data.js').Values} Values */
/** @typedef {import('./skeleton.js').Pose} Pose */
/** @typedef {import('./types.js').MeshRecord} MeshRecord */
/** @typedef {{skin?: boolean, shapes?: boolean, instances?: boolean}} Kind */

const VERTEX = `${CELL}
layout(location=0) in vec3 point; layout(location=1) in vec3 normal;
#ifdef SKIN
layout(location=2) in uvec4 joints; layout(location=3) in vec4 weights;
#endif
#ifdef SHAPES
layout(location=4) in uvec2 span;
#endif
#ifdef INSTANCES
layout(location=5) in mat4 placed; layout(location=9) in vec3 ownColor;
#endif
uniform mat4 viewProjection, view; uniform vec3 color, shift; uniform sampler2D palette, deltas, amounts;
out vec3 n; out vec3 tint; out vec3 eye; out float heat;
void main() {
  vec4 p = vec4(point, 1.);
  vec3 m = normal;
  tint = color; heat = -1.;
#ifdef SHAPES
  for (uint i = span.x; i < span.x + span.y; i++) {
    vec4 d = cell(deltas, int(i));
    p.xyz += d.xyz * cell(amounts, int(d.w)).x;
  }
#endif
#ifdef SKIN
  vec4 a = vec4(0), b = vec4(0), c = vec4(0), extra = vec4(0);
  for (int k = 0; k < 4; k++) {
    if (weights[k] == 0.) continue;
    int at = int(joints[k]) * 4;
    a += weights[k] * cell(palette, at); b += weights[k] * cell(palette, at + 1);
    c += weights[k] * cell(palette, at + 2); extra += weights[k] * cell(palette, at + 3);
  }
  p = vec4(dot(a, p), dot(b, p), dot(c, p), 1.);
  m = vec3(dot(a.xyz, m), dot(b.xyz, m), dot(c.xyz, m));
  heat = extra.x;
#endif
#ifdef INSTANCES
  p = placed * p; m = mat3(placed) * m; tint = ownColor;
#endif
#ifndef SKIN
  p.xyz += shift;
#endif
  n = mat3(view) * m;
  eye = (view * p).xyz;
  gl_Position = viewProjection * p;
}`;

const FRAGMENT = `${SHADE}
in vec3 n; in vec3 tint; in vec3 eye; in float heat; uniform bool flat_; out vec4 result;
void main() {
  vec3 m = normalize(flat_ || dot(n, n) < 1e-12 ? cross(dFdx(eye), dFdy(eye)) : n);
  if (dot(m, eye) > 0.) m = -m;
  result = vec4(shade(heat >= 0. ? heatColor(heat) : tint, m), 1.);
}`;

/** Meshes with fewer points are shaded by face: boxes keep their edges. */
const SMOOTH_FROM = 200;
export const COLOR = [0.4, 0.43, 0.48];

/** @type {Map<string, import('./gl.js').Program>} */
const programs = new Map();

/** @param {WebGL2RenderingContext} gl @param {Kind} kind */
function programOf(gl, kind) {
  const names = Object.entries(kind).filter(([, on]) => on).map(([name]) => name.toUpperCase());
  const key = names.join();
  const made = programs.get(key)
    ?? makeProgram(gl, names.map((name) => `#define ${name}\n`).join('') + VERTEX, FRAGMENT);
  programs.set(key, made);
  return made;
}

/** @param {Values} points @param {Values} faces @returns {Float32Array<ArrayBuffer>} Normals of points, as large faces as much. */
export function normalsOf(points, faces) {
  const out = new Float32Array(points.length);
  for (let f = 0; f < faces.length; f += 3) {
    const a = faces[f] * 3, b = faces[f + 1] * 3, c = faces[f + 2] * 3;
    const ux = points[b] - points[a], uy = points[b + 1] - points[a + 1], uz = points[b + 2] - points[a + 2];
    const vx = points[c] - points[a], vy = points[c + 1] - points[a + 1], vz = points[c + 2] - points[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const i of [a, b, c]) { out[i] += x; out[i + 1] += y; out[i + 2] += z; }
  }
  return out;
}

export class Mesh {
  /**
   * @param {WebGL2RenderingContext} gl @param {Streams} streams @param {MeshRecord} record
   * @param {Pose|null} pose @param {boolean} instances Whether instances draw it.
   */
  constructor(gl, streams, record, pose, instances) {
    this.gl = gl;
    this.streams = streams;
    this.record = record;
    this.pose = pose;
    this.instances = instances;
    this.array = gl.createVertexArray();
    this.points = makeBuffer(gl);
    this.normals = makeBuffer(gl);
    this.count = 0;
    /** Greatest coordinate [m]. */
    this.reach = 0;
    /** @type {Values} Points of rest, or of the last sample of a cache. */
    this.shown = new Float32Array(0);
    streams.use([record.cache, record.visible], pose?.span[0]);
  }

  /** Decode what does not move and give it to the graphics processor. */
  async load() {
    const { gl, record, streams } = this;
    this.shown = await streams.whole(record.points);
    for (const x of this.shown) this.reach = Math.max(this.reach, Math.abs(x));
    /** @type {Values} */
    this.faces = new Uint32Array(await streams.whole(record.faces));
    this.count = this.faces.length;
    const vertices = this.shown.length / 3;
    const given = record.normals == null ? null : await streams.whole(record.normals);
    this.smooth = vertices >= SMOOTH_FROM || given != null;
    gl.bindVertexArray(this.array);
    const index = makeBuffer(gl, this.faces, gl.ELEMENT_ARRAY_BUFFER);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, index);
    this.#place(this.shown, given?.length === this.shown.length ? given : null);
    attribute(gl, 0, this.points, 3);
    attribute(gl, 1, this.normals, 3);
    gl.bindVertexArray(null);
    if (record.skin && this.pose) await this.#loadSkin(record.skin);
    if (record.shapes?.length && this.pose?.record.shapes) await this.#loadShapes(record.shapes, vertices);
    gl.bindVertexArray(null);
    this.program = programOf(gl, {
      skin: !!this.palette, shapes: !!this.deltas, instances: this.instances });
  }

  /** @param {Values} points @param {Values|null} [normals] */
  #place(points, normals = null) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.points);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points), gl.DYNAMIC_DRAW);
    const own = normals ?? (this.smooth ? normalsOf(points, this.faces ?? points) : points);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.normals);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(own), gl.DYNAMIC_DRAW);
  }

  /** @param {import('./types.js').Skin} skin */
  async #loadSkin(skin) {
    const { gl, streams } = this;
    const joints = new Uint16Array(await streams.whole(skin.joints));
    const weights = new Float32Array(await streams.whole(skin.weights));
    this.bind = new Float32Array(await streams.whole(skin.bind));
    for (let i = 0; i < weights.length; i += 4) {
      const sum = weights[i] + weights[i + 1] + weights[i + 2] + weights[i + 3] || 1;
      for (let k = 0; k < 4; k++) weights[i + k] /= sum;
    }
    gl.bindVertexArray(this.array);
    attribute(gl, 2, makeBuffer(gl, joints), 4, { type: gl.UNSIGNED_SHORT, whole: true });
    attribute(gl, 3, makeBuffer(gl, weights), 4);
    this.palette = new Table(gl, skin.palette.length * 4);
  }

  /** Sort what shapes displace by vertex. @param {import('./types.js').Shape[]} shapes @param {number} vertices */
  async #loadShapes(shapes, vertices) {
    const { gl, streams } = this, span = new Uint32Array(vertices * 2);
    const parts = await Promise.all(shapes.map(async ({ column, vertices: v, offsets }) => ({
      column, moved: await streams.whole(v), offsets: await streams.whole(offsets) })));
    for (const { moved } of parts) for (const v of moved) span[v * 2 + 1]++;
    for (let v = 1; v < vertices; v++) span[v * 2] = span[v * 2 - 2] + span[v * 2 - 1];
    const next = span.filter((_, i) => i % 2 === 0);
    const deltas = new Table(gl, parts.reduce((sum, { moved }) => sum + moved.length, 0));
    for (const { column, moved, offsets } of parts) {
      for (let i = 0; i < moved.length; i++) {
        deltas.values.set([offsets[i * 3], offsets[i * 3 + 1], offsets[i * 3 + 2], column], next[moved[i]]++ * 4);
      }
    }
    deltas.send();
    this.deltas = deltas;
    this.amounts = new Table(gl, this.pose?.record.shapes?.names.length ?? 1);
    gl.bindVertexArray(this.array);
    attribute(gl, 4, makeBuffer(gl, span), 2, { type: gl.UNSIGNED_INT, whole: true });
  }

  /** @param {number} sample */
  update(sample) {
    const { pose, palette, bind, streams, record } = this;
    this.hidden = record.visible != null && streams.at(record.visible, sample)?.[0] === 0;
    if (pose && palette && bind) {
      const m = new Float32Array(16), cells = palette.values;
      record.skin?.palette.forEach((joint, j) => {
        multiply(m, 0, pose.world, joint * 16, bind, j * 16);
        for (let i = 0; i < 12; i++) cells[j * 16 + i] = m[(i % 4) * 4 + (i >> 2)];
        cells[j * 16 + 12] = pose.heat ? pose.heat[joint] : -1;
      });
      palette.send();
    }
    const track = pose?.record.shapes, weights = track && streams.at(track.weights, sample);
    if (this.amounts && weights) {
      weights.forEach((x, i) => { if (this.amounts) this.amounts.values[i * 4] = x; });
      this.amounts.send();
    }
    const cached = record.cache == null ? null : streams.at(record.cache, sample);
    if (cached) {
      this.shown = cached;
      this.#place(cached);
    }
  }

  /** @param {View} view @param {number} [instances] How many to draw, each where its buffer says. */
  draw(view, instances = 0) {
    const { gl, program, record } = this;
    if (!program || this.hidden || this.pose?.visible === false) return;
    gl.useProgram(program.program);
    gl.uniformMatrix4fv(program.at('viewProjection'), false, view.viewProjection);
    gl.uniformMatrix4fv(program.at('view'), false, view.view);
    gl.uniform3fv(program.at('color'), display(record.color ?? COLOR).map((x) => x / 255));
    gl.uniform3fv(program.at('shift'), this.pose?.shift ?? [0, 0, 0]);
    gl.uniform1i(program.at('flat_'), this.smooth ? 0 : 1);
    this.palette?.bind(0, program.at('palette'));
    this.deltas?.bind(1, program.at('deltas'));
    this.amounts?.bind(2, program.at('amounts'));
    gl.bindVertexArray(this.array);
    if (this.instances) gl.drawElementsInstanced(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0, instances);
    else gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
  }
}
