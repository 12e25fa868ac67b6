/** Balls that face the view: particles, markers and joints. */

import { SHADE, attribute, makeBuffer, makeProgram, use } from './gl.js';

/** @typedef {import('./camera.js').Eye} View */
/** @typedef {import('./data.js').Streams} Streams */
/** @typedef {import('./types.js').PointsRecord} PointsRecord */

const VERTEX = `
layout(location=0) in vec3 point; layout(location=1) in vec3 color; layout(location=2) in float own;
uniform mat4 viewProjection; uniform float radius, least, perMetre;
out vec3 tint; out float fine;
void main() {
  gl_Position = viewProjection * vec4(point, 1.);
  gl_PointSize = max(least, 2. * (own > 0. ? own : radius) * perMetre / gl_Position.w);
  fine = gl_PointSize; tint = color;
}`;

const FRAGMENT = `${SHADE}
in vec3 tint; in float fine; uniform float opacity; out vec4 result;
void main() {
  vec2 p = gl_PointCoord * 2. - 1.; p.y = -p.y;
  float r = dot(p, p);
  if (r > 1. && fine > 2.5) discard;
  result = vec4(shade(tint, vec3(p, sqrt(max(0., 1. - r)))), opacity);
}`;

/** Where points without a position go: outside of every view. */
const FAR = 1e30;

export class Sprites {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.program = makeProgram(gl, VERTEX, FRAGMENT);
    this.array = gl.createVertexArray();
    this.positions = makeBuffer(gl);
    this.colors = makeBuffer(gl);
    gl.bindVertexArray(this.array);
    attribute(gl, 0, this.positions, 3);
    attribute(gl, 1, this.colors, 3, { type: gl.UNSIGNED_BYTE, normal: true });
    gl.bindVertexArray(null);
    this.count = 0;
  }

  /** Give each point its radius. @param {Float32Array<ArrayBuffer>} radii [m] */
  size(radii) {
    const { gl } = this;
    gl.bindVertexArray(this.array);
    attribute(gl, 2, makeBuffer(gl, radii), 1);
    gl.bindVertexArray(null);
  }

  /** @param {Float32Array<ArrayBuffer>} positions @param {Uint8Array<ArrayBuffer>} [colors] */
  set(positions, colors) {
    const { gl } = this;
    this.count = positions.length / 3;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.positions);
    gl.bufferData(gl.ARRAY_BUFFER, positions, gl.DYNAMIC_DRAW);
    if (!colors) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.colors);
    gl.bufferData(gl.ARRAY_BUFFER, colors, gl.DYNAMIC_DRAW);
  }

  /** @param {View} view @param {number} radius [m] @param {number} least Radius in pixels. */
  draw(view, radius, least) {
    if (!this.count) return;
    const { gl, program } = this;
    use(gl, program, view, { radius, least: least * 2 * view.ratio, perMetre: view.perMetre });
    gl.bindVertexArray(this.array);
    gl.drawArrays(gl.POINTS, 0, this.count);
  }
}

/** @param {number} count @param {number[]} color 0…255 @returns {Uint8Array<ArrayBuffer>} */
export function repeated(count, color) {
  const out = new Uint8Array(count * 3);
  for (let i = 0; i < out.length; i++) out[i] = color[i % 3];
  return out;
}

/** @param {number[]} color Linear, 0…1. @returns {number[]} As screens show it, 0…255. */
export const display = (color) => color.map((x) => Math.max(x, 0) ** (1 / 2.2) * 255);

/** Points of a system or of a capture. */
export class PointCloud {
  /** @param {WebGL2RenderingContext} gl @param {Streams} streams @param {PointsRecord} record */
  constructor(gl, streams, record) {
    this.streams = streams;
    this.record = record;
    this.sprites = new Sprites(gl);
    streams.use([record.positions]);
    this.count = Math.floor(streams.width(record.positions) / 3);
    this.tints = repeated(this.count, display(record.color ?? [0.7, 0.32, 0.05]));
    /** @type {Float32Array<ArrayBuffer>} */
    this.points = new Float32Array(0);
  }

  async load() {
    const { colors, radii } = this.record;
    if (colors != null) this.tints = new Uint8Array(await this.streams.whole(colors)).map((x) => display([x / 255])[0]);
    if (radii != null) this.sprites.size(new Float32Array(await this.streams.whole(radii)));
  }

  /** @param {number} sample */
  update(sample) {
    const values = this.streams.at(this.record.positions, sample);
    if (!values) return;
    const points = new Float32Array(values);
    for (let i = 0; i < points.length; i++) if (!Number.isFinite(points[i])) points[i] = FAR;
    this.points = points;
    this.sprites.set(points, this.tints);
  }

  /** @param {View} view */
  draw(view) { this.sprites.draw(view, this.record.radius ?? 0, 2); }
}
