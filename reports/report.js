// What the page of a fit does beyond standing still: figures that answer (readings, switches, zoom), shapes to go through,
// tables that sort. All data is in the block of JSON above (reports/page_data.hpp says what it holds). Where this script does
// not run, the page shows gnuplot's figures instead; prints always do.
(() => {
'use strict';
const block = document.getElementById('run-data');
const D = block ? JSON.parse(block.textContent) : {figures: {}};
const R = D.readings;

const drawing = (() => {
  const template = document.createElement('template');
  template.innerHTML = '<svg></svg>';
  return template.content.firstChild.namespaceURI;
})();
function make(tag, attributes = {}, ...children) {
  const drawn = ['svg', 'path', 'line', 'rect', 'text', 'g', 'clipPath', 'title', 'circle'].includes(tag);
  const element = drawn ? document.createElementNS(drawing, tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes))
    typeof value === 'function' ? element.addEventListener(name, value) : element.setAttribute(name, value);
  element.append(...children);
  return element;
}
const unique = list => [...new Set(list)];
const number = text => text === '' || text === undefined ? NaN : Number(text);
const digits = (v, n = 4) => v === null || !isFinite(v) ? 'not known' : String(+v.toPrecision(n)).replace('-', '−');
const bracketed = (text, unit) => unit ? `${text} [${unit}]` : text;

/// Rows of a CSV text as objects (RFC 4180).
function table_of(text) {
  const rows = [[]];
  for (const [, quoted, plain, end] of text.matchAll(/(?:"((?:[^"]|"")*)"|([^",\n]*))(,|\n|$)/g)) {
    rows[rows.length - 1].push(quoted !== undefined ? quoted.replaceAll('""', '"') : plain);
    if (end === '\n') rows.push([]);
    if (end === '') break;
  }
  const heads = rows.shift();
  return rows.filter(row => row.length === heads.length).map(row => Object.fromEntries(heads.map((h, i) => [h, row[i]])));
}

// ---- Shapes

/// Coordinates of a point.
const n = D.shapes && D.shapes.triangles.length ? 3 : 2;
const space = n === 3 ? taut_space(D.shapes) : null;
const S = n === 3 && !space ? null : D.shapes;
/// Window of all shapes in steps: what is drawn is drawn in one scale.
const extent = S && (() => {
  const low = Array(n).fill(Infinity), high = Array(n).fill(-Infinity);
  const see = list => list.forEach((v, i) => { low[i % n] = Math.min(low[i % n], v); high[i % n] = Math.max(high[i % n], v); });
  S.states.forEach((state, k) => { state.areas.flat().forEach(see); state.cables.forEach(see); see(space ? space.places[k] : state.lines); });
  return {middle: low.map((v, i) => (v + high[i]) / 2), size: low.map((v, i) => Math.max(high[i] - v, 1))};
})();
const resting = S ? S.states.findIndex(state => state.label.startsWith('rest')) : -1;
const size_of = force => Math.hypot(...force);
/// The largest contact force of all states [N]: arrows of all pictures have one scale.
const largest_force = S ? Math.max(0, ...S.states.flatMap(state => state.contacts.map(c => size_of(c.force)))) : 0;
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const whole_view = () => ({x: 0, y: 0, zoom: 1, azimuth: -Math.PI / 4, elevation: 0.5});
/// Unit vectors of a view: to the right, up, towards the viewer. In space the second of the drawing's axes points up.
function directions(view) {
  if (n === 2) return [[1, 0], [0, 1], null];
  const [ca, sa, ce, se] = [Math.cos(view.azimuth), Math.sin(view.azimuth), Math.cos(view.elevation), Math.sin(view.elevation)];
  const top = 'xyz'.indexOf(S.axes[1]), along = (a, b, c) => [0, 1, 2].map(i => [c, a, b][(i - top + 3) % 3]);
  return [along(-sa, ca, 0), along(-se * ca, -se * sa, ce), along(ce * ca, ce * sa, se)];
}

