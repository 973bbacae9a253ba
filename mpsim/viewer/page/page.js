// The page of mpsim's live view. The format of its messages is written in mpsim/viewer/wire.py.

const VERSION = 1, PICTURE = 1, RADII = 2, HEADER = 96;
const KNEE = 223, FASTEST = 254, ABSORBED = 255;
const SPEEDS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, null]; // null: as fast as it goes
const USUAL = 6;
const REFUSED = [1003, 1008, 1013]; // closed for a reason that trying again would not change
const KEPT = 240; // readings of a gauge in its chart
const MOST_ZOOM = 64;
const NONE = "–";

// Viridis, which is as clear to colour-blind eyes and in grey: nine of its colours, and straight lines between them.
const VIRIDIS = [0x440154, 0x472d7b, 0x3b528b, 0x2c728e, 0x21918c, 0x28ae80, 0x5ec962, 0xaddc30, 0xfde725]
  .map((hex) => [hex >> 16, (hex >> 8) & 255, hex & 255]);

const $ = (id) => document.getElementById(id);
const bound = (value, low, high) => Math.min(Math.max(value, low), high);

/** Colour of a byte, as CSS. */
export function colourOf(byte) {
  const at = bound(byte / FASTEST, 0, 1) * (VIRIDIS.length - 1), low = Math.min(Math.floor(at), VIRIDIS.length - 2);
  const mixed = VIRIDIS[low].map((one, k) => Math.round(one + (VIRIDIS[low + 1][k] - one) * (at - low)));
  return `rgb(${mixed.join(" ")})`;
}

/** A number in four digits; a dash for none. */
export function digits(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-3) return value.toExponential(2).replace("e+", "e").replace("-", "−").replace("e-", "e−");
  const places = Math.max(0, 3 - Math.floor(Math.log10(size)));
  return value.toLocaleString("en", { maximumFractionDigits: places, minimumFractionDigits: Math.min(places, 6) }).replace("-", "−");
}

/** What stands in a message of bytes; throws if it is no such message. */
export function decode(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER || view.getUint32(0, false) !== 0x4d505356) throw new Error("not a picture");
  if (view.getUint8(4) !== VERSION) throw new Error("another version of mpsim runs now: load the page again");
  const kind = view.getUint8(5), count = view.getUint32(12, true);
  if (buffer.byteLength !== HEADER + count * (kind === RADII ? 4 : 5)) throw new Error("a picture was cut");
  if (kind === RADII) return { kind, radii: new Float32Array(buffer, HEADER, count) };
  const float = (offset) => view.getFloat64(offset, true);
  return {
    kind, count, serial: view.getUint32(8, true), frame: Number(view.getBigUint64(16, true)), time: float(24),
    walls: [float(32), float(40), float(48), float(56)], extent: [float(64), float(72)],
    usual: float(80), fastest: float(88),
    places: new Uint16Array(buffer, HEADER, 2 * count), colours: new Uint8Array(buffer, HEADER + 4 * count, count),
  };
}

// --- the stage

const SHADERS = [`#version 300 es
in vec2 corner, place; in float radius, colour;
uniform vec2 extent, image, centre, canvas; uniform float scale;
out vec2 at; flat out float size, tint;
void main() {
  vec2 middle = place * extent + image * mix(-extent, extent, lessThan(place, vec2(0.5)));
  size = max(radius * scale, 0.75);
  at = corner * (size + 1.0);
  vec2 clip = ((middle - centre) * scale + at) * 2.0 / canvas;
  tint = colour * 255.0 / ${FASTEST}.0;
  gl_Position = tint > 1.001 ? vec4(2.0, 2.0, 2.0, 1.0) : vec4(clip, 0.0, 1.0);
}`, `#version 300 es
precision highp float;
in vec2 at; flat in float size, tint; uniform vec3 colours[${VIRIDIS.length}]; out vec4 shade;
void main() {
  float distance = length(at), cover = clamp(size + 0.5 - distance, 0.0, 1.0);
  if (cover <= 0.0) discard;
  float place = clamp(tint, 0.0, 1.0) * float(${VIRIDIS.length - 1});
  int low = min(int(place), ${VIRIDIS.length - 2});
  vec3 own = mix(colours[low], colours[low + 1], place - float(low));
  float rim = size > 2.5 ? smoothstep(size - 1.6, size - 0.6, distance) * 0.6 : 0.0;
  shade = vec4(own * (1.0 - rim), 1.0) * cover;
}`];

