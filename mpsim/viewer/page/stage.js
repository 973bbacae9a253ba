// The stage: the camera, the box and its obstacles.

import { $, INK, bound, digits, polyline, sharpen, state, trace } from "./common.js";
import { ByCanvas, ByWebGL } from "./discs.js";

export const MOST_ZOOM = 64;

/** The visible part of the box: the point in the middle, and canvas pixels per length. */
export const camera = {
  x: 0.5, y: 0.5, zoom: 1, whole: 1, width: 1, height: 1, free: false,
  get scale() { return this.whole * this.zoom; },
  pixel(x, y) { return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale]; },
  /** Fit the canvas; show all, unless the user has moved the view. */
  fit(width, height) {
    [this.width, this.height] = [width, height];
    const box = state.scene ?? { width: 1, height: 1 };
    this.whole = 0.96 * Math.min(width / box.width, height / box.height);
    if (!this.free) [this.x, this.y, this.zoom] = [box.width / 2, box.height / 2, 1];
  },
  all() { this.free = false; this.fit(this.width, this.height); requestDraw(); },
  /** Zoom around a pixel, which stays in place. */
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

export const stage = $("stage"), discs = $("discs-canvas"), lines = $("lines");

const renderers = [];

/** The renderer of discs for a canvas. */
export function rendererFor(canvas) {
  let made;
  try {
    if (new URLSearchParams(location.search).get("canvas") === "2d") throw new Error("asked for");
    made = new ByWebGL(canvas);
  } catch {
    made = new ByCanvas(canvas);
  }
  renderers.push(made);
  return made;
}
export const renderer = rendererFor(discs);

/** Periodic images to draw; (0, 0) is the disc itself. */
export function images(scene) {
  const [x, y] = scene?.periodic ?? [false, false];
  return [[0, 0], ...(x ? [[1, 0]] : []), ...(y ? [[0, 1]] : []), ...(x && y ? [[1, 1]] : [])];
}

export const afterDrawing = []; // other parts draw over the discs

let asked = false;
/** Draw soon, after the last drawing is on the screen, so that the page is not blocked. */
export function requestDraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    if (renderers.some((each) => each.busy())) requestDraw(); else draw();
  });
}

export function draw() {
  const { width, height, ratio } = sharpen(discs);
  sharpen(lines);
  camera.fit(width, height);
  drawGround(lines, state.picture, ratio);
  renderer.draw(state.picture, state.radii, camera, images(state.scene));
  for (const each of afterDrawing) each();
  const picture = state.picture;
  if (picture) {
    $("time").textContent = digits(picture.time);
    $("frame").textContent = picture.frame.toLocaleString("en");
    state.drawn += 1;
    stage.dataset.frame = picture.frame;
    stage.dataset.drawn = state.drawn;
  }
}

/** Draw the box, its obstacles, and the area behind a moving wall, below the discs so that none is covered. */
export function drawGround(canvas, picture, ratio) {
  const c = canvas.getContext("2d"), scene = state.scene;
  c.setTransform(1, 0, 0, 1, 0, 0);
  c.clearRect(0, 0, canvas.width, canvas.height);
  if (!scene) return;
  const fill = (colour, x_low, x_high, y_low, y_high) => {
    const [x, y] = camera.pixel(x_low, y_high), [x2, y2] = camera.pixel(x_high, y_low);
    c.fillStyle = colour;
    c.fillRect(x, y, x2 - x, y2 - y);
    return [x, y, x2, y2];
  };
  const whole = [0, scene.width, 0, scene.height], [left, top, right, bottom] = fill(scene.theme.behind, ...whole);
  fill(scene.theme.ground, ...picture?.walls ?? whole);
  c.save();
  c.beginPath();
  c.rect(left, top, right - left, bottom - top);
  c.clip();
  c.lineCap = "round";
  const shifts = (periodic, length) => (periodic ? [0, -length, length] : [0]);
  state.obstacles.forEach(([ax, ay, bx, by, radius], k) => {
    for (const dx of shifts(scene.periodic[0], scene.width))
      for (const dy of shifts(scene.periodic[1], scene.height)) {
        if (radius < 0) {  // a container, solid around its circle
          if (dx || dy) continue;
          c.beginPath();
          c.rect(left, top, right - left, bottom - top);
          c.arc(...camera.pixel(ax, ay), -radius * camera.scale, 0, 2 * Math.PI);
          c.fillStyle = state.solid[k];
          c.fill("evenodd");
          continue;
        }
        const ends = [camera.pixel(ax + dx, ay + dy), camera.pixel(bx + dx, by + dy)];
        polyline(c, ends, Math.max(2 * radius * camera.scale, 1.5 * ratio), state.solid[k]);
      }
  });
  for (const [first, last] of state.filled) {
    trace(c, state.obstacles.slice(first, last).map(([x, y]) => camera.pixel(x, y)));
    c.fillStyle = state.solid[first];
    c.fill();
  }
  c.restore();
  const side = (dotted, ...ends) => {
    c.setLineDash(dotted ? [2 * ratio, 5 * ratio] : []);
    polyline(c, ends, 2 * ratio, INK);
  };
  for (const x of [left, right]) side(scene.periodic[0], [x, top], [x, bottom]);
  for (const y of [top, bottom]) side(scene.periodic[1], [left, y], [right, y]);
  c.setLineDash([]);
}
