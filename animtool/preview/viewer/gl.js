/** WebGL2: programs, buffers and the shading that all surfaces share. */

/** @typedef {{bind: (slot: number, where: WebGLUniformLocation|null) => void}} Sampled What samplers read. */
/** @typedef {{program: WebGLProgram, at: (name: string) => WebGLUniformLocation|null}} Program */

const HEAD = '#version 300 es\nprecision highp float;\nprecision highp int;\nprecision highp sampler2D;\n';

/** Shade of a surface: a soft key light that goes along with the view, a sky and a rim. */
export const SHADE = `
uniform vec3 light;
vec3 shade(vec3 color, vec3 n) {
  float key = max(dot(n, light), 0.);
  float sky = .5 + .5 * n.y;
  return color * (.55 + .14 * sky + .44 * key) + pow(1. - abs(n.z), 4.) * .05;
}
vec3 heatColor(float h) {
  return h < .5 ? mix(vec3(.16, .45, .72), vec3(.93, .82, .42), h * 2.)
    : mix(vec3(.93, .82, .42), vec3(.80, .18, .16), h * 2. - 1.);
}`;

/** @type {Map<string, Program>} */
const programs = new Map();

/**
 * @param {WebGL2RenderingContext} gl @param {string} vertex @param {string} fragment
 * @returns {Program} One for each text.
 */
export function makeProgram(gl, vertex, fragment) {
  const made = programs.get(vertex + fragment) ?? compiled(gl, vertex, fragment);
  programs.set(vertex + fragment, made);
  return made;
}

/** @param {WebGL2RenderingContext} gl @param {string} vertex @param {string} fragment @returns {Program} */
function compiled(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [type, text] of /** @type {[number, string][]} */ ([
    [gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
    const shader = gl.createShader(type);
    if (!shader) throw new Error('WebGL has lost its context');
    gl.shaderSource(shader, HEAD + text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    const logs = (gl.getAttachedShaders(program) ?? []).map((each) => gl.getShaderInfoLog(each));
    throw new Error(`shader: ${logs.join(' ') || gl.getProgramInfoLog(program)}`);
  }
  /** @type {Map<string, WebGLUniformLocation|null>} */
  const known = new Map();
  return {
    program,
    at: (name) => {
      if (!known.has(name)) known.set(name, gl.getUniformLocation(program, name));
      return known.get(name) ?? null;
    },
  };
}

/**
 * Bind an attribute of a program to a buffer.
 *
 * @param {WebGL2RenderingContext} gl @param {number} index @param {WebGLBuffer} buffer
 * @param {number} size @param {{type?: number, normal?: boolean, stride?: number,
 *   offset?: number, each?: number, whole?: boolean}} [options] `each` 1: by instance.
 */
export function attribute(gl, index, buffer, size, options = {}) {
  const { type = gl.FLOAT, normal = false, stride = 0, offset = 0, each = 0, whole } = options;
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.enableVertexAttribArray(index);
  if (whole) gl.vertexAttribIPointer(index, size, type, stride, offset);
  else gl.vertexAttribPointer(index, size, type, normal, stride, offset);
  gl.vertexAttribDivisor(index, each);
}

/**
 * @param {WebGL2RenderingContext} gl @param {AllowSharedBufferSource} [data] @param {number} [target]
 * @returns {WebGLBuffer}
 */
export function makeBuffer(gl, data, target = gl.ARRAY_BUFFER) {
  const buffer = gl.createBuffer();
  gl.bindBuffer(target, buffer);
  if (data) gl.bufferData(target, data, gl.STATIC_DRAW);
  return buffer;
}

/** A table of four numbers a cell that vertex shaders read. */
export class Table {
  /** @param {WebGL2RenderingContext} gl @param {number} [cells] */
  constructor(gl, cells = 0) {
    this.gl = gl;
    this.values = new Float32Array(0);
    this.wide = this.high = 0;
    /** @type {WebGLTexture|null} */
    this.texture = null;
    this.grow(cells);
  }

  /** Make room; what it held is lost where there was not enough. @param {number} cells */
  grow(cells) {
    const { gl } = this;
    if (this.texture && cells * 4 <= this.values.length) return;
    this.wide = Math.min(1024, Math.max(cells, 64));
    this.high = Math.max(Math.ceil(cells / this.wide), 1);
    this.values = new Float32Array(this.wide * this.high * 4);
    gl.deleteTexture(this.texture);
    this.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, this.wide, this.high);
  }

  /** Give the first values to the graphics processor. @param {number} [cells] */
  send(cells = this.values.length / 4) {
    const { gl } = this, rows = Math.ceil(cells / this.wide);
    if (!rows) return;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, this.wide, rows, gl.RGBA, gl.FLOAT, this.values);
  }

  /** @param {number} slot Unit of textures. @param {WebGLUniformLocation|null} where */
  bind(slot, where) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + slot);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.uniform1i(where, slot);
    gl.activeTexture(gl.TEXTURE0);
  }
}

