// Copyright 2026 The pfd_ros authors
// SPDX-License-Identifier: Apache-2.0
// Draws the curves of a page, see pfd_ros/page/packing.py for their encoding. `window.pfd` holds
// what was drawn; opened with #check, the page also counts the painted pixels, for tests.
(() => {
  'use strict';
  const GAP = 65535, BLOCK = 1024, COLOURS = 8, HEIGHT = 148, AXIS = 92;
  const root = document.documentElement;
  const place = (id) => document.getElementById(id);
  const state = { ready: false, errors: [], plots: [], lanes: 0 };
  window.pfd = state;
  const fail = (text) => state.errors.push(String(text));
  addEventListener('error', (event) => fail(event.message));
  addEventListener('unhandledrejection', (event) => fail(event.reason));
  addEventListener('securitypolicyviolation', (event) => fail(`policy: ${event.violatedDirective}`));

  const data = JSON.parse(place('data').textContent);
  const uplots = [];
  let chosen = null;

  // Theme: the choice of the reader, else of the system.
  const dark = matchMedia('(prefers-color-scheme: dark)');
  let theme = null;
  try { theme = localStorage.getItem('pfd-theme'); } catch { /* no storage for files */ }
  function paint() {
    root.dataset.theme = theme || (dark.matches ? 'dark' : 'light');
    const style = getComputedStyle(root);
    css.cache = (name) => style.getPropertyValue(name).trim();
    for (const plot of uplots) plot.redraw(false, true);
    for (const mark of document.querySelectorAll('[data-colour]')) {
      mark.style.background = css(mark.dataset.colour);
    }
  }
  function css(name) { return css.cache(name); }
  dark.addEventListener('change', paint);
  place('theme').addEventListener('click', () => {
    theme = root.dataset.theme === 'dark' ? 'light' : 'dark';
    try { localStorage.setItem('pfd-theme', theme); } catch { /* no storage for files */ }
    paint();
  });

  // Decoding.
  async function inflated(text, size) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
    const planes = new Uint8Array(await new Response(stream).arrayBuffer());
    const n = planes.length / size;
    const out = new Uint8Array(planes.length);
    for (let k = 0; k < size; k++) for (let i = 0; i < n; i++) out[i * size + k] = planes[k * n + i];
    return out.buffer;
  }
  async function times(axis) {
    const steps = new Uint32Array(await inflated(axis.data, 4));
    const found = new Float64Array(axis.n);
    let ticks = 0;
    for (let i = 0; i < axis.n; i++) { ticks += steps[i]; found[i] = axis.first + axis.tick * ticks; }
    return found;
  }
  async function values(plot, n) {
    const codes = new Uint16Array(await inflated(plot.data, 2));
    return plot.labels.map((_, column) => {
      const found = new Array(n);
      let code = 0;
      for (let i = 0; i < n; i++) {
        code = (code + codes[column * n + i]) & 0xffff;
        const block = Math.floor(i / BLOCK);
        const value = plot.low[column][block] + code * plot.step[column][block];
        found[i] = code === GAP || (plot.log && value <= 0) ? null : value;
      }
      return found;
    });
  }

  // Zoom and cursor in step.
  let zooming = false;
  function zoom(low, high) {
    zooming = true;
    for (const plot of uplots) plot.setScale('x', { min: low, max: high });
    zooming = false;
  }
  const margin = Math.max(1e-3, 0.01 * (data.span[1] - data.span[0]));
  const all = () => zoom(data.span[0] - margin, data.span[1] + margin);
  function around(time) {
    const half = Math.max(0.02 * (data.span[1] - data.span[0]), Math.min(0.5, data.span[1] - data.span[0]));
    chosen = time;
    zoom(time - half, time + half);
  }

  // Joints: one colour in all plots.
  const names = [];
  for (const plot of data.plots) {
    if (plot.joints) for (const name of plot.labels) if (!names.includes(name)) names.push(name);
  }
  const shown = new Set(names);
  const colour = (plot, k) => `--c${(plot.joints ? names.indexOf(plot.labels[k]) : k) % COLOURS}`;
  const dash = (plot, k) =>
    Math.floor((plot.joints ? names.indexOf(plot.labels[k]) : k) / COLOURS) % 2 ? [5, 3] : [];
  function select(name, add) {
    if (add) { if (!shown.delete(name)) shown.add(name); }
    else if (shown.size === 1 && shown.has(name)) names.forEach((each) => shown.add(each));
    else { shown.clear(); shown.add(name); }
    for (const button of place('joints').children) {
      button.classList.toggle('off', !shown.has(button.dataset.name));
    }
    uplots.forEach((plot) => {
      if (!plot.pfd || !plot.pfd.joints) return;
      plot.batch(() => plot.pfd.labels.forEach((label, k) => plot.setSeries(k + 1, { show: shown.has(label) })));
    });
  }
  const troubled = new Set([...document.querySelectorAll('.story tr.bad button')].map((b) => b.dataset.joint));
  names.forEach((name, k) => {
    const button = document.createElement('button');
    const line = document.createElement('i');
    line.dataset.colour = `--c${k % COLOURS}`;
    button.className = troubled.has(name) ? 'joint trouble' : 'joint';
    button.dataset.name = name;
    button.append(line, name);
    button.addEventListener('click', (event) => select(name, event.shiftKey || event.ctrlKey));
    place('joints').append(button);
  });

  // Drawing.
  function vertical(u, time, name, label, before) {
    const x = u.valToPos(time, 'x', true);
    if (!(x >= u.bbox.left - 1 && x <= u.bbox.left + u.bbox.width + 1)) return;
    const c = u.ctx, r = devicePixelRatio;
    c.save();
    c.strokeStyle = c.fillStyle = css(name);
    c.lineWidth = 1.5 * r;
    c.setLineDash([4 * r, 3 * r]);
    c.beginPath(); c.moveTo(x, u.bbox.top); c.lineTo(x, u.bbox.top + u.bbox.height); c.stroke();
    if (label) {
      c.font = `600 ${11 * r}px system-ui, sans-serif`;
      const size = c.measureText(label).width + 6 * r;
      const left = before ? x - size > 0 : x + size > u.bbox.left + u.bbox.width;
      c.textAlign = left ? 'right' : 'left';
      c.textBaseline = 'bottom';
      c.fillText(label, x + (left ? -5 : -1) * r, u.bbox.top - 3 * r);
    }
    c.restore();
  }
  function moments(u) {
    const named = u === uplots[0];
    if (chosen !== null) vertical(u, chosen, '--note');
    for (const mark of data.marks) vertical(u, mark.time, '--mark', named ? mark.label : '');
    if (data.first) vertical(u, data.first.time, '--bad', named && data.marks.every((m) => m.label !== data.first.label) ? `first: ${data.first.label}` : '', data.marks.length);
  }
  function limits(u) {
    const plot = u.pfd;
    if (!plot || !plot.joints || shown.size !== 1) return;
    plot.labels.forEach((label, k) => {
      if (!shown.has(label)) return;
      for (const bound of plot.bounds[k]) {
        if (bound === null) continue;
        const y = u.valToPos(bound, 'y', true), c = u.ctx;
        if (!(y >= u.bbox.top && y <= u.bbox.top + u.bbox.height)) continue;
        c.save();
        c.strokeStyle = css('--bad'); c.lineWidth = devicePixelRatio; c.setLineDash([2, 4]);
        c.beginPath(); c.moveTo(u.bbox.left, y); c.lineTo(u.bbox.left + u.bbox.width, y); c.stroke();
        c.restore();
      }
    });
  }
  function lanes(u) {
    const c = u.ctx, r = devicePixelRatio, h = u.bbox.height / data.lanes.length;
    c.save();
    c.beginPath(); c.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); c.clip();
    data.lanes.forEach((lane, k) => {
      for (const [start, end, severity] of lane.spans) {
        const x = u.valToPos(start, 'x', true);
        const width = Math.max(2.5 * r, u.valToPos(end, 'x', true) - x);
        c.fillStyle = css(lane.kind === data.marks[0]?.label ? '--mark' : `--${severity}`);
        c.fillRect(x - r, u.bbox.top + k * h + 0.18 * h, width, 0.64 * h);
      }
    });
    c.restore();
  }

  const axisOf = (extra) => ({
    stroke: () => css('--soft'),
    grid: { stroke: () => css('--grid'), width: 1 },
    ticks: { stroke: () => css('--grid'), width: 1, size: 4 },
    font: '11px system-ui, sans-serif',
    ...extra,
  });
  const short = (value) => {
    if (value === null || value === undefined) return '–';
    const size = Math.abs(value);
    if (value === 0) return '0';
    return size >= 1e5 || size < 1e-4 ? value.toExponential(2) : String(+value.toPrecision(5));
  };
  function options(width, height, extra) {
    return {
      width, height, padding: [6, 14, 0, 0], scales: { x: { time: false } },
      cursor: {
        y: false, points: { size: 5 }, drag: { x: true, y: false, setScale: true },
        sync: { key: 'pfd', setSeries: false, scales: ['x', null] },
        bind: { dblclick: () => () => { all(); return null; } },
      },
      ...extra,
      hooks: {
        setScale: [(u, key) => {
          if (key === 'x' && !zooming && state.ready) zoom(u.scales.x.min, u.scales.x.max);
        }],
        ...extra.hooks,
      },
    };
  }
  function frame(title, source) {
    const section = document.createElement('section');
    const head = document.createElement('h3');
    const from = document.createElement('small');
    section.className = 'plot';
    from.textContent = source;
    head.append(title, from);
    section.append(head);
    place('plots').append(section);
    return [section, head];
  }
  const room = () => place('plots').clientWidth - 18;

  function timeline() {
    if (!data.lanes.length) return;
    const [section] = frame('What happened, and when', data.origin);
    const count = data.lanes.length;
    uplots.push(new uPlot(options(room(), 48 + 19 * count, {
      padding: [18, 14, 0, 0],
      scales: { x: { time: false }, y: { range: [0, count] } },
      legend: { show: false },
      series: [{}, { stroke: 'transparent' }],
      axes: [axisOf({ size: 26 }), axisOf({
        size: AXIS, grid: { show: false }, ticks: { show: false },
        splits: () => data.lanes.map((_, k) => count - 0.5 - k),
        values: () => data.lanes.map((lane) => lane.kind),
      })],
      hooks: { draw: [lanes, moments] },
    }), [[data.span[0], Math.max(data.span[1], data.span[0] + 1e-6)], [null, null]], section));
  }

  function chart(plot, time, columns) {
    const every = plot.stride > 1 ? `, minimum and maximum of each ${plot.stride} samples` : '';
    const unit = plot.unit && plot.unit !== '1' ? ` [${plot.unit}]` : '';
    const [section, head] = frame(plot.title + unit, plot.source + every);
    const line = plot.stepped && plot.stride === 1 ? uPlot.paths.stepped({ align: 1 }) : undefined;
    const u = new uPlot(options(room(), HEIGHT, {
      scales: { x: { time: false }, y: plot.log ? { distr: 3 } : {} },
      legend: { show: false },
      series: [{}, ...plot.labels.map((label, k) => ({
        label, stroke: () => css(colour(plot, k)), width: 1.25, dash: dash(plot, k),
        points: { show: time.length < 2 }, ...(line ? { paths: line } : {}),
      }))],
      axes: [axisOf({ size: 26 }), axisOf({
        size: AXIS,
        values: (_, ticks) => ticks.map((tick) => (tick === null ? '' : short(tick))),
      })],
      hooks: { draw: [moments, limits], setCursor: [readout(plot, head)] },
    }), [time, ...columns], section);
    u.pfd = plot;
    uplots.push(u);
    state.plots.push({
      title: plot.title, source: plot.source, points: time.length,
      time: time.length ? [time[0], time[time.length - 1]] : [],
      series: plot.labels.map((label, k) => {
        let low = Infinity, high = -Infinity, count = 0;
        for (const value of columns[k]) {
          if (value === null) continue;
          count++; low = Math.min(low, value); high = Math.max(high, value);
        }
        return { label, count, low: count ? low : null, high: count ? high : null };
      }),
    });
  }
  // The values at the cursor, next to the title; names too where they are no joints.
  function readout(plot, head) {
    const box = document.createElement('span'), at = document.createElement('b');
    box.className = 'readout';
    const cells = plot.labels.map((label, k) => {
      const cell = document.createElement('span'), line = document.createElement('i');
      const value = document.createElement('b');
      line.dataset.colour = colour(plot, k);
      line.style.background = css(colour(plot, k));
      cell.append(line, plot.joints ? '' : label, value);
      cell.title = label;
      cell.hidden = plot.joints || plot.labels.length > COLOURS;
      box.append(cell);
      return [cell, value];
    });
    box.prepend(at);
    head.append(box);
    return (u) => {
      const i = u.cursor.left >= 0 ? u.cursor.idx : null;
      const none = i === null || i === undefined;
      at.textContent = none ? '' : `${u.data[0][i].toFixed(4)} s`;
      cells.forEach(([cell, value], k) => {
        value.textContent = none ? '' : short(u.data[k + 1][i]);
        if (plot.joints) cell.hidden = none || !shown.has(plot.labels[k]) || shown.size > COLOURS;
      });
    };
  }

  // For tests: how many pixels of a plot have the colour of one of its curves.
  function painted(u) {
    const { left, top, width, height } = u.bbox;
    const copy = document.createElement('canvas');
    copy.width = left + width; copy.height = top + height;
    const context = copy.getContext('2d', { willReadFrequently: true });
    context.drawImage(u.ctx.canvas, 0, 0);
    const pixels = context.getImageData(left, top, width, height).data;
    const probe = document.createElement('canvas').getContext('2d', { willReadFrequently: true });
    const wanted = u.pfd.labels.map((_, k) => {
      probe.fillStyle = css(colour(u.pfd, k)); probe.fillRect(0, 0, 1, 1);
      return probe.getImageData(0, 0, 1, 1).data;
    });
    let count = 0;
    for (let i = 0; i < pixels.length; i += 4) {
      if (pixels[i + 3] < 128) continue;
      count += wanted.some((w) => Math.abs(pixels[i] - w[0]) + Math.abs(pixels[i + 1] - w[1]) + Math.abs(pixels[i + 2] - w[2]) < 24);
    }
    return count;
  }

  async function draw() {
    if (typeof DecompressionStream === 'undefined') {
      throw new Error('this browser cannot decompress: use one of 2023 or later');
    }
    const axes = await Promise.all(data.axes.map(times));
    const columns = await Promise.all(data.plots.map((plot) => values(plot, data.axes[plot.axis].n)));
    paint();
    timeline();
    data.plots.forEach((plot, k) => chart(plot, axes[plot.axis], columns[k]));
    all();
    for (const button of document.querySelectorAll('[data-time]')) {
      button.addEventListener('click', () => around(+button.dataset.time));
    }
    place('to-all').addEventListener('click', () => { chosen = null; all(); });
    place('to-first').hidden = !data.first;
    place('to-first').addEventListener('click', () => around(data.first.time));
    place('all-settings')?.addEventListener('click', (event) => {
      event.target.closest('details').classList.toggle('everything');
    });
    addEventListener('resize', () => uplots.forEach((u) => u.setSize({ width: room(), height: u.height })));
    state.lanes = data.lanes.length;
    state.zoom = (low, high) => zoom(low, high);
    state.ranges = () => uplots.map((u) => [u.scales.x.min, u.scales.x.max]);
    // uPlot draws in a microtask; a short delay also lets a first resize settle.
    await new Promise((done) => setTimeout(done, 50));
    state.ready = true;
  }

  draw().catch((error) => {
    fail(error.message);
    const line = document.createElement('p');
    line.className = 'card failed';
    line.textContent = `The curves cannot be drawn: ${error.message}`;
    place('plots').prepend(line);
  }).finally(() => {
    if (!location.hash.startsWith('#check')) return;
    const drawn = uplots.filter((u) => u.pfd);
    drawn.forEach((u, k) => { state.plots[k].painted = painted(u); });
    if (location.hash === '#check-zoom' && state.ready) {
      drawn[0].setScale('x', { min: 0.25 * data.span[1], max: 0.5 * data.span[1] });
    }
    setTimeout(() => {
      const report = document.createElement('script');
      report.type = 'application/json';
      report.id = 'drawn';
      const told = { ...state, ranges: uplots.map((u) => [u.scales.x.min, u.scales.x.max]) };
      report.textContent = JSON.stringify(told).replaceAll('<', '\\u003c');
      document.body.append(report);
    }, 100);
  });
})();
