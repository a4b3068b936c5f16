// Which vehicle is shown, when several are heard; its name when there is one.
import { live } from "./live.js";
import { el, put } from "./draw.js";

// The address names the vehicle of this window, so that the page shows the same one when it is loaded anew.
function keep(selected) {
  const place = new URL(location.href);
  if (!selected || place.searchParams.get("vehicle") === selected) return;
  place.searchParams.set("vehicle", selected);
  history.replaceState(history.state, "", place);
}

export function mount(element, options, emit) {
  const name = el("strong", { class: "mf-vehicle-name" });
  const select = el("select", { "aria-label": "vehicle", hidden: true, onchange: () => emit("select", select.value) });
  element.append(name, select);
  let key = "";
  const panel = live.panel({}, (f) => {
    const { vehicles = [], selected = "", replay } = f.about || {};
    const found = vehicles.find(([key]) => key === selected), gone = selected && vehicles.length && !found && !replay;
    const many = vehicles.length > 1 || (vehicles.length && (replay || gone));
    name.hidden = Boolean(many) && !replay;
    select.hidden = !many;
    put(name, replay ? replay.name : found ? found[1] : "no vehicle");
    keep(selected);
    const next = JSON.stringify([vehicles, selected, Boolean(replay)]);
    if (next === key) return;
    key = next;
    const first = replay ? "select a vehicle" : gone ? "not connected: select" : "";
    select.replaceChildren(...(first ? [el("option", { value: "", text: first })] : []), ...vehicles.map(([value, text]) => el("option", { value, text })));
    select.value = replay || gone ? "" : selected;
  });
  return { close: () => panel.close() };
}
