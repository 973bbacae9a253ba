// The connection to the simulation, and its messages.

import { $, digits, state } from "./common.js";
import { GAUGES, KEPT, drawGauges } from "./gauges.js";
import { inNotebook, openSocket } from "./socket.js";
import { afterDrawing, requestDraw } from "./stage.js";

const REFUSED = [1003, 1008, 1013]; // close codes after which retrying is useless
export const SPEEDS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, null]; // null: as fast as possible

const NO_ANSWER = inNotebook
  ? "Python does not answer: it is running a cell, or this view or its kernel has ended. To see the view again, run its cell."
  : "No connection to mpsim. Is it still running? Trying again …";

// --- binary messages, whose format mpsim/viewer/protocol.py defines

const VERSION = 1, RADII = 2, HEADER = 96;

/** The content of a binary message; throws if it is not valid. */
function decode(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER || view.getUint32(0, false) !== 0x4d505356) throw new Error("not a picture");
  if (view.getUint8(4) !== VERSION) throw new Error("Another version of mpsim is running. Reload the page.");
  const kind = view.getUint8(5), count = view.getUint32(12, true);
  if (buffer.byteLength !== HEADER + count * (kind === RADII ? 4 : 5)) throw new Error("picture incomplete");
  const stage = view.getUint16(6, true);
  if (kind === RADII) return { kind, stage, radii: new Float32Array(buffer, HEADER, count) };
  const float = (offset) => view.getFloat64(offset, true);
  return {
    kind, stage, count, serial: view.getUint32(8, true), frame: Number(view.getBigUint64(16, true)), time: float(24),
    walls: [float(32), float(40), float(48), float(56)], extent: [float(64), float(72)],
    usual: float(80), fastest: float(88),
    places: new Uint16Array(buffer, HEADER, 2 * count), colours: new Uint8Array(buffer, HEADER + 4 * count, count),
  };
}

// --- messages

/** Functions of other parts of the page, called with messages of each kind, and when the connection opens. */
export const takers = { scene: [], obstacles: [], hands: [], timeline: [], status: [], pair: [], link: [] }, opened = [];

export function take(message) {
  if (message.type === "scene") {
    if (message.version !== VERSION) return refuse("Another version of mpsim is running. Reload the page.");
    state.scene = message;
    $("name").textContent = document.title = message.name || "mpsim";
    $("reset").disabled = !message.can_reset;
    $("reset").title = message.can_reset ? "R" : "This simulation belongs to a program; only the program can reset it.";
    const periodic = message.periodic.every(Boolean) ? "periodic" : message.periodic.some(Boolean) ? `periodic along ${message.periodic[0] ? "x" : "y"}` : "walls";
    $("about").textContent = `box ${digits(message.width)} × ${digits(message.height)}, ${periodic}; ${message.recording ? `recording ${message.recording}` : `method ${message.method}, dt ${digits(message.dt)}`}`;
    requestDraw();
  } else if (message.type === "obstacles") {
    [state.obstacles, state.owners, state.filled] = [message.capsules, message.numbers, message.filled];
    state.solid = message.colours;
    requestDraw();
  } else if (message.type === "status") {
    state.status = message;
    showStatus();
  } else if (message.type === "compiling") {
    state.compiling = message.text;
    showStatus();
  } else if (message.type === "gauges") {
    state.gauges = message;
    if (message.frame < state.historyFrame) state.history = {};
    state.historyFrame = message.frame;
    for (const name of GAUGES) {
      const values = (state.history[name] ??= []);
      values.push(message[name]);
      if (values.length > KEPT) values.shift();
    }
    drawGauges();
  }
  for (const each of takers[message.type] ?? []) each(message);
}

export function takeBytes(buffer) {
  const found = decode(buffer), shown = found.stage ? state.beside : state;
  if (found.kind === RADII) { shown.radii = found.radii; return; }
  shown.picture = found;
  if (found.stage) return; // the first stage's picture of this moment follows
  due = { serial: found.serial, socket: state.socket };
  if (document.visibilityState === "visible") requestDraw(); else acknowledge();
}

