// Copyright 2026 The pfd_ros authors
// SPDX-License-Identifier: Apache-2.0
// Draws the curves of a page; pfd_ros/page/curves.py encodes them.
'use strict';
const place = (id) => document.getElementById(id);
const root = document.documentElement, box = place('plots');
const data = JSON.parse(place('data').textContent), plots = [];

// Colours: classes of page.css. A canvas takes no light-dark(), but the computed colour of a text.
const computed = {};
function colour(name) {
  if (!computed[name]) {
    const probe = document.createElement('i');
    probe.className = name; probe.hidden = true;
    document.body.append(probe);
    computed[name] = getComputedStyle(probe).color;
    probe.remove();
  }
  return computed[name];
}
const dark = matchMedia('(prefers-color-scheme: dark)');
function repaint() {
  for (const name of Object.keys(computed)) delete computed[name];
  for (const u of plots) u.redraw(false, true);
}
dark.addEventListener('change', repaint);
place('theme').onclick = () => {
  const now = root.style.colorScheme || (dark.matches ? 'dark' : 'light');
  root.style.colorScheme = now === 'dark' ? 'light' : 'dark';
  repaint();
};

async function numbers(text, kind) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0)), size = kind.BYTES_PER_ELEMENT;
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const n = planes.length / size, out = new Uint8Array(planes.length);
  for (let k = 0; k < size; k++) for (let i = 0; i < n; i++) out[i * size + k] = planes[k * n + i];
  return new kind(out.buffer);
}

// All plots show the same time.
let zooming = false;
function zoom(min, max) {
  if (zooming) return;
  zooming = true;
  for (const u of plots) u.setScale('x', { min, max });
  zooming = false;
}
const [start, end] = data.span, margin = Math.max(1e-3, 0.01 * (end - start));
const all = () => zoom(start - margin, end + margin);
function around(time) {
  const half = Math.max(0.02 * (end - start), Math.min(0.5, end - start));
  zoom(time - half, time + half);
}

// A joint has one colour in all plots.
const names = [...new Set(data.plots.filter((p) => p.joints).flatMap((p) => p.labels))], shown = new Set(names);
const index = (p, label, k) => (p.joints ? names.indexOf(label) : k);
function select(name, add) {
  if (add) { if (!shown.delete(name)) shown.add(name); }
  else if (shown.size === 1 && shown.has(name)) names.forEach((x) => shown.add(x));
  else { shown.clear(); shown.add(name); }
  for (const button of place('joints').children) button.classList.toggle('off', !shown.has(button.textContent));
  for (const u of plots) {
    if (u.pfd?.joints) u.batch(() => u.pfd.curves.forEach((c, i) => u.setSeries(i + 1, { show: shown.has(c.label) })));
  }
}
names.forEach((name, k) => {
  const button = document.createElement('button'), line = document.createElement('i');
  line.className = `line k${k % 8}`;
  button.append(line, name);
  button.onclick = (event) => select(name, event.shiftKey || event.ctrlKey);
  place('joints').append(button);
});

function line(u, x0, y0, x1, y1, name, dash) {
  const c = u.ctx, r = devicePixelRatio;
  c.save(); c.strokeStyle = colour(name); c.lineWidth = r; c.setLineDash(dash.map((x) => x * r));
  c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1, y1); c.stroke(); c.restore();
}
function moments(u) {
  const { left, top, width, height } = u.bbox, c = u.ctx, r = devicePixelRatio;
  const at = (time) => Math.min(Math.max(u.valToPos(time, 'x', true), left - 2), left + width + 2);
  const draw = (time, name, label) => {
    const x = at(time);
    if (x < left || x > left + width) return;
    line(u, x, top, x, top + height, name, [4, 3]);
    if (u !== plots[0] || !label) return;
    c.save(); c.fillStyle = colour(name); c.font = `600 ${11 * r}px system-ui, sans-serif`; c.textBaseline = 'bottom';
    c.textAlign = x > left + width / 2 ? 'right' : 'left';
    c.fillText(label, x, top - 2 * r); c.restore();
  };
  for (const [time, until, label, severity] of data.marks) {
    const name = severity === 'bad' ? 'mark' : 'note';
    if (until > time) {
      c.save(); c.globalAlpha = 0.15; c.fillStyle = colour(name);
      c.fillRect(at(time), top, at(until) - at(time), height); c.restore();
    }
    draw(time, name, label);
  }
  if (data.first !== null && data.marks.every((m) => m[0] !== data.first)) draw(data.first, 'bad', 'first problem');
}
function limits(u) {
  if (shown.size !== 1) return;
  const { left, top, width, height } = u.bbox;
  u.pfd.limits.forEach((side) => side.forEach((value, k) => {
    if (value === null || !shown.has(u.pfd.labels[k])) return;
    const y = u.valToPos(value, 'y', true);
    if (y >= top && y <= top + height) line(u, left, y, left + width, y, 'bad', [2, 4]);
  }));
}

