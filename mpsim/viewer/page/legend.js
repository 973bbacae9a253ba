// The quantity that the colours show: its choice, and the legend below the stage.

import { $, FASTEST, INK, KNEE, SOFT, bound, colourOf, digits, paper, sharpen, state, write } from "./common.js";
import { send, takers } from "./connection.js";
import { afterDrawing, requestDraw } from "./stage.js";

const LOW = FASTEST - KNEE; // as in mpsim/viewer/colouring.py
const NAMES = { speed: "speed [length/time]", worker: "worker", column: "column", collision: "time since the last collision", own: "own values" };

let colours = { by: "speed" }, legendKey = "";
/** Draw the legend again, even if its numbers are the same. */
export const forgetLegend = () => { legendKey = ""; };

/** What the colours show. */
export const legendShows = () => colours.by;

const select = $("colour");
takers.colours = [(message) => {
  colours = message;
  if (message.choices.join() !== [...select.options].map((each) => each.value).join()) {
    select.replaceChildren(...message.choices.map((each) => new Option(NAMES[each], each)));
  }
  select.value = message.by;
  requestDraw();
}];
select.addEventListener("change", () => send({ do: "colour", by: select.value }));

/** Ticks of the legend: [place from 0 to 1, value, note below, alignment]. */
function ticksOf(picture) {
  const knee = KNEE / FASTEST;
  if (colours.by === "speed") {
    return [[0, 0, "", "left"], [knee / 2, picture.usual / 2, "", "center"], [knee, picture.usual, "98 % below", "right"], [1, picture.fastest, "max", "right"]];
  }
  if (!colours.values) return [];
  const [, lower, upper, most] = colours.values;
  return [[LOW / FASTEST, lower, "", "left"], [knee, upper, "98 % below", "right"], [1, most, "max", "right"]];
}

function drawLegend() {
  const canvas = $("legend"), { changed } = sharpen(canvas), picture = state.picture;
  const key = picture ? JSON.stringify([picture.usual, picture.fastest, colours]) : "";
  if (key === legendKey && !changed) return;
  legendKey = key;
  const { c, width, height, ratio, size } = paper(canvas), bar = height - 2.95 * size, classes = colours.classes ?? 0;
  if (!picture) return;
  for (let x = 0; x < width; x++) {
    const at = classes ? Math.floor((x / width) * classes) / Math.max(classes - 1, 1) : x / (width - 1);
    c.fillStyle = colourOf(at * FASTEST);
    c.fillRect(x, 0, 1, bar);
  }
  for (let k = 0; k < classes; k++) {
    write(c, colours.by === "column" ? ["even columns", "odd columns"][k] : `worker ${k}`, (k + 0.5) * width / classes, bar + 1.3 * size, "center", INK);
  }
  const room = [width, width]; // in each line of text, left of what was written: long numbers do not run into each other
  for (const [place, value, note, align] of ticksOf(picture).reverse()) {
    const x = place * width;
    c.fillStyle = INK;
    c.fillRect(bound(x - ratio / 2, 0, width - ratio), bar, ratio, 0.4 * size);
    [digits(value), note].forEach((text, line) => {
      const long = c.measureText(text).width, from = { left: x, center: x - long / 2, right: x - long }[align];
      const at = Math.min(from, room[line] - long);
      write(c, text, at, bar + (1.3 + 1.2 * line) * size, "left", line ? SOFT : INK);
      if (text) room[line] = at - size / 2;
    });
  }
}
afterDrawing.push(drawLegend);
