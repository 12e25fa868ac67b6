/** Skeletons: bones as octahedra, joints as balls, and the axes of joints. */

import { SHADE, attribute, makeBuffer, makeProgram } from './gl.js';
import { Lines } from './lines.js';
import { Sprites } from './points.js';
import { cross, sub, unit } from './maths.js';

/** @typedef {import('./camera.js').View} View */
/** @typedef {import('./skeleton.js').Pose} Pose */

const VERTEX = `
layout(location=0) in vec3 point; layout(location=1) in vec3 normal;
layout(location=2) in vec3 head; layout(location=3) in vec3 tail; layout(location=4) in vec4 color;
uniform mat4 viewProjection, view; uniform float thickest;
out vec3 n; out vec3 tint;
void main() {
  vec3 along = tail - head;
  float len = length(along), wide = min(len * .11, thickest);
  vec3 y = along / len, x = normalize(cross(abs(y.x) < .8 ? vec3(1, 0, 0) : vec3(0, 0, 1), y)), z = cross(x, y);
  vec3 p = head + x * point.x * wide + along * point.y + z * point.z * wide;
  n = mat3(view) * normalize(x * normal.x / wide + y * normal.y / len + z * normal.z / wide);
  tint = color.rgb;
  gl_Position = viewProjection * vec4(p, 1.);
}`;

const FRAGMENT = `${SHADE}
in vec3 n; in vec3 tint; out vec4 result;
void main() { result = vec4(shade(tint, normalize(n)), 1.); }`;

/** @returns {Float32Array<ArrayBuffer>} Corners and normals of an octahedron along Y, its waist at .14. */
function octahedron() {
  const ring = [[1, 0.14, 0], [0, 0.14, 1], [-1, 0.14, 0], [0, 0.14, -1]];
  const out = [];
  for (let i = 0; i < 4; i++) {
    const a = ring[i], b = ring[(i + 1) % 4];
    for (const [p, q, s] of [[[0, 0, 0], a, b], [[0, 1, 0], b, a]]) {
      const n = unit(cross(sub(q, p), sub(s, p)));
      for (const corner of [p, q, s]) out.push(...corner, ...n);
    }
  }
  return new Float32Array(out);
}

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
    this.array = gl.createVertexArray();
    const shape = makeBuffer(gl, octahedron());
    this.ends = makeBuffer(gl);
    this.colors = makeBuffer(gl);
    gl.bindVertexArray(this.array);
    attribute(gl, 0, shape, 3, { stride: 24 });
    attribute(gl, 1, shape, 3, { stride: 24, offset: 12 });
    attribute(gl, 2, this.ends, 3, { stride: 24, each: 1 });
    attribute(gl, 3, this.ends, 3, { stride: 24, offset: 12, each: 1 });
    attribute(gl, 4, this.colors, 4, { type: gl.UNSIGNED_BYTE, normal: true, each: 1 });
    gl.bindVertexArray(null);
    this.balls = new Sprites(gl);
    this.axes = new Lines(gl);
  }

  /**
   * Draw the skeletons of takes.
   *
   * @param {View} view @param {Pose[]} poses @param {(take: number) => number[]} color
   * @param {{take: number, joint: number}|null} selected @param {number[]} accent
   * @param {{bones: boolean, axes: boolean}} show
   */
  draw(view, poses, color, selected, accent, show) {
    /** @type {number[]} */
    const ends = [], colors = [];
    /** @type {number[]} */
    const balls = [], tints = [];
    let size = 0;
    for (const pose of poses) {
      const [r, g, b] = color(pose.index), thin = pose.extent * 1e-4;
      size = Math.max(size, pose.extent);
      for (let j = 0; j < pose.count; j++) {
        const own = selected?.take === pose.index && selected.joint === j;
        const tint = own ? accent : pose.heat ? heatColor(pose.heat[j]) : [r, g, b];
        const at = pose.position(j), up = pose.parents[j];
        balls.push(...at);
        tints.push(...tint);
        if (up < 0) continue;
        const from = pose.position(up);
        if (Math.hypot(...sub(at, from)) < thin) continue;
        ends.push(...from, ...at);
        const held = selected?.take === pose.index && selected.joint === up;
        colors.push(...(held ? accent : pose.heat ? heatColor(pose.heat[up]) : [r, g, b]), 255);
      }
      for (const tip of pose.tips) {
        const from = pose.position(tip[0]), at = pose.tip(tip), own = selected?.take === pose.index && selected.joint === tip[0];
        if (Math.hypot(...sub(at, from)) < thin) continue;
        ends.push(...from, ...at);
        colors.push(...(own ? accent : pose.heat ? heatColor(pose.heat[tip[0]]) : [r, g, b]), 255);
      }
      if (show.axes) this.#axes(pose);
    }
    if (show.bones && ends.length) this.#octahedra(view, ends, colors, size);
    if (show.bones && balls.length) {
      this.balls.set(new Float32Array(balls), new Uint8Array(tints));
      this.balls.draw(view, size * 0.008, 2.5);
    }
    this.axes.flush();
    this.axes.draw(view, { width: 1.5 });
  }

  /** @param {View} view @param {number[]} ends @param {number[]} colors @param {number} size */
  #octahedra(view, ends, colors, size) {
    const { gl, program } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.ends);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(ends), gl.DYNAMIC_DRAW);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.colors);
    gl.bufferData(gl.ARRAY_BUFFER, new Uint8Array(colors), gl.DYNAMIC_DRAW);
    gl.useProgram(program.program);
    gl.uniformMatrix4fv(program.at('viewProjection'), false, view.viewProjection);
    gl.uniformMatrix4fv(program.at('view'), false, view.view);
    gl.uniform1f(program.at('thickest'), size * 0.03);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLES, 0, 24, ends.length / 6);
  }

  /** Add the axes of each joint, red, green and blue. @param {Pose} pose */
  #axes(pose) {
    const length = pose.extent * 0.035, { world } = pose;
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