const short = (x) => (x === null || x === undefined ? '–' : x === 0 ? '0' : Math.abs(x) >= 1e5 || Math.abs(x) < 1e-4 ? x.toExponential(2) : String(+x.toPrecision(5)));
// As uPlot's own, which shows a curve that is 0 throughout up to 100.
const range = (_, low, high) => (low === null ? [low, high] : low === high ? [low - 1, high + 1] : uPlot.rangeNum(low, high, 0.1, true));
const axis = (extra) => ({
  stroke: () => colour('soft'), grid: { stroke: () => colour('grid'), width: 1 }, ticks: { stroke: () => colour('grid'), size: 4 },
  font: '11px system-ui, sans-serif', ...extra,
});
function options(height, top, extra) {
  return {
    width: box.clientWidth - 18, height, padding: [top, 14, 0, 0], legend: { show: false },
    cursor: {
      y: false, points: { size: 5 }, drag: { x: true, y: false }, sync: { key: 'pfd', setSeries: false, scales: ['x', null] },
      bind: { dblclick: () => () => { all(); return null; } },
    },
    ...extra,
    hooks: { ...extra.hooks, setScale: [(u, key) => { if (key === 'x') zoom(u.scales.x.min, u.scales.x.max); }] },
  };
}
function frame(title, source) {
  const section = document.createElement('section'), head = document.createElement('h3'), from = document.createElement('small');
  section.className = 'plot';
  from.textContent = source;
  head.append(title, from);
  section.append(head);
  return [box.appendChild(section), head];
}

function timeline() {
  const lanes = Object.entries(data.lanes), count = lanes.length;
  if (!count) return;
  const draw = (u) => lanes.forEach(([, spans], k) => spans.forEach(([from, to, severity]) => {
    const x = u.valToPos(from, 'x', true), y = u.valToPos(count - k - 0.5, 'y', true), r = devicePixelRatio;
    const stop = Math.min(u.valToPos(to, 'x', true), u.bbox.left + u.bbox.width), left = Math.max(x - r, u.bbox.left);
    u.ctx.fillStyle = colour(severity);
    if (stop >= left) u.ctx.fillRect(left, y - 6 * r, Math.max(2.5 * r, stop - left), 12 * r);
  }));
  plots.push(new uPlot(options(48 + 19 * count, 18, {
    scales: { x: { time: false }, y: { range: [0, count] } }, series: [{}, {}],
    axes: [axis({ size: 26 }), axis({ size: 110, grid: { show: false }, ticks: { show: false },
      splits: () => lanes.map((_, k) => count - k - 0.5), values: () => lanes.map(([kind]) => kind) })],
    hooks: { draw: [draw, moments] },
  }), [[start, Math.max(end, start + 1e-6)], [null, null]], frame('What happened, and when', data.origin)[0]));
}

async function chart(p) {
  const steps = await numbers(p.time, Uint32Array), flat = await numbers(p.values, Float32Array);
  const n = steps.length, time = new Float64Array(n);
  for (let i = 0, t = 0; i < n; i++) { t += steps[i]; time[i] = p.start + 1e-6 * t; }
  // A reference and the ends of its tolerance follow the curves that were measured.
  p.curves = [...p.labels.map((label) => ({ label })), ...p.references.map(([label, kind]) => ({ label, kind }))];
  const columns = p.curves.map((_, k) => Array.from(flat.subarray(k * n, (k + 1) * n), (x) => (isFinite(x) ? x : null)));
  const [section, head] = frame(p.title, p.source), readout = document.createElement('span');
  readout.className = 'readout';
  head.append(readout);
  const paths = p.stepped ? uPlot.paths.stepped({ align: 1 }) : undefined;
  const hue = (c, k) => `k${index(p, c.label, k) % 8}`;
  const show = (u) => {
    const i = u?.cursor.left >= 0 ? u.cursor.idx ?? -1 : -1;
    readout.textContent = i < 0 ? '' : `${time[i].toFixed(4)} s`;
    p.labels.forEach((label, k) => {
      if ((p.joints && (i < 0 || !shown.has(label))) || readout.childElementCount > 8) return;
      const cell = document.createElement('b');
      cell.className = hue({ label }, k); cell.title = label;
      cell.textContent = `${p.joints ? '' : label} ${i < 0 ? '' : short(columns[k][i])}`;
      readout.append(cell);
    });
  };
  show();
  const band = (k) => ({ series: [k + 2, k + 1], fill: () => colour('band') });
  const u = new uPlot(options(150, 6, {
    scales: { x: { time: false }, y: { range } },
    series: [{}, ...p.curves.map((c, k) => ({
      label: c.label, stroke: () => colour(hue(c, k)), width: c.kind ? 0.8 : 1.25, dash: c.kind ? [6, 3] : [],
      points: { show: n < 60 }, ...(paths && { paths }) }))],
    bands: p.curves.flatMap((c, k) => (c.kind === 'low' ? [band(k)] : [])),
    axes: [axis({ size: 26 }), axis({ size: 110, values: (_, ticks) => ticks.map((x) => (x === null ? '' : short(x))) })],
    hooks: { draw: [moments, limits], setCursor: [show] },
  }), [time, ...columns], section);
  u.pfd = p;
  plots.push(u);
}

(async () => {
  timeline();
  for (const p of data.plots) await chart(p);
  for (const b of document.querySelectorAll('[data-time]')) b.onclick = () => around(+b.dataset.time);
  place('first').hidden = data.first === null;
  place('first').onclick = () => around(data.first);
  place('all').onclick = all;
  addEventListener('resize', () => plots.forEach((u) => u.setSize({ width: box.clientWidth - 18, height: u.height })));
  all();
})().catch((error) => {
  box.prepend(`The curves cannot be drawn: ${error.message}`);
  root.dataset.error = error.message;
}).finally(() => { root.dataset.drawn = plots.length; });
