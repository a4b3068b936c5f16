// Live plots: any quantity, its components and sources chosen; several under each other on one time axis.
import { live } from "./live.js";
import { el } from "./draw.js";
import { DASHES, plot } from "./plot.js";

const KEY = "mufly-plots", MOST = 6;
const DEFAULT = { window_s: 30, plots: [{ key: "position" }, { key: "attitude" }] };
const PALETTE = ["c0", "c1", "c2", "c3", "c4", "c5", "c6", "c7"];
const WINDOWS = [[5, "5 s"], [10, "10 s"], [30, "30 s"], [120, "2 min"], [600, "10 min"]];

function remembered() {
  try {
    const found = JSON.parse(localStorage.getItem(KEY));
    if (Array.isArray(found?.plots) && found.plots.length) return found;
  } catch (error) { /* a stranger's entry: begin anew */ }
  return structuredClone(DEFAULT);
}

export function mount(element) {
  element.classList.add("mf-plots");
  let beside = "", state = remembered(), catalog = [], fixed = null, paused = false;
  const cards = [];
  const keep = () => localStorage.setItem(KEY, JSON.stringify(state));

  const span = () => {
    if (fixed) return fixed;
    const { t, n } = live.samples, to = n ? t[n - 1] : state.window_s;
    return { from: to - state.window_s, to };
  };
  const onSpan = (from, to) => {
    fixed = from === null ? null : { from, to };
    paused = fixed !== null;
    show();
  };

  const pause = el("button", { type: "button", onclick: () => (paused ? onSpan(null) : onSpan(span().from, span().to)) });
  const windows = el("select", { "aria-label": "length of the time axis", onchange: () => {
    state.window_s = Number(windows.value);
    fixed = null;
    paused = false;
    keep();
    panel.set({ window_s: state.window_s });
    show();
  } }, ...WINDOWS.map(([s, text]) => el("option", { value: s, text })));
  windows.value = String(state.window_s);
  const add = el("button", { type: "button", text: "Add plot", onclick: () => {
    if (state.plots.length >= MOST) return;
    const used = new Set(state.plots.map((p) => p.key));
    state.plots.push({ key: (catalog.find((q) => !used.has(q.key)) || catalog[0])?.key || "position" });
    keep();
    build();
  } });
  const legend = el("span", { class: "mf-legend" }, ...["estimated", "measured", "reference", "truth"].map((s) => el("span", {}, stroke(s), s)), el("span", { title: "estimate ± three standard deviations" }, "shaded: 3σ"));
  const pair = el("span", { class: "mf-legend mf-legend-pair", hidden: true, "data-testid": "compare-legend" });
  const list = el("div", { class: "mf-plot-list" });
  element.append(el("div", { class: "mf-tools" }, pause, windows, add, pair, legend), list);

  function stroke(source, wide = 26) {
    const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    svg.setAttribute("width", wide);
    svg.setAttribute("height", 8);
    svg.setAttribute("aria-hidden", "true");
    svg.innerHTML = `<line x1="0" y1="4" x2="${wide}" y2="4" stroke="currentColor" stroke-width="1.8" stroke-dasharray="${DASHES[source].join(" ")}"/>`;
    return svg;
  }

  function traces(p) {
    const q = catalog.find((c) => c.key === p.key);
    if (!q) return { q: null, list: [] };
    const out = [];
    // What was remembered of it may have other names by now.
    if (p.components && !p.components.some((c) => q.components.includes(c))) p.components = undefined;
    q.components.forEach((component, k) => {
      if (p.components && !p.components.includes(component)) return;
      for (const source of q.sources) {
        if (p.sources && !p.sources.includes(source)) continue;
        const signal = q.signals[`${source}/${component}`];
        const factor = q.upward.includes(component) ? -q.factor : q.factor;
        const band = q.bands?.[`${source}/${component}`];
        const turn = q.unit === "°" ? 360 / Math.abs(q.factor) : 0;
        if (signal) out.push({ signal, band, component, source, turn, colour: PALETTE[k % PALETTE.length], factor });
      }
    });
    // Of the recording beside it the same components once, whoever spoke of them.
    if (!beside) return { q, list: out };
    const once = out.filter((one, k) => out.findIndex((o) => o.component === one.component) === k);
    return { q, list: once.flatMap((one) => [{ ...one, band: undefined }, { ...one, band: undefined, source: "compared", of: one.signal, signal: `compared/${one.signal}` }]) };
  }

  function build() {
    cards.splice(0).forEach((c) => c.plot.close());
    list.replaceChildren();
    state.plots.forEach((p, k) => {
      const { q, list: shown } = traces(p);
      const select = el("select", { "aria-label": "quantity", onchange: () => {
        state.plots[k] = { key: select.value };
        keep();
        build();
      } }, ...catalog.map((c) => el("option", { value: c.key, text: c.title })));
      if (q) select.value = q.key;
      const chips = el("span", { class: "mf-chips" });
      const toggle = (field, all, value, node) => {
        const on = new Set(p[field] || all);
        if (on.has(value)) on.delete(value);
        else on.add(value);
        p[field] = on.size === all.length ? undefined : all.filter((x) => on.has(x));
        keep();
        build();
        list.children[k]?.querySelector(`[data-chip="${node}"]`)?.focus();
      };
      const chip = (field, all, value, colour) => {
        const id = `${field}-${value}`, on = !p[field] || p[field].includes(value);
        const button = el("button", { type: "button", "aria-pressed": on, "data-chip": id, onclick: () => toggle(field, all, value, id) });
        if (field === "components") button.style.setProperty("--chip", `var(--mf-${colour})`);
        // A source is a kind of line; its name is in the legend above.
        if (field === "sources") {
          button.append(stroke(value, 14));
          button.title = value;
          button.setAttribute("aria-label", value);
        } else button.append(value);
        chips.append(button);
      };
      if (q && q.components.length > 1) q.components.forEach((c, i) => chip("components", q.components, c, PALETTE[i % PALETTE.length]));
      if (q && q.sources.length > 1) q.sources.forEach((s) => chip("sources", q.sources, s, ""));
      const remove = state.plots.length > 1 ? el("button", { type: "button", class: "mf-close", text: "✕", "aria-label": "remove this plot", onclick: () => {
        state.plots.splice(k, 1);
        keep();
        build();
      } }) : null;
      const area = el("div", { class: "mf-plot-area" });
      list.append(el("div", { class: "mf-plot" }, el("div", { class: "mf-plot-head" }, select, chips, remove), area));
      const drawn = plot(area, `${q?.title || p.key} over time`, span, onSpan);
      drawn.set(shown, q?.unit || "");
      cards.push({ plot: drawn, signals: shown.flatMap((s) => (s.band ? [s.signal, s.band] : [s.signal])) });
    });
    add.disabled = state.plots.length >= MOST;
    panel?.set({ signals: cards.flatMap((c) => c.signals) });
  }
  function show() {
    pause.textContent = paused ? "▶ Live" : "❚❚ Pause";
    pause.setAttribute("aria-pressed", paused);
    cards.forEach((c) => c.plot.repaint());
  }

  let version = -1;
  function compare(about) {
    const next = about?.compared ? `${about.replay?.name}|${about.compared.name}` : "";
    if (next === beside) return;
    beside = next;
    const [one, two] = next.split("|");
    pair.hidden = !next;
    pair.replaceChildren(...(next ? [el("span", {}, stroke("estimated"), one), el("span", {}, stroke("compared"), two)] : []));
    build();
  }
  const panel = live.panel({ sections: ["catalog"], signals: [], window_s: state.window_s }, (f) => {
    if (f.catalog) {
      catalog = f.catalog;
      build();
    }
    if (f.about) compare(f.about);
    if (f.new) onSpan(null);
    if (live.samples.version !== version && !paused) {
      version = live.samples.version;
      cards.forEach((c) => c.plot.repaint());
    }
  });
  catalog = live.catalog;
  build();
  show();
  return {
    close() {
      panel.close();
      cards.forEach((c) => c.plot.close());
    },
  };
}
