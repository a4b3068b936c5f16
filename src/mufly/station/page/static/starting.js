// How far the start of the vehicle is, over the 3-D view: its stages with their seconds; why it failed stays.
import { live } from "./live.js";
import { el, icon, number, put } from "./draw.js";

export function mount(element) {
  const list = el("ol"), fault = el("p", { class: "mf-starting-fault", role: "alert", "data-testid": "start-fault" }), title = el("p", { class: "mf-dim" });
  const head = el("h2");
  element.append(el("div", { class: "mf-starting-card", "data-testid": "starting" }, head, title, list, fault));
  element.hidden = true;
  let shape = "";
  const panel = live.panel({}, (f) => {
    if (!f.about) return;
    const s = f.about.start;
    element.hidden = !s || Boolean(f.about.replay);
    if (element.hidden) return;
    const failed = s.fault && f.about.vehicles.length ? "The vehicle's process has ended" : s.fault ? "Vehicle start failed" : "Starting";
    put(head, failed);
    put(title, s.title);
    put(fault, s.fault);
    const next = JSON.stringify(s.stages.map(([text, , ended]) => [text, ended]));
    if (next !== shape) {
      shape = next;
      list.replaceChildren(...s.stages.map(([text, , ended]) => el("li", { class: ended ? "mf-dim" : "mf-starting-now" }, icon(ended ? "ok" : "here"), el("span", { text }), el("span", { class: "mf-num" }))));
    }
    s.stages.forEach(([, seconds], k) => put(list.children[k].lastChild, `${number(Math.floor(seconds), 0)} s`));
  });
  return { close: () => panel.close() };
}
