// Two stages: draws the second one like the first, and compares both since their common start.

import { $, LINE, NONE, digits, paper, polyline, sharpen, state, whole, withError, write } from "./common.js";
import { send, takers } from "./connection.js";
import { afterDrawing, camera, drawGround, images, rendererFor, requestDraw } from "./stage.js";

const KEPT = 600; // distances in the chart
const lines = $("second-lines"), discs = $("second-discs");
let renderer = null, told = null;
const history = []; // of [time, distance]

afterDrawing.push(() => {
  if ($("second").hidden) return;
  renderer ??= rendererFor(discs);
  const { ratio } = sharpen(discs);
  sharpen(lines);
  drawGround(lines, state.beside.picture, ratio);
  renderer.draw(state.beside.picture, state.beside.radii, camera, images(state.scene));
  drawDistance();
});

// --- the numbers below

const difference = (value, error) => `${value > 0 ? "+" : ""}${withError(value, error)}`;
const percent = (value) => (value === null ? NONE : `${(100 * value).toFixed(1).replace("-", "−")} %`);

/** The numbers compared: title, value, and note below. */
const NUMBERS = {
  distance: ["Distance", () => (told.parted === null ? digits(told.distance) : "parted"), () => "diameters, rms"],
  missed: ["Missed collisions", () => (told.parted === null ? whole(told.missed) : percent(told.missed_fraction)),
    () => `of ${whole(told.collisions[1])}`],
  pressure: ["Pressure difference", () => difference(told.pressure_difference, told.difference_error),
    () => `${digits(told.pressure[0])} and ${digits(told.pressure[1])}`],
  cost: ["Cost", () => (told.cost_ratio === null ? NONE : `${digits(told.cost_ratio)}×`), () => "second stage / first stage"],
};

for (const [name, [title]] of Object.entries(NUMBERS)) {
  const box = document.createElement("div");
  box.innerHTML = `<small></small><b id="trade-${name}"></b><small class="of"></small>`;
  box.firstChild.textContent = title;
  if (name === "distance") box.append(Object.assign(document.createElement("canvas"), { id: "trade-chart" }));
  $("trade").append(box);
}

/** The distance against time on a logarithmic scale: exponential growth is a straight line. */
function drawDistance() {
  const { c, width, height, ratio } = paper($("trade-chart"), 0.85);
  const known = history.filter(([, distance]) => distance > 0);
  if (known.length < 2) return;
  const low = Math.min(...known.map(([, each]) => Math.log10(each))), from = known[0][0], to = known.at(-1)[0];
  const x = (time) => ((time - from) / (to - from || 1)) * (width - 2 * ratio) + ratio;
  const y = (each) => height - ratio - ((Math.log10(each) - low) / (Math.log10(1) - low || 1)) * (height - 2 * ratio);
  polyline(c, known.map(([time, each]) => [x(time), y(each)]), 1.6 * ratio, LINE);
  write(c, "log", width - ratio, height - 2 * ratio, "right");
}

/** What can still be compared. */
function partedText() {
  const when = `The stages parted for good at time ${digits(told.parted)}: the position of a disc on one stage says nothing about the other. Compare only averages.`;
  return told.lyapunov_time === null ? when
    : `${when} A difference grows by a factor of e in ${digits(told.lyapunov_time)} (the Lyapunov time). Two correct solvers agree until about ${digits(told.agree_until)}.`;
}

const choice = $("beside-choice"), given = new Option("", "given");
given.disabled = true; // for a view opened with a second stage

/** Show the second stage in the list, also if it was not chosen on this page. */
function showChoice(second) {
  if (second === null) given.remove();
  else if (choice.value === "" || given.selected) {
    given.textContent = second;
    choice.append(given);
    choice.value = "given";
  }
}

takers.pair.push((message) => {
  told = message;
  showChoice(message.second);
  const two = message.second !== null;
  for (const id of ["second", "trade", "first-name"]) $(id).hidden = !two;
  $("first-name").textContent = message.first;
  $("second-name").textContent = two ? `${message.second}${message.exact ? ", exact" : ""}` : "";
  $("beside-note").textContent = message.note ?? (message.skipped
    ? `${message.skipped} changes by hand were skipped on the second stage, where a disc was in the way.` : "");
  if (!two || message.time === undefined) {
    history.length = 0;
    if (!two) state.beside.picture = null;
    $("parted").hidden = true;
  } else {
    if (history.length && message.time < history.at(-1)[0]) history.length = 0;
    if (message.distance !== null) history.push([message.time, message.distance]);
    if (history.length > KEPT) history.splice(0, history.length, ...history.filter((_, k) => k % 2));
    $("parted").hidden = message.parted === null;
    if (message.parted !== null) $("parted").textContent = partedText();
  }
  for (const [name, [, value, of]] of Object.entries(NUMBERS)) {
    const there = two && message.time !== undefined;
    $(`trade-${name}`).textContent = there ? value() : NONE;
    $(`trade-${name}`).dataset.value = there ? message[name] ?? "" : "";
    $(`trade-${name}`).parentElement.querySelector(".of").textContent = there ? of() : "";
  }
  requestDraw();
});

choice.addEventListener("change", (event) => send({ do: "beside", settings: event.target.value || null }));

takers.scene.push((scene) => {
  choice.disabled = !scene.can_reset;
});
