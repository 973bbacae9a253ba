// Changes parameters during a run: gravity by an arrow on a dial, the others by sliders.

import { $, ARROWS, CURVE, bound, digits, paper, polyline, state, trace } from "./common.js";
import { paced } from "./edits.js";
import { send, takers } from "./connection.js";

const STEPS = 1000; // of a slider
const NAMES = {
  restitution: "Restitution", wall_restitution: "Wall restitution", friction: "Friction", wall_friction: "Wall friction", piston_speed: "Piston speed",
  temperature: "Temperature of the thermostat", wall_temperature: "Wall temperature", interval: "Time between two emitted discs",
  every: "Frames between two emitted discs", dt: "Time step, dt", contact: "Contact",
  passes: "Passes", substeps: "Sub-steps", workers: "Workers",
};

/** Sends values of one parameter; those of one drag are undone together. */
function sender(name) {
  let next = true, fresh = false; // whether the next value, or the waiting one, begins a new drag
  const out = paced((value) => { send({ do: "change", name, value, same: !fresh }); fresh = false; });
  return {
    post: (value) => { fresh ||= next; next = false; out(value); },
    end: () => { next = true; },
  };
}

// --- sliders

const shown = new Map();
const textOf = (each, value) => (each.whole ? String(value) : digits(value));

/** From a value to a place on its slider, and back; negative numbers by magnitude. */
function scaleOf({ low, high, log, whole }) {
  const sign = low < 0 && log ? -1 : 1, ends = sign < 0 ? [-high, -low] : [low, high];
  const there = log ? Math.log : (each) => each, back = log ? Math.exp : (each) => each;
  const [from, to] = ends.map(there);
  return {
    at: (value) => (to > from ? Math.round(((there(sign * value) - from) / (to - from)) * STEPS) : 0),
    value: (at) => {
      const found = sign * bound(back(from + ((to - from) * at) / STEPS), ...ends);
      return whole ? Math.round(found) : +found.toPrecision(3);
    },
  };
}

function made(each) {
  const label = document.createElement("label"), output = document.createElement("output");
  const control = document.createElement(each.choices ? "select" : "input"), { post, end } = sender(each.name);
  control.id = `change-${each.name}`;
  label.append(NAMES[each.name] ?? each.name, output, control);
  const row = { label, output, control, each, held: false };
  if (each.choices) {
    for (const word of each.choices) control.append(new Option(word, word));
    control.addEventListener("change", () => { post(control.value); end(); });
  } else {
    Object.assign(control, { type: "range", min: 0, max: STEPS, step: each.whole ? STEPS / bound(each.high - each.low, 1, 50) : STEPS / 200 });
    control.addEventListener("input", () => {
      row.held = true;
      const value = scaleOf(row.each).value(+control.value);
      output.textContent = textOf(row.each, value);
      post(value);
    });
    control.addEventListener("change", () => { row.held = false; end(); update(row, row.each); });
  }
  return row;
}

function update(row, each) {
  row.each = each;
  if (each.choices) { row.control.value = each.value; return; }
  if (row.held) return;
  row.control.value = scaleOf(each).at(each.value);
  row.output.textContent = textOf(each, each.value);
  row.control.dataset.value = each.value;
  row.control.setAttribute("aria-valuetext", textOf(each, each.value));
}

takers.hands.push(({ parameters }) => {
  const sliders = parameters.filter((each) => each.name !== "gravity");
  for (const [name, row] of shown) if (!sliders.some((each) => each.name === name)) { row.label.remove(); shown.delete(name); }
  for (const each of sliders) {
    if (!shown.has(each.name)) {
      shown.set(each.name, made(each));
      $("sliders").append(shown.get(each.name).label);
    }
    update(shown.get(each.name), each);
  }
  gravity = parameters.find((each) => each.name === "gravity");
  dial.dataset.value = JSON.stringify(gravity?.value ?? null);
  if (!dragged) drawDial();
});

// --- gravity

const dial = $("dial"), pull = sender("gravity");
let gravity = null, dragged = null;

function drawDial(value = gravity?.value) {
  const { c, width, height, ratio } = paper(dial), middle = width / 2, round = middle - 2 * ratio;
  if (!value) return;
  c.fillStyle = "#fff";
  c.strokeStyle = "#7d8895";
  c.lineWidth = ratio;
  c.beginPath();
  c.arc(middle, height / 2, round, 0, 7);
  c.fill();
  c.stroke();
  const [x, y] = value.map((each) => (each / gravity.high) * round), length = Math.hypot(x, y);
  c.fillStyle = CURVE;
  c.beginPath();
  c.arc(middle, height / 2, 3 * ratio, 0, 7);
  c.fill();
  $("gravity-text").textContent = Math.hypot(...value) ? `${digits(value[0])}, ${digits(value[1])}` : "none";
  if (length < ratio) return;
  const tip = [middle + x, height / 2 - y], head = Math.min(9 * ratio, length);
  polyline(c, [[middle, height / 2], tip], 3 * ratio, CURVE);
  const angles = [2.6, -2.6].map((turn) => Math.atan2(y, x) + turn);
  trace(c, [tip, ...angles.map((each) => [tip[0] + head * Math.cos(each), tip[1] - head * Math.sin(each)])]);
  c.fill();
}

/** Set gravity from the tip of the arrow: zero near the middle, at most the dial's radius. */
function pullBy(event) {
  const box = dial.getBoundingClientRect(), round = box.width / 2;
  const vector = [(event.clientX - box.left - round) / round, -(event.clientY - box.top - box.height / 2) / round];
  const length = Math.hypot(...vector), kept = length < 0.08 ? 0 : gravity.high / Math.max(length, 1);
  dragged = vector.map((each) => +(each * kept).toPrecision(3));
  drawDial(dragged);
  pull.post(dragged);
}

dial.addEventListener("pointerdown", (event) => {
  if (!gravity || event.button !== 0) return;
  dial.setPointerCapture(event.pointerId);
  pullBy(event);
});
dial.addEventListener("pointermove", (event) => { if (dragged && dial.hasPointerCapture(event.pointerId)) pullBy(event); });
for (const name of ["pointerup", "pointercancel"]) dial.addEventListener(name, () => { dragged = null; pull.end(); });

dial.addEventListener("keydown", (event) => {
  const arrow = ARROWS[event.key], none = ["Delete", "Backspace"].includes(event.key);
  if (!gravity || event.ctrlKey || event.metaKey || event.altKey || (!arrow && !none)) return;
  const step = gravity.high / 10;
  const value = none ? [0, 0] : gravity.value.map((each, axis) => +(Math.round(each / step + arrow[axis]) * step).toPrecision(6));
  if (Math.hypot(...value) <= gravity.high * 1.0001) { pull.post(value); pull.end(); }
  event.preventDefault();
  event.stopPropagation();
});
$("parameters").addEventListener("toggle", () => drawDial());
