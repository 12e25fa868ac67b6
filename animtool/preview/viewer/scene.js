/** Everything that is drawn in space, and the order in which it is drawn. */

import { Bones } from './bones.js';
import { View } from './camera.js';
import { Picture } from './gl.js';
import { Instances } from './instances.js';
import { Lines } from './lines.js';
import { Mesh } from './meshes.js';
import { PointCloud } from './points.js';
import { Shadow } from './shadow.js';
import { Pose } from './skeleton.js';
import { Strands } from './strands.js';
import { Ground, Trails } from './trails.js';
import { Box, add } from './maths.js';
import { SERIES } from './dom.js';

/** @typedef {import('./data.js').Streams} Streams */
/** @typedef {import('./types.js').Manifest} Manifest */
/** @typedef {ReturnType<typeof import('./dom.js').themeColors>} Colors */
/** @typedef {Record<'bones'|'axes'|'names'|'meshes'|'trails'|'contacts'|'grid'|'shadows'|'cameras', boolean>} Show */

/** Most takes that are looked at one by one: with more it is a crowd. */
const CAST = 4;
/** Corners of triangles that are drawn without asking, and the longest that a picture of more may take [ms]. */
const SMALL = 3e5, LONG = 50;
/** So many times as large as its characters, a stage is not shown as a whole at first. */
const WIDE = 4;

export class Scene {
  /** @param {WebGL2RenderingContext} gl @param {Streams} streams @param {Manifest} manifest */
  constructor(gl, streams, manifest) {
    this.gl = gl;
    this.streams = streams;
    this.manifest = manifest;
    this.poses = (manifest.takes ?? []).map((take, i) => new Pose(streams, take, i));
    const known = new Map();
    this.meshes = (manifest.meshes ?? []).map((mesh) => new Mesh(
      gl, streams, mesh, this.poses[mesh.take ?? -1] ?? null, known));
    this.instances = (manifest.instances ?? []).filter((each) => this.meshes[each.mesh])
      .map((each) => new Instances(gl, streams, each, this.meshes[each.mesh]));
    this.clouds = (manifest.points ?? []).map((each) => new PointCloud(gl, streams, each));
    this.strands = (manifest.curves3d ?? []).map((each) => new Strands(gl, streams, each, this.poses[each.take ?? -1] ?? null));
    this.cameras = manifest.cameras ?? [];
    for (const { t, r, focal } of this.cameras) streams.use([t, r, focal]);
    this.bones = new Bones(gl);
    this.trails = new Trails(gl, manifest.time);
    this.frusta = new Lines(gl);
    this.ground = new Ground(gl, 1);
    this.shadow = new Shadow(gl);
    this.sample = 0;
    this.picture = new Picture(gl);
    /** Whether there are too many takes for paths and close looks at each. */
    this.crowd = this.poses.length > CAST;
    /** Whether a crowd is drawn as bones alone. */
    this.simple = false;
  }

  /** Decode what is static, and pose the first sample. @param {number} sample */
  async load(sample) {
    await Promise.all([this.streams.load(sample),
      ...[...this.meshes, ...this.clouds, ...this.strands].map((each) => each.load())]);
    this.update(sample);
    for (const pose of this.poses) {
      const box = new Box();
      for (let j = 0; j < pose.count; j++) box.add(pose.world, j * 16 + 12);
      pose.extent = box.empty || box.radius <= 1e-3 ? 1 : box.radius;
    }
    this.simple = this.crowd && this.#cost() > LONG;
  }

  /** Meshes of characters. */
  get bodies() { return this.meshes.filter((mesh) => mesh.palette); }