let due = null;
/** Ask for the next picture once the last one is drawn: a slow page gets fewer. */
function acknowledge() {
  if (due?.socket === state.socket) send({ do: "ack", serial: due.serial });
  due = null;
}
afterDrawing.push(() => { if (due) acknowledge(); });

export function showStatus() {
  const { phase, speed, note } = state.status, open = state.socket?.readyState === WebSocket.OPEN && !quiet;
  const ready = open && (phase === "playing" || phase === "paused");
  $("phase").textContent = open ? { over: "ended" }[phase] ?? phase : state.refused ? "not connected" : "connecting";
  $("play").textContent = phase === "playing" ? "Pause" : "Play";
  for (const id of ["play", "step"]) $(id).disabled = !ready;
  $("speed").disabled = !ready;
  $("reset").disabled = !open || phase === "starting" || !state.scene?.can_reset;
  let at = SPEEDS.indexOf(speed);
  if (at < 0) at = SPEEDS.findIndex((each) => each === null || each >= speed);
  if (document.activeElement !== $("speed") || !state.dragging) $("speed").value = at;
  $("speed-text").textContent = speedText(speed);
  $("speed").setAttribute("aria-valuetext", speedText(speed));
  const seconds = Math.round((performance.now() - state.since) / 1000);
  notice(state.refused ?? (!open ? (seconds > 1 ? NO_ANSWER : null)
    : state.compiling ? `${state.compiling.replace(/^c/, "C")} …`
    : phase === "starting" ? `Getting ready … ${seconds > 1 ? `${seconds} s. The first time, code is compiled for up to half a minute.` : ""}` : note));
}

export function speedText(speed) {
  if (speed === null) return "as fast as possible";
  return `${speed < 1 ? `1/${Math.round(1 / speed)}` : digits(speed).replace(/\.0+$/, "")}×, ${speed * 60 < 10 ? +(speed * 60).toFixed(2) : Math.round(speed * 60)} ${state.scene?.recording ? "recorded frames" : "frames"} a second`;
}

export function notice(text) {
  $("notice").hidden = !text;
  $("notice").textContent = text ?? "";
}

// --- the connection

export function send(message) {
  if (state.socket?.readyState === WebSocket.OPEN) state.socket.send(JSON.stringify(message));
}

let quiet = false; // a notebook's kernel has said nothing for long
export let patience = 500;
export function connect() {
  const socket = (state.socket = openSocket());
  socket.onopen = () => {
    patience = 500;
    state.since = performance.now();
    for (const each of opened) each();
    tellVisible();
    showStatus();
  };
  socket.onquiet = () => { quiet = true; showStatus(); };
  socket.onmessage = ({ data }) => {
    if (quiet) { quiet = false; showStatus(); }
    try {
      if (typeof data === "string") take(JSON.parse(data)); else takeBytes(data);
    } catch (error) {
      refuse(String(error.message ?? error));
    }
  };
  socket.onclose = ({ code, reason }) => {
    if (state.refused) return;
    if (REFUSED.includes(code)) { refuse(`mpsim closed the connection: ${reason}. ${inNotebook ? "Run the cell again" : "Reload the page"}.`); return; }
    state.since = patience === 500 ? performance.now() : state.since;
    setTimeout(connect, patience);
    patience = Math.min(2 * patience, 5000);
    showStatus();
  };
}

export function refuse(text) {
  state.refused = text;
  state.socket?.close();
  showStatus();
}

let onScreen = true; // a notebook scrolls its outputs away
export const tellVisible = () => send({ do: "visible", value: document.visibilityState === "visible" && onScreen });
if (inNotebook) new IntersectionObserver((seen) => { onScreen = seen.at(-1).isIntersecting; tellVisible(); }).observe($("stage"));
document.addEventListener("visibilitychange", () => { tellVisible(); requestDraw(); });
setInterval(() => { if (state.status.phase === "starting" || state.socket?.readyState !== WebSocket.OPEN) showStatus(); }, 1000);
