// Keep: a picture, a film, the session, the scene of this moment, a program, and an address that shows the same.

import { $, state } from "./common.js";
import { download, fileName } from "./export.js";
import { SPEEDS, opened, send, takers } from "./link.js";
import { camera, draw, requestDraw } from "./stage.js";

const note = (text) => { $("keep-note").textContent = text; };
/** A file that the simulation makes; null, with a note, if it cannot. */
async function made(name) {
  note("…");
  try {
    const answer = await fetch(`keep/${name}`);
    if (answer.ok) return await answer.blob();
    note(await answer.text());
  } catch {
    note("No connection to mpsim.");
  }
  return null;
}

for (const [id, name, ending] of [["film", "film.gif", ".gif"], ["mp4", "film.mp4", ".mp4"], ["session", "session.zip", "-session.zip"], ["scene", "scene.zip", "-scene.zip"]]) {
  $(`keep-${id}`).addEventListener("click", async () => {
    const blob = await made(name);
    if (blob) download(blob, fileName(ending));
  });
}

$("keep-picture").addEventListener("click", () => {
  draw();
  const parts = ["lines", "discs-canvas"].map($), legend = $("legend"), [width, height] = [parts[0].width, parts[0].height];
  const canvas = document.createElement("canvas"), edge = Math.round(0.02 * width);
  [canvas.width, canvas.height] = [width, height + legend.height + edge];
  const c = canvas.getContext("2d");
  c.fillStyle = "#fff";
  c.fillRect(0, 0, canvas.width, canvas.height);
  for (const part of parts) c.drawImage(part, 0, 0);
  c.drawImage(legend, edge, height + edge / 2, width - 2 * edge, legend.height);
  canvas.toBlob((blob) => download(blob, fileName(".png")), "image/png");
});

/** Copy a text, and show it: where a page may not copy, people do. */
async function copy(text, what) {
  $("kept-text").hidden = false;
  $("kept-text").value = text;
  $("kept-text").select();
  try {
    await navigator.clipboard.writeText(text);
    note(`${what} is copied.`);
  } catch {
    note(`${what}: copy it from here.`);
  }
}

$("keep-program").addEventListener("click", async () => {
  const blob = await made("program.py");
  if (blob) await copy(await blob.text(), "The program");
});

$("keep-address").addEventListener("click", () => {
  const query = new URLSearchParams(location.search);
  query.set("wait", "");
  query.set("speed", state.status.speed ?? "max");
  for (const name of ["x", "y", "zoom"]) {
    if (camera.free) query.set(name, +camera[name].toPrecision(6)); else query.delete(name);
  }
  const text = new URL(`?${query.toString().replace("wait=&", "wait&")}`, location.href);
  copy(text.href.replace(/#.*$/, ""), "The address");
});

// --- what an address asks for, once

const asked = new URLSearchParams(location.search);
const number = (name) => (asked.has(name) && Number.isFinite(+asked.get(name)) ? +asked.get(name) : null);
let done = false;
opened.push(() => {
  if (done) return;
  done = true;
  if (asked.has("wait")) send({ do: "pause" });
  const speed = asked.get("speed") === "max" ? null : number("speed");
  if (asked.has("speed") && SPEEDS.includes(speed)) send({ do: "speed", value: speed });
});

let placed = false;
takers.scene.push((scene) => {
  const line = $("keep-command");
  line.hidden = !scene.command;
  line.querySelector("code").textContent = scene.command ?? "";
  if (placed || number("zoom") === null) return;
  placed = true;
  camera.zoom = Math.min(Math.max(number("zoom"), 0.5), 64);
  camera.moveTo(number("x") ?? scene.width / 2, number("y") ?? scene.height / 2);
  requestDraw();
});
