// Reads the page's address: a scene with settings to run instead, whether to start paused, a speed, a part of the box.

import { $, state } from "./common.js";
import { opened, send, takers } from "./connection.js";
import { camera, requestDraw } from "./stage.js";

const asked = new URLSearchParams(location.search);
const number = (name) => (asked.has(name) ? +asked.get(name) : null); // mpsim has checked it
const settleAtOnce = [...asked.keys()].every((name) => name === "wait");
let wanted = null, settled = false; // the requested scene, as mpsim writes it; whether it runs now

/** Apply pause, speed and place, once the requested scene runs. */
function settle() {
  settled = true;
  askNoMore();
  if (asked.has("wait")) send({ do: "pause" });
  if (asked.has("speed")) send({ do: "speed", value: asked.get("speed") === "max" ? null : number("speed") });
  place();
}

let placed = false, shown = null;
function place() {
  if (!settled || placed || !state.scene || number("zoom") === null) return;
  placed = true;
  camera.zoom = number("zoom");
  camera.moveTo(number("x") ?? state.scene.width / 2, number("y") ?? state.scene.height / 2);
  requestDraw();
}

// --- a question above the stage, with a button for yes and one for no

let answers = {};

/** Ask; this replaces an earlier question. yes, no: what the answers do; yes null: nothing to choose. */
function ask(text, yes, no) {
  answers = { yes, no };
  $("asked").hidden = false;
  $("asked-text").textContent = text;
  $("asked-yes").hidden = !yes;
  $("asked-no").textContent = yes ? "Keep this run" : "Close";
}

/** Remove the question. */
function askNoMore() {
  answers = {};
  $("asked").hidden = true;
}

for (const each of ["yes", "no"]) $(`asked-${each}`).addEventListener("click", () => {
  const act = answers[each];
  askNoMore();
  act?.();
});

// --- another scene, or the same with other settings

const inWords = (link) => link.split("&").map(decodeURIComponent).map((each) => each.replace("scene=", "")).join(", ");

function compare() {
  if (settled || wanted === null || state.link === undefined || !state.scene) return;
  if (wanted === state.link) settle();
  else if (state.scene.recording || !state.scene.can_reset) {
    ask(`This address asks for ${inWords(wanted)}. This view shows ${state.scene.recording ? "a recording" : "a simulation that belongs to a program"}, and nothing else. In a terminal: mpsim view '?${wanted}'`, null, keep);
  } else ask(`This address asks for ${inWords(wanted)}. ${state.link ? inWords(state.link) : state.scene.name || "A scene of a program"} is running now. A restart changes all pages of this view.`, restart, keep);
}

function restart() {
  const link = wanted;
  wanted = null; // ask once
  if (asked.has("wait")) send({ do: "pause" });
  send({ do: "open", link });
  settle();
}
function keep() {
  wanted = null;
  history.replaceState(null, "", location.pathname); // or a reload would ask again
}

const whenOpen = () => { if (!settled) settle(); };
if (settleAtOnce) opened.push(whenOpen);
else fetch(`link${location.search}`).then(async (answer) => {
  const text = await answer.text();
  if (!answer.ok) ask(`This address cannot be used: ${text}`, null, keep);
  else if (text) { wanted = text; compare(); }
  else if (state.socket?.readyState === WebSocket.OPEN) whenOpen();
  else opened.push(whenOpen);
}, () => ask("This address was not checked: no connection to mpsim.", null, keep));
takers.link.push(compare);
takers.scene.push((scene) => {
  const other = shown !== null && (shown.width !== scene.width || shown.height !== scene.height);
  shown = scene;
  if (other) camera.all();
  place();
  compare();
});
