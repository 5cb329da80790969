// The epoch under the cursor: what was estimated, which satellites were used or refused, and the list to select from.
const box = document.getElementById("inspector");
let chips = [];
function buildInspector() {
  if (!box || !E || !count) { if (box) box.remove(); return; }
  const head = el("div", { class: "head" },
    el("button", { type: "button", class: "step", "aria-label": "Previous epoch", onclick: () => setEpoch(state.i - 1) }, "◀"),
    el("div", { class: "when", "aria-live": "polite" }, el("b", { id: "when" }), el("span", { id: "when-note" })),
    el("button", { type: "button", class: "step", "aria-label": "Next epoch", onclick: () => setEpoch(state.i + 1) }, "▶"),
    el("button", { type: "button", class: "fold", "aria-expanded": "false", "aria-label": "Show the epoch's values and satellites",
      onclick: (ev) => { const on = box.classList.toggle("open"); ev.currentTarget.setAttribute("aria-expanded", String(on)); } }, "▴"));
  const slider = el("input", { type: "range", min: 0, max: count - 1, value: 0, "aria-label": "Epoch", id: "slider" });
  slider.addEventListener("input", () => setEpoch(+slider.value));
  const body = el("div", { class: "body" }, el("dl", { id: "values" }));
  if (S) {
    body.append(el("h3", {}, "Satellites"), satelliteList(), el("div", { id: "why" }), el("div", { id: "one" }));
  }
  body.append(el("p", { class: "hint" }, "Hover moves the cursor, a click pins it. ← → step, Shift ×10. Esc clears. Drag zooms all time axes, double click resets."));
  box.append(head, slider, body);
}
function satelliteList() {
  const list = el("div", { class: "chips", role: "group", "aria-label": "Satellites" }), by = new Map();
  S.names.forEach((name, s) => { if (!by.has(name[0])) by.set(name[0], []); by.get(name[0]).push(s); });
  for (const [letter, members] of by) {
    const row = el("div", { class: "chiprow" }, el("span", { class: "sysname", style: `color:var(--sys-${letter})`, title: SYSTEMS[letter] || letter }, letter));
    for (const s of members) {
      const chip = el("button", { type: "button", class: "chip", "data-sat": S.names[s], "aria-pressed": "false", "aria-label": S.names[s], onclick: () => setSatellite(s) }, S.names[s].slice(1));
      chips[s] = chip;
      row.append(chip);
    }
    list.append(row);
  }
  return list;
}
function value(list, name, text) {
  if (text === null) return;
  list.append(el("dt", {}, name), el("dd", {}, text));
}
const trio = (a, i, decimals) => a.map((s) => (finite(s[i]) ? s[i].toFixed(Math.abs(s[i]) < 1000 ? decimals : 1).replace("-", "−") : "–")).join("  ");
function updateInspector() {
  if (!box || !E || !count) return;
  const i = state.i, full = E.index[i], flag = E.statuses[E.status[i]];
  document.getElementById("when").textContent = clock(times[i]);
  document.getElementById("when-note").textContent = `${clock(times[i], true).slice(0, 10)}  ${full + 1} / ${E.n}${state.pinned ? "  pinned" : ""}`;
  box.classList.toggle("pinned", state.pinned);
  document.getElementById("slider").value = i;
  const list = document.getElementById("values");
  list.replaceChildren();
  value(list, "status", flag === "none" ? "no position" : flag);
  list.lastChild.className = "status-" + flag;
  if (E.enu) value(list, "E N U, m", trio(E.enu, i, 2));
  if (E.sigma) value(list, "1σ, m", trio(E.sigma, i, 2));
  if (T) value(list, "error, m", trio(T.errors, i, 2));
  if (E.h) value(list, "height, m", finite(E.h[i]) ? E.h[i].toFixed(3) : "–");
  if (E.vel) value(list, "velocity, m/s", trio(E.vel, i, 2));
  if (E.extra.yaw_deg) value(list, "roll pitch yaw", trio(["roll_deg", "pitch_deg", "yaw_deg"].map((n) => E.extra[n]), i, 2));
  if (E.dop) value(list, "PDOP", num(E.dop[1][i]));
  if (E.nis && E.dof[i]) value(list, "NIS / dof", `${num(E.nis[i] / E.dof[i])} (${E.dof[i]})`);
  if (!S) { if (E.n_used[i]) value(list, COUNTED, String(E.n_used[i])); return; }
  const ledger = ledgerAt(full);
  value(list, "satellites", `${ledger.used.length} ${USED} of ${ledger.n}`);
  for (let s = 0; s < chips.length; s++) {
    const name = statusAt(s, full);
    chips[s].className = "chip " + (name === null ? "gone" : "k-" + kindOf(name)) + (s === state.sv ? " on" : "");
    chips[s].title = name === null ? `${S.names[s]} not tracked` : `${S.names[s]} ${name === "used" ? "used" : reason(name)}`;
    chips[s].setAttribute("aria-pressed", s === state.sv ? "true" : "false");
    chips[s].setAttribute("aria-label", chips[s].title);
  }
  const why = document.getElementById("why");
  why.replaceChildren();
  for (const name of Object.keys(ledger.refused)) {
    why.append(el("p", {}, el("i", { class: "tick kind-" + kindOf(name) }), el("b", {}, reason(name)), " " + ledger.refused[name].map((s) => S.names[s]).join(" ")));
  }
  const one = document.getElementById("one");
  one.replaceChildren();
  if (state.sv < 0) return;
  const s = state.sv, k = cellAt(s, full), dl = el("dl", {}), name = statusAt(s, full);
  value(dl, "now", name === null ? "not tracked" : name === "used" ? USED : reason(name));
  if (k >= 0 && S.el && finite(elevation(k))) value(dl, "elevation, azimuth", `${elevation(k).toFixed(1)}°  ${((azimuth(k) + 360) % 360).toFixed(1)}°`);
  if (k >= 0 && S.cn0 && S.cn0[k]) value(dl, "C/N0, dBHz", (S.cn0[k] / 4).toFixed(1));
  if (k >= 0 && S.v && finite(S.v[k])) value(dl, D.word + ", m", `${num(S.v[k])}  (${num(vn(k), 2)} σ)`);
  value(dl, "in the whole run", `used at ${S.table.used[s]} of ${S.table.seen[s]} epochs`);
  if (S.table.rms_m && finite(S.table.rms_m[s])) value(dl, "RMS", `${num(S.table.rms_m[s])} m, ${num(S.table.rms_n[s])} σ`);
  one.append(el("h3", {}, S.names[s], " ", el("small", {}, SYSTEMS[S.names[s][0]] || ""), el("button", { type: "button", class: "clear", "aria-label": "Clear the selection", onclick: () => setSatellite(s) }, "✕")), dl);
}
