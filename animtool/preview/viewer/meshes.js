/** Meshes: skins in the vertex shader, blend shapes that have a weight, and points that move as cached. */

import { CELL, SHADE, Table, attribute, makeBuffer, makeProgram, use } from './gl.js';
import { Box, multiply, transform } from './maths.js';
import { display } from './points.js';

/** @typedef {import('./camera.js').Eye} View */
/** @typedef {import('./data.js').Streams} Streams */
/** @typedef {import('./data.js').Values} Values */
/** @typedef {import('./skeleton.js').Pose} Pose */
/** @typedef {import('./types.js').MeshRecord} MeshRecord */
/** @typedef {{skin?: boolean, paint?: boolean, instances?: boolean}} Kind */

const VERTEX = `${CELL}
layout(location=0) in vec3 point; layout(location=1) in vec3 normal;
#ifdef SKIN
layout(location=2) in uvec4 joints; layout(location=3) in vec4 weights;
#endif
#ifdef PAINT
layout(location=4) in vec3 paint;
#endif
#ifdef INSTANCES
layout(location=5) in mat4 placed; layout(location=9) in vec3 ownColor;
#endif
uniform mat4 viewProjection, view; uniform vec3 color, shift; uniform sampler2D palette;
out vec3 n; out vec3 tint; out vec3 eye; out float heat;
void main() {
  vec4 p = vec4(point, 1.);
  vec3 m = normal;
  tint = color; heat = -1.;
#ifdef PAINT
  tint = paint;
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
in vec3 n; in vec3 tint; in vec3 eye; in float heat; uniform float faceted; out vec4 result;
void main() {
  vec3 m = normalize(faceted > 0. || dot(n, n) < 1e-12 ? cross(dFdx(eye), dFdy(eye)) : n);
  if (dot(m, eye) > 0.) m = -m;
  result = vec4(shade(heat >= 0. ? heatColor(heat) : tint, m), 1.);
}`;

/** Meshes with fewer points are shaded by face: boxes keep their edges. */
const SMOOTH_FROM = 200;
/** Vertices of a skin that say how large it is. */
const BOUNDS = 200;
export const COLOR = [0.4, 0.43, 0.48];
/** Lower than this above 0 a mesh is a ground, wider it is a room, as parts of the radius of what is shown. */
const FLAT = 0.02, WIDE = 2.2;

/** @param {WebGL2RenderingContext} gl @param {Kind} kind */
function programOf(gl, kind) {
  const names = Object.entries(kind).filter(([, on]) => on).map(([name]) => name.toUpperCase());
  return makeProgram(gl, names.map((name) => `#define ${name}\n`).join('') + VERTEX, FRAGMENT);
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

/** Buffers of a mesh at rest, which all meshes of the same streams share. */
export class Geometry {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.array = gl.createVertexArray();
    this.points = makeBuffer(gl);
    this.normals = makeBuffer(gl);
    /** @type {Values} */
    this.rest = new Float32Array(0);
    this.faces = new Uint32Array(0);
    this.bind = new Float32Array(0);
    /** First joint of vertices, in the palette. */
    this.joints = new Uint16Array(0);
    /** Greatest coordinate [m], and all that it takes at rest. */
    this.reach = 0;
    this.box = new Box();
    this.smooth = false;
  }

  /** Decode it and give it to the graphics processor. @param {Streams} streams @param {MeshRecord} record */
  async load(streams, { points, faces, skin, colors }) {
    const { gl, array } = this;
    this.rest = await streams.whole(points);
    this.faces = new Uint32Array(await streams.whole(faces));
    for (const x of this.rest) this.reach = Math.max(this.reach, Math.abs(x));
    for (let i = 0; i < this.rest.length; i += 3) this.box.add(this.rest, i);
    this.smooth = this.rest.length >= SMOOTH_FROM * 3;
    this.place(this.rest);
    gl.bindVertexArray(array);
    attribute(gl, 0, this.points, 3);
    attribute(gl, 1, this.normals, 3);
    if (skin) {
      const weights = new Float32Array(await streams.whole(skin.weights));
      const joints = this.joints = new Uint16Array(await streams.whole(skin.joints));
      this.bind = new Float32Array(await streams.whole(skin.bind));
      gl.bindVertexArray(array);
      attribute(gl, 2, makeBuffer(gl, joints), 4, { type: gl.UNSIGNED_SHORT, whole: true });
      attribute(gl, 3, makeBuffer(gl, weights), 4);
    }
    if (colors != null) {
      const paint = new Uint8Array(await streams.whole(colors));
      gl.bindVertexArray(array);
      attribute(gl, 4, makeBuffer(gl, paint), 3, { type: gl.UNSIGNED_BYTE, normal: true });
    }
    gl.bindVertexArray(array);
    makeBuffer(gl, this.faces, gl.ELEMENT_ARRAY_BUFFER);
    gl.bindVertexArray(null);
    return this;
  }

  /** @param {Values} points */
  place(points) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.points);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points), gl.DYNAMIC_DRAW);
    const own = this.smooth ? normalsOf(points, this.faces) : points;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.normals);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(own), gl.DYNAMIC_DRAW);
  }
}

