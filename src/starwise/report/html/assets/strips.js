// Strip charts: rows of series over a common time axis.
const flagNames = { coasted: "coasted", suspect: "suspect", none: "none", reset: "reset" };
let flagRuns = null;
function flags() {
  if (flagRuns) return flagRuns;
  flagRuns = [];
  for (let i = 0; i < count; i++) {
    const name = E.statuses[E.status[i]];
    if (!flagNames[name]) continue;
    const last = flagRuns[flagRuns.length - 1];
    if (last && last.name === name && last.b === i - 1) last.b = i;
    else flagRuns.push({ name, a: i, b: i });
  }
  // many short ones: those of a kind that stand close are drawn as one
  let gap = (times[count - 1] - times[0]) / 800;
  while (flagRuns.length > 160 && gap < times[count - 1] - times[0]) {
    const merged = [];
    for (const r of flagRuns) {
      const last = merged[merged.length - 1];
      if (last && last.name === r.name && times[r.a] - times[last.b] < gap) last.b = r.b;
      else merged.push({ ...r });
    }
    flagRuns = merged;
    gap *= 2;
  }
  return flagRuns;
}
function flagShapes() {
  const half = E.interval_ms / 2;
  return flags().map((r) => ({ type: "rect", xref: "x", yref: "paper", x0: times[r.a] - half, x1: times[r.b] + half, y0: 0, y1: 1,
    layer: "below", line: { width: 0 }, fillcolor: css("--flag-" + r.name) }));
}

// polygons between two series, broken at gaps
function band(x, low, high, fill) {
  const bx = [], by = [];
  let start = -1;
  const close = (end) => {
    if (start < 0 || end - start < 1) { start = -1; return; }
    for (let i = start; i < end; i++) { bx.push(x[i]); by.push(high[i]); }
    for (let i = end - 1; i >= start; i--) { bx.push(x[i]); by.push(low[i]); }
    bx.push(null); by.push(null);
    start = -1;
  };
  for (let i = 0; i < x.length; i++) {
    const there = finite(low[i]) && finite(high[i]);
    if (there && start < 0) start = i;
    if (!there) close(i);
  }
  close(x.length);
  return { type: "scatter", mode: "lines", x: bx, y: by, fill: "toself", fillcolor: fill, line: { width: 0 }, hoverinfo: "skip" };
}
const about = (c, s, k) => Float64Array.from(s, (v, i) => (c ? c[i] : 0) + k * v);
// a series with the breaks where epochs are missing
function broken(y) {
  const x = [], out = [];
  const gap = Math.max(E.interval_ms * 1.9, E.index.length < E.n ? Infinity : 0);
  for (let i = 0; i < count; i++) {
    if (i && times[i] - times[i - 1] > gap && finite(gap)) { x.push(times[i - 1] + E.interval_ms / 2); out.push(null); }
    x.push(times[i]);
    out.push(finite(y[i]) ? y[i] : null);
  }
  return { x, y: out };
}

// rows: [{title, unit, digits, range, type, series: [{name, y, colour, width, dash, bands: [[low, high, fill]]}]}]
function strips(make, options) {
  const o = options || {};
  let rows = null;
  const get = () => rows || (rows = make());
  return {
    time: true, shared: true, rows: o.rows, get: () => { rows = null; return get(); },
    height: (w) => Math.round((w < 440 ? 118 : o.row || 130) * o.rows + 34),
    build(p) {
      rows = null;
      const list = get(), n = list.length, data = [], gap = 24 / Math.max(60, p.size().height - 54);
      const layout = base({ shapes: flagShapes() });
      layout.margin.t = 20;
      const tall = (1 - gap * (n - 1)) / n;
      list.forEach((row, k) => {
        const id = k ? String(k + 1) : "", top = 1 - k * (tall + gap);
        layout["yaxis" + id] = axis({ domain: [Math.max(0, top - tall), top], range: row.range, nticks: 5, anchor: "x", ticksuffix: "",
          zeroline: !!row.zero, zerolinecolor: css("--axis"), zerolinewidth: 1, rangemode: row.rangemode, ...(row.ticks || {}) });
        const names = row.series.filter((s) => s.name).map((s) => `<span style="color:${s.colour}">${s.name}</span>`);
        layout.annotations.push(label(`<b>${row.title}</b>${row.unit ? ", " + row.unit : ""}${names.length > 1 ? "   " + names.join("  ") : ""}`, top));
        for (const s of row.series) {
          for (const [low, high, fill] of s.bands || []) data.push(Object.assign(band(times, low, high, fill), { yaxis: "y" + id }));
          if (!s.y) continue;
          const xy = broken(s.y);
          data.push({ type: "scatter", mode: s.mode || "lines", x: xy.x, y: xy.y, yaxis: "y" + id, name: s.name || row.title, hoverinfo: "skip",
            line: { color: s.colour, width: s.width || 1.3, dash: s.dash, shape: s.shape }, marker: { color: s.colour, size: 3 } });
        }
      });
      layout.xaxis = timeAxis({ range: timeRange(), anchor: "y" + (n > 1 ? n : ""), domain: [0, 1] });
      return { data, layout };
    },
    hover(p, px) {
      const x = p.gd._fullLayout.xaxis, t = px - x._offset;
      if (t < 0 || t > x._length) return null;
      const i = nearest(x.p2l(t));
      const lines = epochLines(i);
      for (const row of get()) {
        const values = row.series.filter((s) => s.y && s.name !== "").map((s) => `${row.series.length > 1 && s.name ? s.name + " " : ""}${num(s.y[i], row.digits || 4)}`);
        if (values.length) lines.splice(1, 0, `${row.title}  ${values.join("  ")}${row.unit ? " " + row.unit : ""}`);
      }
      return { epoch: i, lines };
    },
    mark(p, over) {
      get().forEach((row, k) => {
        for (const s of row.series) {
          const v = s.y ? s.y[state.i] : NaN;
          if (!finite(v) || (row.type === "log" && v <= 0)) continue;
          const [x, y] = p.px(k + 1, times[state.i], row.type === "log" ? Math.log10(v) : v);
          const a = p.axes(k + 1);
          if (x < a.x._offset || x > a.x._offset + a.x._length || y < a.y._offset || y > a.y._offset + a.y._length) continue;
          over.append(svg("circle", { class: "dot", cx: x, cy: y, r: 3, style: `fill:${s.colour}` }));
        }
      });
    },
  };
}

