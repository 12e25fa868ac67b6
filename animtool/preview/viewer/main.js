/** The page: reads its data, draws it, and answers to its user. */

import { View, steer, travels } from './camera.js';
import { Compare } from './compare.js';
import { Curves } from './curves.js';
import { Streams } from './data.js';
import { button, fit, need, press, themeColors } from './dom.js';
import { Findings } from './findings.js';
import { Box } from './maths.js';
import { readFragment, writeFragment } from './fragment.js';
import { Overlay } from './overlay.js';
import { Pace } from './pace.js';
import { Scene } from './scene.js';
import { Timeline, samplesOf } from './timeline.js';
import { Ground } from './trails.js';
import { connect, describe } from './ui.js';
import { watch } from './watch.js';

/** @typedef {{take: number, joint: number}} Selected */
/** @typedef {{errors: string[], ready: Promise<void>}} Page What scripts and tests find as `window.animtool`. */

const page = /** @type {Window & {animtool: Page}} */ (/** @type {unknown} */ (window)).animtool;

/** How near to a joint a click selects it [CSS pixels]. */
const NEAR = 14;

export class App {
  /** @param {import('./types.js').Manifest} manifest @param {WebGL2RenderingContext} gl */
  constructor(manifest, gl) {
    this.manifest = manifest;
    this.gl = gl;
    this.canvas = need('view', HTMLCanvasElement);
    this.cameras = need('camera', HTMLSelectElement);
    this.streams = new Streams(manifest, (block) => need(`b${block}`, HTMLScriptElement).text);
    this.scene = new Scene(gl, this.streams, manifest);
    this.view = new View();
    this.colors = themeColors();
    this.show = {
      bones: true, axes: false, names: false, meshes: true, trails: true, contacts: true, grid: true, shadows: true, cameras: true };
    /** @type {Selected|null} */
    this.selected = null;
    this.timeline = new Timeline(manifest, () => this.invalidate(true));
    this.overlay = new Overlay(this);
    /** Whether data or looks are others than those drawn. */
    this.stale = true;
    /** Whether the picture is another than the one drawn. */
    this.dirty = true;
    // Nothing is drawn before all is loaded.
    this.awake = true;
    this.inset = 0;
    this.before = 0;
    this.pace = new Pace(this);
    /** @type {(() => void)[]} Who waits for the next picture. */
    this.waiting = [];
  }

  async start() {
    const pins = readFragment(location.hash);
    if (pins.f !== undefined) this.timeline.seek(this.timeline.sampleOf(Number(pins.f)));
    await this.scene.load(this.timeline.sample);
    this.compare = new Compare(this);
    this.curves = new Curves(this);
    this.findings = new Findings(this);
    connect(this);
    const whole = await this.#frameAll();
    describe(this);
    this.pace.setSimple(this.scene.simple);
    this.awake = false;
    if (this.compare.beside) this.compare.arrange(true);
    steer(this.canvas, this.view, (moved) => {
      this.invalidate();
      if (moved) this.remember();
    }, (x, y) => this.pick(x, y));
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    addEventListener('hashchange', () => this.open(readFragment(location.hash)));
    this.open(pins);
    await this.drawn();
    const { text } = this.view;
    await this.curves.begin();
    this.#fit();
    if (pins.cam === undefined && this.view.text === text && !this.compare.beside) this.view.frame(whole);
    await this.drawn();
    if (this.manifest.watch) watch(this.manifest.watch);
  }

  /** @param {import('./fragment.js').Pins} pins */
  open({ f, cam, find }) {
    if (cam !== undefined) this.view.text = cam;
    if (find !== undefined) this.findings?.show(Number(find), f === undefined);
    if (f !== undefined && Number.isFinite(Number(f))) this.timeline.seek(this.timeline.sampleOf(Number(f)));
    this.invalidate(true);
  }