/** Draws discs by WebGL2, each as two triangles: points have a largest size, and vanish when their centre leaves. */
class ByWebGL {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true, powerPreference: "high-performance" });
    if (!this.gl) throw new Error("no WebGL2");
    this.build();
    canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); this.lost = true; });
    canvas.addEventListener("webglcontextrestored", () => { this.lost = false; this.build(); requestDraw(); });
  }

  build() {
    const gl = this.gl, program = gl.createProgram();
    [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, k) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, SHADERS[k]);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    });
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "no shaders");
    gl.useProgram(program);
    this.uniform = (name) => gl.getUniformLocation(program, name);
    gl.uniform3fv(this.uniform("colours"), new Float32Array(VIRIDIS.flat().map((each) => each / 255)));
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.place = {};
    this.buffer = {};
    for (const name of ["corner", "place", "radius", "colour"]) {
      this.place[name] = gl.getAttribLocation(program, name);
      this.buffer[name] = gl.createBuffer();
    }
    this.fill("corner", new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), 2, gl.FLOAT, false, 0);
    this.loaded = this.radii = null;
  }

  fill(name, values, size, type, normalized, divisor) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer[name]);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(this.place[name]);
    gl.vertexAttribPointer(this.place[name], size, type, normalized, 0, 0);
    gl.vertexAttribDivisor(this.place[name], divisor);
  }

  load(picture, radii) {
    const gl = this.gl;
    if (this.loaded !== picture) {
      this.fill("place", picture.places, 2, gl.UNSIGNED_SHORT, true, 1);
      this.fill("colour", picture.colours, 1, gl.UNSIGNED_BYTE, true, 1);
      this.loaded = picture;
    }
    if (this.radii !== radii) {
      if (radii.length > 1) this.fill("radius", radii, 1, gl.FLOAT, false, 1);
      else {
        gl.disableVertexAttribArray(this.place.radius);
        gl.vertexAttrib1f(this.place.radius, radii[0] ?? 0);
      }
      this.radii = radii;
    }
  }

  draw(picture, radii, camera, images) {
    if (this.lost) return;
    const gl = this.gl, [width, height] = [this.canvas.width, this.canvas.height];
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!picture || !radii || !picture.count) return;
    this.load(picture, radii);
    gl.uniform2f(this.uniform("extent"), ...picture.extent);
    gl.uniform2f(this.uniform("centre"), camera.x, camera.y);
    gl.uniform2f(this.uniform("canvas"), width, height);
    gl.uniform1f(this.uniform("scale"), camera.scale);
    if (images.length > 1) { // what lies beyond a periodic edge is seen inside
      const [left, top] = camera.pixel(0, picture.extent[1]), [right, bottom] = camera.pixel(picture.extent[0], 0);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(Math.round(left), Math.round(height - bottom), Math.round(right - left), Math.round(bottom - top));
    }
    for (const image of images) {
      gl.uniform2f(this.uniform("image"), ...image);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, picture.count);
    }
  }
}

/** Draws discs on a canvas, where there is no WebGL2: in 32 colours, and small ones as squares. */
class ByCanvas {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
  }

  draw(picture, radii, camera, images) {
    const c = this.context;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (!picture || !radii) return;
    const [w, h] = picture.extent, bins = Array.from({ length: 32 }, () => []);
    for (let k = 0; k < picture.count; k++) if (picture.colours[k] !== ABSORBED) bins[picture.colours[k] >> 3].push(k);
    c.save();
    if (images.length > 1) {
      const [left, top] = camera.pixel(0, h), [right, bottom] = camera.pixel(w, 0);
      c.beginPath();
      c.rect(left, top, right - left, bottom - top);
      c.clip();
    }
    c.strokeStyle = "#0009";
    bins.forEach((discs, bin) => {
      const large = new Path2D();
      c.fillStyle = colourOf(8 * bin + 4);
      for (const k of discs) {
        const fx = picture.places[2 * k] / 65535, fy = picture.places[2 * k + 1] / 65535;
        const radius = Math.max((radii.length > 1 ? radii[k] : radii[0]) * camera.scale, 0.75);
        for (const [ix, iy] of images) {
          const [x, y] = camera.pixel((fx + ix * (fx < 0.5 ? 1 : -1)) * w, (fy + iy * (fy < 0.5 ? 1 : -1)) * h);
          if (x < -radius || y < -radius || x > this.canvas.width + radius || y > this.canvas.height + radius) continue;
          if (radius < 2) c.fillRect(x - radius, y - radius, 2 * radius, 2 * radius);
          else {
            large.moveTo(x + radius, y);
            large.arc(x, y, radius, 0, 7);
          }
        }
      }
      c.fill(large);
      c.stroke(large);
    });
    c.restore();
  }
}

