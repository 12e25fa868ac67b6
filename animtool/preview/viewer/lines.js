/** Lines of any width on the screen or in the world. */

import { CELL, Table, drawTable, makeProgram, use } from './gl.js';

/** @typedef {import('./camera.js').Eye} View */
/** @typedef {{width?: number, world?: number, fade?: number[]|null}} Look */

/** Cells of a segment: its ends and its colour. */
const CELLS = 3;

const VERTEX = `${CELL}
uniform sampler2D segments; uniform mat4 viewProjection; uniform vec2 size; uniform float width, world, perMetre;
out vec4 tint; out vec3 where;
const vec2 CORNERS[6] = vec2[](vec2(0, -1), vec2(1, -1), vec2(0, 1), vec2(0, 1), vec2(1, -1), vec2(1, 1));
void main() {
  vec2 corner = CORNERS[gl_VertexID % 6];
  int at = gl_VertexID / 6 * 3;
  vec3 a = cell(segments, at).xyz, b = cell(segments, at + 1).xyz;
  vec4 p = viewProjection * vec4(a, 1.), q = viewProjection * vec4(b, 1.);
  const float near = 1e-2;
  tint = cell(segments, at + 2);
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
in vec4 tint; in vec3 where; uniform vec4 fade; uniform float opacity; out vec4 result;
void main() {
  float away = fade.w > 0. ? 1. - smoothstep(.25, 1., distance(where, fade.xyz) / fade.w) : 1.;
  result = vec4(tint.rgb, tint.a * away * opacity);
}`;

/** Segments that are drawn together. */
export class Lines {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.program = makeProgram(gl, VERTEX, FRAGMENT);
    this.table = new Table(gl);
    this.count = 0;
    /** @type {number[]} */
    this.added = [];
  }

  /** Add a segment to those of the next `flush`. @param {ArrayLike<number>} a @param {ArrayLike<number>} b @param {number[]} color 0…255, with alpha. */
  add(a, b, color) {
    this.added.push(a[0], a[1], a[2], 0, b[0], b[1], b[2], 0,
      color[0] / 255, color[1] / 255, color[2] / 255, (color[3] ?? 255) / 255);
  }

  /** Draw what was added from now on. */
  flush() {
    const cells = this.added.length / 4;
    this.count = cells / CELLS;
    this.table.grow(cells);
    this.table.values.set(this.added);
    this.table.send(cells);
    this.added.length = 0;
  }

  /**
   * Draw polylines from now on.
   *
   * @param {number} count @param {ArrayLike<number>} points @param {number[]} heads Points
   *   that begin a segment; the next one ends it. @param {number[]} color 0…255.
   */
  set(count, points, heads, color) {
    const { table } = this, [r, g, b] = color.map((x) => x / 255);
    this.count = count;
    table.grow(count * CELLS);
    const { values } = table;
    for (let i = 0, at = 0; i < count; i++, at += 12) {
      const from = heads[i] * 3;
      for (let k = 0; k < 3; k++) {
        values[at + k] = points[from + k];
        values[at + 4 + k] = points[from + 3 + k];
      }
      values[at + 8] = r; values[at + 9] = g; values[at + 10] = b; values[at + 11] = 1;
    }
    table.send(count * CELLS);
  }

  /** @param {View} view @param {Look} [look] Widths in pixels and in metres, fade around a point. */
  draw(view, { width = 1.5, world = 0, fade = null } = {}) {
    if (!this.count) return;
    use(this.gl, this.program, view, {
      size: [view.width, view.height], width: width * view.ratio, world, perMetre: view.perMetre,
      fade: fade ?? [0, 0, 0, 0], segments: this.table });
    drawTable(this.gl, this.count * 6);
  }
}
