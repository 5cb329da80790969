// Track, sky and availability.
function inside(p, row, px, py) {
  const a = p.axes(row);
  return px >= a.x._offset && px <= a.x._offset + a.x._length && py >= a.y._offset && py <= a.y._offset + a.y._length;
}
function clip(p, over, row) {
  const a = p.axes(row), id = `clip-${p.id}-${row}-${Math.random().toString(36).slice(2, 8)}`;
  const c = svg("clipPath", { id });
  c.append(svg("rect", { x: a.x._offset, y: a.y._offset, width: a.x._length, height: a.y._length }));
  const g = svg("g", { "clip-path": `url(#${id})` });
  over.append(c, g);
  return g;
}

const RE = 6378137, E2 = 0.00669437999014;
function radii() {
  const s = Math.sin((E.origin_llh[0] * Math.PI) / 180), w = 1 - E2 * s * s;
  return { m: (RE * (1 - E2)) / Math.pow(w, 1.5), p: (RE / Math.sqrt(w)) * Math.cos((E.origin_llh[0] * Math.PI) / 180) };
}
function angleStep(wanted) {
  for (const unit of [1, 1 / 60, 1 / 3600]) for (const s of [30, 20, 10, 5, 2, 1]) if (s * unit <= wanted) return s * unit;
  const d = Math.pow(10, Math.floor(Math.log10(wanted * 3600))) / 3600;
  return [5, 2, 1].map((s) => s * d).find((s) => s <= wanted * 1.0000001) || d;
}
function angle(v, step, plus, minus) {
  const a = Math.abs(v), hemi = v < 0 ? minus : plus;
  const whole = Math.floor(a + 1e-11), min = (a - whole) * 60, m = Math.floor(min + 1e-9), sec = (min - m) * 60;
  if (step >= 1) return `${Math.round(a)}°${hemi}`;
  if (step >= 1 / 60 - 1e-12) return `${whole}°${pad(Math.round(min), 2)}′${hemi}`;
  const d = Math.max(0, -Math.floor(Math.log10(step * 3600) + 1e-9));
  return `${whole}°${pad(m, 2)}′${Math.max(0, sec).toFixed(d).padStart(d ? d + 3 : 2, "0")}″${hemi}`;
}
// Meridians and parallels of the visible part, true to first order about the origin; scale bar
function graticule(p, under) {
  if (!finite(E.origin_llh[0])) return;
  const a = p.axes(1), r = radii(), [lat0, lon0] = E.origin_llh, g = clip(p, under, 1);
  const x0 = a.x._offset, x1 = x0 + a.x._length, y0 = a.y._offset, y1 = y0 + a.y._length;
  const [e0, e1] = a.x.range, [n0, n1] = a.y.range, deg = 180 / Math.PI;
  const step = angleStep(Math.max(((e1 - e0) / r.p) * deg, ((n1 - n0) / r.m) * deg) / 4);
  const lonStep = angleStep((((e1 - e0) / r.p) * deg) / Math.max(1, Math.min(4, a.x._length / 130)));
  let free = -Infinity;
  for (let k = Math.ceil((lon0 + (e0 / r.p) * deg) / lonStep); k * lonStep <= lon0 + (e1 / r.p) * deg; k++) {
    const x = x0 + a.x.l2p(((k * lonStep - lon0) / deg) * r.p);
    g.append(svg("path", { class: "grat", d: `M${x} ${y0}V${y1}` }));
    if (x < x1 - 76 && x > free) free = x + 92;
    if (free === x + 92) g.append(svg("text", { class: "grat", x: x + 3, y: y0 + 12 }, angle(k * lonStep, lonStep, "E", "W")));
  }
  for (let k = Math.ceil((lat0 + (n0 / r.m) * deg) / step); k * step <= lat0 + (n1 / r.m) * deg; k++) {
    const y = y0 + a.y.l2p(((k * step - lat0) / deg) * r.m);
    g.append(svg("path", { class: "grat", d: `M${x0} ${y}H${x1}` }));
    if (y > y0 + 26) g.append(svg("text", { class: "grat", x: x1 - 4, y: y - 3, "text-anchor": "end" }, angle(k * step, step, "N", "S")));
  }
  const per = a.x._length / (e1 - e0), want = 110 / per, d = Math.pow(10, Math.floor(Math.log10(want)));
  const len = [5, 2, 1].map((s) => s * d).find((s) => s <= want), w = len * per, bx = x0 + 14, by = y1 - 14;
  const words = len >= 1000 ? `${len / 1000} km` : len >= 1 ? `${len} m` : len >= 0.01 ? `${Math.round(len * 100)} cm` : `${+(len * 1000).toPrecision(2)} mm`;
  p.over.append(svg("path", { class: "scale", d: `M${bx} ${by - 5}V${by}H${bx + w}V${by - 5}M${bx + w / 2} ${by - 3}V${by}` }),
    svg("text", { class: "scale", x: bx + w / 2, y: by - 8, "text-anchor": "middle" }, words));
}
function ellipse(i, k) {
  const a = E.cov_en[0][i], b = E.cov_en[1][i], c = E.cov_en[2][i];
  if (!finite(a + b + c)) return null;
  const m = (a + b) / 2, d = Math.hypot((a - b) / 2, c), t = 0.5 * Math.atan2(2 * c, a - b);
  const l1 = k * Math.sqrt(Math.max(0, m + d)), l2 = k * Math.sqrt(Math.max(0, m - d)), x = [], y = [];
  for (let j = 0; j <= 36; j++) {
    const s = (j / 36) * 2 * Math.PI, u = l1 * Math.cos(s), v = l2 * Math.sin(s);
    x.push(E.enu[0][i] + u * Math.cos(t) - v * Math.sin(t));
    y.push(E.enu[1][i] + u * Math.sin(t) + v * Math.cos(t));
  }
  return { x, y };
}
const K95 = 2.4477; // sqrt of chi-square, 2 degrees of freedom, 95 %
function still() {
  const re = robust([E.enu[0]], 0.02, 0.98), rn = robust([E.enu[1]], 0.02, 0.98);
  const span = Math.hypot(re[1] - re[0], rn[1] - rn[0]);
  let sigma = 0;
  if (E.sigma) { const s = Array.from(E.sigma[0]).filter(finite).sort((a, b) => a - b); sigma = s.length ? s[s.length >> 1] : 0; }
  return span < Math.max(12 * sigma, 0.5);
}
function trackRange(rest) {
  const xs = [E.enu[0]], ys = [E.enu[1]];
  if (T) { xs.push(T.e, T.e); ys.push(T.n, T.n); }
  let [a, b] = robust(xs, 0.004, 0.996, 0.2), [c, d] = robust(ys, 0.004, 0.996, 0.2);
  if (T && T.point) { a = Math.min(a, T.e[0]); b = Math.max(b, T.e[0]); c = Math.min(c, T.n[0]); d = Math.max(d, T.n[0]); }
  if (rest && E.cov_en) {
    for (const at of [count - 1, count >> 1, count >> 2]) {
      const last = ellipse(Math.max(0, at), K95);
      if (!last) continue; a = Math.min(a, ...last.x); b = Math.max(b, ...last.x); c = Math.min(c, ...last.y); d = Math.max(d, ...last.y);
    }
  }
  const grow = 0.06 * Math.max(b - a, d - c);
  return [[a - grow, b + grow], [c - grow, d + grow]];
}
const trackSpec = () => ({
  height: (w) => Math.min(Math.max(w, 300), 446),
  build(p) {
    const rest = still(), data = [], [xr, yr] = trackRange(rest);
    if (T && !T.point) data.push({ type: "scatter", mode: "lines", x: T.e, y: T.n, line: { color: css("--truth"), width: 5 }, name: "truth", hoverinfo: "skip" });
    if (E.cov_en) {
      const x = [], y = [], n = rest ? 3 : 40;
      let along = 0;
      const steps = [0];
      for (let i = 1; i < count; i++) { const d = Math.hypot(E.enu[0][i] - E.enu[0][i - 1], E.enu[1][i] - E.enu[1][i - 1]); along += finite(d) ? d : 0; steps.push(rest ? i : along); }
      const whole = steps[count - 1] || 1;
      for (let j = 0; j < n; j++) {
        const i = Math.min(count - 1, below(steps, (whole * (j + 0.999)) / n, 0, count)), e = i >= 0 ? ellipse(i, K95) : null;
        if (e) { x.push(...e.x, null); y.push(...e.y, null); }
      }
      data.push({ type: "scatter", mode: "lines", x, y, fill: "toself", fillcolor: fade(css("--accent"), 0.1), line: { color: css("--accent"), width: 0.8 }, name: "95 %", hoverinfo: "skip" });
    }
    data.push({ type: "scatter", mode: rest ? "lines+markers" : "lines", x: E.enu[0], y: E.enu[1], line: { color: css("--accent"), width: rest ? 0.7 : 1.8 }, marker: { size: 3, color: css("--accent") }, name: "estimate", hoverinfo: "skip" });
    for (const name of ["suspect", "coasted", "reset"]) {
      const x = [], y = [];
      for (let i = 0; i < count; i++) if (E.statuses[E.status[i]] === name) { x.push(E.enu[0][i]); y.push(E.enu[1][i]); }
      if (x.length) data.push({ type: "scatter", mode: "markers", x, y, name, hoverinfo: "skip",
        marker: { size: name === "coasted" ? 5 : 7, symbol: { suspect: "x-thin", coasted: "circle-open", reset: "diamond-open" }[name], color: css("--mark-" + name), line: { color: css("--mark-" + name), width: name === "coasted" ? 1 : 1.6 } } });
    }
    if (T && T.point) data.push({ type: "scatter", mode: "markers", x: [T.e[0]], y: [T.n[0]], name: "truth", hoverinfo: "skip", marker: { size: 16, symbol: "cross-thin", color: css("--ink"), line: { color: css("--ink"), width: 2 } } });
    const size = p.size(), m = { l: 56, r: 12, t: 22, b: 30 }, w = size.width - m.l - m.r, h = size.height - m.t - m.b;
    const per = Math.max((xr[1] - xr[0]) / w, (yr[1] - yr[0]) / h), cx = (xr[0] + xr[1]) / 2, cy = (yr[0] + yr[1]) / 2;
    const layout = base({ margin: m, xaxis: axis({ range: [cx - (per * w) / 2, cx + (per * w) / 2], showgrid: false, nticks: 6 }),
      yaxis: axis({ range: [cy - (per * h) / 2, cy + (per * h) / 2], scaleanchor: "x", scaleratio: 1, showgrid: false, nticks: 6 }) });
    const named = data.filter((d) => d.name && d.name !== "95 %").map((d) => `<span style="color:${d.name === "truth" ? (T.point ? css("--ink") : css("--truth-ink")) : d.marker && d.name !== "estimate" ? d.marker.line.color : css("--accent")}">${{ truth: T && T.point ? "✛" : "▬", estimate: "━", suspect: "✕", coasted: "○", reset: "◇" }[d.name]} ${d.name}</span>`);
    layout.annotations.push(label("<b>north over east</b>, m   " + [...new Set(named)].join("  "), 1));
    return { data, layout };
  },
  under: graticule,
  // the part of the way on which the chosen satellite was used
  select(p, over, s) {
    let d = "", pen = false;
    for (let r = runPtr[s]; r < runPtr[s + 1]; r++) {
      if (S.statuses[S.runs.status[r]] !== "used") continue;
      pen = false;
      for (let i = Math.max(0, below(E.index, S.runs.first[r] - 1, 0, count) + 1); i < count && E.index[i] <= S.runs.last[r]; i++) {
        if (!finite(E.enu[0][i])) { pen = false; continue; }
        d += (pen ? "L" : "M") + p.px(1, E.enu[0][i], E.enu[1][i]).map((z) => z.toFixed(1)).join(" ");
        pen = true;
      }
    }
    clip(p, over, 1).append(svg("path", { class: "sel", d }));
  },
  mark(p, over) {
    const i = state.i, g = clip(p, over, 1);
    if (!finite(E.enu[0][i])) return;
    const e = E.cov_en ? ellipse(i, K95) : null;
    if (e) g.append(svg("path", { class: "ell", d: "M" + e.x.map((x, j) => p.px(1, x, e.y[j]).join(" ")).join("L") }));
    const [x, y] = p.px(1, E.enu[0][i], E.enu[1][i]);
    g.append(svg("circle", { class: "dot big", cx: x, cy: y, r: 5, style: `fill:${css("--accent")}` }));
  },
  hover(p, px, py) {
    if (!inside(p, 1, px, py)) return null;
    let best = -1, d2 = 40 * 40;
    const a = p.axes(1);
    for (let i = 0; i < count; i++) {
      const dx = a.x._offset + a.x.l2p(E.enu[0][i]) - px, dy = a.y._offset + a.y.l2p(E.enu[1][i]) - py, d = dx * dx + dy * dy;
      if (d < d2) { d2 = d; best = i; }
    }
    if (best < 0) return null;
    const lines = epochLines(best);
    lines.splice(1, 0, `east ${num(E.enu[0][best], 4)}  north ${num(E.enu[1][best], 4)} m`);
    return { epoch: best, lines };
  },
});

