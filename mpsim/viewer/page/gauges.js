// Draws the gauges: numbers with charts of their last readings, and the histogram of speeds.

import { $, CURVE, LINE, NONE, SOFT, digits, paper, polyline, state, whole, withError, write } from "./common.js";

export const KEPT = 240; // readings of a gauge in its chart

/** Least range of a chart, below which changes are rounding; for others 2 % of the value. */
export const LEAST = { energy_drift: 1e-9 };
export const GAUGES = ["temperature", "energy_drift", "pressure", "largest_overlap", "collisions", "frames_per_second"];

export function drawGauges() {
  const gauges = state.gauges;
  $("discs").textContent = gauges ? gauges.discs.toLocaleString("en") : NONE;
  for (const name of GAUGES) {
    $(name).textContent = withError(gauges?.[name], gauges?.[`${name}_error`]);
    $(name).dataset.value = gauges?.[name] ?? "";
    drawChart($(name).parentElement.querySelector("canvas"), state.history[name] ?? [], LEAST[name] ?? 0);
  }
  $("collisions").textContent = gauges ? whole(gauges.collisions) : NONE;
  $("collisions-note").textContent = collisionsNote(gauges);
  $("drift-name").textContent = gauges?.energy_note ? "Energy change" : "Energy drift";
  $("drift-note").textContent = gauges?.energy_note
    ? `not conserved here: ${gauges.energy_note}` : "since the start, relative to the kinetic energy";
  $("speeds-note").textContent = gauges ? gauges.speeds?.note ?? (gauges.speeds ? "" : "no disc is moving") : "";
  $("count").checked = Boolean(gauges?.counting);
  $("pressure-note").textContent = pressureNote(gauges);
  drawSpeeds(gauges?.speeds);
}

function collisionsNote(gauges) {
  if (!gauges) return "since the start";
  if (gauges.collisions === null) return "unknown for this run";
  return `since the start, ${gauges.with_walls ? "including walls and obstacles" : "between discs"}`;
}

function pressureNote(gauges) {
  if (!gauges || (!gauges.counting && gauges.pressure === null)) return "not counted";
  if (gauges.pressure_note) return gauges.pressure_note;
  if (gauges.pressure === null) return "not enough counted yet";
  return gauges.pressure_error === null ? "error not known yet" : "";
}

/** The last readings of a gauge as a line, scaled from lowest to highest. */
export function drawChart(canvas, values, smallest) {
  const { c, width, height, ratio } = paper(canvas);
  const known = values.filter((value) => value !== null);
  if (known.length < 2) return;
  let low = Math.min(...known), high = Math.max(...known);
  const least = Math.max(Math.max(Math.abs(low), Math.abs(high)) * 0.02, smallest) || 1;
  const room = Math.max(values.length, KEPT / 4) - 1;
  if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
  const x = (k) => ratio + (k / room) * (width - 2 * ratio), y = (value) => 2 * ratio + (1 - (value - low) / (high - low)) * (height - 4 * ratio);
  c.lineJoin = "round";
  polyline(c, values.map((value, k) => (value === null ? null : [x(k), y(value)])), 1.6 * ratio, LINE);
}

/** Histogram of the speeds, with Maxwell's curve if there is one. */
export function drawSpeeds(speeds) {
  const { c, width, height, ratio, size } = paper($("speeds")), left = ratio, bottom = height - 1.5 * size;
  c.fillStyle = SOFT;
  c.fillRect(left, bottom, width - 2 * ratio, ratio);
  if (!speeds) return;
  const largest = speeds.edges.at(-1), top = 1.06 * Math.max(...speeds.density, ...(speeds.maxwell ?? [0]));
  const x = (speed) => left + (speed / largest) * (width - 2 * ratio), y = (density) => bottom - (density / top) * (bottom - 2 * ratio);
  c.fillStyle = "#56b4e9";
  speeds.density.forEach((density, k) => {
    const from = x(speeds.edges[k]), to = x(speeds.edges[k + 1]);
    c.fillRect(from, y(density), Math.max(to - from - ratio, ratio / 2), bottom - y(density));
  });
  if (speeds.maxwell) {
    const middle = (k) => (speeds.edges[k] + speeds.edges[k + 1]) / 2;
    polyline(c, speeds.maxwell.map((density, k) => [x(middle(k)), y(density)]), 2.4 * ratio, CURVE);
    write(c, "Maxwell", width - 2 * ratio, 1.2 * size, "right", CURVE);
  }
  write(c, "0", left, height - 0.3 * size);
  write(c, "speed", width / 2, height - 0.3 * size, "center");
  write(c, digits(largest), width - ratio, height - 0.3 * size, "right");
}
