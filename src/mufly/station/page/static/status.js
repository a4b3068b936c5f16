// The line on top: what it does, whether the motors may run, battery, link, clock.
import { live } from "./live.js";
import { clamped, clock, el, number, put } from "./draw.js";

export function mount(element) {
  element.classList.add("mf-status");
  const item = (label, cls = "") => {
    const value = el("span", { class: "mf-status-value" });
    element.append(el("div", { class: `mf-status-item ${cls}` }, el("span", { class: "mf-status-label", text: label }), value));
    return value;
  };
  const state = item("state", "mf-status-state"), motors = item("motors"), position = item("N, E, height", "mf-wide"), battery = item("battery"), link = item("link", "mf-wide"), time = item("time");
  const gauge = el("span", { class: "mf-gauge", "aria-hidden": "true" }, el("span"));
  battery.before(gauge);
  gauge.hidden = true;
  let at = 0;
  function nothing() {
    for (const value of [state, motors, position, battery, link, time]) {
      put(value, "–");
      value.parentElement.dataset.level = "";
    }
    gauge.hidden = true;
  }
  nothing();
  const panel = live.panel({}, (f) => {
    const now = performance.now();
    if (now - at < 180 && !f.new) return;
    at = now;
    if (!f.s) return nothing();
    const s = f.s, recording = f.about?.replay;
    put(state, !s.connected ? `no message for ${number(s.silent_s, 0)} s` : s.state ? s.state[0].toUpperCase() + s.state.slice(1) : "–");
    state.parentElement.dataset.level = s.connected ? "" : "bad";
    put(motors, s.armed ? (s.flying ? "armed, flying" : "armed, on the floor") : "disarmed");
    motors.parentElement.dataset.level = s.armed ? "warn" : "";
    const [n, e, d] = s.position;
    put(position, n === null ? "–" : `${number(n)}  ${number(e)}  ${number(d === null ? NaN : -d)} m`);
    const charge = s.battery_charge, left = s.battery_left_s;
    put(battery, `${number(s.battery_voltage)} V${charge === null ? "" : `  ${number(charge * 100, 0)} %`}${left === null || !Number.isFinite(left) ? "" : `  ${clock(left).split(".")[0]} left`}`);
    battery.parentElement.dataset.level = charge !== null && charge < 0.15 ? "bad" : charge !== null && charge < 0.3 ? "warn" : "";
    gauge.firstChild.style.transform = `scaleX(${clamped(charge, 0, 1)})`;
    gauge.hidden = charge === null;
    put(link, recording ? "recording" : s.link_rate_Hz === null ? "–" : `${number(s.link_rate_Hz, 0)}/s  ${number((s.link_loss ?? 0) * 100, 1)} % lost`);
    link.parentElement.dataset.level = !recording && (s.link_loss ?? 0) > 0.1 ? "warn" : "";
    put(time, clock(s.time_s));
  }, { offline: (yes) => {
    if (yes) put(state, "no link to the station"), (state.parentElement.dataset.level = "bad");
  } });
  return { close: () => panel.close() };
}