// Zenith in the middle, straight in elevation
const skyXY = (az, e) => [((90 - e) / 90) * Math.sin((az * Math.PI) / 180), ((90 - e) / 90) * Math.cos((az * Math.PI) / 180)];
function skyPoints() {
  if (skyPoints.made) return skyPoints.made;
  // along each satellite at most 90 points; of each stretch the greatest residual and the worst fate
  const out = [];
  for (let s = 0; s < S.names.length; s++) {
    const a = S.ptr[s], b = S.ptr[s + 1], step = Math.max(1, Math.ceil((b - a) / 90));
    for (let k = a; k < b; k += step) {
      let worst = k, size = -1, kind = "used";
      for (let j = k; j < Math.min(b, k + step); j++) {
        const name = statusName(j), v = S.vn ? Math.abs(vn(j)) : 0;
        if (name !== "used" && (kind === "used" || kindOf(name) === "test")) kind = kindOf(name);
        if ((finite(v) ? v : 0) > size && finite(elevation(j))) { size = finite(v) ? v : 0; worst = j; }
      }
      if (finite(elevation(worst)) && elevation(worst) > -1) out.push({ s, k: worst, kind });
    }
  }
  return (skyPoints.made = out);
}
// end of the colour scale: round, the residuals of used measurements but for the largest hundredth
function skyLimit() {
  if (skyLimit.made) return skyLimit.made;
  const all = skyPoints().filter((q) => q.kind === "used" && finite(vn(q.k))).map((q) => Math.abs(vn(q.k))).sort((a, b) => a - b);
  const most = all.length ? all[Math.floor(0.97 * (all.length - 1))] : 3;
  return (skyLimit.made = [0.2, 0.5, 1, 2, 3].find((v) => v >= most) || 3);
}
const DIVERGING = () => [[0, css("--div-low")], [0.5, css("--div-mid")], [1, css("--div-high")]];
const SEQUENTIAL = () => [[0, css("--seq-0")], [0.5, css("--seq-1")], [1, css("--seq-2")]];
const skySpec = () => ({
  height: (w) => Math.min(Math.max(w + 20, 300), 450), dims: true,
  build(p) {
    const pts = skyPoints(), x = [], y = [], c = [], mode = state.sky;
    for (const q of pts) {
      const [u, v] = skyXY(azimuth(q.k), elevation(q.k));
      x.push(u); y.push(v);
      c.push(mode === "vn" ? (finite(vn(q.k)) ? vn(q.k) : null) : mode === "cn0" ? (S.cn0 && S.cn0[q.k] ? S.cn0[q.k] / 4 : null) : css("--kind-" + q.kind));
    }
    const shapes = [];
    for (const e of [0, 30, 60]) { const r = (90 - e) / 90; shapes.push({ type: "circle", x0: -r, x1: r, y0: -r, y1: r, layer: "below", line: { color: e ? css("--grid") : css("--axis"), width: 1 } }); }
    for (const a of [0, 45, 90, 135]) { const [u, v] = skyXY(a, 0); shapes.push({ type: "line", x0: -u, x1: u, y0: -v, y1: v, layer: "below", line: { color: css("--grid"), width: 1 } }); }
    const data = [];
    const lx = [], ly = [], lt = [], lc = [];
    for (let s = 0; s < S.names.length; s++) {
      for (let k = S.ptr[s + 1] - 1; k >= S.ptr[s]; k--) {
        if (!finite(elevation(k)) || elevation(k) < 0) continue;
        const [u, v] = skyXY(azimuth(k), elevation(k));
        lx.push(u); ly.push(v); lt.push(S.names[s]); lc.push(colour.system(S.names[s][0]));
        break;
      }
    }
    const scale = mode === "kind" ? {} : mode === "vn" ? { colorscale: DIVERGING(), cmin: -skyLimit(), cmax: skyLimit() } : { colorscale: SEQUENTIAL(), cmin: 20, cmax: 52 };
    const bar = mode === "kind" ? {} : { showscale: true, colorbar: { orientation: "h", thickness: 7, len: 0.5, y: -0.015, yanchor: "top", x: 0.5, outlinewidth: 0, tickfont: { size: 10, color: css("--muted") },
      nticks: 5, title: { text: mode === "vn" ? D.word + " / σ" : "C/N0, dBHz", font: { size: 10, color: css("--muted") }, side: "top" } } };
    data.push({ type: "scatter", mode: "markers", x, y, hoverinfo: "skip", marker: Object.assign({ size: 5.5, color: c.map((v) => (v === null ? (mode === "kind" ? css("--muted") : mode === "vn" ? 0 : 20) : v)), opacity: c.map((v) => (v === null ? 0.25 : 0.95)), line: { width: 0 } }, scale, bar) });
    data.push({ type: "scatter", mode: "text", x: lx, y: ly, text: lt, textposition: "top center", textfont: { size: 10.5, color: css("--ink") }, hoverinfo: "skip", cliponaxis: false });
    const size = p.size(), side = Math.min(size.width - 24, size.height - 62), h = (size.width - side) / 2;
    const blank = { range: [-1.08, 1.08], showgrid: false, zeroline: false, showticklabels: false, ticks: "", showline: false, fixedrange: true };
    const layout = base({ margin: { l: h, r: size.width - side - h, t: 10, b: size.height - side - 10 }, shapes, xaxis: axis(blank), yaxis: axis(blank), dragmode: false });
    for (const [t, u, v] of [["N", 0, 1.05], ["E", 1.05, 0], ["S", 0, -1.05], ["W", -1.05, 0], ["30°", 0.03, 0.667], ["60°", 0.03, 0.334]]) {
      layout.annotations.push({ text: t, x: u, y: v, showarrow: false, font: { size: t.length > 1 ? 9.5 : 12, color: css("--muted") }, xanchor: t.length > 1 ? "left" : "center" });
    }
    return { data, layout };
  },
  hover(p, px, py) {
    let best = null, d2 = 22 * 22;
    for (const q of skyPoints()) {
      const [u, v] = skyXY(azimuth(q.k), elevation(q.k)), [x, y] = p.px(1, u, v), d = (x - px) ** 2 + (y - py) ** 2;
      if (d < d2) { d2 = d; best = q; }
    }
    return best ? { epoch: nearest(cellTime[best.k]), sv: best.s, lines: cellLines(best.s, best.k) } : null;
  },
  select(p, over, s) {
    let d = "";
    for (let k = S.ptr[s]; k < S.ptr[s + 1]; k++) {
      if (!finite(elevation(k)) || elevation(k) < 0) continue;
      const [u, v] = skyXY(azimuth(k), elevation(k)), far = k > S.ptr[s] && cellTime[k] - cellTime[k - 1] > 20 * E.interval_ms && S.all;
      d += (d && !far ? "L" : "M") + p.px(1, u, v).map((z) => z.toFixed(1)).join(" ");
    }
    over.append(svg("path", { class: "sel", d }));
  },
  mark(p, over) {
    for (let s = 0; s < S.names.length; s++) {
      const k = cellAt(s, E.index[state.i]);
      if (k < 0 || !finite(elevation(k)) || elevation(k) < 0) continue;
      const [u, v] = skyXY(azimuth(k), elevation(k)), [x, y] = p.px(1, u, v);
      over.append(svg("circle", { class: "ring" + (s === state.sv ? " on" : ""), cx: x, cy: y, r: s === state.sv ? 7 : 4.5, style: `stroke:${css("--kind-" + kindOf(statusName(k)))}` }));
    }
  },
});
function cellLines(s, k) {
  const name = statusName(k), out = [`${S.names[s]}  ${clock(cellTime[k])}`];
  out.push(name === "used" ? USED : `not used: ${reason(name)}`);
  const parts = [];
  if (S.el && finite(elevation(k))) parts.push(`elevation ${elevation(k).toFixed(1)}°  azimuth ${((azimuth(k) + 360) % 360).toFixed(0)}°`);
  if (S.cn0 && S.cn0[k]) parts.push(`C/N0 ${(S.cn0[k] / 4).toFixed(1)} dBHz`);
  if (S.v && finite(S.v[k])) parts.push(`${D.word} ${num(S.v[k])} m, ${num(vn(k), 2)} σ`);
  return out.concat(parts);
}