  /** Write frame, camera and finding into the address, once the picture rests. */
  remember() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      const find = this.findings?.current ?? -1;
      writeFragment({
        f: String(+this.timeline.frameOf(this.timeline.sample).toFixed(6)), cam: this.view.text,
        ...find >= 0 ? { find: String(find) } : {} });
    }, 150);
  }

  /** Show all that is there from first to last; a character that travels is followed. @returns {Promise<Box>} What is shown. */
  async #frameAll() {
    const { scene, timeline: { sample, count }, streams } = this, [pose] = scene.poses;
    const parts = [];
    for (const i of samplesOf(count).concat(sample)) {
      await streams.load(i);
      scene.update(i);
      parts.push({ i, at: pose?.count ? pose.position(pose.root) : [0, 0, 0] });
    }
    this.#fit();
    const { at: now } = parts[parts.length - 1], all = new Box(), cast = new Box();
    const follow = !!pose?.count && !scene.crowd && travels(parts.map(({ at }) => at), now, pose.extent);
    let box = all;
    for (const { i, at } of parts) {
      await streams.load(i);
      scene.update(i);
      scene.prepare(this.show, this.colors);
      box = scene.box(all, cast, follow ? [now[0] - at[0], 0, now[2] - at[2]] : undefined);
    }
    this.view.frame(box);
    scene.ground = new Ground(this.gl, box.radius);
    this.setFollow(follow);
    return box;
  }

  /** Show all. */
  home() { this.view.frame(this.scene.box()); }

  /** @param {string} name */
  preset(name) {
    this.view.preset(name);
    if (name === 'home') this.home();
    this.invalidate();
    this.remember();
  }

  /** @param {boolean} on */
  setFollow(on) {
    this.view.follow = on;
    press(button('follow'), on);
  }

  /** @param {Selected|null} selected */
  select(selected) {
    this.selected = selected;
    const name = selected && this.scene.poses[selected.take]?.names[selected.joint];
    if (name) this.curves?.choose(name);
    this.invalidate();
  }

  /** Select the joint that is nearest to a point of the picture. @param {number} x @param {number} y */
  pick(x, y) {
    let near = NEAR;
    /** @type {Selected|null} */
    let found = null;
    for (const pose of this.scene.poses) {
      for (let j = 0; pose.visible && j < pose.count; j++) {
        const [px, py, depth] = this.view.project(pose.position(j));
        const apart = Math.hypot(px - x, py - y);
        if (depth > 0 && apart < near) [near, found] = [apart, { take: pose.index, joint: j }];
      }
    }
    this.select(found);
  }

  /** Read the colours again. */
  restyle() {
    this.colors = themeColors();
    this.curves?.draw();
    this.invalidate(true);
  }

  resize() {
    const bars = [need('display', HTMLElement), need('cams', HTMLElement)];
    this.inset = Math.max(...bars.map((bar) => bar.offsetTop + bar.offsetHeight));
    this.curves?.draw();
    this.invalidate();
  }

  /** Draw soon. @param {boolean} [stale] Whether more moved than the camera. */
  invalidate(stale = false) {
    this.stale ||= stale;
    this.dirty = true;
    if (this.awake) return;
    this.pace.reset();
    this.awake = true;
    this.before = 0;
    requestAnimationFrame((now) => this.#tick(now));
  }

  /** @returns {Promise<void>} Resolves after the next picture. */
  drawn() {
    return new Promise((resolve) => {
      this.waiting.push(resolve);
      this.invalidate();
    });
  }

  /** @param {number} now */
  async #tick(now) {
    const { timeline, streams, scene } = this;
    try {
      if (timeline.playing) {
        const last = timeline.sample;
        timeline.advance(this.before ? (now - this.before) / 1000 : 0);
        this.pace.hurry(now, this.before);
        this.stale ||= last !== timeline.sample;
        this.before = now;
      }
      while (streams.missing(timeline.sample).length) {
        await streams.load(timeline.sample);
        this.before = 0;
      }
      const { sample } = timeline;
      const waiting = this.waiting.splice(0);
      const moved = scene.sample !== sample || this.stale;
      if (moved) this.#pose(sample);
      if (moved || this.dirty) this.draw();
      if (timeline.playing && this.manifest.time.count > 1) streams.load((sample + 32) % timeline.count);
      else this.remember();
      for (const resolve of waiting) resolve();
    } catch (error) {
      fail(error);
    }
    this.awake = timeline.playing || this.waiting.length > 0 || this.stale;
    if (this.awake) requestAnimationFrame((time) => this.#tick(time));
  }

  /** @param {number} sample */
  #pose(sample) {
    this.stale = false;
    this.scene.update(sample);
    this.compare?.update();
    const [pose] = this.scene.poses;
    this.view.track(pose?.count ? pose.position(pose.root) : null);
    this.scene.prepare(this.show, this.colors);
    this.curves?.move();
  }

  /** Make the picture as large as its place. */
  #fit() {
    const { view, canvas } = this;
    view.ratio = fit(canvas);
    [view.width, view.height, view.inset] = [canvas.width, canvas.height, this.inset];
  }

  draw() {
    this.dirty = false;
    const { view, scene } = this;
    if (this.cameras.value !== `${view.shot}`) this.cameras.value = `${view.shot}`;
    this.#fit();
    view.update(scene.cameras[view.shot] ?? null, this.streams, scene.sample);
    scene.draw(view, this.show, this.colors, this.selected, this.pace.fine || !(this.timeline.playing || view.held));
    this.overlay.draw();
  }
}

/** Say what went wrong. @param {unknown} error */
function fail(error) {
  const text = error instanceof Error ? error.message : String(error);
  page.errors.push(text);
  const place = need('failed', HTMLElement);
  place.textContent = text;
  place.hidden = false;
}

/** @returns {Promise<App>} */
async function open() {
  if (!('DecompressionStream' in window)) throw new Error('This browser is too old for the page: it cannot inflate data.');
  const canvas = need('view', HTMLCanvasElement);
  const gl = canvas.getContext('webgl2', { alpha: false, antialias: false });
  if (!gl) throw new Error('This browser shows no WebGL2, which the page draws with.');
  canvas.addEventListener('webglcontextrestored', () => location.reload());
  const app = new App(JSON.parse(need('manifest', HTMLScriptElement).text), gl);
  await app.start();
  return app;
}

const opened = open();
opened.catch(fail);
/** Resolves when the first picture is drawn, and curves stand beneath it. */
page.ready = opened.then((app) => void Object.assign(page, {
  app,
  frame: () => app.timeline.frameOf(app.timeline.sample),
  seek: (/** @type {number} */ frame) => {
    app.timeline.seek(app.timeline.sampleOf(frame));
    return app.drawn();
  },
  project: (/** @type {number} */ take, /** @type {number} */ joint) => {
    const box = app.canvas.getBoundingClientRect();
    const [x, y] = app.view.project(app.scene.poses[take].position(joint));
    return [x + box.left, y + box.top];
  },
  camera: () => ({ view: [...app.view.view], projection: [...app.view.projection] }),
}));
page.ready.catch(() => undefined);
