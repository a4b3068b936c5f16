// The keyboard: [data-key] names the key of a button. Commands need Shift, so that a stray letter flies nothing.
//
// The emergency stop's key is heard first of all (capture), wherever the focus is: in a field, in a dialog, in a tab.
import { live } from "./live.js";

const STOP = "Shift+Backspace";

export function mount(element) {
  element.hidden = true;
  const press = (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const name = event.shiftKey && event.key !== "?" ? `Shift+${event.key.length === 1 ? event.key.toUpperCase() : event.key}` : event.key;
    const button = document.querySelector(`[data-key="${CSS.escape(name)}"]`);
    if (!button || button.disabled || button.closest("[inert]") || button.checkVisibility?.() === false) return;
    if (name === STOP) event.stopPropagation();
    else if (event.repeat || document.querySelector(".q-dialog") || typing(event) || (name === " " && event.target.closest?.("button, a, [role=tab]"))) return;
    event.preventDefault();
    if (!event.repeat && !live.isLate(event)) button.click(); // a key that is held is one press
  };
  window.addEventListener("keydown", press, true);
  const panel = live.panel({}, () => {});
  return {
    close() {
      window.removeEventListener("keydown", press, true);
      panel.close();
    },
  };
}

function typing(event) {
  return event.target.type !== "range" && event.target.closest?.("input, textarea, select, [contenteditable]");
}
