// The mission that is being drawn, as the station holds it: the table and the 3-D view show it, and say what to change.
//
// The station answers every order with the whole draft. While something is dragged here, what it says of an order before
// the last one is old news.
import { live } from "./live.js";

const watchers = new Set();
let order = 0, ask = null;

export const draft = {
  state: null, // what the station last said, or null
  on: false, // whether the table is shown: then the 3-D view draws, and a click on the floor adds
  may: "", // why this window may not edit; "" if it may
  selected: null, // row: 0 is the take-off, 1 to n the waypoints
  height: 1.0, // of points that are added by a click (m)

  watch(tell) {
    watchers.add(tell);
    return () => watchers.delete(tell);
  },
  edit(content) {
    if (!ask || (draft.may && !["hello"].includes(content.op))) return;
    ask("edit", { ...content, order: ++order });
  },
  select(row) {
    if (row === draft.selected) return;
    draft.selected = row;
    tell();
  },
  show(yes) {
    draft.on = yes;
    document.body.classList.toggle("mf-drawing", yes);
    tell();
  },
  // Add behind what is selected, which then is the new one: a click after the other draws the way.
  add(n, e) {
    const rows = draft.state?.rows || [], after = draft.selected === null ? rows.length : Math.min(draft.selected, rows.length);
    draft.selected = after + 1;
    draft.edit({ op: "add", at: [n, e, -draft.height], after });
  },
  remove(row) {
    if (!row || row > (draft.state?.rows.length ?? 0)) return;
    draft.selected = null;
    draft.edit({ op: "delete", row });
  },
};
window.muflyDraft = draft; // for the tests of the page

function tell() {
  for (const watcher of [...watchers]) watcher(draft);
}

document.addEventListener("keydown", (event) => {
  if (!draft.on || document.querySelector(".q-dialog") || event.target.closest?.("input, select, textarea")) return;
  const key = event.key.toLowerCase();
  if ((event.ctrlKey || event.metaKey) && (key === "z" || key === "y")) {
    event.preventDefault();
    draft.edit({ op: key === "y" || event.shiftKey ? "redo" : "undo" });
  } else if (event.key === "Delete" && draft.selected && !event.ctrlKey && !event.shiftKey) {
    event.preventDefault();
    draft.remove(draft.selected);
  } else if (event.key === "Escape") draft.select(null);
});

export function mount(element, options, emit) {
  element.hidden = true;
  ask = emit;
  live.whenConnected(() => emit("edit", { op: "hello" }));
  return {
    take({ state, may, last }) {
      draft.may = may;
      if (state && last >= order) draft.state = state;
      if (draft.selected > (draft.state?.rows.length ?? 0)) draft.selected = null;
      tell();
    },
    close() {
      ask = null;
    },
  };
}
