/** The camera: it orbits a target, or looks through a camera of the shot. */

import { gestures } from './gestures.js';
import { add, clamp, compose, identity, invertRigid, lookAt, multiply, perspective, sub, transform, unit } from './maths.js';

/** @typedef {import('./types.js').CameraRecord} CameraRecord */
/** @typedef {import('./data.js').Streams} Streams */

/**
 * What drawing needs of a camera: where it looks from, the size of its picture, the key
 * light in its frame, and how opaque what is laid over other things is.
 *
 * @typedef {{view: Float32Array, viewProjection: Float32Array, width: number, height: number,
 *   ratio: number, perMetre: number, light: number[], opacity: number}} Eye
 */

/** From where the key light comes, in the frame of the view. */
export const LIGHT = unit([-0.35, 0.65, 0.68]);
/** Tangent of half the angle of view. */
const HALF = 0.3;
/** What the gate of a camera of the shot fills of the picture. */
const GATE = 0.92;
/** Distance to show all, of that where it touches the edges. */
const ROOM = 1.15;
const STEEP = Math.PI / 2 - 1e-3;
/** @type {Record<string, [number, number]>} Yaw and pitch. */
export const PRESETS = { front: [0, 0], side: [Math.PI / 2, 0], top: [0, STEEP], home: [0.6, 0.18] };

/** A character is followed along a path that is this many times longer than high. */
const LONG_PATH = 2;

/** @param {number[][]} path @param {number[]} now @param {number} extent @returns {boolean} Whether a camera follows along it. */
export function travels(path, now, extent) {
  const far = Math.max(...path.map((at) => Math.hypot(at[0] - now[0], at[2] - now[2])));
  const heights = path.map((at) => at[1]);
  return far > Math.max(extent, LONG_PATH * (Math.max(...heights) - Math.min(...heights)));
}

/** A camera and the picture that it makes. */
export class View {
  constructor() {
    this.yaw = PRESETS.home[0];
    this.pitch = PRESETS.home[1];
    this.distance = 4;
    this.target = [0, 0.9, 0];
    this.radius = 1;
    /** Height of the lowest of what it shows [m]. */
    this.floor = 0;
    /** Index of the shot's camera that it looks through, −1 for none. */
    this.shot = -1;
    this.follow = false;
    /** Whether fingers or a button move it. */
    this.held = false;
    /** @type {number[]|null} Where the followed joint was last. */
    this.followed = null;
    this.width = this.height = this.ratio = 1;
    this.world = identity();
    this.view = identity();
    this.projection = identity();
    this.viewProjection = identity();
    this.perMetre = 1;
    this.light = LIGHT;
    this.opacity = 1;
    /** What buttons cover at the top [CSS pixels]: the picture is centred beneath. */
    this.inset = 0;
    /** @type {number[]|null} The shot's gate in CSS pixels: left, top, width, height. */
    this.gate = null;
  }

