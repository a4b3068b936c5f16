// The list of flights: sorted by any column, filtered by words; one is opened in this page or fetched as a file.
import { live } from "./live.js";
import { clock, el, icon, number, put } from "./draw.js";

const KEY = "mufly-flights";
const COLUMNS = [["start", "date"], ["length", "length"], ["vehicle", "vehicle"], ["mission", "mission"], ["outcome", "outcome"], ["size", "size"], ["name", "file"]];

function day(seconds) {
  const d = new Date(seconds * 1000), two = (x) => String(x).padStart(2, "0");
  return `${d.getFullYear()}-${two(d.getMonth() + 1)}-${two(d.getDate())} ${two(d.getHours())}:${two(d.getMinutes())}`;
}
export const text = {
  start: (r) => day(r.start),
  length: (r) => (r.length === null ? "" : clock(r.length).split(".")[0]),
  vehicle: (r) => r.vehicle,
  mission: (r) => r.mission,
  outcome: (r) => (r.fault ? `cannot be read: ${r.fault}` : r.known ? r.outcome : "…"),
  size: (r) => `${number(r.size / 1e6, 1)} MB`,
  name: (r) => r.name,
};
// Rows that hold all of the words, in the order of a column; what a row does not say comes last.
export function chosen(rows, { by, down, words, all }) {
  const wanted = words.toLowerCase().split(/\s+/).filter(Boolean);
  const kept = rows.filter((r) => (all || !r.beside) && wanted.every((w) => COLUMNS.some(([c]) => text[c](r).toLowerCase().includes(w))));
  const key = (r) => (by === "outcome" ? text.outcome(r) : r[by]);
  const none = (v) => v === null || v === undefined || v === "";
  return kept.sort((a, b) => {
    const [x, y] = [key(a), key(b)];
    if (none(x) || none(y)) return none(x) - none(y);
    const order = typeof x === "number" ? x - y : x.localeCompare(y);
    return (down ? -order : order) || b.start - a.start;
  });
}

export function mount(element, options, emit) {
  element.classList.add("mf-column", "mf-flight-list");
  let rows = null, replaying = false;
  const state = { by: "start", down: true, words: "", all: false };
  try {
    Object.assign(state, JSON.parse(localStorage.getItem(KEY) || "{}"), { words: "" });
  } catch (error) { /* begin anew */ }
  const keep = () => (localStorage.setItem(KEY, JSON.stringify(state)), fill());
  const search = el("input", { type: "search", placeholder: "filter: vehicle, mission, outcome, date …", "aria-label": "filter recordings", oninput: () => ((state.words = search.value), fill()) });
  const every = el("input", { type: "checkbox", "data-testid": "every-file", onchange: () => ((state.all = every.checked), keep()) });
  every.checked = state.all;
  const count = el("span", { class: "mf-dim mf-note", role: "status" });
  const heads = COLUMNS.map(([by, label]) => {
    const button = el("button", { type: "button", text: label, onclick: () => {
      state.down = state.by === by ? !state.down : by === "start" || by === "size" || by === "length";
      state.by = by;
      keep();
    } });
    return { by, label, button, head: el("th", { scope: "col" }, button) };
  });
  const body = el("tbody");
  element.append(el("div", { class: "mf-tools" }, search, el("label", { class: "mf-dim mf-check", title: "also show the station's recordings and packet logs of a flight" }, every, " all files"), count),
    el("div", { class: "mf-scroll", tabindex: 0 }, el("table", { class: "mf-table" }, el("thead", {}, el("tr", {}, el("th"), ...heads.map((h) => h.head))), body)));

  function fill() {
    for (const { by, label, button, head } of heads) {
      head.setAttribute("aria-sort", state.by !== by ? "none" : state.down ? "descending" : "ascending");
      put(button, `${label}${state.by !== by ? "" : state.down ? " ▾" : " ▴"}`);
    }
    const shown = chosen(rows ?? [], state);
    put(count, rows === null ? "searching …" : `${shown.length} of ${rows.length}`);
    body.replaceChildren(...shown.map((r) => el("tr", { class: r.fault ? "mf-level-error" : "" },
      el("td", { class: "mf-row-tools" },
        el("button", { type: "button", text: "Open", title: `open ${r.name}`, "data-testid": "open-recording", disabled: Boolean(r.fault), onclick: () => emit("open", r.name) }),
        el("button", { type: "button", text: "Compare", title: "overlay on the displayed recording (dashed)", "data-testid": "compare-recording", disabled: Boolean(r.fault) || !replaying, onclick: () => emit("compare", r.name) }),
        el("button", { type: "button", text: "⤓", title: `download ${r.name}`, "aria-label": `download ${r.name}`, onclick: () => emit("download", r.name) })),
      ...COLUMNS.map(([c]) => el("td", { class: ["length", "size"].includes(c) ? "mf-num" : c === "name" ? "mf-dim" : "", title: c === "name" || c === "outcome" ? text[c](r) : null }, c === "outcome" && r.fault ? icon("error") : "", text[c](r))))));
    if (rows && !shown.length) body.append(el("tr", {}, el("td", { colspan: 8, class: "mf-empty", text: rows.length ? "no recording matches the filter" : "no recordings in this folder" })));
  }
  const panel = live.panel({}, (f) => {
    const now = Boolean(f.about?.replay);
    if (!f.about || now === replaying) return;
    replaying = now;
    fill();
  });
  fill();
  live.whenConnected(() => emit("hello", null));
  return {
    show(found) {
      rows = found;
      fill();
    },
    close: () => panel.close(),
  };
}
