// Tools: drag, throw, add and remove discs, draw, move and remove walls, by pointer or by keys. The stage shows why an
// action was refused.

import { $, ABSORBED, ARROWS, bound, isText, state } from "./common.js";
import { send, takers } from "./connection.js";
import { afterDrawing, camera, requestDraw, stage } from "./stage.js";

const TOOLS = { h: "hand", a: "add", x: "remove", w: "wall" };
const NEAR = 12; // a press so many screen pixels beside a disc still takes it
const EVERY = 33; // ms between two messages of a gesture; at most 200 a second are allowed
const TRAIL = 90; // the last ms of a drag give the velocity of a throw
const MOST_AT_A_TIME = 6; // places of a stroke, each a message
const NOTE_SECONDS = 4;

let tool = "hand", gesture = null, cross = null, notes = 0;

/** The disc that is held, undefined during another gesture; null: there is no gesture. */
export const held = () => (gesture ? gesture.disc : null);

const ready = () => state.scene && !state.scene.recording && state.picture && ["playing", "paused"].includes(state.status.phase);

/** Call a function at most every EVERY ms, with the last arguments. */
export function paced(act) {
  let waiting = null, timer = null;
  const run = () => {
    timer = null;
    if (!waiting) return;
    const given = waiting;
    waiting = null;
    act(...given);
    timer = setTimeout(run, EVERY);
  };
  const call = (...given) => { waiting = given; if (timer === null) run(); };
  call.forget = () => { waiting = null; };
  return call;
}

// --- places

export const toBox = ([px, py]) => [camera.x + (px - camera.width / 2) / camera.scale, camera.y - (py - camera.height / 2) / camera.scale];
export const onCanvas = (event) => {
  const box = stage.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  return [(event.clientX - box.left - stage.clientLeft) * ratio, (event.clientY - box.top - stage.clientTop) * ratio];
};
/** The length of NEAR on the screen. */
const nearby = () => (NEAR * (window.devicePixelRatio || 1)) / camera.scale;
const radiusOf = (disc) => (state.radii.length > 1 ? state.radii[disc] : state.radii[0] ?? 0);
export const placeOf = (disc, picture = state.picture) => picture.extent.map((length, axis) => (picture.places[2 * disc + axis] / 65535) * length);

let radiiOf = null, typical = 0;
/** The median radius; computed once for the same radii, as there may be a million. */
function typicalRadius() {
  if (radiiOf !== state.radii) [radiiOf, typical] = [state.radii, state.radii?.slice().sort()[state.radii.length >> 1] ?? 0];
  return typical;
}

/** A vector to the nearest image. */
export const nearest = (vector) => vector.map((each, axis) => {
  const length = state.picture.extent[axis];
  return state.scene.periodic[axis] ? each - length * Math.round(each / length) : each;
});

/** The disc at a place, or the nearest one within a distance; null: none. */
export function discAt(place, reach) {
  const { places, colours, count, extent: [width, height] } = state.picture, { radii, scene: { periodic: [aroundX, aroundY] } } = state;
  const [x, y] = place, [perX, perY] = [width / 65535, height / 65535], same = radii.length === 1;
  let found = null, least = reach;
  for (let k = 0; k < count; k++) { // maybe a million: allocate nothing here
    let dx = places[2 * k] * perX - x;
    if (aroundX) dx -= width * Math.round(dx / width);
    const most = least + (same ? radii[0] : radii[k]);
    if (dx > most || dx < -most) continue;
    let dy = places[2 * k + 1] * perY - y;
    if (aroundY) dy -= height * Math.round(dy / height);
    if (dx * dx + dy * dy > most * most || colours[k] === ABSORBED) continue;
    least = Math.sqrt(dx * dx + dy * dy) - (same ? radii[0] : radii[k]);
    found = k;
  }
  return found;
}