/// Draws a state into `stage` (stage_of()); `view` is the middle in steps, how far it is magnified, and in space from where
/// it is seen.
function draw_shape(stage, k, view) {
  const [canvas, svg] = [stage.querySelector('canvas'), stage.querySelector('svg')];
  const width = stage.clientWidth || 320, margin = 14, foot = 26, [right, up, toward] = directions(view);
  const wide = axis => dot(axis.map(Math.abs), extent.size);
  const height = n === 3 ? Math.round(Math.max(260, Math.min(460, width * 0.6)))
    : Math.max(90, Math.min(460, (width - 2 * margin) / wide(right) * wide(up) + 2 * margin + foot));
  const fit = Math.min((width - 2 * margin) / wide(right), (height - 2 * margin - foot) / wide(up)) * view.zoom;
  svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
  svg.style.height = height + 'px';
  const place = point => {
    const from = point.map((v, i) => v - extent.middle[i]);
    return [width / 2 + fit * (dot(right, from) - view.x), (height - foot) / 2 - fit * (dot(up, from) - view.y)];
  };
  const px = (list, i) => place(list.slice(i, i + n)).map(v => v.toFixed(1)).join(' ');
  const line = (points, close) => {
    let d = '';
    for (let i = 0; i < points.length; i += n) d += (i ? 'L' : 'M') + px(points, i);
    return d + (close ? 'Z' : '');
  };
  const strokes = points => {
    let d = '';
    for (let i = 0; i < points.length; i += 2 * n) d += 'M' + px(points, i) + 'L' + px(points, i + n);
    return d;
  };
  const outline = state => state.areas.flat().map(loop => line(loop, true)).join('') + strokes(state.lines);
  const state = S.states[k], parts = [make('title', {}, `Deformed shape: ${state.label}`)];
  if (space) {
    const colour = name => getComputedStyle(stage).getPropertyValue(name).trim();
    canvas.style.height = height + 'px';
    // The middle stands above the foot, where the length to measure by is.
    space.paint(canvas, k, {right, up, toward, middle: extent.middle, scale: fit, x: view.x, y: view.y - foot / 2 / fit, width, height,
      ink: colour('--edge'), grey: colour('--rest')});
  } else {
    state.areas.forEach((loops, r) => parts.push(make('path', {d: loops.map(l => line(l, true)).join(''),
      fill: S.regions[r] ? S.regions[r].colour : '#ccc'})));
    if (resting >= 0 && resting !== k)
      parts.push(make('path', {d: outline(S.states[resting]), fill: 'none', stroke: 'var(--rest)', 'stroke-dasharray': '3 3'}));
    parts.push(make('path', {d: outline(state), fill: 'none', stroke: 'var(--ink)', 'stroke-linejoin': 'round'}));
  }
  for (const cable of state.cables) parts.push(make('path', {d: line(cable, false), fill: 'none', stroke: 'var(--cable)', 'stroke-width': 2}));
  parts.push(...contact_marks(state, place, [right, up], width));
  // A length to measure by, and where the axes point.
  const raw = 90 / fit * S.step, power = 10 ** Math.floor(Math.log10(raw)), mm = [5, 2, 1].find(f => f * power <= raw) * power;
  const long = mm / S.step * fit, y = height - 9;
  parts.push(make('path', {d: `M12 ${y - 5}V${y}H${12 + long}V${y - 5}`, fill: 'none', stroke: 'var(--soft)', 'stroke-width': 1.5}));
  parts.push(make('text', {x: 18 + long, y: y + 1}, `${+mm.toPrecision(2)} mm`));
  if (space) {
    ['x', 'y', 'z'].forEach((name, c) => {
      const [a, b] = [width - 44 + 26 * right[c], height - 44 - 26 * up[c]];
      parts.push(make('path', {class: 'axis', d: `M${width - 44} ${height - 44}L${a.toFixed(1)} ${b.toFixed(1)}`, stroke: 'var(--soft)'}),
        make('text', {x: (width - 44 + 36 * right[c]).toFixed(1), y: (height - 40 - 36 * up[c]).toFixed(1), 'text-anchor': 'middle'}, name));
    });
  }
  svg.replaceChildren(...parts);
  return fit;
}
/// Where something presses: dots on the boundary, an arrow for the net force of each patch, and the largest force in newtons.
function contact_marks(state, place, [right, up], width) {
  const parts = [], shown = state.contacts.filter(c => size_of(c.force) > 0.02 * largest_force);
  let dots = '', label = null;
  for (const c of state.contacts) {
    for (let i = 0; i < c.places.length; i += n) {
      const [x, y] = place(c.places.slice(i, i + n));
      dots += `M${(x - 1.8).toFixed(1)} ${y.toFixed(1)}a1.8 1.8 0 1 0 3.6 0a1.8 1.8 0 1 0 -3.6 0Z`;
    }
  }
  if (dots) parts.push(make('path', {class: 'touched', d: dots}));
  for (const c of shown) {
    const [x, y] = place(c.at), f = [dot(right, c.force), -dot(up, c.force)].map(v => v / largest_force), long = Math.hypot(...f);
    if (long < 1e-3) continue;  // seen along the force
    const s = (14 + 34 * long) / long, [u, v] = f.map(w => w / long), [a, b] = [x + s * f[0], y + s * f[1]];
    const at = (along, across) => `${(a - along * u - across * v).toFixed(1)} ${(b - along * v + across * u).toFixed(1)}`;
    const d = `M${x.toFixed(1)} ${y.toFixed(1)}L${a.toFixed(1)} ${b.toFixed(1)}M${at(7, 4)}L${at(0, 0)}L${at(7, -4)}`;
    parts.push(make('path', {class: 'force halo', d}), make('path', {class: 'force', d}));
    if (c === shown[0]) label = make('text', {class: 'force-size', x: Math.max(32, Math.min(width - 32, (x + a) / 2)).toFixed(1),
      y: Math.max(12, Math.min(y, b) - 8).toFixed(1), 'text-anchor': 'middle'}, `${digits(size_of(c.force), 3)} N`);
  }
  return label ? [...parts, label] : parts;
}
const contact_text = state => state.contacts.length ? `Contact presses on ${state.contacts.length === 1 ? 'one patch'
  : state.contacts.length + ' patches'}, hardest with ${digits(size_of(state.contacts[0].force), 3)} N.` : '';
/// What shapes are drawn into.
function stage_of(attributes) {
  const svg = make('svg', attributes);
  return make('div', {class: n === 3 ? 'stage in-space' : 'stage'}, ...(space ? [make('canvas', {'aria-hidden': 'true'})] : []), svg);
}

/// What was read in a state.
function readings_text(k) {
  if (!R) return '';
  const texts = [];
  for (const channel of D.channels) {
    const here = R.line.map((_, i) => i).filter(i => R.shape[i] === k && R.channel[i] === channel.id);
    if (!here.length) continue;
    texts.push(`${channel.id}: measured ${here.map(i => digits(R.measured[i])).join(', ')}; fitted ${digits(R.fitted[here[0]])} ${channel.unit}`);
  }
  return texts.join('. ');
}

