/** Mouse, pen, fingers and wheel on an element. */

import { clamp } from './maths.js';

/**
 * @typedef {object} Acts Positions are in CSS pixels of the element.
 * @property {(dx: number, dy: number, pans: boolean, x: number) => void} drag With two fingers, Shift or another button it pans.
 * @property {(factor: number, x: number) => void} zoom Farther away with more than 1.
 * @property {(x: number, y: number) => void} [tap]
 * @property {(held: boolean) => void} [hold]
 */

/** @param {HTMLElement} element @param {Acts} acts */
export function gestures(element, { drag, zoom, tap, hold }) {
  /** @type {Map<number, number[]>} */
  const fingers = new Map();
  let travelled = 0;
  element.addEventListener('pointerdown', (event) => {
    element.setPointerCapture(event.pointerId);
    if (!fingers.size) travelled = 0;
    fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    hold?.(true);
  });
  element.addEventListener('pointermove', (event) => {
    const last = fingers.get(event.pointerId), { offsetX: x, offsetY: y } = event;
    if (!last) return;
    const dx = x - last[0], dy = y - last[1];
    travelled += Math.abs(dx) + Math.abs(dy);
    const other = [...fingers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const gap = (/** @type {number[]} */ p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      zoom(gap(last) / gap([x, y]), (x + other[0]) / 2);
      drag(dx / 2, dy / 2, true, x);
    } else if (travelled > 4) drag(dx, dy, !!(event.buttons & 6) || event.shiftKey, x);
    fingers.set(event.pointerId, [x, y]);
  });
  const up = (/** @type {PointerEvent} */ event) => {
    if (fingers.delete(event.pointerId) && travelled <= 4 && event.type === 'pointerup') tap?.(event.offsetX, event.offsetY);
    hold?.(fingers.size > 0);
  };
  element.addEventListener('pointerup', up);
  element.addEventListener('pointercancel', up);
  element.addEventListener('contextmenu', (event) => event.preventDefault());
  element.addEventListener('wheel', (event) => {
    event.preventDefault();
    if (event.deltaX && !event.deltaY) drag(-event.deltaX, 0, true, event.offsetX);
    else zoom(Math.exp(clamp(event.deltaY, -200, 200) * 0.0015), event.offsetX);
  }, { passive: false });
}