/** Which part of the box is seen: the point in the middle, and canvas pixels per length. */
const camera = {
  x: 0.5, y: 0.5, zoom: 1, whole: 1, width: 1, height: 1, free: false,
  get scale() { return this.whole * this.zoom; },
  pixel(x, y) { return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale]; },
  /** Fit the canvas; show all, unless somebody has chosen what is shown. */
  fit(width, height) {
    [this.width, this.height] = [width, height];
    const box = state.scene ?? { width: 1, height: 1 };
    this.whole = 0.96 * Math.min(width / box.width, height / box.height);
    if (!this.free) [this.x, this.y, this.zoom] = [box.width / 2, box.height / 2, 1];
  },
  all() { this.free = false; this.fit(this.width, this.height); requestDraw(); },
  /** Zoom round a pixel, which stays where it is. */
  zoomBy(factor, px = this.width / 2, py = this.height / 2) {
    const before = this.scale;
    this.zoom = bound(this.zoom * factor, 0.5, MOST_ZOOM);
    const change = 1 / before - 1 / this.scale;
    this.moveTo(this.x + (px - this.width / 2) * change, this.y - (py - this.height / 2) * change);
  },
  moveBy(px, py) { this.moveTo(this.x - px / this.scale, this.y + py / this.scale); },
  moveTo(x, y) {
    const box = state.scene ?? { width: 1, height: 1 };
    [this.x, this.y, this.free] = [bound(x, 0, box.width), bound(y, 0, box.height), true];
    requestDraw();
  },
};

const state = {
  scene: null, status: { phase: "connecting", speed: 1, note: null }, gauges: null, picture: null, radii: null,
  history: {}, historyFrame: -1, drawn: 0, socket: null, refused: null, since: performance.now(),
};

const stage = $("stage"), discs = $("discs-canvas"), lines = $("lines");
let renderer;
try {
  if (new URLSearchParams(location.search).get("canvas") === "2d") throw new Error("asked for");
  renderer = new ByWebGL(discs);
} catch {
  renderer = new ByCanvas(discs);
}

/** Where discs are drawn again, as images: (0, 0) is where they are. */
function images(scene) {
  const [x, y] = scene?.periodic ?? [false, false];
  return [[0, 0], ...(x ? [[1, 0]] : []), ...(y ? [[0, 1]] : []), ...(x && y ? [[1, 1]] : [])];
}

/** Make a canvas as fine as the screen; returns its size in its own pixels, and whether that is new. */
function sharpen(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const [width, height] = [Math.max(Math.round(box.width * ratio), 1), Math.max(Math.round(box.height * ratio), 1)];
  const changed = canvas.width !== width || canvas.height !== height;
  if (changed) [canvas.width, canvas.height] = [width, height];
  return { width, height, ratio, changed };
}

let asked = false;
function requestDraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; draw(); });
}

function draw() {
  const { width, height, ratio } = sharpen(discs);
  sharpen(lines);
  camera.fit(width, height);
  drawGround(ratio);
  renderer.draw(state.picture, state.radii, camera, images(state.scene));
  drawLegend();
  const picture = state.picture;
  if (picture) {
    $("time").textContent = digits(picture.time);
    $("frame").textContent = picture.frame.toLocaleString("en");
    state.drawn += 1;
    stage.dataset.frame = picture.frame;
    stage.dataset.drawn = state.drawn;
  }
}

