/** Skeletons: bones as octahedra, joints as balls, and the axes of joints. */

import { CELL, SHADE, Table, attribute, drawTable, makeBuffer, makeProgram, use } from './gl.js';
import { Lines } from './lines.js';
import { Sprites } from './points.js';
import { sub, unit } from './maths.js';

/** @typedef {import('./camera.js').Eye} View */
/** @typedef {import('./skeleton.js').Pose} Pose */

const VERTEX = `${CELL}
uniform sampler2D bones; uniform mat4 viewProjection, view; uniform float thickest;
out vec3 n; out vec3 tint;
const vec2 RING[4] = vec2[](vec2(1, 0), vec2(0, 1), vec2(-1, 0), vec2(0, -1));
// Corners of an octahedron along Y, its waist at .14: four faces below, four above.
vec3 corner(int face, int k) {
  if (k == 0) return vec3(0, face / 4, 0);
  vec2 at = RING[(face + (face < 4 ? k + 3 : 6 - k)) % 4];
  return vec3(at.x, .14, at.y);
}
void main() {
  int at = gl_VertexID / 24 * 3, face = gl_VertexID % 24 / 3;
  vec3 head = cell(bones, at).xyz, tail = cell(bones, at + 1).xyz;
  vec3 point = corner(face, gl_VertexID % 3), first = corner(face, 0);
  vec3 normal = cross(corner(face, 1) - first, corner(face, 2) - first);
  vec3 along = tail - head;
  float len = length(along), wide = min(len * .11, thickest);
  vec3 y = along / len, x = normalize(cross(abs(y.x) < .8 ? vec3(1, 0, 0) : vec3(0, 0, 1), y)), z = cross(x, y);
  vec3 p = head + x * point.x * wide + along * point.y + z * point.z * wide;
  n = mat3(view) * normalize(x * normal.x / wide + y * normal.y / len + z * normal.z / wide);
  tint = cell(bones, at + 2).rgb;
  gl_Position = viewProjection * vec4(p, 1.);
}`;

const FRAGMENT = `${SHADE}
in vec3 n; in vec3 tint; uniform float opacity; out vec4 result;
void main() { result = vec4(shade(tint, normalize(n)), opacity); }`;

const THIN_VERTEX = `
layout(location=0) in vec3 point; layout(location=1) in vec3 color; uniform mat4 viewProjection; out vec3 tint;
void main() { gl_Position = viewProjection * vec4(point, 1.); tint = color; }`;

const THIN_FRAGMENT = 'in vec3 tint; uniform float opacity; out vec4 result; void main() { result = vec4(tint, opacity); }';

/** Most joints that are drawn with thick bones: those of a crowd are lines. */
const THICK = 1500;

/** @param {number} h 0…1 @returns {number[]} From calm blue over yellow to red, 0…255. */
export function heatColor(h) {
  const stops = [[41, 115, 184], [237, 209, 107], [204, 46, 41]];
  const i = h < 0.5 ? 0 : 1, f = h * 2 - i;
  return stops[i].map((x, k) => x + (stops[i + 1][k] - x) * f);
}

export class Bones {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.program = makeProgram(gl, VERTEX, FRAGMENT);
    this.table = new Table(gl);
    this.balls = new Sprites(gl);
    this.axes = new Lines(gl);
    this.thin = makeProgram(gl, THIN_VERTEX, THIN_FRAGMENT);
    this.array = gl.createVertexArray();
    this.ends = makeBuffer(gl);
    gl.bindVertexArray(this.array);
    for (const i of [0, 1]) attribute(gl, i, this.ends, 3, { stride: 24, offset: i * 12 });
  }

  /**
   * Draw the skeletons of takes.
   *
   * @param {View} view @param {Pose[]} poses @param {(take: number) => number[]} color
   * @param {{take: number, joint: number}|null} selected @param {number[]} accent
   * @param {{bones: boolean, axes: boolean}} show
   */
  draw(view, poses, color, selected, accent, show) {
    if (show.bones && poses.reduce((sum, { count }) => sum + count, 0) > THICK) {
      this.#lines(view, poses, color, selected, accent);
      return;
    }
    /** @type {number[]} */
    const bones = [], balls = [];
    /** @type {number[]} */
    const tints = [];
    let size = 0;
    for (const pose of poses) {
      const plain = color(pose.index), thin = pose.extent * 1e-4;
      size = Math.max(size, pose.extent);
      const tint = (/** @type {number} */ j) => (
        selected?.take === pose.index && selected.joint === j ? accent : pose.heat ? heatColor(pose.heat[j]) : plain);
      const bone = (/** @type {number} */ j, /** @type {number[]} */ end) => {
        const head = pose.position(j);
        if (Math.hypot(...sub(end, head)) > thin) bones.push(...head, 0, ...end, 0, ...tint(j).map((x) => x / 255), 0);
      };
      for (let j = 0; j < pose.count; j++) {
        const at = pose.position(j);
        balls.push(...at);
        tints.push(...tint(j));
        if (pose.parents[j] >= 0) bone(pose.parents[j], at);
      }
      for (const tip of pose.tips) bone(tip[0], pose.tip(tip));
      if (show.axes) this.#axes(pose);
    }
    if (show.bones && bones.length) this.#octahedra(view, bones, size);
    if (show.bones && balls.length) {
      this.balls.set(new Float32Array(balls), new Uint8Array(tints));
      this.balls.draw(view, size * 0.008, 2.5);
    }
    this.axes.flush();
    this.axes.draw(view, { width: 1.5 });
  }

  /**
   * Draw many skeletons as thin lines.
   *
   * @param {View} view @param {Pose[]} poses @param {(take: number) => number[]} color
   * @param {{take: number}|null} selected @param {number[]} accent
   */
  #lines(view, poses, color, selected, accent) {
    const { gl, thin } = this, values = new Float32Array(12 * poses.reduce((sum, { count }) => sum + count, 0));
    let at = 0;
    for (const { index, parents, world, count } of poses) {
      const tint = (index === selected?.take ? accent : color(index)).map((x) => x / 255);
      for (let j = 0; j < count; j++) {
        for (const end of parents[j] < 0 ? [] : [j, parents[j]]) {
          for (let k = 0; k < 3; k++, at++) {
            values[at] = world[end * 16 + 12 + k];
            values[at + 3] = tint[k];
          }
          at += 3;
        }
      }
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.ends);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STREAM_DRAW);
    use(gl, thin, view, {});
    gl.bindVertexArray(this.array);
    gl.drawArrays(gl.LINES, 0, at / 6);
  }

  /** @param {View} view @param {number[]} bones Three cells each. @param {number} size */
  #octahedra(view, bones, size) {
    const { gl, program, table } = this;
    table.grow(bones.length / 4);
    table.values.set(bones);
    table.send(bones.length / 4);
    use(gl, program, view, { bones: table, thickest: size * 0.03 });
    drawTable(gl, bones.length * 2);
  }

  /** Add the axes of each joint, red, green and blue. @param {Pose} pose */
  #axes(pose) {
    const length = pose.extent * 0.06, { world } = pose;
    const colors = [[222, 82, 82], [92, 176, 88], [76, 130, 224]];
    for (let j = 0; j < pose.count; j++) {
      const at = pose.position(j);
      for (let k = 0; k < 3; k++) {
        const axis = unit([0, 1, 2].map((i) => world[j * 16 + k * 4 + i]));
        this.axes.add(at, at.map((x, i) => x + axis[i] * length), colors[k]);
      }
    }
  }
}