/**
 * Draw with a program from now on.
 *
 * @param {WebGL2RenderingContext} gl @param {Program} program @param {import('./camera.js').Eye} view
 * @param {Record<string, number|ArrayLike<number>|Sampled|undefined>} uniforms
 */
export function use(gl, { program, at }, view, uniforms) {
  gl.useProgram(program);
  gl.uniformMatrix4fv(at('viewProjection'), false, view.viewProjection);
  gl.uniformMatrix4fv(at('view'), false, view.view);
  gl.uniform3fv(at('light'), view.light);
  gl.uniform1f(at('opacity'), view.opacity);
  for (const [name, value] of Object.entries(uniforms)) {
    if (typeof value === 'number') gl.uniform1f(at(name), value);
    else if (value && 'bind' in value) value.bind(0, at(name));
    else if (value) gl[value.length === 2 ? 'uniform2fv' : value.length === 3 ? 'uniform3fv' : 'uniform4fv'](at(name), Array.from(value));
  }
}

/**
 * Draw triangles whose corners a vertex shader finds in a table.
 *
 * Drawing instances would be the plain way, but software takes each for a drawing.
 *
 * @param {WebGL2RenderingContext} gl @param {number} corners
 */
export function drawTable(gl, corners) {
  gl.bindVertexArray(null);
  gl.drawArrays(gl.TRIANGLES, 0, corners);
}

/** What is drawn into: the canvas, through a picture with smooth edges where it is to be fine. */
export class Picture {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.frame = gl.createFramebuffer();
    this.parts = [gl.RGB8, gl.DEPTH_COMPONENT24].map((format) => ({ format, buffer: gl.createRenderbuffer() }));
    this.size = '';
  }

  /** @param {number} width @param {number} height @param {boolean} fine */
  begin(width, height, fine) {
    const { gl } = this, size = `${width} ${height}`;
    gl.bindFramebuffer(gl.FRAMEBUFFER, fine ? this.frame : null);
    if (fine && size !== this.size) {
      this.size = size;
      this.parts.forEach(({ format, buffer }, i) => {
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        gl.renderbufferStorageMultisample(gl.RENDERBUFFER, 4, format, width, height);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, [gl.COLOR_ATTACHMENT0, gl.DEPTH_ATTACHMENT][i], gl.RENDERBUFFER, buffer);
      });
    }
    gl.viewport(0, 0, width, height);
  }

  /** @param {number} width @param {number} height @param {boolean} fine */
  end(width, height, fine) {
    const { gl } = this;
    if (!fine) return;
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.invalidateFramebuffer(gl.READ_FRAMEBUFFER, [gl.COLOR_ATTACHMENT0, gl.DEPTH_ATTACHMENT]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }
}

/** GLSL: cell `i` of a table. */
export const CELL = `
vec4 cell(sampler2D table, int i) { int w = textureSize(table, 0).x; return texelFetch(table, ivec2(i % w, i / w), 0); }`;