const KIND_NAMES = Object.assign({ used: "used", test: "refused by a test", mask: "below a mask", ephemeris: "ephemeris missing or bad", health: "unhealthy", other: "not asked for, or no data" }, D.kind_names || {});
const KIND_ORDER = ["used", "other", "mask", "ephemeris", "health", "test"];
// satellites in the order of systems; those never used last within each
function rowOrder() {
  if (rowOrder.made) return rowOrder.made;
  const order = S.names.map((_, s) => s).filter((s) => S.table.used[s] > 0);
  const rest = S.names.map((_, s) => s).filter((s) => !S.table.used[s]);
  rowOrder.made = { list: order.concat(rest), row: [] };
  rowOrder.made.list.forEach((s, r) => { rowOrder.made.row[s] = rowOrder.made.list.length - 1 - r; });
  return rowOrder.made;
}
const availabilitySpec = () => ({
  time: true, dims: true,
  // as high as what stands beside it, if that is more
  height: () => {
    const own = Math.max(220, Math.min(S.names.length, 200) * (S.names.length > 45 ? 9.5 : 13) + 74);
    const beside = ["sky", "persat"].map((id) => panels.get(id)).filter(Boolean);
    if (beside.length < 2 || printing || innerWidth <= 1100) return own;
    return Math.max(own, Math.round(beside.reduce((sum, p) => sum + p.spec.height(p.box.clientWidth), 0) + 82));
  },
  build(p) {
    const order = rowOrder(), lists = {}, ticks = {}, half = E.interval_ms / 2, R = S.runs;
    const thick = S.names.length > 45 ? 4.5 : 6.5;
    for (let r = 0; r < R.sv.length; r++) {
      const kind = kindOf(S.statuses[R.status[r]]), list = (lists[kind] = lists[kind] || { x: [], y: [] });
      const y = order.row[R.sv[r]], a = timeOf(R.first[r]), b = timeOf(R.last[r]);
      list.x.push(a - half, b + half, null);
      list.y.push(y, y, null);
      if (kind === "test") { const t = (ticks[kind] = ticks[kind] || { x: [], y: [] }), m = (a + b) / 2; t.x.push(m, m, null); t.y.push(y - 0.42, y + 0.42, null); }
    }
    const data = [], named = [];
    for (const kind of KIND_ORDER) {
      if (!lists[kind]) continue;
      const c = css("--kind-" + kind);
      data.push({ type: "scatter", mode: "lines", x: lists[kind].x, y: lists[kind].y, line: { color: c, width: kind === "used" ? thick : kind === "test" ? thick : thick * 0.55, simplify: false }, hoverinfo: "skip", name: kind });
      if (ticks[kind]) data.push({ type: "scatter", mode: "lines", x: ticks[kind].x, y: ticks[kind].y, line: { color: c, width: 1.4, simplify: false }, hoverinfo: "skip" });
      named.push(`<span style="color:${c}">■</span> ${KIND_NAMES[kind]}`);
    }
    const layout = base({ shapes: flagShapes(), margin: { l: 38, r: 12, t: p.size().width < 620 ? 52 : 34, b: 28 } });
    layout.xaxis = timeAxis({ range: timeRange(), showgrid: true });
    layout.yaxis = axis({ range: [-0.8, S.names.length - 0.2], fixedrange: true, showgrid: false, showline: false, ticks: "", tickvals: order.list.map((s) => order.row[s]),
      ticktext: order.list.map((s) => S.names[s]), tickfont: { size: S.names.length > 45 ? 8.5 : 10.5, color: css("--muted") } });
    const cut = p.size().width < 620 ? Math.ceil(named.length / 2) : named.length;
    layout.annotations.push(label(named.slice(0, cut).join("   ") + (cut < named.length ? "<br>" + named.slice(cut).join("   ") : ""), 1, { yshift: 4, align: "left" }));
    return { data, layout };
  },
  hover(p, px, py) {
    if (!inside(p, 1, px, py)) return null;
    const a = p.axes(1), r = Math.round(a.y.p2l(py - a.y._offset)), s = rowOrder().list[rowOrder().list.length - 1 - r];
    if (s === undefined) return null;
    const i = nearest(a.x.p2l(px - a.x._offset)), name = statusAt(s, E.index[i]), k = cellAt(s, E.index[i]);
    const lines = k >= 0 ? cellLines(s, k) : [`${S.names[s]}  ${clock(times[i])}`, name === null ? "not tracked" : name === "used" ? USED : `not used: ${reason(name)}`];
    const e = epochLines(i);
    return { epoch: i, sv: s, lines: lines.concat(e.slice(1, 2)) };
  },
  select(p, over, s) {
    const a = p.axes(1), y = a.y._offset + a.y.l2p(rowOrder().row[s]);
    over.append(svg("rect", { class: "row", x: a.x._offset - 36, y: y - 6, width: a.x._length + 36, height: 12, rx: 3 }));
  },
});
