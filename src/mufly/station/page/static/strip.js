// The strip above everything: what the selected vehicle does, whatever the panels show.
import { forSeconds, live } from "./live.js";
import { el, icon, number, put } from "./draw.js";

const REFRESH_MS = 180;

export function mount(element) {
  const what = el("strong", { class: "mf-strip-what" }), how = el("span", { class: "mf-num" });
  const battery = el("span", { class: "mf-strip-battery mf-num", "data-testid": "strip-battery" }), pace = el("span", { class: "mf-strip-pace mf-num" }), when = el("span", { class: "mf-num" }), about = el("span", { role: "status" });
  element.append(el("div", { class: "mf-strip-line" }, what, how), el("div", { class: "mf-strip-about" }, battery, pace, when, about));
  let at = 0, said = "";

  function show(flight, start, trouble = "") {
    const f = flight || {}, stage = start?.stages.at(-1);
    const silent = flight && !f.connected, up = f.flying ? "Flying" : f.armed ? "Armed, on the floor" : "Disarmed, on the floor";
    element.dataset.state = silent ? "lost" : f.flying ? "flying" : f.armed ? "armed" : "";
    put(what, !flight ? (start?.fault ? "Vehicle start failed" : start ? "Starting" : "No vehicle") : silent ? `No message for ${number(f.silent_s, 0)} s` : up);
    put(how, !flight ? (stage && !start.fault ? `${stage[0]}, ${number(Math.floor(stage[1]), 0)} s` : "") : silent ? `last state: ${up.toLowerCase()}` : [f.flying ? f.state : "", f.flying ? `${number(f.height)} m` : ""].filter(Boolean).join("  "));
    const [charge, left] = f.battery || ["", ""];
    put(battery, left && `battery ${left}`);
    battery.dataset.level = charge;
    put(pace, f.pace || "");
    pace.title = f.pace ? "rate of the vehicle's clock relative to this machine's; a timing overrun is time that the simulation dropped" : "";
    pace.dataset.level = f.slow ? "warn" : "";
    const others = f.others?.length ? `; also armed: ${f.others.join("; ")}` : "";
    const link = trouble && (silent || !flight) ? ["error", trouble, 0] : null; // what is wrong with the link itself
    const [level, words, age] = start?.fault ? ["error", start.fault, 0] : link || f.alert || ["", flight ? f.name + others : "", 0];
    tell(level, words, age);
  }
  function tell(level, text, age = 0) {
    put(when, age >= 2 ? `${number(age, 0)} s ago` : "");
    if (said === level + text) return;
    said = level + text;
    about.dataset.level = level;
    about.title = text;
    about.replaceChildren(...(level ? [icon(level)] : []), text);
  }
  const panel = live.panel({}, (f) => {
    const now = performance.now();
    if (!f.about || (now - at < REFRESH_MS && !f.new)) return;
    at = now;
    show(f.about.flight, f.about.start, f.about.trouble);
  }, { offline: (yes) => {
    if (!yes) return;
    [at, element.dataset.state] = [0, "lost"];
    put(how, "");
    put(pace, "");
    put(battery, "");
    tell("warning", "this page cannot stop the motors: use the transmitter or its kill switch");
  }, silent: (ms) => put(what, `No link to the station${forSeconds(ms)}`) });
  show(null);
  return { close: () => panel.close() };
}
