// What the drawn panels share: colours of the theme, canvases that follow their size, ticks, numbers as text.

export const colours = {};
const watchers = new Set();
const NAMES = [
  "bg", "panel", "line", "text", "dim", "accent", "good", "warn", "bad", "sky", "ground", "reference",
  "c0", "c1", "c2", "c3", "c4", "c5", "c6", "c7", "grid",
];

function read() {
  const style = getComputedStyle(document.body);
  for (const name of NAMES) colours[name] = style.getPropertyValue(`--mf-${name}`).trim();
  for (const tell of watchers) tell();
}
read();
new MutationObserver(read).observe(document.body, { attributes: true, attributeFilter: ["class"] });
window.addEventListener("load", read);

export function onTheme(tell) {
  watchers.add(tell);
  return () => watchers.delete(tell);
}

export const FONT = "system-ui, 'Segoe UI', Roboto, 'Noto Sans', 'DejaVu Sans', sans-serif";

// Whether pictures are drawn by the processor: then simpler ones, and canvases that stay out of the graphics process.
export const software = (() => {
  const gl = document.createElement("canvas").getContext("webgl");
  const about = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return !gl || /swiftshader|llvmpipe|software|basic render/i.test(name);
})();

// A canvas that fills its element; draw(ctx, width, height) in CSS pixels is called when something has changed.
export function canvas(element, label, draw) {
  const node = document.createElement("canvas");
  node.setAttribute("role", "img");
  node.setAttribute("aria-label", label);
  element.append(node);
  const ctx = node.getContext("2d", { willReadFrequently: software });
  let asked = null;
  function paint() {
    asked = null;
    const ratio = window.devicePixelRatio || 1, { clientWidth: w, clientHeight: h } = element;
    if (!w || !h) return;
    if (node.width !== Math.round(w * ratio) || node.height !== Math.round(h * ratio)) {
      node.width = Math.round(w * ratio);
      node.height = Math.round(h * ratio);
    }
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    draw(ctx, w, h);
  }
  const repaint = () => {
    if (asked === null) asked = requestAnimationFrame(paint);
  };
  const sizes = new ResizeObserver(repaint);
  sizes.observe(element);
  const off = onTheme(repaint);
  return {
    node,
    ctx,
    repaint,
    close() {
      sizes.disconnect();
      off();
      if (asked !== null) cancelAnimationFrame(asked);
    },
  };
}

// What a vehicle says may be any number: what enters a drawing goes through here. Beyond MOST it is not known.
export const MOST = 1e6;
export const drawn = (value, most = MOST) => (Number.isFinite(value) && Math.abs(value) <= most ? value : NaN);
export const place3 = (p) => [0, 1, 2].map((k) => drawn(p?.[k]));
export const clamped = (value, low, high) => (Number.isFinite(value) ? Math.min(high, Math.max(low, value)) : low);

// The multiples of a step from low to high, as [k, k * step]; none where they are more than can be drawn or told apart.
const MOST_TICKS = 500;
export function ticks(low, high, step) {
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  if (!(last - first < MOST_TICKS && step > 0 && Math.abs(first) < 2 ** 52 && Math.abs(last) < 2 ** 52)) return [];
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, k) => [first + k, (first + k) * step]);
}

export function niceStep(span, count) {
  if (!(span > 0 && span < Infinity)) return 1;
  const raw = span / Math.max(count, 1), power = 10 ** Math.floor(Math.log10(raw)), r = raw / power;
  return power * (r <= 1 ? 1 : r <= 2 ? 2 : r <= 5 ? 5 : 10);
}

// The step of an axis so many pixels long: of 1, 2, 5, 10 ..., with at least two numbers on it however short it is.
export function tickStep(low, high, pixels) {
  let step = niceStep(high - low, Math.max(2, pixels / 26));
  for (let tries = 0; tries < 8 && Math.floor(high / step) - Math.ceil(low / step) < 1; tries++) {
    step /= Math.round(step / 10 ** Math.floor(Math.log10(step) + 1e-9)) === 5 ? 2.5 : 2;
  }
  return step;
}

export function number(value, digits = 2) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = Math.abs(value) < 1e9 ? value.toFixed(clamped(digits, 0, 20)) : value.toExponential(1);
  return text.startsWith("-") ? (Number(text) === 0 ? text.slice(1) : `−${text.slice(1)}`) : text;
}

export function clock(seconds) {
  if (!Number.isFinite(drawn(seconds, 1e9))) return "–";
  const sign = seconds < 0 ? "−" : "", s = Math.abs(seconds), m = Math.floor(s / 60);
  return `${sign}${m}:${(s - 60 * m).toFixed(1).padStart(4, "0")}`;
}

export const DEG = 180 / Math.PI;

export function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "class") node.className = value;
    else if (key === "text") node.textContent = value;
    else if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.filter((c) => c !== null));
  return node;
}

// Set a text only when it differs: text nodes that are written needlessly cost layout.
export function put(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

const ICONS = {
  info: "M12 2a10 10 0 1 0 0 20 10 10 0 0 0 0-20zm1 15h-2v-6h2zm0-8h-2V7h2z",
  warning: "M1 21h22L12 2zm12-3h-2v-2h2zm0-4h-2v-4h2z",
  error: "M8 2h8l6 6v8l-6 6H8l-6-6V8zm5 15h-2v-2h2zm0-4h-2V7h2z",
  ok: "M9 16.2 4.8 12l-1.4 1.4L9 19 21 7l-1.4-1.4z",
  open: "M12 5a7 7 0 1 0 0 14 7 7 0 0 0 0-14zm0 2a5 5 0 1 1 0 10 5 5 0 0 1 0-10z",
  here: "M5 3l14 9-14 9z",
  sound: "M3 9v6h4l5 5V4L7 9zm13.5 3A4.5 4.5 0 0 0 14 7.97v8.05A4.5 4.5 0 0 0 16.5 12zM14 3.23v2.06a7 7 0 0 1 0 13.42v2.06a9 9 0 0 0 0-17.54z",
  mute: "M3 9v6h4l5 5V4L7 9zm18.3.1-1.4-1.4-2.4 2.4-2.4-2.4-1.4 1.4 2.4 2.4-2.4 2.4 1.4 1.4 2.4-2.4 2.4 2.4 1.4-1.4-2.4-2.4z",
};
export function icon(name) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("class", `mf-icon mf-${name}`);
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", ICONS[name]);
  svg.append(path);
  return svg;
}
