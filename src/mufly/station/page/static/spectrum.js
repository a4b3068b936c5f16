// Power spectral density of one signal, with the rotors' frequencies marked.
import { live } from "./live.js";
import { FONT, canvas, colours, drawn, el, niceStep, number, ticks } from "./draw.js";

const KEY = "mufly-spectrum", LEFT = 58, BOTTOM = 30, TOP = 38, RIGHT = 12;

export function mount(element) {
  element.classList.add("mf-plots");
  let catalog = [], found = null, state = { signal: "measured_rates_p", seconds: 10 };
  try {
    Object.assign(state, JSON.parse(localStorage.getItem(KEY) || "{}"));
  } catch (error) { /* begin anew */ }
  const select = el("select", { "aria-label": "signal", onchange: () => choose(select.value) });
  const length = el("select", { "aria-label": "length of the window", onchange: () => choose(state.signal) }, ...[5, 10, 30, 60].map((s) => el("option", { value: s, text: `last ${s} s` })));
  length.value = String(state.seconds);
  const note = el("span", { class: "mf-dim mf-note" });
  const area = el("div", { class: "mf-plot-area" });
  element.append(el("div", { class: "mf-tools" }, select, length, note), el("div", { class: "mf-plot-list" }, el("div", { class: "mf-plot" }, area)));
  const view = canvas(area, "Power spectral density over frequency", draw);

  function choose(signal) {
    state = { signal, seconds: Number(length.value) };
    localStorage.setItem(KEY, JSON.stringify(state));
    found = null;
    panel.set({ spectrum: state.signal, spectrum_s: state.seconds });
    view.repaint();
  }
  function fill() {
    const names = catalog.flatMap((q) => Object.entries(q.signals).map(([id, name]) => [name, `${q.title} ${id.split("/").reverse().filter(Boolean).join(", ")}`]));
    select.replaceChildren(...names.map(([value, text]) => el("option", { value, text })));
    if (!names.some(([name]) => name === state.signal)) {
      const better = ["estimated_rates_p", "measured_rates_p", "truth_rates_p", "estimated_attitude_roll"]
        .map((wanted) => names.find(([name]) => name === wanted)).find(Boolean) || names[0];
      if (better) state.signal = better[0];
    }
    select.value = state.signal;
    panel.set({ spectrum: state.signal, spectrum_s: state.seconds });
  }

  function draw(ctx, w, h) {
    const x0 = LEFT, x1 = w - RIGHT, y0 = TOP, y1 = h - BOTTOM;
    ctx.font = `10px ${FONT}`;
    if (!(drawn(found?.rate) > 0)) {
      ctx.fillStyle = colours.dim;
      ctx.textAlign = "center";
      ctx.fillText(found ? "too few samples for a spectrum" : "waiting for samples", w / 2, h / 2);
      return;
    }
    const top = found.rate / 2, sx = (x1 - x0) / top;
    const values = found.d.map((d) => Math.log10(Math.max(d ?? 0, 1e-30)));
    let high = -Infinity, low = Infinity;
    for (const v of values) if (v > -29.9) (high = Math.max(high, v)), (low = Math.min(low, v));
    if (low > high) [low, high] = [-6, 0];
    high = Math.ceil(high + 0.2);
    low = Math.max(Math.floor(low), high - 10);
    const sy = (y1 - y0) / (high - low);
    ctx.strokeStyle = colours.grid;
    ctx.fillStyle = colours.dim;
    ctx.lineWidth = 1;
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    const decades = Math.max(1, Math.ceil((high - low) / Math.max(2, (y1 - y0) / 28)));
    for (const [, d] of ticks(0, high - low, decades)) {
      const k = low + d, y = y1 - (k - low) * sy;
      line(ctx, x0, y, x1, y);
      ctx.fillText(`10${superscript(k)}`, x0 - 6, y);
    }
    ctx.textAlign = "center";
    const step = niceStep(top, (x1 - x0) / 70);
    for (const [, f] of ticks(0, top, step)) {
      line(ctx, x0 + f * sx, y0, x0 + f * sx, y1);
      ctx.fillText(number(f, 0), x0 + f * sx, y1 + 10);
    }
    ctx.fillText("frequency (Hz)", (x0 + x1) / 2, y1 + 23);
    ctx.save();
    ctx.translate(11, (y0 + y1) / 2);
    ctx.rotate(-Math.PI / 2);
    ctx.fillText(`density (${found.unit === "1" ? "" : `(${found.unit})²`}/Hz)`.replace("(/Hz)", "(1/Hz)"), 0, 0);
    ctx.restore();
    ctx.strokeStyle = colours.c0;
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    found.f.forEach((f, k) => {
      const y = Math.min(y1, y1 - (values[k] - low) * sy);
      if (k) ctx.lineTo(x0 + f * sx, y);
      else ctx.moveTo(x0 + f * sx, y);
    });
    ctx.stroke();
    const marks = found.marks.filter((m) => Number.isFinite(drawn(m.at))).sort((a, b) => a.at - b.at);
    const ends = [-Infinity, -Infinity, -Infinity];
    for (const m of marks) {
      const x = x0 + m.at * sx, words = `${m.name} ${number(m.hz, 1)} Hz${m.folded ? " (folded)" : ""}`;
      ctx.strokeStyle = ctx.fillStyle = m.name.startsWith("upper") ? colours.c1 : colours.reference;
      ctx.setLineDash(m.folded ? [2, 3] : []);
      line(ctx, x, y0 - 2, x, y1);
      ctx.setLineDash([]);
      const wide = ctx.measureText(words).width, left = Math.min(x + 3, x1 - wide);
      const level = Math.max(0, ends.findIndex((end) => end < left));
      ends[level] = left + wide + 8;
      ctx.textAlign = "left";
      ctx.fillText(words, left, 6 + 11 * level);
    }
  }

  const panel = live.panel({ sections: ["catalog"], spectrum: state.signal, spectrum_s: state.seconds }, (f) => {
    if (f.catalog) {
      catalog = f.catalog;
      fill();
    }
    if (f.spectrum) {
      found = f.spectrum;
      const folded = found.marks?.some((m) => m.folded);
      note.textContent = found.rate ? `sampled at ${number(found.rate, 0)} Hz${folded ? "; dotted marks are above the Nyquist frequency and appear aliased" : ""}` : "";
      view.repaint();
    }
  });
  catalog = live.catalog;
  if (catalog.length) fill();
  return {
    close() {
      panel.close();
      view.close();
    },
  };
}

function line(ctx, a, b, c, d) {
  ctx.beginPath();
  ctx.moveTo(a, b);
  ctx.lineTo(c, d);
  ctx.stroke();
}

function superscript(n) {
  return String(n).replace("-", "⁻").replace(/[0-9]/g, (d) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[d]);
}
