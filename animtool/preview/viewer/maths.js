/** Vectors, quaternions and 4×4 matrices, column by column, in flat arrays. */

/** @typedef {import('./types.js').Vec} Vec */
/** @typedef {Vec|import('./data.js').Values} Numbers */

/** @returns {Float32Array} */
export const identity = () => new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

/** @param {Numbers} a @param {Numbers} b @returns {Vec} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];

/** @param {Numbers} a @param {Numbers} b @returns {Vec} */
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];

/** @param {Numbers} a @param {Numbers} b @returns {Vec} */
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** @param {Vec} a @returns {Vec} */
export const unit = (a) => {
  const length = Math.hypot(...a) || 1;
  return a.map((x) => x / length);
};

/** @param {number} x @param {number} low @param {number} high */
export const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

/**
 * Write T·R·S to `out`, its 16 numbers from `at`.
 *
 * @param {Float32Array} out @param {number} at
 * @param {Numbers} t @param {number} ti Where the translation begins.
 * @param {Numbers} r @param {number} ri Where the quaternion begins; of any length.
 * @param {Numbers|null} s @param {number} si
 */
export function compose(out, at, t, ti, r, ri, s, si) {
  let x = r[ri], y = r[ri + 1], z = r[ri + 2], w = r[ri + 3];
  const n = 1 / (Math.sqrt(x * x + y * y + z * z + w * w) || 1);
  x *= n; y *= n; z *= n; w *= n;
  const a = s ? s[si] : 1, b = s ? s[si + 1] : 1, c = s ? s[si + 2] : 1;
  out[at] = (1 - 2 * (y * y + z * z)) * a;
  out[at + 1] = 2 * (x * y + z * w) * a;
  out[at + 2] = 2 * (x * z - y * w) * a;
  out[at + 3] = 0;
  out[at + 4] = 2 * (x * y - z * w) * b;
  out[at + 5] = (1 - 2 * (x * x + z * z)) * b;
  out[at + 6] = 2 * (y * z + x * w) * b;
  out[at + 7] = 0;
  out[at + 8] = 2 * (x * z + y * w) * c;
  out[at + 9] = 2 * (y * z - x * w) * c;
  out[at + 10] = (1 - 2 * (x * x + y * y)) * c;
  out[at + 11] = 0;
  out[at + 12] = t[ti]; out[at + 13] = t[ti + 1]; out[at + 14] = t[ti + 2]; out[at + 15] = 1;
}

/**
 * Write a·b to `out`, which may be `b` at the same position.
 *
 * @param {Float32Array} out @param {number} at @param {Numbers} a @param {number} ai
 * @param {Numbers} b @param {number} bi
 */
export function multiply(out, at, a, ai, b, bi) {
  for (let c = 0; c < 16; c += 4) {
    const x = b[bi + c], y = b[bi + c + 1], z = b[bi + c + 2], w = b[bi + c + 3];
    for (let k = 0; k < 4; k++) {
      out[at + c + k] = a[ai + k] * x + a[ai + 4 + k] * y + a[ai + 8 + k] * z + a[ai + 12 + k] * w;
    }
  }
}

/** @param {Numbers} m @param {Numbers} p @returns {Vec} The point with its w, undivided. */
export const transform = (m, p) => [0, 1, 2, 3].map(
  (k) => m[k] * p[0] + m[k + 4] * p[1] + m[k + 8] * p[2] + m[k + 12]);

/** @param {Numbers} m A rigid matrix. @returns {Float32Array} Its inverse. */
export function invertRigid(m) {
  const out = identity();
  for (let i = 0; i < 3; i++) {
    for (let k = 0; k < 3; k++) out[k * 4 + i] = m[i * 4 + k];
    out[12 + i] = -(m[i * 4] * m[12] + m[i * 4 + 1] * m[13] + m[i * 4 + 2] * m[14]);
  }
  return out;
}

/**
 * @param {Numbers} eye @param {Numbers} target @param {Vec} up
 * @returns {Float32Array} world_from_camera; the camera looks along −Z.
 */
export function lookAt(eye, target, up) {
  const z = unit(sub(eye, target)), x = unit(cross(up, z)), y = cross(z, x);
  return new Float32Array([...x, 0, ...y, 0, ...z, 0, eye[0], eye[1], eye[2], 1]);
}

/**
 * @param {number} halfWidth @param {number} halfHeight Of the image at distance 1.
 * @param {number} near @param {number} far @returns {Float32Array}
 */
export function perspective(halfWidth, halfHeight, near, far) {
  const out = new Float32Array(16);
  out[0] = 1 / halfWidth;
  out[5] = 1 / halfHeight;
  out[10] = (far + near) / (near - far);
  out[11] = -1;
  out[14] = 2 * far * near / (near - far);
  return out;
}

/** @param {number} x @returns {number} The next of 1, 2, 5, 10, …, or that which is hardly less. */
export function roundUp(x) {
  const power = 10 ** Math.floor(Math.log10(Math.max(x, 1e-9)));
  return ([1, 2, 5].find((k) => k * power >= x * 0.99) ?? 10) * power;
}

/** Least and greatest of the coordinates that it was shown. */
export class Box {
  constructor() {
    this.low = [Infinity, Infinity, Infinity];
    this.high = [-Infinity, -Infinity, -Infinity];
  }

  /** @param {Numbers|Uint32Array|Uint16Array|Uint8Array} points @param {number} at @param {Vec} [shift] */
  add(points, at, shift = [0, 0, 0]) {
    for (let k = 0; k < 3; k++) {
      const x = points[at + k] + shift[k];
      if (!Number.isFinite(x)) return;
      this.low[k] = Math.min(this.low[k], x);
      this.high[k] = Math.max(this.high[k], x);
    }
  }

  get empty() { return !(this.low[0] <= this.high[0]); }

  get center() { return this.empty ? [0, 0.5, 0] : this.low.map((x, k) => (x + this.high[k]) / 2); }

  /** Half of the diagonal. */
  get radius() { return this.empty ? 1 : Math.max(Math.hypot(...sub(this.high, this.low)) / 2, 1e-3); }
}
