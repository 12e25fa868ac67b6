/** The address of the page pins frame, camera and finding. */

/** @typedef {{f?: string, cam?: string, find?: string}} Pins */

/** @param {string} hash @returns {Pins} */
export function readFragment(hash) {
  const found = new URLSearchParams(hash.replace(/^#/, ''));
  /** @type {Pins} */
  const pins = {};
  for (const key of /** @type {(keyof Pins)[]} */ (['f', 'cam', 'find'])) {
    const value = found.get(key);
    if (value !== null) pins[key] = value;
  }
  return pins;
}

/** Write pins into the address, without an entry in the history. @param {Pins} pins */
export function writeFragment(pins) {
  const text = Object.entries(pins).map(([key, value]) => `${key}=${value}`).join('&');
  try {
    history.replaceState(null, '', `#${text}`);
  } catch {
    // A page inside another may have no address of its own.
  }
}
