// Innovations per satellite, NIS, autocorrelation, distribution, calibration; attitude, biases, clocks.
const quantities = {
  vn: { get: (k) => vn(k), unit: "σ", there: () => !!S.vn },
  v: { get: (k) => S.v[k], unit: "m", there: () => !!S.v },
  rate: { get: (k) => S.rate[k], unit: "m/s", there: () => !!S.rate },
};
// cells that were used, of a satellite, thinned to a number of columns with the extremes of each kept
function seriesOf(s, get, columns) {
  const a = S.ptr[s], b = S.ptr[s + 1], x = [], y = [];
  const width = (times[count - 1] - times[0]) / columns, gap = Math.max(E.interval_ms * 5, width * 2);
  let k = a, last = -Infinity;
  while (k < b) {
    const end = cellTime[k] + (b - a > 2 * columns ? width : 0);
    let lo = -1, hi = -1;
    for (; k < b && cellTime[k] <= end; k++) {
      const v = statusName(k) === "used" ? get(k) : NaN;
      if (!finite(v)) continue;
      if (lo < 0 || v < get(lo)) lo = k;
      if (hi < 0 || v > get(hi)) hi = k;
    }
    if (lo < 0) continue;
    for (const j of lo < hi ? [lo, hi] : lo > hi ? [hi, lo] : [lo]) {
      if (cellTime[j] - last > gap && x.length) { x.push(cellTime[j] - 1); y.push(null); }
      x.push(cellTime[j]);
      y.push(get(j));
      last = cellTime[j];
    }
  }
  return { x, y };
}
const residualsSpec = () => ({
  time: true, dims: true, height: () => 380,
  build(p) {
    const q = quantities[state.residual], by = {}, all = [];
    const columns = Math.max(120, Math.round(p.size().width / 2.5));
    for (let s = 0; s < S.names.length; s++) {
      if (!S.table.used[s]) continue;
      const line = seriesOf(s, q.get, columns), t = (by[S.names[s][0]] = by[S.names[s][0]] || { x: [], y: [] });
      t.x.push(...line.x, null);
      t.y.push(...line.y, null);
      all.push(line.y);
    }
    const data = Object.entries(by).map(([letter, t]) => ({ type: "scatter", mode: "lines+markers", x: t.x, y: t.y, name: letter, hoverinfo: "skip",
      line: { color: fade(colour.system(letter), 0.3), width: 0.8 }, marker: { size: 2, color: fade(colour.system(letter), 0.75) } }));
    if (data.reduce((n, d) => n + d.x.length, 0) > 12000) data.forEach((d) => { d.mode = "lines"; });
    const layout = base({ shapes: flagShapes() });
    layout.margin.t = 22;
    let r = robust(all.length ? [all.flat()] : [[0]], 0.002, 0.998, 0.1);
    const most = Math.max(-r[0], r[1], state.residual === "vn" ? 3.6 : 0);
    layout.xaxis = timeAxis({ range: timeRange() });
    layout.yaxis = axis({ range: [-most, most], zeroline: true, zerolinecolor: css("--axis"), nticks: 8 });
    if (state.residual === "vn") for (const v of [-3, 3]) layout.shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: v, y1: v, line: { color: css("--axis"), width: 1, dash: "dot" } });
    layout.annotations.push(label(`<b>${D.word}</b>, ${q.unit}   ` + Object.keys(by).map((l) => `<span style="color:${colour.system(l)}">${SYSTEMS[l] || l}</span>`).join("  "), 1));
    return { data, layout };
  },
  hover(p, px, py) {
    if (!inside(p, 1, px, py)) return null;
    const a = p.axes(1), i = nearest(a.x.p2l(px - a.x._offset)), q = quantities[state.residual], found = [];
    for (let s = 0; s < S.names.length; s++) {
      const k = cellAt(s, E.index[i]);
      if (k < 0 || statusName(k) !== "used" || !finite(q.get(k))) continue;
      found.push([Math.abs(a.y._offset + a.y.l2p(q.get(k)) - py), s, k]);
    }
    if (!found.length) return { epoch: i, lines: epochLines(i) };
    found.sort((u, v) => u[0] - v[0]);
    const [d, s, k] = found[0];
    return { epoch: i, sv: d < 26 ? s : undefined, lines: d < 26 ? cellLines(s, k).concat(epochLines(i).slice(1)) : epochLines(i) };
  },
  select(p, over, s) {
    const line = seriesOf(s, quantities[state.residual].get, 1e9), g = clip(p, over, 1);
    let d = "", pen = false;
    line.x.forEach((x, j) => {
      if (line.y[j] === null) { pen = false; return; }
      d += (pen ? "L" : "M") + p.px(1, x, line.y[j]).map((z) => z.toFixed(1)).join(" ");
      pen = true;
    });
    g.append(svg("path", { class: "sel", d }));
  },
});
const persatSpec = () => {
  const list = () => rowOrder().list.filter((s) => S.table.used[s] && finite(S.table.rms_n[s]));
  return {
    dims: true, height: () => Math.max(380, list().length * 9 + 60),
    build() {
      const order = list(), n = order.length, data = [{ type: "bar", orientation: "h", x: order.map((s) => S.table.rms_n[s]), y: order.map((_, r) => n - 1 - r), hoverinfo: "skip",
        marker: { color: order.map((s) => fade(colour.system(S.names[s][0]), 0.85)), line: { width: 0 } }, width: 0.62 },
        { type: "scatter", mode: "markers", x: order.map((s) => S.table.mean_n[s]), y: order.map((_, r) => n - 1 - r), hoverinfo: "skip", marker: { symbol: "line-ns", size: 8, color: css("--ink"), line: { width: 1.6, color: css("--ink") } } }];
      const most = Math.max(1.4, ...order.map((s) => S.table.rms_n[s])) * 1.06, least = Math.min(0, ...order.map((s) => S.table.mean_n[s])) * 1.1;
      const layout = base({ bargap: 0.3, margin: { l: 38, r: 12, t: 22, b: 28 } });
      layout.xaxis = axis({ range: [least, most], zeroline: true, zerolinecolor: css("--axis"), nticks: 6, fixedrange: true });
      layout.yaxis = axis({ range: [-0.8, n - 0.2], showgrid: false, showline: false, ticks: "", fixedrange: true, tickvals: order.map((_, r) => n - 1 - r), ticktext: order.map((s) => S.names[s]), tickfont: { size: n > 36 ? 8.5 : 10, color: css("--muted") } });
      layout.shapes.push({ type: "line", yref: "paper", x0: 1, x1: 1, y0: 0, y1: 1, line: { color: css("--ink"), width: 1, dash: "dot" } });
      layout.annotations.push(label("<b>RMS</b> ▬   <b>mean</b> ❘   over σ", 1));
      return { data, layout };
    },
    hover(p, px, py) {
      if (!inside(p, 1, px, py)) return null;
      const order = list(), a = p.axes(1), s = order[order.length - 1 - Math.round(a.y.p2l(py - a.y._offset))];
      if (s === undefined) return null;
      return { sv: s, lines: [S.names[s], `used at ${S.table.used[s]} of ${S.table.seen[s]} epochs`, `RMS ${num(S.table.rms_n[s])} σ, mean ${num(S.table.mean_n[s], 2)} σ`, `RMS ${num(S.table.rms_m[s])} m, mean ${num(S.table.mean_m[s], 2)} m`] };
    },
    select(p, over, s) {
      const order = list(), r = order.indexOf(s);
      if (r < 0) return;
      const a = p.axes(1), y = a.y._offset + a.y.l2p(order.length - 1 - r);
      over.append(svg("rect", { class: "row", x: a.x._offset - 36, y: y - 7, width: a.x._length + 36, height: 14, rx: 3 }));
    },
  };
};