/** The number of the obstacle at a place, or of the nearest one within a distance, as it is drawn; null: none. */
function wallAt(place, reach) {
  let found = null, least = reach;
  state.obstacles.forEach(([ax, ay, bx, by, radius], k) => {
    const along = [bx - ax, by - ay], square = along[0] ** 2 + along[1] ** 2, from = nearest([place[0] - ax, place[1] - ay]);
    const part = square ? bound((from[0] * along[0] + from[1] * along[1]) / square, 0, 1) : 0;
    const centre = Math.hypot(...nearest(along.map((each, axis) => from[axis] - part * each)));
    const away = radius < 0 ? -radius - centre : centre - radius;  // a container is solid around its circle
    if (away <= least) [found, least] = [state.owners[k], away];
  });
  return found;
}

/** The held wall where the pointer would put it, inside the box: its capsules, and its displacement. */
function movedWall() {
  const rows = state.obstacles.filter((_, k) => state.owners[k] === gesture.wall);
  const shift = [0, 1].map((axis) => {
    const ends = rows.flatMap((row) => [row[axis], row[axis + 2]]);
    return bound(gesture.to[axis] - gesture.from[axis], -Math.min(...ends), state.picture.extent[axis] - Math.max(...ends));
  });
  return { shift, rows: rows.map(([ax, ay, bx, by, radius]) => [ax + shift[0], ay + shift[1], bx + shift[0], by + shift[1], radius]) };
}

/** A place for the centre of a disc: in the box, a radius from its walls. */
function inside(place, radius) {
  const [left, right, low, high] = state.picture.walls, room = radius * (1 + 1e-6);
  return [[place[0], left, right], [place[1], low, high]].map(([each, from, to], axis) => {
    const length = state.picture.extent[axis];
    if (!state.scene.periodic[axis]) return bound(each, from + room, to - room);
    const wrapped = ((each % length) + length) % length;
    return wrapped < length ? wrapped : 0;
  });
}

// --- what the tools do when a pointer or the cross begins, moves and ends

/** Walk along the pointer's path in steps of a length; returns at most so many places; the rest of the path stays. */
function walked(step, most) {
  const found = [], { path } = gesture;
  while (path.length && found.length < most) {
    const way = path[0].map((each, axis) => each - gesture.last[axis]), length = Math.hypot(...way);
    if (length < step) { path.shift(); continue; }
    found.push(gesture.last = gesture.last.map((each, axis) => each + (way[axis] * step) / length));
  }
  return found;
}
/** Apply the stroke so far; also a fast one, or one on a busy page, leaves no gaps. */
function stroke() {
  const radius = typicalRadius() || 0.01 * Math.min(...(state.picture?.extent ?? [1])); // without discs
  if (gesture?.tool === "add") walked(2.05 * radius, MOST_AT_A_TIME).forEach(addAt);
  else if (gesture?.tool === "remove") for (const place of walked(radius, MOST_AT_A_TIME)) removeAt(place, 0);
  if (gesture?.path?.length) strokeSoon();
}
const strokeSoon = paced(stroke);

/** Remove the disc or the wall at a place; returns whether one is there. */
function removeAt(place, reach) {
  const disc = discAt(place, 0), wall = disc === null ? wallAt(place, reach) : null;
  const name = disc === null ? `wall ${wall}` : disc;
  if (disc === null && wall === null) return false;
  if (gesture?.gone.has(name)) return true;
  send({ do: disc === null ? "remove_wall" : "remove", id: disc ?? wall, same: gesture?.sent ?? false });
  gesture?.gone.add(name);
  if (gesture) gesture.sent = true;
  return true;
}

function addAt(place) {
  const [x, y] = inside(place, typicalRadius());
  send({ do: "add", x, y, same: gesture?.sent ?? false });
  if (gesture) gesture.sent = true;
}

