// A question above the stage, with a button for yes and one for no.

import { $ } from "./common.js";

let answers = {};

/** Ask; this replaces an earlier question. yes: called on yes, with its name on the button; null: nothing to choose. */
export function ask(text, yes, { name = "Restart with it", no = () => {} } = {}) {
  answers = { yes, no };
  $("asked").hidden = false;
  $("asked-text").textContent = text;
  $("asked-yes").hidden = !yes;
  $("asked-yes").textContent = name;
  $("asked-no").textContent = yes ? "Keep this run" : "Close";
}

/** Remove the question. */
export function askNoMore() {
  answers = {};
  $("asked").hidden = true;
}

for (const each of ["yes", "no"]) $(`asked-${each}`).addEventListener("click", () => {
  const act = answers[each];
  askNoMore();
  act?.();
});
