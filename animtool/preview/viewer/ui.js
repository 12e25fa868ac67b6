/** Buttons, panels, theme and keyboard. */

import { button, click, make, need, number, press, short } from './dom.js';

/** @typedef {import('./main.js').App} App */

const PANELS = ['findings', 'takes', 'channels'];

/** Light or dark: as the system, until it is chosen. @param {App} app */
function theme(app) {
  const dark = matchMedia('(prefers-color-scheme: dark)');
  const apply = (/** @type {boolean} */ on) => {
    document.documentElement.dataset.theme = on ? 'dark' : 'light';
    press(button('theme'), on);
    app.restyle();
  };
  apply(dark.matches);
  dark.addEventListener('change', () => apply(dark.matches));
  click('theme', () => apply(document.documentElement.dataset.theme !== 'dark'));
}

/** What may be shown or not; buttons of what the page has not are left out. @param {App} app */
function toggles(app) {
  const { scene, show, manifest } = app, { joints } = scene;
  const there = {
    bones: joints, axes: joints, names: joints || scene.clouds.some(({ record }) => record.names), trails: joints,
    meshes: !!(scene.meshes.length + scene.clouds.length + scene.strands.length),
    contacts: (manifest.takes ?? []).some((take) => take.contacts?.length),
    grid: true, shadows: true, cameras: scene.cameras.length > 0,
  };
  for (const name of /** @type {(keyof typeof there)[]} */ (Object.keys(there))) {
    const own = button(`show-${name}`);
    own.hidden = !there[name];
    press(own, show[name]);
    own.addEventListener('click', () => {
      show[name] = !show[name];
      press(own, show[name]);
      app.invalidate(true);
    });
  }
}

/** Presets, follow, and the shot's cameras. @param {App} app */
function cameras(app) {
  for (const name of ['front', 'side', 'top', 'home']) {
    click(`cam-${name}`, () => app.preset(name));
  }
  click('follow', () => app.setFollow(!app.view.follow));
  button('follow').hidden = !app.scene.joints;
  const list = need('camera', HTMLSelectElement);
  list.hidden = !app.scene.cameras.length;
  list.append(make('option', { value: '-1' }, 'Orbit'), ...app.scene.cameras.map(
    ({ name }, i) => make('option', { value: String(i) }, short(name, 40))));
  list.addEventListener('change', () => {
    app.view.shot = Number(list.value);
    app.invalidate();
    app.remember();
  });
}

/** Lists beside the picture. @param {App} app */
function panels(app) {
  const { manifest: { findings = [], notices = [], takes = [], channels = [] } } = app;
  const counts = [findings.length + notices.length, takes.length > 1 ? takes.length : 0, channels.length];
  const panel = need('panel', HTMLElement), narrow = innerWidth < 760;
  let open = narrow ? '' : PANELS[counts.findIndex((x) => x > 0)] ?? '';
  const show = () => {
    panel.hidden = !open;
    for (const name of PANELS) {
      need(`panel-${name}`, HTMLElement).hidden = name !== open;
      press(button(`tab-${name}`), name === open);
    }
    app.resize();
  };
  PANELS.forEach((name, i) => {
    button(`tab-${name}`).append(make('span', { class: 'count' }, counts[i] > 9999 ? '9999+' : String(counts[i])));
    button(`tab-${name}`).hidden = !counts[i];
    click(`tab-${name}`, () => {
      open = open === name ? '' : name;
      show();
    });
  });
  show();
}

/** What the page says of its file. @param {App} app */
export function describe(app) {
  const { source, time, takes = [], errors = {} } = app.manifest;
  const joints = takes.reduce((most, take) => Math.max(most, take.skeleton.names.length), 0);
  need('source', HTMLElement).replaceChildren(...[
    ...source.files.length > 1 ? [`${source.files.length} files`] : [], joints ? `${joints} joints` : '',
    `${time.count} frames`, time.label, `${source.unit}, ${source.up.toUpperCase()} up`,
  ].filter(Boolean).map((text) => make('span', {}, short(text, 40))));
  const { unit } = app.overlay, cell = number(app.overlay.inFile([app.scene.ground.cell, 0, 0])[0], 4);
  const parts = [`grid ${cell} ${unit}`];
  if (errors.position_mm) parts.push(`position ±${number(errors.position_mm, 4)} mm`);
  if (errors.rotation_deg) parts.push(`rotation ±${number(errors.rotation_deg, 4)}°`);
  need('note', HTMLElement).textContent = parts.join(' · ');
}

/** @param {App} app */
function keyboard(app) {
  const { timeline } = app, help = need('help', HTMLDialogElement);
  /** @type {Record<string, () => void>} */
  const keys = {
    ' ': () => timeline.toggle(), ArrowLeft: () => timeline.seek(timeline.sample - 1),
    ArrowRight: () => timeline.seek(timeline.sample + 1), Home: () => timeline.seek(0),
    End: () => timeline.seek(timeline.count - 1), ArrowUp: () => timeline.faster(1),
    ArrowDown: () => timeline.faster(-1), f: () => app.setFollow(!app.view.follow),
    1: () => app.preset('front'), 3: () => app.preset('side'), 7: () => app.preset('top'),
    0: () => app.preset('home'), l: () => timeline.setLoop(!timeline.loop),
    m: () => app.pace.toggle(), '?': () => help.showModal(), Escape: () => app.select(null),
  };
  addEventListener('keydown', (event) => {
    const { target } = event;
    const typing = target instanceof HTMLSelectElement || target instanceof HTMLInputElement && !/range|checkbox/.test(target.type);
    if (help.open || typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const pressed = event.key === ' ' && target instanceof HTMLElement && target.closest('button, a, [type=checkbox]');
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act || pressed && target !== button('play')) return;
    event.preventDefault();
    act();
  });
  click('help-open', () => help.showModal());
  click('simple', () => app.pace.toggle());
  click('help-close', () => help.close());
}

/** @param {App} app */
export function connect(app) {
  for (const part of [theme, toggles, cameras, keyboard, panels]) part(app);
}
