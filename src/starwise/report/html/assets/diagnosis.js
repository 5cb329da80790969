// What an assessment found, where it has series: degree of observability, sigma of single epochs, decay of disturbances.
const LAB = D.lab || {};
const degreeSpec = () => ({
  height: () => LAB.degree.names.length * 17 + 58,
  build() {
    const n = LAB.degree.names.length, at = LAB.degree.names.map((_, k) => n - 1 - k), d = LAB.degree.degree;
    const layout = base({ margin: { l: 74, r: 14, t: 22, b: 28 } });
    const data = [{ type: "bar", orientation: "h", x: d, y: at, width: 0.6, hoverinfo: "skip", marker: { line: { width: 0 }, color: d.map((v) => (v > 0.9 ? css("--accent") : v > 0.3 ? css("--caution") : css("--bad"))) } }];
    layout.xaxis = axis({ range: [Math.min(0, ...d), 1.02], nticks: 6, fixedrange: true });
    layout.yaxis = axis({ range: [-0.8, n - 0.2], tickvals: at, ticktext: LAB.degree.names, showgrid: false, showline: false, ticks: "", fixedrange: true });
    layout.annotations.push(label("<b>degree of observability</b>, 1 − σ / σ unmeasured", 1));
    return { data, layout };
  },
  hover(p, px, py) {
    if (!inside(p, 1, px, py)) return null;
    const a = p.axes(1), n = LAB.degree.names.length, k = n - 1 - Math.round(a.y.p2l(py - a.y._offset));
    if (k < 0 || k >= n) return null;
    return { lines: [LAB.degree.names[k], `degree ${num(LAB.degree.degree[k], 4)}`, `σ ${num(LAB.degree.sigma[k])}, unmeasured ${num(LAB.degree.free[k])}`] };
  },
});
const epochSigmaSpec = () => ({
  time: true, height: () => 190,
  build() {
    const x = LAB.sigma.epoch.map(timeOf), y = LAB.sigma.sigma_m, layout = base({ shapes: flagShapes() });
    const there = y.filter((v) => finite(v) && v > 0), logs = there.map(Math.log10);
    layout.margin.t = 22;
    layout.xaxis = timeAxis({ range: timeRange() });
    const wide = logs.length && Math.max(...logs) - Math.min(...logs) > 1;
    layout.yaxis = axis(wide ? logTicks(Math.min(...logs) - 0.1, Math.max(...logs) + 0.1) : { range: [0, Math.max(...there, 0.1) * 1.1], nticks: 5 });
    layout.annotations.push(label("<b>weakest direction of single epochs</b>, 1σ, m", 1));
    return { data: [{ type: "scatter", mode: "lines", x, y, hoverinfo: "skip", line: { color: css("--accent"), width: 1.3 } }], layout };
  },
  hover(p, px, py) {
    if (!inside(p, 1, px, py)) return null;
    const a = p.axes(1), i = nearest(a.x.p2l(px - a.x._offset)), k = Math.max(0, below(LAB.sigma.epoch, E.index[i], 0, LAB.sigma.epoch.length));
    return { epoch: i, lines: [clock(times[i]), `weakest direction ${num(LAB.sigma.sigma_m[k])} m`] };
  },
});
const productSpec = () => ({
  height: () => 230,
  build() {
    const y = LAB.product.norm, n = y.length, x = y.map((_, k) => (k / (n - 1)) * LAB.product.seconds), layout = base({});
    const logs = y.filter((v) => v > 0).map(Math.log10);
    layout.margin.t = 22;
    layout.xaxis = axis({ range: [0, LAB.product.seconds], nticks: 7, ticksuffix: " s" });
    layout.yaxis = axis(logTicks(Math.min(...logs, -0.5) - 0.1, Math.max(...logs, 0) + 0.1));
    layout.shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: Math.exp(-1), y1: Math.exp(-1), line: { color: css("--axis"), width: 1, dash: "dot" } });
    layout.annotations.push(label("<b>left of the error of the start</b>; dotted: 1/e", 1));
    return { data: [{ type: "scatter", mode: "lines", x, y, hoverinfo: "skip", line: { color: css("--accent"), width: 1.6 } }], layout };
  },
  hover: plainHover((x) => { const n = LAB.product.norm.length, k = Math.max(0, Math.min(n - 1, Math.round((x / LAB.product.seconds) * (n - 1)))); return [`after ${num((k / (n - 1)) * LAB.product.seconds)} s`, `${num(LAB.product.norm[k])} is left`]; }),
});
Object.assign(specs, { "obs-degree": degreeSpec, "obs-sigma": epochSigmaSpec, "stab-product": productSpec });
