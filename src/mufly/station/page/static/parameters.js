// The parameter table: search, edit in place, see what was changed. Undo and files are on the server's side.
import { live } from "./live.js";
import { el } from "./draw.js";

const MOST = 250;

export function mount(element, options, emit) {
  element.classList.add("mf-column");
  let all = new Map(), words = "", changedOnly = false;
  const search = el("input", { type: "search", placeholder: "search name or description", "aria-label": "search parameters", oninput: () => {
    words = search.value.toLowerCase();
    fill();
  } });
  const only = el("button", { type: "button", text: "Changed only", "aria-pressed": false, onclick: () => {
    changedOnly = !changedOnly;
    only.setAttribute("aria-pressed", changedOnly);
    fill();
  } });
  const count = el("span", { class: "mf-dim mf-note", role: "status" });
  const body = el("tbody");
  const table = el("table", { class: "mf-table mf-parameter-table" }, el("thead", {}, el("tr", {}, ...["parameter", "value", "unit", "min … max", "description"].map((text) => el("th", { scope: "col", text })))), body);
  element.append(el("div", { class: "mf-tools" }, search, only, count), el("div", { class: "mf-scroll", tabindex: 0 }, table));

  // A number that is none (null here) stands as an empty field that says so.
  const text = (p) => (p.value === null ? "" : p.whole ? String(Math.round(p.value)) : String(Number(p.value.toPrecision(7))));
  const bound = (x) => (x === null ? "" : Math.abs(x) >= 1e6 ? x.toExponential(0) : String(Number(x.toPrecision(4))));
  const differs = (p) => (p.was === null || p.value === null ? p.was !== p.value : Math.fround(p.was) !== Math.fround(p.value));

  function row(p) {
    const input = el("input", { type: "number", step: p.whole ? 1 : "any", min: p.least, max: p.greatest, value: text(p), placeholder: p.value === null ? "not a number" : null, "aria-label": p.name, "data-name": p.name });
    // Whether a value may be written is for the station to say, and what came of it for the vehicle.
    input.addEventListener("change", () => {
      const v = parseFloat(input.value), now = all.get(p.name);
      if (!Number.isFinite(v)) restore(input);
      else if (text({ ...now, value: v }) !== text(now)) emit("write", { name: p.name, value: v });
    });
    input.addEventListener("blur", () => input.validity.customError && restore(input));
    input.addEventListener("input", () => {
      input.setCustomValidity("");
      input.nextSibling?.remove();
    });
    input.addEventListener("keydown", (event) => {
      if (event.key === "Escape") {
        restore(input);
        input.blur();
      }
    });
    const range = p.least === null && p.greatest === null ? "" : `${bound(p.least)} … ${bound(p.greatest)}`;
    return el("tr", { class: differs(p) ? "mf-changed" : "" }, el("th", { scope: "row" }, p.name, differs(p) ? el("span", { class: "mf-badge", title: `initial value ${p.was ?? "not a number"}`, text: "changed" }) : null),
      el("td", {}, input), el("td", { text: p.unit }), el("td", { class: "mf-num mf-dim", text: range }), el("td", { class: "mf-help", text: p.help }));
  }
  // Show what the vehicle has: what was typed is not.
  function restore(input) {
    const p = all.get(input.dataset.name);
    input.setCustomValidity("");
    input.nextSibling?.remove();
    if (p) input.value = input.defaultValue = text(p);
  }
  function fill() {
    const kept = [...all.values()].filter((p) => (!words || `${p.name} ${p.help}`.toLowerCase().includes(words)) && (!changedOnly || differs(p))).sort((a, b) => a.name.localeCompare(b.name));
    const focused = document.activeElement?.dataset?.name;
    body.replaceChildren(...kept.slice(0, MOST).map(row));
    if (focused) body.querySelector(`[data-name="${CSS.escape(focused)}"]`)?.focus();
    if (!all.size) body.append(el("tr", {}, el("td", { colspan: 5, class: "mf-empty", text: "no parameters received" })));
    count.textContent = kept.length > MOST ? `the first ${MOST} of ${kept.length}` : `${kept.length} of ${all.size}`;
  }
  const panel = live.panel({ sections: ["parameters"] }, (f) => {
    if (f.new && !f.parameters) {
      all = new Map();
      fill();
    }
    if (!f.parameters) return;
    if (f.parameters_new) all = new Map();
    for (const [name, value, unit, least, greatest, help, whole, was] of f.parameters) {
      all.set(name, { name, value, unit, least, greatest, help, whole, was });
    }
    // A field that is being typed into is not taken away.
    if (!body.contains(document.activeElement)) fill();
    else patch(f.parameters);
  });
  function patch(list) {
    for (const [name] of list) {
      const input = body.querySelector(`[data-name="${CSS.escape(name)}"]`), p = all.get(name);
      if (!input) continue;
      if (input !== document.activeElement || input.value === input.defaultValue) input.value = input.defaultValue = text(p);
      const fresh = row(p);
      input.closest("tr").className = fresh.className;
      input.closest("tr").firstChild.replaceWith(fresh.firstChild);
    }
  }
  fill();
  return {
    // It was not written: who still types there is told why and may mend it.
    refused(name, why) {
      const input = body.querySelector(`[data-name="${CSS.escape(name)}"]`);
      if (!input) return;
      if (input !== document.activeElement) return restore(input);
      input.setCustomValidity(why);
      input.closest("tr").querySelector(".mf-refused")?.remove();
      input.after(el("div", { class: "mf-refused", role: "alert", text: why }));
    },
    close: () => panel.close(),
  };
}