/** The part of a line that lies in the box, as its two ends; null: none. */
function clipped(from, to) {
  let [first, last] = [0, 1];
  for (const axis of [0, 1]) {
    const step = to[axis] - from[axis], ends = [0, state.picture.extent[axis]].map((edge) => (edge - from[axis]) / step);
    if (step) [first, last] = [Math.max(first, Math.min(...ends)), Math.min(last, Math.max(...ends))];
    else if (from[axis] < 0 || from[axis] > state.picture.extent[axis]) return null;
  }
  return first > last ? null : [first, last].map((part) => from.map((each, axis) => each + part * (to[axis] - each)));
}

/** The wall along the drawn line: clipped to the box, with ends close to an edge moved onto it; null: all of it is
 *  outside. */
function drawnWall() {
  const onEdge = (each, axis) => {
    const length = state.picture.extent[axis], at = bound(each, 0, length);
    return at <= gesture.reach ? 0 : length - at <= gesture.reach ? length : at;
  };
  return clipped(gesture.from, gesture.to)?.map((end) => end.map(onEdge)) ?? null;
}

let building = null;
function build() {
  const wall = drawnWall();
  if (!wall) { say("A wall must be in the box. Draw it there."); return; }
  const [[ax, ay], [bx, by]] = wall;
  sendWall({ do: "wall", ax, ay, bx, by });
}
function move() {
  const [dx, dy] = movedWall().shift;
  if (Math.hypot(dx, dy) > nearby() / 4) sendWall({ do: "move_wall", id: gesture.wall, dx, dy });
}
function sendWall(message) {
  send(message);
  clearTimeout(building);
  building = setTimeout(() => say("Adding the wall … The first time, code is compiled for up to half a minute.", 60), 1000);
}
function built() {
  if (building === null) return;
  clearTimeout(building);
  building = null;
  say("");
}

/** Begin a gesture at a place and a time [ms]; returns whether one has begun. */
function begin(place, reach, time) {
  if (tool === "hand") {
    const wall = discAt(place, 0) === null ? wallAt(place, nearby()) : null, disc = wall === null ? discAt(place, reach) : null;
    if (wall !== null) gesture = { tool: "move", wall, from: place, to: place };
    if (disc === null) return wall !== null;
    const centre = placeOf(disc), off = nearest([centre[0] - place[0], centre[1] - place[1]]);
    gesture = { tool, disc, off, place, trail: [[time, ...place]] };
    hold();
    // or the simulation releases it, as when the page is closed
    gesture.again = setInterval(() => { if (gesture?.tool === "hand") hold(); }, 1000);
  } else if (tool === "wall") {
    gesture = { tool, reach, from: place, to: place };
  } else {
    gesture = { tool, sent: false, gone: new Set(), last: place, path: [] };
    if (tool === "remove") removeAt(place, nearby()); else addAt(place);
  }
  requestDraw();
  return true;
}

const sendHold = (disc, [x, y]) => send({ do: "hold", id: disc, x, y }), holdSoon = paced(sendHold);
/** Say where the held disc is; how: one of these. */
function hold(how = holdSoon) {
  const { place, off, disc } = gesture;
  how(disc, inside(place.map((each, axis) => each + off[axis]), radiusOf(disc)));
}

function go(place, time) {
  if (!gesture) return;
  if (gesture.path) { gesture.path.push(place); strokeSoon(); }
  else if (gesture.from) { gesture.to = place; requestDraw(); }
  else if (gesture.tool === "hand") {
    gesture.place = place;
    gesture.trail.push([time, ...place]);
    while (gesture.trail.length > 1 && gesture.trail[1][0] < time - TRAIL) gesture.trail.shift();
    hold();
    requestDraw();
  }
}

/** End a gesture. A held disc gets the velocity [length/time], or without one that of the pointer at a time [ms]. A wall
 *  is built or moved without a velocity, and dropped with one. */
function end(velocity, time) {
  if (!gesture) return;
  if (gesture.tool === "hand") {
    clearInterval(gesture.again);
    holdSoon.forget();
    hold(sendHold);
    const [vx, vy] = velocity ?? pointerVelocity(time);
    send({ do: "release", id: gesture.disc, vx, vy });
  } else if (gesture.from && !velocity) { if (gesture.tool === "wall") build(); else move(); }
  else while (gesture.path?.length) stroke();
  gesture = null;
  requestDraw();
}