  /** @param {number} distance @returns {number[]} From the target to the eye. */
  #back(distance) {
    const level = Math.cos(this.pitch) * distance;
    return [Math.sin(this.yaw) * level, Math.sin(this.pitch) * distance, Math.cos(this.yaw) * level];
  }

  /** Part of the height that buttons cover. */
  get #covered() { return Math.min(this.inset * this.ratio / this.height, 0.5); }

  /** @returns {number[]} Half of the free width and height at distance 1. */
  #halves() {
    const aspect = this.width / this.height, free = 1 - this.#covered;
    const high = HALF * Math.max(1, free / aspect);
    return [high / free * aspect, high];
  }

  /** Show what is in a box. @param {import('./maths.js').Box} box */
  frame(box) {
    this.target = box.center;
    this.radius = box.radius;
    this.floor = box.low[1];
    const back = this.#back(1), world = lookAt(back, [0, 0, 0], [0, 1, 0]);
    const [wide, high] = this.#halves(), { low, high: top } = box;
    this.distance = this.radius * 0.2;
    for (let i = 0; i < 8 && !box.empty; i++) {
      const from = sub([0, 1, 2].map((k) => (i >> k & 1 ? low : top)[k]), this.target);
      const [x, y, z] = [0, 4, 8].map((c) => world[c] * from[0] + world[c + 1] * from[1] + world[c + 2] * from[2]);
      this.distance = Math.max(this.distance, (Math.abs(x) / wide + z) * ROOM, (Math.abs(y) / high + z) * ROOM);
    }
  }

  /** @param {string} name Of a preset. */
  preset(name) {
    this.shot = -1;
    [this.yaw, this.pitch] = PRESETS[name];
  }

  /** @param {number} dx @param {number} dy In CSS pixels. */
  orbit(dx, dy) {
    this.yaw -= dx * 0.008;
    this.pitch = clamp(this.pitch + dy * 0.008, -STEEP, STEEP);
  }

  /** @param {number} dx @param {number} dy In CSS pixels. */
  pan(dx, dy) {
    const scale = this.distance * this.ratio / this.perMetre;
    const right = this.world.subarray(0, 3), up = this.world.subarray(4, 7);
    this.target = this.target.map((x, k) => x - right[k] * dx * scale + up[k] * dy * scale);
  }

  /** @param {number} factor */
  zoom(factor) { this.distance = clamp(this.distance * factor, this.radius * 0.02, this.radius * 200); }

  /** Go along with a joint, level. @param {number[]|null} position */
  track(position) {
    if (this.follow && position && this.followed) {
      const [dx, , dz] = sub(position, this.followed);
      this.target = add(this.target, [dx, 0, dz]);
    }
    this.followed = position;
  }

  /** @param {CameraRecord|null} camera @param {Streams} streams @param {number} sample */
  update(camera, streams, sample) {
    const aspect = this.width / this.height;
    let [halfWidth, halfHeight] = this.#halves();
    halfHeight /= 1 - this.#covered;
    this.gate = null;
    const t = camera && streams.at(camera.t, sample), r = camera && streams.at(camera.r, sample);
    if (camera && t && r) {
      compose(this.world, 0, new Float32Array(t), 0, new Float32Array(r), 0, null, 0);
      const { focal, aperture_mm: [wide, high] } = camera;
      const length = (focal == null ? null : streams.at(focal, sample)?.[0]) ?? camera.focal_mm;
      const tall = high / (2 * length) / GATE, broad = wide / (2 * length) / GATE;
      halfHeight = Math.max(tall, broad / aspect);
      halfWidth = halfHeight * aspect;
      const w = broad * GATE / halfWidth * this.width, h = tall * GATE / halfHeight * this.height;
      this.gate = [(this.width - w) / 2, (this.height - h) / 2, w, h].map((x) => x / this.ratio);
    } else {
      this.world = lookAt(add(this.target, this.#back(this.distance)), this.target, [0, 1, 0]);
    }
    const away = this.gate ? this.radius * 4 : this.distance;
    this.projection = perspective(halfWidth, halfHeight, away * 0.01, away + this.radius * 100);
    if (!this.gate) this.projection[9] = this.#covered;
    this.view = invertRigid(this.world);
    multiply(this.viewProjection, 0, this.projection, 0, this.view, 0);
    this.perMetre = this.height / (2 * halfHeight);
  }

  /** @param {ArrayLike<number>} point @returns {number[]} CSS pixels in the picture, and the depth; behind the camera it is not positive. */
  project(point) {
    const [x, y, , w] = transform(this.viewProjection, [point[0], point[1], point[2]]);
    return [(x / w + 1) / 2 * this.width / this.ratio, (1 - y / w) / 2 * this.height / this.ratio, w];
  }

  /** @returns {string} For the address of the page. */
  get text() {
    if (this.shot >= 0) return `shot:${this.shot}`;
    return [this.yaw, this.pitch, this.distance, ...this.target].map((x) => +x.toFixed(3)).join();
  }

  set text(text) {
    const shot = /^shot:(\d+)$/.exec(text), values = text.split(',').map(Number);
    if (shot) this.shot = Number(shot[1]);
    else if (values.length === 6 && values.every(Number.isFinite) && values[2] > 0) {
      [this.yaw, this.pitch, this.distance] = values;
      this.pitch = clamp(this.pitch, -STEEP, STEEP);
      this.target = values.slice(3);
      this.shot = -1;
    }
  }
}

/**
 * Move a camera with mouse, pen, fingers and wheel.
 *
 * @param {HTMLElement} element @param {View} view
 * @param {(moved: boolean) => void} changed @param {(x: number, y: number) => void} picked
 */
export function steer(element, view, changed, picked) {
  const moved = () => {
    view.shot = -1;
    changed(true);
  };
  gestures(element, {
    drag: (dx, dy, pans) => {
      if (pans) view.pan(dx, dy);
      else view.orbit(dx, dy);
      moved();
    },
    zoom: (factor) => {
      view.zoom(factor);
      moved();
    },
    tap: picked,
    hold: (held) => {
      view.held = held;
      changed(false);
    },
  });
}
