// Panels: plotly draws axes and data; an overlay of our own carries cursor and selection, so that neither redraws a plot.
const panels = new Map();
const specs = {};
let printing = false;

const colour = {
  e: () => css("--c-e"), n: () => css("--c-n"), u: () => css("--c-u"), x: () => css("--c-e"), y: () => css("--c-n"), z: () => css("--c-u"),
  ink: () => css("--ink"), muted: () => css("--muted"), line: () => css("--line"), accent: () => css("--accent"), panel: () => css("--panel"),
  system: (letter) => css("--sys-" + letter) || css("--muted"),
  kind: (kind) => css("--kind-" + kind),
};
function fade(hex, alpha) {
  const m = /^#?([0-9a-f]{2})([0-9a-f]{2})([0-9a-f]{2})$/i.exec(hex);
  return m ? `rgba(${parseInt(m[1], 16)},${parseInt(m[2], 16)},${parseInt(m[3], 16)},${alpha})` : hex;
}

function axis(more) {
  return Object.assign({
    gridcolor: css("--grid"), zeroline: false, linecolor: css("--axis"), showline: true, ticks: "outside", ticklen: 4, tickwidth: 1,
    tickcolor: css("--axis"), tickfont: { color: css("--muted"), size: 11 }, automargin: false, fixedrange: false, hoverformat: "",
  }, more || {});
}
function base(more) {
  return Object.assign({
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, hovermode: false,
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    margin: { l: 52, r: 14, t: 10, b: 28 }, font: { family: css("--sans"), color: css("--ink"), size: 12 },
    hoverlabel: { bgcolor: css("--panel"), bordercolor: css("--axis"), font: { color: css("--ink"), size: 12 } },
    modebar: { bgcolor: "rgba(0,0,0,0)" }, shapes: [], annotations: [],
  }, more || {});
}
function timeAxis(more) {
  return axis(Object.assign({ type: "date", showgrid: true, nticks: 8, tickformatstops: [
    { dtickrange: [null, 1000], value: "%H:%M:%S.%L" }, { dtickrange: [1000, 60000], value: "%H:%M:%S" },
    { dtickrange: [60000, 86400000], value: "%H:%M" }, { dtickrange: [86400000, null], value: "%m-%d" }] }, more || {}));
}
// ticks of a logarithmic axis in plain numbers
function logTicks(low, high) {
  const tickvals = [];
  for (let d = Math.floor(low); d <= Math.ceil(high); d++) for (const m of high - low > 3 ? [1] : [1, 2, 5]) tickvals.push(+(m * Math.pow(10, d)).toPrecision(1));
  return { type: "log", range: [low, high], tickvals, ticktext: tickvals.map(String) };
}
const timeRange = () => {
  if (state.range) return state.range.slice();
  const a = times[0], b = times[count - 1], edge = Math.max((b - a) * 0.005, E.interval_ms * 0.5);
  return [a - edge, b + edge];
};
function label(text, y, more) {
  return Object.assign({ text, x: 0, y, xref: "paper", yref: "paper", xanchor: "left", yanchor: "bottom", showarrow: false,
    font: { size: 11, color: css("--muted") }, yshift: 1 }, more || {});
}
// Robust range: the bulk of the data and a margin; a lone outlier does not flatten the rest
function robust(lists, low, high, least) {
  const all = [];
  for (const list of lists) {
    const step = Math.max(1, Math.floor(list.length / 4000));
    for (let i = 0; i < list.length; i += step) if (finite(list[i])) all.push(list[i]);
  }
  if (!all.length) return [-1, 1];
  all.sort((a, b) => a - b);
  const at = (q) => all[Math.min(all.length - 1, Math.max(0, Math.round(q * (all.length - 1))))];
  let a = at(low), b = at(high);
  if (at(0) > a - 0.5 * (b - a)) a = at(0);
  if (at(1) < b + 0.5 * (b - a)) b = at(1);
  const edge = Math.max((b - a) * 0.08, ((least || 0) - (b - a)) / 2, 1e-9);
  return [a - edge, b + edge];
}

