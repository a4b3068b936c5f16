// The keyboard: [data-key] names the key of a button. Commands need Shift, so that a stray letter flies nothing.
import { live } from "./live.js";

export function mount(element) {
  element.hidden = true;
  const press = (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat || document.querySelector(".q-dialog")) return;
    const typing = event.target.closest?.("input, textarea, select, [contenteditable]");
    if (typing && event.target.type !== "range") return;
    if (event.key === " " && event.target.closest?.("button, a, [role=tab]")) return;
    const name = event.shiftKey && event.key !== "?" ? `Shift+${event.key.length === 1 ? event.key.toUpperCase() : event.key}` : event.key;
    const button = document.querySelector(`[data-key="${CSS.escape(name)}"]`);
    if (!button || button.disabled || !button.offsetParent) return;
    event.preventDefault();
    button.click();
  };
  document.addEventListener("keydown", press);
  const panel = live.panel({}, () => {});
  return {
    close() {
      document.removeEventListener("keydown", press);
      panel.close();
    },
  };
}