export class Mesh {
  /**
   * @param {WebGL2RenderingContext} gl @param {Streams} streams @param {MeshRecord} record
   * @param {Pose|null} pose @param {Map<string, Promise<Geometry>>} known What meshes share.
   */
  constructor(gl, streams, record, pose, known) {
    this.gl = gl;
    this.streams = streams;
    this.record = record;
    this.pose = pose;
    this.known = known;
    /** Whether instances draw it. */
    this.instances = !!record.prototype;
    this.geometry = new Geometry(gl);
    /** @type {Values} Points of rest, or of the last sample of a cache. */
    this.shown = this.geometry.rest;
    /** @type {{column: number, vertices: Values, offsets: Values}[]} */
    this.shapes = [];
    /** Weights that the points were last made of. */
    this.amounts = '';
    this.hidden = false;
    this.program = programOf(gl, { skin: !!(pose && record.skin), paint: record.colors != null, instances: this.instances });
    streams.use([record.cache, record.visible], pose?.span[0]);
  }

  /** Decode what does not move. */
  async load() {
    const { gl, record, streams, known } = this, { points, faces, skin, shapes, colors } = record;
    const own = record.cache != null || shapes?.length;
    const key = own ? '' : [points, faces, colors, skin?.joints, skin?.weights, skin?.bind].join();
    const wait = known.get(key) ?? this.geometry.load(streams, record);
    if (key) known.set(key, wait);
    this.geometry = await wait;
    this.shown = this.geometry.rest;
    if (this.pose && skin) this.palette = new Table(gl, skin.palette.length * 4);
    this.shapes = await Promise.all((shapes ?? []).map(async (each) => ({
      column: each.column, vertices: await streams.whole(each.vertices), offsets: await streams.whole(each.offsets) })));
  }

  /** Displace points by the shapes that have a weight, where these are others than before. @param {Values} weights */
  #shape(weights) {
    const amounts = this.shapes.map(({ column }) => weights[column]).join();
    if (amounts === this.amounts) return;
    this.amounts = amounts;
    const points = new Float32Array(this.geometry.rest);
    for (const { column, vertices, offsets } of this.shapes) {
      const weight = weights[column];
      for (let i = 0; weight && i < vertices.length; i++) {
        for (let k = 0, at = vertices[i] * 3; k < 3; k++) points[at + k] += weight * offsets[i * 3 + k];
      }
    }
    this.geometry.place(points);
  }

  /** @param {number} sample */
  update(sample) {
    const { pose, palette, streams, record, geometry: { bind } } = this;
    this.hidden = record.visible != null && streams.at(record.visible, sample)?.[0] === 0 || pose?.visible === false;
    if (this.hidden) return;
    if (pose && palette) {
      const m = new Float32Array(16), cells = palette.values;
      record.skin?.palette.forEach((joint, j) => {
        multiply(m, 0, pose.world, joint * 16, bind, j * 16);
        for (let i = 0; i < 12; i++) cells[j * 16 + i] = m[(i % 4) * 4 + (i >> 2)];
        cells[j * 16 + 12] = pose.heat ? pose.heat[joint] : -1;
      });
      palette.send();
    }
    const track = pose?.record.shapes, weights = track && streams.at(track.weights, sample);
    if (weights && this.shapes.length) this.#shape(weights);
    const cached = record.cache == null ? null : streams.at(record.cache, sample);
    if (cached) {
      this.shown = cached;
      this.geometry.place(cached);
    }
  }

  /** Add where it is to a box: of skins some vertices, each with its first joint. @param {import('./maths.js').Box} box */
  bound(box) {
    const { pose, palette, shown, record: { skin }, geometry: { rest, joints, bind } } = this;
    if (this.instances || pose?.visible === false) return;
    if (!pose || !palette || !skin) {
      for (let i = 0; i < shown.length; i += 3) box.add(shown, i);
      return;
    }
    const m = new Float32Array(16), step = Math.ceil(rest.length / 3 / BOUNDS);
    for (let v = 0; v * 3 < rest.length; v += step) {
      const j = joints[v * 4];
      multiply(m, 0, pose.world, skin.palette[j] * 16, bind, j * 16);
      box.add(transform(m, [rest[v * 3], rest[v * 3 + 1], rest[v * 3 + 2]]), 0);
    }
  }

  /** @param {number} radius Of what is shown. @returns {boolean} Whether it is a ground, or a room around all, and casts no shadow. */
  surrounds(radius) {
    const { low, high } = this.geometry.box;
    return !this.pose && !this.instances && this.record.cache == null && (
      high[1] < FLAT * radius || Math.min(high[0] - low[0], high[2] - low[2]) > WIDE * radius);
  }

  /** @param {View} view @param {number} [instances] How many to draw, each where its buffer says. */
  draw(view, instances = 1) {
    if (this.hidden) return;
    const { gl, program, record, geometry: { array, faces, smooth } } = this;
    use(gl, program, view, {
      color: display(record.color ?? COLOR).map((x) => x / 255), shift: this.pose?.shift ?? [0, 0, 0],
      faceted: smooth ? 0 : 1, palette: this.palette });
    gl.bindVertexArray(array);
    gl.drawElementsInstanced(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0, instances);
  }
}
