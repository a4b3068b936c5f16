// One plot: a quantity over time. Colour tells the component, the kind of line tells who says so.
import { live } from "./live.js";
import { FONT, canvas, colours, drawn as bounded, niceStep, number, tickStep, ticks } from "./draw.js";

export const DASHES = { compared: [5, 4], estimated: [], measured: [1.5, 2.5], reference: [7, 4], truth: [10, 3, 2, 3], "": [] };
const WIDTHS = { compared: 1.7, estimated: 1.7, measured: 1.4, reference: 1.5, truth: 1.1, "": 1.6 };
const LEFT = 46, BOTTOM = 18, TOP = 6, RIGHT = 8;
const BREAK_S = 0.6, FAR = 1e12; // beyond, a value does not stretch the axis

// span() returns { from, to } of the time axis; onSpan(from, to) asks for another one, onSpan(null) for the live one.
export function plot(element, label, span, onSpan) {
  let traces = [], unit = "", cursor = null;
  const view = canvas(element, label, draw);

  function find(t, n, value) {
    let low = 0, high = n;
    while (low < high) {
      const mid = (low + high) >> 1;
      if (t[mid] < value) low = mid + 1;
      else high = mid;
    }
    return low;
  }

  function draw(ctx, w, h) {
    const { t, n } = live.samples, { from, to } = span(), x0 = LEFT, x1 = w - RIGHT, y0 = TOP, y1 = h - BOTTOM;
    if (x1 - x0 < 20 || y1 - y0 < 20) return;
    const first = Math.max(0, find(t, n, from) - 1), last = Math.min(n, find(t, n, to) + 1);
    const drawn = unwrapped(traces.map((trace) => [trace, live.column(trace.signal)]).filter(([, c]) => c), first, last);
    let least = Infinity, most = -Infinity;
    // The shade of three deviations is never let make the axis more than a few times as long as what is drawn.
    const wide = (trace) => (trace.band && live.column(trace.band)) || null;
    for (const [trace, c] of drawn) {
      for (let i = first; i < last; i++) {
        const v = bounded(c[i] * trace.factor, FAR);
        if (v < least) least = v;
        if (v > most) most = v;
      }
    }
    const reach = Math.max(most - least, 0.02);
    for (const [trace, c] of drawn) {
      const sigma = wide(trace);
      if (!sigma) continue;
      const [under, over] = [least - reach, most + reach];
      for (let i = first; i < last; i++) {
        const v = bounded(c[i] * trace.factor, FAR), d = bounded(Math.abs(3 * sigma[i] * trace.factor), FAR);
        if (v - d < least && v - d > under) least = v - d;
        if (v + d > most && v + d < over) most = v + d;
      }
    }
    if (least > most) [least, most] = [-1, 1];
    let low = least, high = most;
    const room = Math.max((high - low) * 0.06, Math.abs(high) * 1e-4, 0.002);
    low -= room;
    high += room;
    const sx = (x1 - x0) / (to - from), sy = (y1 - y0) / (high - low);
    grid(ctx, { x0, x1, y0, y1, from, to, low, high, sx, sy });
    ctx.save();
    ctx.beginPath();
    ctx.rect(x0, y0, x1 - x0, y1 - y0);
    ctx.clip();
    const bucket = Math.max(1, Math.floor((last - first) / (x1 - x0)));
    for (const [trace, c] of drawn) {
      const sigma = wide(trace);
      if (sigma) shade(ctx, trace, c, sigma, { t, first, last, bucket, x: (time) => x0 + (time - from) * sx, y: (v) => y1 - (v - low) * sy });
    }
    for (const [trace, c] of drawn) {
      ctx.strokeStyle = colours[trace.colour];
      ctx.lineWidth = WIDTHS[trace.source] || 1.5;
      ctx.setLineDash(DASHES[trace.source] || []);
      ctx.beginPath();
      let before = -Infinity;
      const point = (time, v) => {
        const x = x0 + (time - from) * sx, y = y1 - (v * trace.factor - low) * sy;
        if (time - before > BREAK_S + 3 * (bucket > 1 ? (to - from) / (x1 - x0) : 0)) ctx.moveTo(x, y);
        else ctx.lineTo(x, y);
        before = time;
      };
      // Dense data: the least and the greatest of each bucket, in order; buckets stay put as time goes on.
      for (let i = first - (first % bucket); i < last; i += bucket) {
        if (bucket === 1) {
          if (c[i] === c[i]) point(t[i], c[i]);
          continue;
        }
        let a = -1, b = -1;
        for (let k = Math.max(i, 0); k < Math.min(i + bucket, last); k++) {
          if (c[k] !== c[k]) continue;
          if (a < 0 || c[k] < c[a]) a = k;
          if (b < 0 || c[k] > c[b]) b = k;
        }
        if (a < 0) continue;
        point(t[Math.min(a, b)], c[Math.min(a, b)]);
        if (a !== b) point(t[Math.max(a, b)], c[Math.max(a, b)]);
      }
      ctx.stroke();
    }
    ctx.setLineDash([]);
    names(ctx, drawn, { first, last, x0, x1, y0, y1, x: (i) => x0 + (t[i] - from) * sx, y: (v) => y1 - (v - low) * sy });
    ctx.restore();
    if (cursor !== null && n) reading(ctx, { x0, x1, y0, y1, from, sx, t, n, drawn, find });
  }

  // Angles as they go on, without jumps at half a turn, in whole turns that lie about zero; who says so does not matter.
  function unwrapped(found, first, last) {
    const ranges = new Map(); // of each component: where it begins, its least and its greatest
    const out = found.map(([trace, c]) => {
      if (!trace.turn) return [trace, c];
      const own = new Float64Array(last).fill(NaN), range = ranges.get(trace.component) || { start: NaN, low: Infinity, high: -Infinity };
      ranges.set(trace.component, range);
      let before = Number.isFinite(range.start) ? range.start : 0;
      for (let i = first; i < last; i++) {
        if (!Number.isFinite(c[i])) continue;
        own[i] = before = c[i] - trace.turn * Math.round((c[i] - before) / trace.turn);
        if (!Number.isFinite(range.start)) range.start = own[i];
        range.low = Math.min(range.low, own[i]);
        range.high = Math.max(range.high, own[i]);
      }
      return [trace, own];
    });
    for (const [trace, c] of out) {
      const range = trace.turn && ranges.get(trace.component), shift = range ? trace.turn * Math.round((range.low + range.high) / 2 / trace.turn) : 0;
      if (shift && Number.isFinite(shift)) for (let i = first; i < last; i++) c[i] -= shift;
    }
    return out;
  }

  // The component beside the end of its line: colours alone do not tell them apart.
  function names(ctx, drawn, g) {
    const shown = new Set(), taken = [];
    ctx.font = `600 10px ${FONT}`;
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    for (const [trace, c] of drawn) {
      if (!trace.component || shown.has(trace.component)) continue;
      let i = g.last - 1;
      while (i >= g.first && !(c[i] === c[i] && g.x(i) <= g.x1)) i--;
      if (i < g.first) continue;
      shown.add(trace.component);
      let y = Math.max(g.y0 + 7, Math.min(g.y1 - 7, g.y(c[i] * trace.factor) - 8));
      while (taken.some((other) => Math.abs(other - y) < 11)) y += 11;
      taken.push(y);
      const wide = ctx.measureText(trace.component).width, x = Math.max(g.x0 + wide + 6, Math.min(g.x1 - 3, g.x(i) - 3));
      ctx.fillStyle = colours.panel;
      ctx.globalAlpha = 0.8;
      ctx.fillRect(x - wide - 2, y - 6, wide + 4, 12);
      ctx.globalAlpha = 1;
      ctx.fillStyle = colours[trace.colour];
      ctx.fillText(trace.component, x, y);
    }
  }

  // What is believed to lie within three deviations, piece by piece where they are known.
  function shade(ctx, trace, c, sigma, g) {
    let above = [], below = [];
    const fill = () => {
      if (above.length > 1) {
        ctx.beginPath();
        [...above, ...below.reverse()].forEach(([x, y], k) => (k ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
        ctx.fill();
      }
      [above, below] = [[], []];
    };
    ctx.fillStyle = colours[trace.colour];
    ctx.globalAlpha = 0.14;
    let before = -Infinity;
    for (let i = g.first - (g.first % g.bucket); i < g.last; i += g.bucket) {
      const k = Math.max(i, 0), v = c[k] * trace.factor, d = 3 * sigma[k] * Math.abs(trace.factor);
      if (v !== v || d !== d) continue;
      if (g.t[k] - before > BREAK_S + 3 * g.bucket * 0.05) fill();
      before = g.t[k];
      above.push([g.x(g.t[k]), g.y(v + d)]);
      below.push([g.x(g.t[k]), g.y(v - d)]);
    }
    fill();
    ctx.globalAlpha = 1;
  }

  // Above it stands the unit.
  const top = (g) => g.y0 + (unit ? 12 : 0);

  function grid(ctx, g) {
    ctx.font = `10px ${FONT}`;
    ctx.fillStyle = colours.dim;
    ctx.strokeStyle = colours.grid;
    ctx.lineWidth = 1;
    const step = tickStep(g.low, g.high - (top(g) - g.y0) / g.sy, g.y1 - top(g));
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    ctx.beginPath();
    for (const [, value] of ticks(g.low, g.high, step)) {
      const y = Math.round(g.y1 - (value - g.low) * g.sy) + 0.5;
      ctx.moveTo(g.x0, y);
      ctx.lineTo(g.x1, y);
      if (y > top(g)) ctx.fillText(number(value, digits), g.x0 - 5, y);
    }
    const long = niceStep(g.to - g.from, Math.max(2, (g.x1 - g.x0) / 70));
    const places = Math.max(0, -Math.floor(Math.log10(long) + 1e-9));
    ctx.textAlign = "center";
    ctx.textBaseline = "alphabetic";
    for (const [, time] of ticks(g.from, g.to, long)) {
      const x = Math.round(g.x0 + (time - g.from) * g.sx) + 0.5;
      ctx.moveTo(x, g.y0);
      ctx.lineTo(x, g.y1);
      if (x < g.x1 - 22) ctx.fillText(number(time, places), x, g.y1 + 13);
    }
    ctx.stroke();
    ctx.textAlign = "right";
    ctx.fillText("s", g.x1, g.y1 + 13);
    ctx.fillStyle = colours.text;
    ctx.fillText(unit, g.x0 - 5, g.y0 + 9);
    ctx.strokeStyle = colours.line;
    ctx.strokeRect(g.x0 + 0.5, g.y0 + 0.5, g.x1 - g.x0, g.y1 - g.y0);
  }

  function reading(ctx, g) {
    const x = Math.max(g.x0, Math.min(g.x1, cursor)), at = g.from + (x - g.x0) / g.sx;
    const i = Math.min(g.n - 1, Math.max(0, g.find(g.t, g.n, at)));
    const words = [[`${number(g.t[i], 2)} s`, colours.text]];
    for (const [trace, c] of g.drawn) {
      let k = i;
      while (k > 0 && !(c[k] === c[k]) && i - k < 20) k--;
      const value = c[k] * trace.factor, first = trace.source === "compared" && g.drawn.find(([other]) => other.signal === trace.of);
      const off = first ? first[1][i] * first[0].factor - value : NaN;
      words.push([`${trace.component ? `${trace.component} ` : ""}${trace.source || ""} ${number(value, 3)}${Number.isFinite(off) ? ` (Δ ${off < 0 ? "" : "+"}${number(off, 3)})` : ""}`, colours[trace.colour]]);
    }
    ctx.strokeStyle = colours.dim;
    ctx.beginPath();
    ctx.moveTo(Math.round(x) + 0.5, g.y0);
    ctx.lineTo(Math.round(x) + 0.5, g.y1);
    ctx.stroke();
    ctx.font = `10px ${FONT}`;
    const wide = Math.max(...words.map(([word]) => ctx.measureText(word).width)) + 10;
    const high = Math.min(words.length * 12 + 6, g.y1 - g.y0 - 4), left = x + wide + 8 > g.x1 ? x - wide - 6 : x + 6;
    ctx.fillStyle = colours.panel;
    ctx.globalAlpha = 0.92;
    ctx.fillRect(left, g.y0 + 3, wide, high);
    ctx.globalAlpha = 1;
    ctx.textAlign = "left";
    words.forEach(([word, colour], k) => {
      if (k * 12 + 12 > high) return;
      ctx.fillStyle = colour;
      ctx.fillText(word, left + 5, g.y0 + 14 + 12 * k);
    });
  }

  // Wheel: zoom about the pointer; drag: move along; double click: back to live.
  const node = view.node;
  let dragging = null;
  const timeAt = (event) => {
    const box = node.getBoundingClientRect(), { from, to } = span();
    return from + ((event.clientX - box.left - LEFT) / Math.max(1, box.width - LEFT - RIGHT)) * (to - from);
  };
  node.addEventListener("wheel", (event) => {
    event.preventDefault();
    const { from, to } = span(), at = timeAt(event), by = event.deltaY > 0 ? 1.25 : 0.8;
    if ((to - from) * by > 0.05 && (to - from) * by < 1e5) onSpan(at - (at - from) * by, at + (to - at) * by);
  }, { passive: false });
  node.addEventListener("pointerdown", (event) => {
    dragging = { x: event.clientX, ...span(), moved: false };
    node.setPointerCapture(event.pointerId);
  });
  node.addEventListener("pointermove", (event) => {
    cursor = event.clientX - node.getBoundingClientRect().left;
    if (dragging && Math.abs(event.clientX - dragging.x) > 3) {
      const shift = ((event.clientX - dragging.x) * (dragging.to - dragging.from)) / Math.max(1, node.clientWidth - LEFT - RIGHT);
      onSpan(dragging.from - shift, dragging.to - shift);
    }
    view.repaint();
  });
  node.addEventListener("pointerup", () => (dragging = null));
  node.addEventListener("pointerleave", () => {
    cursor = null;
    view.repaint();
  });
  node.addEventListener("dblclick", () => onSpan(null));

  return {
    // traces: [{ signal, component, source, colour, factor }]
    set(next, nextUnit) {
      [traces, unit] = [next, nextUnit];
      view.repaint();
    },
    repaint: view.repaint,
    close: view.close,
  };
}