/** Velocity of the pointer at release: its last displacement over the simulated time. Times come from the events, as
 *  a busy page handles them later. */
function pointerVelocity(now) {
  const trail = gesture.trail.filter(([time]) => time >= now - 2 * TRAIL);
  if (trail.length < 2 || now - trail.at(-1)[0] > TRAIL) return [0, 0];
  const [first, last] = [trail[0], trail.at(-1)], seconds = Math.max(last[0] - first[0], 8) / 1000;
  const rate = seconds * 60 * (state.status.speed ?? 1) * (state.hands?.dt ?? state.scene.dt);
  return [(last[1] - first[1]) / rate, (last[2] - first[2]) / rate];
}

// --- pointers: the first one uses the tool, or moves the view where there is nothing to use it on; two of them zoom

let user = null; // the pointer that uses the tool
const movers = new Map(); // pointers that move the view, and their places on the canvas
stage.addEventListener("pointerdown", (event) => {
  if (event.target.closest("button")) return;
  const place = onCanvas(event), uses = event.button === 0 && user === null && !movers.size && ready();
  stage.setPointerCapture(event.pointerId);
  if (!uses || !begin(toBox(place), nearby(), event.timeStamp)) {
    movers.set(event.pointerId, place);
    stage.classList.add("dragged");
    return;
  }
  [user, cross] = [event.pointerId, null];
  stage.focus({ preventScroll: true });
  event.preventDefault();
});
stage.addEventListener("pointermove", (event) => {
  const before = movers.get(event.pointerId), now = onCanvas(event);
  if (event.pointerId === user) {
    const all = event.getCoalescedEvents?.() ?? []; // a busy page gets several moves as one
    for (const each of all.length ? all : [event]) go(toBox(onCanvas(each)), each.timeStamp);
  } else if (before) {
    const other = [...movers].find(([id]) => id !== event.pointerId)?.[1];
    movers.set(event.pointerId, now);
    if (!other) { camera.moveBy(now[0] - before[0], now[1] - before[1]); return; }
    const far = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]) || 1;
    camera.zoomBy(far(now) / far(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    camera.moveBy((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
  }
});
for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, (event) => {
  movers.delete(event.pointerId);
  if (!movers.size) stage.classList.remove("dragged");
  if (event.pointerId !== user) return;
  user = null;
  end(name === "pointercancel" ? [0, 0] : null, event.timeStamp);
});

// --- keys

function choose(name) {
  end([0, 0]);
  stage.dataset.tool = tool = name;
  for (const each of Object.values(TOOLS)) $(`tool-${each}`).setAttribute("aria-pressed", each === name);
}
for (const name of Object.values(TOOLS)) $(`tool-${name}`).addEventListener("click", () => choose(name));
const undo = () => { if (!$("undo").disabled) { end([0, 0]); send({ do: "undo" }); } };
$("undo").addEventListener("click", undo);
choose("hand");

document.addEventListener("keydown", (event) => {
  if (event.altKey || isText(event.target) || state.scene?.recording) return;
  const key = event.key.toLowerCase();
  if (key === "z" && !event.shiftKey) undo();
  else if (event.ctrlKey || event.metaKey) return;
  else if (key === "k" && ready()) pointByKeys();
  else if (TOOLS[key]) choose(TOOLS[key]);
  else return;
  event.preventDefault();
});

function pointByKeys() {
  if (cross) { end([0, 0]); cross = null; } else cross = [camera.x, camera.y];
  stage.focus();
  requestDraw();
}

stage.addEventListener("keydown", (event) => {
  if (!cross || event.ctrlKey || event.metaKey || event.altKey || event.target !== stage) return;
  const arrow = ARROWS[event.key];
  if (arrow && event.shiftKey && gesture?.tool === "hand") {
    end(arrow.map((each) => each * (state.picture.usual || 1))); // thrown faster than 98 % of the discs
  } else if (arrow) {
    const step = 0.02 * Math.min(camera.width, camera.height) / camera.scale;
    cross = cross.map((each, axis) => bound(each + step * arrow[axis], 0, state.picture.extent[axis]));
    go(cross, event.timeStamp);
  } else if (event.key === "Enter" && ready()) press(event.timeStamp);
  else if (event.key === "Escape") pointByKeys();
  else return;
  requestDraw();
  event.preventDefault();
  event.stopPropagation();
});

function press(time) {
  if (gesture) { end(gesture.from ? null : [0, 0]); return; }
  if (tool === "add") addAt(cross);
  else if (tool === "remove") { if (!removeAt(cross, nearby())) say("No disc and no wall is under the cross."); }
  else begin(cross, tool === "wall" ? 0 : Infinity, time);
  if (gesture?.tool === "move") say("The wall is held.");
  if (gesture?.tool === "hand") { // the cross jumps to the disc, and both move together
    cross = gesture.place = placeOf(gesture.disc);
    gesture.off = [0, 0];
    say(`Disc ${gesture.disc} is held.`);
  }
}

// --- messages and drawing

let silence = null;
export function say(text, seconds = NOTE_SECONDS) {
  $("hand-note").textContent = text;
  $("hand-note").hidden = !text;
  clearTimeout(silence);
  silence = setTimeout(() => { $("hand-note").hidden = true; }, seconds * 1000);
}

let first = true;
takers.obstacles.push(built);
takers.hands.push((message) => {
  built();
  state.hands = message;
  $("undo").disabled = !message.undo;
  $("undo").title = message.undo === null ? "This simulation belongs to a program, so changes cannot be undone here."
    : "Z: returns to the moment before the last change";
  if (message.note && message.notes !== notes && !first) say(message.note);
  [notes, first] = [message.notes, false];
});

/** Stroke a path twice, in white and then in orange, so that it can be seen on discs of any colour. */
function mark(c, widths, path) {
  widths.forEach((width, k) => {
    [c.lineWidth, c.strokeStyle] = [width * (window.devicePixelRatio || 1), k ? "#d55e00" : "#fff"];
    c.beginPath();
    path();
    c.stroke();
  });
}

afterDrawing.push(() => {
  const canvas = $("hand-canvas"), box = $("discs-canvas");
  if (canvas.width !== box.width || canvas.height !== box.height) [canvas.width, canvas.height] = [box.width, box.height];
  const c = canvas.getContext("2d"), ratio = window.devicePixelRatio || 1;
  c.clearRect(0, 0, canvas.width, canvas.height);
  if (gesture?.tool === "hand" && state.picture && gesture.disc < state.picture.count) {
    const [x, y] = camera.pixel(...placeOf(gesture.disc));
    mark(c, [5, 2.5], () => c.arc(x, y, radiusOf(gesture.disc) * camera.scale + 3 * ratio, 0, 7));
  }
  const drawn = gesture?.tool === "wall" && state.picture ? drawnWall() : null;
  for (const [ax, ay, bx, by, radius] of drawn ? [drawn.flat()] : gesture?.tool === "move" ? movedWall().rows : []) {
    c.lineCap = "round";
    const [x, y] = camera.pixel(ax, ay);
    mark(c, [7, 4], () => { if (radius < 0) c.arc(x, y, -radius * camera.scale, 0, 7); else { c.moveTo(x, y); c.lineTo(...camera.pixel(bx, by)); } });
  }
  if (!cross) return;
  const [x, y] = camera.pixel(...cross), arm = 14 * ratio;
  mark(c, [5, 2], () => { for (const [dx, dy] of [[arm, 0], [0, arm]]) { c.moveTo(x - dx, y - dy); c.lineTo(x + dx, y + dy); } });
});