const nisSpec = () => ({
  time: true, height: () => 260,
  build() {
    const x = [], low = [], high = [], mean = [], tx = [], half = E.interval_ms / 2;
    for (let k = 0; k < NIS.mean.length; k++) {
      const a = timeOf(NIS.first[k]) - half, b = timeOf(NIS.last[k]) + half;
      x.push(a, b); low.push(NIS.low[k], NIS.low[k]); high.push(NIS.high[k], NIS.high[k]);
      tx.push((a + b) / 2);
      mean.push(NIS.mean[k]);
    }
    const out = mean.map((v, k) => v < NIS.low[k] || v > NIS.high[k]);
    const most = Math.max(...mean), least = Math.min(...mean.filter((v) => v > 0)), log = most > 6 || least < 0.15;
    const each = E.nis ? Float64Array.from(E.nis, (v, i) => (E.dof[i] ? v / E.dof[i] : NaN)) : null, data = [];
    if (each) data.push(Object.assign({ type: "scatter", mode: "markers", hoverinfo: "skip", marker: { size: 2, color: fade(css("--muted"), 0.45) } }, { x: times, y: each }));
    data.push(band(x, low, high, fade(css("--good"), 0.22)));
    data.push({ type: "scatter", mode: "lines+markers", x: tx, y: mean, hoverinfo: "skip", line: { color: css("--accent"), width: 1.4 },
      marker: { size: 6, color: out.map((o) => (o ? css("--bad") : css("--accent"))), symbol: out.map((o) => (o ? "diamond" : "circle")) } });
    const layout = base({ shapes: flagShapes() });
    layout.margin.t = 22;
    layout.xaxis = timeAxis({ range: timeRange() });
    layout.yaxis = axis(log ? logTicks(Math.log10(Math.max(1e-3, Math.min(least, 0.8))) - 0.15, Math.log10(Math.max(most, 1.3)) + 0.15) : { range: [0, Math.max(1.4, most * 1.1)], nticks: 6 });
    layout.shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: 1, y1: 1, line: { color: css("--axis"), width: 1, dash: "dot" } });
    layout.annotations.push(label(`<b>NIS / dof</b>   whole run ${num(NIS.all.mean)}, 95 % bounds ${num(NIS.all.low, 4)}–${num(NIS.all.high, 4)}`, 1));
    return { data, layout };
  },
  hover(p, px, py) {
    if (!inside(p, 1, px, py)) return null;
    const a = p.axes(1), i = nearest(a.x.p2l(px - a.x._offset)), lines = epochLines(i);
    const k = below(NIS.first, E.index[i], 0, NIS.first.length);
    if (E.nis && E.dof[i]) lines.splice(1, 0, `NIS ${num(E.nis[i])} of ${E.dof[i]}`);
    if (k >= 0 && NIS.last[k] >= E.index[i]) lines.splice(1, 0, `window ${num(NIS.mean[k])}, bounds ${num(NIS.low[k])}–${num(NIS.high[k])}`);
    return { epoch: i, lines };
  },
});
const plainHover = (text) => (p, px, py) => {
  if (!inside(p, 1, px, py)) return null;
  const a = p.axes(1);
  return { lines: text(a.x.p2l(px - a.x._offset), a.y.p2l(py - a.y._offset)) };
};
const rhoSpec = () => ({
  height: () => 260,
  build() {
    const R = D.rho, n = R.rho.length, lags = R.rho.map((_, k) => k + 1), out = R.rho.map((v) => Math.abs(v) > R.all);
    const data = [{ type: "bar", x: lags, y: R.rho, width: 0.34, marker: { color: out.map((o) => (o ? css("--caution") : css("--accent"))), line: { width: 0 } }, hoverinfo: "skip" }];
    const most = Math.max(...R.rho.map(Math.abs), R.all * 1.6, 0.1) * 1.1, low = Math.min(0, ...R.rho, -R.all * 1.6) * 1.1;
    const layout = base({});
    layout.margin.t = 22;
    layout.xaxis = axis({ range: [0.3, n + 0.7], showgrid: false, nticks: 6, fixedrange: true });
    layout.yaxis = axis({ range: [low, most], zeroline: true, zerolinecolor: css("--axis"), nticks: 6, fixedrange: true });
    layout.shapes.push({ type: "rect", xref: "paper", x0: 0, x1: 1, y0: -R.all, y1: R.all, layer: "below", line: { width: 0 }, fillcolor: fade(css("--good"), 0.22) });
    layout.annotations.push(label("<b>correlation</b> over the lag in epochs", 1));
    return { data, layout };
  },
  hover: plainHover((x) => { const k = Math.round(x) - 1; return k >= 0 && k < D.rho.rho.length ? [`lag ${k + 1}`, `${num(D.rho.rho[k])} of ${D.rho.pairs[k]} pairs`, `white: within ±${num(D.rho.all, 2)}`] : []; }),
});
const CURVES = () => [["3D", css("--ink"), "solid"], ["horizontal", css("--c-e"), "solid"], ["vertical", css("--c-u"), "dash"]];
const cdfSpec = () => ({
  height: () => 320,
  build() {
    const C = T.cdf, data = CURVES().filter(([n]) => C[n]).map(([n, c, dash]) => ({ type: "scatter", mode: "lines", x: C[n], y: C.share.map((v) => v * 100), line: { color: c, width: 1.8, dash }, name: n, hoverinfo: "skip" }));
    const most = Math.max(...CURVES().filter(([n]) => C[n]).map(([n]) => C[n][C.share.length - 1]));
    const p95 = Math.max(...CURVES().filter(([n]) => C[n]).map(([n]) => C[n][95]));
    const layout = base({});
    layout.margin.t = 22;
    layout.xaxis = axis({ range: [0, Math.min(most, p95 * 2) * 1.03], rangemode: "tozero", nticks: 7 });
    layout.yaxis = axis({ range: [0, 101], nticks: 6, ticksuffix: " %", fixedrange: true });
    layout.shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: 95, y1: 95, line: { color: css("--axis"), width: 1, dash: "dot" } });
    layout.annotations.push(label("<b>share</b> over the error, m   " + CURVES().filter(([n]) => C[n]).map(([n, c]) => `<span style="color:${c}">${n}</span>`).join("  "), 1));
    return { data, layout };
  },
  hover: plainHover((x) => [`error at most ${num(x)} m`].concat(CURVES().filter(([n]) => T.cdf[n]).map(([n]) => { const k = below(T.cdf[n], x, 0, T.cdf.share.length); return `${n}: ${k < 0 ? 0 : Math.round(T.cdf.share[k] * 100)} %`; }))),
});
const calibrationSpec = () => ({
  height: () => 320,
  build() {
    const C = T.calibration, at = C.nominal.map((v) => v * 100);
    const data = [{ type: "scatter", mode: "lines", x: [0, 100], y: [0, 100], line: { color: css("--axis"), width: 1, dash: "dot" }, hoverinfo: "skip" }];
    for (const [n, c, dash] of CURVES()) if (C[n]) data.push({ type: "scatter", mode: "lines", x: [0, ...at], y: [0, ...C[n].map((v) => v * 100)], line: { color: c, width: 1.8, dash }, hoverinfo: "skip" });
    const layout = base({});
    layout.margin.t = 22;
    layout.xaxis = axis({ range: [0, 100.5], ticksuffix: " %", nticks: 6, fixedrange: true });
    layout.yaxis = axis({ range: [0, 101.5], ticksuffix: " %", nticks: 6, fixedrange: true });
    layout.annotations.push(label("<b>seen</b> over <b>claimed</b>   " + CURVES().filter(([n]) => C[n]).map(([n, c]) => `<span style="color:${c}">${n}</span>`).join("  "), 1),
      { text: "cautious", x: 14, y: 88, showarrow: false, font: { size: 11, color: css("--muted") } }, { text: "claims too much", x: 78, y: 12, showarrow: false, font: { size: 11, color: css("--muted") } });
    return { data, layout };
  },
  hover: plainHover((x) => { const C = T.calibration, k = Math.max(0, below(C.nominal, x / 100, 0, C.nominal.length)); return [`made to hold ${Math.round(C.nominal[k] * 100)} %`].concat(CURVES().filter(([n]) => C[n]).map(([n]) => `${n}: ${(C[n][k] * 100).toFixed(1)} %`)); }),
});