  /** @returns {number} How long the meshes of all characters take to be drawn, by the first of them [ms]. */
  #cost() {
    const { gl, bodies } = this, view = new View(), pixel = new Uint8Array(4);
    const total = bodies.reduce((sum, { geometry }) => sum + geometry.faces.length, 0);
    if (total < SMALL) return 0;
    let before = 0;
    // The first time, the program is made ready.
    for (const count of [1, 4]) {
      before = performance.now();
      for (let i = 0; i < count; i++) bodies[0].draw(view);
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    }
    return (performance.now() - before) / 4 * total / bodies[0].geometry.faces.length;
  }

  /** What is drawn as shapes. */
  get #solids() {
    const all = [...this.meshes, ...this.instances, ...this.clouds, ...this.strands];
    return this.simple ? all.filter((each) => !('pose' in each && each.pose)) : all;
  }

  get joints() { return this.poses.some((pose) => pose.count); }

  /**
   * Grow boxes around all that is shown and around its characters.
   *
   * @param {Box} [box] @param {Box} [cast] @param {number[]} [shift] How they are moved.
   * @returns {Box} That of the characters, where the other is far larger.
   */
  box(box = new Box(), cast = new Box(), shift = [0, 0, 0]) {
    const own = new Box(), around = new Box();
    this.#bound(own, around);
    if (!around.empty) for (const corner of [around.low, around.high]) cast.add(corner, 0, shift);
    if (!own.empty) for (const corner of [own.low, own.high]) box.add(corner, 0, shift);
    return !cast.empty && box.radius > WIDE * cast.radius ? cast : box;
  }

  /** @param {Box} box @param {Box} cast */
  #bound(box, cast) {
    for (const pose of this.poses) {
      for (let j = 0; pose.visible && j < pose.count; j++) cast.add(pose.world, j * 16 + 12);
    }
    for (const mesh of this.meshes) mesh.bound(mesh.palette ? cast : box);
    if (!cast.empty) for (const corner of [cast.low, cast.high]) box.add(corner, 0);
    for (const { matrices, shown, mesh: { geometry: { reach } } } of this.instances) {
      for (let i = 0; i < shown; i++) {
        const size = reach * Math.hypot(...matrices.subarray(i * 16, i * 16 + 3));
        for (const side of [-size, size]) box.add(matrices, i * 16 + 12, [side, side, side]);
      }
    }
    for (const { points } of this.clouds) for (let i = 0; i < points.length; i += 3) if (points[i] < 1e29) box.add(points, i);
    for (const { points } of this.strands) for (let i = 0; points && i < points.length; i += 3) box.add(points, i);
  }

  /** Put everything where it is at a sample. @param {number} sample */
  update(sample) {
    this.sample = sample;
    for (const pose of this.poses) pose.update(sample);
  }

  /** @param {number} take @param {Colors} colors @returns {number[]} */
  color(take, colors) { return this.poses.length > 1 ? SERIES[take % SERIES.length] : colors.bone; }

  /** Give the graphics processor what moved. @param {Show} show @param {Colors} colors */
  prepare(show, colors) {
    const { sample } = this, visible = this.poses.filter((pose) => pose.visible);
    this.shadow.stale = true;
    if (show.meshes) {
      for (const each of this.#solids) each.update(sample);
    }
    const pick = (/** @type {number} */ take) => (this.poses.length > 1 ? this.color(take, colors) : colors.accent);
    this.trails.update(this.crowd ? [] : visible, sample, pick, colors.contact, show);
  }

  /**
   * @param {View} view @param {Show} show @param {Colors} colors
   * @param {{take: number, joint: number}|null} selected @param {boolean} fine Whether edges are smooth.
   */
  draw(view, show, colors, selected, fine) {
    const { gl } = this;
    const [r, g, b] = colors.back.map((x) => x / 255);
    const solid = show.meshes && !this.simple && this.meshes.some((mesh) => mesh.pose || mesh.record.cache != null);
    const visible = this.poses.filter((pose) => pose.visible), bones = show.bones || this.simple;
    const skeletons = (/** @type {import('./camera.js').Eye} */ eye, axes = false) => this.bones.draw(
      eye, visible, (take) => this.color(take, colors), selected, colors.accent, { bones, axes });
    const shaded = show.shadows && fine && this.shadow.cast(view, (eye) => {
      this.#shapes(eye, show, (each) => !(each instanceof Mesh && each.surrounds(view.radius)));
      if (!solid) skeletons(eye);
    });
    this.picture.begin(view.width, view.height, fine);
    gl.clearColor(r, g, b, 1);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.depthRange(0.1, 1);
    this.#shapes(view, show);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    if (shaded) this.shadow.draw(view);
    if (show.grid) {
      const center = view.target;
      this.ground.lay(center, colors.line, colors.strong);
      this.ground.draw(view, center);
    }
    this.trails.draw(view);
    if (show.cameras) this.#frusta(view, colors.soft);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    // In front of the skin, which hides them else.
    if (solid) {
      gl.depthRange(0, 0.1);
      gl.enable(gl.BLEND);
      view.opacity = 0.5;
    }
    skeletons(view, show.axes);
    view.opacity = 1;
    this.picture.end(view.width, view.height, fine);
  }

  /** @param {import('./camera.js').Eye} eye @param {Show} show @param {(each: object) => boolean} [wanted] */
  #shapes(eye, show, wanted = () => true) {
    for (const each of show.meshes ? this.#solids : []) {
      if (!(each instanceof Mesh && each.instances) && wanted(each)) each.draw(eye);
    }
  }

  /** @param {View} view @param {number[]} color */
  #frusta(view, color) {
    this.cameras.forEach((camera, i) => {
      const t = this.streams.at(camera.t, this.sample), q = this.streams.at(camera.r, this.sample);
      if (!t || !q || i === view.shot) return;
      const [x, y, z, w] = q, [wide, high] = camera.aperture_mm, size = view.radius * 0.16;
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 1.5]].map(([a, b]) => {
        const v = [a * size * 0.5, b * size * 0.5 * high / wide, -size];
        // v + 2 u × (u × v + w v), the rotation by a unit quaternion.
        const c = [y * v[2] - z * v[1] + w * v[0], z * v[0] - x * v[2] + w * v[1], x * v[1] - y * v[0] + w * v[2]];
        return add(t instanceof Float32Array ? t : [0, 0, 0], [
          v[0] + 2 * (y * c[2] - z * c[1]), v[1] + 2 * (z * c[0] - x * c[2]), v[2] + 2 * (x * c[1] - y * c[0])]);
      });
      for (let k = 0; k < 4; k++) {
        this.frusta.add(t, corners[k], color);
        this.frusta.add(corners[k], corners[(k + 1) % 4], color);
      }
      this.frusta.add(corners[3], corners[4], color);
      this.frusta.add(corners[2], corners[4], color);
    });
    this.frusta.flush();
    this.frusta.draw(view, { width: 1.5 });
  }
}
