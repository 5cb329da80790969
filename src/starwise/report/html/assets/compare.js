// Several solutions beside each other: each in its colour, all over the same axes.
const OTHERS = D.solutions ? unpackAll(D.solutions).map((s) => Object.assign(s, { t: Float64Array.from(s.t_ms, (t) => t + s.t0_ms) })) : [];
const solutionColour = (k) => css("--solution-" + (k % 8));
const legend = () => OTHERS.map((s, k) => `<span style="color:${solutionColour(k)}">━ ${s.name.replace(/[<>&]/g, (c) => `&#${c.charCodeAt(0)};`)}</span>`).join("  ");
function overlaid(rows) {
  return {
    time: true, shared: true, rows: rows.length, height: (w) => Math.round((w < 560 ? 128 : 150) * rows.length + 56),
    build() {
      const n = rows.length, gap = 0.06, tall = (1 - gap * (n - 1)) / n, data = [], layout = base({});
      layout.margin.t = 40;
      rows.forEach((row, r) => {
        const id = r ? String(r + 1) : "", top = 1 - r * (tall + gap), all = [];
        OTHERS.forEach((s, k) => {
          const y = row.of(s);
          if (!y) return;
          all.push(y);
          data.push({ type: "scatter", mode: "lines", x: s.t, y, yaxis: "y" + id, hoverinfo: "skip", line: { color: solutionColour(k), width: 1.2 } });
        });
        let range = robust(all, 0.005, 0.995, 0.02);
        if (row.zero) { const m = Math.max(-range[0], range[1]); range = [-m, m]; }
        if (row.from0) range = [0, range[1]];
        layout["yaxis" + id] = axis({ domain: [Math.max(0, top - tall), top], range, nticks: 5, anchor: "x", zeroline: !!row.zero, zerolinecolor: css("--axis") });
        layout.annotations.push(label(`<b>${row.title}</b>${row.unit ? ", " + row.unit : ""}`, top));
      });
      layout.annotations.push(label(legend(), 1, { yshift: 18 }));
      layout.xaxis = timeAxis({ range: timeRange(), anchor: "y" + (n > 1 ? n : ""), domain: [0, 1] });
      return { data, layout };
    },
    hover(p, px) {
      const x = p.gd._fullLayout.xaxis, t = px - x._offset;
      if (t < 0 || t > x._length) return null;
      const i = nearest(x.p2l(t)), lines = [clock(times[i])];
      OTHERS.forEach((s) => {
        const k = Math.max(0, below(s.t, times[i] + E.interval_ms / 2, 0, s.t.length));
        if (Math.abs(s.t[k] - times[i]) <= E.interval_ms) lines.push(`${s.name}: ${rows.map((r) => (r.of(s) ? num(r.of(s)[k]) : "–")).join("  ")} ${rows[0].unit}`);
      });
      return { epoch: i, lines };
    },
  };
}
const cmpTrackSpec = () => ({
  height: (w) => Math.min(Math.max(w, 300), 412),
  build(p) {
    const data = OTHERS.map((s, k) => ({ type: "scatter", mode: "lines", x: s.enu[0], y: s.enu[1], hoverinfo: "skip", line: { color: solutionColour(k), width: k ? 1.4 : 2 } }));
    const xr = robust(OTHERS.map((s) => s.enu[0]), 0.01, 0.99, 0.3), yr = robust(OTHERS.map((s) => s.enu[1]), 0.01, 0.99, 0.3);
    const size = p.size(), m = { l: 56, r: 12, t: 22, b: 30 }, w = size.width - m.l - m.r, h = size.height - m.t - m.b;
    const per = Math.max((xr[1] - xr[0]) / w, (yr[1] - yr[0]) / h), cx = (xr[0] + xr[1]) / 2, cy = (yr[0] + yr[1]) / 2;
    const layout = base({ margin: m, xaxis: axis({ range: [cx - (per * w) / 2, cx + (per * w) / 2], showgrid: false, nticks: 6 }), yaxis: axis({ range: [cy - (per * h) / 2, cy + (per * h) / 2], scaleanchor: "x", showgrid: false, nticks: 6 }) });
    layout.annotations.push(label(legend(), 1));
    return { data, layout };
  },
  under: graticule,
  mark(p, over) {
    const g = clip(p, over, 1);
    OTHERS.forEach((s, k) => {
      const j = Math.max(0, below(s.t, times[state.i] + E.interval_ms / 2, 0, s.t.length));
      if (!finite(s.enu[0][j]) || Math.abs(s.t[j] - times[state.i]) > E.interval_ms) return;
      const [x, y] = p.px(1, s.enu[0][j], s.enu[1][j]);
      g.append(svg("circle", { class: "dot", cx: x, cy: y, r: 4, style: `fill:${solutionColour(k)}` }));
    });
  },
});
const cmpCdfSpec = () => ({
  height: () => 280,
  build() {
    const list = OTHERS.filter((s) => s.cdf && s.cdf["3D"]), data = [];
    OTHERS.forEach((s, k) => { if (s.cdf && s.cdf["3D"]) data.push({ type: "scatter", mode: "lines", x: s.cdf["3D"], y: s.cdf.share.map((v) => v * 100), hoverinfo: "skip", line: { color: solutionColour(k), width: 1.8 } }); });
    const p95 = Math.max(0.1, ...list.map((s) => s.cdf["3D"][95])), layout = base({});
    layout.margin.t = 24;
    layout.xaxis = axis({ range: [0, p95 * 1.5], nticks: 7 });
    layout.yaxis = axis({ range: [0, 101], ticksuffix: " %", fixedrange: true, nticks: 6 });
    layout.annotations.push(label(`<b>share</b> over the ${D.word}, m   ` + legend(), 1));
    return { data, layout };
  },
  hover: plainHover((x) => [`at most ${num(x)} m`].concat(OTHERS.filter((s) => s.cdf && s.cdf["3D"]).map((s) => { const k = below(s.cdf["3D"], x, 0, s.cdf.share.length); return `${s.name}: ${k < 0 ? 0 : Math.round(s.cdf.share[k] * 100)} %`; }))),
});
Object.assign(specs, {
  "cmp-track": cmpTrackSpec, "cmp-cdf": cmpCdfSpec,
  "cmp-height": () => overlaid([{ title: "height", unit: "m", of: (s) => s.h }, { title: "claimed 1σ, 3D", unit: "m", from0: true, of: (s) => s.sigma }]),
  "cmp-errors": () => overlaid([0, 1, 2].map((k) => ({ title: ["east", "north", "up"][k], unit: "m", zero: true, of: (s) => s.errors && s.errors[k] }))),
  "cmp-count": () => overlaid([{ title: "satellites used", unit: "", from0: true, of: (s) => Float64Array.from(s.n_used) }]),
});
