// Motors, servos and rotors as bars with their numbers.
import { live } from "./live.js";
import { drawn, el, number, put } from "./draw.js";

const ROWS = [
  ["Upper", "motor_input", 0, false],
  ["Lower", "motor_input", 1, false],
  ["Pitch, servo 1", "servo_input", 0, true],
  ["Roll, servo 2", "servo_input", 1, true],
];
const RPM = 30 / Math.PI;

export function mount(element) {
  const rows = ROWS.map(([name, key, k, signed]) => {
    const fill = el("div", { class: "mf-bar-fill" });
    const track = el("div", { class: signed ? "mf-bar mf-bar-signed" : "mf-bar" }, fill);
    const value = el("span", { class: "mf-num" }), extra = el("span", { class: "mf-num mf-dim" });
    element.append(el("div", { class: "mf-bar-row", role: "group", "aria-label": name }, el("span", { text: name }), track, value, extra));
    return { key, k, signed, fill, track, value, extra };
  });
  const panel = live.panel({}, (f) => {
    if (!f.s) return;
    for (const r of rows) {
      const v = drawn(f.s[r.key]?.[r.k]), known = Number.isFinite(v);
      put(r.value, known ? (r.signed ? `${v > 0.005 ? "+" : v < -0.005 ? "−" : ""}${Math.abs(v * 100).toFixed(0)} %` : `${(v * 100).toFixed(0)} %`) : "–");
      const railed = known && (r.signed ? Math.abs(v) >= 0.999 : v >= 0.999);
      r.track.classList.toggle("mf-railed", railed);
      if (railed) r.track.title = "at the limit (saturated)";
      const size = known ? Math.min(1, Math.abs(v)) : 0;
      if (r.signed) r.fill.style.transform = `scaleX(${(v < 0 ? -1 : 1) * size})`;
      else r.fill.style.transform = `scaleX(${size})`;
      if (!r.signed) {
        const speed = f.s.rotor_speed[r.k];
        put(r.extra, Number.isFinite(speed) ? `${number(speed * RPM, 0)} rpm` : "");
      } else put(r.extra, railed ? "limit" : "");
    }
  });
  return { close: () => panel.close() };
}
