// Draws the discs by WebGL2, or on a 2-D canvas without it.

import { ABSORBED, FASTEST, VIRIDIS, colourOf } from "./common.js";
import { requestDraw } from "./stage.js";

const SMALL = 4; // radius in pixels below which discs are points: twenty times as fast without a GPU

const SHADERS = [`#version 300 es
in vec2 corner, place; in float radius, colour;
uniform vec2 extent, image, centre, canvas; uniform float scale; uniform bool points;
out vec2 at; flat out float size, tint;
void main() {
  vec2 middle = place * extent + image * mix(-extent, extent, lessThan(place, vec2(0.5)));
  size = max(radius * scale, 0.75);
  at = points ? vec2(0.0) : corner * (size + 1.0);
  gl_PointSize = 2.0 * (size + 1.0);
  vec2 clip = ((middle - centre) * scale + at) * 2.0 / canvas;
  tint = colour * 255.0 / ${FASTEST}.0;
  gl_Position = tint > 1.001 ? vec4(2.0, 2.0, 2.0, 1.0) : vec4(clip, 0.0, 1.0);
}`, `#version 300 es
precision highp float;
in vec2 at; flat in float size, tint; uniform vec3 colours[${VIRIDIS.length}]; uniform bool points; out vec4 shade;
void main() {
  float distance = length(points ? (gl_PointCoord * 2.0 - 1.0) * (size + 1.0) : at), cover = clamp(size + 0.5 - distance, 0.0, 1.0);
  if (cover <= 0.0) discard;
  float place = clamp(tint, 0.0, 1.0) * float(${VIRIDIS.length - 1});
  int low = min(int(place), ${VIRIDIS.length - 2});
  vec3 own = mix(colours[low], colours[low + 1], place - float(low));
  float rim = size > 2.5 ? smoothstep(size - 1.6, size - 0.6, distance) * 0.6 : 0.0;
  shade = vec4(own * (1.0 - rim), 1.0) * cover;
}`];

/** Draws discs by WebGL2: small ones as points, others as two triangles, because points have a largest size, and vanish
 *  when their centre leaves. */
export class ByWebGL {
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
    this.loaded = this.radii = this.fence = this.drawn = null;
  }

  /** Whether the graphics processor, or its substitute, is still busy with the last drawing. */
  busy() {
    if (!this.fence || this.lost) return false;
    if (this.gl.clientWaitSync(this.fence, 0, 0) === this.gl.TIMEOUT_EXPIRED) return true;
    this.gl.deleteSync(this.fence);
    this.fence = null;
    return false;
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
      this.largest = radii.reduce((most, each) => Math.max(most, each), 0);
    }
  }

  /** Use the values of discs once per vertex, or once per instance of the square. */
  arrange(points, radii) {
    const gl = this.gl, each = points ? 0 : 1;
    for (const name of ["place", "colour", "radius"]) if (name !== "radius" || radii.length > 1) gl.vertexAttribDivisor(this.place[name], each);
    if (points) gl.disableVertexAttribArray(this.place.corner); else gl.enableVertexAttribArray(this.place.corner);
    gl.uniform1i(this.uniform("points"), points);
  }

  draw(picture, radii, camera, images) {
    if (this.lost) return;
    const gl = this.gl, [width, height] = [this.canvas.width, this.canvas.height];
    const asked = [picture, radii, width, height, camera.x, camera.y, camera.scale, images.length];
    if (this.drawn?.every((each, k) => each === asked[k])) return; // the canvas still shows it
    this.drawn = asked;
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!picture || !radii || !picture.count) return;
    this.load(picture, radii);
    const points = this.largest * camera.scale < SMALL;
    this.arrange(points, radii);
    gl.uniform2f(this.uniform("extent"), ...picture.extent);
    gl.uniform2f(this.uniform("centre"), camera.x, camera.y);
    gl.uniform2f(this.uniform("canvas"), width, height);
    gl.uniform1f(this.uniform("scale"), camera.scale);
    if (images.length > 1) { // draw no image outside the box
      const [left, top] = camera.pixel(0, picture.extent[1]), [right, bottom] = camera.pixel(picture.extent[0], 0);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(Math.round(left), Math.round(height - bottom), Math.round(right - left), Math.round(bottom - top));
    }
    for (const image of images) {
      gl.uniform2f(this.uniform("image"), ...image);
      if (points) gl.drawArrays(gl.POINTS, 0, picture.count);
      else gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, picture.count);
    }
    if (this.fence) gl.deleteSync(this.fence);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
  }
}

/** Draws discs on a 2-D canvas, without WebGL2: in 32 colours, small ones as squares. */
export class ByCanvas {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
  }

  busy() { return false; }

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
