// Data, state and small helpers. Everything from the data reaches the page as text, never as markup.
const D = JSON.parse(document.getElementById("data").textContent);
const KINDS = { f4: Float32Array, f8: Float64Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, i2: Int16Array, i4: Int32Array };

function unpack(item) {
  if (!item || typeof item !== "object" || item.bdata === undefined) return item;
  const raw = atob(item.bdata);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new KINDS[item.dtype](bytes.buffer);
}

function unpackAll(value) {
  if (Array.isArray(value)) return value.map((v) => (v && typeof v === "object" ? unpackAll(v) : v));
  if (value && typeof value === "object") {
    if (value.bdata !== undefined) return unpack(value);
    const out = {};
    for (const k of Object.keys(value)) out[k] = unpackAll(value[k]);
    return out;
  }
  return value;
}

const NS = "http://www.w3.org/2000/svg";
function el(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [k, v] of Object.entries(attributes || {})) {
    if (v === false || v === null || v === undefined) continue;
    if (k === "onclick") node.addEventListener("click", v);
    else node.setAttribute(k, v === true ? "" : v);
  }
  for (const c of children) if (c !== null && c !== undefined) node.append(c);
  return node;
}
function svg(tag, attributes, text) {
  const node = document.createElementNS(NS, tag);
  for (const [k, v] of Object.entries(attributes || {})) node.setAttribute(k, v);
  if (text !== undefined) node.textContent = text;
  return node;
}

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const finite = Number.isFinite;
function num(v, digits) {
  if (!finite(v)) return "–";
  const a = Math.abs(v), d = digits === undefined ? 3 : digits;
  if (a !== 0 && (a >= 1e6 || a < 1e-4)) return v.toExponential(d - 1).replace("-", "−");
  return v.toFixed(a === 0 ? 0 : Math.max(0, d - 1 - Math.floor(Math.log10(a)))).replace("-", "−");
}
const pad = (v, n) => String(v).padStart(n, "0");
function clock(ms, withDate) {
  const d = new Date(Math.round(ms)), f = d.getUTCMilliseconds();
  const day = `${d.getUTCFullYear()}-${pad(d.getUTCMonth() + 1, 2)}-${pad(d.getUTCDate(), 2)} `;
  return (withDate ? day : "") + `${pad(d.getUTCHours(), 2)}:${pad(d.getUTCMinutes(), 2)}:${pad(d.getUTCSeconds(), 2)}` + (f ? "." + pad(f, 3) : "");
}
// last index with a[k] <= v, in [lo, hi)
function below(a, v, lo, hi) {
  let l = lo, h = hi;
  while (l < h) { const m = (l + h) >> 1; if (a[m] <= v) l = m + 1; else h = m; }
  return l - 1;
}

const SYSTEMS = { G: "GPS", R: "GLONASS", E: "Galileo", C: "BeiDou", J: "QZSS", I: "NavIC", S: "SBAS" };
const E = D.epochs ? unpackAll(D.epochs) : null;
const S = D.sats ? unpackAll(D.sats) : null;
const T = D.truth ? unpackAll(D.truth) : null;
const NIS = D.nis ? unpackAll(D.nis) : null;

const times = E ? Float64Array.from(E.t_ms, (t) => t + E.t0_ms) : new Float64Array(0);
const count = times.length;
// time of any epoch, by its number in the whole solution; between shown ones by interpolation
function timeOf(full) {
  const k = Math.max(0, below(E.index, full, 0, count));
  if (E.index[k] === full || k + 1 >= count) return times[k];
  return times[k] + ((times[k + 1] - times[k]) * (full - E.index[k])) / (E.index[k + 1] - E.index[k]);
}
function nearest(ms) {
  const k = Math.max(0, below(times, ms, 0, count));
  return k + 1 < count && times[k + 1] - ms < ms - times[k] ? k + 1 : k;
}

const cells = S ? S.epoch.length : 0;
const cellTime = S ? Float64Array.from(S.epoch, timeOf) : null;
const azimuth = (k) => S.az[k] / 100;
const elevation = (k) => (S.el[k] <= -32768 ? NaN : S.el[k] / 100);
const vn = (k) => (S.vn[k] <= -32768 ? NaN : S.vn[k] / 100);
const statusName = (k) => S.statuses[S.status[k]];
const COUNTED = D.counted || "satellites";
const USED = D.kind === "simulation" ? "in view" : "used";
const kindOf = (name) => D.kinds[name] || "other";
const reason = (name) => D.reasons[name] || name;
const runPtr = S ? S.names.map((_, s) => below(S.runs.sv, s - 1, 0, S.runs.sv.length) + 1).concat(S.runs.sv.length) : null;
// status of a satellite at an epoch (number in the whole solution); null: not tracked
function statusAt(s, full) {
  const r = below(S.runs.first, full, runPtr[s], runPtr[s + 1]);
  return r >= runPtr[s] && S.runs.last[r] >= full ? S.statuses[S.runs.status[r]] : null;
}
function cellAt(s, full) {
  const k = below(S.epoch, full, S.ptr[s], S.ptr[s + 1]);
  return k >= S.ptr[s] && S.epoch[k] === full ? k : -1;
}
function ledgerAt(full) {
  const out = { used: [], refused: {}, n: 0 };
  for (let s = 0; s < S.names.length; s++) {
    const name = statusAt(s, full);
    if (name === null) continue;
    out.n++;
    if (name === "used") out.used.push(s);
    else (out.refused[name] = out.refused[name] || []).push(s);
  }
  return out;
}

const state = { i: 0, sv: -1, pinned: false, range: null, sky: "vn", residual: "vn", clock: "detrended", active: false };
const listeners = [];
const changed = (what) => listeners.forEach((f) => f(what));
function setEpoch(i, pin) {
  if (!count) return;
  state.i = Math.max(0, Math.min(count - 1, i));
  state.active = true;
  if (pin !== undefined) state.pinned = pin;
  changed("epoch");
}
function setSatellite(s) {
  state.sv = state.sv === s ? -1 : s;
  changed("satellite");
}
function clearAll() {
  state.sv = -1;
  state.pinned = false;
  state.active = false;
  changed("satellite");
  changed("epoch");
}
