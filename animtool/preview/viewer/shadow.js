/** The contact shadow: what is near above the ground darkens it. */

import { makeProgram, use } from './gl.js';

/** @typedef {import('./camera.js').Eye} Eye */
/** @typedef {import('./camera.js').View} View */

/** Texels of the map to a side. */
const SIZE = 512;
/** Half of its width and what still darkens the ground, as parts of the radius of what is shown. */
const WIDE = 1.1, HIGH = 0.35;
/** What is so far below the ground is cast too, as a part of the height. */
const DEEP = 2e-3;
/** Where so much of what is shown is below the ground there is none, as a part of the radius. */
const SUNK = 0.2;

const SCREEN_VERTEX = `
out vec2 at;
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3. : -1., gl_VertexID == 2 ? 3. : -1.);
  at = corner * .5 + .5;
  gl_Position = vec4(corner, 0., 1.);
}`;

// From heights, which depths seen from below are, to darkness at first.
const BLUR_FRAGMENT = `
in vec2 at; uniform sampler2D source; uniform vec2 reach; uniform float heights; out vec4 result;
float dark(vec2 p) { float x = texture(source, p).r; return heights > 0. ? (1. - x) * (1. - x) : x; }
void main() {
  float sum = 0., total = 0.;
  for (int k = -7; k <= 7; k++) {
    float weight = exp(-float(k * k) / 16.);
    sum += weight * dark(at + reach * float(k)); total += weight;
  }
  result = vec4(sum / total, 0., 0., 1.);
}`;

// Corners of a square on the ground, a little in front of what lies there.
const GROUND_VERTEX = `
uniform mat4 viewProjection; uniform vec3 area; out vec2 at;
void main() {
  vec2 corner = vec2(gl_VertexID % 2, gl_VertexID / 2);
  at = corner;
  corner = area.xy + (corner * 2. - 1.) * area.z;
  gl_Position = viewProjection * vec4(corner.x, 0., corner.y, 1.);
  gl_Position.z -= 1e-5 * gl_Position.w;
}`;

const GROUND_FRAGMENT = `
in vec2 at; uniform sampler2D map; out vec4 result;
void main() {
  vec2 side = abs(at * 2. - 1.);
  float edge = 1. - smoothstep(.85, 1., max(side.x, side.y));
  result = vec4(.05, .06, .09, .55 * edge * texture(map, at).r);
}`;

/** A texture as uniforms take it. */
class Layer {
  /** @param {WebGL2RenderingContext} gl @param {number} format @param {number} filter */
  constructor(gl, format, filter) {
    this.gl = gl;
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, SIZE, SIZE);
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, name, value);
    this.frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    const place = format === gl.R8 ? gl.COLOR_ATTACHMENT0 : gl.DEPTH_ATTACHMENT;
    gl.framebufferTexture2D(gl.FRAMEBUFFER, place, gl.TEXTURE_2D, this.texture, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  /** @param {number} slot Unit of textures. @param {WebGLUniformLocation|null} where */
  bind(slot, where) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + slot);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.uniform1i(where, slot);
  }
}

export class Shadow {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.blur = makeProgram(gl, SCREEN_VERTEX, BLUR_FRAGMENT);
    this.ground = makeProgram(gl, GROUND_VERTEX, GROUND_FRAGMENT);
    this.heights = new Layer(gl, gl.DEPTH_COMPONENT24, gl.NEAREST);
    this.maps = [0, 1].map(() => new Layer(gl, gl.R8, gl.LINEAR));
    this.key = '';
    /** Whether what casts it moved. */
    this.stale = true;
  }

  /**
   * Make the map around what the camera looks at, where it is another than before.
   *
   * @param {View} view @param {(eye: Eye) => void} draw What casts the shadow.
   * @returns {boolean} Whether there is a shadow.
   */
  cast(view, draw) {
    const { gl } = this, half = view.radius * WIDE, texel = 2 * half / SIZE;
    if (view.floor < -SUNK * view.radius) return false;
    // On whole texels, so that edges do not flicker while the camera goes along.
    const [x, z] = [view.target[0], view.target[2]].map((c) => Math.round(c / texel) * texel);
    const key = [x, z, half].join();
    this.area = [x, z, half];
    if (!this.stale && key === this.key) return true;
    this.key = key;
    this.stale = false;
    gl.viewport(0, 0, SIZE, SIZE);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.heights.frame);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.depthMask(true);
    gl.depthRange(0, 1);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    draw(this.#below(view, x, z, half));
    gl.disable(gl.DEPTH_TEST);
    gl.bindVertexArray(null);
    const reach = 1.5 / SIZE, [across, along] = this.maps;
    this.#pass(view, across, this.heights, [reach, 0], 1);
    this.#pass(view, along, across, [0, reach], 0);
    return true;
  }

  /** @param {View} view @param {Layer} into @param {Layer} source @param {number[]} reach @param {number} heights */
  #pass(view, into, source, reach, heights) {
    const { gl, blur } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, into.frame);
    use(gl, blur, view, { source, reach, heights });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** @param {View} view @param {number} x @param {number} z @param {number} half @returns {Eye} Looks up from the ground. */
  #below({ radius, light }, x, z, half) {
    const high = HIGH * radius, low = -DEEP * high, k = 2 / (high - low);
    return {
      view: new Float32Array([1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, -x, -z, 0, 1]),
      viewProjection: new Float32Array([
        1 / half, 0, 0, 0, 0, 0, k, 0, 0, 1 / half, 0, 0, -x / half, -z / half, -1 - low * k, 1]),
      width: SIZE, height: SIZE, ratio: 1, perMetre: SIZE / (2 * half), light, opacity: 1,
    };
  }

  /** Darken the ground. @param {View} view */
  draw(view) {
    const { gl, ground, area, maps: [, map] } = this;
    gl.bindVertexArray(null);
    use(gl, ground, view, { area, map });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
}
