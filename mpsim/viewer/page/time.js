// Shows one frame pass by pass, with the worker of each bracket; the marked moment; the seed.

import { $, bound, onButton, state } from "./common.js";
import { send, takers } from "./connection.js";
import { afterDrawing, camera, requestDraw, stage } from "./stage.js";

// Okabe and Ito's colours, safe for colour-blind people; more workers reuse them.
const OWNERS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#f0e442"];

for (const [id, key] of [["pass", "p"], ["snapshot", "s"], ["return", "g"]]) onButton(id, key, () => send({ do: id }));

takers.status.push(({ phase, snapshot, can_remember: can }) => {
  const ready = (phase === "playing" || phase === "paused") && !state.scene?.recording;
  $("pass").disabled = !ready;
  $("snapshot").disabled = !ready || !can;
  $("return").disabled = !ready || snapshot === null || snapshot === undefined;
  if (!$("return").disabled) $("return").title = `G: returns to the mark, frame ${snapshot.toLocaleString("en")}`;
});

takers.scene.push((scene) => {
  $("seed-label").hidden = !scene.can_redraw;
  if (document.activeElement !== $("seed")) $("seed").value = scene.seed;
});
$("seed").addEventListener("change", () => {
  send({ do: "seed", value: bound(Math.round(+$("seed").value) || 0, 0, 1000000) });
});

// --- passes

let pass = { name: null };
takers.pass.push((message) => {
  pass = message;
  stage.dataset.pass = message.name ? `${message.name} ${message.number}/${message.of}` : "";
  requestDraw();
});

/** The brackets of a pass: two columns each, in the colour of the worker that resolves them. */
afterDrawing.push(() => {
  $("pass-note").hidden = !pass.name;
  if (!pass.name || !state.scene) return;
  const c = $("hand-canvas").getContext("2d"), ratio = window.devicePixelRatio || 1;
  const width = state.scene.width / pass.columns, [, top] = camera.pixel(0, state.scene.height), [, bottom] = camera.pixel(0, 0);
  const side = (column, alpha, owner) => {
    const [left] = camera.pixel(column * width, 0), [right] = camera.pixel((column + 1) * width, 0);
    c.globalAlpha = alpha;
    c.fillStyle = OWNERS[owner % OWNERS.length];
    c.fillRect(left, top, right - left, bottom - top);
    return [left, right];
  };
  pass.brackets.forEach((column, k) => {
    const owner = pass.owners[k], [left] = side(column, 0.22, owner), [, right] = side((column + 1) % pass.columns, 0.22, owner);
    c.globalAlpha = 1;
    if (right < left) return; // across a periodic edge: the two columns do not touch here
    c.strokeStyle = OWNERS[owner % OWNERS.length];
    c.lineWidth = 2 * ratio;
    c.strokeRect(left + ratio, top + ratio, right - left - 2 * ratio, bottom - top - 2 * ratio);
  });
  c.globalAlpha = 1;
  const workers = Math.max(...pass.owners) + 1;
  $("pass-note").textContent = `${pass.name} pass, ${pass.number} of ${pass.of}: ${pass.contacts.toLocaleString("en")} contacts; `
    + (workers > 1 ? `${workers} workers, by colour; no two brackets share a column` : "one worker; no two brackets share a column");
});
