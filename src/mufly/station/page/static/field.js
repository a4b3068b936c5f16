// A number with a label and a unit; what is typed is told at once, Enter tells "enter".
import { el } from "./draw.js";

export function mount(element, options, emit) {
  const input = el("input", { type: "number", step: options.step || 0.1, value: options.value, "aria-label": options.meaning, "data-testid": options.test });
  const tell = () => {
    const v = parseFloat(input.value);
    if (Number.isFinite(v)) emit("change", v);
  };
  input.addEventListener("input", tell);
  input.addEventListener("keydown", (event) => event.key === "Enter" && emit("enter", null));
  element.append(el("label", { class: "mf-field" }, options.label ? el("span", { text: options.label }) : "", input, options.unit ? el("span", { text: options.unit }) : ""));
  return {
    set(value) {
      input.value = String(Math.round(value * 1000) / 1000);
    },
  };
}