function show_shapes(figure) {
  const states = S.states.map((_, k) => k).filter(k => k !== resting);
  if (!states.length) return null;
  const rows = unique(states.map(k => S.states[k].row));
  let at = states[0], view = whole_view(), fit = 1, playing = 0;
  const stage = stage_of({role: 'img', tabindex: 0}), svg = stage.querySelector('svg');
  const text = make('output', {'aria-live': 'polite'}), read = make('p', {class: 'note'});
  const in_row = () => states.filter(k => S.states[k].row === S.states[at].row);
  const slider = (name, change) => {
    const input = make('input', {type: 'range', min: 0, step: 1, 'aria-label': name, input: () => { stop(); change(+input.value); }});
    return input;
  };
  const held = slider('what is held', r => {
    const load = in_row().indexOf(at), next = states.filter(k => S.states[k].row === rows[r]);
    go(next[Math.min(load, next.length - 1)]);
  });
  const load = slider('load', c => go(in_row()[c]));
  const held_text = make('output'), play = make('button', {type: 'button', click: () => playing ? stop() : start()}, 'Play');
  function stop() { clearInterval(playing); playing = 0; play.textContent = 'Play'; }
  function start() {
    play.textContent = 'Pause';
    if (at === states[states.length - 1]) go(states[0]);
    playing = setInterval(() => {
      const next = states.indexOf(at) + 1;
      next < states.length ? go(states[next]) : stop();
    }, 450);
  }
  function go(k) {
    at = k;
    const state = S.states[k], row = in_row();
    held.max = rows.length - 1; held.value = rows.indexOf(state.row);
    load.max = row.length - 1; load.value = row.indexOf(k);
    held_text.textContent = state.row || 'nothing';
    text.textContent = state.column || state.label;
    svg.setAttribute('aria-label', `Deformed shape: ${state.label}`);
    read.textContent = [readings_text(k), contact_text(state)].filter(Boolean).join('. ');
    fit = draw_shape(stage, at, view);
  }
  const zoom = factor => { view = factor ? {...view, zoom: Math.max(1, Math.min(200, view.zoom * factor))} : whole_view(); go(at); };
  const turn = (left, down) => {
    view.azimuth -= left;
    view.elevation = Math.max(-1.57, Math.min(1.57, view.elevation + down));
    go(at);
  };
  drag(svg, {touch: n === 3, move: (dx, dy, from, to, e) => {
    if (n === 3 && !e.shiftKey) return turn(0.01 * dx, 0.01 * dy);
    view.x -= dx / fit;
    view.y += dy / fit;
    go(at);
  }});
  svg.addEventListener('keydown', e => {
    const turned = n === 3 && e.shiftKey && {ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, -0.15], ArrowDown: [0, 0.15]}[e.key];
    if (turned) {
      e.preventDefault();
      return turn(...turned);
    }
    const move = {ArrowLeft: -1, ArrowRight: 1}[e.key], factor = {'+': 1.4, '=': 1.4, '-': 1 / 1.4, 0: 0}[e.key];
    if (move) go(states[Math.max(0, Math.min(states.length - 1, states.indexOf(at) + move))]);
    else if (factor !== undefined) zoom(factor);
    else return;
    e.preventDefault();
  });
  const key = make('p', {class: 'note'});
  for (const region of S.regions) key.append(make('i',
      {style: `display:inline-block;width:1.2em;height:.8em;margin:0 .4em;background:${region.colour}`}), region.name);
  if (S.states.some(state => state.cables.length))
    key.append(make('i', {style: 'display:inline-block;width:1.2em;height:.2em;margin:0 .4em .25em .8em;background:var(--cable)'}), 'cable');
  if (largest_force > 0) key.append(make('i', {style: 'display:inline-block;width:1.2em;height:.2em;margin:0 .4em .25em .8em;background:var(--contact)'}),
    `contact: dots where something presses, arrows for the force on the specimen (the longest: ${digits(largest_force, 3)} N)`);
  if (resting >= 0) key.append(make('span', {style: 'margin-left:.8em'}, n === 3 ? 'Grey lines: at rest.' : 'Dashed: at rest.'));
  key.append(n === 3 ? ` To scale${S.states.some(state => state.cables.length || state.contacts.length) ? '; cables and contact are seen through the body' : ''}.` : ` To scale, in the plane of ${S.axes[0]} and ${S.axes[1]}.`);
  if (S.states.length < D.stored) key.append(` ${S.states.length} of ${D.stored} stored shapes (thinned out to keep this file small).`);
  const live = make('div', {class: 'live'}, make('h3', {}, D.before + 'Deformed shapes'),
    ...(rows.length > 1 ? [make('div', {class: 'slide'}, make('span', {}, 'Held'), held, held_text)] : []),
    make('div', {class: 'slide'}, make('span', {}, rows.length > 1 ? 'Load' : 'Condition'), load, text, play),
    make('div', {class: 'panel'}, make('div', {class: 'head'}, make('b', {}, ''), ...zoom_buttons('shapes', zoom)), stage), read, key,
    make('p', {class: 'note'}, (n === 3 ? 'Drag to turn, with Shift to move; Shift and arrow keys turn, too;' : 'Drag to move;') +
      ' arrow keys go through the conditions, + and − zoom, 0 shows all.'));
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => go(at));
  attach(figure, live, () => go(at));
  return go;
}

