/** What is written over the picture: names of joints, the gate of a camera, the axes of the file. */

import { css, fit, make, need, number, short } from './dom.js';
import { transform } from './maths.js';

/** @typedef {import('./main.js').App} App */

/** @type {Record<string, number>} Of a metre. */
const UNITS = { m: 1, cm: 100, mm: 1000, in: 1 / 0.0254, ft: 1 / 0.3048, dm: 10, km: 0.001 };
const NAMES = 400;

export class Overlay {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.canvas = need('labels', HTMLCanvasElement);
    this.readout = need('readout', HTMLElement);
    const { unit, up } = app.manifest.source;
    this.unit = UNITS[unit] ? unit : 'm';
    this.zUp = up.toLowerCase() === 'z';
    this.turned = '';
    /** @type {number[][]} Where names are written: left, right, middle. */
    this.taken = [];
  }

  /** @param {number[]} p In the page's axes [m]. @returns {number[]} In those and the unit of the file. */
  inFile([x, y, z]) {
    const k = UNITS[this.unit];
    return (this.zUp ? [x, -z, y] : [x, y, z]).map((v) => v * k);
  }

  /** @param {HTMLCanvasElement} canvas @returns {CanvasRenderingContext2D|null} Its pen, on an empty canvas. */
  #pen(canvas) {
    const ratio = fit(canvas), pen = canvas.getContext('2d');
    pen?.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen?.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    if (pen) [pen.font, pen.textBaseline] = ['11px system-ui, sans-serif', 'middle'];
    return pen;
  }

  draw() {
    const { app, canvas } = this, { view, scene, show, selected } = app;
    const pose = selected && scene.poses[selected.take];
    this.#axes();
    this.#read();
    // An empty layer would be blended over each picture for nothing.
    canvas.hidden = !view.gate && !show.names && !pose;
    const pen = canvas.hidden ? null : this.#pen(canvas);
    if (!pen) return;
    if (view.gate) this.#gate(pen, view.gate);
    this.taken = [];
    if (pose && selected) {
      this.#label(pen, pose.position(selected.joint), pose.names[selected.joint], app.colors.accent, true);
    }
    if (show.names) this.#points(pen);
    let written = 0;
    for (const each of scene.poses) {
      if (!each.visible || !show.names) continue;
      for (let j = 0; j < each.count && written < NAMES; j++, written++) {
        this.#label(pen, each.position(j), each.names[j], app.colors.soft);
      }
    }
  }

  /** @param {CanvasRenderingContext2D} pen Names of markers and targets. */
  #points(pen) {
    for (const { points, record: { names } } of this.app.scene.clouds) {
      (names ?? []).slice(0, NAMES).forEach((name, i) => {
        const at = points.subarray(i * 3, i * 3 + 3);
        if (at[0] < 1e29) this.#label(pen, [...at], name, this.app.colors.soft);
      });
    }
  }

  /** Write where the selected joint is. */
  #read() {
    const { selected, scene } = this.app, pose = selected && scene.poses[selected.take];
    this.readout.hidden = !pose;
    if (!pose || !selected) return;
    const place = this.inFile(pose.position(selected.joint).map((x, k) => x - pose.shift[k]));
    this.readout.replaceChildren(make('bdi', {}, short(pose.names[selected.joint], 40)),
      ` ${place.map((x) => number(x, 2)).join('  ')} ${this.unit}`);
  }

  /** @param {CanvasRenderingContext2D} pen @param {number[]} place @param {string} name @param {number[]} color @param {boolean} [ring] */
  #label(pen, place, name, color, ring = false) {
    const [x, y, depth] = this.app.view.project(place);
    if (depth <= 0) return;
    if (ring) {
      pen.strokeStyle = css(color);
      pen.lineWidth = 2;
      pen.beginPath();
      pen.arc(x, y, 9, 0, 7);
      pen.stroke();
    }
    pen.lineWidth = 3;
    pen.lineJoin = 'round';
    pen.strokeStyle = css(this.app.colors.back);
    pen.fillStyle = css(color);
    const text = short(name, 32), end = x + 16 + pen.measureText(text).width;
    // A name that another would cover is left out.
    if (this.taken.some(([left, right, at]) => x < right && end > left && Math.abs(y - at) < 12)) return;
    this.taken.push([x, end, y]);
    pen.strokeText(text, x + 12, y);
    pen.fillText(text, x + 12, y);
  }

  /** Darken what the camera of the shot does not see. @param {CanvasRenderingContext2D} pen @param {number[]} gate */
  #gate(pen, [x, y, w, h]) {
    pen.fillStyle = 'rgb(0 0 0 / .28)';
    pen.beginPath();
    pen.rect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    pen.rect(x, y, w, h);
    pen.fill('evenodd');
    pen.strokeStyle = css(this.app.colors.accent);
    pen.lineWidth = 1;
    pen.strokeRect(x, y, w, h);
  }

  /** The axes of the file, drawn when the camera turned. */
  #axes() {
    const size = 20, middle = 32, turn = this.app.view.view.slice();
    turn[12] = turn[13] = turn[14] = 0;
    const key = turn.join();
    if (key === this.turned) return;
    this.turned = key;
    const pen = this.#pen(need('axes', HTMLCanvasElement));
    if (!pen) return;
    pen.textAlign = 'center';
    const axes = this.zUp ? [[1, 0, 0], [0, 0, -1], [0, 1, 0]] : [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    axes.map((axis, k) => ({ k, at: transform(turn, axis) })).sort((a, b) => a.at[2] - b.at[2])
      .forEach(({ k, at: [dx, dy] }) => {
        pen.strokeStyle = pen.fillStyle = ['#d65a5a', '#58a854', '#4f86dc'][k];
        pen.lineWidth = 2;
        pen.beginPath();
        pen.moveTo(middle, middle);
        pen.lineTo(middle + dx * size, middle - dy * size);
        pen.stroke();
        pen.fillText('XYZ'[k], middle + dx * (size + 8), middle - dy * (size + 8));
      });
  }
}
