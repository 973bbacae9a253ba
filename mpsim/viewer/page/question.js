// A question above the stage, with a button for yes and one for no.

import { $ } from "./common.js";

let answers = {};

/** Ask, in place of the question before. yes: what is done then, and its name on the button; null: there is nothing to choose. */
export function ask(text, yes, { name = "Restart with it", no = () => {} } = {}) {
  answers = { yes, no };
  $("asked").hidden = false;
  $("asked-text").textContent = text;
  $("asked-yes").hidden = !yes;
  $("asked-yes").textContent = name;
  $("asked-no").textContent = yes ? "Keep this run" : "Close";
}

/** Take the question back. */
export function askNoMore() {
  answers = {};
  $("asked").hidden = true;
}

for (const each of ["yes", "no"]) $(`asked-${each}`).addEventListener("click", () => {
  const act = answers[each];
  askNoMore();
  act?.();
});