/// Shows `live` in the place of a figure's picture, and draws it again whenever its width changes.
function attach(figure, live, draw) {
  figure.insertBefore(live, figure.querySelector('.picture'));
  figure.classList.add('has-live');
  let width = 0;
  const again = () => { if (live.clientWidth !== width) { width = live.clientWidth; draw(); } };
  again();
  new ResizeObserver(again).observe(live);
}
function zoom_buttons(name, zoom) {
  return [['+', 1.4, 'larger'], ['−', 1 / 1.4, 'smaller'], ['all', 0, 'everything']].map(([text, factor, what]) =>
    make('button', {type: 'button', 'aria-label': `${name}: ${what}`, click: () => zoom(factor)}, text));
}
/// Reports drags of a mouse or a pen: move(dx, dy, from, to) while it lasts, done(from, to) at its end, tap(at, event) where it did not move.
/// Fingers scroll the page and tap; with `touch` they drag sideways, too.
function drag(svg, {move, done, tap, touch = false}) {
  let from = null, last = null;
  const place = e => { const box = svg.getBoundingClientRect(); return [e.clientX - box.left, e.clientY - box.top]; };
  svg.addEventListener('pointerdown', e => {
    from = last = place(e);
    if (touch || e.pointerType !== 'touch') svg.setPointerCapture(e.pointerId);
  });
  svg.addEventListener('pointermove', e => {
    if (!from || !e.buttons || (e.pointerType === 'touch' && !touch)) return;
    const to = place(e);
    if (move) move(to[0] - last[0], to[1] - last[1], from, to, e);
    last = to;
  });
  svg.addEventListener('pointerup', e => {
    if (!from) return;
    const to = place(e), far = Math.hypot(to[0] - from[0], to[1] - from[1]) > 6;
    if (far && done && e.pointerType !== 'touch') done(from, to);
    if (!far && tap) tap(to, e);
    from = null;
  });
  svg.addEventListener('pointercancel', () => { from = null; });
}

// ---- Charts

/// Marks of trials, around (0, 0).
const kMarks = ['M-4 0A4 4 0 1 1 4 0A4 4 0 1 1 -4 0Z', 'M-3.6 -3.6H3.6V3.6H-3.6Z', 'M0 -4.6L4.4 3.4H-4.4Z', 'M0 -5L4.4 0L0 5L-4.4 0Z',
  'M0 4.6L4.4 -3.4H-4.4Z', 'M0 -4.6L4.4 -1.4L2.7 3.8H-2.7L-4.4 -1.4Z'];
const kCross = 'M-4 -4L4 4M-4 4L4 -4';

/// The reading that a line of a figure's table shows, by what is written there.
const reading_of = R ? (() => {
  const index = new Map(R.line.map((line, i) => [[line, R.trial[i], R.channel[i]].join('\n'), i]));
  return row => index.get([row.line, row.trial, row.channel].join('\n'));
})() : () => undefined;

/// Residuals in standard deviations, of readings that have them.
const scaled_misses = (title, x, place) => ({title, y: '(measured − fitted) / σ', x, expected: 1.96, zero_line: true,
  item: (r, i) => ({x: place(r, i), y: number(r.normalised_residual), y0: number(r.normalised_residual) - 1,
      y1: number(r.normalised_residual) + 1})});

/// What each figure draws, of its table, one panel per channel and entry: x and y, ends of bars, what stands at the axes.
const kFigures = {
  force_displacement(rows, heads) {
    const [value, sigma, low, high] = heads.slice(6);
    return [{title: 'Force and ' + (value === 'value' ? 'readings' : value.replace(/_.*/, '')), y: bracketed(D.load.label, D.load.unit),
      x: channel => bracketed(channel.label, channel.unit), zero: true,
      item: r => ({x: number(r[value]), y: number(r.load_N), x0: r.kind === 'reading' ? r[value] - r[sigma] : number(r[low]),
          x1: r.kind === 'reading' ? +r[value] + +r[sigma] : number(r[high])})}];
  },
  residuals(rows, heads) {
    const loads = rows.some(r => r.load_N !== '');
    const title = 'What the fitted model misses', x = () => loads ? bracketed(D.load.label, D.load.unit) : 'reading', [miss, sigma] = heads.slice(5);
    return [{title, y: channel => bracketed('measured − fitted', channel.unit), x, zero_line: true,
      item: (r, i) => ({x: loads ? number(r.load_N) : i + 1, y: number(r[miss]), y0: number(r[miss]) - number(r[sigma]),
          y1: number(r[miss]) + number(r[sigma])})}, scaled_misses(title, x, (r, i) => loads ? number(r.load_N) : i + 1)];
  },
  effective_stiffness() {
    return [{title: 'Effective stiffness', y: 'force / displacement [N/m]', x: () => bracketed(D.load.label, D.load.unit), logarithmic: true,
      item: r => ({x: number(r.load_N), y: number(r.kind === 'at_least' ? r.band_lower_N_per_m : r.stiffness_N_per_m),
          y0: number(r.band_lower_N_per_m), y1: number(r.band_upper_N_per_m),
        text: r.kind === 'at_least' ? `stiffness at least ${digits(+r.band_lower_N_per_m)} N/m` : r.stiffness_N_per_m && `stiffness ${digits(+r.stiffness_N_per_m)} ± ${digits(number(r.sigma_N_per_m), 2)} N/m`})}];
  },
  stress_strain() {
    return [{title: 'Stress and strain', y: 'stress [kPa]', x: () => 'engineering strain', zero: true,
      item: r => ({x: number(r.strain), y: number(r.stress_kPa), y0: r.kind === 'reading' ? r.stress_kPa - r.sigma_kPa : number(r.band_lower_kPa),
          y1: r.kind === 'reading' ? +r.stress_kPa + +r.sigma_kPa : number(r.band_upper_kPa)})},
      scaled_misses('What this fit misses', () => 'engineering strain', r => number(r.strain))];
  },
  search_history(rows) {
    const unit_of = Object.fromEntries(rows.map(r => [r.channel, r.unit]));
    return [{title: 'The way of the search', y: channel => bracketed(channel.id, unit_of[channel.id]), x: () => 'evaluation of the model',
      logarithmic: true, whole: true, heading: id => id, what: 'evaluations',
      item: r => ({kind: r.kind === 'evaluation' ? 'reading' : 'line', x: number(r.evaluation), y: number(r.value),
        text: `evaluation ${r.evaluation}, ${r.phase}\n${r.channel} ${digits(+r.value)} ${r.unit}`.trim()})}];
  },
};