function extraRow(name, title, unit, c, sigmas) {
  const y = E.extra[name], s = E.extra["sigma_" + name], parts = s ? [y, about(y, s, -1), about(y, s, 1)] : [y];
  return { title, unit, range: robust(parts, 0.01, 0.99, unit === "deg" ? 1 : 0), series: [{ name: title, y, colour: c, bands: s ? [[about(y, s, -sigmas), about(y, s, sigmas), fade(c, 0.16)]] : [] }] };
}
const unwrap = (y) => { let turn = 0; return y.map((v, i) => { if (i && finite(v) && finite(y[i - 1])) { if (v - y[i - 1] > 180) turn -= 360; if (v - y[i - 1] < -180) turn += 360; } return v + turn; }); };
const attitudeSpec = () => {
  const list = ["roll", "pitch", "yaw"].filter((n) => E.extra[n + "_deg"]);
  if (E.extra.yaw_deg && !E.extra.yaw_deg.unwrapped) { E.extra.yaw_deg = unwrap(E.extra.yaw_deg); E.extra.yaw_deg.unwrapped = true; }
  return strips(() => list.map((n, k) => extraRow(n + "_deg", n, "deg", [colour.e(), colour.n(), colour.u()][k], D.kind === "simulation" ? 0 : 3)), { rows: list.length, row: 130 });
};
const UNITS = { dph: "°/h", mps2: "m/s²", ppm: "ppm", deg: "°", m: "m", s: "s", mps: "m/s" };
function extraGroups() {
  const names = Object.keys(E.extra).filter((n) => !n.startsWith("sigma_") && !["roll_deg", "pitch_deg", "yaw_deg"].includes(n)), groups = new Map();
  for (const n of names) {
    const m = /^(.*?)_([xyz])_([a-z0-9]+)$/.exec(n), u = /_([a-z0-9]+)$/.exec(n), unit = m ? m[3] : u && UNITS[u[1]] ? u[1] : "";
    const key = m ? `${m[1]}|${unit}` : `${unit ? n.slice(0, -unit.length - 1) : n}|${unit}`;
    if (!groups.has(key)) groups.set(key, []);
    groups.get(key).push([m ? m[2] : "", n]);
  }
  return groups;
}
const biasesSpec = () => {
  const groups = extraGroups();
  return strips(() => [...groups].map(([key, list]) => {
    const [title, unit] = key.split("|"), shown = [];
    const series = list.map(([a, n]) => {
      const y = E.extra[n], s = E.extra["sigma_" + n], c = a ? colour[a]() : colour.accent();
      shown.push(y);
      if (s) shown.push(about(y, s, -1), about(y, s, 1));
      return { name: a || title.replaceAll("_", " "), y, colour: c, bands: s ? [[about(y, s, -1), about(y, s, 1), fade(c, 0.13)]] : [] };
    });
    return { title: title.replaceAll("_", " "), unit: UNITS[unit] || unit, range: robust(shown, 0.03, 0.97), series };
  }), { rows: groups.size, row: 122 });
};
// a clock without the whole milliseconds by which receivers set it
function unstepped(y) {
  const step = 299792.458;
  let taken = 0, last = NaN;
  return Float64Array.from(y, (v) => {
    const steps = finite(v) && finite(last) ? Math.round((v - last) / step) : 0;
    if (Math.abs(steps) >= 1 && Math.abs(v - last - steps * step) < 0.1 * step) taken += steps * step;
    if (finite(v)) last = v;
    return v - taken;
  });
}
// a series less its straight line (least squares)
function detrended(y) {
  let n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
  const x = (i) => (times[i] - times[0]) / 1000;
  for (let i = 0; i < count; i++) if (finite(y[i])) { n++; sx += x(i); sy += y[i]; sxx += x(i) * x(i); sxy += x(i) * y[i]; }
  const d = n * sxx - sx * sx, b = d > 0 ? (n * sxy - sx * sy) / d : 0, a = n ? (sy - b * sx) / n : 0;
  return Float64Array.from(y, (v, i) => v - a - b * x(i));
}
const clocksSpec = () => strips(() => {
  const C = E.clocks, mode = state.clock, first = C[0];
  const shown = C.map((c) => ({ name: SYSTEMS[c.name] || c.name, c, colour: colour.system(c.name), width: mode === "detrended" ? 1.2 : 1.3 }));
  if (mode === "drift") return [{ title: "drift", unit: "m/s", range: robust(C.map((c) => c.drift), 0.005, 0.995, 0.01), series: shown.map((s) => ({ ...s, y: s.c.drift })) }];
  if (mode === "between" && C.length > 1) {
    const rest = shown.slice(1).map((s) => ({ ...s, name: `${s.name} − ${SYSTEMS[first.name] || first.name}`, y: Float64Array.from(s.c.bias, (v, i) => v - first.bias[i]) }));
    return [{ title: "between systems", unit: "m", range: robust(rest.map((s) => s.y), 0.01, 0.99, 0.1), series: rest }];
  }
  const list = shown.map((s) => ({ ...s, y: detrended(unstepped(s.c.bias)) }));
  return [{ title: "bias less its straight line and whole milliseconds", unit: "m", range: robust(list.map((s) => s.y), 0.002, 0.998, 0.1), series: list }];
}, { rows: 1, row: 230 });