class Panel {
  constructor(box, spec) {
    this.box = box;
    this.spec = spec;
    this.id = box.dataset.panel;
    this.gd = null;
    box.addEventListener("keydown", (ev) => keys(ev));
  }
  get figure() { return this.box.closest(".panel"); }
  size() {
    const width = Math.floor(this.box.clientWidth);
    const tall = this.spec.height ? this.spec.height(width) : 240;
    return { width, height: tall };
  }
  draw() {
    if (this.gd || !this.box.isConnected) return;
    const size = this.size();
    this.under = svg("svg", { class: "under", "aria-hidden": "true" });
    this.gd = el("div", { class: "gd" });
    this.over = svg("svg", { class: "over", "aria-hidden": "true" });
    this.box.append(this.under, this.gd, this.over);
    this.box.style.height = size.height + "px";
    const { data, layout } = this.spec.build(this);
    Plotly.newPlot(this.gd, data, Object.assign(layout, size), { displayModeBar: false, responsive: false, doubleClick: false });
    this.gd.on("plotly_afterplot", () => this.overlay());
    this.gd.on("plotly_relayout", (ev) => this.moved(ev));
    this.gd.on("plotly_doubleclick", () => this.reset());
    this.gd.addEventListener("mousemove", (ev) => this.hover(ev));
    this.gd.addEventListener("mouseleave", hideTip);
    this.gd.addEventListener("mousedown", (ev) => { this.down = [ev.clientX, ev.clientY]; });
    this.gd.addEventListener("click", (ev) => {
      if (this.down && Math.hypot(ev.clientX - this.down[0], ev.clientY - this.down[1]) > 4) return;
      this.click(ev);
    });
    this.box.dataset.drawn = "1";
    this.overlay();
  }
  redraw() {
    if (!this.gd) return;
    const size = this.size();
    this.box.style.height = size.height + "px";
    const { data, layout } = this.spec.build(this);
    Plotly.react(this.gd, data, Object.assign(layout, size));
    this.overlay();
  }
  reset() {
    if (this.spec.time && state.range) { state.range = null; zoomTime(null); return; }
    this.redraw();
  }
  moved(ev) {
    if (!this.spec.time || Panel.syncing) return;
    const a = ev["xaxis.range[0]"], b = ev["xaxis.range[1]"];
    if (a === undefined) return;
    const ms = (v) => (typeof v === "number" ? v : Date.parse(String(v).replace(" ", "T") + (String(v).length > 10 ? "Z" : "T00:00Z")));
    zoomTime([ms(a), ms(b)]);
  }
  // Axes by number of the row: 1, 2 ...
  axes(row) {
    const f = this.gd._fullLayout, n = row > 1 ? String(row) : "";
    return { x: f["xaxis" + (this.spec.shared ? "" : n)] || f.xaxis, y: f["yaxis" + n] };
  }
  px(row, x, y) {
    const a = this.axes(row);
    return [a.x._offset + a.x.l2p(x), a.y._offset + a.y.l2p(y)];
  }
  at(ev) {
    const r = this.gd.getBoundingClientRect();
    return [ev.clientX - r.left, ev.clientY - r.top];
  }
  hover(ev) {
    if (!this.spec.hover || ev.buttons) return;
    const [px, py] = this.at(ev);
    const found = this.spec.hover(this, px, py);
    if (!found) { hideTip(); return; }
    if (found.epoch !== undefined && !state.pinned) setEpoch(found.epoch);
    showTip(ev, found.lines);
  }
  click(ev) {
    if (!this.spec.hover) return;
    const [px, py] = this.at(ev);
    const found = this.spec.hover(this, px, py);
    if (!found) return;
    if (found.sv !== undefined && found.sv >= 0) setSatellite(found.sv);
    if (found.epoch !== undefined) setEpoch(found.epoch, found.sv === undefined ? true : state.pinned);
    showTip(ev, found.lines);
  }
  overlay() {
    if (!this.gd || !this.gd._fullLayout) return;
    this.over.replaceChildren();
    this.under.replaceChildren();
    this.figure.classList.toggle("dim", state.sv >= 0 && !!this.spec.dims);
    if (this.spec.under) this.spec.under(this, this.under);
    const select = this.spec.select || (this.spec.time ? stretches : null);
    if (select && S && state.sv >= 0) select(this, this.over, state.sv);
    if (this.spec.time && state.active && count) cursor(this);
    if (this.spec.mark && state.active && count) this.spec.mark(this, this.over);
  }
}
Panel.syncing = false;

