// The page of mpsim's live view: buttons and keys. Other files of this folder draw what it shows.

import { $, bound, onButton, onKeys, state } from "./common.js";
import { drawGauges } from "./gauges.js";
import { onCanvas } from "./edits.js";
import "./follow.js";
import "./downloads.js";
import "./address.js";
import "./comparison.js";
import "./sliders.js";
import "./timeline.js";
import { SPEEDS, connect, refuse, send, showStatus, takers } from "./connection.js";
import { forgetLegend } from "./legend.js";
import { camera, renderer, requestDraw, stage } from "./stage.js";

const USUAL = 6; // of SPEEDS

onButton("play", " ", () => send({ do: state.status.phase === "playing" ? "pause" : "play" }));
onButton("step", ".", () => send({ do: "step", frames: 1 }));
onButton("reset", "r", () => send({ do: "reset" }));

function setSpeed(index) {
  if ($("speed").disabled) return;
  const at = bound(index, 0, SPEEDS.length - 1);
  $("speed").value = at; // at once, so that the next key counts from here
  send({ do: "speed", value: SPEEDS[at] });
}
$("speed").max = SPEEDS.length - 1;
$("speed").value = USUAL;
$("speed").addEventListener("input", () => { state.dragging = true; setSpeed(+$("speed").value); });
$("speed").addEventListener("change", () => { state.dragging = false; });

takers.scene.push((scene) => {
  $("seed-label").hidden = !scene.can_redraw;
  if (document.activeElement !== $("seed")) $("seed").value = scene.seed;
});
$("seed").addEventListener("change", () => {
  send({ do: "seed", value: bound(Math.round(+$("seed").value) || 0, 0, 1000000) });
});

$("count").addEventListener("change", () => send({ do: "count", value: $("count").checked }));

$("zoom-in").addEventListener("click", () => camera.zoomBy(1.5));
$("zoom-out").addEventListener("click", () => camera.zoomBy(1 / 1.5));
$("zoom-all").addEventListener("click", () => camera.all());

onKeys((key, event) => {
  const move = 0.1 * Math.min(camera.width, camera.height);
  const actions = {
    "[": () => setSpeed(+$("speed").value - 1), "]": () => setSpeed(+$("speed").value + 1), m: () => setSpeed(SPEEDS.length - 1),
    "+": () => camera.zoomBy(1.25), "=": () => camera.zoomBy(1.25), "-": () => camera.zoomBy(0.8), 0: () => camera.all(),
  };
  if (event.target === stage) Object.assign(actions, {
    ArrowLeft: () => camera.moveBy(move, 0), ArrowRight: () => camera.moveBy(-move, 0),
    ArrowUp: () => camera.moveBy(0, move), ArrowDown: () => camera.moveBy(0, -move),
  });
  return Object.hasOwn(actions, key) ? actions[key] : null;
});

// The wheel zooms only on the stage; elsewhere it scrolls the page.
stage.addEventListener("wheel", (event) => {
  event.preventDefault();
  camera.zoomBy(Math.exp(-bound(event.deltaY * (event.deltaMode ? 30 : 1), -200, 200) / 400), ...onCanvas(event));
}, { passive: false });

new ResizeObserver(() => { forgetLegend(); requestDraw(); drawGauges(); }).observe(document.body);
new ResizeObserver(requestDraw).observe(stage);
stage.dataset.drawnBy = renderer.constructor.name;
if (new Uint8Array(new Uint16Array([1]).buffer)[0] !== 1) refuse("This page needs a little-endian machine.");
else if (location.protocol === "https:") refuse("mpsim view speaks http. Forward its port by ssh -L, and open http://localhost:PORT/ with the rest of the printed address.");
else connect();
showStatus();
