// The keyboard: what each key does, and the list of it.

import { make } from "clothfit/drawing";

/** Listen to keys; `actions` are {keys: [names], shown, does, act}. Fields of the page keep their own keys. */
export function listen(actions) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.("[data-own]")) return;
    const own = event.target.closest?.("select, summary, button, input[type=radio]");
    if (own && (event.key === " " || event.key === "Enter")) return;
    if (own?.matches("select, input") && event.key.startsWith("Arrow")) return;
    if (own?.matches("select") && event.key.length === 1) return;
    const name = event.shiftKey && event.key.startsWith("Arrow") ? `Shift ${event.key}` : event.key;
    const action = actions.find((each) => each.keys.includes(name.length === 1 ? name.toLowerCase() : name));
    if (!action) return;
    event.preventDefault();
    action.act(name);
  });
}

/** The list of keys. */
export function list(element, actions) {
  const rows = actions.filter((each) => each.shown).map((each) => [each.shown, each.does]);
  rows.push(["drag", "turn"], ["Shift or right drag", "shift"], ["wheel, pinch", "nearer or farther"]);
  element.append(...rows.map(([name, does]) => make("div", {}, make("dt", {}, name), make("dd", {}, does))));
}
