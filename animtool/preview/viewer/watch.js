/** Pages that are served while their sources are edited. */

import { need } from './dom.js';

/** How often the server is asked, and how often while it does not answer [ms]. */
const PAUSE = 250, LOST = 2000;

/** Load the page again when its sources changed. @param {{url: string, version: number}} watched */
export async function watch({ url, version }) {
  const place = need('failed', HTMLElement);
  for (let pause = PAUSE; ;) {
    await new Promise((resolve) => { setTimeout(resolve, pause); });
    try {
      const now = await (await fetch(url, { cache: 'no-store' })).json();
      if (now.version !== version) {
        location.reload();
        return;
      }
      pause = PAUSE;
      place.hidden = !now.error;
      place.textContent = now.error ?? '';
    } catch {
      pause = LOST;
    }
  }
}
