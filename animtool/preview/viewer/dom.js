/** Elements of the page; names from files only ever become text. */

/** @template {Element} T @param {string} id @param {new (...args: any[]) => T} kind @returns {T} */
export function need(id, kind) {
  const found = document.getElementById(id);
  if (!(found instanceof kind)) throw new Error(`the page lacks #${id}`);
  return found;
}

/** @param {string} id */
export const button = (id) => need(id, HTMLButtonElement);

/** Whether a button is down. @param {HTMLElement} element @param {boolean} on */
export const press = (element, on) => element.setAttribute('aria-pressed', String(on));

/** @param {string} id @param {() => void} act */
export const click = (id, act) => button(id).addEventListener('click', act);

/**
 * @param {string} tag @param {Record<string, string|boolean|((event: Event) => void)>} [attributes]
 * @param {...(Node|string)} children @returns {HTMLElement}
 */
export function make(tag, attributes = {}, ...children) {
  const out = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === 'function') out.addEventListener(name, value);
    else if (typeof value === 'boolean') out.toggleAttribute(name, value);
    else out.setAttribute(name, value);
  }
  out.append(...children);
  return out;
}

/** @param {string} text @param {number} [most] @returns {string} Its beginning, where it is long. */
export function short(text, most = 48) {
  const letters = [...text.slice(0, most * 2 + 2)];
  return letters.length > most ? `${letters.slice(0, most - 1).join('')}…` : text;
}

/** @param {string} text @returns {HTMLElement} A name, apart from the direction of what is around it. */
export const named = (text) => make('bdi', { title: short(text, 300) }, short(text, 80));

/** @param {number} x @param {number} [digits] */
export const number = (x, digits = 3) => (Math.abs(x) < 5 * 10 ** -digits ? 0 : x).toLocaleString('en', {
  maximumFractionDigits: digits, useGrouping: false });

/** Fit a canvas to its box. @param {HTMLCanvasElement} canvas @returns {number} Device pixels a CSS pixel. */
export function fit(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  return ratio;
}

/** @returns {Record<'back'|'line'|'strong'|'bone'|'accent'|'contact'|'ink'|'soft', number[]>} Colours of the theme, 0…255. */
export function themeColors() {
  const style = getComputedStyle(document.documentElement);
  const read = (/** @type {string} */ name) => {
    const hex = parseInt(style.getPropertyValue(`--${name}`).trim().slice(1), 16);
    return [hex >> 16 & 255, hex >> 8 & 255, hex & 255];
  };
  return {
    back: read('view'), line: read('grid'), strong: read('grid-strong'), bone: read('bone'),
    accent: read('accent'), contact: read('contact'), ink: read('ink'), soft: read('soft'),
  };
}

/** @param {number[]} color */
export const css = ([r, g, b]) => `rgb(${r} ${g} ${b})`;

/** Colours of takes and of curves, in both themes told apart by most eyes. */
export const SERIES = [[56, 132, 196], [214, 126, 44], [60, 158, 116], [186, 92, 150], [138, 120, 206], [196, 84, 80]];