// where nothing else shows the chosen satellite: when it was used or refused, along the axis of time
function stretches(p, over, s) {
  const f = p.gd._fullLayout, x = f.xaxis, rows = p.spec.rows || 1, y = f["yaxis" + (rows > 1 ? rows : "")], R = S.runs;
  const at = Math.max(y._offset + y._length, f.yaxis._offset + f.yaxis._length) - 5, half = E.interval_ms / 2;
  for (let r = runPtr[s]; r < runPtr[s + 1]; r++) {
    const a = Math.max(0, x.l2p(timeOf(R.first[r]) - half)), b = Math.min(x._length, x.l2p(timeOf(R.last[r]) + half));
    if (b <= a) continue;
    over.append(svg("rect", { class: "strip", x: x._offset + a, y: at, width: Math.max(1, b - a), height: 5, style: `fill:${css("--kind-" + kindOf(S.statuses[R.status[r]]))}` }));
  }
}
function cursor(p) {
  const f = p.gd._fullLayout, x = f.xaxis, at = x.l2p(times[state.i]);
  if (at < 0 || at > x._length) return;
  const rows = p.spec.rows || 1;
  let top = Infinity, bottom = 0;
  for (let r = 1; r <= rows; r++) {
    const y = f["yaxis" + (r > 1 ? r : "")];
    top = Math.min(top, y._offset);
    bottom = Math.max(bottom, y._offset + y._length);
  }
  p.over.append(svg("path", { class: state.pinned ? "cursor pinned" : "cursor", d: `M${x._offset + at} ${top}V${bottom}` }));
}
function zoomTime(range) {
  state.range = range;
  Panel.syncing = true;
  for (const p of panels.values()) {
    if (!p.spec.time || !p.gd) continue;
    if (range) Plotly.relayout(p.gd, { "xaxis.range": range.slice() });
    else p.redraw();
  }
  Panel.syncing = false;
  document.documentElement.classList.toggle("zoomed", !!range);
}

const tip = el("div", { class: "tip", "aria-hidden": "true" });
document.body.append(tip);
function showTip(ev, lines) {
  if (!lines || !lines.length) { hideTip(); return; }
  tip.replaceChildren(...lines.map((l, i) => el("div", { class: i ? "" : "first" }, l)));
  tip.classList.add("on");
  const w = tip.offsetWidth, h = tip.offsetHeight;
  const x = ev.clientX + 16 + w > innerWidth ? Math.max(4, ev.clientX - w - 14) : ev.clientX + 16;
  tip.style.transform = `translate(${x}px,${Math.min(innerHeight - h - 4, Math.max(4, ev.clientY + 14))}px)`;
}
function hideTip() { tip.classList.remove("on"); }

// What a tooltip says of an epoch: time, satellites, what was refused and why
function epochLines(i) {
  const flag = E.statuses[E.status[i]];
  const out = [clock(times[i], false) + (flag === "ok" ? "" : `  ${flag}`)];
  if (!S) { if (E.n_used[i]) out.push(`${E.n_used[i]} ${COUNTED} ${USED}`); return out; }
  const ledger = ledgerAt(E.index[i]);
  out.push(`${ledger.used.length} of ${ledger.n} satellites ${USED}`);
  const names = Object.keys(ledger.refused).sort((a, b) => (kindOf(a) === "test" ? -1 : 0) - (kindOf(b) === "test" ? -1 : 0));
  for (const name of names.slice(0, 4)) {
    const list = ledger.refused[name];
    out.push(`${reason(name)}: ${list.slice(0, 6).map((s) => S.names[s]).join(" ")}${list.length > 6 ? " +" + (list.length - 6) : ""}`);
  }
  return out;
}