const AXES = ["e", "n", "u"], AXIS_NAMES = { e: "east", n: "north", u: "up" };
function motionSpec() {
  const su = E.sigma && E.sigma[2];
  return strips(() => {
    const near = (y, s) => robust(s ? [about(y, s, -1), about(y, s, 1), y] : [y], 0.01, 0.99, 0.2);
    const moving = E.vel && E.vel.some((s) => s.some((v) => Math.abs(v) > 1e-6));
    const rows = [{ title: "height", unit: "m", digits: 7, range: near(E.h, su), series: [
      { name: "height", y: E.h, colour: colour.u(), bands: su ? [[about(E.h, su, -1), about(E.h, su, 1), fade(colour.u(), 0.16)]] : [] }] }];
    if (moving) {
      const speed = Float64Array.from(E.vel[0], (v, i) => Math.hypot(v, E.vel[1][i]));
      rows.push({ title: "speed", unit: "m/s", range: robust([speed], 0, 0.995, 0.05), series: [{ name: "speed", y: speed, colour: colour.ink() }] });
      rows.push({ title: "velocity", unit: "m/s", zero: true, range: robust(E.vel, 0.002, 0.998, 0.05),
        series: AXES.map((a, k) => ({ name: AXIS_NAMES[a], y: E.vel[k], colour: colour[a](), width: 1.1,
          bands: E.sigma_vel ? [[about(E.vel[k], E.sigma_vel[k], -1), about(E.vel[k], E.sigma_vel[k], 1), fade(colour[a](), 0.12)]] : [] })) });
    }
    return rows;
  }, E.vel && E.vel.some((s) => s.some((v) => Math.abs(v) > 1e-6)) ? { rows: 3, row: 137 } : { rows: 1, row: 411 });
}
function errorsSpec() {
  return strips(() => AXES.map((a, k) => {
    const y = T.errors[k], s = E.sigma && E.sigma[k], c = colour[a]();
    const three = s ? about(null, s, 3) : null;
    const wide = robust(three ? [y, three, about(null, s, -3)] : [y], 0.02, 0.98, 0.02);
    const own = robust([y], 0.003, 0.997, 0.02), most = Math.max(Math.min(Math.max(-wide[0], wide[1]), 4 * Math.max(-own[0], own[1])), -own[0], own[1]);
    return { title: AXIS_NAMES[a], unit: "m", zero: true, range: [-most, most], series: [{ name: "error", y, colour: c,
      bands: s ? [[about(null, s, -3), three, fade(c, 0.1)], [about(null, s, -1), about(null, s, 1), fade(c, 0.18)]] : [] }] };
  }), { rows: 3, row: 140 });
}
const claimedSpec = () => strips(() => [{ title: "1σ", unit: "m", range: [0, robust(E.sigma, 0, 0.99, 0.05)[1]],
  series: AXES.map((a, k) => ({ name: AXIS_NAMES[a], y: E.sigma[k], colour: colour[a]() })) }], { rows: 1, row: 190 });
function geometrySpec() {
  const n = D.has_count === false ? 0 : 1;
  return strips(() => {
    const rows = [{ title: `${COUNTED} ${USED}`, unit: "", digits: 2, rangemode: "tozero", range: [0, Math.max(4, ...E.n_used) * 1.12],
      series: [{ name: "used", y: Float64Array.from(E.n_used), colour: colour.accent(), shape: "hv" }] }];
    if (E.dop) {
      const log = robust(E.dop, 0, 0.995)[1] > 12;
      rows.push({ title: "dilution of precision", unit: "", type: log ? "log" : undefined, ticks: log ? logTicks(...robust(E.dop.map((d) => Float64Array.from(d, Math.log10)), 0, 1)) : null, range: log ? undefined : [0, robust(E.dop, 0, 0.995, 1)[1]],
        series: [["GDOP", colour.muted()], ["PDOP", colour.ink()], ["HDOP", colour.e()], ["VDOP", colour.u()]].map(([name, c], k) => ({ name, y: E.dop[k], colour: c })) });
    }
    return rows;
  }, { rows: n + (E.dop ? 1 : 0), row: 140 });
}