/** The box, what stands in it, and what a moving wall has closed off: below the discs, so that they are seen whole. */
function drawGround(ratio) {
  const c = lines.getContext("2d"), scene = state.scene;
  c.setTransform(1, 0, 0, 1, 0, 0);
  c.clearRect(0, 0, lines.width, lines.height);
  if (!scene) return;
  const [left, top] = camera.pixel(0, scene.height), [right, bottom] = camera.pixel(scene.width, 0);
  c.fillStyle = "#fff";
  c.fillRect(left, top, right - left, bottom - top);
  const walls = state.picture?.walls;
  if (scene.wall !== null && walls) {
    const [x, y] = camera.pixel(walls[0], walls[3]), [x2, y2] = camera.pixel(walls[1], walls[2]);
    c.fillStyle = "#9aa3ad";
    if (scene.wall === 0) c.fillRect(left, top, x - left, bottom - top);
    if (scene.wall === 1) c.fillRect(x2, top, right - x2, bottom - top);
    if (scene.wall === 2) c.fillRect(left, y2, right - left, bottom - y2);
    if (scene.wall === 3) c.fillRect(left, top, right - left, y - top);
  }
  c.save();
  c.beginPath();
  c.rect(left, top, right - left, bottom - top);
  c.clip();
  c.strokeStyle = "#3a3f45";
  c.lineCap = "round";
  const shifts = (periodic, length) => (periodic ? [0, -length, length] : [0]);
  for (const [ax, ay, bx, by, radius] of scene.capsules)
    for (const dx of shifts(scene.periodic[0], scene.width))
      for (const dy of shifts(scene.periodic[1], scene.height)) {
        c.lineWidth = Math.max(2 * radius * camera.scale, 1.5 * ratio);
        c.beginPath();
        c.moveTo(...camera.pixel(ax + dx, ay + dy));
        c.lineTo(...camera.pixel(bx + dx, by + dy));
        c.stroke();
      }
  c.restore();
  c.lineWidth = 2 * ratio;
  c.strokeStyle = "#16191d";
  const side = (dotted, ...points) => {
    c.setLineDash(dotted ? [2 * ratio, 5 * ratio] : []);
    c.beginPath();
    points.forEach((point, k) => (k ? c.lineTo(...point) : c.moveTo(...point)));
    c.stroke();
  };
  for (const x of [left, right]) side(scene.periodic[0], [x, top], [x, bottom]);
  for (const y of [top, bottom]) side(scene.periodic[1], [left, y], [right, y]);
  c.setLineDash([]);
}

/** Text that fits a canvas: its size in canvas pixels. */
const fontSize = (ratio) => parseFloat(getComputedStyle(document.documentElement).fontSize) * 0.82 * ratio;

let legendKey = "";
function drawLegend() {
  const canvas = $("legend"), { width, height, ratio, changed } = sharpen(canvas), picture = state.picture;
  const key = picture ? `${picture.usual} ${picture.fastest}` : "";
  if (key === legendKey && !changed) return;
  legendKey = key;
  const c = canvas.getContext("2d"), size = fontSize(ratio), bar = height - 2.95 * size;
  c.clearRect(0, 0, width, height);
  if (!picture) return;
  for (let x = 0; x < width; x++) {
    c.fillStyle = colourOf((x / (width - 1)) * FASTEST);
    c.fillRect(x, 0, 1, bar);
  }
  c.font = `${size}px system-ui, "DejaVu Sans", sans-serif`;
  c.fillStyle = c.strokeStyle = "#16191d";
  const knee = (KNEE / FASTEST) * width;
  const ticks = [[0, 0, "left"], [knee / 2, picture.usual / 2, "center"], [knee, picture.usual, "right"], [width, picture.fastest, "right"]];
  for (const [x, speed, align] of ticks) {
    c.textAlign = align;
    c.fillRect(bound(x - ratio / 2, 0, width - ratio), bar, ratio, 0.4 * size);
    c.fillText(digits(speed), x, bar + 1.3 * size);
  }
  c.fillStyle = "#4d5661";
  c.textAlign = "left";
  c.fillText("speed [length/time]", 0, bar + 2.5 * size);
  c.textAlign = "right";
  c.fillText("98 % below", knee, bar + 2.5 * size);
  c.fillText("max", width, bar + 2.5 * size);
}

// --- the gauges

