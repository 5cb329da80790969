// Which panels there are, when they are drawn, keys, colours, printing.
Object.assign(specs, {
  track: trackSpec, motion: motionSpec, claimed: claimedSpec, errors: errorsSpec, cdf: cdfSpec, calibration: calibrationSpec,
  sky: skySpec, availability: availabilitySpec, residuals: residualsSpec, persat: persatSpec, nis: nisSpec, rho: rhoSpec,
  geometry: geometrySpec, attitude: attitudeSpec, biases: biasesSpec, clocks: clocksSpec,
});
const root = document.documentElement;

function keys(ev) {
  const step = ev.shiftKey ? 10 : 1;
  const to = { ArrowLeft: state.i - step, ArrowRight: state.i + step, Home: 0, End: count - 1 }[ev.key];
  if (to === undefined || !count || ev.target.tagName === "INPUT") return;
  ev.preventDefault();
  setEpoch(to, true);
}
document.addEventListener("keydown", (ev) => {
  // Before anything has been chosen, too; Home and End then move the page, as they do everywhere.
  if (ev.target === document.body && (ev.key === "ArrowLeft" || ev.key === "ArrowRight") && !ev.altKey && !ev.ctrlKey && !ev.metaKey) keys(ev);
  if (ev.key !== "Escape") return;
  hideTip();
  if (state.range) zoomTime(null);
  clearAll();
});

let frame = 0;
const pending = new Set();
listeners.push((what) => {
  pending.add(what);
  if (!frame) frame = requestAnimationFrame(() => {
    frame = 0;
    updateInspector();
    for (const p of panels.values()) p.overlay();
    root.dataset.satellite = S && state.sv >= 0 ? S.names[state.sv] : "";
    root.dataset.epoch = String(state.i);
    pending.clear();
  });
});

// Colours: as the system says until the switch is used
const dark = matchMedia("(prefers-color-scheme: dark)");
let chosen = null;
const theme = () => (printing ? "light" : chosen || (dark.matches ? "dark" : "light"));
function applyTheme() {
  const now = theme();
  if (root.dataset.theme === now) return;
  root.dataset.theme = now;
  const button = document.getElementById("theme");
  if (button) button.setAttribute("aria-pressed", String(now === "dark"));
  for (const p of panels.values()) p.redraw();
}
dark.addEventListener("change", applyTheme);
document.getElementById("theme").addEventListener("click", () => { chosen = root.dataset.theme === "dark" ? "light" : "dark"; applyTheme(); });
const printButton = document.getElementById("print");
printButton.hidden = false;
printButton.addEventListener("click", () => window.print());

function resize() { for (const p of panels.values()) if (p.gd && p.size().width !== p.width) { p.width = p.size().width; p.redraw(); } }
addEventListener("beforeprint", () => {
  printing = true;
  root.classList.add("printing");
  for (const d of document.querySelectorAll("details")) { d.dataset.was = d.open ? "1" : ""; d.open = true; }
  begin();
  root.dataset.theme = "light";
  for (const p of panels.values()) if (p.gd) p.redraw(); else p.draw();
});
addEventListener("afterprint", () => {
  printing = false;
  root.classList.remove("printing");
  for (const d of document.querySelectorAll("details")) d.open = d.dataset.was === "1";
  root.dataset.theme = theme();
  for (const p of panels.values()) p.redraw();
});

for (const group of document.querySelectorAll("[data-switch]")) {
  const name = group.dataset.switch;
  for (const b of group.querySelectorAll("button")) {
    if (name === "residual" && S && !quantities[b.dataset.value].there()) { b.remove(); continue; }
    if (name === "sky" && b.dataset.value === "cn0" && S && !S.cn0) { b.remove(); continue; }
    if (name === "clock" && b.dataset.value === "between" && E.clocks.length < 2) { b.remove(); continue; }
    if (b.getAttribute("aria-pressed") === "true") state[name] = b.dataset.value;
    b.addEventListener("click", () => {
      state[name] = b.dataset.value;
      for (const other of group.querySelectorAll("button")) other.setAttribute("aria-pressed", String(other === b));
      const p = panels.get(group.closest(".panel").querySelector(".plot").dataset.panel);
      if (p) p.redraw();
    });
  }
}
for (const b of document.querySelectorAll("button.sv")) {
  b.addEventListener("click", () => { const s = S ? S.names.indexOf(b.dataset.sv) : -1; if (s >= 0) { if (state.sv === s) setSatellite(s); else setSatellite(s); } });
}

applyTheme();
buildInspector();
updateInspector();
for (const place of document.querySelectorAll(".plot")) {
  const make = specs[place.dataset.panel];
  if (make) panels.set(place.dataset.panel, new Panel(place, make()));
}
const seen = new IntersectionObserver((entries) => {
  for (const e of entries) if (e.isIntersecting) { const p = panels.get(e.target.dataset.panel); if (p) { p.draw(); p.width = p.size().width; } seen.unobserve(e.target); }
}, { rootMargin: "200px" });
// Plotly takes most of a second to begin: words and numbers are shown before it does. It lies in the page as text.
function begin() {
  if (window.Plotly || !panels.size) return;
  document.head.append(el("script", {}, document.getElementById("plotly").textContent));
  document.getElementById("plotly").remove();
  for (const p of panels.values()) seen.observe(p.box);
}
// the rest when there is time, so that everything is there for searching and printing
const idle = window.requestIdleCallback || ((f) => setTimeout(f, 30));
function rest() {
  const next = [...panels.values()].find((p) => !p.gd);
  if (!next) { root.dataset.ready = "1"; return; }
  next.draw();
  next.width = next.size().width;
  idle(rest);
}
const start = () => { begin(); idle(rest); };
if (document.visibilityState === "hidden") setTimeout(start, 0);
else requestAnimationFrame(() => setTimeout(start, 0));
let waiting = 0;
addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(resize, 120); });
// the section one is in
const links = new Map([...document.querySelectorAll("header.top nav a")].map((a) => [a.getAttribute("href").slice(1), a]));
const where = new IntersectionObserver((entries) => {
  for (const e of entries) { const a = links.get(e.target.id); if (a) a.classList.toggle("here", e.isIntersecting); }
}, { rootMargin: "-45% 0px -50% 0px" });
for (const s of document.querySelectorAll("main > section")) where.observe(s);