function range_of(values, zero) {
  const real = values.filter(isFinite);
  if (zero) real.push(0);
  if (!real.length) return [0, 1];
  let low = Infinity, high = -Infinity;
  for (const v of real) { low = Math.min(low, v); high = Math.max(high, v); }
  const room = (high - low || Math.abs(high) || 1) * 0.06;
  return [zero && low === 0 ? 0 : low - room, zero && high === 0 ? 0 : high + room];
}
function tics_of(low, high, most, logarithmic) {
  if (logarithmic && high / low > 8) {
    const out = [];
    for (let e = Math.floor(Math.log10(low)); e <= Math.log10(high); ++e) for (const f of [1, 2, 5]) out.push(f * 10 ** e);
    return out.filter(v => v >= low && v <= high);
  }
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw)), step = [1, 2, 5, 10].map(f => f * power).find(s => s >= raw);
  const out = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; ++k) out.push(+(k * step).toPrecision(12));
  return out;
}

function show_chart(figure, name, go_to_shape) {
  const text = D.figures[name], rows = table_of(text), heads = text.slice(0, text.indexOf('\n')).split(',');
  const specs = kFigures[name](rows, heads), title = specs[0].title;
  for (const spec of specs) {
    spec.items = rows.map((row, i) => ({kind: 'reading', ...row, channel: row.channel ?? row.mode, trial: row.trial ?? '', ...spec.item(row,
        i)})).filter(p => isFinite(p.x) && isFinite(p.y));
    for (const p of spec.items) {
      p.point = ['reading', 'excluded', 'at_least'].includes(p.kind);
      if (p.point) p.reading = reading_of(p);
      if (p.reading !== undefined && R.excluded[p.reading]) p.kind = 'excluded';
    }
  }
  const items = specs[0].items;
  if (!items.length) return;
  const channels = unique(items.map(p => p.channel)), series = unique(items.map(p => p.series)),
      trials = unique(items.filter(p => p.point).map(p => p.trial));
  const colour = p => `var(--c${(series.length > 1 ? series.indexOf(p.series) : channels.indexOf(p.channel)) % 7})`;
  const hidden = new Set(),
      hides = p => hidden.has('series ' + p.series) || (p.point && hidden.has('trial ' + p.trial)) || (p.kind === 'start' && hidden.has('start')) || (p.kind === 'trend' && hidden.has('trend'));
  const pinned = make('div', {class: 'pinned', hidden: ''});
  const rows_of_panels = specs.map((spec, s) => channels.filter(id => spec.items.some(p => p.channel === id)).map(id => make_panel(spec, s, id)));
  const panels = rows_of_panels.flat();

  function make_panel(spec, s, id) {
    const mine = spec.items.filter(p => p.channel === id), channel = (D.channels || []).find(c => c.id === id) || {id, label: id, unit: ''};
    const curves = new Map();
    for (const p of mine) if (!p.point) curves.set(p.kind + '\n' + p.series, [...(curves.get(p.kind + '\n' + p.series) || []), p]);
    const points = mine.filter(p => p.point);
    // A long bar of one poor reading does not squeeze the rest.
    const ys = mine.map(p => p.y), positive = ys.every(y => y > 0),
        logarithmic = Boolean(spec.logarithmic) && positive && Math.max(...ys) / Math.min(...ys) > 8;
    const whole = () => {
      const shown = mine.filter(p => !hides(p) && p.kind !== 'start'), from = shown.length ? shown : mine;
      const [x0, x1] = range_of(from.flatMap(p => p.point ? [p.x, p.x0 ?? NaN, p.x1 ?? NaN] : [p.x]), spec.zero || name !== 'force_displacement');
      let [y0, y1] = range_of(from.map(p => p.y).concat(spec.expected ? [-2.6, 2.6] : spec.zero_line ? [0] : []), spec.zero);
      const room = 0.4 * (y1 - y0), bars = from.filter(p => p.point && isFinite(p.y0)).flatMap(p => [p.y0, p.y1]);
      if (!logarithmic) [y0, y1] = [Math.max(y0 - room, Math.min(y0, ...bars)), Math.min(y1 + room, Math.max(y1, ...bars))];
      if (logarithmic) { const real = from.map(p => p.y); y0 = Math.min(...real) / 1.2; y1 = Math.max(...real) * 1.2; }
      return {x0, x1, y0, y1};
    };
    let view = null, map = null, chosen = -1, band = null;
    const svg = make('svg', {tabindex: 0, role: 'group', 'aria-roledescription': 'chart',
      'aria-label': `${spec.title}, ${id}: ${points.length} ${spec.what || 'readings'}. Arrow keys go from one to the next, ${go_to_shape && !spec.what ? 'Enter shows the shape, ' : ''}+ and − zoom, 0 shows all.`});
    const tip = make('div', {class: 'tip', 'aria-live': 'polite', hidden: ''});
    const clip = `clip-${name}-${s}-${channels.indexOf(id)}`;
    const seen = () => points.filter(p => !hides(p));

    function draw() {
      const v = view || whole(), width = Math.max(svg.clientWidth, 240), height = Math.round(Math.max(230, Math.min(360, width * 0.66)));
      const longest = Math.max(...tics_of(v.y0, v.y1, 6, logarithmic).map(y => digits(y, 6).length));
      const left = Math.max(52, 24 + 7.4 * longest), right = width - 10, top = 8, bottom = height - 42;
      svg.setAttribute('viewBox', `0 0 ${width} ${height}`);
      svg.style.height = height + 'px';
      const f = logarithmic ? Math.log : y => y;
      const X = x => left + (x - v.x0) / (v.x1 - v.x0) * (right - left), Y = y => bottom - (f(y) - f(v.y0)) / (f(v.y1) - f(v.y0)) * (bottom - top);
      map = {X, Y, v, left, right, top, bottom, inverse: (px, py) => {
        const t = f(v.y0) + (bottom - py) / (bottom - top) * (f(v.y1) - f(v.y0));
        return [v.x0 + (px - left) / (right - left) * (v.x1 - v.x0), logarithmic ? Math.exp(t) : t];
      }};
      const parts = [], inside = make('g', {'clip-path': `url(#${clip})`});
      const axis = (d, c = 'var(--line)') => make('path', {d, stroke: c, fill: 'none'});
      parts.push(make('clipPath', {id: clip}, make('rect', {x: left, y: top, width: right - left, height: bottom - top})));
      if (spec.expected) parts.push(make('rect', {x: left, width: right - left, y: Math.max(top, Y(spec.expected)), height: Math.max(0,
          Math.min(bottom, Y(-spec.expected)) - Math.max(top, Y(spec.expected))), fill: 'var(--rest)', opacity: .2}));
      for (const x of tics_of(v.x0, v.x1, width > 420 ? 7 : 5)) parts.push(axis(`M${X(x)} ${top}V${bottom}`), make('text', {x: X(x), y: bottom + 16,
          'text-anchor': 'middle'}, digits(x, 6)));
      for (const y of tics_of(v.y0, v.y1, 6, logarithmic)) parts.push(axis(`M${left} ${Y(y)}H${right}`), make('text', {x: left - 6, y: Y(y) + 4,
          'text-anchor': 'end'}, digits(y, 6)));
      parts.push(axis(`M${left} ${top}V${bottom}H${right}`, 'var(--strong)'));
      parts.push(make('text', {x: (left + right) / 2, y: height - 8, 'text-anchor': 'middle'}, spec.x(channel)));
      const middle = (top + bottom) / 2;
      parts.push(make('text', {x: 12, y: middle, transform: `rotate(-90 12 ${middle})`, 'text-anchor': 'middle'},
          (typeof spec.y === 'function' ? spec.y(channel) : spec.y) + (logarithmic ? ', logarithmic' : '')));
      const near = (a, low, high) => Math.min(high + 1e4, Math.max(low - 1e4, a)).toFixed(1);
      const at = (x, y) => `${near(X(x), left, right)} ${near(Y(logarithmic ? Math.max(y, 1e-9 * v.y0) : y), top, bottom)}`;
      const path = list => list.map(([x, y], i) => (i ? 'L' : 'M') + at(x, y)).join('');
      if (spec.zero_line) inside.append(make('path', {d: path([[v.x0, 0], [v.x1, 0]]), stroke: 'var(--ink)'}));
      for (const list of curves.values()) {
        if (hides(list[0])) continue;
        const c = colour(list[0]), along_x = 'x0' in list[0], bounded = list.filter(p => isFinite(along_x ? p.x0 : p.y0));
        if (bounded.length && list[0].kind === 'curve') {
          const lower = bounded.map(p => along_x ? [p.x0, p.y] : [p.x, p.y0]), upper = bounded.map(p => along_x ? [p.x1, p.y] : [p.x, p.y1]);
          inside.append(make('path', {d: path(lower.concat(upper.reverse())) + 'Z', fill: c, opacity: .22}));
        }
        const dashes = {trend: '6 4', start: '2 4'}[list[0].kind];
        inside.append(make('path', {d: path(list.map(p => [p.x, p.y])), fill: 'none', stroke: c, 'stroke-width': 1.8,
            ...(dashes ? {'stroke-dasharray': dashes} : {})}));
      }
      for (const p of points) {
        if (hides(p)) continue;
        const out = p.kind === 'excluded', c = out ? 'var(--rest)' : colour(p);
        if (p.kind === 'reading' && isFinite(p.x0)) inside.append(make('path', {d: `M${at(p.x0, p.y)}L${at(p.x1, p.y)}`, stroke: c}));
        if (p.kind === 'reading' && isFinite(p.y0)) inside.append(make('path', {d: `M${at(p.x, p.y0)}L${at(p.x, p.y1)}`, stroke: c}));
        if (p.kind === 'at_least') inside.append(make('path', {d: `M${at(p.x, p.y)}v-18m-4 6l4 -6l4 6`, stroke: c, fill: 'none',
            'stroke-width': 1.4}));
        inside.append(make('path', {d: out ? kCross : kMarks[Math.max(0, trials.indexOf(p.trial)) % kMarks.length],
            transform: `translate(${at(p.x, p.y)})`,
          fill: p === points[chosen] || p.phase === 'cold replay' ? c : 'var(--paper)', 'fill-opacity': p === points[chosen] ? 1 : .55, stroke: c,
              'stroke-width': p === points[chosen] ? 3 : 1.4}));
      }
      parts.push(inside);
      if (band) parts.push(make('rect', {x: Math.min(band[0][0], band[1][0]), y: Math.min(band[0][1], band[1][1]),
          width: Math.abs(band[1][0] - band[0][0]), height: Math.abs(band[1][1] - band[0][1]), fill: 'var(--accent)', opacity: .15}));
      svg.replaceChildren(...parts);
    }

    function say(k) {
      if (k === chosen) return;
      chosen = k;
      draw();
      tip.hidden = k < 0;
      if (k < 0) return;
      const p = points[k], i = p.reading, lines = [];
      if (i === undefined) p.text || lines.push(`${digits(p.x)}, ${digits(p.y)}`);
      else {
        const unit = channel.unit ? ' ' + channel.unit : '', residual = R.measured[i] - R.fitted[i];
        lines.push(`line ${R.line[i]}${R.trial[i] ? ', trial ' + R.trial[i] : ''}, ${R.channel[i]}`, R.setting[i],
          `measured ${digits(R.measured[i])} ± ${digits(R.sigma[i], 2)}${unit}`);
        if (R.fitted[i] === null) lines.push('nothing predicts it');
        else lines.push(`fitted ${digits(R.fitted[i])}${unit}`, `residual ${digits(residual, 3)}${unit} (${digits(residual / R.sigma[i], 3)} σ)`);
        if (R.excluded[i]) lines.push('not fitted');
      }
      if (p.text) lines.push(p.text);
      if (i !== undefined && R.shape[i] >= 0) lines.push('click or Enter: its shape');
      tip.textContent = lines.filter(Boolean).join('\n');
      const x = map.X(p.x), y = map.Y(p.y), w = svg.clientWidth, wide = tip.offsetWidth,
          head = svg.getBoundingClientRect().top - svg.parentElement.getBoundingClientRect().top;
      tip.style.left = Math.max(0, Math.min(w - wide, x > w / 2 ? x - wide - 12 : x + 12)) + 'px';
      tip.style.top = head + Math.max(0, Math.min(svg.clientHeight - tip.offsetHeight, y - tip.offsetHeight / 2)) + 'px';
    }
    function nearest(x, y) {
      let best = -1, least = 26;
      points.forEach((p, k) => {
        const far = Math.hypot(map.X(p.x) - x, map.Y(p.y) - y);
        if (!hides(p) && far < least) { least = far; best = k; }
      });
      return best;
    }
    const pin = k => { if (k >= 0 && points[k].reading !== undefined) pin_shape(points[k].reading); };
    function zoom(factor) {
      if (!factor) view = null;
      else {
        const v = map.v, [cx, cy] = map.inverse((map.left + map.right) / 2, (map.top + map.bottom) / 2), k = 1 / factor;
        const [ax, ay] = map.inverse((map.left + map.right) / 2 - k * (map.right - map.left) / 2,
            (map.top + map.bottom) / 2 + k * (map.bottom - map.top) / 2);
        const [bx, by] = map.inverse((map.left + map.right) / 2 + k * (map.right - map.left) / 2,
            (map.top + map.bottom) / 2 - k * (map.bottom - map.top) / 2);
        view = [cx, cy, ax, ay, bx, by].every(isFinite) ? {x0: ax, x1: bx, y0: ay, y1: by} : v;
      }
      say(-1);
      draw();
    }
    svg.addEventListener('pointermove', e => {
      if (e.buttons) return;
      const box = svg.getBoundingClientRect();
      say(nearest(e.clientX - box.left, e.clientY - box.top));
    });
    svg.addEventListener('pointerleave', e => { if (e.pointerType !== 'touch') say(-1); });
    svg.addEventListener('blur', () => say(-1));
    svg.addEventListener('dblclick', () => zoom(0));
    drag(svg, {
      move: (dx, dy, from, to) => { band = [from, to]; draw(); },
      done: (from, to) => {
        band = null;
        if (Math.abs(to[0] - from[0]) > 8 && Math.abs(to[1] - from[1]) > 8) {
          const [ax, ay] = map.inverse(...from), [bx, by] = map.inverse(...to);
          view = {x0: Math.min(ax, bx), x1: Math.max(ax, bx), y0: Math.min(ay, by), y1: Math.max(ay, by)};
        }
        draw();
      },
      tap: ([x, y]) => { band = null; const k = nearest(x, y); say(k); pin(k); },
    });
    svg.addEventListener('keydown', e => {
      const list = seen(), move = {ArrowRight: 1, ArrowLeft: -1}[e.key], factor = {'+': 1.4, '=': 1.4, '-': 1 / 1.4, 0: 0}[e.key];
      if (move && list.length) {
        const now = list.indexOf(points[chosen]);
        say(points.indexOf(list[now < 0 ? (move > 0 ? 0 : list.length - 1) : (now + move + list.length) % list.length]));
      } else if (e.key === 'Enter') pin(chosen);
      else if (e.key === 'Escape') say(-1);
      else if (factor !== undefined) zoom(factor);
      else return;
      e.preventDefault();
    });
    const box = make('div', {class: 'panel'}, make('div', {class: 'head'}, make('b', {}, spec.heading ? spec.heading(id) : channels.length > 1 || id ? `Channel ${id}` : ''),
        ...zoom_buttons(`${spec.title}, ${id}`, zoom)), svg, tip);
    return {box, draw: () => { say(-1); draw(); }};
  }

  function pin_shape(reading) {
    const k = R.shape[reading];
    if (k < 0) return;
    const stage = stage_of({role: 'img', 'aria-label': `Deformed shape: ${S.states[k].label}`});
    const away = make('button', {type: 'button', 'aria-label': 'close the shape', click: () => { pinned.hidden = true; }}, '×');
    pinned.replaceChildren(make('div', {class: 'head'}, make('b', {}, `Shape: ${S.states[k].label}`), away), stage);
    pinned.hidden = false;
    draw_shape(stage, k, whole_view());
    if (go_to_shape) go_to_shape(k);
  }

  const redraw = () => panels.forEach(panel => panel.draw());
  const switches = make('div', {class: 'switches', role: 'group', 'aria-label': `${title}: what is shown`});
  function add_switch(key, label, mark) {
    const button = make('button', {type: 'button', 'aria-pressed': 'true', click: () => {
      hidden.has(key) ? hidden.delete(key) : hidden.add(key);
      button.setAttribute('aria-pressed', String(!hidden.has(key)));
      redraw();
    }}, ...(mark ? [mark] : []), label);
    switches.append(button);
  }
  if (series.length > 1) series.forEach((s, i) => add_switch('series ' + s, s || (name === 'stress_strain' ? 'readings' : '(none)'), make('i',
      {style: `background:var(--c${i % 7})`})));
  if (trials.length > 1 && trials.length < 13)
    trials.forEach((t, i) => add_switch('trial ' + t, 'trial ' + t, make('svg', {viewBox: '-7 -7 14 14', 'aria-hidden': 'true',
        style: 'width:14px;height:14px;display:inline-block;vertical-align:-2px;margin-right:4px'},
      make('path', {d: kMarks[i % kMarks.length], fill: 'none', stroke: 'currentColor', 'stroke-width': 1.4}))));
  for (const [kind, label] of [['start', 'where the fit started'], ['trend', 'trend, no model']])
    if (items.some(p => p.kind === kind)) add_switch(kind, label, make('i', {style: 'border-top:2px dashed currentColor;height:0'}));
  const live = make('div', {class: 'live'}, make('h3', {}, D.before + title), switches, ...rows_of_panels.map(row => make('div', {class: 'panels'},
      ...row.map(p => p.box))),
    make('p', {class: 'note'},
        (specs[0].what ? 'Point at an evaluation for its value;' : 'Point at a reading for its line and residual;') + ' drag a rectangle to zoom, double-click to see all.' +
        (!specs[0].what && S && R && R.shape.some(k => k >= 0) ? ' Click a reading for its shape.' : '')), pinned);
  attach(figure, live, redraw);
}