/** Least height of a chart, where less is rounding; of the others it is 2 % of the value. */
const LEAST = { energy_drift: 1e-9 };
const GAUGES = ["temperature", "energy_drift", "collisions_per_second", "frames_per_second", "nanoseconds"];

function drawGauges() {
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
function drawChart(canvas, values, smallest) {
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
function drawSpeeds(speeds) {
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

// --- what the simulation says

function take(message) {
  if (message.type === "scene") {
    if (message.version !== VERSION) return refuse("another version of mpsim runs now: load the page again");
    state.scene = message;
    $("name").textContent = document.title = message.name || "mpsim";
    $("reset").disabled = !message.can_reset;
    $("reset").title = message.can_reset ? "R" : "This simulation belongs to a program: only that can start it anew.";
    const periodic = message.periodic.every(Boolean) ? "periodic" : message.periodic.some(Boolean) ? `periodic along ${message.periodic[0] ? "x" : "y"}` : "walls";
    $("about").textContent = `box ${digits(message.width)} × ${digits(message.height)}, ${periodic}; method ${message.method}, dt ${digits(message.dt)}`;
    requestDraw();
  } else if (message.type === "status") {
    state.status = message;
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
}

function takeBytes(buffer) {
  const found = decode(buffer);
  if (found.kind === RADII) { state.radii = found.radii; return; }
  state.picture = found;
  send({ do: "ack", serial: found.serial });
  requestDraw();
}

function showStatus() {
  const { phase, speed, note } = state.status, open = state.socket?.readyState === WebSocket.OPEN;
  const ready = open && (phase === "playing" || phase === "paused");
  $("phase").textContent = open ? { over: "ended" }[phase] ?? phase : state.refused ? "not connected" : "connecting";
  $("play").textContent = phase === "playing" ? "Pause" : "Play";
  for (const id of ["play", "step"]) $(id).disabled = !ready;
  $("speed").disabled = !ready;
  $("reset").disabled = !open || phase === "starting" || !state.scene?.can_reset;
  let at = SPEEDS.indexOf(speed);
  if (at < 0) at = SPEEDS.findIndex((each) => each === null || each >= speed);
  if (document.activeElement !== $("speed") || !dragging) $("speed").value = at;
  $("speed-text").textContent = speedText(speed);
  $("speed").setAttribute("aria-valuetext", speedText(speed));
  const seconds = Math.round((performance.now() - state.since) / 1000);
  notice(state.refused ?? (!open ? (seconds > 1 ? "No connection to mpsim. Is it still running? Trying again …" : null)
    : phase === "starting" ? `Getting ready … ${seconds > 1 ? `${seconds} s; the first time, loops are compiled for up to half a minute` : ""}` : note));
}

function speedText(speed) {
  if (speed === null) return "as fast as it goes";
  return `${speed < 1 ? `1/${Math.round(1 / speed)}` : digits(speed).replace(/\.0+$/, "")}×, ${speed * 60 < 10 ? +(speed * 60).toFixed(2) : Math.round(speed * 60)} frames a second`;
}

function notice(text) {
  $("notice").hidden = !text;
  $("notice").textContent = text ?? "";
}

// --- the connection

function send(message) {
  if (state.socket?.readyState === WebSocket.OPEN) state.socket.send(JSON.stringify(message));
}

let patience = 500;
function connect() {
  const address = new URL("socket", location.href);
  address.protocol = "ws:";
  address.search = address.hash = "";
  const socket = (state.socket = new WebSocket(address));
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    patience = 500;
    state.since = performance.now();
    tellVisible();
    showStatus();
  };
  socket.onmessage = ({ data }) => {
    try {
      if (typeof data === "string") take(JSON.parse(data)); else takeBytes(data);
    } catch (error) {
      refuse(String(error.message ?? error));
    }
  };
  socket.onclose = ({ code, reason }) => {
    if (state.refused) return;
    if (REFUSED.includes(code)) { refuse(`mpsim has ended the connection: ${reason}. Load the page again.`); return; }
    state.since = patience === 500 ? performance.now() : state.since;
    setTimeout(connect, patience);
    patience = Math.min(2 * patience, 5000);
    showStatus();
  };
}

function refuse(text) {
  state.refused = text;
  state.socket?.close();
  showStatus();
}

const tellVisible = () => send({ do: "visible", value: document.visibilityState === "visible" });
document.addEventListener("visibilitychange", () => { tellVisible(); requestDraw(); });
setInterval(() => { if (state.status.phase === "starting" || state.socket?.readyState !== WebSocket.OPEN) showStatus(); }, 1000);

// --- what people do

const act = {
  play: () => send({ do: state.status.phase === "playing" ? "pause" : "play" }),
  step: () => send({ do: "step", frames: 1 }),
  reset: () => send({ do: "reset" }),
};
const disabled = (id) => $(id).disabled;
for (const id of ["play", "step", "reset"]) $(id).addEventListener("click", act[id]);

let dragging = false; // the slider
function setSpeed(index) {
  const at = bound(index, 0, SPEEDS.length - 1);
  $("speed").value = at; // at once, so that the next key counts from here
  send({ do: "speed", value: SPEEDS[at] });
}
$("speed").max = SPEEDS.length - 1;
$("speed").value = USUAL;
$("speed").addEventListener("input", () => { dragging = true; setSpeed(+$("speed").value); });
$("speed").addEventListener("change", () => { dragging = false; });

$("zoom-in").addEventListener("click", () => camera.zoomBy(1.5));
$("zoom-out").addEventListener("click", () => camera.zoomBy(1 / 1.5));
$("zoom-all").addEventListener("click", () => camera.all());

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const on = event.target, key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const onControl = on.closest?.("button, input, summary");
  if (onControl && (key === " " || key === "Enter" || key.startsWith("Arrow"))) return; // it has a meaning of its own there
  const move = 0.1 * Math.min(camera.width, camera.height);
  const deeds = {
    " ": () => disabled("play") || act.play(), ".": () => disabled("step") || act.step(), r: () => disabled("reset") || act.reset(),
    "[": () => disabled("speed") || setSpeed(+$("speed").value - 1), "]": () => disabled("speed") || setSpeed(+$("speed").value + 1),
    m: () => disabled("speed") || setSpeed(SPEEDS.length - 1),
    "+": () => camera.zoomBy(1.25), "=": () => camera.zoomBy(1.25), "-": () => camera.zoomBy(0.8), 0: () => camera.all(),
  };
  if (on === stage) Object.assign(deeds, {
    ArrowLeft: () => camera.moveBy(move, 0), ArrowRight: () => camera.moveBy(-move, 0),
    ArrowUp: () => camera.moveBy(0, move), ArrowDown: () => camera.moveBy(0, -move),
  });
  if (!(key in deeds)) return;
  event.preventDefault();
  deeds[key]();
});

// The wheel zooms on the stage only; elsewhere it scrolls the page, as ever.
const onCanvas = (event) => {
  const box = stage.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  return [(event.clientX - box.left - stage.clientLeft) * ratio, (event.clientY - box.top - stage.clientTop) * ratio];
};
stage.addEventListener("wheel", (event) => {
  event.preventDefault();
  camera.zoomBy(Math.exp(-bound(event.deltaY * (event.deltaMode ? 30 : 1), -200, 200) / 400), ...onCanvas(event));
}, { passive: false });

const pointers = new Map();
stage.addEventListener("pointerdown", (event) => {
  if (event.target.closest("button")) return;
  stage.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, onCanvas(event));
  stage.classList.add("dragged");
});
stage.addEventListener("pointermove", (event) => {
  const before = pointers.get(event.pointerId);
  if (!before) return;
  const now = onCanvas(event), other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
  pointers.set(event.pointerId, now);
  if (other) { // two fingers
    const far = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]) || 1;
    camera.zoomBy(far(now) / far(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    camera.moveBy((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
  } else camera.moveBy(now[0] - before[0], now[1] - before[1]);
});
for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, (event) => {
  pointers.delete(event.pointerId);
  if (!pointers.size) stage.classList.remove("dragged");
});

new ResizeObserver(() => { legendKey = ""; requestDraw(); drawGauges(); }).observe(document.body);
new ResizeObserver(requestDraw).observe(stage);
stage.dataset.drawnBy = renderer.constructor.name;
if (new Uint8Array(new Uint16Array([1]).buffer)[0] !== 1) refuse("this page needs a machine that is little-endian");
else connect();
showStatus();
