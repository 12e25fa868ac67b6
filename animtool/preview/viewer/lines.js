/** Lines of any width on the screen or in the world, a segment an instance. */

import { attribute, makeBuffer, makeProgram } from './gl.js';

/** @typedef {import('./camera.js').View} View */
/** @typedef {{width?: number, world?: number, fade?: number[]|null, alpha?: number}} Look */

const VERTEX = `
layout(location=0) in vec2 corner; layout(location=1) in vec3 a; layout(location=2) in vec3 b;
layout(location=3) in vec4 color;
uniform mat4 viewProjection; uniform vec2 size; uniform float width, world, perMetre;
out vec4 tint; out vec3 where;
void main() {
  vec4 p = viewProjection * vec4(a, 1.), q = viewProjection * vec4(b, 1.);
  const float near = 1e-2;
  tint = color;
  vec3 from = a, to = b;
  if (p.w < near && q.w < near) { gl_Position = vec4(2., 2., 2., 1.); return; }
  if (p.w < near) { float t = (q.w - near) / (q.w - p.w); p = mix(q, p, t); from = mix(to, from, t); }
  if (q.w < near) { float t = (p.w - near) / (p.w - q.w); q = mix(p, q, t); to = mix(from, to, t); }
  where = mix(from, to, corner.x);
  vec2 along = (q.xy / q.w - p.xy / p.w) * size;
  along = dot(along, along) > 1e-12 ? normalize(along) : vec2(1., 0.);
  gl_Position = mix(p, q, corner.x);
  float wide = max(width, world * perMetre / gl_Position.w);
  gl_Position.xy += vec2(-along.y, along.x) / size * wide * corner.y * gl_Position.w;
}`;

const FRAGMENT = `
in vec4 tint; in vec3 where; uniform vec4 fade; uniform float alpha; out vec4 result;
void main() {
  float away = fade.w > 0. ? 1. - smoothstep(.25, 1., distance(where, fade.xyz) / fade.w) : 1.;
  result = vec4(tint.rgb, tint.a * away * alpha);
}`;

/** @type {WeakMap<WebGL2RenderingContext, {program: import('./gl.js').Program, corners: WebGLBuffer}>} */
const shared = new WeakMap();

/** Segments that are drawn together. */
export class Lines {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    const made = shared.get(gl) ?? {
      program: makeProgram(gl, VERTEX, FRAGMENT),
      corners: makeBuffer(gl, new Float32Array([0, -1, 1, -1, 0, 1, 1, 1])),
    };
    shared.set(gl, made);
    this.program = made.program;
    this.array = gl.createVertexArray();
    this.ends = makeBuffer(gl);
    this.colors = makeBuffer(gl);
    gl.bindVertexArray(this.array);
    attribute(gl, 0, made.corners, 2);
    attribute(gl, 1, this.ends, 3, { stride: 24, each: 1 });
    attribute(gl, 2, this.ends, 3, { stride: 24, offset: 12, each: 1 });
    attribute(gl, 3, this.colors, 4, { type: gl.UNSIGNED_BYTE, normal: true, each: 1 });
    gl.bindVertexArray(null);
    this.count = 0;
    /** @type {number[]} */
    this.points = [];
    /** @type {number[]} */
    this.tints = [];
  }

  /** Add a segment to those of the next `flush`. @param {ArrayLike<number>} a @param {ArrayLike<number>} b @param {number[]} color 0…255, with alpha. */
  add(a, b, color) {
    this.points.push(a[0], a[1], a[2], b[0], b[1], b[2]);
    this.tints.push(color[0], color[1], color[2], color[3] ?? 255);
  }

  /** Draw what was added from now on. */
  flush() {
    this.set(new Float32Array(this.points), new Uint8Array(this.tints));
    this.points.length = this.tints.length = 0;
  }

  /** @param {Float32Array<ArrayBuffer>} ends Six numbers a segment. @param {Uint8Array<ArrayBuffer>} [colors] Four each; without them the last ones stay. */
  set(ends, colors) {
    const { gl } = this;
    this.count = ends.length / 6;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.ends);
    gl.bufferData(gl.ARRAY_BUFFER, ends, gl.DYNAMIC_DRAW);
    if (!colors) return;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.colors);
    gl.bufferData(gl.ARRAY_BUFFER, colors, gl.DYNAMIC_DRAW);
  }

  /** @param {View} view @param {Look} [look] Widths in pixels and in metres, fade around a point. */
  draw(view, { width = 1.5, world = 0, fade = null, alpha = 1 } = {}) {
    if (!this.count) return;
    const { gl, program } = this;
    gl.useProgram(program.program);
    gl.uniformMatrix4fv(program.at('viewProjection'), false, view.viewProjection);
    gl.uniform2f(program.at('size'), view.width, view.height);
    gl.uniform1f(program.at('width'), width * view.ratio);
    gl.uniform1f(program.at('world'), world);
    gl.uniform1f(program.at('perMetre'), view.perMetre);
    gl.uniform4fv(program.at('fade'), fade ?? [0, 0, 0, 0]);
    gl.uniform1f(program.at('alpha'), alpha);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
  }
}
