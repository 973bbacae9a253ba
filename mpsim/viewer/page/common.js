// Shared by all parts of the page: its state, numbers as text, colours, canvases at the screen's resolution.

export const NONE = "–";
export const KNEE = 223, FASTEST = 254, ABSORBED = 255; // bytes of colours, as in mpsim/viewer/protocol.py

// Viridis, clear to colour-blind people and in grey: nine of its colours, interpolated linearly.
export const VIRIDIS = [0x440154, 0x472d7b, 0x3b528b, 0x2c728e, 0x21918c, 0x28ae80, 0x5ec962, 0xaddc30, 0xfde725]
  .map((hex) => [hex >> 16, (hex >> 8) & 255, hex & 255]);

export const $ = (id) => document.getElementById(id);
/** Whether an element takes keys itself: a text, a number or a list. */
export const isText = (element) => Boolean(element.closest?.("textarea, select, input:not([type=range], [type=checkbox])"));
export const bound = (value, low, high) => Math.min(Math.max(value, low), high);

export const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** Do what `actOf(key, event)` returns, if anything, when a key is pressed alone and not into a text. */
export function onKeys(actOf) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || isText(event.target)) return;
    const onControl = event.target.closest?.("button, input, summary");
    if (onControl && (event.key === " " || event.key === "Enter" || event.key.startsWith("Arrow"))) return; // its own
    const act = actOf(event.key.length === 1 ? event.key.toLowerCase() : event.key, event);
    if (!act) return;
    event.preventDefault();
    act();
  });
}

/** Let a button, and a key, do something while the button is enabled. */
export function onButton(id, key, act) {
  $(id).addEventListener("click", act);
  onKeys((pressed) => (pressed === key ? () => { if (!$(id).disabled) act(); } : null));
}

/** Colour of a byte, as CSS. */
export function colourOf(byte) {
  const at = bound(byte / FASTEST, 0, 1) * (VIRIDIS.length - 1), low = Math.min(Math.floor(at), VIRIDIS.length - 2);
  const mixed = VIRIDIS[low].map((one, k) => Math.round(one + (VIRIDIS[low + 1][k] - one) * (at - low)));
  return `rgb(${mixed.join(" ")})`;
}

/** A number with four digits, or a dash. */
export function digits(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-3) return value.toExponential(2).replace("e+", "e").replace("-", "−").replace("e-", "e−");
  const places = Math.max(0, 3 - Math.floor(Math.log10(size)));
  return value.toLocaleString("en", { maximumFractionDigits: places, minimumFractionDigits: Math.min(places, 6) }).replace("-", "−");
}

/** A whole number with all its digits, or a dash. */
export const whole = (value) => (value === null || value === undefined ? NONE : value.toLocaleString("en").replace("-", "−"));

/** A value with its standard error in brackets, in units of the last digit, as the library prints it: 2.240(16). */
export function withError(value, error) {
  if (!Number.isFinite(value) || !Number.isFinite(error) || error === null || error <= 0) return digits(value);
  const size = Math.floor(Math.log10(Math.max(Math.abs(value), error))), power = size < -4 || size > 6 ? size : 0;
  const scale = 10 ** power, decimals = Math.max(1 - Number((error / scale).toExponential(1).split("e")[1]), 0);
  const rounded = (error / scale).toFixed(decimals), last = rounded >= 1 ? rounded : rounded.replace(/^0\.0*/, "");
  return `${(value / scale).toFixed(decimals)}(${last})${power ? `e${power}` : ""}`.replaceAll("-", "−");
}

export const state = {
  beside: { picture: null, radii: null }, // the second stage
  scene: null, obstacles: [], owners: [], filled: [], solid: [], status: { phase: "connecting", speed: 1, note: null }, gauges: null, picture: null, radii: null, timeline: null,
  history: {}, historyFrame: -1, drawn: 0, socket: null, refused: null, dragging: false, since: performance.now(),
};

/** Set a canvas to the screen's resolution; returns its size in pixels, and whether it changed. */
export function sharpen(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const [width, height] = [Math.max(Math.round(box.width * ratio), 1), Math.max(Math.round(box.height * ratio), 1)];
  const changed = canvas.width !== width || canvas.height !== height;
  if (changed) [canvas.width, canvas.height] = [width, height];
  return { width, height, ratio, changed };
}

export const INK = "#16191d", SOFT = "#4d5661", CURVE = "#b34700", LINE = "#0b5394"; // as in page.css

/** Begin a path through points; null in place of a point interrupts it. */
export function trace(c, points) {
  c.beginPath();
  points.forEach((point, k) => { if (point) points[k - 1] ? c.lineTo(...point) : c.moveTo(...point); });
}

/** Draw lines through points, as in `trace`. */
export function polyline(c, points, width, colour) {
  [c.lineWidth, c.strokeStyle] = [width, colour];
  trace(c, points);
  c.stroke();
}

/** Write a text: its baseline is at y, and it begins, ends or has its middle at x. */
export function write(c, text, x, y, align = "left", colour = SOFT) {
  [c.textAlign, c.fillStyle] = [align, colour];
  c.fillText(text, x, y);
}

/** A cleared canvas to draw on: its context, with a font of so many times the usual size, and its sizes in pixels. */
export function paper(canvas, times = 1) {
  const { width, height, ratio } = sharpen(canvas), c = canvas.getContext("2d");
  const size = parseFloat(getComputedStyle(document.documentElement).fontSize) * 0.82 * ratio * times;
  c.clearRect(0, 0, width, height);
  c.font = `${size}px system-ui, "DejaVu Sans", sans-serif`;
  return { c, width, height, ratio, size };
}
