// Changes parameters during a run, by sliders.

import { $, bound, digits } from "./common.js";
import { paced } from "./edits.js";
import { send, takers } from "./connection.js";

const STEPS = 1000; // of a slider
const NAMES = {
  "gravity-x": "Gravity along x", "gravity-y": "Gravity along y",
  restitution: "Restitution", wall_restitution: "Wall restitution", friction: "Friction", wall_friction: "Wall friction", piston_speed: "Piston speed",
  temperature: "Temperature of the thermostat", wall_temperature: "Wall temperature", interval: "Time between two emitted discs",
  every: "Frames between two emitted discs", dt: "Time step, dt",
  passes: "Passes", substeps: "Sub-steps",
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
  const control = document.createElement("input"), { post, end } = sender(each.name);
  control.id = `change-${each.id}`;
  label.append(NAMES[each.id] ?? each.name, output, control);
  const row = { label, output, control, each, held: false };
  Object.assign(control, { type: "range", min: 0, max: STEPS, step: each.whole ? STEPS / bound(each.high - each.low, 1, 50) : STEPS / 200 });
  control.addEventListener("input", () => {
    row.held = true;
    const value = scaleOf(row.each).value(+control.value);
    output.textContent = textOf(row.each, value);
    post(row.each.both?.map((old, axis) => (axis === row.each.axis ? value : old)) ?? value);
  });
  control.addEventListener("change", () => { row.held = false; end(); update(row, row.each); });
  return row;
}

function update(row, each) {
  row.each = each;
  if (row.held) return;
  row.control.value = scaleOf(each).at(each.value);
  row.output.textContent = textOf(each, each.value);
  row.control.dataset.value = each.value;
  row.control.setAttribute("aria-valuetext", textOf(each, each.value));
}

/** The sliders of a parameter: one, or for gravity one along each axis. */
const slidersOf = (each) => (each.name !== "gravity" ? [{ ...each, id: each.name }]
  : each.value.map((value, axis) => ({ ...each, id: `gravity-${"xy"[axis]}`, value, axis, both: each.value })));

takers.hands.push(({ parameters }) => {
  const sliders = parameters.flatMap(slidersOf);
  for (const [id, row] of shown) if (!sliders.some((each) => each.id === id)) { row.label.remove(); shown.delete(id); }
  for (const each of sliders) {
    if (!shown.has(each.id)) {
      shown.set(each.id, made(each));
      $("sliders").append(shown.get(each.id).label);
    }
    update(shown.get(each.id), each);
  }
});
