// Which vehicle is shown, when several are heard; its name when there is one.
import { live } from "./live.js";
import { el, put } from "./draw.js";

export function mount(element, options, emit) {
  const name = el("strong", { class: "mf-vehicle-name" });
  const select = el("select", { "aria-label": "vehicle", hidden: true, onchange: () => emit("select", select.value) });
  element.append(name, select);
  let key = "";
  const panel = live.panel({}, (f) => {
    const { vehicles = [], selected = "", replay } = f.about || {};
    const many = vehicles.length > 1 || (vehicles.length && replay);
    name.hidden = Boolean(many) && !replay;
    select.hidden = !many;
    put(name, replay ? replay.name : selected || "no vehicle");
    const next = JSON.stringify([vehicles, selected, Boolean(replay)]);
    if (next === key) return;
    key = next;
    select.replaceChildren(...(replay ? [el("option", { value: "", text: "go to a vehicle" })] : []), ...vehicles.map((v) => el("option", { value: v, text: v })));
    select.value = replay ? "" : selected;
  });
  return { close: () => panel.close() };
}