// ---- Tables

/// The number that a cell begins with, its unit's prefix counted: "470 Pa" stands before "1.2 kPa".
function value_of(text) {
  const found = /^[<>≤≥~]?\s*([+\-−]?\d+(?:\.\d+)?(?:e[+-]?\d+)?)\s*(?:±\s*\S+\s*)?([^\s\d]*)/i.exec(text.trim());
  if (!found) return null;
  const prefix = {T: 1e12, G: 1e9, M: 1e6, k: 1e3, m: 1e-3, u: 1e-6, µ: 1e-6, n: 1e-9}, unit = found[2];
  const scaled = unit.length > 1 && /^[TGMkmuµn](Pa|N|m|g|s|J|Nm|Hz)\b/.test(unit) ? prefix[unit[0]] : 1;
  return Number(found[1].replace('−', '-')) * scaled;
}
function make_sortable(table) {
  const heads = [...table.querySelectorAll('thead th')], body = table.tBodies[0];
  if (!heads.length || !body || body.rows.length < 3 || table.closest('#correlations')) return;
  heads.forEach((head, c) => {
    if (!head.textContent) return;
    const button = make('button', {type: 'button', click: () => {
      const down = head.getAttribute('aria-sort') === 'ascending';
      heads.forEach(h => h.removeAttribute('aria-sort'));
      head.setAttribute('aria-sort', down ? 'descending' : 'ascending');
      const keyed = [...body.rows].map(row => ({row, text: row.cells[c] ? row.cells[c].textContent : '',
          value: value_of(row.cells[c] ? row.cells[c].textContent : '')}));
      const by_number = keyed.some(k => k.value !== null) && head.classList.contains('n');
      // What is no number stands last either way.
      keyed.sort((a, b) => {
        if (by_number && (a.value === null || b.value === null)) return (a.value === null) - (b.value === null);
        const order = by_number ? a.value - b.value : a.text.localeCompare(b.text, 'en', {numeric: true});
        return down ? -order : order;
      });
      body.append(...keyed.map(k => k.row));
    }}, ...head.childNodes);
    head.append(button);
  });
}

/// Correlations as a map: the stronger, the darker.
function colour_correlations(table) {
  for (const cell of table.querySelectorAll('td')) {
    const value = Number(cell.textContent);
    if (isFinite(value)) cell.style.background = `rgba(${value < 0 ? '213,94,0' : '0,114,178'},${(0.6 * Math.min(1, Math.abs(value))).toFixed(2)})`;
    cell.style.paddingLeft = '.8rem';
  }
}

const shapes_figure = document.getElementById('figure-deformed_shapes');
const go_to_shape = S && shapes_figure ? show_shapes(shapes_figure) : null;
for (const name of Object.keys(kFigures)) {
  const figure = document.getElementById('figure-' + name);
  if (figure && D.figures[name]) show_chart(figure, name, go_to_shape);
}
document.querySelectorAll('#correlations table').forEach(colour_correlations);
document.querySelectorAll('table').forEach(make_sortable);
})();
