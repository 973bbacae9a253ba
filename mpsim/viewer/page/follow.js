// One disc: its label under the pointer, following it, and its trail.

import { $, ABSORBED, KNEE, FASTEST, digits, onKeys, state, trace } from "./common.js";
import { discAt, held, nearest, onCanvas, placeOf, say, toBox } from "./edits.js";
import { showsSpeed } from "./legend.js";
import { afterDrawing, camera, requestDraw, stage } from "./stage.js";

const PLACES = 60; // in a trail

let pointer = null, asked = false, followed = null, seen = null, trail = [];

const label = (disc) => {
  const [x, y] = placeOf(disc), byte = state.picture.colours[disc], { usual, fastest } = state.picture;
  const speed = byte <= KNEE ? (byte / KNEE) * usual : usual + ((byte - KNEE) / (FASTEST - KNEE)) * (fastest - usual);
  return `disc ${disc}: ${digits(x)}, ${digits(y)}${showsSpeed() ? `; speed about ${digits(speed)}` : ""}`;
};

/** The disc under the pointer; null: none. */
const pointed = () => (pointer && state.picture && state.radii ? discAt(toBox(pointer), 0) : null);

function showLabel() {
  asked = false;
  const of = held(), disc = of === null ? followed ?? pointed() : of, box = $("disc-label"); // in a gesture that of its disc
  box.hidden = disc === null || !(disc < state.picture?.count);
  if (box.hidden) return;
  const ratio = window.devicePixelRatio || 1, [x, y] = camera.pixel(...placeOf(disc));
  box.textContent = label(disc);
  box.style.left = `${Math.max(Math.min(x / ratio + 12, stage.clientWidth - box.offsetWidth - 4), 4)}px`;
  box.style.top = `${Math.max(y / ratio - 32, 4)}px`;
}
function askLabel() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(showLabel);
}
addEventListener("pointermove", (event) => { // before the tools, which keep it to themselves
  pointer = stage.contains(event.target) && !event.target.closest("button") ? onCanvas(event) : null;
  askLabel();
}, true);
stage.addEventListener("pointerleave", () => { pointer = null; askLabel(); });

onKeys((key) => (key === "f" ? follow : null));
function follow() {
  followed = followed === null ? pointed() : null;
  say(followed === null ? "No disc is followed. Point at one and press F." : `Following disc ${followed}. F ends it.`);
  [trail, seen] = [[], null];
  requestDraw();
}

/** Record the place in a picture; another run, or other discs, begin a new trail. */
function record(picture) {
  if (seen && (picture.frame < seen.frame || picture.count !== seen.count)) {
    trail = [];
    if (followed >= picture.count) followed = null;
  }
  seen = picture;
  if (followed !== null && picture.colours[followed] === ABSORBED) followed = null;
  if (followed === null) return;
  trail.push(placeOf(followed));
  if (trail.length > PLACES) trail.shift();
  camera.moveTo(...trail.at(-1));
}

function drawTrail(c) {
  trace(c, trail.flatMap((here, k) => {
    const away = k ? here.map((each, axis) => each - trail[k - 1][axis]) : [0, 0], pixel = camera.pixel(...here);
    return nearest(away).some((each, axis) => Math.abs(each - away[axis]) > 1e-9) ? [null, pixel] : [pixel]; // it has wrapped
  }));
  c.stroke();
}

afterDrawing.push(() => {
  const picture = state.picture;
  if (!picture) return;
  if (picture !== seen) record(picture);
  const c = $("hand-canvas").getContext("2d"), ratio = window.devicePixelRatio || 1;
  [c.lineWidth, c.strokeStyle, c.lineJoin] = [2.5 * ratio, "#d55e00", "round"];
  if (followed !== null) drawTrail(c);
  stage.dataset.followed = followed ?? "";
  if (followed !== null || pointer) askLabel();
});
