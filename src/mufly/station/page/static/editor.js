// The table of the mission that is being drawn: a row an item, its numbers to be typed, and what the check says of it.
import { draft } from "./draft.js";
import { clock, el, icon, number, put } from "./draw.js";

const COLUMNS = [["", ""], ["N", "m"], ["E", "m"], ["height", "m"], ["wait", "s"], ["heading", "°"], ["speed", "m/s"], ["", ""]];
const ENDS = [["land", "land at the last waypoint"], ["hover", "hover at the last waypoint"], ["return", "return and land"]];
const MEANING = { north: "north", east: "east", height: "height", wait_s: "wait", heading_deg: "heading", speed_m_s: "speed" };

export function mount(element) {
  element.classList.add("mf-column", "mf-editor");
  const tool = (text, title, test, press) => el("button", { type: "button", text, title, "aria-label": title, "data-testid": test, onclick: press });
  const undo = tool("↶", "undo (Ctrl+Z)", "plan-undo", () => draft.edit({ op: "undo" }));
  const redo = tool("↷", "redo (Ctrl+Y)", "plan-redo", () => draft.edit({ op: "redo" }));
  const high = el("input", { type: "number", step: 0.1, min: 0.2, "aria-label": "height of new waypoints (m)", "data-testid": "plan-height", value: draft.height, oninput: () => {
    const h = parseFloat(high.value);
    if (Number.isFinite(h) && h > 0) draft.height = h;
  } });
  const plus = tool("+ Waypoint", "add a waypoint 1 m north of the selected one", "plan-add", () => {
    const { start, rows } = draft.state, k = Math.min(draft.selected ?? rows.length, rows.length), [n, e] = k ? rows[k - 1].at : start;
    draft.add(Math.round((n + 1) * 100) / 100, e);
  });
  const name = el("input", { type: "text", maxlength: 80, "aria-label": "mission name", "data-testid": "plan-name", onchange: () => draft.edit({ op: "name", value: name.value.trim() }) });
  const said = el("p", { class: "mf-verdict", role: "status", "data-testid": "plan-verdict" });
  const body = el("tbody");
  const head = el("tr", {}, ...COLUMNS.map(([text, unit]) => el("th", { scope: "col" }, text, unit ? ` (${unit})` : "")));
  element.append(
    el("div", { class: "mf-tools" }, undo, redo, plus, el("label", { class: "mf-dim" }, "name ", name), el("label", { class: "mf-dim" }, "height of new waypoints ", high, " m"), said),
    el("div", { class: "mf-scroll", tabindex: 0 }, el("table", { class: "mf-table" }, el("thead", {}, head), body)),
  );
  let shape = "";

  function field(row, name, value, { step = 0.1, empty = "" } = {}) {
    const input = el("input", { type: "number", step, placeholder: empty, "aria-label": `${MEANING[name]} of ${row ? `waypoint ${row}` : "the take-off"}`, "data-testid": `plan-${row}-${name}`, onfocus: () => draft.select(row) });
    const give = () => {
      const typed = input.value.trim(), v = typed === "" ? null : parseFloat(typed);
      if (typed === input.dataset.shown) return;
      if (v === null && !empty) return void (input.value = input.dataset.shown);
      draft.edit({ op: "put", row, name, value: v });
    };
    input.addEventListener("change", give);
    input.addEventListener("keydown", (event) => {
      if (event.key === "Escape") {
        input.value = input.dataset.shown;
        input.blur();
      }
    });
    return { name, input, cell: el("td", {}, input), value };
  }
  const text = (v) => (v === null || v === undefined ? "" : String(Math.round(v * 1000) / 1000));

  const lines = [];
  function build(s) {
    lines.length = 0;
    const made = [];
    for (let k = 0; k <= s.rows.length; k++) {
      const fields = [field(k, "north"), field(k, "east"), field(k, "height"), field(k, "wait_s", null, { step: 0.5, empty: "0" })];
      if (k) fields.push(field(k, "heading_deg", null, { step: 5, empty: "track" }), field(k, "speed_m_s", null, { step: 0.1, empty: "default" }));
      const small = (label, title, op, off) => el("button", { type: "button", text: label, title, "aria-label": `${title}, waypoint ${k}`, disabled: off, onclick: () => op() });
      const doing = k ? el("td", { class: "mf-row-tools" },
        small("↑", "move up", () => (draft.select(Math.max(1, k - 1)), draft.edit({ op: "shift", row: k, by: -1 })), k === 1),
        small("↓", "move down", () => (draft.select(k + 1), draft.edit({ op: "shift", row: k, by: 1 })), k === s.rows.length),
        small("+", "insert a waypoint before", () => (draft.select(k), draft.edit({ op: "insert", row: k }))),
        small("✕", "delete", () => draft.remove(k))) : el("td");
      const name = el("th", { scope: "row" }, icon("error"), k ? `${k}` : "take off");
      const line = el("tr", { "data-row": k, onclick: () => draft.select(k) }, name, ...fields.map((f) => f.cell), ...(k ? [] : [el("td"), el("td")]), doing);
      lines.push({ line, fields });
      made.push(line);
    }
    const end = el("select", { "aria-label": "end of mission", "data-testid": "plan-end", onchange: () => draft.edit({ op: "end", value: end.value }) }, ...ENDS.map(([value, words]) => el("option", { value, text: words })));
    const last = el("tr", { "data-row": s.rows.length + 1 }, el("th", { scope: "row" }, icon("error"), "then"), el("td", { colspan: 7 }, end));
    lines.push({ line: last, fields: [], end });
    body.replaceChildren(...made, last);
  }

  function fill() {
    const s = draft.state;
    if (!s) return;
    const next = String(s.rows.length);
    if (next !== shape) {
      const focus = document.activeElement?.dataset?.testid;
      build(s);
      shape = next;
      if (focus && element.isConnected) body.querySelector(`[data-testid="${focus}"]`)?.focus();
    }
    lines.forEach(({ line, fields, end }, k) => {
      line.classList.toggle("mf-now", k === draft.selected);
      line.classList.toggle("mf-bad-row", k === s.bad);
      if (end) end.value = s.at_end;
      const r = k ? s.rows[k - 1] : { at: s.start, wait: s.take_off_wait };
      const values = r && [...r.at, r.wait || null, r.heading, r.speed];
      fields.forEach(({ input }, j) => {
        const now = text(values[j]);
        input.dataset.shown = now;
        if (document.activeElement !== input || input.value === "") input.value = now;
        else if (s.refused) input.value = now; // what was typed was not taken
      });
    });
    for (const node of element.querySelectorAll("input, select, button")) node.disabled = Boolean(draft.may) && node !== high;
    if (document.activeElement !== name) name.value = s.name;
    undo.disabled = !s.undo || Boolean(draft.may);
    redo.disabled = !s.redo || Boolean(draft.may);
    undo.title = s.undo ? "undo (Ctrl+Z)" : "nothing to undo";
    const e = s.estimate;
    const [kind, words] = draft.may ? ["open", draft.may] : s.refused ? ["error", `rejected, mission unchanged: ${s.refused}`] : !s.rows.length ? ["open", "click the floor to add the first waypoint"]
      : !s.checked ? ["open", "checking …"] : s.fault ? ["error", s.fault]
        : ["ok", `valid: ${number(e.m, 1)} m in ${clock(e.s).split(".")[0]}${e.share === null ? "" : `, ${number(e.share * 100, 0)} % of the battery`}`];
    said.dataset.state = kind;
    put(said, words);
    said.title = words;
  }
  const off = draft.watch(fill);
  draft.show(true);
  // On a small window the tab comes to stand below the view that one draws in.
  if (matchMedia("(max-width: 900px)").matches) requestAnimationFrame(() => document.querySelector(".mf-centre")?.scrollIntoView({ block: "center" }));
  return {
    close() {
      off();
      draft.show(false);
    },
  };
}
