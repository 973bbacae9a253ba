// Reads the page's address: whether to start paused, a speed, a part of the box. The scene and its settings in it are for
// mpsim view, as all pages show the run of the view.

import { bound, state } from "./common.js";
import { opened, send, takers } from "./connection.js";
import { say } from "./edits.js";
import { MOST_ZOOM, camera } from "./stage.js";

const SEEN = ["wait", "speed", "zoom", "x", "y", "canvas"];
const asked = new URLSearchParams(location.search);
const number = (name) => (asked.has(name) && Number.isFinite(+asked.get(name)) ? +asked.get(name) : null);
const runOf = (query) => [...new URLSearchParams(query)].filter(([name]) => !SEEN.includes(name)).map(String).sort().join("&");

let begun = false, placed = false, told = !asked.has("scene");

opened.push(() => {
  if (begun) return; // the page connects again
  begun = true;
  if (asked.has("wait")) send({ do: "pause" });
  if (asked.get("speed") === "max") send({ do: "speed", value: null });
  else if (number("speed") !== null) send({ do: "speed", value: bound(number("speed"), 0.01, 1000) });
});

takers.scene.push((scene) => {
  if (placed || number("zoom") === null) return;
  placed = true;
  camera.zoom = bound(number("zoom"), 0.5, MOST_ZOOM);
  camera.moveTo(number("x") ?? scene.width / 2, number("y") ?? scene.height / 2);
});

takers.link.push(() => {
  if (!told && runOf(asked) !== runOf(state.link ?? "")) say(`This view shows another run than this address asks for. In a terminal: mpsim view '${location.search}'`, 60);
  told = true;
});
