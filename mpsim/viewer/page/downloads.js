// Downloads: a picture, a film, the session, a program; and an address that shows the same.

import { $, state } from "./common.js";
import { SPEEDS, opened, send, takers } from "./connection.js";
import { fileFrom, inNotebook } from "./socket.js";
import { camera, draw, requestDraw } from "./stage.js";

const fileName = (ending) => `${(state.scene?.name || "mpsim").replace(/[^\w-]+/g, "_")}-${state.picture?.frame ?? 0}${ending}`;

/** Download a file, and say so. */
function download(blob, name) {
  const link = document.createElement("a");
  [link.href, link.download] = [URL.createObjectURL(blob), name];
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  note(`${name}, ${Math.max(Math.round(blob.size / 1000), 1)} kB`);
}

const note = (text) => { $("keep-note").textContent = text; };
/** A file from the simulation; null, with a note, if it fails. */
async function made(name) {
  note(inNotebook ? "Waiting for Python, which answers between cells …" : "…");
  try {
    return await fileFrom(state.socket, name);
  } catch (error) {
    note(error.message);
    return null;
  }
}

for (const [id, name, ending] of [["film", "film.gif", ".gif"], ["session", "session.zip", "-session.zip"]]) {
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

/** Copy a text, and show it, as a page may not be allowed to copy. */
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

/** The query for what is shown: scene and settings, speed, and the part of the box. It starts paused. */
function asking() {
  const found = new URLSearchParams();
  found.set("speed", state.status.speed ?? "max");
  if (camera.free) for (const name of ["x", "y", "zoom"]) found.set(name, +camera[name].toPrecision(6));
  return `?${state.link ? `${state.link}&` : ""}wait&${found}`;
}
$("keep-address").addEventListener("click", () => copy(new URL(asking(), location.href).href, "The address"));
$("keep-command").addEventListener("click", () => copy(`mpsim view '${asking()}'`, "The command"));

takers.link.push(({ text }) => {
  state.link = text;
  $("keep-command").disabled = text === null;
  $("keep-command-note").textContent = text === null
    ? "For another machine: send the file under Session. Only scenes that come with mpsim have a command." : "";
});
