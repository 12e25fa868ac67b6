/** Findings of the validation: each is a link to its frame and joint. */

import { make, named, need, number, short } from './dom.js';

/** @typedef {import('./main.js').App} App */

const LISTED = 300;

export class Findings {
  /** @param {App} app */
  constructor(app) {
    this.app = app;
    this.findings = app.manifest.findings ?? [];
    /** Index of the finding that is shown, −1 for none. */
    this.current = -1;
    const list = need('findings', HTMLElement);
    this.links = this.findings.slice(0, LISTED).map((_, i) => this.#link(i));
    list.append(...this.links.map((link) => make('li', {}, link)));
    const left = this.findings.length - LISTED;
    need('findings-note', HTMLElement).textContent = left > 0 ? `and ${left} more: animtool validate lists them`
      : this.findings.length ? '' : 'No findings.';
    list.append(...(app.manifest.notices ?? []).map((text) => make('li', { class: 'notice' }, short(text, 400))));
  }

  /** @param {number} i @returns {HTMLElement} */
  #link(i) {
    const { code, severity, message, frame, joint } = this.findings[i];
    const where = make('span', { class: 'where' });
    if (frame != null) where.append(`frame ${number(frame)}`);
    if (joint != null) where.append(frame == null ? '' : ' · ', named(joint));
    return make('a', {
      href: `#find=${i}`, class: `finding ${/^(error|warning)$/.test(severity) ? severity : 'info'}`,
      click: (event) => {
        event.preventDefault();
        this.show(i);
      },
    }, make('b', {}, short(code, 24)), make('span', { class: 'severity' }, short(severity, 16)), where,
    make('span', { class: 'message' }, short(message, 400)));
  }

  /** Go to a finding. @param {number} i @param {boolean} [seek] */
  show(i, seek = true) {
    const found = this.findings[i], { app } = this;
    if (!found) return;
    this.links[this.current]?.removeAttribute('aria-current');
    this.current = i;
    this.links[i]?.setAttribute('aria-current', 'true');
    const take = found.take ?? 0, joint = app.scene.poses[take]?.names.indexOf(found.joint ?? '') ?? -1;
    app.select(joint < 0 ? null : { take, joint });
    if (seek && found.frame != null) app.timeline.seek(app.timeline.sampleOf(found.frame));
    app.invalidate();
    app.remember();
  }
}
