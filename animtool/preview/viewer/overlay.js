/** What is written over the picture: names of joints, the gate of a camera, the axes of the file. */

import { css, fit, need, number, short } from './dom.js';
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
  }

  /** @param {number[]} p In the page's axes [m]. @returns {number[]} In those and the unit of the file. */
  inFile([x, y, z]) {
    const k = UNITS[this.unit];
    return (this.zUp ? [x, -z, y] : [x, y, z]).map((v) => v * k);
  }

  draw() {
    const { app, canvas } = this, { view, scene, show, selected } = app;
    const ratio = fit(canvas), pen = canvas.getContext('2d');
    if (!pen) return;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    pen.font = '11px system-ui, sans-serif';
    pen.textBaseline = 'middle';
    if (view.gate) this.#gate(pen, view.gate);
    this.#axes(pen, canvas.clientHeight);
    let written = 0;
    for (const pose of scene.poses) {
      if (!pose.visible || !show.names) continue;
      for (let j = 0; j < pose.count && written < NAMES; j++, written++) {
        this.#label(pen, pose.position(j), pose.names[j], app.colors.soft);
      }
    }
    const pose = selected && scene.poses[selected.take];
    this.readout.hidden = !pose;
    if (!pose || !selected) return;
    const at = pose.position(selected.joint), name = pose.names[selected.joint];
    this.#label(pen, at, name, app.colors.accent, true);
    const place = this.inFile(at.map((x, k) => x - pose.shift[k]));
    this.readout.replaceChildren(document.createElement('bdi'),
      ` ${place.map((x) => number(x, 2)).join('  ')} ${this.unit}`);
    if (this.readout.firstChild) this.readout.firstChild.textContent = short(name, 40);
  }

  /** @param {CanvasRenderingContext2D} pen @param {number[]} at @param {string} name @param {number[]} color @param {boolean} [ring] */
  #label(pen, at, name, color, ring = false) {
    const [x, y, depth] = this.app.view.project(at);
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
    const text = short(name, 32);
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

  /** The axes of the file, lower left. @param {CanvasRenderingContext2D} pen @param {number} height */
  #axes(pen, height) {
    const x = 34, y = height - 58, size = 20, turn = this.app.view.view.slice();
    turn[12] = turn[13] = turn[14] = 0;
    const axes = this.zUp ? [[1, 0, 0], [0, 0, -1], [0, 1, 0]] : [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    pen.textAlign = 'center';
    axes.map((axis, k) => ({ k, at: transform(turn, axis) })).sort((a, b) => a.at[2] - b.at[2])
      .forEach(({ k, at: [dx, dy] }) => {
        pen.strokeStyle = pen.fillStyle = ['#d65a5a', '#58a854', '#4f86dc'][k];
        pen.lineWidth = 2;
        pen.beginPath();
        pen.moveTo(x, y);
        pen.lineTo(x + dx * size, y - dy * size);
        pen.stroke();
        pen.fillText('XYZ'[k], x + dx * (size + 9), y - dy * (size + 9));
      });
    pen.textAlign = 'left';
  }
}
