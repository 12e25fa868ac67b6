/** Time: playing, stepping and scrubbing in frames of the shot. */

import { button, click, make, need, number, press } from './dom.js';
import { clamp } from './maths.js';

/** @typedef {import('./types.js').Manifest} Manifest */

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];

/** Parts of the motion, at whose ends the camera looks where everything is. */
const LOOKS = 12;

/** @param {number} count @returns {number[]} Samples that say where the whole motion is, the first and the last of them. */
export const samplesOf = (count) => [...new Set(Array.from({ length: LOOKS + 1 }, (_, i) => Math.round(i / LOOKS * (count - 1))))];

export class Timeline {
  /** @param {Manifest} manifest @param {() => void} changed Called when sample or state is another. */
  constructor({ time, findings = [] }, changed) {
    this.first = time.first;
    this.step = time.step || 1;
    this.count = Math.max(time.count, 1);
    /** Samples a second. */
    this.rate = time.rate[0] / time.rate[1] / this.step;
    this.changed = changed;
    this.sample = 0;
    this.position = 0;
    this.playing = false;
    this.loop = true;
    this.speed = 1;
    this.scrub = need('scrub', HTMLInputElement);
    this.field = need('frame', HTMLInputElement);
    this.clock = need('time', HTMLElement);
    this.speeds = need('speed', HTMLSelectElement);
    this.scrub.max = String(this.count - 1);
    Object.assign(this.field, { min: this.first, max: this.frameOf(this.count - 1), step: this.step });
    need('last-frame', HTMLElement).textContent = `/ ${number(this.frameOf(this.count - 1))}`;
    this.speeds.append(...SPEEDS.map((x) => make('option', { value: String(x), selected: x === 1 }, `${x}×`)));
    this.scrub.addEventListener('input', () => this.seek(Number(this.scrub.value)));
    this.field.addEventListener('change', () => this.seek(this.sampleOf(Number(this.field.value))));
    this.speeds.addEventListener('change', () => { this.speed = Number(this.speeds.value); });
    click('play', () => this.toggle());
    click('first', () => this.seek(0));
    click('back', () => this.seek(this.sample - 1));
    click('next', () => this.seek(this.sample + 1));
    click('last', () => this.seek(this.count - 1));
    click('loop', () => this.setLoop(!this.loop));
    this.#ticks(findings.map((each) => each.frame));
    this.show();
  }

  /** @param {number} sample */
  frameOf(sample) { return this.first + sample * this.step; }

  /** @param {number} frame @returns {number} The nearest sample. */
  sampleOf(frame) {
    return clamp(Math.round((frame - this.first) / this.step) || 0, 0, this.count - 1);
  }

  /** Mark findings above the slider. @param {(number|null|undefined)[]} frames */
  #ticks(frames) {
    const places = new Set(frames.flatMap((f) => (f == null ? [] : [this.sampleOf(f)])));
    need('ticks', HTMLElement).append(...[...places].slice(0, 500).map((i) => {
      const tick = make('i');
      tick.style.left = `${i / Math.max(this.count - 1, 1) * 100}%`;
      return tick;
    }));
  }

  /** @param {number} sample */
  seek(sample) {
    this.playing = false;
    this.position = this.sample = clamp(Math.round(sample), 0, this.count - 1);
    this.show();
    this.changed();
  }

  toggle() {
    this.playing = !this.playing && this.count > 1;
    if (this.playing && this.sample === this.count - 1) this.position = this.sample = 0;
    this.show();
    this.changed();
  }

  /** @param {boolean} on */
  setLoop(on) {
    this.loop = on;
    this.show();
  }

  /** @param {number} by Places in the list of speeds. */
  faster(by) {
    this.speed = SPEEDS[clamp(SPEEDS.indexOf(this.speed) + by, 0, SPEEDS.length - 1)];
    this.speeds.value = String(this.speed);
  }

  /** Let time pass. @param {number} seconds */
  advance(seconds) {
    this.position += Math.min(seconds, 0.25) * this.rate * this.speed;
    if (this.position >= this.count) {
      this.playing = this.loop;
      this.position = this.loop ? this.position % this.count : this.count - 1;
    }
    const { sample } = this;
    this.sample = Math.floor(this.position);
    if (sample !== this.sample || !this.playing) this.show();
  }

  /** Write the state into the page. */
  show() {
    const frame = number(this.frameOf(this.sample)), seconds = this.sample / this.rate;
    this.scrub.value = String(this.sample);
    this.scrub.setAttribute('aria-valuetext', `frame ${frame}`);
    this.scrub.style.setProperty('--at', `${this.sample / Math.max(this.count - 1, 1) * 100}%`);
    if (document.activeElement !== this.field || !this.playing) this.field.value = frame;
    this.clock.textContent = `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(2).padStart(5, '0')}`;
    const play = button('play'), name = this.playing ? 'Pause' : 'Play';
    if (play.getAttribute('aria-label') !== name) play.setAttribute('aria-label', name);
    play.dataset.on = String(this.playing);
    press(button('loop'), this.loop);
  }
}
