/** Curves of controls and channels over time, with the playhead. */

import { gestures } from './gestures.js';
import { clamp } from './maths.js';
import { SERIES, css, fit, make, named, need, number, short, themeColors } from './dom.js';

/** @typedef {import('./types.js').Channel} Channel */
/** @typedef {import('./main.js').App} App */
/** @typedef {{channel: Channel, color: number[], values: Float32Array, first: number}} Curve */

/** Most names of channels in the list, and curves in the chart; curves to begin with. */
const LISTED = 200, DRAWN = 6, BEGIN = 3;
const LEFT = 46, RIGHT = 12, TOP = 24, BOTTOM = 8;

export class Curves {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.channels = app.manifest.channels ?? [];
    /** @type {Map<number, Curve>} By the channel's index. */
    this.shown = new Map();
    this.section = need('curves', HTMLElement);
    this.playhead = need('playhead', HTMLElement);
    /** Width of the chart [px]. */
    this.wide = 0;
    /** First and last sample that are seen. */
    this.from = 0;
    this.to = Math.max(app.timeline.count - 1, 1);
    /** @type {Text[]} Values at the playhead. */
    this.values = [];
    this.canvas = need('chart', HTMLCanvasElement);
    this.legend = need('legend', HTMLElement);
    this.list = need('channels', HTMLElement);
    this.filter = need('filter', HTMLInputElement);
    this.note = need('channels-note', HTMLElement);
    this.filter.addEventListener('input', () => this.show());
    this.#scrubbing();
    this.show();
    this.resize();
  }

  /** Draw the channels that move most to begin with. */
  async begin() {
    const most = this.channels.map((each, i) => ({ i, moves: each.moves ?? 0 }));
    most.sort((a, b) => b.moves - a.moves || a.i - b.i);
    const first = most.slice(0, BEGIN).filter((each, k) => !k || each.moves > 0);
    for (const { i } of first) await this.toggle(i, true);
  }

  /** The filter is text, no pattern. */
  show() {
    const wanted = this.filter.value.trim().toLowerCase();
    /** @type {number[]} */
    const found = [];
    let count = 0;
    this.channels.forEach((each, i) => {
      if (wanted && !each.name.toLowerCase().includes(wanted)) return;
      if (count++ < LISTED) found.push(i);
    });
    this.list.replaceChildren(...found.map((i) => this.#entry(i)));
    this.note.textContent = count > LISTED ? `${LISTED} of ${count} channels: filter to see others`
      : `${count} of ${this.channels.length} channels`;
  }

  /** @param {number} i @returns {HTMLElement} */
  #entry(i) {
    const curve = this.shown.get(i);
    const dot = make('i', { class: 'dot' });
    if (curve) dot.style.background = css(curve.color);
    return make('li', {}, make('button', {
      type: 'button', 'aria-pressed': String(!!curve), click: () => { this.toggle(i, !this.shown.has(i)); },
    }, dot, named(this.channels[i].name)));
  }

  /** Draw a channel, or leave it. @param {number} i @param {boolean} on */
  async toggle(i, on) {
    const channel = this.channels[i];
    if (!on) this.shown.delete(i);
    else if (!this.shown.has(i)) {
      if (this.shown.size >= DRAWN) this.shown.delete([...this.shown.keys()][0]);
      const used = new Set([...this.shown.values()].map((each) => each.color));
      const color = SERIES.find((each) => !used.has(each)) ?? SERIES[0];
      const values = await this.app.streams.column(channel.values, channel.column ?? 0);
      const first = this.app.scene.poses[channel.take ?? -1]?.span[0] ?? 0;
      this.shown.set(i, { channel, color, values, first });
    }
    this.resize();
    this.show();
    this.draw();
  }

  /** Draw the channels of a joint. @param {string} joint */
  async choose(joint) {
    const wanted = this.channels.flatMap((each, i) => (each.name.replace(/^joint\//, '').startsWith(`${joint}.`) ? [i] : []));
    if (!wanted.length) return;
    this.shown.clear();
    for (const i of wanted.slice(0, DRAWN)) await this.toggle(i, true);
  }

  resize() {
    const hidden = !this.shown.size;
    if (this.section.hidden === hidden) return;
    this.section.hidden = hidden;
    this.app.invalidate();
  }

  /** @param {number} sample @returns {number} Where it is on the chart [CSS pixels]. */
  #x(sample) { return LEFT + (sample - this.from) / (this.to - this.from) * (this.wide - LEFT - RIGHT); }

  /** @param {number} x @returns {number} The sample there. */
  #at(x) { return this.from + (x - LEFT) / (this.wide - LEFT - RIGHT) * (this.to - this.from); }

  /** Scrub on the chart; zoom and pan it in time. */
  #scrubbing() {
    const go = (/** @type {number} */ x) => this.app.timeline.seek(this.#at(x));
    gestures(this.canvas, {
      drag: (dx, _, pans, x) => (pans ? this.look(1, x, dx) : go(x)),
      zoom: (factor, x) => this.look(factor, x, 0),
      tap: go,
    });
    this.canvas.addEventListener('dblclick', () => this.look(Infinity, 0, 0));
  }

  /** See more or less of the time, or earlier or later. @param {number} factor @param {number} x What stays where it is. @param {number} dx [CSS pixels] */
  look(factor, x, dx) {
    const last = Math.max(this.app.timeline.count - 1, 1), span = this.to - this.from;
    const wide = clamp(span * factor, Math.min(4, last), last), stays = this.#at(x);
    const from = stays - (stays - this.from) * wide / span - dx / (this.wide - LEFT - RIGHT) * wide;
    this.from = wide === last ? 0 : clamp(from, 0, last - wide);
    this.to = this.from + wide;
    this.draw();
  }

  /** @returns {Map<string, number[]>} Least and greatest value by unit. */
  #ranges() {
    /** @type {Map<string, number[]>} */
    const out = new Map();
    for (const { channel, values, first } of this.shown.values()) {
      let low = Infinity, high = -Infinity;
      for (let i = Math.max(0, Math.floor(this.from - first)); i <= this.to - first + 1 && i < values.length; i++) {
        if (values[i] < low) low = values[i];
        if (values[i] > high) high = values[i];
      }
      const [a, b] = out.get(channel.unit) ?? [Infinity, -Infinity];
      out.set(channel.unit, [Math.min(a, low), Math.max(b, high)]);
    }
    for (const [unit, [low, high]] of out) {
      const room = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
      out.set(unit, Number.isFinite(low) ? [low - room, high + room] : [-1, 1]);
    }
    return out;
  }

  draw() {
    if (this.section.hidden) return;
    const ratio = fit(this.canvas), pen = this.canvas.getContext('2d');
    if (!pen) return;
    const colors = themeColors();
    const width = this.wide = this.canvas.clientWidth, height = this.canvas.clientHeight;
    const right = width - RIGHT, bottom = height - BOTTOM;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = '11px system-ui, sans-serif';
    const ranges = this.#ranges(), main = [...ranges.values()][0];
    pen.strokeStyle = css(colors.line);
    pen.fillStyle = css(colors.soft);
    pen.textAlign = 'right';
    for (let k = 0; main && k <= 2; k++) {
      const y = bottom - (bottom - TOP) * k / 2;
      pen.beginPath();
      pen.moveTo(LEFT, y);
      pen.lineTo(right, y);
      pen.stroke();
      pen.fillText(number(main[0] + (main[1] - main[0]) * k / 2, 2), LEFT - 6, y + 4);
    }
    pen.save();
    pen.beginPath();
    pen.rect(LEFT - 4, 0, right - LEFT + 8, height);
    pen.clip();
    for (const curve of this.shown.values()) {
      const [low, high] = ranges.get(curve.channel.unit) ?? [0, 1];
      this.#curve(pen, curve, (v) => bottom - (v - low) / (high - low) * (bottom - TOP));
    }
    pen.restore();
    this.values = [...this.shown.values()].map(() => new Text());
    this.legend.replaceChildren(...[...this.shown.values()].map(({ channel, color }, i) => {
      const dot = make('i', { class: 'dot' });
      dot.style.background = css(color);
      return make('span', {}, dot, make('bdi', {}, short(channel.name, 32)), ' ', this.values[i]);
    }));
    this.move();
  }

  /** Put the playhead where the frame is, and write the values there. */
  move() {
    if (this.section.hidden) return;
    const { sample } = this.app.timeline;
    this.playhead.hidden = sample < this.from || sample > this.to;
    this.playhead.style.transform = `translateX(${this.#x(sample)}px)`;
    [...this.shown.values()].forEach(({ channel, values, first }, i) => {
      const value = values[clamp(sample - first, 0, values.length - 1)] ?? NaN;
      const text = `${number(value)} ${channel.unit}`;
      if (this.values[i] && this.values[i].data !== text) this.values[i].data = text;
    });
  }

  /**
   * @param {CanvasRenderingContext2D} pen @param {Curve} curve @param {(value: number) => number} y
   */
  #curve(pen, { values, color, channel, first: start }, y) {
    const x = (/** @type {number} */ sample) => this.#x(sample);
    pen.strokeStyle = pen.fillStyle = css(color);
    pen.lineWidth = 1.5;
    pen.lineJoin = 'round';
    pen.beginPath();
    // Of many samples in a pixel, the least and the greatest are drawn.
    const each = Math.max(1, Math.floor(Math.min(this.to - this.from, values.length) / 2000));
    const last = Math.min(values.length, Math.ceil(this.to - start) + each + 1);
    for (let i = Math.max(0, Math.floor((this.from - start) / each) * each); i < last; i += each) {
      let low = values[i], high = low;
      for (let k = i + 1; k < i + each && k < values.length; k++) {
        low = Math.min(low, values[k]);
        high = Math.max(high, values[k]);
      }
      pen.lineTo(x(start + i), y(low));
      if (high > low) pen.lineTo(x(start + i), y(high));
    }
    if (values.length === 1) pen.lineTo(x(this.app.timeline.count - 1), y(values[0]));
    pen.stroke();
    const { first, step } = this.app.timeline;
    for (const [frame, value] of channel.keys ?? []) {
      pen.beginPath();
      pen.arc(x((frame - first) / step), y(value), 3, 0, 7);
      pen.fill();
    }
    pen.lineWidth = 1;
  }
}
