// The legend below the stage: what the colours show.

import { $, FASTEST, INK, KNEE, SOFT, bound, colourOf, digits, paper, sharpen, state, write } from "./common.js";
import { takers } from "./connection.js";
import { afterDrawing, requestDraw } from "./stage.js";

const LOW = FASTEST - KNEE; // as in mpsim/viewer/protocol.py

let own = [], legendKey = ""; // percentiles of the numbers that the program gave; none: colours show speeds
/** Draw the legend again, even if its numbers are the same. */
export const forgetLegend = () => { legendKey = ""; };

/** Whether colours show speeds. */
export const showsSpeed = () => !own.length;

takers.colours = [({ values }) => {
  own = values;
  $("legend-name").textContent = showsSpeed() ? "speed [length/time]" : "own values";
  requestDraw();
}];

/** Ticks of the legend: [place from 0 to 1, value, note below, alignment]. */
function ticksOf(picture) {
  const knee = KNEE / FASTEST;
  if (showsSpeed()) {
    return [[0, 0, "", "left"], [knee / 2, picture.usual / 2, "", "center"], [knee, picture.usual, "98 % below", "right"], [1, picture.fastest, "max", "right"]];
  }
  const [, lower, upper, most] = own;
  return [[LOW / FASTEST, lower, "", "left"], [knee, upper, "98 % below", "right"], [1, most, "max", "right"]];
}

function drawLegend() {
  const canvas = $("legend"), { changed } = sharpen(canvas), picture = state.picture;
  const key = picture ? JSON.stringify([picture.usual, picture.fastest, own]) : "";
  if (key === legendKey && !changed) return;
  legendKey = key;
  const { c, width, height, ratio, size } = paper(canvas), bar = height - 2.95 * size;
  if (!picture) return;
  for (let x = 0; x < width; x++) {
    c.fillStyle = colourOf((x / (width - 1)) * FASTEST);
    c.fillRect(x, 0, 1, bar);
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
