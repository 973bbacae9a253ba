// The gauges: numbers with charts of their last readings, and the histogram of the speeds.

import { $, NONE, digits, fontSize, sharpen, state } from "./common.js";

export const KEPT = 240; // readings of a gauge in its chart

/** Least height of a chart, where less is rounding; of the others it is 2 % of the value. */
export const LEAST = { energy_drift: 1e-9 };
export const GAUGES = ["temperature", "energy_drift", "collisions_per_second", "frames_per_second", "nanoseconds"];

export function drawGauges() {
  const gauges = state.gauges;
  $("discs").textContent = gauges ? gauges.discs.toLocaleString("en") : NONE;
  for (const name of GAUGES) {
    $(name).textContent = digits(gauges?.[name]);
    $(name).dataset.value = gauges?.[name] ?? "";
    drawChart($(name).parentElement.querySelector("canvas"), state.history[name] ?? [], LEAST[name] ?? 0);
  }
  $("drift-name").textContent = gauges?.energy_note ? "Energy change" : "Energy drift";
  $("drift-note").textContent = gauges?.energy_note
    ? `not conserved here: ${gauges.energy_note}` : "since the start, of the kinetic energy";
  $("speeds-note").textContent = gauges ? gauges.speeds?.note ?? (gauges.speeds ? "" : "no disc moves") : "";
  drawSpeeds(gauges?.speeds);
}

/** The last readings of a gauge as a line, from the lowest to the highest. */
export function drawChart(canvas, values, smallest) {
  const { width, height, ratio } = sharpen(canvas), c = canvas.getContext("2d");
  c.clearRect(0, 0, width, height);
  const known = values.filter((value) => value !== null);
  if (known.length < 2) return;
  let low = Math.min(...known), high = Math.max(...known);
  const least = Math.max(Math.max(Math.abs(low), Math.abs(high)) * 0.02, smallest) || 1;
  const room = Math.max(values.length, KEPT / 4) - 1;
  if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
  c.strokeStyle = "#0b5394";
  c.lineWidth = 1.6 * ratio;
  c.lineJoin = "round";
  c.beginPath();
  let open = false;
  values.forEach((value, k) => {
    if (value === null) { open = false; return; }
    const x = ratio + (k / room) * (width - 2 * ratio), y = 2 * ratio + (1 - (value - low) / (high - low)) * (height - 4 * ratio);
    if (open) c.lineTo(x, y); else c.moveTo(x, y);
    open = true;
  });
  c.stroke();
}

/** Histogram of the speeds, with the curve of Maxwell where there is one. */
export function drawSpeeds(speeds) {
  const canvas = $("speeds"), { width, height, ratio } = sharpen(canvas), c = canvas.getContext("2d");
  c.clearRect(0, 0, width, height);
  const size = fontSize(ratio), left = ratio, bottom = height - 1.5 * size;
  c.font = `${size}px system-ui, "DejaVu Sans", sans-serif`;
  c.fillStyle = "#4d5661";
  c.fillRect(left, bottom, width - 2 * ratio, ratio);
  c.textAlign = "left";
  if (!speeds) return;
  const largest = speeds.edges.at(-1), top = 1.06 * Math.max(...speeds.density, ...(speeds.maxwell ?? [0]));
  const x = (speed) => left + (speed / largest) * (width - 2 * ratio), y = (density) => bottom - (density / top) * (bottom - 2 * ratio);
  c.fillStyle = "#56b4e9";
  speeds.density.forEach((density, k) => {
    const from = x(speeds.edges[k]), to = x(speeds.edges[k + 1]);
    c.fillRect(from, y(density), Math.max(to - from - ratio, ratio / 2), bottom - y(density));
  });
  if (speeds.maxwell) {
    c.strokeStyle = "#b34700";
    c.lineWidth = 2.4 * ratio;
    c.beginPath();
    speeds.maxwell.forEach((density, k) => {
      const middle = (speeds.edges[k] + speeds.edges[k + 1]) / 2;
      if (k) c.lineTo(x(middle), y(density)); else c.moveTo(x(middle), y(density));
    });
    c.stroke();
    c.fillStyle = "#b34700";
    c.textAlign = "right";
    c.fillText("Maxwell", width - 2 * ratio, 1.2 * size);
  }
  c.fillStyle = "#4d5661";
  c.textAlign = "left";
  c.fillText("0", left, height - 0.3 * size);
  c.textAlign = "center";
  c.fillText("speed", width / 2, height - 0.3 * size);
  c.textAlign = "right";
  c.fillText(digits(largest), width - ratio, height - 0.3 * size);
}
